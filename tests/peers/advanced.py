"""Zenoh's own advanced subscriber (zenoh-ext) as a recorder that comes late: it fetches what was published before.

    advanced.py ENDPOINT SECONDS

Prints one JSON object: the numbers of the first and of the last message in order, how many came, how many out of order, and
how often it was tried. zenoh-ext 1.10.2 asks for the history twice, and where a live message arrives between the end of one
answer and the start of the other, it takes that message for the first of all and throws the history away; for a hole it asks
once. Where either has struck it is tried anew, once.
"""

import json
import struct
import sys
import threading
import time

import zenoh
from zenoh.ext import HistoryConfig, RecoveryConfig, declare_advanced_subscriber


def listen(endpoint, seconds):
    """The numbers of the messages, as they came."""
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
        return numbers


def main():
    for tries in (1, 2):
        numbers = listen(sys.argv[1], float(sys.argv[2]))
        ordered = sorted(set(numbers))
        if ordered and ordered == list(range(1, len(ordered) + 1)):
            break
    print(json.dumps({
        "first": ordered[0], "last": ordered[-1], "received": len(numbers), "different": len(ordered),
        "backwards": sum(later < earlier for earlier, later in zip(numbers, numbers[1:])), "tries": tries,
    }))


main()
