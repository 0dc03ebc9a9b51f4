"""Opens the exports of a twin with other people's libraries and compares them with the twin's own numbers.

    exports.py FOLDER NAME STATES.csv BEYOND.csv SWING.json TWIN.json

STATES.csv: q,dq,effort per line, from the twin; BEYOND.csv: the same faster than anything that was probed. Prints one JSON object; the test that runs this has the bounds.
"""
import csv
import importlib.util
import json
import math
import pathlib
import sys

import mujoco
import numpy as np
import onnx
import onnxruntime
import yourdfpy
from pxr import Gf, Usd, UsdGeom, UsdPhysics, UsdUtils

folder, name = pathlib.Path(sys.argv[1]), sys.argv[2]
states, beyond = (np.array([[float(v) for v in row] for row in csv.reader(open(path))]) for path in sys.argv[3:5])
swing = json.load(open(sys.argv[5]))
twin = json.load(open(sys.argv[6]))
q, dq, effort = states.T
scale = np.sqrt(np.mean(effort**2))
found = {}


def relative(ours):
    return float(np.sqrt(np.mean((ours - effort) ** 2)) / scale)


# MuJoCo: joint attributes alone, then with the callback; then a free swing.
model = mujoco.MjModel.from_xml_path(str(folder / f"{name}.xml"))
data = mujoco.MjData(model)
other = mujoco.MjModel.from_xml_path(str(folder / f"{name}.xml"))
there = mujoco.MjData(other)


def off_beyond(ours):
    return float(np.abs(ours / beyond[:, 2] - 1).max())


def mujoco_efforts(q=q, dq=dq):
    out = []
    for at, speed in zip(q, dq):
        data.qpos[0], data.qvel[0] = at, speed
        mujoco.mj_forward(model, data)
        # Gravity and its compensation are one in the bias, one in the passive forces.
        out.append(data.qfrc_bias[0] - data.qfrc_passive[0] + model.dof_frictionloss[0] * np.sign(speed))
    return np.array(out)


found["mujoco_native_error"] = relative(mujoco_efforts())
sidecar = json.load(open(folder / f"{name}.xml.mechanism.json"))
found["mujoco_announced_error"] = sidecar["native"]["relative_error"]
found["table_announced_error"] = sidecar["relative_error"]
found["left_out"], found["not_identified"] = sidecar["left_out"], sidecar["not_identified"]
texts = [(folder / f"{name}.{ending}").read_text() for ending in ("xml", "urdf", "usda")]
found["left_out_in_text"] = all(" without its " in text for text in texts) if sidecar["left_out"] else any(" without its " in text for text in texts)
spec = importlib.util.spec_from_file_location("passive", folder / f"{name}_passive.py")
passive = importlib.util.module_from_spec(spec)
spec.loader.exec_module(passive)
passive.install(model)
found["mujoco_error"] = relative(mujoco_efforts())
found["mujoco_error_beyond"] = off_beyond(mujoco_efforts(*beyond.T[:2]))
mujoco.mj_resetData(model, data)
data.qpos[0] = swing["from"]
while swing["end"]["how"] == "arrived" and data.qpos[0] > swing["until"] and data.time < 60:
    mujoco.mj_step(model, data)
found["mujoco_swing_s"] = data.time
mujoco.mj_resetData(model, data)
data.qpos[0], data.qvel[0] = swing["from"], 0.0
mujoco.mj_forward(model, data)
# The inertia about the joint, as the simulator itself feels it: acceleration by one newton metre more.
data.qfrc_applied[0] = 0.0
mujoco.mj_forward(model, data)
data.qfrc_applied[0] = 1.0
model.dof_frictionloss[0] = 0.0
mujoco.mj_forward(model, data)
after = data.qacc[0]
data.qfrc_applied[0] = 0.0
mujoco.mj_forward(model, data)
found["mujoco_inertia"] = float(1.0 / (after - data.qacc[0]))
# Another model is none of the callback's business.
there.qpos[0], there.qvel[0] = q[0], dq[0]
mujoco.mj_forward(other, there)
data.qpos[0], data.qvel[0] = q[0], dq[0]
mujoco.mj_forward(model, data)
found["mujoco_callback_of_one_model"] = bool(abs(there.qfrc_passive[0] - data.qfrc_passive[0]) > 1e-9)


# Where the handle is when the joint has moved, by each library; the truth by Rodrigues' formula.
def handle(at):
    axis, tool = np.array(twin["joint"]["axis_direction"]), np.array(twin["joint"]["tool_position"])
    at -= twin["joint"]["coordinate"]["offset"]  # the tool is where it was at the recording's 0
    if twin["joint"]["kind"] == "prismatic":
        return tool + at * axis
    arm = tool - np.array(twin["joint"]["axis_point"])
    turned = arm * math.cos(at) + np.cross(axis, arm) * math.sin(at) + axis * axis.dot(arm) * (1 - math.cos(at))
    return tool - arm + turned


places = [0.0, 0.5 * twin["joint"]["q_range"][1]]


def mujoco_handle(at):
    data.qpos[0] = at
    mujoco.mj_forward(model, data)
    return data.geom(f"{name}_handle").xpos.copy()


found["mujoco_handle_m"] = max(float(np.linalg.norm(mujoco_handle(at) - handle(at))) for at in places)
mujoco.set_mjcb_passive(None)

# URDF.
robot = yourdfpy.URDF.load(str(folder / f"{name}.urdf"))
joint = robot.joint_map[f"{name}_joint"]


def urdf_handle(at):
    robot.update_cfg({f"{name}_joint": at})
    local = np.eye(4)
    local[:3, 3] = robot.link_map[name].visuals[1].origin[:3, 3]
    return (robot.get_transform(name, robot.base_link) @ local)[:3, 3]


inertial = robot.link_map[name].inertial
turn = inertial.origin[:3, :3]
direction = np.array(twin["joint"]["axis_direction"])
found["urdf"] = {
    "handle_m": max(float(np.linalg.norm(urdf_handle(at) - handle(at))) for at in places),
    "inertia_about_axis": float(direction @ turn @ inertial.inertia @ turn.T @ direction),
    "mass": float(inertial.mass),
    "type": joint.type,
    "axis": list(map(float, joint.axis)),
    "range": [joint.limit.lower, joint.limit.upper],
    "valid": bool(robot.validate()),
}

# USD.
stage = Usd.Stage.Open(str(folder / f"{name}.usda"))
checker = UsdUtils.ComplianceChecker(arkit=False, skipARKitRootLayerCheck=True) if hasattr(UsdUtils, "ComplianceChecker") else None
if checker:
    checker.CheckCompliance(str(folder / f"{name}.usda"))
    found["usd_problems"] = checker.GetErrors() + checker.GetFailedChecks()
else:
    from pxr import UsdValidation

    validators = UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
    problems = UsdValidation.ValidationContext(validators).Validate(stage)
    found["usd_problems"] = [f"{p.GetName()}: {p.GetMessage()}" for p in problems if str(p.GetType()).endswith("Error")]
prim = stage.GetPrimAtPath(f"/{name}/joint")
kind = "angular" if prim.IsA(UsdPhysics.RevoluteJoint) else "linear"
drive = UsdPhysics.DriveAPI(prim, kind)
limits = UsdPhysics.RevoluteJoint(prim) if kind == "angular" else UsdPhysics.PrismaticJoint(prim)
body = UsdPhysics.MassAPI(stage.GetPrimAtPath(f"/{name}/part"))
rotation = Gf.Rotation(Gf.Quatd(body.GetPrincipalAxesAttr().Get()))
main_axis = np.array(rotation.TransformDir(Gf.Vec3d(1, 0, 0)))
cache = UsdGeom.XformCache()
part = stage.GetPrimAtPath(f"/{name}/part")
to_part = np.array(cache.GetLocalToWorldTransform(part)).T
handle_local = cache.ComputeRelativeTransform(stage.GetPrimAtPath(f"/{name}/part/handle"), part)[0].ExtractTranslation()
at_rest = (to_part @ np.append(np.array(handle_local), 1))[:3]
joint_frame = np.array(Gf.Rotation(Gf.Quatd(limits.GetLocalRot0Attr().Get())).TransformDir(Gf.Vec3d(1, 0, 0)))
to_si = math.degrees(1) if kind == "angular" else 1.0
friction = prim.GetAttribute("newton:friction").Get()
stiffness, damping = drive.GetStiffnessAttr().Get() * to_si, drive.GetDampingAttr().Get() * to_si
target = drive.GetTargetPositionAttr().Get() / to_si
found["usd"] = {
    "kind": kind,
    "handle_m": float(np.linalg.norm(at_rest - handle(0.0))),
    "joint_meets_part_m": float(np.linalg.norm(np.array(limits.GetLocalPos0Attr().Get()) - to_part[:3, 3])),
    "axis_off": float(max(np.linalg.norm(joint_frame - direction), np.linalg.norm(main_axis - direction))),
    "default_prim": stage.GetDefaultPrim().GetName(),
    "range": [limits.GetLowerLimitAttr().Get() / to_si, limits.GetUpperLimitAttr().Get() / to_si],
    "inertia": float(body.GetDiagonalInertiaAttr().Get()[0]) if kind == "angular" else float(body.GetMassAttr().Get()),
    "error": relative(stiffness * (q - target) + damping * dq + friction * np.sign(dq)),
    "announced_error": json.load(open(folder / f"{name}.usda.mechanism.json"))["native"]["relative_error"],
}

# ONNX.
onnx.checker.check_model(onnx.load(folder / f"{name}.onnx"), full_check=True)
session = onnxruntime.InferenceSession(str(folder / f"{name}.onnx"))
got = session.run(None, {"q": q.astype(np.float32), "dq": dq.astype(np.float32)})[0]
found["onnx_error"] = relative(got)
far = {"q": beyond[:, 0].astype(np.float32), "dq": beyond[:, 1].astype(np.float32)}
found["onnx_error_beyond"] = off_beyond(session.run(None, far)[0])
# Ten thousand environments at once.
many = np.resize(q, 10_000).astype(np.float32), np.resize(dq, 10_000).astype(np.float32)
at_once = session.run(None, {"q": many[0], "dq": many[1]})[0]
found["onnx_batch_error"] = float(np.abs(at_once - np.resize(got, 10_000)).max())
print(json.dumps(found))
