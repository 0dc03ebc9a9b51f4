"""Tries the Python wheel in the environment that it was installed into, with nothing else than what it asks for.

    wheel.py RECORDING TWIN.json NS_PER_STATE_IN_RUST

TWIN.json is what `ft-identify` made of the recording. Prints one JSON object; the test that runs this has the bounds.
"""
import ast
import json
import pathlib
import sys
import time

import numpy as np

import forcetwin

recording, path, rust_ns = sys.argv[1], sys.argv[2], float(sys.argv[3])
twin, raw = forcetwin.Twin.load(path), json.load(open(path))
found = {"repr": repr(twin), "kind": twin.kind, "inertia": twin.inertia}
rng = np.random.default_rng(7)
(low, high), (slowest, fastest) = twin.domain


def states(n):
    return rng.uniform(low, high, n), rng.uniform(slowest, fastest, n), rng.uniform(-3, 3, n)


def refusal(call, *arguments):
    try:
        call(*arguments)
    except (ValueError, RuntimeError, OSError) as error:
        return f"{type(error).__name__}: {error}"
    return "none"


# Arrays of any shape, strides and type are what single numbers are.
q, dq, ddq = (v.reshape(20, 30) for v in states(600))
whole = twin.effort(q, dq, ddq)
single = np.array([twin.effort(*map(float, s)) for s in zip(q.ravel(), dq.ravel(), ddq.ravel())]).reshape(20, 30)
found["array_error"] = float(np.abs(whole - single).max())
found["strided_error"] = float(np.abs(twin.effort(q.T, dq.T, ddq.T).T - whole).max())
found["scalar_and_array_error"] = float(np.abs(twin.effort(0.3, dq) - twin.effort(np.full_like(dq, 0.3), dq, 0 * dq)).max())
found["list_error"] = float(abs(twin.effort([0.3], [0.1])[0] - twin.effort(0.3, 0.1)))
found["terms_error"] = float(np.abs(sum(twin.terms(q, dq, ddq).values()) - whole).max())
moved = twin.in_coordinate(True, 0.4).in_frame("asset", np.eye(4).tolist())
found["moved_error"] = float(np.abs(moved.effort(0.4 - q, -dq, -ddq) + whole).max())
found["shapes_refused"] = refusal(twin.effort, np.zeros(3), np.zeros(4))
found["missing_refused"] = refusal(forcetwin.Twin.load, "no/such/twin.json")
found["bad_refused"] = refusal(forcetwin.Twin.from_json, "{}")
found["transform_refused"] = refusal(twin.in_frame, "asset", (2 * np.eye(4)).tolist())
found["gradient_ddq"] = twin.gradient(0.3, 0.2)[2]
found["outside"] = [twin.outside(0.5 * (low + high), 0.1), twin.outside(high + 1, 0.1), twin.outside(0.3, fastest + 9)]
needed = twin.demand(0.8 * high, 6.0, limit=1e-3)
found["demand"] = [needed["exceeds_at"], needed["enough_within"], float(np.abs(needed["effort"]).max() - abs(needed["peak"]))]
swing = twin.release(0.5 * high)
found["swing"] = [swing["end"], float(swing["time"][-1])]
json.loads(twin.to_json())

# The recording and the identification.
samples = forcetwin.read(recording)
found["samples"] = [list(np.shape(v)) for v in (samples.time, samples.position, samples.quaternion, samples.wrench)]
found["quaternion_norm_error"] = float(np.abs(np.linalg.norm(samples.quaternion, axis=1) - 1).max())
found["runs"] = samples.runs
found["unread"] = refusal(forcetwin.read, "no/such/file.mcap")
found["topics_refused"] = refusal(forcetwin.read, recording, {"/nothing": "/ft/wrench"})
identified = forcetwin.identify(recording)
found["identified_effort_error"] = float(np.abs(identified.twin.effort(q, dq, ddq) - whole).max())
found["report"] = [identified.report["schema"], identified.report["final"]["verdict"]]
found["samples_of_joint"] = len(identified.time) == len(identified.q) == len(identified.tau) > 1000


# The stubs name what is there, and all of it.
stub = ast.parse(pathlib.Path(forcetwin.__file__).with_name("__init__.pyi").read_text()).body
classes = {node.name: node.body for node in stub if isinstance(node, ast.ClassDef)}
said = {f"{name}.{member.name if isinstance(member, ast.FunctionDef) else member.target.id}" for name, body in classes.items()
        for member in body if isinstance(member, (ast.FunctionDef, ast.AnnAssign))}
said |= set(classes) | {node.name for node in stub if isinstance(node, ast.FunctionDef)}
there = {f"{name}.{member}" for name in classes for member in dir(getattr(forcetwin, name)) if not member.startswith("_")}
found["stub_differs"] = sorted(said ^ (there | set(forcetwin.__all__)))


# The same model written in NumPy, from the file alone: the twin without its named effects.
def splines(interval, pieces, degree, x):
    """Index of the first function that is not zero, and the values of the degree + 1 from there."""
    scaled = np.clip((x - interval[0]) / (interval[1] - interval[0]) * pieces, 0, pieces)
    piece = np.minimum(scaled.astype(int), pieces - 1)
    u = scaled - piece
    values = [np.ones_like(u)]
    for d in range(1, degree + 1):
        new = [np.zeros_like(u) for _ in range(d + 1)]
        for j, old in enumerate(values):
            new[j] += (j + 1 - u) / d * old
            new[j + 1] += (u + d - 1 - j) / d * old
        values = new
    return piece, values


def numpy_effort(q, dq, ddq):
    beta = {name: value or 0.0 for name, value in zip(raw["beta"]["names"], raw["beta"]["values"])}
    out = beta.get("load", 0.0) + beta["inertia"] * ddq + beta["coulomb"] * np.sign(dq) + beta["viscous"] * dq
    load = raw["mechanism"]["load"]
    first, values = splines(load["interval"], load["pieces"], load["degree"], q)
    c = np.array(load["coefficients"])
    out += sum(c[first + j] * v for j, v in enumerate(values))
    for way, surface in enumerate(raw["mechanism"]["damping"]):
        here = (dq >= 0) if way == 0 else (dq < 0)
        speed = np.abs(dq[here])
        (p, s), (dp, ds) = surface["pieces"], surface["degree"]
        i, in_q = splines(surface["interval_q"], p, dp, q[here])
        j, in_speed = splines(surface["interval_sqrt_speed"], s, ds, np.sqrt(speed))
        c = np.array(surface["coefficients"])
        straight = sum(c[(i + a) * (s + ds) + j + b] * u * v for a, u in enumerate(in_q) for b, v in enumerate(in_speed)) * speed
        size, slope = straight.copy(), 1.0
        for bend in surface.get("valve", []):
            size += (bend["slope"] - slope) * np.maximum(straight - bend["at"], 0)
            slope = bend["slope"]
        out[here] += size if way == 0 else -size
    return out


raw["effects"] = []
plain = forcetwin.Twin.from_json(json.dumps(raw))
q, dq, ddq = states(1_000_000)
found["numpy_error"] = float(np.abs(plain.effort(q, dq, ddq) - numpy_effort(q, dq, ddq)).max())


def nanoseconds(call, repeats):
    best = min(_once(call) for _ in range(repeats))
    return 1e9 * best / len(q)


def _once(call):
    start = time.perf_counter()
    call(q, dq, ddq)
    return time.perf_counter() - start


ours = nanoseconds(plain.effort, 15)
found["ns_per_state"] = {"rust": rust_ns, "python": ours, "numpy": nanoseconds(numpy_effort, 3), "add": nanoseconds(lambda a, b, c: a + b, 7)}
found["python_over_rust"] = ours / rust_ns
print(json.dumps(found))
