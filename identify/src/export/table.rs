//! What is left of a twin beyond a simulator's own attributes, as a table over coordinate, speed and direction.

use serde::Serialize;

use super::native::{Native, off};
use crate::screw::JointKind;
use crate::twin::{Evaluator, Twin};

/// Nodes over the coordinate.
const ALONG: usize = 241;
/// Nodes over the root of the speed.
const SPEEDS: usize = 65;

/// Highest speed of the table over the fastest probed.
const BEYOND: f64 = 2.0;

/// Effort over (direction, q, sqrt|dq|): bilinear between the nodes, held at its edges outside.
#[derive(Clone, Debug, PartialEq)]
pub struct Table {
    /// First and last coordinate, rad or m.
    pub q: [f64; 2],
    /// Highest speed, rad/s or m/s.
    pub speed: f64,
    /// Nodes over q and over sqrt(speed).
    pub nodes: [usize; 2],
    /// Efforts, N m or N; index = (direction * nodes over q + i_q) * nodes over speed + i_speed, direction 0 for dq >= 0.
    pub efforts: Vec<f64>,
}

/// The table as it lies beside an exported file.
#[derive(Clone, Debug, Serialize)]
pub(super) struct Sidecar<'a> {
    schema: &'static str,
    kind: JointKind,
    /// What the simulator's own attributes hold already.
    native: &'a Native,
    q: [f64; 2],
    speed: f64,
    nodes: [usize; 2],
    /// Rounded to seven digits.
    efforts: Vec<f32>,
    twin: &'a Twin,
}

impl Table {
    /// What `twin` has beyond its inertia and `native`.
    #[must_use]
    pub fn of(twin: &Evaluator, native: &Native) -> Self {
        let domain = twin.domain();
        // Beyond what was probed too, so that a simulator meets no edge; there it means as little as the twin does.
        let speed = BEYOND * twin.fastest();
        let [low, high] = domain.q;
        let mut efforts = Vec::with_capacity(2 * ALONG * SPEEDS);
        for direction in [1.0, -1.0] {
            for i in 0..ALONG {
                let q = low + (high - low) * i as f64 / (ALONG - 1) as f64;
                for j in 0..SPEEDS {
                    let share = (j as f64 / (SPEEDS - 1) as f64).powi(2).max(1e-12);
                    let dq = direction * share * speed;
                    efforts.push(twin.effort(q, dq, 0.0) - native.effort(q, dq));
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
        let place = |share: f64, nodes: usize| {
            let at = (share * (nodes - 1) as f64).clamp(0.0, (nodes - 1) as f64);
            let first = (at as usize).min(nodes - 2);
            (first, at - first as f64)
        };
        let (i, u) = place((q - self.q[0]) / (self.q[1] - self.q[0]), along);
        let (j, v) = place((speed / self.speed).sqrt(), speeds);
        let at = |i: usize, j: usize| self.efforts[(direction * along + i) * speeds + j];
        (1.0 - u) * ((1.0 - v) * at(i, j) + v * at(i, j + 1))
            + u * ((1.0 - v) * at(i + 1, j) + v * at(i + 1, j + 1))
    }

    /// Root mean square difference between the twin and `native` with this table, over the effort's own.
    #[must_use]
    pub fn error(&self, twin: &Evaluator, native: &Native) -> f64 {
        off(twin, |q, dq| native.effort(q, dq) + self.effort(q, dq))
    }

    pub(super) fn sidecar<'a>(&self, twin: &'a Twin, native: &'a Native) -> Sidecar<'a> {
        Sidecar {
            schema: "ft-identify/mechanism-table/1",
            kind: twin.joint.kind,
            native,
            q: self.q,
            speed: self.speed,
            nodes: self.nodes,
            efforts: self.efforts.iter().map(|effort| *effort as f32).collect(),
            twin,
        }
    }
}
