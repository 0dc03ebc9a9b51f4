"""Lets the joint of an exported USD go in Newton, on the CPU, and compares with what the joint's attributes ask for.

    pip install -r newton.txt
    newton_swing.py FILE.usda START UNTIL        both in rad or m; UNTIL below START

Prints one JSON object: Newton's swing time, the efforts that it applies on a grid against the attributes (relative), the joint's
inertia. Newton honours friction only in its MuJoCo solver. Its kernels compile for a minute and more when they run first.
"""
import json
import math
import sys

import newton
import numpy as np
import warp

warp.config.quiet = True
file, start, until = sys.argv[1], float(sys.argv[2]), float(sys.argv[3])
native = json.load(open(file + ".mechanism.json"))["native"]
builder = newton.ModelBuilder()
builder.add_usd(file)
model = builder.finalize(device="cpu")
solver = newton.solvers.SolverMuJoCo(model, use_mujoco_cpu=True)
mj, data = solver.mj_model, solver.mj_data
mj.opt.timestep = step = 0.0005
import mujoco

at = mj.nv - 1
stiffness, damping, friction = native["stiffness"][0], native["damping"][0], native["friction"]
efforts, wanted = [], []
control = model.control()
# A spring that is slack only beyond the joint's limits: Newton moves such a target inside them. Put it where it belongs.
targets = control.joint_target_q if hasattr(control, "joint_target_q") else control.joint_target_pos
loaded = float(targets.numpy()[-1])
moved = targets.numpy()
moved[-1] = data.ctrl[:] = native["reference"]
targets.assign(moved)
for q in np.linspace(until, start, 12):
    for dq in np.linspace(-1, 1, 10):
        data.qpos[-1], data.qvel[-1] = q, dq
        mujoco.mj_forward(mj, data)
        efforts.append(data.qfrc_bias[at] - data.qfrc_passive[at] - data.qfrc_actuator[at] + mj.dof_frictionloss[at] * np.sign(dq))
        wanted.append(stiffness * (q - native["reference"]) + damping * dq + friction * np.sign(dq))
efforts, wanted = np.array(efforts), np.array(wanted)
full = np.zeros((mj.nv, mj.nv))
mujoco.mj_resetData(mj, data)
mujoco.mj_forward(mj, data)
mujoco.mj_fullM(mj, data, full)

# The swing, by Newton's own loop.
state, after = model.state(), model.state()
q = state.joint_q.numpy()
q[-1] = start
state.joint_q.assign(q)
newton.eval_fk(model, state.joint_q, state.joint_qd, state)
time, last = 0.0, start
while time < 30.0:
    state.clear_forces()
    solver.step(state, after, control, None, step)
    state, after = after, state
    now = float(state.joint_q.numpy()[-1])
    if now <= until:
        time += step * (last - until) / (last - now)
        break
    time, last = time + step, now
print(json.dumps({
    "swing_s": time,
    "effort_error": float(np.sqrt(np.mean((efforts - wanted) ** 2) / np.mean(wanted**2))),
    "target_as_loaded": loaded,
    "target": native["reference"],
    "inertia": float(full[at, at]),
}))
