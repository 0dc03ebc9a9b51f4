"""Tries what it should not on the page of a running ft-capture, and prints what became of each try as one JSON object.

    intruder.py HOST PORT TOKEN

A viewer of good faith looks on all the time: what it saw is in the answer, too.
"""

import json
import socket
import sys
import threading
import time

from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect

HOST, PORT, TOKEN = sys.argv[1], int(sys.argv[2]), sys.argv[3]
HERE = f"{HOST}:{PORT}"


def request(method, path, headers, body=b""):
    """The status of one HTTP request, written by hand so that every header is ours; 0 when the server hung up."""
    headers = {"Host": HERE, "Content-Length": str(len(body)), "Connection": "close", **headers}
    lines = "".join(f"{name}: {value}\r\n" for name, value in headers.items() if value is not None)
    try:
        with socket.create_connection((HOST, PORT), timeout=20) as line:
            line.sendall(f"{method} {path} HTTP/1.1\r\n{lines}\r\n".encode() + body)
            answer = line.makefile("rb").readline().split()
            return int(answer[1]) if len(answer) > 1 else 0
    except (ConnectionError, TimeoutError):
        return 0


def command(name, token, **headers):
    return request("POST", f"/command/{name}", {"Authorization": f"Bearer {token}", **headers})


def websocket(**headers):
    try:
        with connect(f"ws://{HERE}/live", additional_headers=headers, proxy=None) as opened:
            opened.recv(timeout=5)
            return 101
    except InvalidStatus as error:
        return error.response.status_code


def huge_message():
    """100 MB in one message: how it ended, and how much was taken."""
    sent = 0
    with socket.create_connection((HOST, PORT), timeout=20) as line:
        key = "dGhlIHNhbXBsZSBub25jZQ=="
        line.sendall(
            f"GET /live HTTP/1.1\r\nHost: {HERE}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
            f"Sec-WebSocket-Key: {key}\r\nSec-WebSocket-Version: 13\r\n\r\n".encode()
        )
        size = 100_000_000
        try:
            line.sendall(b"\x82\xff" + size.to_bytes(8, "big") + b"\0\0\0\0")
            while sent < size:
                sent += line.send(b"\0" * 65536)
            return "taken", sent
        except (ConnectionError, TimeoutError):
            return "hung up", sent


def talkative():
    """What becomes of a viewer that sends small messages without end, and after how many."""
    with connect(f"ws://{HERE}/live", proxy=None) as opened:
        for count in range(100_000):
            try:
                opened.send("x")
            except ConnectionClosed:
                return "hung up", count
    return "taken", count


def huge_body():
    return request("POST", "/command/mark", {"Authorization": f"Bearer {TOKEN}", "Content-Length": "100000000"}, b"x" * 100_000)


def many_connections(count):
    """How many of `count` connections at one time were let in: those that answer a request."""
    lines, inside = [], 0
    for _ in range(count):
        try:
            lines.append(socket.create_connection((HOST, PORT), timeout=10))
        except OSError:
            pass
    for line in lines:
        try:
            line.settimeout(2)
            line.sendall(f"GET /page.css HTTP/1.1\r\nHost: {HERE}\r\n\r\n".encode())
            inside += bool(line.recv(1))
        except OSError:
            pass
    return lines, inside


class Viewer(threading.Thread):
    """Counts the frames that a viewer of good faith gets."""

    def __init__(self):
        super().__init__(daemon=True)
        self.frames, self.widest = 0, 0.0
        self.start()

    def run(self):
        with connect(f"ws://{HERE}/live", proxy=None) as opened:
            before = None
            while True:
                try:
                    frame = opened.recv()
                except ConnectionClosed:
                    return
                if isinstance(frame, bytes):
                    now = time.monotonic()
                    self.frames += 1
                    self.widest = max(self.widest, now - (before or now))
                    before = now


def main():
    viewer = Viewer()
    time.sleep(2)
    seen = {
        "token": command("tare", TOKEN),
        "no token": request("POST", "/command/tare", {}),
        "wrong token": command("stop", "0" * len(TOKEN)),
        "wrong tokens": sorted({command("stop", f"{guess:032x}") for guess in range(50)}),
        "command of another origin": command("stop", TOKEN, Origin="https://evil.example"),
        "command by another name": command("stop", TOKEN, Host="evil.example"),
        "page by another name": request("GET", "/", {"Host": f"evil.example:{PORT}"}),
        "page without a name": request("GET", "/", {"Host": None}),
        "viewer of our origin": websocket(Origin=f"http://{HERE}"),
        "viewer of another origin": websocket(Origin="https://evil.example"),
        "viewer of another port": websocket(Origin=f"http://{HOST}:1"),
        "huge message": huge_message(),
        "talkative": talkative(),
        "huge body": huge_body(),
        "method": request("GET", "/command/stop", {"Authorization": f"Bearer {TOKEN}"}),
        "path": request("GET", "/../../etc/passwd", {}),
    }
    bearer = {"Authorization": f"Bearer {TOKEN}"}
    seen["folder"] = request("POST", "/command/start", bearer, b"../../intruder")
    seen["too many commands"] = sorted({command("status", TOKEN) for _ in range(60)})
    before = viewer.frames
    begun = time.monotonic()
    lines, inside = many_connections(1000)
    seen["of 1000 connections"] = inside
    time.sleep(2)
    seen["frames_hz meanwhile"] = (viewer.frames - before) / (time.monotonic() - begun)
    # Those that were let in and say nothing are sent away after ten seconds.
    silent = [socket.create_connection((HOST, PORT), timeout=20) for _ in range(3)]
    for line in lines:
        line.close()
    time.sleep(1)
    idle = socket.create_connection((HOST, PORT), timeout=20)
    begun = time.monotonic()
    try:
        idle.recv(1)
    except OSError:
        pass
    seen["silent for"] = time.monotonic() - begun
    for line in silent:
        line.close()
    seen["afterwards"] = request("GET", "/", {})
    seen["widest"] = viewer.widest
    print(json.dumps(seen))


main()
