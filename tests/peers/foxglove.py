"""A client of the Foxglove WebSocket protocol, written from its published message layout; rosbags decodes by the advertised
schemas alone.

    foxglove.py URL SECONDS [PROTOCOL]

Prints one JSON object: for each topic how many messages came, and one of them.
"""

import json
import struct
import sys
import time

from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from websockets.sync.client import connect


def plain(value):
    """What JSON can say of a message."""
    if hasattr(value, "__dataclass_fields__"):
        return {name: plain(getattr(value, name)) for name in value.__dataclass_fields__ if not name.startswith("__")}
    if hasattr(value, "tolist"):
        return value.tolist()
    return [plain(element) for element in value] if isinstance(value, list) else value


def main():
    url, seconds = sys.argv[1], float(sys.argv[2])
    protocol = sys.argv[3] if len(sys.argv) > 3 else "foxglove.sdk.v1"
    topics = {}
    with connect(url, subprotocols=[protocol], max_size=None, proxy=None) as socket:
        info = json.loads(socket.recv(timeout=5))
        assert info["op"] == "serverInfo", info
        advertised = json.loads(socket.recv(timeout=5))
        assert advertised["op"] == "advertise", advertised
        channels = {}
        for number, channel in enumerate(advertised["channels"], start=100):
            assert channel["encoding"] == "cdr" and channel["schemaEncoding"] == "ros2msg", channel
            store = get_typestore(Stores.EMPTY)
            store.register(get_types_from_msg(channel["schema"], channel["schemaName"]))
            channels[number] = (channel, store)
            topics[channel["topic"]] = {"type": channel["schemaName"], "count": 0, "last": None, "backwards": 0}
        wanted = [{"id": number, "channelId": channel["id"]} for number, (channel, _) in channels.items()]
        socket.send(json.dumps({"op": "subscribe", "subscriptions": wanted}))
        end = time.monotonic() + seconds
        before = {}
        while time.monotonic() < end:
            try:
                frame = socket.recv(timeout=max(0.01, end - time.monotonic()))
            except TimeoutError:
                break
            if isinstance(frame, str):
                raise SystemExit(f"the server says {frame}")
            code, number, stamp = struct.unpack_from("<BIQ", frame)
            assert code == 1, code
            channel, store = channels[number]
            message = store.deserialize_cdr(frame[13:], channel["schemaName"])
            topic = topics[channel["topic"]]
            topic["count"] += 1
            topic["backwards"] += stamp < before.get(number, 0)
            before[number] = stamp
            topic["last"] = message
    for topic in topics.values():
        topic["last"] = plain(topic["last"])
    print(json.dumps({"name": info["name"], "topics": topics}))


main()
