//! `twin.json` (schema `ft-identify/twin/1`): the identified joint for controllers and simulators.
//!
//! The effort at a state is `I ddq + mu sgn(dq) + b dq`, the added effects, and `g(q) + c(q, |dq|) dq`, in the joint coordinate of the recording.
//! [`Twin::in_frame`] and [`Twin::in_coordinate`] re-express it (the paper's twin assembly) without changing the effort.

mod batch;
mod check;
mod error;
mod evaluator;
mod express;
mod lanes;
mod mechanism;
mod pieces;
mod rows;

pub use batch::{Each, LengthError};
pub use error::TwinError;
pub(crate) use evaluator::BEYOND;
pub use evaluator::{Evaluator, Outside, Terms};
pub use mechanism::{Spline, SurfaceSpline, TwinMechanism};
use nalgebra::{Point3, Unit, Vector3};
use serde::{Deserialize, Serialize};

use crate::dynamics::EffortModel;
use crate::mechanism::Domain;
use crate::report::effects::TwinEffect;
use crate::screw::{JointKind, ScrewAxis};

/// Name of the schema.
pub const SCHEMA: &str = "ft-identify/twin/1";

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

#[cfg(test)]
mod tests;
