//! Kunwei KWR75 sensors on RS-422 or USB, 460 800 bit/s, streaming at 1 kHz.
//!
//! ```text
//! stop (not answered) -> Drain (quiet) -> start -> Streaming
//! ```
//!
//! **No check sum, no counter, no clock.** The driver trusts a stream once three frames follow each other at exact spacing, and
//! searches anew after each frame that is not where it must be. A sample that differs from both samples before it by more than
//! [`Config::max_step_n`] or [`Config::max_step_nm`] is delivered as [`Quality::Invalid`] with status bit 0 set: a suspect, such as a
//! flipped bit makes; the first one, which has none before it, when it differs so from both samples behind it. A flip that changes a
//! number by less is not seen; a sample lost as a whole leaves no trace and is not counted.
//!
//! **Sign**: unconfirmed on hardware; taken as environment on tool, [`Config::sign`] changes that.
//!
//! # Source
//! hardware.md 2.7, see [`ft_wire::kunwei_kwr75`].
//!
//! [`Quality::Invalid`]: crate::reading::Quality::Invalid

use std::time::Duration;

use ft_wire::kunwei_kwr75::{self as wire, Command, FRAME_LEN, NEWTONS_PER_KG, Sample};
use ft_wire::{Chunk, DecodeError, HostTime, Parsed, Wrench};

use crate::device::{Counted, Device};
use crate::framer::{Found, Framer};
use crate::link::RxStamps;
use crate::options::{Sign, Startup};
use crate::reading::{Counts, Reading, SampleInstant, WrenchReading};
use crate::stages::{Due, Stages, Timing, quality};

/// Bit rate of the line, bit/s.
pub const BAUD_BPS: u32 = 460_800;

/// Time between two samples.
const PERIOD: Duration = Duration::from_millis(1);
/// Frames in a row that make a stream.
const FRAMES_TO_LOCK: usize = 3;
/// Status bit of a suspect sample.
const SUSPECT: u32 = 1;

/// How to set the sensor up.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Config {
    /// Largest change of a force from one sample to the next that is believed, N. Default 20.
    pub max_step_n: f64,
    /// Largest change of a torque from one sample to the next that is believed, N m. Default 2.
    pub max_step_nm: f64,
    /// Which side's wrench the sensor reports. Default environment on tool; unconfirmed on hardware.
    pub sign: Sign,
    /// Set the sensor up, or only listen. Default set up.
    pub startup: Startup,
    /// Longest wait for the first sample, of three attempts. Default 300 ms.
    pub answer_timeout: Duration,
    /// Silence after which the stream counts as lost. Default 500 ms.
    pub silence_timeout: Duration,
    /// Pause between being lost and the next attempt. Default 1 s.
    pub retry_after: Duration,
}

impl Default for Config {
    fn default() -> Self {
        Self {
            max_step_n: 20.0,
            max_step_nm: 2.0,
            sign: Sign::default(),
            startup: Startup::default(),
            answer_timeout: Duration::from_millis(300),
            silence_timeout: Duration::from_millis(500),
            retry_after: Duration::from_secs(1),
        }
    }
}

/// The driver.
#[derive(Debug)]
pub struct KunweiKwr75 {
    config: Config,
    stages: Stages<Command>,
    framer: Framer,
    /// The two samples before, the newest first.
    before: [Option<[f64; 6]>; 2],
    last_at: HostTime,
}

/// A sample, and those behind it where it began the lock.
type Followed = (Sample, Option<[Sample; FRAMES_TO_LOCK - 1]>);

/// Reads a frame of the stream. Nothing here asks for single samples: a head that says so is a streamed one's with a flipped bit.
fn decode_streamed(bytes: &[u8]) -> Result<Parsed<Sample>, DecodeError> {
    match wire::decode(bytes)? {
        Parsed::Complete { value, .. } if value.asked => Err(DecodeError::Field {
            name: "head",
            value: bytes.first().copied().unwrap_or_default().into(),
        }),
        parsed => Ok(parsed),
    }
}

/// Reads a frame where one must be; elsewhere only one that others follow.
fn decode(bytes: &[u8], locked: bool) -> Result<Parsed<Followed>, DecodeError> {
    let Parsed::Complete { value, used } = decode_streamed(bytes)? else {
        return Ok(Parsed::Incomplete);
    };
    if locked {
        let value = (value, None);
        return Ok(Parsed::Complete { value, used });
    }
    let mut behind = [value; FRAMES_TO_LOCK - 1];
    for (frame, follower) in (1..).zip(&mut behind) {
        let rest = bytes.get(frame * FRAME_LEN..).unwrap_or_default();
        let Parsed::Complete { value, .. } = decode_streamed(rest)? else {
            return Ok(Parsed::Incomplete);
        };
        *follower = value;
    }
    let value = (value, Some(behind));
    Ok(Parsed::Complete { value, used })
}

/// N and N m.
fn values(sample: &Sample) -> [f64; 6] {
    let [fx, fy, fz] = sample.force_kg.map(f64::from);
    let [mx, my, mz] = sample.torque_kgm.map(f64::from);
    [fx, fy, fz, mx, my, mz].map(|value| value * NEWTONS_PER_KG)
}

fn near(values: [f64; 6], other: [f64; 6], limits: [f64; 6]) -> bool {
    let mut steps = values.iter().zip(other).zip(limits);
    steps.all(|((one, other), limit)| (one - other).abs() <= limit)
}

impl KunweiKwr75 {
    /// A driver that begins at its first `handle_timeout`.
    #[must_use]
    pub fn new(config: Config) -> Self {
        let timing = Timing {
            startup: config.startup,
            quiet: Duration::from_millis(50),
            drain_limit: Duration::from_millis(500),
            answer_timeout: config.answer_timeout,
            silence_timeout: config.silence_timeout,
            retry_after: config.retry_after,
        };
        let checks = "check bit rate (460800), cable and power";
        Self {
            config,
            stages: Stages::new(timing, Some(Command::Stop), checks),
            framer: Framer::new(),
            before: [None; 2],
            last_at: HostTime::EPOCH,
        }
    }

    fn on_sample(&mut self, (sample, behind): &Followed, arrival: HostTime) {
        if !self.stages.admits_sample(Some(Command::Start), arrival) {
            return;
        }
        self.framer.begin_counting();
        let values = values(sample);
        let suspect = self.is_suspect(values, behind.as_ref(), arrival);
        if suspect && self.stages.fresh_bits(SUSPECT) != 0 {
            let Config {
                max_step_n,
                max_step_nm,
                ..
            } = self.config;
            let text = format!(
                "a sample is more than {max_step_n} N or {max_step_nm} N m off the ones beside it: marked invalid, as all \
                 such are; frames have no check sum, look at cable and grounding"
            );
            self.stages.warn(text, arrival);
        }
        self.stages.deliver(Reading::Wrench(WrenchReading {
            at: SampleInstant {
                arrival,
                device_ns: None,
            },
            wrench: self.config.sign.apply(Wrench::from_array(values)),
            temperature_celsius: None,
            quality: quality(suspect, false),
            status_bits: if suspect { SUSPECT } else { 0 },
        }));
    }

    /// Whether `values` are far from both samples before, or, where there are none yet, from both `behind`.
    fn is_suspect(
        &mut self,
        values: [f64; 6],
        behind: Option<&[Sample; FRAMES_TO_LOCK - 1]>,
        arrival: HostTime,
    ) -> bool {
        let [newest, older] = self.before;
        let limits = self.limits(arrival);
        let believed = match newest {
            Some(newest) => [Some(newest), older]
                .into_iter()
                .flatten()
                .any(|before| near(values, before, limits)),
            None => behind
                .into_iter()
                .flatten()
                .any(|sample| near(values, self::values(sample), limits)),
        };
        if newest.is_none() && !believed {
            // The next one is a first one, too.
            self.framer.unlock();
            return true;
        }
        self.before = [Some(values), newest];
        self.last_at = arrival;
        !believed
    }

    /// Largest steps that are believed, N and N m. After a pause they grow with the samples that may be missing.
    fn limits(&self, arrival: HostTime) -> [f64; 6] {
        let pause = match self.before {
            [Some(_), _] => arrival.saturating_since(self.last_at).as_secs_f64(),
            _ => 0.0,
        };
        let periods = (pause / PERIOD.as_secs_f64()).max(1.0);
        let (force, torque) = (
            self.config.max_step_n * periods,
            self.config.max_step_nm * periods,
        );
        [force, force, force, torque, torque, torque]
    }
}

impl Device for KunweiKwr75 {
    type Frame = Chunk;
    type Reading = Reading;

    fn handle_frame(&mut self, chunk: &Chunk, stamps: RxStamps) -> Result<(), DecodeError> {
        let mut first_error = Ok(());
        self.stages.on_traffic(stamps.arrival);
        self.framer.push(chunk);
        loop {
            match self.framer.next_by_lock(decode, |_| ()) {
                Found::Frame(sample) => {
                    self.stages.tell_missing(self.framer.take_missing());
                    self.on_sample(&sample, stamps.arrival);
                }
                Found::Refused(error) => first_error = first_error.and(Err(error)),
                Found::Nothing => return first_error,
            }
        }
    }

    fn handle_timeout(&mut self, now: HostTime) {
        if self.stages.handle_timeout(now) == Due::Drained {
            self.stages.ask(Command::Start, now);
        }
        if !self.stages.is_streaming() {
            // What stands there is left from before a pause.
            self.framer.clear();
            self.before = [None; 2];
        }
    }

    fn poll_timeout(&self) -> Option<HostTime> {
        Some(self.stages.poll_timeout())
    }

    fn poll_transmit(&mut self, _now: HostTime) -> Option<Chunk> {
        Some(Chunk::take_from(&wire::encode_command(self.stages.poll_transmit()?)).0)
    }

    fn poll_reading(&mut self) -> Option<Reading> {
        self.stages.poll_reading()
    }
}

impl Counted for KunweiKwr75 {
    fn counts(&self) -> Counts {
        Counts {
            received: self.stages.received(),
            refused: self.framer.refused,
            skipped: self.framer.skipped,
            ..Counts::default()
        }
    }
}

#[cfg(test)]
mod tests;
