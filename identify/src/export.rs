//! Twins for other people's simulators: MJCF, URDF, USD and ONNX, each derived from `twin.json` alone.
//!
//! No format holds a mechanism as it is. Each export gives the joint's inertia, friction and the nearest polynomial or
//! spring and damper that the format has ([`Native`]), says how far that is from the twin, and puts the whole effort beside it as a
//! table over (q, dq) ([`Table`]) that a few lines of a callback, or the ONNX file, evaluate: the callback adds what it has beyond
//! the attributes. Effects with a memory are in none of them ([`Twin::left_out`]).

mod mjcf;
mod native;
mod onnx;
mod scene;
mod table;
mod urdf;
mod usd;

use std::path::{Path, PathBuf};

pub use native::Native;
pub use scene::Scene;
pub use table::Table;

use crate::error::IdentifyError;
use crate::least_squares::FitError;
use crate::output::{refuse_existing, replace};
use crate::twin::{Evaluator, Twin};

/// A format.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Target {
    /// MuJoCo's XML, with a passive-force callback in Python.
    Mjcf,
    /// URDF.
    Urdf,
    /// USD text, with the attributes of UsdPhysics, PhysX, Newton and MuJoCo.
    Usd,
    /// The effort without inertia as an ONNX graph.
    Onnx,
}

/// Why a twin cannot be exported.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ExportError {
    /// A rigid body needs an inertia.
    #[error(
        "the twin has no inertia: it was not identifiable; probe with fast strokes and identify again, or export `onnx`, which needs none"
    )]
    NoInertia,
    /// Its efforts are no numbers.
    #[error("the twin's efforts cannot be fitted: {0}")]
    Fit(#[from] FitError),
    /// The name is that of the frame.
    #[error("`{name}` is the name of the twin's frame (or `world`): choose another with --name")]
    Name {
        /// The name.
        name: String,
    },
    /// A file is there already, or cannot be written.
    #[error(transparent)]
    Output(#[from] IdentifyError),
    /// The table cannot be put into JSON.
    #[error("the table of the mechanism cannot be written: {0}")]
    Json(#[from] serde_json::Error),
}

/// What was written, and what it lacks.
#[derive(Clone, Debug)]
pub struct Exported {
    /// The files, the main one first.
    pub files: Vec<PathBuf>,
    /// What the format's own attributes hold; nothing for ONNX, which holds everything.
    pub native: Option<Native>,
    /// Root mean square difference between the twin and the table beside it, over the effort's own.
    pub table_error: f64,
}

/// Writes `name.*` into `directory`, which is made when it is not there; nothing is written when one of the files is there and
/// `force` is not set.
///
/// # Errors
/// [`ExportError`].
pub fn export(
    twin: &Twin,
    targets: &[Target],
    directory: &Path,
    name: &str,
    force: bool,
) -> Result<Vec<Exported>, ExportError> {
    if name == "world" || name == twin.joint.frame {
        return Err(ExportError::Name {
            name: name.to_owned(),
        });
    }
    let parts: Vec<Parts> = targets
        .iter()
        .map(|target| parts(twin, *target, name))
        .collect::<Result<_, _>>()?;
    let names: Vec<&str> = parts
        .iter()
        .flat_map(|(texts, ..)| texts.iter().map(|(file, _)| file.as_str()))
        .collect();
    refuse_existing(directory, &names, force)?;
    std::fs::create_dir_all(directory).map_err(|source| IdentifyError::Write {
        path: directory.to_owned(),
        source,
    })?;
    let mut all = Vec::new();
    for (texts, native, table_error) in parts {
        let mut files = Vec::new();
        for (file, bytes) in texts {
            let path = directory.join(file);
            replace(&path, bytes).map_err(|source| IdentifyError::Write {
                path: path.clone(),
                source,
            })?;
            files.push(path);
        }
        all.push(Exported {
            files,
            native,
            table_error,
        });
    }
    Ok(all)
}

fn parts(twin: &Twin, target: Target, name: &str) -> Result<Parts, ExportError> {
    let evaluator = twin.evaluator();
    if target != Target::Onnx && evaluator.inertia() <= 0.0 {
        return Err(ExportError::NoInertia);
    }
    match target {
        Target::Onnx => {
            let table = Table::of(&evaluator);
            let error = table.error(&evaluator);
            let bytes = onnx::model(&table, twin);
            Ok((vec![(format!("{name}.onnx"), bytes)], None, error))
        }
        Target::Mjcf => beside(
            twin,
            &evaluator,
            Native::polynomial(&evaluator)?,
            |native, scene| {
                vec![
                    (
                        format!("{name}.xml"),
                        mjcf::document(name, twin, native, scene),
                    ),
                    (format!("{name}_passive.py"), mjcf::callback(name)),
                ]
            },
        ),
        Target::Urdf => beside(
            twin,
            &evaluator,
            Native::friction(&evaluator)?,
            |native, scene| {
                vec![(
                    format!("{name}.urdf"),
                    urdf::document(name, twin, native, scene),
                )]
            },
        ),
        Target::Usd => beside(
            twin,
            &evaluator,
            Native::spring(&evaluator)?,
            |native, scene| {
                vec![(
                    format!("{name}.usda"),
                    usd::document(name, twin, native, scene),
                )]
            },
        ),
    }
}

/// The name of a frame as an identifier of USD and URDF.
fn identifier(frame: &str) -> String {
    let mut out: String = frame
        .chars()
        .map(|c| if c.is_ascii_alphanumeric() { c } else { '_' })
        .collect();
    if !out.starts_with(|c: char| c.is_ascii_alphabetic()) {
        out.insert(0, '_');
    }
    out
}

/// How far joint attributes are from the twin, for a comment.
fn percent(twin: &Twin, native: &Native) -> String {
    let off = native.relative_error.unwrap_or(1.0);
    let without: Vec<&str> = twin.left_out().collect();
    let without = if without.is_empty() {
        String::new()
    } else {
        format!(" without its {} (which have a memory)", without.join(", "))
    };
    format!(
        "{:.1} % (root mean square, over the probed domain) from the twin{without}",
        100.0 * off
    )
}

type Parts = (Vec<(String, Vec<u8>)>, Option<Native>, f64);

/// The documents of a format with the table.
fn beside(
    twin: &Twin,
    evaluator: &Evaluator,
    native: Native,
    documents: impl FnOnce(&Native, &Scene) -> Vec<(String, String)>,
) -> Result<Parts, ExportError> {
    let scene = Scene::of(twin);
    let table = Table::of(evaluator);
    let mut texts: Vec<(String, Vec<u8>)> = documents(&native, &scene)
        .into_iter()
        .map(|(file, text)| (file, text.into_bytes()))
        .collect();
    let error = table.error(evaluator);
    let sidecar = serde_json::to_vec(&table.sidecar(twin, &native, error))?;
    let main = texts.first().map_or("", |(file, _)| file);
    texts.push((format!("{main}.mechanism.json"), sidecar));
    Ok((texts, Some(native), error))
}

#[cfg(test)]
mod tests;
