"""Tries the Python wheel in the environment that it was installed into, with nothing else than what it asks for.

    wheel.py RECORDING TWIN.json

TWIN.json is what `ft-identify` made of the recording. Prints one JSON object; the test that runs this has the bounds.
"""
import ast
import json
import pathlib
import sys

import numpy as np

import forcetwin

recording, path = sys.argv[1:3]
twin = forcetwin.Twin.load(path)
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
into = np.empty_like(q)
found["out_error"] = float(np.abs(twin.effort(q, dq, ddq, out=into) - whole).max()) + float(np.abs(into - whole).max())
found["out_refused"] = refusal(lambda: twin.effort(q, dq, ddq, out=np.empty(7)))
found["out_is_input_refused"] = refusal(lambda: twin.effort(q, dq, ddq, out=q))
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
# What is imported under its own name is said, too.
said |= {one.asname for node in stub if isinstance(node, ast.ImportFrom) for one in node.names if one.asname == one.name}
there = {f"{name}.{member}" for name in classes for member in dir(getattr(forcetwin, name)) if not member.startswith("_")}
found["stub_differs"] = sorted(said ^ (there | set(forcetwin.__all__)))

print(json.dumps(found))
