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

    /// Derivatives of predicted position and rotation (left perturbation) by [q, geometry...], as columns; `turn` = rotation of
    /// the joint's motion at `q`.
    pub(super) fn jacobians(
        &self,
        state: &State,
        q: f64,
        turn: &UnitQuaternion<f64>,
    ) -> [[Vector3<f64>; GEOMETRY + 1]; 2] {
        let zero = Vector3::zeros();
        let mut position = [zero; GEOMETRY + 1];
        let mut rotation = [zero; GEOMETRY + 1];
        let direction = state.axis.direction.into_inner();
        let turn = turn.to_rotation_matrix();
        match state.axis.kind {
            JointKind::Prismatic => {
                position[0] = direction;
                position[1] = self.first.cross(&direction) * q;
                position[2] = self.second.cross(&direction) * q;
            }
            JointKind::Revolute => {
                let arm = state.p0 - state.axis.point;
                let turned = turn * arm;
                position[0] = direction.cross(&turned);
                rotation[0] = direction;
                for (k, e) in [self.first, self.second].into_iter().enumerate() {
                    position[1 + k] = e.cross(&turned) - turn * e.cross(&arm);
                    rotation[1 + k] = e - turn * e;
                    position[3 + k] = e - turn * e;
                }
            }
        }
        for k in 0..2 {
            position[5 + k] = turn * self.grasp[k];
        }
        for (k, e) in self.turns.into_iter().enumerate() {
            rotation[7 + k] = turn * e;
        }
        [position, rotation]
    }
}
