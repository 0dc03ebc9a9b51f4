//! URDF: a link on one joint, with damping and dry friction.

use nalgebra::UnitQuaternion;

use super::native::Native;
use super::scene::{Scene, three};
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
    let fastest = twin
        .domain
        .dq
        .iter()
        .fold(0.0_f64, |all, v| all.max(v.abs()));
    format!(
        r#"<?xml version="1.0"?>
<!-- {name}: measured joint, frame `{frame}`, written by {version}. URDF has damping and friction only: they are {error:.1} % (root mean square, over
     the probed domain) from the twin; {name}.urdf.mechanism.json holds the rest. Gravity is in that table, not in the link. -->
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
</robot>
"#,
        frame = twin.joint.frame,
        version = twin.provenance.version,
        error = 100.0 * native.relative_error,
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
