//! A clock made of the samples themselves, for sensors that sample evenly and send neither clock nor counter.
//!
//! The n-th sample was taken n periods after the first, so the number of samples is a device clock; [`OneWay`] translates it. The
//! period is learned from the lower hull of the first arrivals, which bursts do not bend.
//!
//! Samples that the driver knows to be lost are put on the count ([`Counted::pass`]). One that was lost without a trace leaves the
//! count a period behind: from then on even the promptest sample of each short window comes later than before. By how much is rounded
//! to whole periods and put on the count, on a prompt link; elsewhere only what is more than a period, because a link that polls is
//! late by up to that. A count that was put too far shows at the first prompt sample, which would come too early: for half a minute
//! (on CAN two seconds) such a sample takes it back, and for a second what the driver knew of. Nothing is learned while a guess is in
//! doubt, so that the line stays true.
//!
//! What is not known is part of the spread: by how much the promptest of the newest samples was late, because the count may be
//! behind by it, and the periods that were put on without being told, while they may be taken back.
//!
//! Samples that are lost without a trace while the period is learned make it wrong. By more than a skew can be: then the skew stands at its
//! bound, stamps are arrivals or too early, and after five seconds the period is mended by what the hull shows ([`Counted::mended`]
//! tells how often).
//!
//! It cannot see a silent loss in its first ten seconds otherwise, and of one on a link that polls, unless that was seen to be prompt
//! for two minutes on end, only the spread tells. Uneven sampling is taken for jitter of the link.

use core::time::Duration;

use ft_wire::HostTime;

use super::hull::{Hull, Line};
use super::{ClockStatus, OneWay, OneWayConfig, TRUSTED_AFTER_S, Translated, nanos};

/// The period is learned from so much time and so many samples.
const LEARN_NS: i64 = 2_000_000_000;
const LEARN_SAMPLES: u64 = 32;
/// While it is learned, a sample counts as this long, ns.
const UNIT_NS: i64 = 1_000_000;
/// A sample that is lost while the period is learned makes it this much wrong.
const MAX_SKEW_PPM: f64 = 2_000.0;
/// The line must be so old before lateness is taken for a loss, s.
const TRUSTED_S: f64 = 10.0;
/// Losses are looked for in windows of so much time and so many samples.
const WINDOW: Duration = Duration::from_millis(200);
const WINDOW_SAMPLES: u32 = 8;
/// Lateness is the least of so much time, and so many samples: the ends of bursts are in it.
const RECENT: Duration = Duration::from_millis(20);
const RECENT_SAMPLES: u32 = 8;
/// A link is called prompt when over so many windows the promptest sample of each was less late than this share of a period.
const PROMPT_WINDOWS: u32 = 600;
const PROMPT: f64 = 0.3;
/// Periods that the driver knew of are doubted for so long: too many show at the first prompt sample.
const TOLD_DOUBT: Duration = Duration::from_secs(1);
/// So many guesses are doubted apart.
const MOST_DOUBTED: usize = 8;

/// How a link hands over what arrives.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Handover {
    /// As it arrives: CAN, whose frames are stamped by the kernel or the adapter, or read at once.
    Prompt,
    /// When it is polled, or in bursts, which may be as far apart as the samples: serial lines behind USB.
    Polled,
}

impl Handover {
    /// How late the promptest sample of a window may come, in periods, for all that is known of the link.
    const fn usual(self) -> f64 {
        match self {
            Self::Prompt => PROMPT,
            Self::Polled => 1.0,
        }
    }

    /// How long a guess is doubted: until a link that was slow is prompt again, or the phase of bursts has moved.
    const fn doubt(self) -> Duration {
        match self {
            Self::Prompt => Duration::from_secs(2),
            Self::Polled => Duration::from_secs(30),
        }
    }
}

/// Translates the arrivals of one stream without a clock.
#[derive(Debug)]
pub struct Counted {
    clock: OneWay,
    handover: Handover,
    learning: Hull,
    samples: i64,
    /// Learned; `None` before that.
    period_ns: Option<f64>,
    /// The count, in ns.
    device_ns: f64,
    window: Option<Window>,
    /// How late the promptest sample of a window comes without a loss, in periods.
    usual: f64,
    /// The most of it, over so many windows.
    most: (f64, u32),
    /// That of the window before, as it came.
    before: Option<f64>,
    /// The newest samples.
    recent: Option<Window>,
    /// How late the promptest of those before was, in periods.
    recent_least: f64,
    /// Samples that the driver knows to be lost since the newest.
    passed: f64,
    /// Periods that the driver knew of, which may be too many.
    told: Doubted,
    /// Periods that lateness told.
    guessed: Doubted,
    /// Spread of the newest translation.
    spread: Duration,
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

impl Window {
    /// With one more sample.
    fn with(window: Option<Self>, arrival: HostTime, late_ns: f64) -> Self {
        let window = window.unwrap_or(Self {
            since: arrival,
            samples: 0,
            least_ns: late_ns,
        });
        Self {
            samples: window.samples + 1,
            least_ns: window.least_ns.min(late_ns),
            ..window
        }
    }

    fn is_full(&self, arrival: HostTime, samples: u32, time: Duration) -> bool {
        self.samples >= samples && arrival.saturating_since(self.since) >= time
    }
}

/// Periods put on the count, and until when an early sample may take them back.
#[derive(Debug)]
struct Doubted {
    time: Duration,
    /// (until when, periods); those of no periods are free.
    each: [(HostTime, f64); MOST_DOUBTED],
}

impl Doubted {
    const fn new(time: Duration) -> Self {
        Self {
            time,
            each: [(HostTime::EPOCH, 0.0); MOST_DOUBTED],
        }
    }

    const fn clear(&mut self) {
        *self = Self::new(self.time);
    }

    fn periods(&self) -> f64 {
        self.each.iter().map(|(_, periods)| periods).sum()
    }

    /// The oldest makes room.
    fn add(&mut self, periods: f64, arrival: HostTime) {
        let oldest = self.each.iter_mut().min_by_key(|(until, _)| *until);
        if let Some(oldest) = oldest {
            *oldest = (arrival + self.time, periods);
        }
    }

    fn forget_the_old(&mut self, arrival: HostTime) {
        for (until, periods) in &mut self.each {
            if arrival > *until {
                (*until, *periods) = (HostTime::EPOCH, 0.0);
            }
        }
    }

    /// Takes so many back, of those that are there, the newest first.
    fn take(&mut self, periods: f64) -> f64 {
        let wanted = periods.max(0.0);
        let mut left = wanted;
        self.each
            .sort_unstable_by_key(|(until, _)| core::cmp::Reverse(*until));
        for (_, there) in &mut self.each {
            let taken = left.min(*there);
            *there -= taken;
            left -= taken;
        }
        wanted - left
    }
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
    pub fn new(config: OneWayConfig, handover: Handover) -> Self {
        Self {
            clock: OneWay::new(Self::bounds(config)),
            handover,
            learning: Hull::new(),
            samples: 0,
            period_ns: None,
            device_ns: 0.0,
            window: None,
            usual: handover.usual(),
            most: (0.0, 0),
            before: None,
            recent: None,
            recent_least: 0.0,
            passed: 0.0,
            told: Doubted::new(TOLD_DOUBT),
            guessed: Doubted::new(handover.doubt()),
            spread: Duration::ZERO,
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
        self.look_anew();
        self.judge_anew();
        self.told.clear();
        self.guessed.clear();
        self.passed = 0.0;
        self.newest = HostTime::EPOCH;
    }

    /// What is known of the clock that the counts make; `None` while the period is learned.
    #[must_use]
    pub fn status(&self) -> Option<ClockStatus> {
        Some(ClockStatus {
            spread_ns: nanos(self.spread),
            ..self.clock.status()?
        })
    }

    /// So many samples were taken between the newest and the next, and do not come.
    pub fn pass(&mut self, samples: u64) {
        // Before the first one there is nothing to count from.
        if self.period_ns.is_some() {
            self.passed += samples as f64;
        } else if self.samples > 0 {
            self.samples = self.samples.saturating_add_unsigned(samples);
        }
    }

    /// Takes the arrival of the next sample; `None` while the period is learned, for 2 s or more. No answer is later than its
    /// arrival, and while arrivals do not go back the answers do not either.
    pub fn observe(&mut self, arrival: HostTime) -> Option<CountedInstant> {
        let Some(period_ns) = self.period_ns else {
            self.learn(arrival);
            return None;
        };
        self.device_ns += period_ns;
        let passed = core::mem::take(&mut self.passed);
        if passed > 0.0 {
            self.device_ns += passed * period_ns;
            self.told.add(passed, arrival);
        }
        self.look_for_losses(arrival, period_ns);
        let device_ns = whole(self.device_ns);
        let translated = match self.held(device_ns, arrival) {
            Some(translated) => translated,
            None => self.clock.observe(device_ns, arrival),
        };
        let at = translated.at.max(self.newest).min(arrival);
        self.newest = at;
        let periods = self.periods;
        let behind = self.before.unwrap_or(0.0).max(self.recent_least).max(0.0);
        let unsure_s = behind.hypot(self.guessed.periods()) * period_ns * 1e-9;
        let spread = translated.spread.as_secs_f64().hypot(unsure_s).min(1e6);
        self.spread = Duration::from_secs_f64(spread);
        self.mend(device_ns, period_ns);
        Some(CountedInstant {
            device_ns,
            translated: Translated {
                at,
                spread: self.spread,
            },
            periods,
        })
    }

    /// Whether the link is prompt.
    fn judge_anew(&mut self) {
        (self.usual, self.most) = (self.handover.usual(), (0.0, 0));
    }

    /// After the count or the line became another.
    fn look_anew(&mut self) {
        (self.window, self.before) = (None, None);
        (self.recent, self.recent_least) = (None, 0.0);
    }

    fn learn(&mut self, arrival: HostTime) {
        self.learning
            .add(self.samples.saturating_mul(UNIT_NS), arrival.as_nanos());
        self.samples = self.samples.saturating_add(1);
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
        if self.guessed.periods() > 0.0
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
        self.look_anew();
        self.judge_anew();
        self.mended = self.mended.saturating_add(1);
        self.periods = self.periods.wrapping_add(1);
    }

    /// By the line as it stands, while a guess is in doubt.
    fn held(&self, device_ns: i64, arrival: HostTime) -> Option<Translated> {
        let (line, newest) = (self.clock.line?, self.clock.newest?);
        if self.guessed.periods() == 0.0 {
            return None;
        }
        // What the slope is wrong by adds up.
        let held_s = device_ns.saturating_sub(newest.device_ns) as f64 * 1e-9;
        let grown = 1.0 + (held_s / self.clock.active.span_s().max(1.0)).max(0.0);
        Some(Translated {
            at: self.clock.delayed(line.at(device_ns)).min(arrival),
            spread: newest.translated.spread.mul_f64(grown.min(1e3)),
        })
    }

    /// Learns anew, but from where the line stands and with the period that it shows.
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
        let trusted = self.clock.active.span_s() >= TRUSTED_S;
        self.told.forget_the_old(arrival);
        let doubted = self.guessed.periods() > 0.0;
        self.guessed.forget_the_old(arrival);
        if doubted && self.guessed.periods() == 0.0 && self.handover == Handover::Polled {
            // The guess stands, and by now the hull has a hole, with bursts of another phase behind it.
            self.begin_from(line, whole(self.device_ns));
        }
        if trusted && self.take_back(-late_ns / period_ns, period_ns, line) {
            return;
        }
        let recent = Window::with(self.recent, arrival, late_ns);
        self.recent = Some(recent);
        if recent.is_full(arrival, RECENT_SAMPLES, RECENT) {
            self.recent = None;
            self.recent_least = recent.least_ns / period_ns;
        }
        let window = Window::with(self.window, arrival, late_ns);
        self.window = Some(window);
        if !window.is_full(arrival, WINDOW_SAMPLES, WINDOW) {
            return;
        }
        self.window = None;
        let least = window.least_ns / period_ns;
        let lost = if trusted { self.lost(least) } else { 0.0 };
        if lost > 0.0 {
            self.device_ns += lost * period_ns;
            self.guessed.add(lost, arrival);
            self.recent_least -= lost;
        } else {
            self.judge_promptness(least);
        }
        self.before = Some(least - lost);
    }

    /// Takes back what a sample that comes so many periods early shows to be too much: of what was guessed, as soon as it does; of what
    /// the driver told, whole periods, because a link may become faster by a part of one. Whether it did.
    fn take_back(&mut self, early: f64, period_ns: f64, line: Line) -> bool {
        let guessed = self.guessed.take((early - 0.25).ceil());
        let told = self.told.take((early - guessed - 0.1).round());
        let back = guessed + told;
        if back == 0.0 {
            return false;
        }
        self.device_ns -= back * period_ns;
        self.look_anew();
        if guessed > 0.0 {
            // It was no loss but the phase of bursts.
            self.judge_anew();
        }
        let newest = self
            .clock
            .newest
            .map_or(i64::MIN, |newest| newest.device_ns);
        if newest >= whole(self.device_ns) {
            // The line has learned the count as it was.
            self.begin_from(line, whole(self.device_ns));
        }
        true
    }

    fn judge_promptness(&mut self, least: f64) {
        let (most, windows) = (self.most.0.max(least), self.most.1 + 1);
        self.most = (most, windows);
        if windows >= PROMPT_WINDOWS {
            self.usual = if most < PROMPT {
                most
            } else {
                self.handover.usual()
            };
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
