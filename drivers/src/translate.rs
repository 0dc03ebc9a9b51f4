//! One-way translation of a device clock to the host clock, causal, by the lower convex envelope.
//!
//! A frame is never delivered before it was sent, so with `x` the device's instant and `y` the arrival, the line
//! `y = x + offset + skew x` runs below all points (x, y). The points that came fastest touch it: the estimate is an
//! edge of the lower convex hull of the points of a sliding window, the one over the middle of the window, extended to
//! the newest point. An edge's line lies below every point of its hull, so no translation is later than its arrival.
//!
//! ```text
//! t_host = t_device + offset + skew (t_device - t_support) - link_delay,   |skew| <= max_skew
//! ```
//!
//! The window slides by two hulls: the newer one takes over when the older is a window long and is by then half a window
//! long. While the window is shorter than 5 s the skew is drawn towards 0, because an edge of a short window
//! shows jitter and not skew. One observation costs O(1) amortised for the hull and a binary search in at most 256 vertices.
//!
//! It cannot see a constant delay of the link, nor a delay that is never short.
//!
//! # Source
//! Zhang, Liu, Xia, INFOCOM 2002; interop.md 5.2.

use std::time::Duration;

use ft_wire::HostTime;

mod counted;
mod hull;
mod smooth;

pub use counted::{Counted, CountedInstant, Handover};
use hull::{Hull, Line};
pub use smooth::smooth;

/// Device time after which the skew is wholly the hull's, s.
const TRUSTED_AFTER_S: f64 = 5.0;
/// Observations that the expected jitter weighs.
const PRIOR_OBSERVATIONS: f64 = 10.0;
/// Observations over which the mean residual is taken.
const RESIDUAL_MEMORY: f64 = 1_000.0;
/// A clock was set back when every sample comes later than the envelope by this and by so many mean residuals ...
const SET_BACK_NS: f64 = 2e6;
const SET_BACK_RESIDUALS: f64 = 4.0;
/// ... through so many samples (and [`OneWayConfig::set_back_after`]), or when so many in a row, each later than the one
/// before, are older than the newest.
const SET_BACK_SAMPLES: u32 = 8;

/// How to translate.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OneWayConfig {
    /// Length of the sliding window. Default 60 s.
    pub window: Duration,
    /// Bound of the skew, parts per million. Default 500; crystals keep within 100.
    pub max_skew_ppm: f64,
    /// Constant delay from sample to arrival (sensor's filter, transmission), subtracted. Default 0.
    pub link_delay: Duration,
    /// A disagreement of device clock and prediction beyond this is a restart of the device. Default 1 s.
    pub restart_threshold: Duration,
    /// A clock that was set back by less shows when all samples come late for so long: then the translator begins anew. Until
    /// then stamps are too early by as much as the clock was set back. Default 500 ms.
    pub set_back_after: Duration,
    /// Jitter to expect before any is seen; it only sets the first spreads. Default 1 ms.
    pub expected_jitter: Duration,
}

impl Default for OneWayConfig {
    fn default() -> Self {
        Self {
            window: Duration::from_secs(60),
            max_skew_ppm: 500.0,
            link_delay: Duration::ZERO,
            restart_threshold: Duration::from_secs(1),
            set_back_after: Duration::from_millis(500),
            expected_jitter: Duration::from_millis(1),
        }
    }
}

/// Where a device instant falls on the host clock.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Translated {
    /// Best estimate; never later than the arrival.
    pub at: HostTime,
    /// One standard deviation of `at`, estimated from jitter and number of observations. Does not cover the constant
    /// link delay, which one-way stamps cannot show.
    pub spread: Duration,
}

/// What is known of a device clock: `t_host = t_device + offset` now, growing by `skew` of the device time from here.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ClockStatus {
    /// Host clock minus device clock at the newest observation, ns; `link_delay` is subtracted.
    pub offset_ns: i64,
    /// How much faster the host clock runs than the device's, parts per million.
    pub skew_ppm: f64,
    /// Spread of the newest translation, ns.
    pub spread_ns: i64,
    /// Observations since the last reset.
    pub observations: u64,
}

/// Translates the stamps of one device clock.
#[derive(Debug)]
pub struct OneWay {
    config: OneWayConfig,
    active: Hull,
    successor: Hull,
    /// Times that the device clock was forgotten.
    resets: u32,
    observations: u64,
    mean_residual_ns: f64,
    line: Option<Line>,
    newest: Option<Newest>,
    /// An unbroken run of samples that lie behind the prediction.
    behind: Option<Behind>,
    /// An unbroken, growing run of samples that are older than the newest.
    older: Option<Older>,
}

#[derive(Clone, Copy, Debug)]
struct Behind {
    since: HostTime,
    /// What counted as behind when the run began; the run itself is not to move it.
    limit_ns: f64,
    samples: u32,
}

#[derive(Clone, Copy, Debug)]
struct Older {
    device_ns: i64,
    samples: u32,
}

#[derive(Clone, Copy, Debug)]
struct Newest {
    device_ns: i64,
    translated: Translated,
}

impl OneWay {
    /// A translator that knows nothing yet. Allocates all it will ever need.
    #[must_use]
    pub fn new(config: OneWayConfig) -> Self {
        Self {
            config,
            active: Hull::new(),
            successor: Hull::new(),
            resets: 0,
            observations: 0,
            mean_residual_ns: 0.0,
            line: None,
            newest: None,
            behind: None,
            older: None,
        }
    }

    /// Forgets the device clock, after a restart of the device or a pause.
    pub fn reset(&mut self) {
        self.active.clear();
        self.successor.clear();
        self.resets = self.resets.wrapping_add(1);
        (self.observations, self.mean_residual_ns) = (0, 0.0);
        (self.line, self.newest) = (None, None);
        (self.behind, self.older) = (None, None);
    }

    /// Takes a sample's instant on the unwrapped device clock, ns, and its arrival, and translates it.
    ///
    /// For growing `device_ns` and arrivals that do not go back, the answers do not go back. A late sample (smaller
    /// `device_ns`) is translated without being learned from; the newest stamp again gets the same answer again.
    /// A device clock that jumps against the prediction by more than the threshold resets the translator, and so does one
    /// that was set back by less, as soon as that shows.
    pub fn observe(&mut self, device_ns: i64, arrival: HostTime) -> Translated {
        if self.restarted(device_ns, arrival) {
            self.reset();
        }
        if let Some(newest) = self.newest
            && device_ns <= newest.device_ns
        {
            return self.translate_older(device_ns, arrival, newest);
        }
        self.learn(device_ns, arrival);
        let line = self.fit();
        self.line = Some(line);
        let residual = arrival.as_nanos().saturating_sub(line.at(device_ns));
        let weight = (self.observations as f64).min(RESIDUAL_MEMORY);
        self.mean_residual_ns += (residual as f64 - self.mean_residual_ns) / weight;
        let mut at = self.delayed(line.at(device_ns));
        if let Some(newest) = self.newest {
            at = at.max(newest.translated.at);
        }
        let translated = Translated {
            at: at.min(arrival),
            spread: self.spread(),
        };
        self.newest = Some(Newest {
            device_ns,
            translated,
        });
        translated
    }

    /// What is known of the device clock; `None` before the first observation.
    #[must_use]
    pub fn status(&self) -> Option<ClockStatus> {
        let (line, newest) = (self.line?, self.newest?);
        Some(ClockStatus {
            offset_ns: self
                .delayed(line.at(newest.device_ns))
                .as_nanos()
                .saturating_sub(newest.device_ns),
            skew_ppm: line.slope * 1e6,
            spread_ns: i64::try_from(newest.translated.spread.as_nanos()).unwrap_or(i64::MAX),
            observations: self.observations,
        })
    }

    fn translate_older(&self, device_ns: i64, arrival: HostTime, newest: Newest) -> Translated {
        let at = match self.line {
            Some(line) if device_ns < newest.device_ns => self.delayed(line.at(device_ns)),
            _ => newest.translated.at,
        };
        Translated {
            at: at.min(newest.translated.at).min(arrival),
            ..newest.translated
        }
    }

    fn delayed(&self, host_ns: i64) -> HostTime {
        HostTime::from_nanos(host_ns) - self.config.link_delay
    }

    fn restarted(&mut self, device_ns: i64, arrival: HostTime) -> bool {
        let (Some(line), Some(newest)) = (self.line, self.newest) else {
            return false;
        };
        let threshold = nanos(self.config.restart_threshold);
        if device_ns < newest.device_ns.saturating_sub(threshold) {
            return true;
        }
        let behind = arrival.as_nanos().saturating_sub(line.at(device_ns));
        if behind < -threshold {
            return true;
        }
        self.was_set_back(device_ns, behind, arrival, newest)
    }

    /// A stalled link catches up in no time and a frame that was overtaken is one; a clock that was set back, or stood still,
    /// stays behind.
    fn was_set_back(
        &mut self,
        device_ns: i64,
        behind: i64,
        arrival: HostTime,
        newest: Newest,
    ) -> bool {
        let older = (device_ns < newest.device_ns).then(|| {
            let before = self.older.filter(|older| older.device_ns < device_ns);
            Older {
                device_ns,
                samples: before.map_or(0, |older| older.samples) + 1,
            }
        });
        self.older = older;
        if older.is_some_and(|older| older.samples >= SET_BACK_SAMPLES) {
            return true;
        }
        let mut run = self.behind.unwrap_or(Behind {
            since: arrival,
            limit_ns: SET_BACK_NS.max(SET_BACK_RESIDUALS * self.mean_residual_ns),
            samples: 0,
        });
        if behind as f64 <= run.limit_ns {
            self.behind = None;
            return false;
        }
        run.samples = run.samples.saturating_add(1);
        self.behind = Some(run);
        run.samples > SET_BACK_SAMPLES
            && arrival.saturating_since(run.since) > self.config.set_back_after
    }

    fn learn(&mut self, device_ns: i64, arrival: HostTime) {
        let window = nanos(self.config.window);
        if self.active.span_to(device_ns) >= window {
            core::mem::swap(&mut self.active, &mut self.successor);
            self.successor.clear();
        }
        self.active.add(device_ns, arrival.as_nanos());
        if self.active.span_to(device_ns) >= window / 2 {
            self.successor.add(device_ns, arrival.as_nanos());
        }
        self.observations += 1;
    }

    fn fit(&self) -> Line {
        let bound = self.config.max_skew_ppm.abs() * 1e-6;
        let slope = (self.trust() * self.active.middle_slope()).clamp(-bound, bound);
        self.active.support(slope)
    }

    /// How much of the hull's slope is believed, 0 to 1.
    fn trust(&self) -> f64 {
        (self.active.span_s() / TRUSTED_AFTER_S).powi(2).min(1.0)
    }

    fn spread(&self) -> Duration {
        let n = self.active.observations() as f64;
        let expected = nanos(self.config.expected_jitter) as f64;
        let jitter =
            (self.mean_residual_ns * n + expected * PRIOR_OBSERVATIONS) / (n + PRIOR_OBSERVATIONS);
        // The envelope nears the true line as more samples come; the edge's slope, over half a window, doubles its variance.
        let envelope = jitter * (2.0 / n.max(1.0)).sqrt();
        // A skew that is not yet believed may be anywhere within its bound.
        let skew = (1.0 - self.trust()) * self.config.max_skew_ppm * 1e-6 / 3.0_f64.sqrt();
        let drift = skew * self.active.span_s() * 0.5e9;
        Duration::from_secs_f64(envelope.hypot(drift).clamp(0.0, 1e15) * 1e-9)
    }
}

fn nanos(duration: Duration) -> i64 {
    i64::try_from(duration.as_nanos()).unwrap_or(i64::MAX)
}

#[cfg(test)]
mod tests;
