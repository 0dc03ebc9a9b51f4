//! How to set a Robotous sensor up.

use std::time::Duration;

use ft_wire::robotous_rft::model_named;

use crate::options::{Sign, Startup};

/// Raw counts per unit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Scale {
    /// DF: counts per N.
    pub counts_per_newton: f64,
    /// DT: counts per N m.
    pub counts_per_newton_metre: f64,
}

impl Scale {
    /// The manual's scale of a model, such as `RFT64-SB01`.
    #[must_use]
    pub fn of_model(name: &str) -> Option<Self> {
        let model = model_named(name)?;
        Some(Self {
            counts_per_newton: model.df,
            counts_per_newton_metre: model.dt,
        })
    }
}

/// The sensor's own filter.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Filter {
    /// None.
    Off,
    /// First-order low pass; 500, 300, 200, 150, 100, 50, 40, 30, 20, 10, 5, 3, 2 or 1 Hz.
    LowPass {
        /// Cut-off, Hz.
        cut_off_hz: u16,
    },
}

/// How to set the sensor up.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Config {
    /// Output rate, Hz: 10, 20, 50, 100, 200, 333, 500 or 1000. Default 200, which every model and bit rate allows.
    pub rate_hz: u16,
    /// Filter. Default off: the host filters wrench and pose alike.
    pub filter: Filter,
    /// Scale. Default 50 counts/N and 2000 counts/(N m), RFT40 and RFT60.
    pub scale: Scale,
    /// Which side's wrench the sensor reports. Default environment on tool; unconfirmed on hardware.
    pub sign: Sign,
    /// Set the sensor up, or only listen. Default set up.
    pub startup: Startup,
    /// Longest wait for an answer, of three attempts. Default 300 ms: storing a setting takes its time.
    pub answer_timeout: Duration,
    /// Silence after which the stream counts as lost. Default 500 ms.
    pub silence_timeout: Duration,
    /// Pause between being lost and the next attempt. Default 1 s.
    pub retry_after: Duration,
}

impl Default for Config {
    fn default() -> Self {
        Self {
            rate_hz: 200,
            filter: Filter::Off,
            scale: Scale {
                counts_per_newton: 50.0,
                counts_per_newton_metre: 2000.0,
            },
            sign: Sign::default(),
            startup: Startup::default(),
            answer_timeout: Duration::from_millis(300),
            silence_timeout: Duration::from_millis(500),
            retry_after: Duration::from_secs(1),
        }
    }
}
