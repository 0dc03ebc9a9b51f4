"""Sends every command to a running ft-capture, as its README shows, and prints the answers as one JSON object.

    commands.py ENDPOINT ID
"""

import json
import sys

import zenoh


def main():
    endpoint, capture = sys.argv[1:3]
    config = zenoh.Config.from_json5(json.dumps({"mode": "client", "connect": {"endpoints": [endpoint]}}))
    answers = {}
    with zenoh.open(config) as session:
        for name, text in [("mark", "door squeaks here"), ("tare", None), ("status", None), ("mark", None), ("stop", None)]:
            key = name if text is not None or name != "mark" else "mark without text"
            for reply in session.get(f"ft_capture/{capture}/{name}", payload=text):
                answers[key] = json.loads(reply.ok.payload.to_string())
    print(json.dumps(answers))


main()
