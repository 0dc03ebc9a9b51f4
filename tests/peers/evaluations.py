"""One model, a million states: the wheel, NumPy and (where it is there) PyTorch, each beside Rust.

    evaluations.py TWIN.json NS_PER_STATE_IN_RUST TABLE.json torch_environments.py

The twin is evaluated without its named effects: inertia, friction, load and the spline mechanism. TABLE.json lies beside an export of
the same twin. Prints one JSON object with nanoseconds per state, each the best of several runs; the test that runs this has the bounds.
"""
import contextlib
import io
import json
import runpy
import sys
import time

import forcetwin
import numpy as np

try:
    import torch
except ImportError:
    torch = None

path, rust_ns, table, example = sys.argv[1:]
raw = json.load(open(path))
raw["effects"] = []
twin = forcetwin.Twin.from_json(json.dumps(raw))
rng = np.random.default_rng(7)
(low, high), (slowest, fastest) = twin.domain
states = rng.uniform(low, high, 1_000_000), rng.uniform(slowest, fastest, 1_000_000), rng.uniform(-3, 3, 1_000_000)


def model(xp, whole):
    """The effort by the library `xp`, from the file alone; `whole` rounds down to integers."""
    beta = {name: value or 0.0 for name, value in zip(raw["beta"]["names"], raw["beta"]["values"])}
    load, surfaces = raw["mechanism"]["load"], raw["mechanism"]["damping"]
    of_load = xp.asarray(load["coefficients"], dtype=xp.float64)
    of_surface = [xp.asarray(surface["coefficients"], dtype=xp.float64) for surface in surfaces]

    def splines(interval, pieces, degree, x):
        """Index of the first function that is not zero, and the values of the degree + 1 from there."""
        scaled = xp.clip((x - interval[0]) / (interval[1] - interval[0]) * pieces, 0, pieces)
        piece = xp.clip(whole(scaled), 0, pieces - 1)
        u = scaled - piece
        values = [xp.ones_like(u)]
        for d in range(1, degree + 1):
            new = [xp.zeros_like(u) for _ in range(d + 1)]
            for j, old in enumerate(values):
                new[j] += (j + 1 - u) / d * old
                new[j + 1] += (u + d - 1 - j) / d * old
            values = new
        return piece, values

    def effort(q, dq, ddq):
        out = beta.get("load", 0.0) + beta["inertia"] * ddq + beta["coulomb"] * xp.sign(dq) + beta["viscous"] * dq
        first, values = splines(load["interval"], load["pieces"], load["degree"], q)
        out += sum(of_load[first + j] * v for j, v in enumerate(values))
        for way, (surface, c) in enumerate(zip(surfaces, of_surface)):
            here = (dq >= 0) if way == 0 else (dq < 0)
            speed = xp.abs(dq[here])
            (p, s), (dp, ds) = surface["pieces"], surface["degree"]
            i, in_q = splines(surface["interval_q"], p, dp, q[here])
            j, in_speed = splines(surface["interval_sqrt_speed"], s, ds, xp.sqrt(speed))
            straight = sum(c[(i + a) * (s + ds) + j + b] * u * v for a, u in enumerate(in_q) for b, v in enumerate(in_speed)) * speed
            size, slope = straight, 1.0
            for bend in surface.get("valve", []):
                size = size + (bend["slope"] - slope) * xp.clip(straight - bend["at"], 0, None)
                slope = bend["slope"]
            out[here] += size if way == 0 else -size
        return out

    return effort


def nanoseconds(call, arguments, repeats):
    return 1e9 * min(_once(call, arguments) for _ in range(repeats)) / len(arguments[0])


def _once(call, arguments):
    start = time.perf_counter()
    call(*arguments)
    return time.perf_counter() - start


ours, out = twin.effort(*states), np.empty(1_000_000)
in_numpy = model(np, lambda x: x.astype(np.int64))
found = {"numpy_error": float(np.abs(ours - in_numpy(*states)).max())}
times = found["ns_per_state"] = {
    "rust": float(rust_ns),
    "python, out given": nanoseconds(lambda *s: twin.effort(*s, out=out), states, 60),
    "python, a new array each time": nanoseconds(twin.effort, states, 60),
    "numpy": nanoseconds(in_numpy, states, 3),
    "numpy, a + b + c into a given array": nanoseconds(lambda a, b, c: np.add(np.add(a, b, out=out), c, out=out), states, 30),
}
if torch:
    in_torch = model(torch, lambda x: x.long())
    tensors = [torch.tensor(v.tolist(), dtype=torch.float64) for v in states]
    found["torch"] = f"{torch.__version__}, {torch.get_num_threads()} thread(s)"
    found["torch_error"] = float(np.abs(ours - np.array(in_torch(*tensors).tolist())).max())
    times["torch"] = nanoseconds(in_torch, tensors, 3)
    # The example, on the table: every effect, no inertia.
    sys.argv = [example, table]
    with contextlib.redirect_stdout(io.StringIO()) as said:
        environments = runpy.run_path(example)
    whole, (q, dq, _) = forcetwin.Twin.load(path), (v[:10_000] for v in states)
    q[0] = dq[1] = 0.0
    got = np.array(environments["effort"](torch.tensor(q.tolist()), torch.tensor(dq.tolist())).tolist())
    wanted = whole.effort(q, dq)
    moving = dq != 0
    found["torch_example_error"] = float(np.sqrt(np.mean((got - wanted)[moving] ** 2) / np.mean(wanted[moving] ** 2)))
    found["torch_example_said"] = said.getvalue().strip()
    beyond = 10 * np.full(3, fastest)
    far = np.array(environments["effort"](torch.tensor([low, 0.5 * (low + high), high]), torch.tensor(beyond.tolist())).tolist())
    found["torch_example_error_beyond"] = float(np.abs(far / whole.effort(np.array([low, 0.5 * (low + high), high]), beyond) - 1).max())
found["over_rust"] = {name: value / times["rust"] for name, value in times.items()}
print(json.dumps(found))
