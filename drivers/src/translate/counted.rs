//! A clock made of the samples themselves, for sensors that sample evenly and send neither clock nor counter.
//!
//! The n-th sample was taken n periods after the first, so the number of samples is a device clock; [`OneWay`] translates it. The
//! period is learned from the lower hull of the first arrivals, which bursts do not bend.
//!
//! A sample that was lost leaves the count one period behind: from then on even the promptest sample of each short window comes
//! later than before. By how much is rounded to whole periods and put on the count. A count that was put too far shows at the first
//! prompt sample, which would come too early; for half a minute after a loss nothing is learned, so that the line stays true meanwhile.
//!
//! Samples that are lost while the period is learned make it wrong. By more than a skew can be: then the skew stands at its bound, the
//! stamps are arrivals, and after five seconds the period is mended by what the hull shows ([`Counted::mended`] tells how often).
//!
//! It cannot see a single loss in its first ten seconds otherwise, and of a loss while the promptest samples come nearly in time although they may come up
//! to a period late (bursts) only what their phase shows later. Uneven sampling is taken for jitter of the link.

use core::time::Duration;

use ft_wire::HostTime;

use super::hull::{Hull, Line};
use super::{OneWay, OneWayConfig, TRUSTED_AFTER_S, Translated};

/// The period is learned from so much time and so many samples.
const LEARN_NS: i64 = 2_000_000_000;
const LEARN_SAMPLES: u64 = 32;
/// While it is learned, a sample counts as this long, ns.
const UNIT_NS: i64 = 1_000_000;
/// A sample that is lost while the period is learned makes it this much wrong.
const MAX_SKEW_PPM: f64 = 2_000.0;
/// The line must be so old before lateness is taken for a loss, s, ...
const TRUSTED_S: f64 = 10.0;
/// ... and nothing is learned for so long after one.
const PROBATION: Duration = Duration::from_secs(30);
/// Losses are looked for in windows of so much time and so many samples.
const WINDOW: Duration = Duration::from_millis(200);
const WINDOW_SAMPLES: u32 = 8;
/// A link is called prompt when over so many windows the promptest sample of each was less late than this share of a period.
const PROMPT_WINDOWS: u32 = 600;
const PROMPT: f64 = 0.3;

/// Translates the arrivals of one stream without a clock.
#[derive(Debug)]
pub struct Counted {
    clock: OneWay,
    learning: Hull,
    samples: i64,
    /// Learned; `None` before that.
    period_ns: Option<f64>,
    /// The count, in ns.
    device_ns: f64,
    window: Option<Window>,
    /// How late the promptest sample of a window comes without a loss, in periods: 1 unless the link is called prompt.
    usual: f64,
    /// The most of it, over so many windows.
    most: (f64, u32),
    /// That of the window before, as it came.
    before: Option<f64>,
    /// Until when the line is held after a loss.
    held_until: Option<HostTime>,
    newest: HostTime,
    /// Times that the period had to be mended.
    mended: u32,
    /// Times that the period became another.
    periods: u32,
}

/// The promptest sample since a window began.
#[derive(Clone, Copy, Debug)]
struct Window {
    since: HostTime,
    samples: u32,
    least_ns: f64,
}

/// A sample on the clock of counts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CountedInstant {
    /// Samples since the stream began, and the lost ones that were noticed, times the period, ns.
    pub device_ns: i64,
    /// Where that falls on the host clock.
    pub translated: Translated,
    /// How often the period had become another by then: a clock of counts bends there as no crystal does.
    pub periods: u32,
}

impl Counted {
    /// `config` for the clock that counts make: a period that was learned in two seconds is less exact than a crystal.
    #[must_use]
    pub fn bounds(config: OneWayConfig) -> OneWayConfig {
        OneWayConfig {
            // Losses are noticed here, before the count looks like a clock that was set back.
            set_back_after: Duration::from_secs(3),
            max_skew_ppm: config.max_skew_ppm.max(MAX_SKEW_PPM),
            ..config
        }
    }

    /// A translator that knows nothing yet. Allocates all it will ever need.
    #[must_use]
    pub fn new(config: OneWayConfig) -> Self {
        Self {
            clock: OneWay::new(Self::bounds(config)),
            learning: Hull::new(),
            samples: 0,
            period_ns: None,
            device_ns: 0.0,
            window: None,
            usual: 1.0,
            most: (0.0, 0),
            before: None,
            held_until: None,
            newest: HostTime::EPOCH,
            mended: 0,
            periods: 0,
        }
    }

    /// How often the period turned out to be wrong, because samples were lost while it was learned: until then, for five seconds or more,
    /// stamps were about arrivals.
    #[must_use]
    pub const fn mended(&self) -> u32 {
        self.mended
    }

    /// Forgets the stream, after a restart of the device or a pause.
    pub fn reset(&mut self) {
        self.clock.reset();
        self.learning.clear();
        (self.samples, self.device_ns, self.period_ns) = (0, 0.0, None);
        (self.window, self.before, self.held_until) = (None, None, None);
        (self.usual, self.most) = (1.0, (0.0, 0));
        self.newest = HostTime::EPOCH;
    }

    /// The clock that the counts make.
    #[must_use]
    pub const fn clock(&self) -> &OneWay {
        &self.clock
    }

    /// Takes the arrival of the next sample; `None` while the period is learned, for 2 s or more. No answer is later than its
    /// arrival, and while arrivals do not go back the answers do not either.
    pub fn observe(&mut self, arrival: HostTime) -> Option<CountedInstant> {
        let Some(period_ns) = self.period_ns else {
            self.learn(arrival);
            return None;
        };
        self.device_ns += period_ns;
        self.look_for_losses(arrival, period_ns);
        let device_ns = whole(self.device_ns);
        let translated = match self.held(device_ns, arrival) {
            Some(translated) => translated,
            None => self.clock.observe(device_ns, arrival),
        };
        let at = translated.at.max(self.newest).min(arrival);
        self.newest = at;
        let periods = self.periods;
        self.mend(device_ns, period_ns);
        Some(CountedInstant {
            device_ns,
            translated: Translated { at, ..translated },
            periods,
        })
    }

    fn learn(&mut self, arrival: HostTime) {
        self.learning
            .add(self.samples * UNIT_NS, arrival.as_nanos());
        self.samples += 1;
        let enough = self.learning.observations() >= LEARN_SAMPLES;
        if enough && self.learning.arrivals_span() >= LEARN_NS {
            let period_ns = UNIT_NS as f64 * (1.0 + self.learning.middle_slope());
            if period_ns > 0.0 {
                self.period_ns = Some(period_ns);
            }
            self.learning.clear();
            self.samples = 0;
        }
    }

    /// A skew at its bound is none: the period is wrong.
    fn mend(&mut self, device_ns: i64, period_ns: f64) {
        let slope = self.clock.active.middle_slope();
        let bound = 1e-6 * self.clock.config.max_skew_ppm;
        if self.held_until.is_some()
            || self.clock.active.span_s() < TRUSTED_AFTER_S
            || slope.abs() < bound
            || slope <= -1.0
        {
            return;
        }
        let line = self.clock.active.support(slope);
        let at = HostTime::from_nanos(line.at(device_ns));
        self.period_ns = Some(period_ns * (1.0 + slope));
        self.clock.reset();
        self.clock.observe(device_ns, at);
        (self.window, self.before) = (None, None);
        (self.usual, self.most) = (1.0, (0.0, 0));
        self.mended = self.mended.saturating_add(1);
        self.periods = self.periods.wrapping_add(1);
    }

    /// By the line as it stands, while it is held.
    fn held(&mut self, device_ns: i64, arrival: HostTime) -> Option<Translated> {
        let until = self.held_until?;
        let (line, newest) = (self.clock.line?, self.clock.newest?);
        if arrival > until {
            self.held_until = None;
            self.begin_from(line, device_ns);
            return None;
        }
        Some(Translated {
            at: self.clock.delayed(line.at(device_ns)).min(arrival),
            ..newest.translated
        })
    }

    /// Learns anew, because the hull has a hole by now, but from where the line stands and with the period that it shows.
    fn begin_from(&mut self, line: Line, device_ns: i64) {
        self.period_ns = self.period_ns.map(|period| period * (1.0 + line.slope));
        self.periods = self.periods.wrapping_add(1);
        let at = HostTime::from_nanos(line.at(device_ns));
        self.clock.reset();
        self.clock.observe(device_ns, at);
    }

    /// Puts the count forward when all samples of a window came later by whole periods, and back when one comes too early.
    fn look_for_losses(&mut self, arrival: HostTime, period_ns: f64) {
        let Some(line) = self.clock.line else { return };
        let predicted = line.at(whole(self.device_ns));
        let late_ns = arrival.as_nanos().saturating_sub(predicted) as f64;
        if self.held_until.is_some() && late_ns < -0.25 * period_ns {
            self.device_ns += (late_ns / period_ns).floor() * period_ns;
            (self.window, self.before) = (None, None);
            // It was no loss but the phase of bursts.
            (self.usual, self.most) = (1.0, (0.0, 0));
            return;
        }
        let mut window = self.window.unwrap_or(Window {
            since: arrival,
            samples: 0,
            least_ns: late_ns,
        });
        window.samples += 1;
        window.least_ns = window.least_ns.min(late_ns);
        self.window = Some(window);
        if window.samples < WINDOW_SAMPLES || arrival.saturating_since(window.since) < WINDOW {
            return;
        }
        self.window = None;
        let least = window.least_ns / period_ns;
        let lost = if self.clock.active.span_s() >= TRUSTED_S {
            self.lost(least)
        } else {
            0.0
        };
        if lost > 0.0 {
            self.device_ns += lost * period_ns;
            self.held_until = Some(arrival + PROBATION);
        } else {
            self.judge_promptness(least);
        }
        self.before = Some(least - lost);
    }

    fn judge_promptness(&mut self, least: f64) {
        let (most, windows) = (self.most.0.max(least), self.most.1 + 1);
        self.most = (most, windows);
        if windows >= PROMPT_WINDOWS {
            self.usual = if most < PROMPT { most } else { 1.0 };
            self.most = (0.0, 0);
        }
    }

    /// How many samples were lost when a window's promptest sample is `least` periods late. A step from the window before tells it,
    /// unless the phase of bursts may have begun anew; else the fewest that explain it count.
    fn lost(&self, least: f64) -> f64 {
        let usual = self.usual;
        let before = self.before.unwrap_or(least);
        let step = least - before;
        if step > 0.5 && least > usual + 0.15 && before > 0.4 * usual - 0.05 {
            step.round()
        } else if least > usual + 0.5 {
            (least - 0.5 * usual - 0.1).round()
        } else {
            0.0
        }
    }
}

/// A float to integer `as` saturates.
#[allow(clippy::cast_possible_truncation)]
fn whole(ns: f64) -> i64 {
    ns.round() as i64
}
