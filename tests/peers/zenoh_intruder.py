"""Tries what it should not on the Zenoh side of a running ft-capture, with Zenoh's own Python library, and prints what became
of each try as one JSON object.

    zenoh_intruder.py certificates ENDPOINT ID KEYS OTHER_KEYS
    zenoh_intruder.py passwords    ENDPOINT ID KEYS
    zenoh_intruder.py open         ENDPOINT ID

KEYS are what `ft-capture keys` made, with one operator and one viewer; OTHER_KEYS are of another authority.
"""

import json
import os
import pathlib
import socket
import sys
import time
import tomllib

# This end receives and sends in one thread, too: docs/security.md.
os.environ["ZENOH_RUNTIME"] = "(tx: (handover: rx), rx: (worker_threads: 1))"

import zenoh

WRENCH = "0/ft/wrench/geometry_msgs::msg::dds_::WrenchStamped_"
HASH = "RIHS01_8dc3deaf06b2ab281f9f9a742a8961c328ca7cec16e3fd6586d3a5c83fa78f77"


def session(endpoint, ca=None, own=None, login=None):
    config = zenoh.Config()
    settings = {
        "mode": "client", "connect/endpoints": [endpoint], "connect/timeout_ms": 1500, "connect/exit_on_failure": True,
        "scouting/multicast/enabled": False,
    }
    if ca:
        settings["transport/link/tls/root_ca_certificate"] = str(ca / "ca.pem")
    if own:
        settings["transport/link/tls/enable_mtls"] = True
        settings["transport/link/tls/connect_certificate"] = str(own / "certificate.pem")
        settings["transport/link/tls/connect_private_key"] = str(own / "key.pem")
    if login:
        settings["transport/auth/usrpwd/user"], settings["transport/auth/usrpwd/password"] = login
    for key, value in settings.items():
        config.insert_json5(key, json.dumps(value))
    return zenoh.open(config)


def enters(*arguments, **options):
    """Whether a session can be opened and gets an answer to `status`."""
    try:
        with session(*arguments, **options) as opened:
            return ask(opened, "status")
    except zenoh.ZError:
        return "shut out"


def ask(opened, name, payload=None):
    for reply in opened.get(f"ft_capture/{ID}/{name}", payload=payload, timeout=2.0):
        if reply.ok is not None:
            return "done" if json.loads(reply.ok.payload.to_string())["ok"] else "refused"
        return "error"
    return "no answer"


def heard(opened, seconds, act=lambda: None):
    """Wrenches that come within `seconds`, and of these those that are no wrenches."""
    samples = []
    subscriber = opened.declare_subscriber(f"{WRENCH}/*", lambda sample: samples.append(bytes(sample.payload)))
    begun = time.monotonic()
    act()
    time.sleep(max(0, seconds - (time.monotonic() - begun)))
    subscriber.undeclare()
    return len(samples), sum(sample == b"forged" for sample in samples)


def asked(opened, seconds):
    """How many questions were asked for `seconds` while all samples came, and how many of them had no answer."""
    everything = opened.declare_subscriber("**", lambda sample: None)
    begun, answers = time.monotonic(), []
    while time.monotonic() - begun < seconds:
        answers.append(ask(opened, "status"))
    everything.undeclare()
    return len(answers), answers.count("no answer")


def roles(open_viewer, open_operator, seen):
    """What a viewer and an operator can do."""
    with open_operator() as operator, open_viewer() as viewer:
        seen["asked"], seen["unanswered"] = asked(viewer, 6)
        seen["viewer hears"], _ = heard(viewer, 3)
        seen["viewer lists"] = len(list(viewer.liveliness().get("@ros2_lv/0/**", timeout=3.0)))
        for name, payload in [("status", None), ("tare", None), ("mark", "forged"), ("start", None), ("stop", None)]:
            seen[f"viewer: {name}"] = ask(viewer, name, payload)

        def forge():
            for _ in range(100):
                viewer.put(f"{WRENCH}/{HASH}", b"forged")
                time.sleep(0.01)

        answering = viewer.declare_queryable(f"ft_capture/{ID}/status", lambda query: query.reply(str(query.key_expr), '{"ok": false}'))
        seen["operator hears"], seen["forged"] = heard(operator, 3, forge)
        seen["operator: status"] = ask(operator, "status")
        answering.undeclare()
        for name, payload in [("mark", "by the operator"), ("tare", None)]:
            seen[f"operator: {name}"] = ask(operator, name, payload)


def certificates(endpoint, keys, others):
    seen = {
        "in the clear": enters(endpoint.replace("tls/", "tcp/")),
        "no certificate": enters(endpoint, ca=keys / "viewer"),
        "certificate of another authority": enters(endpoint, ca=keys / "viewer", own=others / "operator"),
        "capture of another authority": enters(endpoint, ca=others / "viewer", own=keys / "operator"),
        "viewer": enters(endpoint, ca=keys / "viewer", own=keys / "viewer"),
    }
    roles(
        lambda: session(endpoint, ca=keys / "viewer", own=keys / "viewer"),
        lambda: session(endpoint, ca=keys / "operator", own=keys / "operator"),
        seen,
    )
    return seen


def passwords(endpoint, keys):
    def login(name):
        read = tomllib.loads((keys / name / "login.toml").read_text())
        return read["user"], read["password"]

    seen = {
        "no password": enters(endpoint, ca=keys / "viewer"),
        "wrong password": enters(endpoint, ca=keys / "viewer", login=("viewer", "0" * 32)),
        "wrong passwords": sorted({enters(endpoint, ca=keys / "viewer", login=("operator", f"{guess:032x}")) for guess in range(5)}),
        "unknown name": enters(endpoint, ca=keys / "viewer", login=("eve", login("viewer")[1])),
        "another's password": enters(endpoint, ca=keys / "viewer", login=("operator", login("viewer")[1])),
    }
    roles(
        lambda: session(endpoint, ca=keys / "viewer", login=login("viewer")),
        lambda: session(endpoint, ca=keys / "operator", login=login("operator")),
        seen,
    )
    return seen


def unlocked(endpoint):
    """Nobody asked for keys: what is left are the limits."""
    seen = {}
    host, port = endpoint.removeprefix("tcp/").split(":")
    with session(endpoint) as good:
        seen["before"], _ = heard(good, 3)
        with session(endpoint) as greedy:
            seen["100 MB"] = ask(greedy, "mark", b"x" * 100_000_000)
        lines = []

        def crowd():
            for _ in range(1000):
                try:
                    lines.append(socket.create_connection((host, int(port)), timeout=1))
                except OSError:
                    pass

        begun = time.monotonic()
        count, _ = heard(good, 3, crowd)
        seen["during 1000 connections, a second"] = count / (time.monotonic() - begun)
        garbage = 0
        for line in lines:
            try:
                line.sendall(b"\xff" * 4096)
                garbage += 1
            except OSError:
                pass
        seen["connections"], seen["garbage sent to"] = len(lines), garbage
        for line in lines:
            line.close()
        time.sleep(1)
        seen["after"], _ = heard(good, 3)
        seen["the good one"] = ask(good, "status")
    seen["newcomer"] = enters(endpoint)
    return seen


KIND, ENDPOINT, ID = sys.argv[1:4]
KEYS = [pathlib.Path(folder) for folder in sys.argv[4:]]
print(json.dumps({"certificates": certificates, "passwords": passwords, "open": unlocked}[KIND](ENDPOINT, *KEYS)))
