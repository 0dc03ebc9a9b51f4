"""Reads a simulated sensor on a CAN interface by python-can, from its maker's table and with nothing of this project.

    read_can.py DRIVER INTERFACE SAMPLES

Prints {"samples": [[Fx, Fy, Fz, Mx, My, Mz], ...], "bad": samples that did not come whole} in N and N m.
"""

import json
import struct
import sys
import time

import can

driver, interface, wanted = sys.argv[1], sys.argv[2], int(sys.argv[3])
bus = can.Bus(interface="socketcan", channel=interface)
samples, bad = [], 0


def send(number, data):
    bus.send(can.Message(arbitration_id=number, data=data, is_extended_id=False))


def receive(patience=0.5):
    """Id and data of the next frame; None when the bus is quiet."""
    message = bus.recv(patience)
    return message and (message.arbitration_id, bytes(message.data))


def until_quiet():
    while receive(0.1):
        pass


def answer(number):
    """The next frame with this id."""
    end = time.monotonic() + 20
    while time.monotonic() < end:
        frame = receive()
        if frame and frame[0] == number:
            return frame[1]
    raise SystemExit(f"no answer with id {number:#x}")


def robotous_can():
    # Command to 0x64, eight bytes; response D1..D8 by id 1, D9..D16 by id 2. RFT64-SB01: 50 counts/N, 2000 counts/(N m).
    global bad
    send(0x64, [0x0C] + [0] * 7)
    until_quiet()
    send(0x64, [0x0F, 0x05] + [0] * 6)
    assert answer(1)[:2] == b"\x0f\x01"
    answer(2)
    send(0x64, [0x0B] + [0] * 7)
    first = None
    while len(samples) < wanted:
        number, data = receive()
        if number == 1 and data[0] == 0x0B:
            bad += first is not None
            first = data
        elif number == 2 and first is not None:
            raw = struct.unpack(">6h", (first + data)[1:13])
            samples.append([count / unit for count, unit in zip(raw, [50] * 3 + [2000] * 3)])
            first = None


def optoforce_can():
    # The stream's packet AA 07 08 10 | counter | status | 6 x i16 | sum, big endian, cut into 8 + 8 + 6 bytes with id 0x100.
    global bad
    summed = lambda data: data + struct.pack(">H", sum(data) & 0xFFFF)

    def configure(speed):
        command = summed(bytes([0xAA, 0, 0x32, 3, speed, 0, 0]))
        send(0x101, command[:8])
        send(0x101, command[8:].ljust(8, b"\0"))

    configure(0)
    until_quiet()
    configure(3)
    packet = b""
    scale = [18.28, 18.41, 2.12, 278.72, 259.55, 448.47]
    while len(samples) < wanted:
        frame = receive()
        if frame is None or frame[0] != 0x100:
            continue
        packet = frame[1] if frame[1][:4] == b"\xaa\x07\x08\x10" else packet + frame[1]
        if len(packet) >= 22:
            whole = packet[:22]
            if summed(whole[:20]) == whole:
                samples.append([raw / unit for raw, unit in zip(struct.unpack(">6h", whole[8:20]), scale)])
            else:
                bad += 1
            packet = b""


def ati_netcanoem():
    # Base 0x20: 0x202 asks for a row of the matrix, 0x207 for counts per unit, 0x200 for the gauges (0 2 4, then 1 3 5).
    global bad
    rows = []
    for axis in range(6):
        send(0x202, [axis])
        rows.append(sum((struct.unpack(">2f", answer(number)) for number in (0x202, 0x203, 0x204)), ()))
    send(0x207, [])
    force, torque = struct.unpack(">2I", answer_of(0x207, 8))
    while len(samples) < wanted:
        send(0x200, [])
        even = struct.unpack(">H3h", answer_of(0x200, 8))
        odd = struct.unpack(">3h", answer_of(0x201, 6))
        bad += even[0] != 0
        gauges = [even[1], odd[0], even[2], odd[1], even[3], odd[2]]
        counts = [sum(a * b for a, b in zip(row, gauges)) for row in rows]
        samples.append([count / unit for count, unit in zip(counts, [force] * 3 + [torque] * 3)])
        time.sleep(0.005)


def answer_of(number, length):
    data = answer(number)
    assert len(data) == length, data
    return data


{"robotous_can": robotous_can, "optoforce_can": optoforce_can, "ati_netcanoem": ati_netcanoem}[driver]()
bus.shutdown()
print(json.dumps({"samples": samples, "bad": bad}))
