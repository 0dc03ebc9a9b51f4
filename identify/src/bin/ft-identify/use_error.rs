//! Why a twin cannot be used.

use std::path::PathBuf;

use ft_identify::error::IdentifyError;
use ft_identify::export::ExportError;
use ft_identify::screw::JointKind;
use ft_identify::simulate::SimulateError;
use ft_identify::twin::TwinError;

/// Why a twin cannot be used.
#[derive(Debug, thiserror::Error)]
pub(crate) enum UseError {
    #[error("cannot read {}: {source}; give the twin.json that ft-identify wrote", path.display())]
    Read {
        path: PathBuf,
        source: std::io::Error,
    },
    #[error("{}: {source}", path.display())]
    Twin { path: PathBuf, source: TwinError },
    #[error("cannot write {}: {source}; check that the directory exists and has room", path.display())]
    Write {
        path: PathBuf,
        source: std::io::Error,
    },
    #[error("`{text}` is no place on a {} joint: give a number with {units}", kind.name())]
    Place {
        text: String,
        kind: JointKind,
        units: String,
    },
    #[error("{} is {}, the first twin is {}: only one kind of joint can be compared", path.display(), kind.name(), first.name())]
    Kinds {
        path: PathBuf,
        kind: JointKind,
        first: JointKind,
    },
    #[error(
        "the twin does not say how far its handle is from its axis (it comes from a table): a force at the handle cannot be compared with it; leave --limit out"
    )]
    NoLever,
    #[error(transparent)]
    Simulate(#[from] SimulateError),
    #[error(transparent)]
    Export(#[from] ExportError),
    #[error(transparent)]
    Output(#[from] IdentifyError),
}
