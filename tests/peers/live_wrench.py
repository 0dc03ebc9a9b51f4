"""Subscribes to a running ft-capture as a ROS 2 node of rmw_zenoh would, with other people's libraries only.

    live_wrench.py ENDPOINT SECONDS

Prints one JSON object: what the liveliness tokens list, and what /ft/wrench carried, decoded by rosbags.
Exits with 1 when the topic is not listed, when nothing came, or when an attachment is not rmw_zenoh's.
"""

import json
import struct
import sys
import time

import zenoh
from rosbags.typesys import Stores, get_typestore

ATTACHMENT_LEN = 33


def listed_topics(session):
    """Topic -> type, from the tokens of publishers: as rmw_zenoh's graph cache reads them."""
    topics = {}
    for reply in session.liveliness().get("@ros2_lv/0/**", timeout=5.0):
        if reply.ok is None:
            continue
        chunks = str(reply.ok.key_expr).split("/")
        if len(chunks) == 13 and chunks[5] == "MP":
            topics[chunks[9].replace("%", "/")] = chunks[10]
    return topics


def main():
    endpoint, seconds = sys.argv[1], float(sys.argv[2])
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", json.dumps([endpoint]))
    config.insert_json5("scouting/multicast/enabled", "false")
    typestore = get_typestore(Stores.ROS2_JAZZY)
    got = []
    with zenoh.open(config) as session:
        subscriber = session.declare_subscriber(
            "0/ft/wrench/geometry_msgs::msg::dds_::WrenchStamped_/*",
            lambda sample: got.append((bytes(sample.payload), bytes(sample.attachment or b""), str(sample.key_expr))),
        )
        time.sleep(seconds)
        subscriber.undeclare()
        topics = listed_topics(session)

    missed, last, frames, ages, forces = 0, None, set(), [], []
    for payload, attachment, key in got:
        if len(attachment) != ATTACHMENT_LEN or attachment[16] != 16:
            sys.exit(f"attachment of {len(attachment)} bytes is not rmw_zenoh's")
        sequence, source_ns = struct.unpack_from("<qq", attachment)
        if last is not None:
            missed += sequence - last - 1
        last = sequence
        message = typestore.deserialize_cdr(payload, "geometry_msgs/msg/WrenchStamped")
        stamp = message.header.stamp.sec * 1_000_000_000 + message.header.stamp.nanosec
        if stamp != source_ns:
            sys.exit(f"header.stamp {stamp} is not the attachment's source time {source_ns}")
        frames.add(message.header.frame_id)
        forces.append((message.wrench.force.x**2 + message.wrench.force.y**2 + message.wrench.force.z**2) ** 0.5)
    print(
        json.dumps(
            {
                "topics": topics,
                "received": len(got),
                "missed": missed,
                "frame_ids": sorted(frames),
                "key": got[0][2] if got else None,
                "mean_force_n": sum(forces) / len(forces) if forces else None,
            }
        )
    )
    if "/ft/wrench" not in topics or not got:
        sys.exit(1)


main()
