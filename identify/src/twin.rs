//! `twin.json` (schema `ft-identify/twin/1`): the identified joint for controllers and simulators.
//!
//! The effort at a state is `I ddq + mu sgn(dq) + b dq`, the added effects, and `g(q) + c(q, |dq|) dq`, in the joint coordinate of the recording.
//! [`Twin::in_frame`] and [`Twin::in_coordinate`] re-express it (the paper's twin assembly) without changing the effort.

mod batch;
mod check;
mod evaluator;
mod pieces;

pub use batch::{Each, LengthError};
pub(crate) use evaluator::BEYOND;
pub use evaluator::{Evaluator, Outside, Terms};
use nalgebra::{Isometry3, Point3, Unit, Vector3};
use serde::{Deserialize, Serialize};

use crate::dynamics::EffortModel;
use crate::mechanism::{Domain, Mechanism, SplineMechanism, Valve};
use crate::report::effects::TwinEffect;
use crate::screw::{JointKind, ScrewAxis};
use crate::spline::Basis;

/// Name of the schema.
pub const SCHEMA: &str = "ft-identify/twin/1";

/// Why a file is no twin.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum TwinError {
    /// No JSON of a twin's form.
    #[error("not a twin: {0}; give the twin.json that ft-identify wrote")]
    Json(serde_json::Error),
    /// Another schema.
    #[error("schema is `{found}`, this program reads `{SCHEMA}`")]
    Schema {
        /// The file's.
        found: String,
    },
    /// A number that no joint has.
    #[error("not a twin: the number {number} is beyond anything that a joint has, in SI units")]
    Large {
        /// The number.
        number: String,
    },
    /// An effect that this program cannot evaluate.
    #[error(
        "the twin has an effect `{name}`, which this program does not know; use the program that wrote it, or a newer one"
    )]
    Effect {
        /// Its name.
        name: String,
    },
    /// Numbers that do not fit together.
    #[error("not a whole twin: {what}")]
    Content {
        /// What is wrong.
        what: &'static str,
    },
}

/// The identified joint.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Twin {
    schema: String,
    /// Frame, kind, axis, range.
    pub joint: TwinJoint,
    /// I, mu, b.
    pub beta: Beta,
    /// Added effects.
    pub effects: Vec<TwinEffect>,
    /// The mechanism, when it was fitted.
    pub mechanism: Option<TwinMechanism>,
    /// Where all this was probed.
    pub domain: Domain,
    /// Where it comes from.
    pub provenance: Provenance,
}

/// Frame, kind, axis, range.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TwinJoint {
    /// Frame of the axis.
    pub frame: String,
    /// Revolute or prismatic.
    pub kind: JointKind,
    /// Unit direction; nothing when only a table was seen.
    pub axis_direction: Option<[f64; 3]>,
    /// A point on the axis, m.
    pub axis_point: Option<[f64; 3]>,
    /// Where the tool held the part when the recording's coordinate was 0, m.
    #[serde(default)]
    pub tool_position: Option<[f64; 3]>,
    /// Probed range, rad or m.
    pub q_range: [f64; 2],
    /// The twin's coordinate is `sign * q + offset` of the recording's.
    pub coordinate: Coordinate,
}

/// `q_twin = sign * q_recording + offset`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Coordinate {
    /// 1 or -1.
    pub sign: f64,
    /// rad or m.
    pub offset: f64,
}

/// Parameters with their covariance.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Beta {
    /// Names, in the order of `values`.
    pub names: Vec<String>,
    /// Units.
    pub units: Vec<String>,
    /// Estimates; nothing where the data do not show it.
    pub values: Vec<Option<f64>>,
    /// Covariance of the estimates, row by row.
    pub covariance: Vec<Vec<f64>>,
}

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

/// Where a twin comes from.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Provenance {
    /// Input files with their SHA-256.
    pub recordings: Vec<Source>,
    /// Program and version.
    pub version: String,
    /// Where the tool's calibration came from.
    pub calibration: Option<String>,
    /// Held-out error of I, mu, b alone and of the full model.
    pub held_out_rms: Option<[f64; 2]>,
}

/// One input file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Source {
    /// File name.
    pub file: String,
    /// SHA-256, 64 hex digits.
    pub sha256: String,
}

impl Twin {
    /// A twin of a joint and its effort model; `axis` is nothing for a table, `speeds` are the smallest and largest
    /// velocity that the fit saw.
    #[must_use]
    pub fn new(
        kind: JointKind,
        axis: Option<&ScrewAxis>,
        q_range: [f64; 2],
        speeds: [f64; 2],
        model: &EffortModel,
        provenance: Provenance,
    ) -> Self {
        let rows = model.covariance.nrows();
        let domain = model.mechanism.as_ref().map_or(
            Domain {
                q: q_range,
                dq: speeds,
            },
            |m| m.domain.clone(),
        );
        Self {
            schema: SCHEMA.to_owned(),
            joint: TwinJoint {
                frame: "world".to_owned(),
                kind,
                axis_direction: axis.map(|axis| axis.direction.into_inner().into()),
                axis_point: axis.map(|axis| axis.point.coords.into()),
                tool_position: None,
                q_range,
                coordinate: Coordinate {
                    sign: 1.0,
                    offset: 0.0,
                },
            },
            beta: Beta {
                names: model.terms.iter().map(|term| term.name.clone()).collect(),
                units: model.terms.iter().map(|term| term.unit.clone()).collect(),
                values: model.terms.iter().map(|term| term.value).collect(),
                covariance: (0..rows)
                    .map(|i| model.covariance.row(i).iter().copied().collect())
                    .collect(),
            },
            effects: Vec::new(),
            mechanism: model.mechanism.as_ref().map(TwinMechanism::of),
            domain,
            provenance,
        }
    }

    /// The twin with the effects that an analysis named.
    #[must_use]
    pub fn with_effects(mut self, effects: Vec<TwinEffect>) -> Self {
        self.effects = effects;
        self
    }

    /// The twin with the place where the tool held the part at the recording's coordinate 0.
    #[must_use]
    pub fn held_at(mut self, tool_position: Point3<f64>) -> Self {
        self.joint.tool_position = Some(tool_position.coords.into());
        self
    }

    /// Where the tool holds the part at the twin's coordinate 0, m; nothing for a table.
    #[must_use]
    pub fn tool_at_zero(&self) -> Option<Point3<f64>> {
        let joint = &self.joint;
        let axis = self.axis()?;
        // From the twin's coordinate of the recording's 0 back to its own 0.
        Some(axis.motion(-joint.coordinate.offset) * Point3::from(joint.tool_position?))
    }

    /// Effects that an evaluation leaves out: those with memory, which are no function of the state.
    pub fn left_out(&self) -> impl Iterator<Item = &str> {
        let without = self.effects.iter().filter(|effect| !effect.memoryless);
        without.map(|effect| effect.name.as_str())
    }

    /// Parameters that the data did not show, which count as 0 in an evaluation.
    pub fn not_identified(&self) -> impl Iterator<Item = &str> {
        let all = self.beta.names.iter().zip(&self.beta.values);
        all.filter(|(_, value)| value.is_none())
            .map(|(name, _)| name.as_str())
    }

    /// Distance of the tool from the axis of a turning joint, m; nothing for a slide or a table.
    #[must_use]
    pub fn radius(&self) -> Option<f64> {
        let axis = self
            .axis()
            .filter(|axis| axis.kind == JointKind::Revolute)?;
        Some(axis.distance(&Point3::from(self.joint.tool_position?)))
    }

    fn axis(&self) -> Option<ScrewAxis> {
        Some(ScrewAxis {
            direction: Unit::new_normalize(Vector3::from(self.joint.axis_direction?)),
            point: Point3::from(self.joint.axis_point?),
            kind: self.joint.kind,
        })
    }

    /// The twin ready for evaluation.
    #[must_use]
    pub fn evaluator(&self) -> Evaluator {
        Evaluator::new(self)
    }

    /// The twin with its axis in frame `name`, `name_from_old` taking the old frame's coordinates there. The joint
    /// coordinate and the effort stay.
    #[must_use]
    pub fn in_frame(&self, name: &str, name_from_old: &Isometry3<f64>) -> Self {
        let mut twin = self.clone();
        twin.joint.frame = name.to_owned();
        twin.joint.axis_direction = self
            .joint
            .axis_direction
            .map(|d| (name_from_old.rotation * Vector3::from(d)).into());
        twin.joint.axis_point = self
            .joint
            .axis_point
            .map(|p| (name_from_old * Point3::from(p)).coords.into());
        twin.joint.tool_position = self
            .joint
            .tool_position
            .map(|p| (name_from_old * Point3::from(p)).coords.into());
        twin
    }

    /// The twin in the coordinate `s q + offset`, `s` = 1 or (when `reversed`) -1. The axis turns with the sense.
    #[must_use]
    pub fn in_coordinate(&self, reversed: bool, offset: f64) -> Self {
        let s = if reversed { -1.0 } else { 1.0 };
        let mut twin = self.clone();
        let old = self.joint.coordinate;
        twin.joint.coordinate = Coordinate {
            sign: s * old.sign,
            offset: s * old.offset + offset,
        };
        let mapped = |[low, high]: [f64; 2], offset: f64| {
            let (a, b) = (s * low + offset, s * high + offset);
            [a.min(b), a.max(b)]
        };
        twin.joint.q_range = mapped(self.joint.q_range, offset);
        twin.domain = Domain {
            q: mapped(self.domain.q, offset),
            dq: mapped(self.domain.dq, 0.0),
        };
        twin.joint.axis_direction = self.joint.axis_direction.map(|d| d.map(|v| s * v));
        twin
    }

    /// A twin from its JSON.
    ///
    /// # Errors
    /// [`TwinError`].
    pub fn from_json(text: &str) -> Result<Self, TwinError> {
        let value: serde_json::Value = serde_json::from_str(text).map_err(TwinError::Json)?;
        check::size(&value)?;
        let twin: Self = serde_json::from_value(value).map_err(TwinError::Json)?;
        if twin.schema != SCHEMA {
            return Err(TwinError::Schema { found: twin.schema });
        }
        check::content(&twin)?;
        Ok(twin)
    }

    /// The twin as JSON, indented.
    ///
    /// # Errors
    /// Never for values of this type; the serializer's own error type is kept.
    pub fn to_json(&self) -> Result<String, serde_json::Error> {
        serde_json::to_string_pretty(self)
    }
}

impl TwinMechanism {
    fn of(mechanism: &SplineMechanism) -> Self {
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::analysis::analyse;
    use crate::motion::MotionSettings;
    use crate::samples::JointSamples;

    fn twin() -> (Twin, crate::analysis::Analysis) {
        let time: Vec<f64> = (0..6000).map(|i| 0.005 * f64::from(i)).collect();
        let state: Vec<[f64; 3]> = time
            .iter()
            .map(|t| crate::dynamics::probing(*t, 0.8))
            .collect();
        let samples = JointSamples {
            kind: JointKind::Revolute,
            period: 0.005,
            runs: vec![0..6000],
            q: state.iter().map(|s| s[0]).collect(),
            tau: state
                .iter()
                .map(|[q, dq, ddq]| 2.0 * ddq + 0.6 * dq.signum() + 0.9 * dq + 3.0 * q * q)
                .collect(),
            time,
            noise_of_q: Vec::new(),
            aside: crate::samples::Aside::default(),
        };
        let analysis = analyse(&samples, &MotionSettings::default()).unwrap();
        let axis = ScrewAxis {
            direction: nalgebra::Unit::new_normalize(Vector3::new(0.0, 0.1, 1.0)),
            point: Point3::new(1.0, 2.0, 3.0),
            kind: JointKind::Revolute,
        };
        let twin = Twin::new(
            JointKind::Revolute,
            Some(&axis),
            analysis.q_range,
            [-1.0, 1.0],
            &analysis.full,
            Provenance::default(),
        )
        .with_effects(TwinEffect::of(&analysis));
        (twin, analysis)
    }

    #[test]
    fn the_twin_gives_the_efforts_of_its_model() {
        let (twin, analysis) = twin();
        let model = &analysis.full;
        let (q, dq, ddq) = (0.4, -0.7, 1.5);
        let expected = model.theta[0] * ddq - model.theta[1]
            + model.theta[2] * dq
            + model.mechanism.as_ref().unwrap().effort(q, dq)
            + twin.evaluator().terms(q, dq, ddq).effects;
        assert!((twin.evaluator().effort(q, dq, ddq) - expected).abs() < 1e-9);
        assert!(
            (expected - (3.0 - 0.6 - 0.63 + 0.48)).abs() < 0.15,
            "{expected}"
        );
    }

    #[test]
    fn another_frame_or_coordinate_does_not_change_the_effort() {
        let (twin, _) = twin();
        let motion = Isometry3::new(Vector3::new(1.0, 0.0, 2.0), Vector3::new(0.3, 0.2, 0.1));
        let moved = twin
            .in_frame("asset", &motion)
            .in_coordinate(true, 0.25)
            .in_coordinate(false, -1.0);
        for (q, dq, ddq) in [(0.1, 0.5, 1.0), (0.7, -0.9, 0.0), (0.4, -0.2, -3.0)] {
            let there = moved.evaluator().effort(-q + 0.25 - 1.0, -dq, -ddq);
            assert!(
                (there + twin.evaluator().effort(q, dq, ddq)).abs() < 1e-12,
                "effort turns its sign with the coordinate"
            );
        }
        let [low, high] = twin.joint.q_range;
        assert_eq!(moved.joint.q_range, [-high + 0.25 - 1.0, -low + 0.25 - 1.0]);
        let back = moved
            .in_coordinate(true, -0.75)
            .in_frame("world", &motion.inverse());
        assert!(
            (Vector3::from(back.joint.axis_direction.unwrap())
                - Vector3::from(twin.joint.axis_direction.unwrap()))
            .norm()
                < 1e-12
        );
    }

    proptest::proptest! {
        #![proptest_config(proptest::test_runner::Config::with_cases(1000))]
        #[test]
        fn any_frame_and_coordinate_gives_the_same_effort(
            turn in proptest::array::uniform3(-3.0..3.0), way in proptest::array::uniform3(-5.0..5.0),
            reversed: bool, offset in -4.0..4.0, q in 0.0..0.8, dq in -1.5..1.5, ddq in -9.0..9.0,
        ) {
            let (twin, _) = shared();
            let motion = Isometry3::new(Vector3::from(way), Vector3::from(turn));
            let moved = twin.in_frame("asset", &motion).in_coordinate(reversed, offset);
            let s = if reversed { -1.0 } else { 1.0 };
            let (here, there) = (twin.evaluator(), moved.evaluator());
            let (before, after) = (here.effort(q, dq, ddq), s * there.effort(s * q + offset, s * dq, s * ddq));
            proptest::prop_assert!((before - after).abs() <= 1e-9 * before.abs().max(1e-3), "{before} {after}");
            proptest::prop_assert_eq!(here.outside(q, dq).is_some(), there.outside(s * q + offset, s * dq).is_some());
            // Power: the effort works on the point of the axis that carries the tool, wherever the frame.
            let twist = |twin: &Twin, dq: f64| dq * Vector3::from(twin.joint.axis_direction.unwrap());
            let turned = motion.rotation * twist(twin, dq);
            proptest::prop_assert!((turned - twist(&moved, s * dq)).norm() < 1e-9);
        }
    }

    fn shared() -> &'static (Twin, crate::analysis::Analysis) {
        static SHARED: std::sync::OnceLock<(Twin, crate::analysis::Analysis)> =
            std::sync::OnceLock::new();
        SHARED.get_or_init(twin)
    }

    #[test]
    fn a_gradient_is_the_slope_of_the_effort_and_stays_on_its_side_of_rest() {
        let evaluator = shared().0.evaluator();
        let [by_q, by_dq, by_ddq] = evaluator.gradient(0.4, 0.6);
        let slope = |h: f64| {
            (evaluator.effort(0.4 + h, 0.6, 0.0) - evaluator.effort(0.4 - h, 0.6, 0.0)) / (2.0 * h)
        };
        assert!(
            (by_q - slope(1e-4)).abs() < 0.05 * by_q.abs().max(1.0),
            "{by_q} {}",
            slope(1e-4)
        );
        assert!(by_dq > 0.0 && (by_ddq - evaluator.inertia()).abs() < 1e-12);
        // Across rest the Coulomb friction would jump by more than a newton metre over a thousandth of the range.
        assert!(evaluator.gradient(0.4, 1e-6)[1] < 20.0);
        assert_eq!(evaluator.outside(0.4, 0.1), None);
        assert_eq!(evaluator.outside(f64::NAN, 0.1), Some(Outside::Coordinate));
        assert_eq!(evaluator.outside(3.0, 0.1), Some(Outside::Coordinate));
        assert_eq!(evaluator.outside(0.4, 30.0), Some(Outside::Velocity));
    }

    #[test]
    fn many_efforts_at_once_are_those_one_by_one() {
        // More than a block of states and not a whole number of blocks; named effects too; either sense.
        let (twin, _) = shared();
        let states: Vec<[f64; 3]> = (0..333)
            .map(|k| {
                let t = f64::from(k);
                [
                    0.4 + 0.7 * t.sin(),
                    1.2 * (0.7 * t).cos(),
                    3.0 * (1.3 * t).sin(),
                ]
            })
            .chain([[0.3, 0.0, 1.0], [f64::NAN, 0.2, 0.0], [0.2, f64::NAN, 0.0]])
            .collect();
        let of = |i: usize| -> Vec<f64> { states.iter().map(|state| state[i]).collect() };
        for twin in [twin.clone(), twin.in_coordinate(true, 0.3)] {
            let evaluator = twin.evaluator();
            let mut out = vec![0.0; states.len()];
            evaluator.efforts(&of(0), &of(1), &of(2), &mut out).unwrap();
            for ([q, dq, ddq], effort) in states.iter().zip(&out) {
                let one = evaluator.effort(*q, *dq, *ddq);
                assert!((one - effort).abs() < 1e-12 || (one.is_nan() && effort.is_nan()));
            }
            evaluator.efforts(&of(0), 0.4, 0.0, &mut out).unwrap();
            assert!((out[7] - evaluator.effort(states[7][0], 0.4, 0.0)).abs() < 1e-12);
            let wrong = evaluator
                .efforts(0.1, &of(1)[1..], 0.0, &mut out)
                .unwrap_err();
            assert_eq!((wrong.name, wrong.expected, wrong.got), ("dq", 336, 335));
        }
    }

    #[test]
    fn json_gives_the_twin_back() {
        let (twin, _) = twin();
        let back: Twin = serde_json::from_str(&twin.to_json().unwrap()).unwrap();
        assert!(
            (back.evaluator().effort(0.3, 0.4, 0.5) - twin.evaluator().effort(0.3, 0.4, 0.5)).abs()
                < 1e-12
        );
        assert_eq!(back.joint.coordinate, twin.joint.coordinate);
    }
}
