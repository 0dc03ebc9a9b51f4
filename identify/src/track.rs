//! A joint from a track of poses alone: text with 3 or 7 numbers per line, or CSV with a header.
//!
//! 3 columns = x y z, 7 columns = x y z qx qy qz qw, in m, separated by blanks, commas or semicolons; lines that start with
//! `#` are skipped. A header names columns instead: x y z (or px py pz, tx ty tz, `position.x`), qx qy qz qw, and
//! optionally t or time (then gaps are not looked for; the order counts).

use std::path::{Path, PathBuf};

use nalgebra::{Point3, Quaternion, UnitQuaternion};

use crate::joint_graph::{RefinedJoint, refine};
use crate::pipeline::MOST_OFF_PATH_M;
use crate::samples::{extrema, opening_sign};
use crate::screw::{Candidates, JointKind, PoseSamples, SelectError, select};

/// Why a track cannot be used.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum TrackError {
    /// The file cannot be read.
    #[error("cannot read {}: {source}{}", path.display(), if path.extension().is_some_and(|end| end == "mcap") {
        "; a recording is identified without `track`: ft-identify RECORDING -o DIR"
    } else {
        ""
    })]
    Io {
        /// The file.
        path: PathBuf,
        /// What the system says.
        source: std::io::Error,
    },
    /// A line has another number of columns.
    #[error("{}: line {line} has {got} columns, need 3 (x y z) or 7 (x y z qx qy qz qw)", path.display())]
    Columns {
        /// The file.
        path: PathBuf,
        /// Line, from 1.
        line: usize,
        /// Columns there.
        got: usize,
    },
    /// A cell is not a finite number, or four are no rotation.
    #[error("{}: line {line}: `{text}` is not a pose", path.display())]
    NotAPose {
        /// The file.
        path: PathBuf,
        /// Line, from 1.
        line: usize,
        /// What stands there.
        text: String,
    },
    /// The header lacks positions.
    #[error("{}: no columns x, y, z in the header; there are: {}", path.display(), there.join(", "))]
    MissingColumns {
        /// The file.
        path: PathBuf,
        /// Those there.
        there: Vec<String>,
    },
    /// No joint fits.
    #[error("{}: {source}", path.display())]
    Select {
        /// The file.
        path: PathBuf,
        /// Why.
        source: SelectError,
    },
}

/// A joint found in a track.
#[derive(Clone, Debug)]
pub struct TrackJoint {
    /// First fits and the choice.
    pub candidates: Candidates,
    /// The joint after refinement, with its sense such that the first sustained displacement is positive.
    pub joint: RefinedJoint,
    /// Distance of the track from the axis, m; nothing for a line.
    pub radius: Option<f64>,
    /// Smallest and largest coordinate, rad or m.
    pub q_range: [f64; 2],
}

impl TrackJoint {
    /// Whether the motion is that of one joint: some best fit there always is.
    #[must_use]
    pub fn is_one_joint(&self) -> bool {
        self.joint.position_rms <= MOST_OFF_PATH_M
    }
}

/// Finds the joint in the track of a file.
///
/// # Errors
/// [`TrackError`].
pub fn identify_track(path: &Path) -> Result<TrackJoint, TrackError> {
    let samples = read_track(path)?;
    joint_of(&samples).map_err(|source| TrackError::Select {
        path: path.to_owned(),
        source,
    })
}

/// Finds the joint in a track.
///
/// # Errors
/// [`SelectError`].
pub fn joint_of(samples: &PoseSamples) -> Result<TrackJoint, SelectError> {
    let candidates = select(samples)?;
    let mut joint = refine(samples, &candidates);
    if opening_sign(&joint.q) < 0.0 {
        joint.axis = joint.axis.reversed();
        for q in &mut joint.q {
            *q = -*q;
        }
    }
    let radius =
        (joint.axis.kind == JointKind::Revolute).then(|| joint.axis.distance(&joint.tool_position));
    let (low, high) = extrema(&joint.q);
    Ok(TrackJoint {
        candidates,
        radius,
        q_range: [low, high],
        joint,
    })
}

/// Reads a track.
///
/// # Errors
/// [`TrackError`], all but `Select`.
pub fn read_track(path: &Path) -> Result<PoseSamples, TrackError> {
    let text = std::fs::read_to_string(path).map_err(|source| TrackError::Io {
        path: path.to_owned(),
        source,
    })?;
    let mut out = PoseSamples {
        starts: vec![0],
        period: 1.0,
        ..PoseSamples::default()
    };
    let mut order: Option<Vec<usize>> = None;
    let mut separator = None;
    for (number, whole) in text.lines().enumerate() {
        let cells = cells_of(whole, separator);
        if whole.trim().is_empty() || whole.trim_start().starts_with('#') {
            continue;
        }
        let line = number + 1;
        let header = order.is_none()
            && out.positions.is_empty()
            && cells.iter().all(|cell| cell.parse::<f64>().is_err());
        if header {
            // Names may have blanks, and cells of other columns may be empty.
            separator = ['\t', ';', ','].into_iter().find(|c| whole.contains(*c));
            let cells = cells_of(whole, separator);
            order = Some(by_header(&cells).ok_or_else(|| TrackError::MissingColumns {
                path: path.to_owned(),
                there: cells.iter().map(|cell| (*cell).to_owned()).collect(),
            })?);
            continue;
        }
        let picked: Vec<&str> = match &order {
            Some(order) => order
                .iter()
                .map(|&i| cells.get(i).copied().unwrap_or(""))
                .collect(),
            None => cells,
        };
        if picked.len() != 3 && picked.len() != 7 {
            return Err(TrackError::Columns {
                path: path.to_owned(),
                line,
                got: picked.len(),
            });
        }
        let wrong = || TrackError::NotAPose {
            path: path.to_owned(),
            line,
            text: picked.join(" "),
        };
        let values: Vec<f64> = picked
            .iter()
            .filter_map(|cell| cell.parse::<f64>().ok())
            .filter(|v| v.is_finite())
            .collect();
        if values.len() != picked.len() {
            return Err(wrong());
        }
        out.positions
            .push(Point3::new(values[0], values[1], values[2]));
        if let [qx, qy, qz, qw] = values[3..] {
            let quaternion = Quaternion::new(qw, qx, qy, qz);
            if !(0.5..2.0).contains(&quaternion.norm()) {
                return Err(wrong());
            }
            out.rotations
                .push(UnitQuaternion::from_quaternion(quaternion));
        }
        if !out.rotations.is_empty() && out.rotations.len() != out.positions.len() {
            return Err(TrackError::Columns {
                path: path.to_owned(),
                line,
                got: picked.len(),
            });
        }
    }
    Ok(out)
}

/// The cells of a line; without a separator between blanks, commas and semicolons.
fn cells_of(line: &str, separator: Option<char>) -> Vec<&str> {
    match separator {
        Some(separator) => line.split(separator).map(str::trim).collect(),
        None => line
            .split(|c: char| c.is_whitespace() || c == ',' || c == ';')
            .filter(|cell| !cell.is_empty())
            .collect(),
    }
}

/// Indices of x y z and, when all are there, qx qy qz qw.
fn by_header(names: &[&str]) -> Option<Vec<usize>> {
    let clean: Vec<String> = names
        .iter()
        .map(|name| name.trim_matches('"').to_ascii_lowercase())
        .collect();
    let find = |wanted: &[&str]| {
        clean.iter().position(|name| {
            wanted.iter().any(|w| {
                name == w
                    || name
                        .strip_prefix(w)
                        .is_some_and(|r| r.trim_start().starts_with(['_', '[']))
            })
        })
    };
    let position = ["x", "y", "z"].map(|axis| {
        find(&[
            axis,
            &format!("p{axis}"),
            &format!("t{axis}"),
            &format!("position.{axis}"),
            &format!("pos_{axis}"),
            &format!("ee_{axis}"),
        ])
    });
    let rotation = ["x", "y", "z", "w"].map(|axis| {
        find(&[
            &format!("q{axis}"),
            &format!("orientation.{axis}"),
            &format!("quat_{axis}"),
        ])
    });
    let mut order: Vec<usize> = position.into_iter().collect::<Option<_>>()?;
    if let Some(rotation) = rotation.into_iter().collect::<Option<Vec<usize>>>() {
        order.extend(rotation);
    }
    Some(order)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn written(text: &str) -> tempfile::NamedTempFile {
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), text).unwrap();
        file
    }

    fn arc(radius: f64) -> Vec<[f64; 3]> {
        (0..200)
            .map(|i| 1.2 * f64::from(i) / 200.0)
            .enumerate()
            .map(|(i, a)| {
                [
                    radius * a.cos() + 5e-4 * (i as f64 * 2.3).sin(),
                    radius * a.sin(),
                    5e-4 * (i as f64 * 1.7).sin(),
                ]
            })
            .collect()
    }

    #[test]
    fn an_arc_is_a_hinge_in_any_notation() {
        let blanks: String = arc(0.4)
            .iter()
            .map(|[x, y, z]| format!("{x} {y}\t{z}\n"))
            .collect();
        let commas: String = arc(0.4)
            .iter()
            .map(|[x, y, z]| format!("0,{z},{x},{y}\n"))
            .collect();
        let tabs: String = arc(0.4)
            .iter()
            .map(|[x, y, z]| format!("0\t\t{x}\t{y}\t{z}\n"))
            .collect();
        for text in [
            format!("Time [s]\tnote\tx [m]\ty [m]\tz [m]\n{tabs}"),
            format!("# a comment\n{blanks}"),
            format!("t,z,x,y\n{commas}"),
        ] {
            let found = identify_track(written(&text).path()).unwrap();
            assert_eq!(found.candidates.kind, JointKind::Revolute);
            assert!((found.radius.unwrap() - 0.4).abs() < 2e-3);
            assert!((found.q_range[1] - found.q_range[0] - 1.2).abs() < 0.02);
        }
    }

    #[test]
    fn wrong_tracks_are_refused_with_their_line() {
        let refused = |text: &str| {
            identify_track(written(text).path())
                .unwrap_err()
                .to_string()
        };
        assert!(refused("0 0 0\n1 2 3 4\n").contains("line 2 has 4 columns"));
        assert!(refused("0 0 0\n1 two 3\n").contains("line 2: `1 two 3` is not a pose"));
        assert!(refused("0 0 0 0 0 0 0\n").contains("is not a pose"));
        assert!(refused("a,b,c\n1,2,3\n").contains("there are: a, b, c"));
        assert!(refused("0 0 0\n1 1 1\n").contains("2 poses are too few"));
        assert!(refused(&"0.1 0.2 0.3\n".repeat(100)).contains("never moves"));
        assert!(
            identify_track(Path::new("/nonexistent"))
                .unwrap_err()
                .to_string()
                .contains("cannot read")
        );
    }
}
