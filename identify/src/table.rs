//! Measured position and effort of one joint from a CSV file.
//!
//! Columns are separated by commas, semicolons or tabs, whichever gives the named ones; numbers have points.
//! The columns are named by the caller; the rest is ignored. Time must increase; it may be irregular, and the series are
//! then put on a uniform grid of the median step (linear interpolation). A step over three times the median is a gap.

mod plausible;
mod published;

pub use plausible::doubts;
pub use published::{Recipe, identify_published};

use std::path::{Path, PathBuf};

use crate::samples::{JointSamples, quantile};
use crate::screw::JointKind;

/// Which columns of a table are what.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TableColumns {
    /// Time, s.
    pub time: String,
    /// Joint coordinate, rad or m.
    pub position: String,
    /// Effort applied to the joint, N m or N.
    pub effort: String,
}

/// Why a table cannot be used.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum TableError {
    /// The file cannot be read.
    #[error("cannot read {}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// What the reader says.
        source: csv::Error,
    },
    /// It is no table.
    #[error("{} is an MCAP recording and no table; give it to ft-identify without `table`", path.display())]
    Recording {
        /// The file.
        path: PathBuf,
    },
    /// A row has other cells than the header.
    #[error("{}: row {row} has {cells} cells and the header {columns}; mend the row or remove it", path.display())]
    OtherCells {
        /// The file.
        path: PathBuf,
        /// Line of the file, from 1.
        row: u64,
        /// Cells of the row.
        cells: u64,
        /// Cells of the header.
        columns: u64,
    },
    /// A named column is not there.
    #[error("{}: no column `{name}`; {}", path.display(), if there.is_empty() {
        "the file is empty".to_owned()
    } else {
        format!("there are: {}", there.join(", "))
    })]
    MissingColumn {
        /// The file.
        path: PathBuf,
        /// Asked for.
        name: String,
        /// Those there.
        there: Vec<String>,
    },
    /// A named column is there more than once.
    #[error("{}: there is more than one column `{name}`; rename the others", path.display())]
    DoubledColumn {
        /// The file.
        path: PathBuf,
        /// Its name.
        name: String,
    },
    /// A column was named for two things.
    #[error(
        "column `{name}` cannot be two of time, position and effort; name three different ones"
    )]
    SameColumn {
        /// Its name.
        name: String,
    },
    /// A cell is not a number.
    #[error("{}: row {row}, column `{column}`: `{text}` is not a number{}", path.display(), if text.contains(',') {
        " (decimals come after a point)"
    } else {
        "; remove the row or fill it in"
    })]
    NotANumber {
        /// The file.
        path: PathBuf,
        /// Line of the file, from 1.
        row: u64,
        /// The column.
        column: String,
        /// What stands there.
        text: String,
    },
    /// A cell is NaN or infinite.
    #[error("{}: row {row}, column `{column}`: {value} is not finite; remove the row or fill it in", path.display())]
    NotFinite {
        /// The file.
        path: PathBuf,
        /// Line of the file, from 1.
        row: u64,
        /// The column.
        column: String,
        /// What stands there.
        value: f64,
    },
    /// A cell is beyond anything that is measured, in these units.
    #[error("{}: row {row}, column `{column}`: {value:e} is no measured value in s, m, rad, N or N m (below 1e12); mend it or convert the column", path.display())]
    TooLarge {
        /// The file.
        path: PathBuf,
        /// Line of the file, from 1.
        row: u64,
        /// The column.
        column: String,
        /// What stands there.
        value: f64,
    },
    /// Time does not increase.
    #[error("{}: row {row}: time {time} s does not come after {before} s; sort the rows and remove repeated ones", path.display())]
    TimeNotIncreasing {
        /// The file.
        path: PathBuf,
        /// Line of the file, from 1.
        row: u64,
        /// Its time.
        time: f64,
        /// Time of the row before.
        before: f64,
    },
    /// The published recipe drops every row.
    #[error("--drop-border {drop_border} leaves none of {rows} rows; drop fewer")]
    NothingLeft {
        /// First row that would be kept, from 1.
        drop_border: usize,
        /// Rows there.
        rows: usize,
    },
    /// The effort is the same everywhere.
    #[error("{}: column `{column}` is {value} in every row: no effort was measured; name another column with --effort", path.display())]
    ConstantEffort {
        /// The file.
        path: PathBuf,
        /// The column.
        column: String,
        /// What stands there.
        value: f64,
    },
    /// Fewer rows than a motion needs.
    #[error("{}: {rows} rows are too few, need at least {needed}", path.display())]
    TooShort {
        /// The file.
        path: PathBuf,
        /// Rows there.
        rows: usize,
        /// Rows needed.
        needed: usize,
    },
}

const MIN_ROWS: usize = 100;
/// Nothing in SI units is larger, not even a time since 1970.
const LARGEST: f64 = 1e12;

/// Reads a table.
///
/// # Errors
/// [`TableError`].
pub fn read_table(
    path: &Path,
    columns: &TableColumns,
    kind: JointKind,
) -> Result<JointSamples, TableError> {
    let io = |source| TableError::Io {
        path: path.to_owned(),
        source,
    };
    let wanted = [&columns.time, &columns.position, &columns.effort];
    if let Some(name) = (1..3).find_map(|k| wanted[..k].iter().find(|name| **name == wanted[k])) {
        return Err(TableError::SameColumn {
            name: (*name).clone(),
        });
    }
    let bytes = std::fs::read(path).map_err(|source| io(source.into()))?;
    if bytes.starts_with(b"\x89MCAP") {
        return Err(TableError::Recording {
            path: path.to_owned(),
        });
    }
    let (separator, there) = separated(&bytes, wanted).map_err(io)?;
    let find = |name: &String| {
        let mut found = (0..there.len()).filter(|&at| there[at] == *name);
        match (found.next(), found.next()) {
            (Some(at), None) => Ok(at),
            (Some(_), Some(_)) => Err(TableError::DoubledColumn {
                path: path.to_owned(),
                name: name.clone(),
            }),
            (None, _) => Err(TableError::MissingColumn {
                path: path.to_owned(),
                name: name.clone(),
                there: there.clone(),
            }),
        }
    };
    let index = [find(wanted[0])?, find(wanted[1])?, find(wanted[2])?];
    let mut reader = csv_reader(&bytes, separator);
    let mut rows: Vec<[f64; 3]> = Vec::new();
    for record in reader.records() {
        let record = record.map_err(|source| match *source.kind() {
            csv::ErrorKind::UnequalLengths {
                ref pos,
                expected_len,
                len,
            } => TableError::OtherCells {
                path: path.to_owned(),
                row: pos.as_ref().map_or(0, csv::Position::line),
                cells: len,
                columns: expected_len,
            },
            _ => io(source),
        })?;
        let row = record.position().map_or(0, csv::Position::line);
        let mut values = [0.0_f64; 3];
        for ((value, at), name) in values.iter_mut().zip(index).zip(wanted) {
            let text = record.get(at).unwrap_or("");
            *value = text.parse().map_err(|_| TableError::NotANumber {
                path: path.to_owned(),
                row,
                column: name.clone(),
                text: text.to_owned(),
            })?;
            if !value.is_finite() {
                return Err(TableError::NotFinite {
                    path: path.to_owned(),
                    row,
                    column: name.clone(),
                    value: *value,
                });
            }
            if value.abs() > LARGEST {
                return Err(TableError::TooLarge {
                    path: path.to_owned(),
                    row,
                    column: name.clone(),
                    value: *value,
                });
            }
        }
        if let Some(before) = rows.last().filter(|before| values[0] <= before[0]) {
            return Err(TableError::TimeNotIncreasing {
                path: path.to_owned(),
                row,
                time: values[0],
                before: before[0],
            });
        }
        rows.push(values);
    }
    if rows.len() < MIN_ROWS {
        return Err(TableError::TooShort {
            path: path.to_owned(),
            rows: rows.len(),
            needed: MIN_ROWS,
        });
    }
    let value = rows[0][2];
    if rows.iter().all(|row| row[2] == value) {
        return Err(TableError::ConstantEffort {
            path: path.to_owned(),
            column: columns.effort.clone(),
            value,
        });
    }
    Ok(on_a_grid(&rows, kind))
}

fn csv_reader(bytes: &[u8], separator: u8) -> csv::Reader<&[u8]> {
    csv::ReaderBuilder::new()
        .trim(csv::Trim::All)
        .delimiter(separator)
        .from_reader(bytes)
}

/// The separator that gives most of the wanted columns, then most columns at all; and the header by it.
fn separated(bytes: &[u8], wanted: [&String; 3]) -> Result<(u8, Vec<String>), csv::Error> {
    let mut best = (0, 0);
    let mut found = (b',', Vec::new());
    for separator in [b',', b';', b'\t'] {
        let header = csv_reader(bytes, separator).headers()?.clone();
        let there: Vec<String> = header.iter().map(str::to_owned).collect();
        let count = wanted.iter().filter(|name| there.contains(name)).count();
        if (count, there.len()) > best {
            best = (count, there.len());
            found = (separator, there);
        }
    }
    Ok(found)
}

fn on_a_grid(rows: &[[f64; 3]], kind: JointKind) -> JointSamples {
    let steps: Vec<f64> = rows.windows(2).map(|w| w[1][0] - w[0][0]).collect();
    // The mean within 1 % of the median keeps a nominally uniform table uniform over its whole length.
    let median = quantile(&steps, 0.5);
    let regular: Vec<f64> = steps
        .iter()
        .copied()
        .filter(|s| (s / median - 1.0).abs() < 0.5)
        .collect();
    let period = regular.iter().sum::<f64>() / regular.len().max(1) as f64;
    let mut out = JointSamples {
        kind,
        period,
        runs: Vec::new(),
        time: Vec::new(),
        q: Vec::new(),
        tau: Vec::new(),
        noise_of_q: Vec::new(),
        aside: crate::samples::Aside::default(),
    };
    let start = rows[0][0];
    let mut from = 0;
    for (i, step) in steps.iter().chain(&[f64::INFINITY]).enumerate() {
        if *step > 3.0 * median {
            append(&mut out, &rows[from..=i], start);
            from = i + 1;
        }
    }
    let mean = out.aside.interpolated[0] / out.time.len().max(1) as f64;
    out.aside.interpolated = [mean; 2];
    out
}

/// One piece without gaps: as it is when its steps are even, else interpolated.
fn append(out: &mut JointSamples, piece: &[[f64; 3]], start: f64) {
    let begin = out.time.len();
    let (first, last) = (piece[0][0], piece[piece.len() - 1][0]);
    let even = piece
        .iter()
        .enumerate()
        .all(|(i, r)| (r[0] - first - i as f64 * out.period).abs() < 0.2 * out.period);
    if even {
        for row in piece {
            out.time.push(row[0] - start);
            out.q.push(row[1]);
            out.tau.push(row[2]);
        }
    } else {
        let mut at = 0;
        let count = ((last - first) / out.period).floor() as usize + 1;
        for k in 0..count {
            let t = first + k as f64 * out.period;
            while at + 2 < piece.len() && piece[at + 1][0] <= t {
                at += 1;
            }
            let (a, b) = (&piece[at], &piece[(at + 1).min(piece.len() - 1)]);
            let part = if b[0] > a[0] {
                ((t - a[0]) / (b[0] - a[0])).clamp(0.0, 1.0)
            } else {
                0.0
            };
            out.time.push(t - start);
            out.aside.interpolated[0] += 2.0 * part * (1.0 - part);
            out.q.push(a[1] + part * (b[1] - a[1]));
            out.tau.push(a[2] + part * (b[2] - a[2]));
        }
    }
    out.runs.push(begin..out.time.len());
}

#[cfg(test)]
mod tests;
