//! Rows of a table by their stamps, and what of them is left out.

use std::fmt;

use ft_recording::{Pose7, Stamped};
use serde::Serialize;

use super::RowTime;
use crate::import::ImportError;
use crate::import::order::{SET_BACK, in_order};
use crate::import::table::{LAST_INSTANT, Table};

/// What became of a table's rows.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct RowCounts {
    /// Rows of the file.
    pub rows: u64,
    /// Rows with an empty field or one that is not finite, or cut short: left out.
    pub no_value: u64,
    /// Rows whose stamp is before 1970 or after 2096: left out.
    pub no_stamp: u64,
    /// Rows of another time, hours from the most, or some few with holes of 10 s around them: left out.
    pub far: u64,
    /// Rows that, put in their places, are not later than the one before: left out.
    pub not_later: u64,
    /// Rows by a clock that was set back, or by the one before it, whichever are fewer: left out.
    pub set_back: u64,
    /// Rows whose quaternion has a length that is not near 1: left out.
    pub no_rotation: u64,
    /// Length of the first such quaternion.
    pub quaternion_length: Option<f64>,
    /// Rows that stood elsewhere than by their stamps: put in their places.
    pub moved: u64,
}

impl RowCounts {
    /// All rows that are left out.
    #[must_use]
    pub const fn left_out(&self) -> u64 {
        self.no_value + self.no_stamp + self.far + self.not_later + self.set_back + self.no_rotation
    }

    /// A pose of these numbers, if they are one.
    pub(super) fn pose(&mut self, numbers: [f64; 7]) -> Option<Pose7> {
        let [x, y, z, rotation @ ..] = numbers;
        let length = rotation.iter().map(|q| q * q).sum::<f64>().sqrt();
        let pose = Pose7::normalised([x, y, z], rotation);
        if pose.is_none() {
            self.no_rotation += 1;
            self.quaternion_length.get_or_insert(length);
        }
        pose
    }

    /// Rows of `table` by time, as `value` makes them of their finite numbers.
    pub(super) fn read<T: PartialEq, const N: usize>(
        table: &Table,
        time: &RowTime,
        columns: [crate::import::table::Column; N],
        mut value: impl FnMut(&mut Self, [f64; N]) -> Option<T>,
    ) -> Result<(Vec<Stamped<T>>, Self), ImportError> {
        let mut counts = Self {
            rows: table.len() as u64 + table.cut_rows(),
            no_value: table.cut_rows(),
            ..Self::default()
        };
        let mut rows = Vec::with_capacity(table.len());
        for row in 0..table.len() {
            let numbers = table.numbers(row, columns)?;
            let stamp = stamp(table, row, time)?;
            let (Some(at), true) = (stamp, numbers.iter().all(|number| number.is_finite())) else {
                counts.no_value += 1;
                continue;
            };
            if !(0..=LAST_INSTANT).contains(&at) {
                counts.no_stamp += 1;
                continue;
            }
            rows.extend(value(&mut counts, numbers).map(|value| (at, value)));
        }
        let ordered = in_order(rows);
        counts.far = ordered.far;
        counts.moved = ordered.moved;
        counts.not_later = ordered.repeated;
        counts.set_back = ordered.set_back;
        let samples = ordered.stamped();
        if samples.is_empty() {
            return Err(ImportError::Content {
                path: table.path().to_owned(),
                reason: format!("no row of it can be used: {counts}"),
            });
        }
        Ok((samples, counts))
    }
}

/// When a row was true, ns; `None` where its field says nothing.
fn stamp(table: &Table, row: usize, time: &RowTime) -> Result<Option<i64>, ImportError> {
    let (name, unit_ns) = match time {
        RowTime::Rate(hz) => {
            let at = crate::import::shifted(super::UNKNOWN_BEGIN, row as f64 / hz);
            return Ok(Some(at.as_nanos()));
        }
        RowTime::Column(name, unit_ns) => (name, *unit_ns),
    };
    let column = table.column(name)?;
    // Whole numbers stay exact.
    if let Ok(whole) = table.number::<i64>(row, column) {
        return Ok(Some(whole.saturating_mul(unit_ns)));
    }
    let number = table.float(row, column)?;
    Ok((!number.is_nan()).then(|| crate::import::nanos(number * unit_ns as f64 * 1e-9)))
}

impl fmt::Display for RowCounts {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let parts = [
            (
                self.no_value,
                "with a field that is empty, missing or not finite",
            ),
            (
                self.no_stamp,
                "stamped before 1970 or after 2096 (--time-unit says what the numbers are)",
            ),
            (self.far, "stamped at another time than the most"),
            (self.not_later, "not later than the one before"),
            (self.set_back, SET_BACK),
        ];
        let mut texts: Vec<String> = parts
            .into_iter()
            .filter(|(count, _)| *count > 0)
            .map(|(count, what)| format!("{count} {what}"))
            .collect();
        if let Some(length) = self.quaternion_length {
            texts.push(format!(
                "{} with a quaternion of another length than 1 (the first: {length:.3})",
                self.no_rotation
            ));
        }
        if texts.is_empty() {
            return write!(f, "there is none");
        }
        write!(f, "{}", texts.join(", "))
    }
}
