//! Stamps of a finished recording anew: the device clocks smoothed over the whole recording instead of followed causally.
//!
//! The raw frames go through the drivers again, which gives every sample's instant on its device's clock; the offline smoother
//! ([`ft_drivers::translate::smooth`]) puts them on the host's; and a new recording gets stamps that are moved by as much.

use std::cell::RefCell;
use std::collections::BTreeMap;
use std::fmt;
use std::path::{Path, PathBuf};
use std::rc::Rc;
use std::time::Duration;

use ft_drivers::translate::{Counted, OneWayConfig, smooth};
use ft_recording::rewrite::Rewrite;
use ft_recording::{metadata, topic};
use ft_wire::HostTime;
use serde::Serialize;

use super::SessionError;
use super::replay::{Source, play};
use crate::config::Driver;
use crate::item::{Body, Item};

/// What was moved.
#[derive(Clone, Debug, Serialize)]
pub struct Retimed {
    /// The new recording.
    pub path: PathBuf,
    /// By topic.
    pub topics: BTreeMap<String, Moved>,
}

/// How far a topic's samples were moved.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Moved {
    /// Samples on a device's clock.
    pub samples: u64,
    /// Root mean square of the moves, us.
    pub rms_us: f64,
    /// The largest move, us, with its sign.
    pub largest_us: f64,
    /// Messages without a raw frame, whose stamps stay.
    pub kept: u64,
}

/// Writes `out`: the recording `file` with smoothed stamps. `file` stays as it is.
///
/// # Errors
/// `file` has no raw frames, no configuration or no device with a clock, or is damaged; `out` exists or cannot be written.
pub fn retime(file: &Path, out: &Path, overwrite: bool) -> Result<Retimed, SessionError> {
    let source = Source::read(file)?;
    let devices: Vec<(&'static str, OneWayConfig)> = source
        .config
        .devices
        .iter()
        .map(|device| {
            let config = clock_of(device.driver, device.latency_us);
            (device.driver.topic(), config)
        })
        .collect();
    let seen = listen(file, source, devices.len())?;
    let mut moves: BTreeMap<&str, Moves> = BTreeMap::new();
    for ((name, config), seen) in devices.iter().zip(&seen) {
        if !seen.is_empty() {
            moves.insert(name, Moves::of(seen, config));
        }
    }
    if moves.is_empty() {
        return Err(SessionError::NoDeviceClock {
            path: file.display().to_string(),
        });
    }
    let mut topics: BTreeMap<String, Moved> = moves
        .iter()
        .map(|(name, moves)| ((*name).to_owned(), moves.summary()))
        .collect();
    let mut rewrite = Rewrite::new();
    let entries = BTreeMap::from([(
        "json".to_owned(),
        serde_json::to_string(&topics).unwrap_or_default(),
    )]);
    rewrite.metadata(metadata::RETIMED, entries);
    rewrite.restamp(|name, stamp, arrival| {
        // A sensor's temperature comes with its wrench.
        let device = if name == topic::TEMPERATURE {
            topic::WRENCH
        } else {
            name
        };
        match moves.get(device).and_then(|moves| moves.at(stamp, arrival)) {
            Some(moved_ns) => {
                let at = HostTime::from_nanos(stamp.as_nanos().saturating_add(moved_ns));
                at.min(arrival.max(stamp))
            }
            None => {
                if let Some(moved) = topics.get_mut(device) {
                    moved.kept += 1;
                }
                stamp
            }
        }
    });
    rewrite.write(Some(file), out, overwrite)?;
    Ok(Retimed {
        path: out.to_owned(),
        topics,
    })
}

/// Bounds of a device's clock. One that is made of the number of samples has a period that was learned, not a crystal's.
fn clock_of(driver: Driver, latency_us: f64) -> OneWayConfig {
    let config = OneWayConfig {
        link_delay: Duration::from_secs_f64(latency_us * 1e-6),
        ..OneWayConfig::default()
    };
    if driver.samples_evenly() {
        Counted::bounds(config)
    } else {
        config
    }
}

/// A sample of a device with a clock.
#[derive(Clone, Copy, Debug)]
struct Seen {
    device_ns: i64,
    arrival: HostTime,
    /// As the causal translator stamped it.
    causal: HostTime,
}

/// What each device's clock said, in the order of arrival.
fn listen(file: &Path, source: Source, devices: usize) -> Result<Vec<Vec<Seen>>, SessionError> {
    let seen = Rc::new(RefCell::new(vec![Vec::new(); devices]));
    let taken = Rc::clone(&seen);
    let listener = move |item: &Item| {
        let at = match &item.body {
            Body::Wrench(reading) => reading.at,
            Body::Width(reading) => reading.at,
            Body::Pose(reading) => reading.at,
            _ => return,
        };
        let mut seen = taken.borrow_mut();
        let of_device: Option<&mut Vec<Seen>> = item.device.and_then(|index| seen.get_mut(index));
        if let (Some(device_ns), Some(of_device)) = (at.device_ns, of_device) {
            of_device.push(Seen {
                device_ns,
                arrival: at.arrival,
                causal: item.sample_time,
            });
        }
    };
    play(file, source, None, Some(Box::new(listener)))?;
    Ok(seen.take())
}

/// By how much a device's samples are moved, ns.
struct Moves {
    /// (arrival, causal stamp, move), by arrival.
    samples: Vec<(HostTime, HostTime, i64)>,
}

impl Moves {
    fn of(seen: &[Seen], config: &OneWayConfig) -> Self {
        let observations: Vec<_> = seen
            .iter()
            .map(|one| (one.device_ns, one.arrival))
            .collect();
        let smoothed = smooth(&observations, config);
        let mut samples: Vec<_> = seen
            .iter()
            .zip(smoothed)
            .map(|(one, at)| {
                let moved_ns = at.as_nanos().saturating_sub(one.causal.as_nanos());
                (one.arrival, one.causal, moved_ns)
            })
            .collect();
        samples.sort_by_key(|(arrival, ..)| *arrival);
        Self { samples }
    }

    /// The move of the sample that came at `arrival` and is stamped nearest to `stamp`.
    fn at(&self, stamp: HostTime, arrival: HostTime) -> Option<i64> {
        let from = self.samples.partition_point(|(at, ..)| *at < arrival);
        let same = self.samples[from..]
            .iter()
            .take_while(|(at, ..)| *at == arrival);
        same.min_by_key(|(_, causal, _)| causal.as_nanos().abs_diff(stamp.as_nanos()))
            .map(|(.., moved_ns)| *moved_ns)
    }

    fn summary(&self) -> Moved {
        let moves = || {
            self.samples
                .iter()
                .map(|(.., moved_ns)| 1e-3 * *moved_ns as f64)
        };
        let power = moves().map(|moved| moved * moved).sum::<f64>();
        Moved {
            samples: self.samples.len() as u64,
            rms_us: (power / self.samples.len().max(1) as f64).sqrt(),
            largest_us: moves().fold(0.0, |a: f64, b| if b.abs() > a.abs() { b } else { a }),
            kept: 0,
        }
    }
}

impl fmt::Display for Retimed {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (name, moved) in &self.topics {
            writeln!(
                f,
                "{name}: {} samples moved by {:.1} us rms, {:+.1} us at most; {} without a raw frame stay",
                moved.samples, moved.rms_us, moved.largest_us, moved.kept
            )?;
        }
        write!(f, "written to {}", self.path.display())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Root mean square error of the smoothed stamps, us: 30 s at 1 kHz whose device clock, or learned period, is 0.15 % off, in
    /// bursts of 16 ms.
    fn error_us(driver: Driver) -> f64 {
        let truth = |k: i64| 1_700_000_000_000_000_000 + k * 1_000_000;
        let seen: Vec<_> = (0..30_000)
            .map(|k| {
                let arrival = HostTime::from_nanos((truth(k) / 16_000_000 + 1) * 16_000_000);
                Seen {
                    device_ns: k * 1_001_500,
                    arrival,
                    causal: arrival,
                }
            })
            .collect();
        let moves = Moves::of(&seen, &clock_of(driver, 0.0));
        let error = |(k, (_, causal, moved)): (usize, &(HostTime, HostTime, i64))| {
            1e-3 * (causal.as_nanos() + moved - truth(k as i64)) as f64
        };
        let power = moves
            .samples
            .iter()
            .enumerate()
            .map(error)
            .map(|e| e * e)
            .sum::<f64>();
        (power / moves.samples.len() as f64).sqrt()
    }

    #[test]
    fn a_learned_period_may_be_farther_off_than_a_crystal() {
        let (counted, crystal) = (error_us(Driver::RobotousUart), error_us(Driver::BotaSerial));
        println!("counted {counted:.0} us, held to a crystal's bounds {crystal:.0} us");
        // Up to a sample period stays hidden behind bursts that are in step.
        assert!(counted < 1_000.0, "{counted}");
        assert!(crystal > 2_000.0, "{crystal}");
    }
}
