"""Puts twins on the joints of assets that are there already, with the wheel, and reads the result with other people's libraries.

    attach.py DOOR_TWIN.json DRAWER_TWIN.json FOLDER

The asset is a cabinet: a door and two drawers, made here about the twins' axes, moved by a registration, its joints' senses
reversed. Prints one JSON object; the test that runs this has the bounds.
"""
import hashlib
import importlib.util
import json
import math
import pathlib
import sys

import mujoco
import numpy as np
import yourdfpy
from pxr import Gf, Usd, UsdGeom, UsdPhysics, UsdValidation

from forcetwin import Twin, attach

twins = {"door": Twin.load(sys.argv[1]), "lower": Twin.load(sys.argv[2])}
folder = pathlib.Path(sys.argv[3])
turn, way = attach._turn([0.9, 0.1, -0.2, 0.3]), np.array([1.5, -0.4, 0.3])
registration = np.eye(4)
registration[:3, :3], registration[:3, 3] = turn, way
found = {}


def moved(point):
    return turn @ np.array(point) + way


def numbers(values):
    return " ".join(repr(float(v)) for v in values)


# The parts in the asset's frame: joint, axis (reversed), anchor, handle. A second drawer hangs half a metre above the first.
parts = {}
for name, twin in twins.items():
    direction, point = twin.axis
    parts[name] = ("revolute" if name == "door" else "prismatic", -turn @ np.array(direction), moved(point), moved(twin.tool))
kind, axis, anchor, handle = parts["lower"]
parts["upper"] = (kind, axis, anchor, handle + turn @ np.array([0, 0, 0.5]))
parts["lid"] = ("revolute", np.cross(axis, [0.3, 0.1, 1.0]) / np.linalg.norm(np.cross(axis, [0.3, 0.1, 1.0])), anchor, handle)

bodies, links, joints = "", "", ""
for name, (kind, axis, anchor, handle) in parts.items():
    bodies += f"""<body name="{name}" pos="{numbers(anchor)}" quat="0.6 0 0.8 0">
      <joint name="{name}_joint" type="{'hinge' if kind == 'revolute' else 'slide'}" axis="{numbers(attach._turn([0.6, 0, 0.8, 0]).T @ axis)}" range="-2 2" damping="3"/>
      <geom type="box" size="0.05 0.02 0.05" pos="{numbers(attach._turn([0.6, 0, 0.8, 0]).T @ (handle - anchor))}" mass="4"/>
      <body name="{name}_knob" pos="{numbers(attach._turn([0.6, 0, 0.8, 0]).T @ (handle - anchor))}"><geom name="{name}_handle" size="0.02" mass="0.5"/></body>
    </body>"""
    links += f"""<link name="{name}"><inertial><mass value="4"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>
      <visual><origin xyz="{numbers(handle - anchor)}"/><geometry><box size="0.1 0.04 0.1"/></geometry></visual></link>"""
    joints += f"""<joint name="{name}_joint" type="{kind}"><parent link="cabinet"/><child link="{name}"/><origin xyz="{numbers(anchor)}"/>
      <axis xyz="{numbers(axis)}"/><limit lower="-2" upper="2" effort="10" velocity="10"/><dynamics damping="3"/></joint>"""
(folder / "cabinet.xml").write_text(f'<mujoco model="cabinet"><compiler angle="radian"/><worldbody>{bodies}</worldbody></mujoco>')
(folder / "cabinet.urdf").write_text(f'<robot name="cabinet"><link name="cabinet"/>{links}{joints}</robot>')
stage = Usd.Stage.CreateNew(str(folder / "cabinet.usda"))
UsdGeom.SetStageMetersPerUnit(stage, 1.0)
UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
UsdPhysics.SetStageKilogramsPerUnit(stage, 1.0)
root = UsdGeom.Xform.Define(stage, "/cabinet")
UsdPhysics.ArticulationRootAPI.Apply(root.GetPrim())
stage.SetDefaultPrim(root.GetPrim())
for name, (kind, axis, anchor, handle) in parts.items():
    part = UsdGeom.Xform.Define(stage, f"/cabinet/{name}")
    part.AddTranslateOp().Set(tuple(map(float, anchor)))
    UsdPhysics.RigidBodyAPI.Apply(part.GetPrim())
    knob = UsdGeom.Sphere.Define(stage, f"/cabinet/{name}/knob")
    knob.CreateRadiusAttr(0.02)
    knob.CreateExtentAttr([(-0.02, -0.02, -0.02), (0.02, 0.02, 0.02)])
    knob.AddTranslateOp().Set(tuple(map(float, handle - anchor)))
    api = (UsdPhysics.RevoluteJoint if kind == "revolute" else UsdPhysics.PrismaticJoint).Define(stage, f"/cabinet/{name}_joint")
    api.CreateBody1Rel().SetTargets([part.GetPath()])
    api.CreateAxisAttr("X")
    # x to the axis: half way about the sum of both.
    middle = (axis + [1, 0, 0]) / np.linalg.norm(axis + [1, 0, 0])
    quat = Gf.Quatf(0.0, *map(float, middle))
    api.CreateLocalPos0Attr(tuple(map(float, anchor)))
    api.CreateLocalRot0Attr(quat)
    api.CreateLocalPos1Attr((0, 0, 0))
    api.CreateLocalRot1Attr(quat)
    api.CreateLowerLimitAttr(-100.0)
    api.CreateUpperLimitAttr(100.0)
stage.Save()
assets = {kind: folder / f"cabinet.{ending}" for kind, ending in (("mjcf", "xml"), ("urdf", "urdf"), ("usd", "usda"))}
before = {kind: hashlib.sha256(path.read_bytes()).hexdigest() for kind, path in assets.items()}

for name, twin in twins.items():
    out = folder / name
    done = {kind: getattr(attach, kind)(twin, path, registration.tolist(), out, name=name) for kind, path in assets.items()}
    here = found[name] = {
        "joints": {kind: one.joint for kind, one in done.items()},
        "axis_deg": max(one.axis_deg for one in done.values()),
        "tool_m": max(one.tool_m for one in done.values()),
        "inertia": twin.inertia,
    }
    (low, high), (slowest, fastest) = done["mjcf"].twin.domain
    q, dq = (v.ravel() for v in np.meshgrid(np.linspace(low, high, 25), np.linspace(slowest, fastest, 24)))
    # The asset's coordinate runs against the twin's.
    effort = -twin.effort(-q, -dq)
    scale = np.sqrt(np.mean(effort**2))

    # MuJoCo.
    model = mujoco.MjModel.from_xml_path(str(done["mjcf"].file))
    data = mujoco.MjData(model)
    joint = model.joint(done["mjcf"].joint)
    at = joint.dofadr[0]
    spec = importlib.util.spec_from_file_location("passive", out / f"{name}_passive.py")
    passive = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(passive)
    # Twice, as a cell of a notebook may be run: the effort is there once.
    for _ in range(2):
        passive.install(model, joint=done["mjcf"].joint)
    got = []
    for a, b in zip(q, dq):
        mujoco.mj_resetData(model, data)
        data.qpos[joint.qposadr[0]], data.qvel[at] = a, b
        mujoco.mj_forward(model, data)
        got.append(data.qfrc_bias[at] - data.qfrc_passive[at] + model.dof_frictionloss[at] * np.sign(b))
    here["mujoco_error"] = float(np.sqrt(np.mean((got - effort) ** 2)) / scale)
    full = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, full, data.qM) if hasattr(data, "qM") else mujoco.mj_fullM(model, data, full)
    here["mujoco_inertia"] = float(full[at, at])
    mujoco.set_mjcb_passive(None)

    # URDF.
    robot = yourdfpy.URDF.load(str(done["urdf"].file))
    moving = robot.joint_map[done["urdf"].joint]
    inertial = robot.link_map[moving.child].inertial
    to_com = robot.get_transform(moving.child, robot.base_link)[:3, :3] @ inertial.origin[:3, 3]
    axis = np.array(moving.axis)
    lever = np.cross(axis, to_com)
    about = float(axis @ inertial.inertia @ axis + inertial.mass * lever @ lever)
    here["urdf_inertia"] = about if moving.type == "revolute" else float(inertial.mass)
    native = json.load(open(out / f"{name}.urdf.mechanism.json"))["native"]
    here["urdf_dynamics"] = [float(moving.dynamics.damping) - native["damping"][0], float(moving.dynamics.friction) - native["friction"]]

    # USD.
    opened = Usd.Stage.Open(str(done["usd"].file))
    problems = UsdValidation.ValidationContext(UsdValidation.ValidationRegistry().GetOrLoadAllValidators()).Validate(opened)
    here["usd_problems"] = [f"{p.GetName()}: {p.GetMessage()}" for p in problems if str(p.GetType()).endswith("Error")]
    prim = opened.GetPrimAtPath(done["usd"].joint)
    axis_name = "angular" if prim.IsA(UsdPhysics.RevoluteJoint) else "linear"
    drive = UsdPhysics.DriveAPI(prim, axis_name)
    si = math.degrees(1) if axis_name == "angular" else 1.0
    k, d = drive.GetStiffnessAttr().Get() * si, drive.GetDampingAttr().Get() * si
    held = k * (q - drive.GetTargetPositionAttr().Get() / si) + d * dq + prim.GetAttribute("newton:friction").Get() * np.sign(dq)
    native = json.load(open(out / f"{name}.usda.mechanism.json"))["native"]
    here["usd_error"] = float(np.sqrt(np.mean((held - effort) ** 2)) / scale)
    here["usd_announced"] = native["relative_error"]
    body = UsdPhysics.MassAPI(opened.GetPrimAtPath(UsdPhysics.Joint(prim).GetBody1Rel().GetTargets()[0]))
    here["usd_inertia"] = float(body.GetDiagonalInertiaAttr().Get()[0] if axis_name == "angular" else body.GetMassAttr().Get())
    here["usd_geometry_kept"] = bool(opened.GetPrimAtPath("/cabinet/upper/knob").IsValid())


def refusal(a_from_w, format="mjcf", **to):
    try:
        getattr(attach, format)(twins["door"], assets[format], a_from_w, **{"out": folder / "never", **to})
    except ValueError as error:
        return str(error)
    return "none"


aside = registration.copy()
aside[:3, 3] += 4.0
found["aside"] = refusal(aside.tolist())
found["onto"] = {kind: refusal(registration.tolist(), kind, out=folder, name="cabinet", force=True) for kind in assets}
askew = np.eye(4)
askew[:3, :3] = attach._turn([math.cos(0.7), math.sin(0.7), 0, 0]) @ turn
found["askew"] = refusal(askew.tolist())
found["untouched"] = before == {kind: hashlib.sha256(path.read_bytes()).hexdigest() for kind, path in assets.items()}
print(json.dumps(found))
