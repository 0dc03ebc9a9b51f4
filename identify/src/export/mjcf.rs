//! MuJoCo's XML: cubic stiffness and damping in the joint, the rest by a passive-force callback.

use super::native::Native;
use super::scene::{Scene, three, wxyz};
use super::{identifier, percent};
use crate::screw::JointKind;
use crate::twin::Twin;

/// The model. Angles are radians.
pub(super) fn document(name: &str, twin: &Twin, native: &Native, scene: &Scene) -> String {
    let joint_kind = match scene.kind {
        JointKind::Revolute => "hinge",
        JointKind::Prismatic => "slide",
    };
    let [low, high] = scene.range;
    let [k1, k2, k3] = native.stiffness;
    let [d1, d2, d3] = native.damping;
    let [i1, i2, i3] = scene.inertia;
    let [width, height, thickness] = scene.panel_size.map(|size| 0.5 * size);
    format!(
        r#"<!-- {name}: measured joint, frame `{frame}`, written by {version}. The joint's own attributes are
     {error}; {name}_passive.py adds what they lack. Stiffness and damping are polynomials of degree 3: MuJoCo 3.12 or later. -->
<mujoco model="{name}">
  <compiler angle="radian"/>
  <option timestep="0.0005" integrator="implicitfast"/>
  <worldbody>
    <light pos="0 0 3"/>
    <body name="{name}" pos="{origin}" gravcomp="1">
      <inertial pos="0 0 0" quat="{turn}" mass="{mass}" diaginertia="{i1} {i2} {i3}"/>
      <joint name="{name}_joint" type="{joint_kind}" pos="0 0 0" axis="{axis}" limited="true" range="{low} {high}" armature="0"
             stiffness="{k1} {k2} {k3}" springref="{reference}" damping="{d1} {d2} {d3}" frictionloss="{friction}"/>
      <geom name="{name}_panel" type="box" pos="{centre}" quat="{panel}" size="{width} {height} {thickness}" mass="0" rgba="0.72 0.58 0.42 1"/>
      <geom name="{name}_handle" type="sphere" pos="{handle}" size="0.03" mass="0" rgba="0.3 0.3 0.3 1"/>
    </body>
  </worldbody>
</mujoco>
"#,
        frame = identifier(&twin.joint.frame),
        version = twin.provenance.version,
        error = percent(twin, native),
        origin = three(&scene.origin.coords),
        turn = wxyz(&scene.x_to_axis),
        mass = scene.mass,
        axis = three(&scene.axis),
        reference = native.reference,
        friction = native.friction,
        centre = three(&scene.panel_centre),
        panel = wxyz(&scene.panel_rotation),
        handle = three(&scene.handle),
    )
}

/// A module that adds the rest of the twin's effort to the passive forces of a model.
pub(super) fn callback(name: &str) -> String {
    format!(
        r#""""What MuJoCo's joint attributes lack of the measured joint `{name}`, as a passive force.

    import mujoco, {name}_passive
    model = mujoco.MjModel.from_xml_path("{name}.xml")
    {name}_passive.install(model)
"""
import json
import pathlib

import mujoco
import numpy as np


class Table:
    """Effort (N m or N) without inertia over coordinate, speed and direction, and what of it the joint's attributes hold; q and dq may
    be arrays. Faster than the table it goes on straight, outside the range of q it is held."""

    def __init__(self, path):
        read = json.loads(pathlib.Path(path).read_text())
        self.low, self.high = read["q"]
        self.speed = read["speed"]
        along, speeds = read["nodes"]
        self.efforts = np.array(read["efforts"]).reshape(2, along, speeds)
        self.held = read["native"]

    def __call__(self, q, dq):
        _, along, speeds = self.efforts.shape
        at_q = np.clip((np.asarray(q) - self.low) / (self.high - self.low), 0.0, 1.0) * (along - 1)
        at_speed = np.abs(dq) / self.speed * (speeds - 1) ** 2  # nodes at the squares of whole numbers
        i, j = (np.minimum(at.astype(int), n - 2) for at, n in ((at_q, along), (np.sqrt(at_speed), speeds)))
        u, v = at_q - i, (at_speed - j * j) / (2 * j + 1)

        def one(way):
            e = self.efforts[way]
            return (1 - u) * ((1 - v) * e[i, j] + v * e[i, j + 1]) + u * ((1 - v) * e[i + 1, j] + v * e[i + 1, j + 1])

        return np.where(np.asarray(dq) > 0, one(0), np.where(np.asarray(dq) < 0, one(1), 0.5 * (one(0) + one(1))))

    def native(self, q, dq):
        """Effort that the joint's own stiffness, damping and friction have."""
        x, v = np.asarray(q) - self.held["reference"], np.abs(dq)
        spring = sum(k * x ** (n + 1) for n, k in enumerate(self.held["stiffness"]))
        damper = sum(k * v ** (n + 1) for n, k in enumerate(self.held["damping"]))
        return spring + np.sign(dq) * (damper + self.held["friction"])


_installed = mujoco.__dict__.setdefault("_passive_tables", [])


def _passive(m, d):
    for model, table, q, v in _installed:
        if m is model:
            d.qfrc_passive[v] -= table(d.qpos[q], d.qvel[v]) - table.native(d.qpos[q], d.qvel[v])


def install(model, joint="{name}_joint", table=None):
    """Adds the effort at every step of every simulation of `model`, and of no other model.

    Load every model before the first call: MuJoCo cannot compile a model while a Python callback is set. It has one callback
    for all models; several twins may be installed, one after the other; a passive callback of your own
    must call this one (`mujoco.get_mjcb_passive()`). Once more for the same joint takes the place of the first time.
    """
    table = table or Table(pathlib.Path(__file__).with_name("{name}.xml.mechanism.json"))
    at = model.joint(joint)
    _installed[:] = [one for one in _installed if one[0] is not model or one[3] != at.dofadr[0]]
    _installed.append((model, table, at.qposadr[0], at.dofadr[0]))
    mujoco.set_mjcb_passive(_passive)
"#
    )
}
