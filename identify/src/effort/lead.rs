//! What the joint does while the fingers close on it.

use core::iter;

use nalgebra::Point3;

use crate::grasp::Grasp;
use crate::screw::{JointKind, ScrewAxis, angles};
use crate::tool::ToolSamples;

/// A tool so near to the joint's path moves the object, m.
const ON_PATH_M: f64 = 3e-3;

/// The coordinate while the fingers close, from its value at the first held sample: as far back as the tool is on the joint's path and `touches` something
/// (to a drawer's handle the hand comes on that path, too). A hand that moves at once has begun its first stroke there.
pub(super) fn lead(
    tool: &ToolSamples,
    grasp: &Grasp,
    axis: &ScrewAxis,
    touches: impl Fn(usize) -> bool,
) -> Vec<f64> {
    let next = grasp.held.first().map_or(0, |run| run.start);
    // The sample at the very end of it may be the first held one, too.
    let closing = grasp.closing.start.min(next)..grasp.closing.end.min(next);
    if closing.is_empty() || closing.end != next {
        return Vec::new();
    }
    let first = tool.position[next];
    let direction = axis.direction.into_inner();
    let along = |p: &Point3<f64>| direction.dot(&(p - first));
    let off_path = |p: &Point3<f64>| match axis.kind {
        JointKind::Prismatic => (p - first - direction * along(p)).norm(),
        JointKind::Revolute => along(p).hypot(axis.distance(p) - axis.distance(&first)),
    };
    let back = closing.rev();
    let back = back.take_while(|i| off_path(&tool.position[*i]) < ON_PATH_M && touches(*i));
    let path = &tool.position[next - back.count()..next];
    match axis.kind {
        JointKind::Prismatic => path.iter().map(along).collect(),
        JointKind::Revolute => {
            let back: Vec<Point3<f64>> = iter::once(first)
                .chain(path.iter().rev().copied())
                .collect();
            let mut lead = angles(&back, axis).split_off(1);
            lead.reverse();
            lead
        }
    }
}
