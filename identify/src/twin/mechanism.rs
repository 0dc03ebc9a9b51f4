//! The mechanism as a twin's file has it: B-splines on uniform knots.

use serde::{Deserialize, Serialize};

use crate::mechanism::{Mechanism as _, SplineMechanism, Valve};
use crate::spline::Basis;

/// A mechanism as B-splines on uniform knots, in the recording's coordinate.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TwinMechanism {
    /// `spline`.
    pub kind: String,
    /// g(q).
    pub load: Spline,
    /// c(q, |dq|) for dq >= 0 and for dq < 0, cut into the same pieces.
    pub damping: [SurfaceSpline; 2],
}

/// Uniform B-splines.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Spline {
    /// Interval; outside, the end value holds.
    pub interval: [f64; 2],
    /// Number of pieces.
    pub pieces: usize,
    /// Degree, at most 3.
    pub degree: usize,
    /// One coefficient per function.
    pub coefficients: Vec<f64>,
}

/// A tensor product of uniform B-splines; coefficient index = i_q * functions of speed + i_speed.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SurfaceSpline {
    /// Interval of q.
    pub interval_q: [f64; 2],
    /// Interval of sqrt(|dq|).
    pub interval_sqrt_speed: [f64; 2],
    /// Pieces over q and over sqrt(|dq|).
    pub pieces: [usize; 2],
    /// Degrees over q, at most 2, and over sqrt(|dq|), at most 1.
    pub degree: [usize; 2],
    /// Coefficients.
    pub coefficients: Vec<f64>,
    /// What becomes of `c |dq|`: place and slope of each bend of a piecewise straight line from 0, at first of slope 1.
    #[serde(default, skip_serializing_if = "Valve::is_straight")]
    pub valve: Valve,
}

impl TwinMechanism {
    pub(super) fn of(mechanism: &SplineMechanism) -> Self {
        let pair = |basis: &Basis| {
            let (low, high) = basis.interval();
            [low, high]
        };
        let load = mechanism.load_basis();
        let (in_q, in_speed) = mechanism.damping_bases();
        let surface = |coefficients: &Vec<f64>, valve: &Valve| SurfaceSpline {
            interval_q: pair(in_q),
            interval_sqrt_speed: pair(in_speed),
            pieces: [in_q.intervals(), in_speed.intervals()],
            degree: [in_q.degree(), in_speed.degree()],
            coefficients: coefficients.clone(),
            valve: valve.clone(),
        };
        let [opening, closing] = &mechanism.damping_coefficients;
        Self {
            kind: mechanism.kind().to_owned(),
            load: Spline {
                interval: pair(load),
                pieces: load.intervals(),
                degree: load.degree(),
                coefficients: mechanism.load_coefficients.clone(),
            },
            damping: [
                surface(opening, &mechanism.valves[0]),
                surface(closing, &mechanism.valves[1]),
            ],
        }
    }
}
