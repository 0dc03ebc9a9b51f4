"""The paper's pipeline in Python, to compare speeds with: NumPy, SciPy's NNLS, PyTorch on the CPU.

Usage: paper_pipeline.py DIR [--window 0.155] [--rate 100] [--epochs 1200] [--patience 120] [--threads N]

DIR holds a recording's aligned streams as little-endian float64: wrench.f64 (stamp s, force N, torque N m), pose.f64 (stamp s,
position m of the TCP, quaternion x y z w), and meta.json (marks and the sensor's place). `cargo run --release -p ft-tests --bin
speed` writes them and runs this beside ft-identify. Needs numpy, scipy and torch (Debian: python3-scipy python3-torch).

Steps, each timed: interpolate; joint by a line and a circle through the positions, the better one; generalized effort by virtual
work, the tool's weight taken off by the free-air part; joint coordinate smoothed by a local cubic, gates, NNLS for mu, b, I;
network g(q) + c(q, |dq|) dq as the paper trains it. Prints one JSON object.
"""

import argparse
import json
import time
from pathlib import Path

import numpy as np
from scipy.optimize import nnls
from scipy.signal import savgol_coeffs
from scipy.spatial.transform import Rotation, Slerp

GRAVITY = np.array([0.0, 0.0, -9.80665])


def read(folder):
    """Wrenches and poses as arrays with times in s, marks, and the sensor in the TCP's frame."""
    wrench = np.fromfile(folder / "wrench.f64").reshape(-1, 7)
    pose = np.fromfile(folder / "pose.f64").reshape(-1, 8)
    meta = json.loads((folder / "meta.json").read_text())
    return wrench, pose, meta["marks"], meta["tcp_from_ft_sensor"]


def circle(points):
    """Axis direction, centre, and rms distance of points from the circle."""
    middle = points.mean(axis=0)
    normal = np.linalg.svd(points - middle, full_matrices=False)[2][2]
    first = np.cross(normal, [1.0, 0.0, 0.0] if abs(normal[0]) < 0.9 else [0.0, 1.0, 0.0])
    first /= np.linalg.norm(first)
    second = np.cross(normal, first)
    x, y = (points - middle) @ first, (points - middle) @ second
    a, b, c = np.linalg.lstsq(np.c_[2 * x, 2 * y, np.ones_like(x)], x * x + y * y, rcond=None)[0]
    radius = np.sqrt(c + a * a + b * b)
    rest = np.hypot(np.hypot(x - a, y - b) - radius, (points - middle) @ normal)
    return normal, middle + a * first + b * second, np.sqrt(np.mean(rest**2))


def line(points):
    """Direction, middle, and rms distance of points from the line."""
    middle = points.mean(axis=0)
    direction = np.linalg.svd(points - middle, full_matrices=False)[2][0]
    rest = points - middle - np.outer((points - middle) @ direction, direction)
    return direction, middle, np.sqrt(np.mean(np.sum(rest**2, axis=1)))


def network(q, dq, tau, epochs, patience):
    """Trains the residual network and gives its error and the epochs it took."""
    import torch

    torch.manual_seed(1)

    def net(inputs, outputs):
        return torch.nn.Sequential(
            torch.nn.Linear(inputs, 64), torch.nn.Tanh(), torch.nn.Linear(64, 64), torch.nn.Tanh(), torch.nn.Linear(64, outputs)
        )

    scale = [np.std(q), np.sqrt(np.mean(dq**2)), np.sqrt(np.mean(tau**2))]
    x = torch.tensor((q - q.mean()) / scale[0], dtype=torch.float32)[:, None]
    v = torch.tensor(dq / scale[1], dtype=torch.float32)
    y = torch.tensor(tau / scale[2], dtype=torch.float32)
    load, damping = net(1, 1), net(2, 2)
    weights = list(load.parameters()) + list(damping.parameters())
    optimizer = torch.optim.AdamW(weights, lr=1e-3, weight_decay=1e-3)
    order = torch.randperm(len(y))
    held, fitted = order[: len(y) // 4], order[len(y) // 4 :]

    def error(rows):
        heads = torch.nn.functional.softplus(damping(torch.cat([x[rows], v[rows, None].abs()], 1)))
        c = torch.where(v[rows] < 0, heads[:, 1], heads[:, 0])
        return torch.mean((load(x[rows])[:, 0] + c * v[rows] - y[rows]) ** 2)

    best, since, done = float("inf"), 0, 0
    for _ in range(epochs):
        done += 1
        optimizer.zero_grad()
        error(fitted).backward()
        optimizer.step()
        with torch.no_grad():
            now = float(error(held))
        best, since = (now, 0) if now < best else (best, since + 1)
        if since >= patience:
            break
    with torch.no_grad():
        return float(torch.sqrt(error(order))) * scale[2], done


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--window", type=float, default=0.155)
    parser.add_argument("--rate", type=float, default=100.0)
    parser.add_argument("--epochs", type=int, default=1200)
    parser.add_argument("--patience", type=int, default=120)
    parser.add_argument("--threads", type=int, help="of PyTorch; as many as it chooses by default")
    args = parser.parse_args()
    seconds, started = {}, time.perf_counter()

    def lap(name):
        nonlocal started
        now = time.perf_counter()
        seconds[name] = now - started
        started = now

    wrench, pose, marks, mounted = read(args.folder)
    lap("read")

    def mark(name):
        return next(t for t, text in marks if text == name)

    t = wrench[:, 0]
    position = np.stack([np.interp(t, pose[:, 0], pose[:, k]) for k in (1, 2, 3)], axis=1)
    inside = np.clip(t, pose[0, 0], pose[-1, 0])
    rotation = Slerp(pose[:, 0], Rotation.from_quat(pose[:, 4:8]))(inside)
    held = (t > mark("grasp") + 0.2) & (t < mark("release") - 0.2)
    free = (t > mark("free_air_begin") + 0.2) & (t < mark("grasp") - 1.0)
    lever, sensor_turn = np.array(mounted[:3]), Rotation.from_quat(mounted[3:])
    turn = rotation * sensor_turn
    origin = position + rotation.apply(lever)
    lap("align")

    points = position[held][:: max(1, int(0.02 * len(t) / (t[-1] - t[0])))]
    slide, hinge = line(points), circle(points)
    prismatic = slide[2] < 3.0 * hinge[2]
    direction, centre, _ = slide if prismatic else hinge
    if prismatic:
        q = (position[held] - position[held][0]) @ direction
    else:
        arm = position[held] - centre
        arm -= np.outer(arm @ direction, direction)
        side = np.cross(direction, arm[0])
        q = np.unwrap(np.arctan2(arm @ side, arm @ arm[0]))
    if q[np.argmax(np.abs(q) > 0.2 * np.ptp(q))] < 0:
        q, direction = -q, -direction
    lap("joint")

    dt = np.median(np.diff(t))
    smooth = np.convolve
    width = max(5, int(args.window / dt) | 1)
    weights = [savgol_coeffs(width, 3, deriv=k, delta=dt) for k in range(3)]
    acceleration = np.stack([smooth(origin[:, k], weights[2], "same") for k in range(3)], axis=1)
    specific = turn.inv().apply(GRAVITY - acceleration)
    # Mass, first moment and bias from the free-air part, quasi-static.
    s = specific[free]
    zero, one = np.zeros((len(s), 3, 3)), np.tile(np.eye(3), (len(s), 1, 1))
    cross = np.zeros((len(s), 3, 3))
    for (i, j), value in {(0, 1): s[:, 2], (0, 2): -s[:, 1], (1, 0): -s[:, 2], (1, 2): s[:, 0], (2, 0): s[:, 1], (2, 1): -s[:, 0]}.items():
        cross[:, i, j] = value
    rows = np.concatenate(
        [np.concatenate([s[:, :, None], zero, one, zero], axis=2), np.concatenate([np.zeros((len(s), 3, 1)), cross, zero, one], axis=2)], axis=1
    ).reshape(-1, 10)
    own = np.linalg.lstsq(rows, wrench[free][:, 1:7].reshape(-1), rcond=None)[0]
    s = specific[held]
    force = wrench[held][:, 1:4] - own[4:7] - own[0] * s
    torque = wrench[held][:, 4:7] - own[7:10] - np.cross(own[1:4], s)
    force, torque = -turn[held].apply(force), -turn[held].apply(torque)
    if prismatic:
        tau = force @ direction
    else:
        tau = (torque + np.cross(origin[held] - centre, force)) @ direction
    lap("effort")

    step = max(1, round(1.0 / (args.rate * dt)))
    half = width // 2
    state = [smooth(q, w, "same")[half:-half:step] for w in weights]
    tau = tau[half:-half:step]
    low, high = q.min(), q.max()
    edge, slow = 0.02 * (high - low), 0.02 * np.quantile(np.abs(state[1]), 0.95)
    implausible = 3.0 * np.quantile(np.abs(state[2]), 0.99)
    kept = (state[0] > low + edge) & (state[0] < high - edge) & (np.abs(state[1]) > slow) & (np.abs(state[2]) < implausible)
    q, dq, ddq, tau = *(series[kept] for series in state), tau[kept]
    regressor = np.c_[ddq, np.sign(dq), dq]
    theta, _ = nnls(regressor, tau)
    residual = tau - regressor @ theta
    lap("dynamics")

    out = {"joint": "prismatic" if prismatic else "revolute", "samples": len(tau), "inertia_coulomb_viscous": theta.tolist()}
    out["rms"] = float(np.sqrt(np.mean(residual**2)))
    import torch  # its import is not part of the training's time

    if args.threads:
        torch.set_num_threads(args.threads)
    started = time.perf_counter()
    out["network_rms"], out["epochs"] = network(q, dq, residual, args.epochs, args.patience)
    out["threads"] = torch.get_num_threads()
    lap("network")
    out["seconds"] = seconds
    print(json.dumps(out))


if __name__ == "__main__":
    main()
