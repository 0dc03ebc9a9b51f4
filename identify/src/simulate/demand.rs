//! What a motion asks of whoever moves the joint: a feed-forward before the attempt, and whether a robot can.

use crate::twin::Evaluator;

/// A motion from rest to rest with the least jerk (quintic in time; Flash and Hogan, 1985).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Opening {
    /// Where it begins, rad or m.
    pub from: f64,
    /// Where it ends.
    pub to: f64,
    /// Time that it takes, s.
    pub duration: f64,
}

/// What an [`Opening`] needs.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct Demand {
    /// Time, s; a thousand equal steps.
    pub time: Vec<f64>,
    /// Coordinate, rad or m.
    pub q: Vec<f64>,
    /// Velocity, rad/s or m/s.
    pub dq: Vec<f64>,
    /// Effort, N m or N.
    pub effort: Vec<f64>,
    /// Largest effort against or with the motion, N m or N.
    pub peak: f64,
    /// Where, rad or m.
    pub peak_at: f64,
    /// Share of the time at states that were not probed.
    pub not_probed: f64,
}

const STEPS: usize = 1000;

impl Opening {
    /// Coordinate, velocity and acceleration at `time`.
    #[must_use]
    pub fn at(&self, time: f64) -> [f64; 3] {
        let s = (time / self.duration).clamp(0.0, 1.0);
        let way = self.to - self.from;
        [
            self.from + way * s * s * s * (10.0 + s * (6.0 * s - 15.0)),
            way / self.duration * 30.0 * s * s * (1.0 - s) * (1.0 - s),
            way / self.duration.powi(2) * 60.0 * s * (1.0 - s) * (1.0 - 2.0 * s),
        ]
    }
}

/// Effort of a twin over an opening. At its two ends, where the joint rests, dry friction counts as in the motion.
#[must_use]
pub fn demand(twin: &Evaluator, opening: &Opening) -> Demand {
    let direction = (opening.to - opening.from).signum();
    let mut out = Demand {
        time: Vec::with_capacity(STEPS + 1),
        q: Vec::with_capacity(STEPS + 1),
        dq: Vec::with_capacity(STEPS + 1),
        effort: Vec::with_capacity(STEPS + 1),
        peak: 0.0,
        peak_at: opening.from,
        not_probed: 0.0,
    };
    let mut outside = 0_usize;
    for k in 0..=STEPS {
        let time = opening.duration * k as f64 / STEPS as f64;
        let [q, dq, ddq] = opening.at(time);
        let effort = twin.effort(q, direction * dq.abs().max(1e-9), ddq);
        if effort.abs() > out.peak.abs() {
            (out.peak, out.peak_at) = (effort, q);
        }
        outside += usize::from(twin.outside(q, dq).is_some());
        out.time.push(time);
        out.q.push(q);
        out.dq.push(dq);
        out.effort.push(effort);
    }
    out.not_probed = outside as f64 / (STEPS + 1) as f64;
    out
}

/// No opening takes longer than this, s: what is too much then is too much however slowly.
const SLOWEST: f64 = 600.0;

/// The shortest time, from the opening's own on, s, within which `limit` (N m or N) is enough all the way; nothing when it never is.
///
/// The time is found to a thousandth, supposing that a slower opening needs no more: so it is with inertia and damping.
#[must_use]
pub fn shortest(twin: &Evaluator, opening: &Opening, limit: f64) -> Option<f64> {
    let enough = |duration: f64| {
        let slower = Opening {
            duration,
            ..*opening
        };
        demand(twin, &slower).exceeds(limit).is_none()
    };
    if enough(opening.duration) {
        return Some(opening.duration);
    }
    let (mut short, mut long) = (opening.duration, SLOWEST);
    if long <= short || !enough(long) {
        return None;
    }
    while long > 1.001 * short {
        let middle = (short * long).sqrt();
        if enough(middle) {
            long = middle;
        } else {
            short = middle;
        }
    }
    Some(long)
}

impl Demand {
    /// Where more than `limit` (N m or N) is needed first; nothing when it is never.
    #[must_use]
    pub fn exceeds(&self, limit: f64) -> Option<f64> {
        let at = self.effort.iter().position(|effort| effort.abs() > limit)?;
        self.q.get(at).copied()
    }
}
