//! CUI AMT21 absolute encoders on RS-485 as the encoder of a gripper: polled.
//!
//! ```text
//! Drain (quiet) -> a poll every period; too many without an answer -> Lost -> wait -> Drain
//! ```
//!
//! An answer is two bytes with two check bits and no framing. A poll that is not answered by exactly these, or by bytes whose
//! check is wrong, is one gap; bytes nobody asked for are skipped. An answer that comes later than [`Config::poll_timeout`] would be
//! taken for the next poll's: choose it longer than the longest delay of the line.
//!
//! The encoder's end of turn is put opposite of the linkage's zero angle, so that a gripper never meets it.
//!
//! # Source
//! hardware.md 3.2, see [`ft_wire::amt21`].

use std::f64::consts::TAU;
use std::time::Duration;

use ft_wire::amt21::{self as wire, COUNTS_PER_TURN, REPLY_LEN};
use ft_wire::{Chunk, DecodeError, HostTime};

use crate::device::{Counted, Device};
use crate::link::RxStamps;
use crate::linkage::{Linkage, Widths};
use crate::options::Startup;
use crate::reading::{Counts, Reading, SampleInstant};
use crate::stages::{Due, Polling, Stages, Timing};

/// Whether the adapter hands back what was sent.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Echo {
    /// It does not.
    #[default]
    None,
    /// It does: the answer follows the question's own byte.
    Present,
}

/// How to poll the encoder.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Config {
    /// Address, a multiple of 4. Default 0x54, the factory's.
    pub address: u8,
    /// Time between two polls. Default 5 ms.
    pub period: Duration,
    /// Position that is angle 0, counts. Default 0.
    pub zero_counts: u16,
    /// Angle to jaw opening. Default the Hoi! gripper's.
    pub linkage: Linkage,
    /// Whether the adapter echoes. Default not.
    pub echo: Echo,
    /// Ask, or only listen to a line on which another program asks. Default ask.
    pub startup: Startup,
    /// Longest wait for an answer. Default 30 ms, which an FTDI latency timer of 16 ms needs.
    pub poll_timeout: Duration,
    /// Unanswered polls in a row after which the encoder counts as lost. Default 10.
    pub lost_after: u32,
    /// Pause between being lost and the next attempt. Default 1 s.
    pub retry_after: Duration,
}

impl Default for Config {
    fn default() -> Self {
        Self {
            address: wire::FACTORY_ADDRESS,
            period: Duration::from_millis(5),
            zero_counts: 0,
            linkage: Linkage::HOI,
            echo: Echo::default(),
            startup: Startup::default(),
            poll_timeout: Duration::from_millis(30),
            lost_after: 10,
            retry_after: Duration::from_secs(1),
        }
    }
}

/// The one question.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Position;

/// The driver.
#[derive(Debug)]
pub struct Amt21 {
    config: Config,
    stages: Stages<Position>,
    widths: Widths,
    /// Bytes of the answer so far, echo included.
    answer: [u8; REPLY_LEN + 1],
    answer_len: usize,
    /// When bytes came last.
    last_at: HostTime,
    refused: u64,
    skipped: u64,
}

impl Amt21 {
    /// A driver that begins at its first `handle_timeout`.
    #[must_use]
    pub fn new(config: Config) -> Self {
        let timing = Timing {
            startup: config.startup,
            quiet: Duration::from_millis(20),
            drain_limit: Duration::from_millis(500),
            answer_timeout: config.poll_timeout,
            silence_timeout: Duration::from_millis(500),
            retry_after: config.retry_after,
        };
        let polling = Polling {
            question: Position,
            period: config.period,
            timeout: config.poll_timeout,
            lost_after: config.lost_after,
        };
        let checks = "check power (the shaft must be still for 200 ms after it), address, bit rate and whether the \
                      adapter echoes";
        Self {
            config,
            stages: Stages::new(timing, None, checks).with_polling(polling),
            widths: Widths::new(config.linkage),
            answer: [0; REPLY_LEN + 1],
            answer_len: 0,
            last_at: HostTime::EPOCH,
            refused: 0,
            skipped: 0,
        }
    }

    fn expected(&self) -> usize {
        REPLY_LEN + usize::from(self.config.echo == Echo::Present)
    }

    fn on_byte(&mut self, byte: u8, at: HostTime) -> Result<(), DecodeError> {
        if !self.stages.is_polling() && self.config.startup == Startup::Configure {
            self.skipped += u64::from(self.stages.is_streaming());
            return Ok(());
        }
        if let Some(slot) = self.answer.get_mut(self.answer_len) {
            *slot = byte;
            self.answer_len += 1;
        }
        if self.answer_len < self.expected() {
            return Ok(());
        }
        self.answer_len = 0;
        let [first, second, third] = self.answer;
        let reply = match self.config.echo {
            Echo::None => [first, second],
            Echo::Present if first == wire::position_request(self.config.address) => {
                [second, third]
            }
            Echo::Present => {
                return self.refuse(DecodeError::Field {
                    name: "echo",
                    value: first.into(),
                });
            }
        };
        match wire::decode_position(reply) {
            Ok(position) => {
                self.on_position(position, at);
                Ok(())
            }
            Err(error) => self.refuse(error),
        }
    }

    fn refuse(&mut self, error: DecodeError) -> Result<(), DecodeError> {
        self.refused += u64::from(self.stages.is_streaming());
        Err(error)
    }

    fn on_position(&mut self, position: u16, arrival: HostTime) {
        if !self.stages.admits_answer(arrival) {
            return;
        }
        let at = SampleInstant {
            arrival,
            device_ns: None,
        };
        let angle_rad = self.angle_rad(position);
        let reading = self.widths.reading(at, position.into(), angle_rad);
        self.stages.deliver(Reading::Width(reading));
    }

    /// The angle within half a turn of the linkage's zero angle.
    fn angle_rad(&self, position: u16) -> f64 {
        let turns =
            (f64::from(position) - f64::from(self.config.zero_counts)) / f64::from(COUNTS_PER_TURN);
        let (Linkage::CrankAndRod { zero_angle_rad, .. } | Linkage::Linear { zero_angle_rad, .. }) =
            self.config.linkage;
        let middle = zero_angle_rad / TAU;
        let off = turns - middle;
        (middle + off - off.round()) * TAU
    }
}

impl Device for Amt21 {
    type Frame = Chunk;
    type Reading = Reading;

    fn handle_frame(&mut self, chunk: &Chunk, stamps: RxStamps) -> Result<(), DecodeError> {
        self.stages.on_traffic(stamps.arrival);
        let len = chunk.as_slice().len();
        if self.config.startup == Startup::Configure && self.answer_len + len > self.expected() {
            // Which of these bytes are the answer nobody knows.
            self.answer_len = 0;
            return self.refuse(DecodeError::Length {
                expected: self.expected(),
                got: len,
            });
        }
        if self.config.startup == Startup::Listen
            && stamps.arrival.saturating_since(self.last_at) > self.config.period / 2
        {
            // No poll ends what is left of half an answer in a recording.
            self.answer_len = 0;
        }
        self.last_at = stamps.arrival;
        let mut first_error = Ok(());
        for byte in chunk.as_slice() {
            first_error = first_error.and(self.on_byte(*byte, stamps.arrival));
        }
        first_error
    }

    fn handle_timeout(&mut self, now: HostTime) {
        match self.stages.handle_timeout(now) {
            Due::Drained => self.stages.begin_polling(now),
            Due::Began => self.widths.forget(),
            Due::Polled => {
                // Half an answer is none.
                let left = u64::try_from(self.answer_len).unwrap_or_default();
                self.skipped += if self.stages.is_streaming() { left } else { 0 };
                self.answer_len = 0;
            }
            Due::Nothing | Due::Lost | Due::Unanswered(_) => {}
        }
    }

    fn poll_timeout(&self) -> Option<HostTime> {
        Some(self.stages.poll_timeout())
    }

    fn poll_transmit(&mut self, _now: HostTime) -> Option<Chunk> {
        self.stages.poll_transmit()?;
        Some(Chunk::take_from(&[wire::position_request(self.config.address)]).0)
    }

    fn poll_reading(&mut self) -> Option<Reading> {
        self.stages.poll_reading()
    }
}

impl Counted for Amt21 {
    fn counts(&self) -> Counts {
        Counts {
            received: self.stages.received(),
            gaps: self.stages.missed(),
            refused: self.refused,
            skipped: self.skipped,
            ..Counts::default()
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reading::DeviceEvent;
    use crate::test_support::Bench;

    const RACK: Linkage = Linkage::Linear {
        zero_angle_rad: 0.0,
        width_at_zero_m: 0.05,
        slope_m_per_rad: 0.01,
    };

    fn bench(echo: Echo) -> Bench<Amt21> {
        Bench::new(Amt21::new(Config {
            linkage: RACK,
            zero_counts: 1_000,
            echo,
            ..Config::default()
        }))
    }

    fn expect_poll(bench: &mut Bench<Amt21>) {
        bench.advance_until(|bench| !bench.sent.is_empty());
        assert_eq!(bench.take_sent(), [0x54]);
    }

    fn counts(bench: &Bench<Amt21>) -> [u64; 4] {
        let counts = bench.device.counts();
        [counts.received, counts.gaps, counts.refused, counts.skipped]
    }

    fn polled() -> Bench<Amt21> {
        let mut bench = bench(Echo::None);
        expect_poll(&mut bench);
        bench.bytes(&wire::encode_position(1_000)).unwrap();
        bench
    }

    #[test]
    fn a_byte_too_many_is_no_answer() {
        let mut bench = polled();
        expect_poll(&mut bench);
        // Noise, then 192: its first two bytes have right check bits, too.
        let refused = bench.bytes(&[0x00, 0xC0, 0x00]);
        assert!(refused.is_err());
        assert_eq!(bench.widths().len(), 1);
        expect_poll(&mut bench);
        bench.bytes(&wire::encode_position(1_000)).unwrap();
        assert_eq!((bench.widths().len(), counts(&bench)[2]), (2, 1));
    }

    #[test]
    fn half_an_answer_in_a_recording_shifts_no_other() {
        let mut bench = Bench::new(Amt21::new(Config {
            linkage: RACK,
            zero_counts: 1_000,
            startup: Startup::Listen,
            ..Config::default()
        }));
        bench.advance_ms(1);
        bench.bytes(&wire::encode_position(1_000)[..1]).unwrap();
        for _ in 0..20 {
            bench.advance_ms(20);
            bench.bytes(&wire::encode_position(1_000)).unwrap();
        }
        let widths = bench.widths();
        assert_eq!(widths.len(), 20);
        assert!(widths.iter().all(|width| width.counts == 1_000));
    }

    #[test]
    fn polls_end_in_widths_and_their_rate() {
        let mut bench = polled();
        expect_poll(&mut bench);
        bench.bytes(&wire::encode_position(1_000 + 1_024)).unwrap();
        assert_eq!(
            bench.events(),
            [DeviceEvent::Starting, DeviceEvent::Streaming]
        );
        let widths = bench.widths();
        assert!((widths[0].width_m - 0.05).abs() < 1e-12);
        let step = 0.01 * TAU / 16.0;
        assert!((widths[1].width_m - 0.05 - step).abs() < 1e-12);
        let elapsed = widths[1].at.arrival.seconds_since(widths[0].at.arrival);
        assert!((widths[1].width_rate_m_s - step / elapsed).abs() < 1e-9);
        assert_eq!(widths[1].counts, 2_024);
    }

    #[test]
    fn the_end_of_the_turn_is_opposite_of_zero() {
        let bench = bench(Echo::None);
        for (position, turns) in [
            (1_000, 0.0),
            (999, -1.0 / 16_384.0),
            (0, -1_000.0 / 16_384.0),
        ] {
            assert!((bench.device.angle_rad(position) / TAU - turns).abs() < 1e-12);
        }
        assert!(bench.device.angle_rad(1_000 + 8_191) > 0.0);
        assert!(bench.device.angle_rad(1_000 + 8_193) < 0.0);
    }

    #[test]
    fn a_wrong_check_is_refused_and_its_poll_a_gap() {
        let mut bench = polled();
        expect_poll(&mut bench);
        let [low, high] = wire::encode_position(1_001);
        assert!(bench.bytes(&[low ^ 1, high]).is_err());
        expect_poll(&mut bench);
        bench.bytes(&wire::encode_position(1_001)).unwrap();
        assert_eq!(counts(&bench), [2, 1, 1, 0]);
    }

    #[test]
    fn half_an_answer_never_joins_the_next() {
        let mut bench = polled();
        expect_poll(&mut bench);
        bench.bytes(&wire::encode_position(5)[..1]).unwrap();
        expect_poll(&mut bench);
        bench.bytes(&wire::encode_position(6)).unwrap();
        assert_eq!(bench.widths()[1].counts, 6);
        assert_eq!(counts(&bench), [2, 1, 0, 1]);
    }

    #[test]
    fn bytes_that_nobody_asked_for_are_skipped() {
        let mut bench = polled();
        bench.bytes(&wire::encode_position(7)).unwrap();
        assert_eq!(counts(&bench), [1, 0, 0, 2]);
    }

    #[test]
    fn an_echo_is_passed_over_and_a_missing_one_is_refused() {
        let mut bench = bench(Echo::Present);
        expect_poll(&mut bench);
        let [low, high] = wire::encode_position(1_000);
        bench.bytes(&[0x54, low, high]).unwrap();
        expect_poll(&mut bench);
        assert!(bench.bytes(&[low, high, 0]).is_err());
        assert_eq!(counts(&bench), [1, 0, 1, 0]);
    }

    #[test]
    fn an_encoder_that_falls_silent_is_lost_after_ten_polls_and_tried_again() {
        let mut bench = polled();
        bench.advance_until(|bench| !bench.complaints().is_empty());
        let complaint = &bench.complaints()[0];
        assert!(complaint.contains("10 questions in a row"), "{complaint}");
        bench.sent.clear();
        let waited = bench.advance_until(|bench| !bench.sent.is_empty());
        assert_eq!(waited, Duration::from_millis(1_020));
    }
}
