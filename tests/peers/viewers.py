"""Many viewers of one page: counts what each gets.

    viewers.py HOST:PORT COUNT SECONDS
"""

import json
import struct
import sys
import threading
import time

from websockets.sync.client import connect


def look(address, until, seen):
    frames, lost, before = 0, 0, None
    with connect(f"ws://{address}/live", proxy=None) as opened:
        while time.monotonic() < until:
            frame = opened.recv(timeout=10)
            if isinstance(frame, bytes):
                (number,) = struct.unpack_from("<I", frame)
                lost += number - before - 1 if before else 0
                frames, before = frames + 1, number
    seen.append((frames, lost))


def main():
    address, count, seconds = sys.argv[1], int(sys.argv[2]), float(sys.argv[3])
    seen, until = [], time.monotonic() + seconds
    threads = [threading.Thread(target=look, args=(address, until, seen)) for _ in range(count)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    print(json.dumps({"frames": [frames for frames, _ in seen], "lost": [lost for _, lost in seen], "seconds": seconds}))


main()
