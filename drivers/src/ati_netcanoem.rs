//! ATI NETCANOEM: ATI's force-torque sensors on CAN, polled.
//!
//! ```text
//! Drain (quiet) -> firmware -> serial number -> calibration -> counts per unit -> units -> six rows of the matrix -> polls
//! ```
//!
//! A sample is two frames that say nothing about each other: the second half must come right behind the first and be stamped
//! within half a [`Config::period`], and a new poll forgets a half that waits. The wrench is the matrix, read from the board at
//! each start, times the gauges; units are the board's and become SI.
//!
//! The board keeps a bus error in its status until it is reset: the driver calls it lost, resets it and sets it up anew, matrix
//! included, since a reset makes calibration 0 the active one.
//!
//! **Sign**: unconfirmed on hardware; taken as environment on tool, [`Config::sign`] changes that.
//!
//! **Gaps**: a poll that is not answered. The stamp of a sample is its second frame's arrival.
//!
//! # Source
//! hardware.md 2.4, see [`ft_wire::ati_netcanoem`].

use std::time::Duration;

use ft_wire::ati_netcanoem::{self as wire, Reply, Request, Status};
use ft_wire::{CanFrame, DecodeError, HostTime, Wrench};

use crate::device::{Counted, Device};
use crate::link::RxStamps;
use crate::options::{Sign, Startup};
use crate::reading::{Counts, DeviceEvent, Identity, Reading, SampleInstant, WrenchReading};
use crate::stages::{Due, Polling, Stages, Timing, quality};

/// Bit rate of the bus as the factory sets it, bit/s.
pub const FACTORY_BITRATE_BPS: u32 = 250_000;

/// How to find and poll the board.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Config {
    /// Base id, 7 bits. Factory 0x20.
    pub base: u8,
    /// Which of the board's 16 calibrations. Default 0.
    pub calibration: u8,
    /// Time between two polls. Default 4 ms; at the factory's 250 kbit/s a poll takes 1.1 ms.
    pub period: Duration,
    /// Which side's wrench the sensor reports. Default environment on tool; unconfirmed on hardware.
    pub sign: Sign,
    /// Ask, or only listen to a bus on which another program asks. Default ask.
    pub startup: Startup,
    /// Longest wait for an answer during set-up, of three attempts. Default 100 ms.
    pub answer_timeout: Duration,
    /// Longest wait for the answer to a poll. Default 20 ms.
    pub poll_timeout: Duration,
    /// Unanswered polls in a row after which the board counts as lost. Default 10.
    pub lost_after: u32,
    /// Pause between being lost and the next attempt. Default 1 s.
    pub retry_after: Duration,
}

impl Default for Config {
    fn default() -> Self {
        Self {
            base: wire::FACTORY_BASE,
            calibration: 0,
            period: Duration::from_millis(4),
            sign: Sign::default(),
            startup: Startup::default(),
            answer_timeout: Duration::from_millis(100),
            poll_timeout: Duration::from_millis(20),
            lost_after: 10,
            retry_after: Duration::from_secs(1),
        }
    }
}

/// Counts per unit of force and torque of boards with a firmware before 3.7, which do not answer the question (hardware.md).
const COUNTS_PER_UNIT_BEFORE_3_7: [f64; 2] = [1e6; 2];

/// Gauges to SI, as far as it has been read.
#[derive(Clone, Copy, Debug, Default)]
struct Scale {
    rows: [[f64; 6]; 6],
    rows_read: usize,
    /// Parts of the row that is being read.
    parts: usize,
    /// The rows as they were read the first time.
    first: Option<[[f64; 6]; 6]>,
    counts_per_unit: Option<[f64; 2]>,
    si_per_unit: Option<[f64; 2]>,
}

impl Scale {
    /// Takes a part of the row being read; whether the row is whole now. Parts come in order, else the row begins anew.
    fn add(&mut self, part: u8, pair: [f32; 2]) -> bool {
        let at = usize::from(part);
        if at != self.parts {
            self.parts = 0;
            if at != 0 {
                return false;
            }
        }
        let elements = self
            .rows
            .get_mut(self.rows_read)
            .and_then(|row| row.get_mut(2 * at..2 * at + 2));
        for (slot, element) in elements.into_iter().flatten().zip(pair) {
            *slot = f64::from(element);
        }
        self.parts = (at + 1) % 3;
        if self.parts == 0 && self.rows_read < 6 {
            self.rows_read += 1;
            return true;
        }
        false
    }

    /// For the recording: the calibration in use, one unit of the board, and the rows of the matrix, `;` between them.
    fn told(&self, calibration: u8) -> Option<Vec<(&'static str, String)>> {
        let ([force, torque], [newtons, newton_metres]) =
            (self.counts_per_unit?, self.si_per_unit?);
        let row = |row: &[f64; 6]| row.map(|element| element.to_string()).join(" ");
        let rows: Vec<_> = self.rows.iter().map(row).collect();
        Some(vec![
            ("calibration", calibration.to_string()),
            ("newtons_per_count", (newtons / force).to_string()),
            (
                "newton_metres_per_count",
                (newton_metres / torque).to_string(),
            ),
            ("matrix_counts_per_gauge", rows.join("; ")),
        ])
    }

    /// N and N m, once everything is known.
    fn wrench(&self, gauges: [i16; 6]) -> Option<[f64; 6]> {
        let ([force, torque], [newtons, newton_metres]) =
            (self.counts_per_unit?, self.si_per_unit?);
        if self.rows_read < 6 {
            return None;
        }
        let (force, torque) = (newtons / force, newton_metres / torque);
        let scales = [force, force, force, torque, torque, torque];
        let mut wrench = [0.0; 6];
        for ((component, row), scale) in wrench.iter_mut().zip(&self.rows).zip(scales) {
            let sum: f64 = row
                .iter()
                .zip(gauges)
                .map(|(element, gauge)| element * f64::from(gauge))
                .sum();
            *component = sum * scale;
        }
        Some(wrench)
    }
}

/// The driver.
#[derive(Debug)]
pub struct AtiNetcanoem {
    config: Config,
    stages: Stages<Request>,
    identity: Identity,
    scale: Scale,
    even: Option<(Status, [i16; 3], HostTime)>,
    refused: u64,
    skipped: u64,
}

impl AtiNetcanoem {
    /// A driver that begins at its first `handle_timeout`.
    #[must_use]
    pub fn new(config: Config) -> Self {
        let timing = Timing {
            startup: config.startup,
            // Longer than a reset may take.
            quiet: Duration::from_millis(200),
            drain_limit: Duration::from_millis(1_000),
            answer_timeout: config.answer_timeout,
            silence_timeout: Duration::from_millis(500),
            retry_after: config.retry_after,
        };
        let polling = Polling {
            question: Request::ReadGauges,
            period: config.period,
            timeout: config.poll_timeout,
            lost_after: config.lost_after,
        };
        let checks = "check bit rate (the factory's is 250 kbit/s), base id, termination and power";
        Self {
            config,
            stages: Stages::new(timing, None, checks)
                .with_polling(polling)
                .with_optional(Request::ReadCountsPerUnit),
            identity: Identity::default(),
            scale: Scale::default(),
            even: None,
            refused: 0,
            skipped: 0,
        }
    }

    /// Goes on when `answered` is what was asked.
    fn go_on(&mut self, answered: Request, next: Request, now: HostTime) {
        if self.stages.awaits(answered) {
            self.stages.ask(next, now);
        }
    }

    fn on_reply(&mut self, reply: Reply, at: HostTime) {
        match reply {
            Reply::EvenGauges { status, even } => {
                if self.even.replace((status, even, at)).is_some() {
                    self.refuse();
                }
            }
            Reply::OddGauges(odd) => self.on_odd(odd, at),
            Reply::Firmware {
                major,
                minor,
                build,
            } => {
                self.identity.firmware = format!("{major}.{minor}.{build}");
                self.go_on(Request::ReadFirmware, Request::ReadSerialNumber, at);
            }
            Reply::SerialNumber(text) => {
                self.identity.serial_number = String::from_utf8_lossy(&text)
                    .trim_matches(['\0', ' '])
                    .to_owned();
                if self.stages.awaits(Request::ReadSerialNumber) {
                    self.identity.model = "NETCANOEM".to_owned();
                    let identity = self.identity.clone();
                    self.stages.tell(DeviceEvent::Identified(identity), at);
                    let calibration = Request::SetCalibration(self.config.calibration);
                    self.stages.ask(calibration, at);
                }
            }
            Reply::Calibration(index) => self.on_calibration(index, at),
            Reply::CountsPerUnit(counts) => {
                self.scale.counts_per_unit = Some(counts.map(f64::from));
                self.go_on(Request::ReadCountsPerUnit, Request::ReadUnits, at);
            }
            Reply::Units(si) => {
                self.scale.si_per_unit = Some(si);
                if self.stages.awaits(Request::ReadUnits) {
                    self.scale.rows_read = 0;
                    self.stages.ask(Request::ReadMatrixRow(0), at);
                }
            }
            Reply::MatrixPart { part, pair } => self.on_matrix_part(part, pair, at),
        }
    }

    fn on_calibration(&mut self, index: u8, at: HostTime) {
        let wanted = self.config.calibration;
        if !self.stages.awaits(Request::SetCalibration(wanted)) {
            return;
        }
        if index == wanted {
            self.stages.ask(Request::ReadCountsPerUnit, at);
        } else {
            self.stages.lose(
                format!("calibration {wanted} was asked for, {index} is active"),
                at,
            );
        }
    }

    fn on_matrix_part(&mut self, part: u8, pair: [f32; 2], at: HostTime) {
        let row = self.scale.rows_read;
        if !self.scale.add(part, pair) {
            return;
        }
        let asked = u8::try_from(row).map(Request::ReadMatrixRow);
        if !asked.is_ok_and(|asked| self.stages.awaits(asked)) {
            return;
        }
        match u8::try_from(row + 1) {
            Ok(next @ ..=5) => self.stages.ask(Request::ReadMatrixRow(next), at),
            _ => self.on_matrix(at),
        }
    }

    /// Reads the matrix twice: a row's answer that comes late, when it was asked again, would be taken for the next row's.
    fn on_matrix(&mut self, at: HostTime) {
        match self.scale.first.replace(self.scale.rows) {
            None => {
                self.scale.rows_read = 0;
                self.stages.ask(Request::ReadMatrixRow(0), at);
            }
            Some(first) if first == self.scale.rows => {
                self.stages.set_stop(None);
                if let Some(scale) = self.scale.told(self.config.calibration) {
                    self.stages.tell(DeviceEvent::Scale(scale), at);
                }
                self.stages.begin_polling(at);
            }
            Some(_) => {
                let reason = "the matrix is another one when it is read again: an answer came late or broken";
                self.stages.lose(reason.to_owned(), at);
            }
        }
    }

    fn on_odd(&mut self, odd: [i16; 3], at: HostTime) {
        let Some((status, [sg0, sg2, sg4], first_at)) = self.even.take() else {
            self.skip();
            return;
        };
        if at.saturating_since(first_at) > self.config.period / 2 {
            self.refuse();
            self.skip();
            return;
        }
        let [sg1, sg3, sg5] = odd;
        let Some(wrench) = self.scale.wrench([sg0, sg1, sg2, sg3, sg4, sg5]) else {
            // Gauges without a matrix are no wrench; only listening can bring them.
            return;
        };
        if !self.stages.admits_answer(at) {
            self.skip();
            return;
        }
        if status.has(Status::BUS_ERROR) && self.config.startup == Startup::Configure {
            self.stages.set_stop(Some(Request::Reset));
            let reason = "the board reports a bus error, which stays until a reset: it is reset and set up anew";
            return self.stages.lose(reason.to_owned(), at);
        }
        self.warn_of(status, at);
        let over = Status::TOO_HIGH | Status::TOO_LOW;
        self.stages.deliver(Reading::Wrench(WrenchReading {
            at: SampleInstant {
                arrival: at,
                device_ns: None,
            },
            wrench: self.config.sign.apply(Wrench::from_array(wrench)),
            temperature_celsius: None,
            // An error without a name is one, too.
            quality: quality(
                status.has(!(over | Status::ANY)) || (status.has(Status::ANY) && !status.has(over)),
                status.has(over),
            ),
            status_bits: status.0.into(),
        }));
    }

    fn warn_of(&mut self, status: Status, at: HostTime) {
        let named = status.0 & !Status::ANY;
        let told = if named == 0 { status.0 } else { named };
        let fresh = self.stages.fresh_bits(told.into());
        for bit in (0..16).filter(|bit| fresh & (1 << bit) != 0) {
            let text = format!("status {:#06x}: {}", status.0, Status::meaning(bit));
            self.stages.warn(text, at);
        }
    }

    fn refuse(&mut self) {
        self.refused += u64::from(self.stages.is_streaming());
    }

    fn skip(&mut self) {
        self.skipped += u64::from(self.stages.is_streaming());
    }
}

impl Device for AtiNetcanoem {
    type Frame = CanFrame;
    type Reading = Reading;

    fn handle_frame(&mut self, frame: &CanFrame, stamps: RxStamps) -> Result<(), DecodeError> {
        match wire::decode(self.config.base, frame) {
            Ok(reply) => {
                self.stages.on_traffic(stamps.arrival);
                self.on_reply(reply, stamps.arrival);
                Ok(())
            }
            Err(DecodeError::Field { name: "can_id", .. }) => {
                // Another device's frame on the same bus.
                self.skip();
                Ok(())
            }
            Err(error) => {
                // Ours, but wrong: the half that waited for it is lost with it.
                self.even = None;
                self.refuse();
                Err(error)
            }
        }
    }

    fn handle_timeout(&mut self, now: HostTime) {
        match self.stages.handle_timeout(now) {
            Due::Began => {
                self.scale = Scale::default();
                self.identity = Identity::default();
            }
            Due::Drained => self.stages.ask(Request::ReadFirmware, now),
            Due::Polled => {
                if self.even.take().is_some() {
                    self.refuse();
                }
            }
            Due::Unanswered(_) => {
                self.scale.counts_per_unit = Some(COUNTS_PER_UNIT_BEFORE_3_7);
                self.stages.ask(Request::ReadUnits, now);
            }
            Due::Nothing | Due::Lost => {}
        }
        if !self.stages.is_streaming() {
            self.even = None;
        }
    }

    fn poll_timeout(&self) -> Option<HostTime> {
        Some(self.stages.poll_timeout())
    }

    fn poll_transmit(&mut self, _now: HostTime) -> Option<CanFrame> {
        let request = self.stages.poll_transmit()?;
        Some(wire::request_frame(self.config.base, request))
    }

    fn poll_reading(&mut self) -> Option<Reading> {
        self.stages.poll_reading()
    }
}

impl Counted for AtiNetcanoem {
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
mod tests;
