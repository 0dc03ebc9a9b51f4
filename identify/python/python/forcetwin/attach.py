"""A twin on the joint of an asset that is there already: MJCF, URDF or USD.

    from forcetwin import Twin, attach
    done = attach.mjcf(twin, "kitchen.xml", a_from_w, "out", name="door")      needs mujoco
    done = attach.urdf(twin, "kitchen.urdf", a_from_w, "out", name="door")     needs yourdfpy
    done = attach.usd(twin, "kitchen.usda", a_from_w, "out", name="door")      needs usd-core

`a_from_w` takes coordinates of the twin's frame (the recording's world) to the asset's: a 4x4 rigid transform, a registration. The
joint is the one of the twin's kind, along its axis, whose part comes nearest to where the tool held the handle. The asset's own zero
is where the grasp began, unless `offset` says by how much more it stands open there (rad or m). The asset is never changed: `out` receives
a new file with the joint's inertia, friction, spring and damping, and the table of what the format cannot hold, as
`Twin.export` writes it. Geometry and limits stay the asset's.
"""
from __future__ import annotations

import dataclasses
import json
import math
import os
import pathlib
import warnings
import xml.etree.ElementTree as ElementTree

import numpy as np

from ._forcetwin import Twin

_MOST_TURNED_DEG = 20.0
_MOST_APART_M = 0.5
_DOUBTFUL_DEG, _DOUBTFUL_M = 5.0, 0.05


@dataclasses.dataclass
class Joint:
    """A joint of the asset at its zero, in the asset's frame."""

    name: str
    kind: str
    axis: np.ndarray
    anchor: np.ndarray
    part: np.ndarray
    """`asset_from_part`, 4x4."""
    distance: float
    """From the tool to the part's geometry, m."""


@dataclasses.dataclass
class Attached:
    """What was written, and how well twin and asset agree."""

    file: pathlib.Path
    joint: str
    twin: Twin
    """In the asset's frame and in its joint's coordinate."""
    axis_deg: float
    """Between the asset's and the twin's axis."""
    axis_m: float
    """Between their lines; nan for a slide."""
    tool_m: float
    """From the tool to the part's geometry."""


def _choose(twin: Twin, joints: list[Joint], offset: float) -> tuple[Joint, Twin, float, float]:
    if twin.axis is None or twin.tool is None:
        raise ValueError("the twin comes from a table and has no axis: it cannot be placed in an asset")
    direction, point = (np.array(v) for v in twin.axis)

    def turned(joint: Joint) -> float:
        return math.degrees(math.acos(min(1.0, abs(float(joint.axis @ direction)))))

    fitting = [j for j in joints if j.kind == twin.kind and turned(j) <= _MOST_TURNED_DEG]
    if not fitting:
        seen = ", ".join(f"{j.name} ({j.kind}, {turned(j):.0f} deg)" for j in joints) or "none"
        raise ValueError(
            f"no {twin.kind} joint within {_MOST_TURNED_DEG:.0f} deg of the twin's axis: {seen}; check the registration a_from_w"
        )
    best = min(fitting, key=lambda joint: joint.distance)
    between = np.linalg.norm(np.cross(direction, best.anchor - point)) if twin.kind == "revolute" else math.nan
    if between > _MOST_APART_M:
        raise ValueError(
            f"{best.name}: its axis lies {between:.2f} m beside the twin's, more than {_MOST_APART_M} m; check the registration a_from_w"
        )
    if turned(best) > _DOUBTFUL_DEG or between > _DOUBTFUL_M or best.distance > _DOUBTFUL_M:
        warnings.warn(
            f"{best.name}: axes {turned(best):.1f} deg and {between:.3f} m apart, tool {best.distance:.3f} m from the part; "
            "check the registration a_from_w",
            stacklevel=3,
        )
    return best, twin.in_coordinate(bool(best.axis @ direction < 0), offset), turned(best), float(between)


def _outside_of_box(point: np.ndarray, middle: np.ndarray, half: np.ndarray) -> float:
    return float(np.linalg.norm(np.maximum(np.abs(point - middle) - half, 0.0)))


def _turn(wxyz) -> np.ndarray:
    w, x, y, z = np.asarray(wxyz, float) / np.linalg.norm(wxyz)
    return np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ])


def _wxyz(turn: np.ndarray) -> list[float]:
    # The eigenvector of the largest eigenvalue (Bar-Itzhack, 2000): no cases, no small divisors.
    t = turn
    k = np.array([
        [t[0, 0] - t[1, 1] - t[2, 2], t[0, 1] + t[1, 0], t[0, 2] + t[2, 0], t[2, 1] - t[1, 2]],
        [0, t[1, 1] - t[0, 0] - t[2, 2], t[1, 2] + t[2, 1], t[0, 2] - t[2, 0]],
        [0, 0, t[2, 2] - t[0, 0] - t[1, 1], t[1, 0] - t[0, 1]],
        [0, 0, 0, t[0, 0] + t[1, 1] + t[2, 2]],
    ])
    x, y, z, w = np.linalg.eigh(k, UPLO="U")[1][:, -1]
    return [float(v) for v in (w, x, y, z)]


def _body_in_part(twin: Twin, part: np.ndarray) -> tuple[dict, np.ndarray, np.ndarray]:
    """The rigid body, its centre and its principal axes in the part's frame."""
    body = twin.rigid_body()
    if twin.kind == "prismatic":
        body["inertia"] = 3 * [max(body["inertia"])]  # never felt; what is rounded must stay some body's
    turn, way = part[:3, :3], part[:3, 3]
    return body, turn.T @ (np.array(body["origin"]) - way), turn.T @ _turn(body["quaternion"])


def _not_onto(asset, out, file: str) -> None:
    """Refuses what would write over the asset, whatever is forced."""
    there = pathlib.Path(out) / file
    if there.exists() and there.samefile(asset):
        raise ValueError(f"{there} is the asset itself, which is never changed: give another folder or name")


def _sidecar(twin: Twin, to: str, out, name: str, force: bool) -> tuple[pathlib.Path, dict]:
    file = pathlib.Path(twin.export(to, out, name, force)[0])
    return file, json.loads(file.with_name(file.name + ".mechanism.json").read_text())["native"]


def mjcf(twin: Twin, asset, a_from_w, out, name: str = "object", offset: float = 0.0, force: bool = False) -> Attached:
    """Writes `out/name.xml` and, beside it, the table and the passive callback: `name_passive.install(model, joint=done.joint)`."""
    import mujoco

    _not_onto(asset, out, f"{name}.xml")
    twin = twin.in_frame("asset", a_from_w)
    spec = mujoco.MjSpec.from_file(os.fspath(asset))
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    tool = np.array(twin.tool if twin.tool is not None else [math.nan] * 3)
    kinds = {int(mujoco.mjtJoint.mjJNT_HINGE): "revolute", int(mujoco.mjtJoint.mjJNT_SLIDE): "prismatic"}

    def moved(body: int) -> set[int]:
        """The body and what is fixed to it."""
        return {b for b in range(model.nbody) if model.body_weldid[b] == model.body_weldid[body]}

    def distance(body: int) -> float:
        away = [math.inf]
        for g in np.flatnonzero(np.isin(model.geom_bodyid, list(moved(body)))):
            local = data.geom_xmat[g].reshape(3, 3).T @ (tool - data.geom_xpos[g])
            away.append(_outside_of_box(local, model.geom_aabb[g, :3], model.geom_aabb[g, 3:]))
        return min(away)

    joints = []
    for j in range(model.njnt):
        body = model.jnt_bodyid[j]
        if int(model.jnt_type[j]) in kinds and model.body_jntnum[body] == 1:
            part = np.eye(4)
            part[:3, :3], part[:3, 3] = data.xmat[body].reshape(3, 3), data.xpos[body]
            joints.append(Joint(model.joint(j).name or str(j), kinds[int(model.jnt_type[j])], data.xaxis[j], data.xanchor[j], part, distance(body)))
    joint, twin, axis_deg, axis_m = _choose(twin, joints, offset)
    file, native = _sidecar(twin, "mjcf", out, name, force)
    body, centre, axes = _body_in_part(twin, joint.part)
    target = next(j for j in spec.joints if (model.joint(j.id).name or str(j.id)) == joint.name)
    target.name = target.name or f"{name}_joint"
    target.stiffness, target.springref, target.damping = native["stiffness"], native["reference"], native["damping"]
    target.frictionloss, target.armature = native["friction"], 0.0
    # What is fixed to the part moves with it, and its mass is the twin's already.
    fixed = moved(model.jnt_bodyid[target.id])
    for own in (body for body in spec.bodies if body.id in fixed):
        own.explicitinertial, own.mass, own.inertia = False, 0.0, np.zeros(3)
        for geom in own.geoms:
            geom.mass, geom.density = 0.0, 0.0
    part = target.parent
    part.explicitinertial, part.mass, part.ipos, part.iquat = True, body["mass"], centre, _wxyz(axes)
    part.inertia, part.gravcomp = body["inertia"], 1.0
    part.fullinertia = np.full(6, np.nan)
    folder = pathlib.Path(asset).resolve().parent
    spec.meshdir, spec.texturedir = str(folder / spec.meshdir), str(folder / spec.texturedir)
    spec.compile()
    file.write_text(spec.to_xml())
    return Attached(file, target.name, twin, axis_deg, axis_m, joint.distance)


def urdf(twin: Twin, asset, a_from_w, out, name: str = "object", offset: float = 0.0, force: bool = False) -> Attached:
    """Writes `out/name.urdf` and the table. Relative paths of meshes lead to where they were; `package://` stays."""
    import yourdfpy

    _not_onto(asset, out, f"{name}.urdf")
    twin = twin.in_frame("asset", a_from_w)
    robot = yourdfpy.URDF.load(os.fspath(asset), load_meshes=False, build_scene_graph=True)
    robot.update_cfg(np.zeros(len(robot.actuated_joints)))
    tool = np.array(twin.tool if twin.tool is not None else [math.nan] * 3)
    kinds = {"revolute": "revolute", "continuous": "revolute", "prismatic": "prismatic"}

    def fixed_to(link: str) -> list[str]:
        children = [j.child for j in robot.robot.joints if j.parent == link and j.type == "fixed"]
        return [link] + [other for child in children for other in fixed_to(child)]

    def distance(link: str) -> float:
        away = [math.inf]
        for other in fixed_to(link):
            for shape in robot.link_map[other].visuals + robot.link_map[other].collisions:
                at = robot.get_transform(other, robot.base_link) @ (np.eye(4) if shape.origin is None else shape.origin)
                g, half = shape.geometry, np.zeros(3)
                if g.box is not None:
                    half = 0.5 * np.asarray(g.box.size, float)
                elif g.sphere is not None:
                    half = np.full(3, g.sphere.radius)
                elif g.cylinder is not None:
                    half = np.array([g.cylinder.radius, g.cylinder.radius, 0.5 * g.cylinder.length])
                away.append(_outside_of_box(at[:3, :3].T @ (tool - at[:3, 3]), np.zeros(3), half))
        return min(away)

    joints = []
    for j in robot.robot.joints:
        if j.type in kinds:
            part = robot.get_transform(j.child, robot.base_link)
            own = np.array([1.0, 0.0, 0.0] if j.axis is None else j.axis, float)
            axis = part[:3, :3] @ (own / np.linalg.norm(own))
            joints.append(Joint(j.name, kinds[j.type], axis, part[:3, 3], part, distance(j.child)))
    joint, twin, axis_deg, axis_m = _choose(twin, joints, offset)
    file, native = _sidecar(twin, "urdf", out, name, force)
    body, centre, axes = _body_in_part(twin, joint.part)
    tree = ElementTree.parse(asset)
    root = tree.getroot()
    element = next(e for e in root.findall("joint") if e.get("name") == joint.name)
    for old in element.findall("dynamics"):
        element.remove(old)
    ElementTree.SubElement(element, "dynamics", damping=repr(native["damping"][0]), friction=repr(native["friction"]))
    links = fixed_to(element.find("child").get("link"))
    for link in root.findall("link"):
        if link.get("name") in links:
            for old in link.findall("inertial"):
                link.remove(old)
        if link.get("name") == links[0]:
            inertial = ElementTree.SubElement(link, "inertial")
            full = axes @ np.diag(body["inertia"]) @ axes.T
            ElementTree.SubElement(inertial, "origin", xyz=" ".join(map(repr, map(float, centre))), rpy="0 0 0")
            ElementTree.SubElement(inertial, "mass", value=repr(body["mass"]))
            pairs = {"ixx": (0, 0), "ixy": (0, 1), "ixz": (0, 2), "iyy": (1, 1), "iyz": (1, 2), "izz": (2, 2)}
            ElementTree.SubElement(inertial, "inertia", {key: repr(float(full[at])) for key, at in pairs.items()})
    for shape in [*root.iter("mesh"), *root.iter("texture")]:
        named = shape.get("filename", "")
        if named and "://" not in named and not os.path.isabs(named):
            shape.set("filename", os.path.relpath(pathlib.Path(asset).resolve().parent / named, file.parent.resolve()))
    tree.write(file, encoding="unicode", xml_declaration=True)
    return Attached(file, joint.name, twin, axis_deg, axis_m, joint.distance)


def usd(twin: Twin, asset, a_from_w, out, name: str = "object", offset: float = 0.0, force: bool = False) -> Attached:
    """Writes `out/name.usda`, a layer over the asset, and the table. The asset's stage must be in metres and in the joint's zero."""
    from pxr import Gf, Sdf, Usd, UsdGeom, UsdPhysics

    _not_onto(asset, out, f"{name}.usda")
    twin = twin.in_frame("asset", a_from_w)
    tool = np.array(twin.tool if twin.tool is not None else [math.nan] * 3)
    source = Usd.Stage.Open(os.fspath(asset))
    if abs(UsdGeom.GetStageMetersPerUnit(source) - 1.0) > 1e-9:
        raise ValueError(f"{asset} is not in metres (metersPerUnit {UsdGeom.GetStageMetersPerUnit(source)}): convert it first")
    placed = UsdGeom.XformCache()
    boxes = UsdGeom.BBoxCache(Usd.TimeCode.Default(), [UsdGeom.Tokens.default_, UsdGeom.Tokens.render])

    def world(prim) -> np.ndarray:
        return np.array(placed.GetLocalToWorldTransform(prim)).T

    def distance(prim) -> float:
        away = [math.inf]
        for shape in Usd.PrimRange(prim):
            if shape.IsA(UsdGeom.Gprim):
                box = boxes.ComputeWorldBound(shape)
                low, high = (np.array(v) for v in (box.GetRange().GetMin(), box.GetRange().GetMax()))
                local = np.linalg.inv(np.array(box.GetMatrix()).T) @ np.append(tool, 1.0)
                away.append(_outside_of_box(local[:3], 0.5 * (low + high), 0.5 * (high - low)))
        return min(away)

    joints = []
    for prim in source.Traverse():
        kind = {"PhysicsRevoluteJoint": "revolute", "PhysicsPrismaticJoint": "prismatic"}.get(prim.GetTypeName())
        bodies = [r.GetTargets() for r in (UsdPhysics.Joint(prim).GetBody0Rel(), UsdPhysics.Joint(prim).GetBody1Rel())] if kind else []
        if not kind or not bodies[1]:
            continue
        api = UsdPhysics.RevoluteJoint(prim) if kind == "revolute" else UsdPhysics.PrismaticJoint(prim)
        frame = world(source.GetPrimAtPath(bodies[0][0])) if bodies[0] else np.eye(4)
        turn = _turn([api.GetLocalRot0Attr().Get().GetReal(), *api.GetLocalRot0Attr().Get().GetImaginary()])
        axis = frame[:3, :3] @ turn @ np.eye(3)["XYZ".index(api.GetAxisAttr().Get())]
        anchor = frame @ np.append(np.array(api.GetLocalPos0Attr().Get(), float), 1.0)
        part = source.GetPrimAtPath(bodies[1][0])
        joints.append(Joint(str(prim.GetPath()), kind, axis / np.linalg.norm(axis), anchor[:3], world(part), distance(part)))
    joint, twin, axis_deg, axis_m = _choose(twin, joints, offset)
    file, native = _sidecar(twin, "usd", out, name, force)
    body, centre, axes = _body_in_part(twin, joint.part)
    file.unlink()
    layer = Sdf.Layer.CreateNew(str(file))
    layer.subLayerPaths.append(os.path.relpath(asset, file.parent))
    stage = Usd.Stage.Open(layer)
    for key in ("metersPerUnit", "upAxis", "kilogramsPerUnit"):
        if source.HasAuthoredMetadata(key):
            stage.SetMetadata(key, source.GetMetadata(key))
    if source.HasDefaultPrim():
        stage.SetDefaultPrim(stage.GetPrimAtPath(source.GetDefaultPrim().GetPath()))
    prim = stage.GetPrimAtPath(joint.name)
    angular = twin.kind == "revolute"
    per = math.radians(1.0) if angular else 1.0
    drive = UsdPhysics.DriveAPI.Apply(prim, "angular" if angular else "linear")
    drive.CreateTypeAttr("force")
    drive.CreateStiffnessAttr(native["stiffness"][0] * per)
    drive.CreateDampingAttr(native["damping"][0] * per)
    drive.CreateTargetPositionAttr(native["reference"] / per)
    friction = native["friction"]
    axis_name = "angular" if angular else "linear"
    prim.AddAppliedSchema(f"PhysxJointAxisAPI:{axis_name}")
    prim.AddAppliedSchema("MjcJointAPI")
    for attribute in ("static", "dynamic"):
        prim.CreateAttribute(f"physxJointAxis:{axis_name}:{attribute}FrictionEffort", Sdf.ValueTypeNames.Float).Set(friction)
    prim.CreateAttribute(f"physxJointAxis:{axis_name}:viscousFrictionCoefficient", Sdf.ValueTypeNames.Float).Set(0.0)
    prim.CreateAttribute("newton:friction", Sdf.ValueTypeNames.Float).Set(friction)
    prim.CreateAttribute("newton:damping", Sdf.ValueTypeNames.Float).Set(0.0)
    prim.CreateAttribute("mjc:frictionloss", Sdf.ValueTypeNames.Double).Set(friction)
    part = stage.GetPrimAtPath(UsdPhysics.Joint(prim).GetBody1Rel().GetTargets()[0])
    mass = UsdPhysics.MassAPI.Apply(part)
    mass.CreateMassAttr(body["mass"])
    mass.CreateCenterOfMassAttr(Gf.Vec3f(*map(float, centre)))
    mass.CreateDiagonalInertiaAttr(Gf.Vec3f(*body["inertia"]))
    w, x, y, z = _wxyz(axes)
    mass.CreatePrincipalAxesAttr(Gf.Quatf(w, x, y, z))
    part.AddAppliedSchema("PhysxRigidBodyAPI")
    part.CreateAttribute("physxRigidBody:disableGravity", Sdf.ValueTypeNames.Bool).Set(True)
    layer.Save()
    return Attached(file, joint.name, twin, axis_deg, axis_m, joint.distance)
