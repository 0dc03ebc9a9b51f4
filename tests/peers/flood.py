"""Publishes wrenches as an ft-capture would, at any rate, until it is killed.

    flood.py ENDPOINT RATE_HZ
"""

import json
import struct
import sys
import time

import zenoh

KEY = (
    "0/ft/wrench/geometry_msgs::msg::dds_::WrenchStamped_/"
    "RIHS01_8dc3deaf06b2ab281f9f9a742a8961c328ca7cec16e3fd6586d3a5c83fa78f77"
)


def main():
    endpoint, rate_hz = sys.argv[1], int(sys.argv[2])
    config = zenoh.Config()
    for key, value in [("mode", "peer"), ("listen/endpoints", [endpoint]), ("scouting/multicast/enabled", False)]:
        config.insert_json5(key, json.dumps(value))
    with zenoh.open(config) as session:
        publisher = session.declare_publisher(KEY)
        print("ready", flush=True)
        begin, sequence = time.time_ns(), 0
        while True:
            # What is due since the last look, every 5 ms.
            due = (time.time_ns() - begin) * rate_hz // 1_000_000_000
            while sequence < due:
                sequence += 1
                stamp = begin + sequence * 1_000_000_000 // rate_hz
                head = struct.pack("<4siII10s2x", b"\0\1\0\0", stamp // 10**9, stamp % 10**9, 10, b"ft_sensor\0")
                payload = head + struct.pack("<6d", 0.001 * (sequence % 1000), 2, 3, 0.1, 0.2, 0.3)
                publisher.put(payload, attachment=struct.pack("<qqB16s", sequence, stamp, 16, b"f" * 16))
            time.sleep(0.005)


main()
