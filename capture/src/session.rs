//! A session: devices in, recording and live topics out.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use ft_drivers::LinkError;
use ft_recording::calibration::Calibration;
use ft_recording::writer::WriterOptions;
use ft_wire::HostTime;

use crate::config::{Config, ConfigError, Device};
use crate::encode::static_transforms;
use crate::health::{Health, Named};
use crate::ledger::{OWN_STREAM, StreamCounters, StreamLedger};
use crate::settings::{in_effect, with_defaults};
use crate::sink::SinkError;
use crate::sink::mcap::Preamble;
use crate::summary::Summary;

pub mod control;
pub mod link_loop;
pub mod live;
pub mod outlets;
mod publisher;
mod recorder;
pub mod replay;
pub mod retime;
pub mod stepped;

/// What a session is to do.
#[derive(Clone, Debug)]
pub struct Plan {
    /// Devices, frames, calibration, network.
    pub config: Config,
    /// The recording; `None` only publishes.
    pub record: Option<PathBuf>,
    /// Replace an existing recording.
    pub overwrite: bool,
    /// Stop after this time.
    pub duration: Option<Duration>,
    /// Whether to publish on the network.
    pub publish: bool,
}

/// Why a session could not begin or had to end early. What was recorded is kept.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SessionError {
    /// The configuration makes no sense.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// A driver's settings make no sense.
    #[error("{device}: settings of {driver}: {what}")]
    Settings {
        /// The device's name.
        device: String,
        /// Its driver.
        driver: &'static str,
        /// Which key, and what is wanted.
        what: String,
    },
    /// There is no link to a simulated or replayed device.
    #[error("{device}: its driver finds no link of its kind")]
    NoSuchLink {
        /// The device's name.
        device: String,
    },
    /// A device comes over the network, and there is none.
    #[error("{device}: {port} needs the network, which could not be opened: see above")]
    NoNetwork {
        /// The device's name.
        device: String,
        /// Its port.
        port: String,
    },
    /// The recording that is to be read cannot be.
    #[error(transparent)]
    Read(#[from] ft_recording::error::ReadError),
    /// The new recording would take the place of the one that is read.
    #[error("{} is the recording that is read: name another for the new one", path.display())]
    IsSource {
        /// The recording.
        path: std::path::PathBuf,
    },
    /// The recording has nothing to replay.
    #[error("{path}: {what}")]
    NotReplayable {
        /// The recording.
        path: String,
        /// What is missing, and why.
        what: &'static str,
    },
    /// The recording's devices have no clock.
    #[error(
        "{path}: no device in it has a clock of its own (their stamps are arrivals less the link's delay), so there is nothing to smooth"
    )]
    NoDeviceClock {
        /// The recording.
        path: String,
    },
    /// The calibration makes no sense.
    #[error("calibration: {0}")]
    Calibration(#[from] ft_recording::error::CalibrationError),
    /// The configuration has something that cannot be written into the recording.
    #[error("the configuration cannot be written into the recording")]
    Unwritable(#[source] toml::ser::Error),
    /// None of the devices is there.
    #[error("no device can be opened: {reasons}")]
    NoDevice {
        /// Each device with what failed and what to check.
        reasons: String,
    },
    /// A device cannot be reached.
    #[error("{device}: {source}")]
    Link {
        /// The device's name.
        device: String,
        /// What failed.
        source: LinkError,
    },
    /// The recording or the network failed.
    #[error(transparent)]
    Sink(#[from] SinkError),
    /// The live page cannot be served.
    #[error(transparent)]
    Web(#[from] crate::web::WebError),
    /// The simulation cannot be run.
    #[error("simulation: {0}")]
    Simulation(String),
    /// The disk refused what the system had already taken.
    #[error(
        "the recording was written, and the disk reported an error on the way: check it with `ft-capture check`"
    )]
    Sync(#[source] std::io::Error),
    /// A thread could not be started.
    #[error("a thread could not be started")]
    Thread(#[source] std::io::Error),
    /// A thread ended in a way that should be impossible.
    #[error(
        "the {0} thread panicked: please report this; what was flushed is in the .partial file"
    )]
    Panicked(&'static str),
}

impl From<ft_recording::writer::WriteError> for SessionError {
    fn from(error: ft_recording::writer::WriteError) -> Self {
        Self::Sink(SinkError::Recording(error))
    }
}

impl Plan {
    /// How the recording is written.
    #[must_use]
    pub fn writer_options(&self) -> WriterOptions {
        WriterOptions {
            overwrite: self.overwrite,
            flush_period: Duration::from_millis(self.config.recording.flush_period_ms),
            ..WriterOptions::default()
        }
    }

    /// What the recording says about itself.
    ///
    /// # Errors
    /// The calibration or a device's settings make no sense, or the configuration cannot be written.
    pub fn preamble(
        &self,
        start: HostTime,
        anchor: HostTime,
        clock: &str,
    ) -> Result<Preamble, SessionError> {
        let session = BTreeMap::from([
            ("version".to_owned(), env!("CARGO_PKG_VERSION").to_owned()),
            ("id".to_owned(), self.config.id.clone()),
            ("clock".to_owned(), clock.to_owned()),
            ("start_unix_ns".to_owned(), start.as_nanos().to_string()),
            (
                "clock_anchor_unix_ns".to_owned(),
                anchor.as_nanos().to_string(),
            ),
            (
                "config".to_owned(),
                toml::to_string(&with_defaults(&self.config)?).map_err(SessionError::Unwritable)?,
            ),
        ]);
        let calibration = self
            .config
            .calibration
            .as_ref()
            .map(Calibration::to_metadata)
            .transpose()?;
        Ok(Preamble {
            session,
            calibration,
            static_transforms: static_transforms(&self.config.frames, start),
            start,
            devices: self
                .config
                .devices
                .iter()
                .map(|device| device.name.clone())
                .collect(),
        })
    }
}

/// Nothing is known yet of the plan's devices.
fn health(plan: &Plan, counters: &[Arc<StreamCounters>]) -> Health {
    let named = plan.config.devices.iter().zip(counters);
    Health::new(
        named
            .map(|(device, counters)| Named {
                name: device.name.clone(),
                driver: device.driver.name(),
                settings: settings_in_effect(device),
                counters: Arc::clone(counters),
            })
            .collect(),
    )
}

/// Keys and values of a device's settings for `/diagnostics`; of wrong ones there are none, and the session does not begin.
fn settings_in_effect(device: &Device) -> Vec<(String, String)> {
    in_effect(device)
        .unwrap_or_default()
        .into_iter()
        .map(|(key, value)| match value {
            toml::Value::String(text) => (key, text),
            value => (key, value.to_string()),
        })
        .collect()
}

/// The accounts when a recording began: what was counted before is not of that recording.
#[derive(Clone, Debug, Default)]
pub struct Baseline {
    /// Every device's, in the order of the configuration; empty = nothing was counted before.
    pub streams: Vec<StreamLedger>,
    /// The service's own.
    pub own: StreamLedger,
}

/// The metadata `ft.ledger`: one JSON object for each stream, and one for what the service itself says.
#[must_use]
pub fn ledger_metadata(
    health: &Health,
    own: StreamLedger,
    before: &Baseline,
) -> BTreeMap<String, String> {
    let own = own.since(&before.own);
    let own = serde_json::json!({"drops": own.drops, "view_drops": own.view_drops});
    let mut ledger: BTreeMap<String, String> = health
        .summary()
        .iter()
        .enumerate()
        .map(|(index, stream)| {
            let earlier = before.streams.get(index).copied().unwrap_or_default();
            (
                stream.name.clone(),
                serde_json::to_string(&stream.ledger.since(&earlier)).unwrap_or_default(),
            )
        })
        .collect();
    ledger.insert(OWN_STREAM.to_owned(), own.to_string());
    ledger
}

/// The summary of a session that ran from `start` to `end`.
#[must_use]
pub fn summarize(
    health: &Health,
    own: StreamLedger,
    start: HostTime,
    end: HostTime,
    files: Vec<FileSummary>,
) -> Summary {
    Summary {
        duration_s: end.seconds_since(start),
        streams: health.summary(),
        own_drops: own.drops,
        own_view_drops: own.view_drops,
        source_damage: Vec::new(),
        files,
    }
}

pub use crate::summary::FileSummary;

fn spawn<T: Send + 'static>(
    name: &str,
    work: impl FnOnce() -> T + Send + 'static,
) -> Result<std::thread::JoinHandle<T>, SessionError> {
    std::thread::Builder::new()
        .name(name.to_owned())
        .spawn(work)
        .map_err(SessionError::Thread)
}
