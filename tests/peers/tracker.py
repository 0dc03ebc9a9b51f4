"""A tracker that gives the tool's pose directly: publishes it on Zenoh as a ROS 2 node would, until it is killed.

    tracker.py ENDPOINT KEY
"""

import json
import struct
import sys
import time

import zenoh
from rosbags.typesys import Stores, get_typestore


def main():
    endpoint, key = sys.argv[1:]
    store = get_typestore(Stores.ROS2_JAZZY)
    Time, Header, Point, Quaternion, Pose, PoseStamped = (
        store.types[name]
        for name in [
            "builtin_interfaces/msg/Time", "std_msgs/msg/Header", "geometry_msgs/msg/Point", "geometry_msgs/msg/Quaternion",
            "geometry_msgs/msg/Pose", "geometry_msgs/msg/PoseStamped",
        ]
    )
    config = zenoh.Config()
    for name, value in [("mode", "client"), ("connect/endpoints", [endpoint]), ("scouting/multicast/enabled", False)]:
        config.insert_json5(name, json.dumps(value))
    with zenoh.open(config) as session:
        publisher = session.declare_publisher(key)
        print("ready", flush=True)
        sequence = 0
        while True:
            sequence += 1
            now = time.time_ns()
            message = PoseStamped(
                Header(Time(now // 10**9, now % 10**9), "world"),
                Pose(Point(0.25, -0.5, 1.0), Quaternion(0.0, 0.0, 0.0, 1.0)),
            )
            attachment = struct.pack("<qqB16s", sequence, now, 16, b"t" * 16)
            publisher.put(bytes(store.serialize_cdr(message, PoseStamped.__msgtype__)), attachment=attachment)
            time.sleep(0.02)


main()
