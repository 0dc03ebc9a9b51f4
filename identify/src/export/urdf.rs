//! URDF: a link on one joint, with damping and dry friction.

use nalgebra::UnitQuaternion;

use super::native::Native;
use super::scene::{Scene, three};
use super::{identifier, percent};
use crate::screw::JointKind;
use crate::twin::Twin;

/// The robot. The base link is the twin's frame.
pub(super) fn document(name: &str, twin: &Twin, native: &Native, scene: &Scene) -> String {
    let kind = match scene.kind {
        JointKind::Revolute => "revolute",
        JointKind::Prismatic => "prismatic",
    };
    let [low, high] = scene.range;
    let [i1, i2, i3] = scene.inertia;
    let [width, height, thickness] = scene.panel_size;
    // A limit that no simulator should meet: what was probed is no limit of the joint.
    let fastest = 10.0 * twin.evaluator().fastest();
    format!(
        r#"<?xml version="1.0"?>
<!-- {name}: measured joint, frame `{frame}`, written by {version}. URDF has damping and friction only: they are
     {error}; {name}.urdf.mechanism.json holds the whole effort. Gravity is in that effort: the link must not feel
     it (a turning link has its mass on the axis; for a sliding one switch gravity off, as the gazebo element does). -->
<robot name="{name}">
  <link name="{frame}"/>
  <joint name="{name}_joint" type="{kind}">
    <parent link="{frame}"/>
    <child link="{name}"/>
    <origin xyz="{origin}" rpy="0 0 0"/>
    <axis xyz="{axis}"/>
    <limit lower="{low}" upper="{high}" effort="1000" velocity="{fastest}"/>
    <dynamics damping="{damping}" friction="{friction}"/>
  </joint>
  <link name="{name}">
    <inertial>
      <origin xyz="0 0 0" rpy="{turn}"/>
      <mass value="{mass}"/>
      <inertia ixx="{i1}" ixy="0" ixz="0" iyy="{i2}" iyz="0" izz="{i3}"/>
    </inertial>
    <visual>
      <origin xyz="{centre}" rpy="{panel}"/>
      <geometry><box size="{width} {height} {thickness}"/></geometry>
    </visual>
    <visual>
      <origin xyz="{handle}" rpy="0 0 0"/>
      <geometry><sphere radius="0.03"/></geometry>
    </visual>
    <collision>
      <origin xyz="{centre}" rpy="{panel}"/>
      <geometry><box size="{width} {height} {thickness}"/></geometry>
    </collision>
  </link>
  <gazebo reference="{name}"><gravity>false</gravity></gazebo>
</robot>
"#,
        frame = identifier(&twin.joint.frame),
        version = twin.provenance.version,
        error = percent(twin, native),
        origin = three(&scene.origin.coords),
        axis = three(&scene.axis),
        damping = native.damping[0],
        friction = native.friction,
        turn = rpy(&scene.x_to_axis),
        mass = scene.mass,
        centre = three(&scene.panel_centre),
        panel = rpy(&scene.panel_rotation),
        handle = three(&scene.handle),
    )
}

fn rpy(rotation: &UnitQuaternion<f64>) -> String {
    let (roll, pitch, yaw) = rotation.euler_angles();
    format!("{roll} {pitch} {yaw}")
}
