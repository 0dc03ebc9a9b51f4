//! An axis of a USB HID device (joystick, dial, slider, wheel) as the encoder of a gripper.
//!
//! The link hands over the device's report descriptor first, then its reports. Devices of this kind mostly report only when
//! something moves, so silence is no loss; an unplugged device ends the link.
//!
//! An angle is [`Config::counts_per_turn`] of the axis's counts, or what the descriptor's unit says. Relative axes (dials) are summed up from
//! 0 at the start: the gripper must begin where [`Linkage`] has its zero angle. Reports carry no counter and no clock: one lost as a
//! whole leaves no trace.
//!
//! # Source
//! hardware.md 3.6, see [`ft_wire::hid`].

use std::f64::consts::TAU;

use ft_wire::hid::{self, Axis, Motion, Report, Usage};
use ft_wire::{DecodeError, HostTime};

use crate::device::{Counted, Device};
use crate::link::RxStamps;
use crate::linkage::{Linkage, Widths};
use crate::reading::{Counts, DeviceEvent, Reading, SampleInstant};

/// What a HID link carries.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum HidFrame {
    /// The report descriptor, once at the start.
    Descriptor(Box<[u8]>),
    /// A report.
    Report(Report),
}

/// Which axis, and what it means.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Config {
    /// Which axis of the device. Default X.
    pub usage: Usage,
    /// Counts in a turn, negative when it counts down as the angle grows; `None` takes the unit of the descriptor.
    pub counts_per_turn: Option<f64>,
    /// Counts at angle 0. Default 0.
    pub zero_counts: f64,
    /// Angle to jaw opening. Default the Hoi! gripper's.
    pub linkage: Linkage,
}

impl Default for Config {
    fn default() -> Self {
        Self {
            usage: Usage::X,
            counts_per_turn: None,
            zero_counts: 0.0,
            linkage: Linkage::HOI,
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum State {
    Idle,
    /// Waits for the descriptor.
    Begun,
    /// Reads this axis; this much of an angle per count, rad.
    Reading(Axis, f64),
    /// The device has no such axis, or no scale.
    Lost,
}

/// The driver.
#[derive(Debug)]
pub struct HidAxis {
    config: Config,
    state: State,
    streaming: bool,
    /// Sum of a relative axis.
    position: i32,
    widths: Widths,
    received: u64,
    refused: u64,
    skipped: u64,
    readings: std::collections::VecDeque<Reading>,
}

impl HidAxis {
    /// A driver that begins at its first `handle_timeout`.
    #[must_use]
    pub fn new(config: Config) -> Self {
        Self {
            config,
            state: State::Idle,
            streaming: false,
            position: 0,
            widths: Widths::new(config.linkage),
            received: 0,
            refused: 0,
            skipped: 0,
            readings: std::collections::VecDeque::with_capacity(32),
        }
    }

    fn tell(&mut self, event: DeviceEvent, at: HostTime) {
        self.readings.push_back(Reading::Event { at, event });
    }

    fn lose(&mut self, reason: String, at: HostTime) {
        self.tell(DeviceEvent::Lost { reason }, at);
        self.state = State::Lost;
    }

    fn on_descriptor(&mut self, descriptor: &[u8], at: HostTime) -> Result<(), DecodeError> {
        (self.streaming, self.position) = (false, 0);
        self.widths.forget();
        let axes = match hid::axes(descriptor) {
            Ok(axes) => axes,
            Err(error) => {
                self.lose(format!("its report descriptor is broken: {error}"), at);
                return Err(error);
            }
        };
        let wanted = self.config.usage;
        let Some(axis) = axes.iter().find(|axis| axis.usage == wanted) else {
            let names: Vec<_> = axes.iter().map(|axis| axis.usage.name()).collect();
            let (wanted, names) = (wanted.name(), names.join(", "));
            let reason = format!("it has no axis {wanted}; its axes are: {names}");
            self.lose(reason, at);
            return Ok(());
        };
        let scale = match self.config.counts_per_turn {
            Some(counts) => Some(TAU / counts),
            None => axis.radians_per_count(),
        };
        match scale {
            Some(scale) => {
                let (least, most) = axis.logical;
                let told = vec![
                    ("radians_per_count", scale.to_string()),
                    ("range_counts", format!("{least} to {most}")),
                ];
                self.tell(DeviceEvent::Scale(told), at);
                self.state = State::Reading(*axis, scale);
            }
            None => self.lose(
                format!(
                    "axis {} counts from {} to {} without a unit of angle: set counts_per_turn",
                    wanted.name(),
                    axis.logical.0,
                    axis.logical.1
                ),
                at,
            ),
        }
        Ok(())
    }

    fn on_report(&mut self, report: &Report, arrival: HostTime) -> Result<(), DecodeError> {
        let State::Reading(axis, scale) = self.state else {
            return Ok(());
        };
        let value = match axis.read(report.as_slice()) {
            Ok(Some(value)) => value,
            Ok(None) => {
                self.skipped += 1;
                return Ok(());
            }
            Err(error) => {
                self.refused += 1;
                return Err(error);
            }
        };
        let counts = match axis.motion {
            Motion::Absolute => value,
            Motion::Relative => {
                self.position = self.position.saturating_add(value);
                self.position
            }
        };
        if !core::mem::replace(&mut self.streaming, true) {
            self.tell(DeviceEvent::Streaming, arrival);
        }
        let at = SampleInstant {
            arrival,
            device_ns: None,
        };
        let angle_rad = (f64::from(counts) - self.config.zero_counts) * scale;
        let reading = self.widths.reading(at, counts, angle_rad);
        self.received += 1;
        self.readings.push_back(Reading::Width(reading));
        Ok(())
    }
}

impl Device for HidAxis {
    type Frame = HidFrame;
    type Reading = Reading;

    fn handle_frame(&mut self, frame: &HidFrame, stamps: RxStamps) -> Result<(), DecodeError> {
        match frame {
            HidFrame::Descriptor(descriptor) => self.on_descriptor(descriptor, stamps.arrival),
            HidFrame::Report(report) => self.on_report(report, stamps.arrival),
        }
    }

    fn handle_timeout(&mut self, now: HostTime) {
        if self.state == State::Idle {
            self.tell(DeviceEvent::Starting, now);
            self.state = State::Begun;
        }
    }

    fn poll_timeout(&self) -> Option<HostTime> {
        (self.state == State::Idle).then_some(HostTime::EPOCH)
    }

    fn poll_transmit(&mut self, _now: HostTime) -> Option<HidFrame> {
        None
    }

    fn poll_reading(&mut self) -> Option<Reading> {
        self.readings.pop_front()
    }
}

impl Counted for HidAxis {
    fn counts(&self) -> Counts {
        Counts {
            received: self.received,
            refused: self.refused,
            skipped: self.skipped,
            ..Counts::default()
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_support::Bench;

    /// Report 3: a slider of 16 bits without unit.
    const SLIDER: &[u8] = &[
        0x05, 0x01, 0x09, 0x04, 0xA1, 0x01, 0x85, 0x03, 0x09, 0x36, 0x15, 0x00, 0x27, 0xFF, 0xFF,
        0x00, 0x00, 0x75, 0x10, 0x95, 0x01, 0x81, 0x02, 0xC0,
    ];
    /// A dial of 16 bits, relative, 0.1 degree.
    const DIAL: &[u8] = &[
        0x05, 0x01, 0x09, 0x0E, 0xA1, 0x01, 0x09, 0x37, 0x95, 0x01, 0x75, 0x10, 0x55, 0x0F, 0x65,
        0x14, 0x36, 0xF0, 0xF1, 0x46, 0x10, 0x0E, 0x16, 0xF0, 0xF1, 0x26, 0x10, 0x0E, 0x81, 0x06,
        0xC0,
    ];

    fn bench(descriptor: &[u8], config: Config) -> Bench<HidAxis> {
        let mut bench = Bench::new(HidAxis::new(config));
        bench.advance_ms(1);
        let _ = bench.frame(&HidFrame::Descriptor(descriptor.into()));
        bench
    }

    fn report(bench: &mut Bench<HidAxis>, bytes: &[u8]) -> Result<(), DecodeError> {
        bench.advance_ms(8);
        bench.frame(&HidFrame::Report(Report::new(bytes).unwrap()))
    }

    fn slider() -> Config {
        Config {
            usage: Usage::Slider,
            counts_per_turn: Some(65_536.0),
            linkage: Linkage::Linear {
                zero_angle_rad: 0.0,
                width_at_zero_m: 0.0,
                slope_m_per_rad: 0.1 / TAU,
            },
            ..Config::default()
        }
    }

    #[test]
    fn a_slider_becomes_widths() {
        let mut bench = bench(SLIDER, slider());
        report(&mut bench, &[3, 0x00, 0x80]).unwrap();
        report(&mut bench, &[3, 0x00, 0x40]).unwrap();
        let widths: Vec<_> = bench.widths().iter().map(|width| width.width_m).collect();
        assert!((widths[0] - 0.05).abs() < 1e-12 && (widths[1] - 0.025).abs() < 1e-12);
        assert!((bench.widths()[1].width_rate_m_s + 0.025 / 0.008).abs() < 1e-9);
        assert_eq!(
            bench.events(),
            [
                DeviceEvent::Starting,
                DeviceEvent::Scale(vec![
                    ("radians_per_count", (TAU / 65_536.0).to_string()),
                    ("range_counts", "0 to 65535".to_owned())
                ]),
                DeviceEvent::Streaming
            ]
        );
    }

    #[test]
    fn a_dial_sums_its_steps_by_the_unit_of_its_descriptor() {
        let config = Config {
            usage: Usage::Dial,
            linkage: slider().linkage,
            ..Config::default()
        };
        let mut bench = bench(DIAL, config);
        for step in [900_i16, 900, -450] {
            report(&mut bench, &step.to_le_bytes()).unwrap();
        }
        let last = bench.widths()[2];
        assert_eq!(last.counts, 1_350);
        assert!((last.width_m - 0.1 * 135.0 / 360.0).abs() < 1e-12);
    }

    #[test]
    fn an_axis_that_is_not_there_or_has_no_scale_is_named_with_what_there_is() {
        let absent = bench(SLIDER, Config::default());
        assert_eq!(
            absent.complaints(),
            ["it has no axis x; its axes are: slider"]
        );
        let unscaled = bench(
            SLIDER,
            Config {
                counts_per_turn: None,
                ..slider()
            },
        );
        assert!(unscaled.complaints()[0].contains("from 0 to 65535 without a unit of angle"));
        let broken = bench(&SLIDER[..SLIDER.len() - 1], slider());
        assert!(broken.complaints()[0].contains("collection without end"));
    }

    #[test]
    fn reports_of_another_id_are_skipped_and_short_ones_refused() {
        let mut bench = bench(SLIDER, slider());
        report(&mut bench, &[4, 0, 0]).unwrap();
        assert!(report(&mut bench, &[3, 0]).is_err());
        report(&mut bench, &[3, 1, 0]).unwrap();
        let counts = bench.device.counts();
        assert_eq!((counts.received, counts.refused, counts.skipped), (1, 1, 1));
    }

    #[test]
    fn silence_is_no_loss_and_a_new_descriptor_begins_anew() {
        let mut bench = bench(
            DIAL,
            Config {
                usage: Usage::Dial,
                ..Config::default()
            },
        );
        report(&mut bench, &100_i16.to_le_bytes()).unwrap();
        bench.advance_ms(60_000);
        assert!(bench.complaints().is_empty());
        bench.frame(&HidFrame::Descriptor(DIAL.into())).unwrap();
        report(&mut bench, &7_i16.to_le_bytes()).unwrap();
        assert_eq!(bench.widths()[1].counts, 7);
    }
}
