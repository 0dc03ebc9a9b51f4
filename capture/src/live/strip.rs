//! Force and torque for drawing: the least and the greatest of each short bin, so that no peak is lost.

use std::time::Duration;

/// The length of a bin.
pub const BIN: Duration = Duration::from_millis(10);
/// Bins that may wait to be taken; older ones make room.
const MOST: usize = 64;
/// A sample that is this long before the open bin, ns, is not late: the source's clock stepped back, or was far ahead for a moment.
const STEP_NS: i64 = 1_000_000_000;

/// One bin: fx fy fz (N), tx ty tz (N m).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bin {
    /// Its begin, ns since the Unix epoch, a multiple of [`BIN`].
    pub begin_ns: i64,
    /// The least of each component.
    pub least: [f32; 6],
    /// The greatest of each component.
    pub greatest: [f32; 6],
}

/// Turns samples into bins.
#[derive(Debug, Default)]
pub struct Decimator {
    open: Option<Bin>,
    done: Vec<Bin>,
}

impl Decimator {
    /// Takes a sample of `at_ns`; one that is up to a second earlier than the open bin goes into the open bin.
    pub fn take(&mut self, at_ns: i64, values: [f64; 6]) {
        #[allow(clippy::cast_possible_truncation, reason = "for drawing")]
        let values = values.map(|value| value as f32);
        let length = i64::try_from(BIN.as_nanos()).unwrap_or(i64::MAX);
        let begin_ns = at_ns - at_ns.rem_euclid(length);
        match &mut self.open {
            Some(open)
                if begin_ns <= open.begin_ns
                    && open.begin_ns.saturating_sub(begin_ns) <= STEP_NS =>
            {
                open.widen(values);
            }
            open => {
                let before = open.replace(Bin {
                    begin_ns,
                    least: values,
                    greatest: values,
                });
                if self.done.len() == MOST {
                    self.done.remove(0);
                }
                self.done.extend(before);
            }
        }
    }

    /// The bins that are complete and were not yet taken.
    pub fn drain(&mut self) -> std::vec::Drain<'_, Bin> {
        self.done.drain(..)
    }
}

impl Bin {
    fn widen(&mut self, values: [f32; 6]) {
        for ((least, greatest), value) in self.least.iter_mut().zip(&mut self.greatest).zip(values)
        {
            *least = least.min(value);
            *greatest = greatest.max(value);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_peak_of_one_sample_is_in_its_bin() {
        let mut strip = Decimator::default();
        for index in 0..240_i64 {
            let value = if index == 77 { -40.0 } else { index as f64 };
            strip.take(index * 125_000, [value; 6]);
        }
        let bins: Vec<_> = strip.drain().collect();
        assert_eq!(bins.len(), 2, "the third is still open");
        assert_eq!(bins[0].least[0], -40.0);
        assert_eq!(bins[0].greatest[0], 79.0);
        assert_eq!((bins[1].begin_ns, bins[1].least[5]), (10_000_000, 80.0));
    }

    #[test]
    fn nobody_who_takes_costs_no_memory() {
        let mut strip = Decimator::default();
        for index in 0..1000 {
            strip.take(index * 10_000_000, [0.0; 6]);
        }
        assert_eq!(strip.drain().len(), MOST);
    }

    #[test]
    fn a_sample_that_is_late_widens_the_open_bin() {
        let mut strip = Decimator::default();
        strip.take(25_000_000, [1.0; 6]);
        strip.take(9_000_000, [7.0; 6]);
        strip.take(31_000_000, [0.0; 6]);
        assert_eq!(strip.drain().next().unwrap().greatest[2], 7.0);
    }

    #[test]
    fn a_clock_that_steps_back_does_not_stop_the_strip() {
        let mut strip = Decimator::default();
        strip.take(90_000_000_000, [0.0; 6]);
        for index in 0..5 {
            strip.take(index * 10_000_000, [0.0; 6]);
        }
        let begins: Vec<_> = strip.drain().map(|bin| bin.begin_ns).collect();
        assert_eq!(
            begins,
            [90_000_000_000, 0, 10_000_000, 20_000_000, 30_000_000]
        );
    }
}
