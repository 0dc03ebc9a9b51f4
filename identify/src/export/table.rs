//! The effort of a twin without its inertia, as a table over coordinate, speed and direction.

use serde::Serialize;

use super::native::{Native, off};
use crate::screw::JointKind;
use crate::twin::{BEYOND, Evaluator, Twin};

/// Nodes over the coordinate.
const ALONG: usize = 241;
/// Nodes over the root of the speed.
const SPEEDS: usize = 65;

/// Effort over (direction, q, |dq|), bilinear between nodes that are even in q and in sqrt|dq|. Faster than the last node it goes on
/// straight, as the twin does (whose damping is then that at the edge); outside the range of q it is held.
#[derive(Clone, Debug, PartialEq)]
pub struct Table {
    /// First and last coordinate, rad or m.
    pub q: [f64; 2],
    /// Speed of the last node, rad/s or m/s.
    pub speed: f64,
    /// Nodes over q and over sqrt(speed).
    pub nodes: [usize; 2],
    /// Efforts, N m or N; index = (direction * nodes over q + i_q) * nodes over speed + i_speed, direction 0 for dq >= 0.
    pub efforts: Vec<f64>,
}

/// The table as it lies beside an exported file. What the file's own attributes lack is the table less them.
#[derive(Clone, Debug, Serialize)]
pub(super) struct Sidecar<'a> {
    schema: &'static str,
    kind: JointKind,
    /// What the simulator's own attributes hold already.
    native: &'a Native,
    /// Root mean square difference between twin and table over the probed domain, over the effort's own.
    relative_error: f64,
    /// Effects with a memory, which neither holds.
    left_out: Vec<&'a str>,
    /// Parameters that nobody knows, which count as 0.
    not_identified: Vec<&'a str>,
    q: [f64; 2],
    speed: f64,
    nodes: [usize; 2],
    /// Rounded to seven digits.
    efforts: Vec<f32>,
    twin: &'a Twin,
}

impl Table {
    /// Of a twin, over its range and all that was probed.
    #[must_use]
    pub fn of(twin: &Evaluator) -> Self {
        let ([low, high], [first, last]) = (twin.domain().q, twin.range());
        let (low, high) = (low.min(first), high.max(last));
        // Beyond what was probed too, so that no bend of a valve or drag is cut off; there it means as little as the twin does.
        let speed = BEYOND * twin.fastest();
        let mut efforts = Vec::with_capacity(2 * ALONG * SPEEDS);
        for direction in [1.0, -1.0] {
            for i in 0..ALONG {
                let q = low + (high - low) * i as f64 / (ALONG - 1) as f64;
                for j in 0..SPEEDS {
                    let share = (j as f64 / (SPEEDS - 1) as f64).powi(2).max(1e-12);
                    efforts.push(twin.effort(q, direction * share * speed, 0.0));
                }
            }
        }
        Self {
            q: [low, high],
            speed,
            nodes: [ALONG, SPEEDS],
            efforts,
        }
    }

    /// The table at a state; at rest the middle of both directions.
    #[must_use]
    pub fn effort(&self, q: f64, dq: f64) -> f64 {
        if dq == 0.0 {
            return 0.5 * (self.in_direction(q, 0.0, 0) + self.in_direction(q, 0.0, 1));
        }
        self.in_direction(q, dq.abs(), usize::from(dq < 0.0))
    }

    fn in_direction(&self, q: f64, speed: f64, direction: usize) -> f64 {
        let [along, speeds] = self.nodes;
        let last = (along - 1) as f64;
        let at_q = ((q - self.q[0]) / (self.q[1] - self.q[0]) * last).clamp(0.0, last);
        let i = (at_q as usize).min(along - 2);
        let u = at_q - i as f64;
        // Nodes lie at the squares of whole numbers; straight in the speed itself between them, and after the last.
        let at_speed = speed / self.speed * ((speeds - 1) as f64).powi(2);
        let j = (at_speed.sqrt() as usize).min(speeds - 2);
        let v = (at_speed - (j * j) as f64) / (2 * j + 1) as f64;
        let at = |i: usize, j: usize| self.efforts[(direction * along + i) * speeds + j];
        (1.0 - u) * ((1.0 - v) * at(i, j) + v * at(i, j + 1))
            + u * ((1.0 - v) * at(i + 1, j) + v * at(i + 1, j + 1))
    }

    /// Root mean square difference from the twin, over the effort's own.
    #[must_use]
    pub fn error(&self, twin: &Evaluator) -> f64 {
        off(twin, |q, dq| self.effort(q, dq))
    }

    pub(super) fn sidecar<'a>(
        &self,
        twin: &'a Twin,
        native: &'a Native,
        error: f64,
    ) -> Sidecar<'a> {
        Sidecar {
            schema: "ft-identify/mechanism-table/2",
            kind: twin.joint.kind,
            native,
            relative_error: error,
            left_out: twin.left_out().collect(),
            not_identified: twin.not_identified().collect(),
            q: self.q,
            speed: self.speed,
            nodes: self.nodes,
            efforts: self.efforts.iter().map(|effort| *effort as f32).collect(),
            twin,
        }
    }
}
