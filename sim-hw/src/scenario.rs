//! Scenarios: which object, who probes it, and what is fitted, as TOML files.
//!
//! Lengths, points and directions are in the building's frame, z up; the tracker's world is that frame turned about z and
//! moved (`[world]`). `q` is in rad or m by joint kind and grows as the object opens.

mod check;
mod effect;
mod parts;

use std::path::Path;

use serde::{Deserialize, Serialize};

pub use effect::EffectSpec;
pub use parts::{
    ClockSpec, GraspSpec, GripperDriver, GripperSpec, JointKind, JointSpec, LinkSpec,
    MechanismSpec, ObjectSpec, PersonSpec, SensorDriver, SensorSpec, StrutSpec, SwingDirection,
    ToolSpec, TrackerSpec, WorldSpec, ZoneSpec,
};

/// An object, a person and fitted devices, before a seed makes them particular.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Scenario {
    /// Short name, lower snake case.
    pub name: String,
    /// One sentence for people.
    pub description: String,
    /// Mixed into the seed, so that two files differ under the same seed; 0 leaves the seed as it is.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub salt: u32,
    /// The one joint of the object.
    pub joint: JointSpec,
    /// Inertia, friction, stops, weight.
    pub object: ObjectSpec,
    /// Where the tool holds the object.
    pub grasp: GraspSpec,
    /// What else acts on the joint.
    #[serde(default, rename = "mechanism")]
    pub mechanisms: Vec<MechanismSpec>,
    /// What else is so, on the object and in the measurement, and is kept from every model.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub undeclared: Vec<EffectSpec>,
    /// The wrist force-torque sensor.
    pub sensor: SensorSpec,
    /// The tracker's world in the building.
    #[serde(default)]
    pub world: WorldSpec,
    /// The hand and its habits.
    #[serde(default)]
    pub person: PersonSpec,
    /// The part of the gripper in front of the sensor.
    #[serde(default)]
    pub tool: ToolSpec,
    /// The pose tracker.
    #[serde(default)]
    pub tracker: TrackerSpec,
    /// The gripper's encoder.
    #[serde(default)]
    pub gripper: GripperSpec,
}

#[allow(clippy::trivially_copy_pass_by_ref)] // serde hands a reference
fn is_zero(salt: &u32) -> bool {
    *salt == 0
}

const BUILTIN: [(&str, &str); 6] = [
    ("wood_door", include_str!("../scenarios/wood_door.toml")),
    ("metal_door", include_str!("../scenarios/metal_door.toml")),
    (
        "drawer_light",
        include_str!("../scenarios/drawer_light.toml"),
    ),
    (
        "drawer_loaded",
        include_str!("../scenarios/drawer_loaded.toml"),
    ),
    (
        "sliding_door",
        include_str!("../scenarios/sliding_door.toml"),
    ),
    ("oven_door", include_str!("../scenarios/oven_door.toml")),
];

impl Scenario {
    /// The names that [`Scenario::builtin`] knows, the default first.
    #[must_use]
    pub fn builtin_names() -> Vec<&'static str> {
        BUILTIN.iter().map(|(name, _)| *name).collect()
    }

    /// The scenario that comes with the program under `name`.
    ///
    /// # Errors
    /// There is none of that name; the error lists them.
    pub fn builtin(name: &str) -> Result<Self, ScenarioError> {
        match BUILTIN.iter().find(|(known, _)| *known == name) {
            Some((_, text)) => Self::from_toml(text),
            None => Err(ScenarioError::UnknownName {
                name: name.to_owned(),
                known: Self::builtin_names().join(", "),
            }),
        }
    }

    /// A scenario from the text of a TOML file.
    ///
    /// # Errors
    /// The text is no TOML, a key is unknown or missing, or a value is outside what the error says is allowed.
    pub fn from_toml(text: &str) -> Result<Self, ScenarioError> {
        let scenario: Self = toml::from_str(text).map_err(ScenarioError::Toml)?;
        scenario.check()?;
        Ok(scenario)
    }

    /// The scenario as the text of a TOML file, which [`Scenario::from_toml`] takes back.
    ///
    /// # Errors
    /// A value is not finite, or another one that TOML cannot hold.
    pub fn to_toml(&self) -> Result<String, ScenarioError> {
        toml::to_string(self).map_err(ScenarioError::NotToml)
    }

    /// The seed that everything random is drawn from.
    pub(crate) fn salted(&self, seed: u64) -> u64 {
        seed ^ u64::from(self.salt).wrapping_mul(0x9E37_79B9_7F4A_7C15)
    }

    /// A built-in scenario by its name, or else a file by its path (anything with a `/` or ending in `.toml` is a path).
    ///
    /// # Errors
    /// Neither exists, or the file is not a scenario.
    pub fn load(path_or_name: &str) -> Result<Self, ScenarioError> {
        let path = Path::new(path_or_name);
        if !path_or_name.contains('/')
            && path.extension().is_none_or(|extension| extension != "toml")
        {
            return Self::builtin(path_or_name);
        }
        let text = std::fs::read_to_string(path).map_err(|source| ScenarioError::Read {
            path: path_or_name.to_owned(),
            source,
        })?;
        Self::from_toml(&text).map_err(|source| ScenarioError::InFile {
            path: path_or_name.to_owned(),
            source: Box::new(source),
        })
    }
}

/// Why a scenario cannot be played.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ScenarioError {
    /// No built-in scenario has that name.
    #[error("there is no scenario {name:?}: give one of {known}, or the path of a TOML file")]
    UnknownName {
        /// What was asked for.
        name: String,
        /// What there is.
        known: String,
    },
    /// The file cannot be read.
    #[error("cannot read the scenario {path}")]
    Read {
        /// The path as given.
        path: String,
        /// What the system said.
        source: std::io::Error,
    },
    /// The file is not a scenario.
    #[error("in the scenario {path}: {source}")]
    InFile {
        /// The path as given.
        path: String,
        /// What is wrong in it.
        source: Box<ScenarioError>,
    },
    /// No TOML, or keys that a scenario does not have.
    #[error("{0}")]
    Toml(toml::de::Error),
    /// TOML cannot hold the scenario.
    #[error("the scenario cannot be written as TOML: {0}")]
    NotToml(toml::ser::Error),
    /// A value outside the allowed ones.
    #[error("{key} is {value}: it must be {allowed}")]
    Value {
        /// The key, with its table.
        key: String,
        /// What it holds.
        value: String,
        /// What it may hold.
        allowed: String,
    },
    /// The wanted duration is too short.
    #[error(
        "a duration of {asked_s} s is too short: at least {least_s} s are needed to grasp, move and release"
    )]
    TooShort {
        /// Wanted, s.
        asked_s: f64,
        /// Least, s.
        least_s: f64,
    },
    /// The object does not come to rest by itself, so that nobody can grasp it.
    #[error(
        "the object is still moving at {rate} rad/s or m/s after {waited_s} s without a hand: raise object.coulomb or object.viscous"
    )]
    NeverRests {
        /// Joint rate left.
        rate: f64,
        /// Simulated wait, s.
        waited_s: f64,
    },
}
