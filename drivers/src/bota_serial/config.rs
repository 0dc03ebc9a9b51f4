//! How to set a Bota sensor up.

use std::time::Duration;

use ft_wire::bota_serial::{BaudRate, FRAME_LEN, Filter};

use crate::options::{Sign, Startup};

/// How to set the sensor up.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Config {
    /// Bit rate at which the line is open and that the sensor is told to keep. Default 460 800 bit/s, to which the
    /// maker's driver switches; the factory's is 230 400.
    pub baud: BaudRate,
    /// Filter, which sets the rate: about 51 200 Hz / `sinc_length`. Default sinc 64 without FIR, 800 Hz, which the
    /// maker calls the practical top.
    pub filter: Filter,
    /// Whether the sensor compensates its temperature. Default no, as the maker's driver.
    pub temperature_compensation: bool,
    /// Which side's wrench the sensor reports. Default environment on tool; unconfirmed on hardware.
    pub sign: Sign,
    /// Set the sensor up, or only listen. Default set up.
    pub startup: Startup,
    /// Longest wait for an acknowledgement, and for the first sample. Default 2 s, the maker's.
    pub ack_timeout: Duration,
    /// Silence after which the stream counts as lost. Default 500 ms; a filter that takes longer for a sample is given what it
    /// takes, and 15 % more as the maker's driver does.
    pub silence_timeout: Duration,
    /// Pause between being lost and the next attempt. Default 1 s.
    pub retry_after: Duration,
}

/// The rate at which the sensor samples its gauges, before its filter, Hz.
pub const GAUGE_RATE_HZ: f64 = 51_200.0;
/// With chop a sample takes as many times as long, at least.
const CHOP: f64 = 4.0;
/// Start bit, eight bits, stop bit.
const BITS_PER_BYTE: f64 = 10.0;

/// What a sample takes at sinc length 4096 with chop, the slowest, by the maker's driver.
const SLOWEST: Duration = Duration::from_millis(1_770);

impl Config {
    /// Said where the line cannot carry the rate that the filter sets.
    pub(super) fn too_fast(&self) -> Option<String> {
        let length =
            f64::from(self.filter.sinc_length.max(1)) * if self.filter.chop { CHOP } else { 1.0 };
        let (rate, baud) = (GAUGE_RATE_HZ / length, self.baud.bps());
        let most = f64::from(baud) / (BITS_PER_BYTE * FRAME_LEN as f64);
        (rate > most).then(|| {
            format!(
                "a rate of {rate:.0} Hz is more than the {most:.0} Hz that a line of {baud} bit/s carries: samples will be lost; \
                 lower rate_hz or raise baud_bps"
            )
        })
    }

    /// The same with a silence that the filter's slowest sample does not reach.
    pub(super) fn patient(self) -> Self {
        let share = f64::from(self.filter.sinc_length) / 4096.0;
        // Without chop a sample is four times faster or more; the documents give only this figure.
        let slowest = if self.filter.chop { 1.0 } else { 0.25 };
        let least = SLOWEST.mul_f64(1.15 * share * slowest);
        Self {
            silence_timeout: self.silence_timeout.max(least),
            ..self
        }
    }
}

impl Default for Config {
    fn default() -> Self {
        Self {
            baud: BaudRate::Bps460800,
            filter: Filter {
                sinc_length: 64,
                chop: false,
                fast: false,
                fir_disable: true,
            },
            temperature_compensation: false,
            sign: Sign::default(),
            startup: Startup::default(),
            ack_timeout: Duration::from_secs(2),
            silence_timeout: Duration::from_millis(500),
            retry_after: Duration::from_secs(1),
        }
    }
}
