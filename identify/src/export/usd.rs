//! USD text: UsdPhysics joint, mass and drive, and the friction attributes of PhysX, Newton and MuJoCo.
//!
//! UsdPhysics measures angles in degrees, so an angular drive's stiffness and damping are per degree, and so are PhysX's
//! viscous friction and Newton's damping. PhysX reads its joint friction only inside an articulation.

use nalgebra::UnitQuaternion;

use super::native::Native;
use super::scene::Scene;
use super::{identifier, percent};
use crate::screw::JointKind;
use crate::twin::Twin;

/// The stage. The default prim is the articulation, in the twin's frame.
pub(super) fn document(name: &str, twin: &Twin, native: &Native, scene: &Scene) -> String {
    let (joint, drive) = match scene.kind {
        JointKind::Revolute => ("PhysicsRevoluteJoint", "angular"),
        JointKind::Prismatic => ("PhysicsPrismaticJoint", "linear"),
    };
    // Stored numbers per degree for an angle, per metre for a way.
    let per = |value: f64| match scene.kind {
        JointKind::Revolute => value.to_radians(),
        JointKind::Prismatic => value,
    };
    let stored = |value: f64| match scene.kind {
        JointKind::Revolute => value.to_degrees(),
        JointKind::Prismatic => value,
    };
    let [low, high] = scene.range.map(stored);
    let [i1, i2, i3] = scene.inertia;
    let [width, height, thickness] = scene.panel_size;
    let o = scene.origin;
    format!(
        r#"#usda 1.0
(
    defaultPrim = "{name}"
    doc = """Measured joint, frame `{frame}`, written by {version}. Drive and friction are {error}; {name}.usda.mechanism.json holds the whole effort."""
    metersPerUnit = 1
    kilogramsPerUnit = 1
    upAxis = "Z"
)

def Xform "{name}" (
    prepend apiSchemas = ["PhysicsArticulationRootAPI"]
)
{{
    def Xform "base" (
        prepend apiSchemas = ["PhysicsRigidBodyAPI", "PhysicsMassAPI"]
    )
    {{
        float physics:mass = 1
        float3 physics:diagonalInertia = (1, 1, 1)
        quatf physics:principalAxes = (1, 0, 0, 0)
    }}

    def PhysicsFixedJoint "to_{frame}"
    {{
        rel physics:body0 = </{name}>
        rel physics:body1 = </{name}/base>
    }}

    def Xform "part" (
        prepend apiSchemas = ["PhysicsRigidBodyAPI", "PhysicsMassAPI", "PhysxRigidBodyAPI"]
    )
    {{
        float physics:mass = {mass}
        point3f physics:centerOfMass = (0, 0, 0)
        float3 physics:diagonalInertia = ({i1}, {i2}, {i3})
        quatf physics:principalAxes = {turn}
        bool physxRigidBody:disableGravity = 1
        double3 xformOp:translate = ({ox}, {oy}, {oz})
        uniform token[] xformOpOrder = ["xformOp:translate"]

        def Cube "panel" (
            prepend apiSchemas = ["PhysicsCollisionAPI"]
        )
        {{
            double size = 1
            float3[] extent = [(-0.5, -0.5, -0.5), (0.5, 0.5, 0.5)]
            double3 xformOp:translate = ({cx}, {cy}, {cz})
            quatf xformOp:orient = {panel}
            float3 xformOp:scale = ({width}, {height}, {thickness})
            uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:orient", "xformOp:scale"]
        }}

        def Sphere "handle"
        {{
            double radius = 0.03
            float3[] extent = [(-0.03, -0.03, -0.03), (0.03, 0.03, 0.03)]
            double3 xformOp:translate = ({hx}, {hy}, {hz})
            uniform token[] xformOpOrder = ["xformOp:translate"]
        }}
    }}

    def {joint} "joint" (
        prepend apiSchemas = ["PhysicsDriveAPI:{drive}", "PhysxJointAxisAPI:{drive}", "MjcJointAPI"]
    )
    {{
        rel physics:body0 = </{name}/base>
        rel physics:body1 = </{name}/part>
        uniform token physics:axis = "X"
        point3f physics:localPos0 = ({ox}, {oy}, {oz})
        point3f physics:localPos1 = (0, 0, 0)
        quatf physics:localRot0 = {turn}
        quatf physics:localRot1 = {turn}
        float physics:lowerLimit = {low}
        float physics:upperLimit = {high}
        uniform token drive:{drive}:physics:type = "force"
        float drive:{drive}:physics:stiffness = {stiffness}
        float drive:{drive}:physics:damping = {damping}
        float drive:{drive}:physics:targetPosition = {target}
        float physxJointAxis:{drive}:staticFrictionEffort = {friction}
        float physxJointAxis:{drive}:dynamicFrictionEffort = {friction}
        float physxJointAxis:{drive}:viscousFrictionCoefficient = 0
        float newton:friction = {friction}
        float newton:damping = 0
        double mjc:frictionloss = {friction}
    }}
}}
"#,
        frame = identifier(&twin.joint.frame),
        version = twin.provenance.version,
        error = percent(twin, native),
        mass = scene.mass,
        turn = quat(&scene.x_to_axis),
        panel = quat(&scene.panel_rotation),
        ox = o.x,
        oy = o.y,
        oz = o.z,
        cx = scene.panel_centre.x,
        cy = scene.panel_centre.y,
        cz = scene.panel_centre.z,
        hx = scene.handle.x,
        hy = scene.handle.y,
        hz = scene.handle.z,
        stiffness = per(native.stiffness[0]),
        damping = per(native.damping[0]),
        target = stored(native.reference),
        friction = native.friction,
    )
}

fn quat(q: &UnitQuaternion<f64>) -> String {
    format!("({}, {}, {}, {})", q.w, q.i, q.j, q.k)
}
