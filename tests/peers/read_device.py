"""Reads a simulated device with pyserial, from its maker's table and nothing of this project, and prints what came as JSON.

    read_device.py DRIVER PORT SECONDS

Sensors: {"seconds": ..., "samples": [[Fx, Fy, Fz, Mx, My, Mz], ...], "bad": frames with a wrong check} in N and N m.
Encoders: the same with one angle in degrees per sample. Trackers: with x, y, z, qx, qy, qz, qw.
"""

import json
import struct
import sys
import time

import serial

BAUD = {
    "bota_serial": 460800,
    "robotous_uart": 921600,
    "optoforce_serial": 1000000,
    "kunwei_kwr75": 460800,
    "leptrino": 460800,
    "dynamixel": 57600,
    "amt21": 2000000,
    "encoder_line": 115200,
    "pose_stream": 2000000,
}


def crc16(data, polynomial, value, reflected):
    for byte in data:
        value ^= byte if reflected else byte << 8
        for _ in range(8):
            if reflected:
                value = (value >> 1) ^ polynomial if value & 1 else value >> 1
            else:
                value = ((value << 1) ^ polynomial if value & 0x8000 else value << 1) & 0xFFFF
    return value


def x25(data):
    return crc16(data, 0x8408, 0xFFFF, True) ^ 0xFFFF


class Reader:
    def __init__(self, port, seconds):
        self.port, self.seconds = port, seconds
        self.buffer, self.samples, self.bad = b"", [], 0

    def until_quiet(self):
        """Reads away what still comes."""
        while self.port.read(4096):
            pass
        self.buffer = b""

    def ask(self, command, length):
        """The answer of known length."""
        self.port.write(command)
        end = time.monotonic() + 1.0
        answer = b""
        while len(answer) < length and time.monotonic() < end:
            answer += self.port.read(length - len(answer))
        return answer

    def stream(self, head, length, check, take):
        """Frames of fixed length with a head: those whose check holds are taken."""
        end = time.monotonic() + self.seconds
        # The line's buffer holds 4 kB: read often.
        self.port.timeout = 0.005
        while time.monotonic() < end:
            self.buffer += self.port.read(1024)
            while True:
                at = self.buffer.find(head)
                if at < 0 or len(self.buffer) - at < length:
                    break
                frame = self.buffer[at : at + length]
                if check(frame):
                    self.samples.append(take(frame))
                    self.buffer = self.buffer[at + length :]
                else:
                    self.bad += 1
                    self.buffer = self.buffer[at + 1 :]

    def bota_serial(self):
        # 0 AA | 1 u16 status | 3 6 x f32 | 27 u32 us | 31 f32 deg C | 35 u16 CRC-16/X-25 of 1..35; little endian.
        check = lambda f: x25(f[1:35]) == struct.unpack("<H", f[35:])[0]
        self.stream(b"\xaa", 37, check, lambda f: struct.unpack("<6f", f[3:27]))

    def robotous_uart(self):
        # Command 55 D1..D8 sum AA, response 55 D1..D16 sum AA; RFT64-SB01: 50 counts/N, 2000 counts/(N m).
        command = lambda *data: bytes([0x55, *data, *[0] * (8 - len(data)), sum(data) & 0xFF, 0xAA])
        self.port.write(command(0x0C))
        self.until_quiet()
        answer = self.ask(command(0x0F, 8), 19)
        assert answer[1:3] == b"\x0f\x01", answer
        self.port.write(command(0x0B))
        check = lambda f: sum(f[1:17]) & 0xFF == f[17] and f[18] == 0xAA
        take = lambda f: [raw / scale for raw, scale in zip(struct.unpack(">6h", f[2:14]), [50] * 3 + [2000] * 3)]
        self.stream(b"\x55\x0b", 19, check, take)

    def optoforce_serial(self):
        # AA 07 08 10 | u16 counter | u16 status | 6 x i16 | u16 sum; big endian. Sensitivities: the report of this sensor.
        summed = lambda data: data + struct.pack(">H", sum(data) & 0xFFFF)
        configure = lambda speed: summed(bytes([0xAA, 0x00, 0x32, 0x03, speed, 0, 0]))
        self.port.write(configure(0))
        self.until_quiet()
        answer = self.ask(configure(1), 7)
        assert answer == summed(b"\xaa\x00\x50\x01\x00"), answer
        scale = [18.28, 18.41, 2.12, 278.72, 259.55, 448.47]
        check = lambda f: summed(f[:20]) == f
        take = lambda f: [raw / unit for raw, unit in zip(struct.unpack(">6h", f[8:20]), scale)]
        self.stream(b"\xaa\x07\x08\x10", 22, check, take)

    def kunwei_kwr75(self):
        # 48 AA | 6 x f32 little endian, kg and kg m | 0D 0A; no check.
        self.port.write(b"\x43\xaa\x0d\x0a")
        self.until_quiet()
        self.port.write(b"\x48\xaa\x0d\x0a")
        take = lambda f: [value * 9.81 for value in struct.unpack("<6f", f[2:26])]
        self.stream(b"\x48\xaa", 28, lambda f: f[26:] == b"\x0d\x0a", take)

    def leptrino(self):
        # 10 02 | body, every 10 twice | 10 03 | XOR of body and 03.
        def frame(body):
            check = 0x03
            for byte in body:
                check ^= byte
            return b"\x10\x02" + body.replace(b"\x10", b"\x10\x10") + bytes([0x10, 0x03, check])

        self.port.write(frame(b"\x04\xff\x33\x00"))
        self.until_quiet()
        answer = self.ask(frame(b"\x04\xff\x2b\x00"), 33)
        limits = struct.unpack("<6f", answer[6:30])
        self.port.write(frame(b"\x04\xff\x32\x00"))
        end = time.monotonic() + self.seconds
        while time.monotonic() < end:
            self.buffer += self.port.read(4096)
            while (body := self.next_body()) is not None:
                if len(body) == 20 and body[:3] == b"\x14\xff\x32":
                    raw = struct.unpack("<6h", body[4:16])
                    self.samples.append([count * limit / 10000 for count, limit in zip(raw, limits)])

    def next_body(self):
        at = self.buffer.find(b"\x10\x02")
        body, place = bytearray(), at + 2
        while at >= 0:
            if place + 2 >= len(self.buffer):
                return None
            if self.buffer[place] != 0x10:
                body.append(self.buffer[place])
                place += 1
            elif self.buffer[place + 1] == 0x10:
                body.append(0x10)
                place += 2
            else:
                check = 0x03
                for byte in body:
                    check ^= byte
                self.bad += self.buffer[place + 1] != 0x03 or check != self.buffer[place + 2]
                self.buffer = self.buffer[place + 3 :]
                return bytes(body)
        return None

    def dynamixel(self):
        # Protocol 2.0: FF FF FD 00 id length instruction parameters CRC; 132: present position, 4096 per turn.
        read = bytes.fromhex("ff ff fd 00 01 07 00 02 84 00 04 00 1d 15")
        self.poll(read, 15, lambda f: crc16(f[:13], 0x8005, 0, False) == struct.unpack("<H", f[13:])[0],
                  lambda f: [struct.unpack("<i", f[9:13])[0] * 360 / 4096])

    def amt21(self):
        # 54 asks; u16 little endian, bits 15 and 14 make the odd and the even bits odd in number.
        def check(frame):
            word = struct.unpack("<H", frame)[0]
            return all(bin(word & mask).count("1") % 2 == 1 for mask in (0xAAAA, 0x5555))

        self.poll(b"\x54", 2, check, lambda f: [(struct.unpack("<H", f)[0] & 0x3FFF) * 360 / 16384])

    def poll(self, question, length, check, take):
        end = time.monotonic() + self.seconds
        while time.monotonic() < end:
            answer = self.ask(question, length)
            if len(answer) == length and check(answer):
                self.samples.append(take(answer))
            else:
                self.bad += 1
            time.sleep(0.01)

    def encoder_line(self):
        # $ENC,<us>,<counts>*<XOR of what stands between>; 4096 counts per turn.
        end = time.monotonic() + self.seconds
        self.port.readline()
        while time.monotonic() < end:
            line = self.port.readline()
            if not line.endswith(b"\r\n"):
                continue
            content, check = line[1:-2].split(b"*")
            exclusive = 0
            for byte in content:
                exclusive ^= byte
            self.bad += exclusive != int(check, 16)
            self.samples.append([int(content.split(b",")[2]) * 360 / 4096])

    def pose_stream(self):
        # This project's own format: A5 5A 01 4A | u64 ns | 3 x f64 | 4 x f64 | f32 | u16 CRC-16/X-25 of bytes 2..72.
        check = lambda f: x25(f[2:72]) == struct.unpack("<H", f[72:])[0]
        self.stream(b"\xa5\x5a\x01\x4a", 74, check, lambda f: struct.unpack("<7d", f[12:68]))


def main():
    driver, port, seconds = sys.argv[1:4]
    with serial.Serial(port, BAUD[driver], timeout=0.05) as line:
        reader = Reader(line, float(seconds))
        began = time.monotonic()
        getattr(reader, driver)()
        print(json.dumps({"seconds": time.monotonic() - began, "samples": reader.samples, "bad": reader.bad}))


main()
