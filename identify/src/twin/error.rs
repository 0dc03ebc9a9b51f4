//! Why a file is no twin.

use super::SCHEMA;

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
