"""Zenoh's own advanced subscriber (zenoh-ext) as a recorder that comes late: it fetches what was published before.

    advanced.py ENDPOINT SECONDS

Prints one JSON object: the numbers of the first and of the last message in order, how many came, and how many out of order.
"""

import json
import struct
import sys
import threading
import time

import zenoh
from zenoh.ext import HistoryConfig, RecoveryConfig, declare_advanced_subscriber


def main():
    endpoint, seconds = sys.argv[1], float(sys.argv[2])
    config = zenoh.Config()
    for key, value in [("mode", "client"), ("connect/endpoints", [endpoint]), ("scouting/multicast/enabled", False)]:
        config.insert_json5(key, json.dumps(value))
    numbers, lock = [], threading.Lock()

    def take(sample):
        with lock:
            numbers.append(struct.unpack_from("<q", sample.attachment.to_bytes())[0])

    with zenoh.open(config) as session:
        # Its one question for the history goes to whom the session knows by then.
        patience = time.monotonic() + 20.0
        while not any(session.liveliness().get("0/ft/wrench/**/@adv/**")) and time.monotonic() < patience:
            time.sleep(0.1)
        subscriber = declare_advanced_subscriber(
            session, "0/ft/wrench/**", take,
            history=HistoryConfig(detect_late_publishers=True), recovery=RecoveryConfig(heartbeat=True),
        )
        time.sleep(seconds)
        subscriber.undeclare()
    with lock:
        ordered = sorted(set(numbers))
        print(json.dumps({
            "first": ordered[0], "last": ordered[-1], "received": len(numbers), "different": len(ordered),
            "backwards": sum(later < earlier for earlier, later in zip(numbers, numbers[1:])),
        }))


main()
