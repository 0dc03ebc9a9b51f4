//! Instants on the host clock, and counters of devices unwrapped.
//!
//! A [`HostTime`] is nanoseconds since the Unix epoch on a clock that never steps back within a recording: it is
//! anchored to the system's real-time clock once and runs on the monotonic clock from there.

use core::fmt;
use core::marker::PhantomData;
use core::ops::{Add, Sub};
use core::time::Duration;

/// An instant on the host clock, ns since the Unix epoch.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct HostTime(i64);

impl HostTime {
    /// The Unix epoch.
    pub const EPOCH: Self = Self(0);
    /// The latest instant; a deadline that never comes.
    pub const FAR_FUTURE: Self = Self(i64::MAX);

    /// The instant `nanos` after the Unix epoch.
    #[must_use]
    pub const fn from_nanos(nanos: i64) -> Self {
        Self(nanos)
    }

    /// Nanoseconds since the Unix epoch.
    #[must_use]
    pub const fn as_nanos(self) -> i64 {
        self.0
    }

    /// Seconds since `earlier`, negative when `self` comes first.
    #[must_use]
    pub fn seconds_since(self, earlier: Self) -> f64 {
        self.0.saturating_sub(earlier.0) as f64 * 1e-9
    }

    /// Time since `earlier`, zero when `self` comes first.
    #[must_use]
    pub fn saturating_since(self, earlier: Self) -> Duration {
        Duration::from_nanos(u64::try_from(self.0.saturating_sub(earlier.0)).unwrap_or(0))
    }

    /// `self` moved by `seconds`, which may be negative; saturates at the ends.
    #[must_use]
    pub fn offset_by_seconds(self, seconds: f64) -> Self {
        // A float to integer `as` saturates, and NaN becomes zero.
        #[allow(clippy::cast_possible_truncation)]
        Self(self.0.saturating_add((seconds * 1e9).round() as i64))
    }
}

impl Add<Duration> for HostTime {
    type Output = Self;
    fn add(self, step: Duration) -> Self {
        Self(
            self.0
                .saturating_add(i64::try_from(step.as_nanos()).unwrap_or(i64::MAX)),
        )
    }
}

impl Sub<Duration> for HostTime {
    type Output = Self;
    fn sub(self, step: Duration) -> Self {
        Self(
            self.0
                .saturating_sub(i64::try_from(step.as_nanos()).unwrap_or(i64::MAX)),
        )
    }
}

impl fmt::Display for HostTime {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "{}.{:09}",
            self.0.div_euclid(1_000_000_000),
            self.0.rem_euclid(1_000_000_000)
        )
    }
}

/// A device's own counter, unwrapped. `D` names the device clock, so that ticks of two clocks never mix.
pub struct DeviceTicks<D> {
    ticks: i64,
    clock: PhantomData<D>,
}

impl<D> DeviceTicks<D> {
    /// `ticks` of the clock `D`, in the unit that `D` documents.
    #[must_use]
    pub const fn new(ticks: i64) -> Self {
        Self {
            ticks,
            clock: PhantomData,
        }
    }

    /// The unwrapped count, in the unit that `D` documents.
    #[must_use]
    pub const fn count(self) -> i64 {
        self.ticks
    }
}

impl<D> Clone for DeviceTicks<D> {
    fn clone(&self) -> Self {
        *self
    }
}
impl<D> Copy for DeviceTicks<D> {}
impl<D> PartialEq for DeviceTicks<D> {
    fn eq(&self, other: &Self) -> bool {
        self.ticks == other.ticks
    }
}
impl<D> Eq for DeviceTicks<D> {}
impl<D> fmt::Debug for DeviceTicks<D> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "DeviceTicks({})", self.ticks)
    }
}

/// Unwraps a counter of `bits` bits (at most 32) into an `i64`.
///
/// A step of less than half the range forward is taken as forward, anything else as a step back, so late frames unwrap
/// right too. A silence longer than half the range is not seen: 35 min for a 32-bit microsecond counter.
#[derive(Clone, Copy, Debug)]
pub struct Unwrapper {
    bits: u32,
    last: Option<i64>,
}

impl Unwrapper {
    /// An unwrapper for a counter of `bits` bits; more than 32 are taken as 32.
    #[must_use]
    pub const fn new(bits: u32) -> Self {
        Self {
            bits: if bits > 32 { 32 } else { bits },
            last: None,
        }
    }

    /// The unwrapped value of `raw`; the first one is `raw` itself.
    pub fn unwrap(&mut self, raw: u32) -> i64 {
        let modulus = 1_i64 << self.bits;
        let raw = i64::from(raw).rem_euclid(modulus);
        let value = match self.last {
            None => raw,
            Some(last) => {
                let step = (raw - last).rem_euclid(modulus);
                last + if step >= modulus / 2 {
                    step - modulus
                } else {
                    step
                }
            }
        };
        self.last = Some(self.last.map_or(value, |last| last.max(value)));
        value
    }

    /// Forgets the past, after a device restart.
    pub fn reset(&mut self) {
        self.last = None;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_wrap_goes_on_counting() {
        let mut unwrapper = Unwrapper::new(32);
        assert_eq!(unwrapper.unwrap(u32::MAX - 1), i64::from(u32::MAX) - 1);
        assert_eq!(unwrapper.unwrap(3), i64::from(u32::MAX) + 4);
    }

    #[test]
    fn a_late_frame_does_not_wrap() {
        let mut unwrapper = Unwrapper::new(16);
        assert_eq!(unwrapper.unwrap(100), 100);
        assert_eq!(unwrapper.unwrap(98), 98);
        assert_eq!(unwrapper.unwrap(101), 101);
    }

    #[test]
    fn seconds_are_signed() {
        let a = HostTime::from_nanos(1_500_000_000);
        let b = HostTime::from_nanos(500_000_000);
        assert_eq!(b.seconds_since(a), -1.0);
        assert_eq!(a.offset_by_seconds(-1.0), b);
        assert_eq!(a.to_string(), "1.500000000");
    }
}
