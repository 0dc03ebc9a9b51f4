//! A gripper's encoder behind a microcontroller that sends our own line format.
//!
//! The firmware sends by itself and takes no commands: the driver listens. Gaps, duplicates and restarts show by the firmware's
//! microseconds, for which it must send at a steady rate.
//!
//! # Source
//! [`ft_wire::encoder_line`] defines the format.

use std::f64::consts::TAU;
use std::time::Duration;

use ft_wire::encoder_line::{self as wire, Sample};
use ft_wire::{Chunk, DecodeError, HostTime, Unwrapper};

use crate::device::{Counted, Device};
use crate::framer::{Found, Framer};
use crate::link::RxStamps;
use crate::linkage::{Linkage, Widths};
use crate::options::Startup;
use crate::reading::{Counts, Reading, SampleInstant};
use crate::sequence::{Seen, Sequence};
use crate::stages::{Due, Stages, Timing};

/// What the encoder is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Config {
    /// Counts in a turn; negative when it counts down as the angle grows.
    pub counts_per_turn: f64,
    /// Counts at angle 0. Default 0.
    pub zero_counts: f64,
    /// Angle to jaw opening. Default the Hoi! gripper's.
    pub linkage: Linkage,
    /// Silence after which the encoder counts as lost. Default 500 ms.
    pub silence_timeout: Duration,
}

impl Config {
    /// An encoder of so many counts per turn on the Hoi! gripper.
    #[must_use]
    pub const fn new(counts_per_turn: f64) -> Self {
        Self {
            counts_per_turn,
            zero_counts: 0.0,
            linkage: Linkage::HOI,
            silence_timeout: Duration::from_millis(500),
        }
    }
}

/// The driver.
#[derive(Debug)]
pub struct EncoderLine {
    config: Config,
    stages: Stages<()>,
    framer: Framer,
    widths: Widths,
    ticks: Unwrapper,
    sequence: Sequence,
    duplicated: u64,
}

impl EncoderLine {
    /// A driver that begins at its first `handle_timeout`.
    #[must_use]
    pub fn new(config: Config) -> Self {
        let timing = Timing {
            startup: Startup::Listen,
            quiet: Duration::ZERO,
            drain_limit: Duration::ZERO,
            answer_timeout: config.silence_timeout,
            silence_timeout: config.silence_timeout,
            retry_after: config.silence_timeout,
        };
        let checks = "check power, port, bit rate and what the firmware sends";
        Self {
            config,
            stages: Stages::new(timing, None, checks),
            framer: Framer::new(),
            widths: Widths::new(config.linkage),
            ticks: Unwrapper::new(32),
            sequence: Sequence::new(),
            duplicated: 0,
        }
    }

    fn on_sample(&mut self, sample: Sample, arrival: HostTime) {
        if !self.stages.is_streaming() {
            self.ticks.reset();
            self.sequence.forget();
            self.widths.forget();
        }
        if !self.stages.admits_sample(None, arrival) {
            return;
        }
        self.framer.begin_counting();
        let Some(device_ns) = self.place(sample.time_us, arrival) else {
            return;
        };
        let at = SampleInstant {
            arrival,
            device_ns: Some(device_ns),
        };
        let turns =
            (f64::from(sample.counts) - self.config.zero_counts) / self.config.counts_per_turn;
        let reading = self.widths.reading(at, sample.counts, turns * TAU);
        self.stages.deliver(Reading::Width(reading));
    }

    /// The sample's instant on the firmware's unwrapped clock, ns; `None` for a duplicate.
    fn place(&mut self, time_us: u32, arrival: HostTime) -> Option<i64> {
        let device_ns = self.ticks.unwrap(time_us) * 1_000;
        match self.sequence.observe(device_ns, arrival) {
            Seen::New | Seen::Late => Some(device_ns),
            Seen::Duplicate => {
                self.duplicated += 1;
                None
            }
            Seen::Restarted { was_ns } => {
                self.ticks.reset();
                let device_ns = self.ticks.unwrap(time_us) * 1_000;
                self.sequence.forget();
                self.sequence.observe(device_ns, arrival);
                self.widths.forget();
                let was_us = was_ns / 1_000;
                let text = format!(
                    "the encoder's clock went from {was_us} us to {time_us} us: its firmware restarted, an \
                     incremental encoder begins at 0 again"
                );
                self.stages.warn(text, arrival);
                Some(device_ns)
            }
        }
    }
}

impl Device for EncoderLine {
    type Frame = Chunk;
    type Reading = Reading;

    fn handle_frame(&mut self, chunk: &Chunk, stamps: RxStamps) -> Result<(), DecodeError> {
        let mut first_error = Ok(());
        self.framer.push(chunk);
        loop {
            match self.framer.next(wire::decode, |_| ()) {
                Found::Frame(sample) => self.on_sample(sample, stamps.arrival),
                Found::Refused(error) => first_error = first_error.and(Err(error)),
                Found::Nothing => return first_error,
            }
        }
    }

    fn handle_timeout(&mut self, now: HostTime) {
        if self.stages.handle_timeout(now) == Due::Lost {
            self.framer.clear();
        }
    }

    fn poll_timeout(&self) -> Option<HostTime> {
        Some(self.stages.poll_timeout())
    }

    fn poll_transmit(&mut self, _now: HostTime) -> Option<Chunk> {
        None
    }

    fn poll_reading(&mut self) -> Option<Reading> {
        self.stages.poll_reading()
    }
}

impl Counted for EncoderLine {
    fn counts(&self) -> Counts {
        Counts {
            received: self.stages.received(),
            gaps: self.sequence.gaps(),
            refused: self.framer.refused,
            duplicated: self.duplicated,
            skipped: self.framer.skipped,
            ..Counts::default()
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reading::DeviceEvent;
    use crate::test_support::Bench;

    fn bench() -> Bench<EncoderLine> {
        let mut bench = Bench::new(EncoderLine::new(Config {
            zero_counts: 100.0,
            linkage: Linkage::Linear {
                zero_angle_rad: 0.0,
                width_at_zero_m: 0.05,
                slope_m_per_rad: 0.01,
            },
            ..Config::new(-4096.0)
        }));
        bench.advance_ms(1);
        bench
    }

    /// A line of a sample every 10 ms.
    fn line(index: u32, counts: i32) -> Vec<u8> {
        let time_us = index.wrapping_mul(10_000);
        wire::encode(&Sample { time_us, counts })
            .as_slice()
            .to_vec()
    }

    #[test]
    fn lines_become_widths_with_the_firmwares_instants() {
        let mut bench = bench();
        for index in 0..3 {
            bench.advance_ms(10);
            bench
                .bytes(&line(index, 100 - 1_024 * index.cast_signed()))
                .unwrap();
        }
        assert_eq!(
            bench.events(),
            [DeviceEvent::Starting, DeviceEvent::Streaming]
        );
        let widths = bench.widths();
        let step = 0.01 * TAU / 4.0;
        for (index, width) in (0..3).zip(&widths) {
            assert!((width.width_m - 0.05 - step * f64::from(index)).abs() < 1e-12);
            assert_eq!(width.at.device_ns, Some(i64::from(index) * 10_000_000));
        }
        assert!((widths[2].width_rate_m_s - step / 0.01).abs() < 1e-9);
    }

    #[test]
    fn the_firmwares_clock_shows_gaps_duplicates_and_restarts() {
        let mut bench = bench();
        for index in (0..40)
            .filter(|index| ![20, 21].contains(index))
            .chain([39])
        {
            bench.advance_ms(10);
            bench.bytes(&line(index, 0)).unwrap();
        }
        let counts = bench.device.counts();
        assert_eq!(
            (counts.received, counts.gaps, counts.duplicated),
            (38, 2, 1)
        );
        bench.advance_ms(1_200);
        assert!(bench.complaints()[0].contains("no sample for 500ms"));
    }

    #[test]
    fn a_restart_in_the_stream_is_a_warning_and_no_gap() {
        let mut bench = bench();
        for index in (1_000..1_030).chain(0..30) {
            bench.advance_ms(10);
            bench.bytes(&line(index, 0)).unwrap();
        }
        assert_eq!(bench.device.counts().gaps, 0);
        assert!(bench.complaints()[0].contains("firmware restarted"));
    }

    #[test]
    fn a_broken_line_is_one_refused_and_never_delivered() {
        let mut bench = bench();
        bench.bytes(&line(0, 5)).unwrap();
        let mut broken = line(1, 5);
        broken[6] ^= 1;
        bench.advance_ms(10);
        assert!(bench.bytes(&broken).is_err());
        bench.advance_ms(10);
        bench.bytes(&line(2, 5)).unwrap();
        let counts = bench.device.counts();
        assert_eq!((counts.received, counts.refused), (2, 1));
        assert_eq!(counts.skipped as usize, broken.len());
    }

    #[test]
    fn an_encoder_that_comes_back_is_picked_up_again() {
        let mut bench = bench();
        bench.bytes(&line(0, 5)).unwrap();
        bench.advance_ms(5_000);
        bench.bytes(&line(501, 5)).unwrap();
        let streaming = bench
            .events()
            .into_iter()
            .filter(|event| *event == DeviceEvent::Streaming);
        assert_eq!(streaming.count(), 2);
        assert_eq!(bench.device.counts().gaps, 0);
    }
}
