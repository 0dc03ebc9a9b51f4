//! Directions of the geometry parameters, and the derivatives of the predicted poses.

use nalgebra::{UnitQuaternion, Vector3};

use super::{GEOMETRY, State};
use crate::screw::{JointKind, perpendiculars};

/// Directions of the geometry parameters at the current estimate.
pub(super) struct Frame {
    pub(super) first: Vector3<f64>,
    pub(super) second: Vector3<f64>,
    pub(super) grasp: [Vector3<f64>; 2],
    /// Of the grasp's rotation. The last of a revolute joint is about the axis, where nothing is seen: it is held.
    pub(super) turns: [Vector3<f64>; 3],
}

impl Frame {
    pub(super) fn new(state: &State) -> Self {
        let (first, second) = perpendiculars(&state.axis.direction);
        let direction = state.axis.direction.into_inner();
        let grasp = match state.axis.kind {
            JointKind::Prismatic => [first, second],
            JointKind::Revolute => {
                let arm = state.p0 - state.axis.point;
                [
                    (arm - direction * direction.dot(&arm)).normalize(),
                    direction,
                ]
            }
        };
        Self {
            first,
            second,
            grasp,
            turns: [first, second, direction],
        }
    }

    /// At `q`; `turn` = rotation of the joint's motion there.
    pub(super) fn jacobians(&self, state: &State, q: f64, turn: &UnitQuaternion<f64>) -> Jacobians {
        let zero = Vector3::zeros();
        let mut position = [zero; GEOMETRY];
        let mut rotation = [zero; GEOMETRY];
        let direction = state.axis.direction.into_inner();
        let turn = turn.to_rotation_matrix();
        let along = match state.axis.kind {
            JointKind::Prismatic => {
                position[0] = self.first.cross(&direction) * q;
                position[1] = self.second.cross(&direction) * q;
                direction
            }
            JointKind::Revolute => {
                let arm = state.p0 - state.axis.point;
                let turned = turn * arm;
                for (k, e) in [self.first, self.second].into_iter().enumerate() {
                    position[k] = e.cross(&turned) - turn * e.cross(&arm);
                    rotation[k] = e - turn * e;
                    position[2 + k] = e - turn * e;
                }
                direction.cross(&turned)
            }
        };
        for k in 0..2 {
            position[4 + k] = turn * self.grasp[k];
        }
        for (k, e) in self.turns.into_iter().enumerate() {
            rotation[6 + k] = turn * e;
        }
        Jacobians {
            along,
            geometry: [position, rotation],
        }
    }
}

/// Derivatives of a predicted pose.
pub(super) struct Jacobians {
    /// Of the position by the joint coordinate.
    pub(super) along: Vector3<f64>,
    /// Of position and rotation (left perturbation) by the geometry, as columns.
    pub(super) geometry: [[Vector3<f64>; GEOMETRY]; 2],
}
