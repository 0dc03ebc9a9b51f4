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

use ft_drivers::reading::SampleInstant;
use ft_drivers::translate::{Counted, OneWayConfig, smooth};
use ft_recording::reader::{Record, RecordReader};
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
    /// Messages that were moved.
    pub samples: u64,
    /// Root mean square of the moves, us.
    pub rms_us: f64,
    /// The largest move, us, with its sign.
    pub largest_us: f64,
    /// Messages whose stamps stay: they have no raw frame, or were stamped by another translator.
    pub kept: u64,
}

/// Writes `out`: the recording `file` with smoothed stamps. `file` stays as it is.
///
/// # Errors
/// `file` has no raw frames, no configuration or no device with a clock, was smoothed already, or is damaged; `out` exists or cannot be written.
pub fn retime(file: &Path, out: &Path, overwrite: bool) -> Result<Retimed, SessionError> {
    let source = Source::read(file)?;
    if source.is_retimed {
        return Err(SessionError::NotReplayable {
            path: file.display().to_string(),
            what: "its stamps were smoothed already (metadata ft.retimed): give the recording that it was made from",
        });
    }
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
    let mut topics = BTreeMap::new();
    let mut recorded = recorded(file)?;
    for (name, moves) in &mut moves {
        let stamps = recorded.remove(*name).unwrap_or_default();
        topics.insert((*name).to_owned(), moves.fit(&stamps));
    }
    // What is left comes with another topic, or has no device's clock.
    for (name, stamps) in recorded {
        if let Some(moves) = moves.get(device_topic(&name)) {
            topics.insert(name, moves.moved(&stamps));
        }
    }
    let mut rewrite = Rewrite::new();
    let entries = BTreeMap::from([(
        "json".to_owned(),
        serde_json::to_string(&topics).unwrap_or_default(),
    )]);
    rewrite.metadata(metadata::RETIMED, entries);
    rewrite.restamp(|name, stamp, arrival| {
        let moves = moves.get(device_topic(name));
        match moves.and_then(|moves| moves.at(stamp, arrival)) {
            Some(moved_ns) => {
                let at = HostTime::from_nanos(stamp.as_nanos().saturating_add(moved_ns));
                at.min(arrival.max(stamp))
            }
            None => stamp,
        }
    });
    rewrite.write(Some(file), out, overwrite)?;
    Ok(Retimed {
        path: out.to_owned(),
        topics,
    })
}

/// The topic of the device that stamps `topic`: a sensor's temperature comes with its wrench.
fn device_topic(topic: &str) -> &str {
    if topic == topic::TEMPERATURE {
        topic::WRENCH
    } else {
        topic
    }
}

/// (Arrival, stamp) of all messages, by topic.
fn recorded(file: &Path) -> Result<BTreeMap<String, Vec<(HostTime, HostTime)>>, SessionError> {
    let mut reader = RecordReader::open(file)?;
    let mut topics = BTreeMap::new();
    let mut found: BTreeMap<String, Vec<_>> = BTreeMap::new();
    let time = |nanos| i64::try_from(nanos).map_or(HostTime::FAR_FUTURE, HostTime::from_nanos);
    while let Some(record) = reader.next_record()? {
        match record {
            Record::Channel(channel) => {
                topics.insert(channel.id, channel.topic);
            }
            Record::Message(message) => {
                // Ours are published when they are stamped.
                if let Some(topic) = topics.get(&message.channel_id) {
                    let stamps = (time(message.log_time), time(message.publish_time));
                    match found.get_mut(topic) {
                        Some(stamped) => stamped.push(stamps),
                        None => drop(found.insert(topic.clone(), vec![stamps])),
                    }
                }
            }
            _ => {}
        }
    }
    Ok(found)
}

/// Bounds of a device's clock. One that is made of the number of samples has a period that was learned, not a crystal's.
fn clock_of(driver: Driver, latency_us: f64) -> OneWayConfig {
    let config = OneWayConfig {
        link_delay: Duration::from_secs_f64(latency_us * 1e-6),
        ..OneWayConfig::default()
    };
    if driver.samples_evenly().is_some() {
        // Until its period was mended it may be off by any number of samples.
        OneWayConfig {
            max_skew_ppm: 1e6,
            ..Counted::bounds(config)
        }
    } else {
        config
    }
}

/// A sample of a device with a clock.
#[derive(Clone, Copy, Debug)]
struct Seen {
    clock_epoch: u32,
    device_ns: i64,
    arrival: HostTime,
    /// As the causal translator stamped it.
    causal: HostTime,
}

/// `None` when the device had no clock yet.
fn seen_of(item: &Item, at: SampleInstant) -> Option<Seen> {
    Some(Seen {
        clock_epoch: item.clock_epoch,
        device_ns: at.device_ns?,
        arrival: at.arrival,
        causal: item.sample_time,
    })
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
        if let (Some(one), Some(of_device)) = (seen_of(item, at), of_device) {
            of_device.push(one);
        }
    };
    play(file, source, None, Some(Box::new(listener)))?;
    Ok(seen.take())
}

/// A stamp that differs by more than this from the replayed one is another translator's, ns.
const SAME_NS: u64 = 10_000;

/// By how much a device's samples are moved, ns.
struct Moves {
    /// (arrival, causal stamp, move), by arrival.
    samples: Vec<(HostTime, HostTime, i64)>,
    /// By how much all recorded stamps are later than the causal ones, ns: poses may have been aligned.
    aligned_ns: i64,
}

impl Moves {
    fn of(seen: &[Seen], config: &OneWayConfig) -> Self {
        let mut samples = Vec::with_capacity(seen.len());
        // A clock that begins anew, or counts by another period, is another clock.
        for piece in seen.chunk_by(|a, b| a.clock_epoch == b.clock_epoch) {
            let observations: Vec<_> = piece
                .iter()
                .map(|one| (one.device_ns, one.arrival))
                .collect();
            let smoothed = smooth(&observations, config);
            samples.extend(piece.iter().zip(smoothed).map(|(one, at)| {
                let moved_ns = at.as_nanos().saturating_sub(one.causal.as_nanos());
                (one.arrival, one.causal, moved_ns)
            }));
        }
        samples.sort_by_key(|(arrival, ..)| *arrival);
        Self {
            samples,
            aligned_ns: 0,
        }
    }

    /// Learns from what was recorded, (arrival, stamp), how it was aligned; and tells what becomes of it.
    fn fit(&mut self, recorded: &[(HostTime, HostTime)]) -> Moved {
        // The newest of those that came together, on both sides.
        let mut apart: Vec<i64> = recorded
            .chunk_by(|a, b| a.0 == b.0)
            .filter_map(|same| {
                let (arrival, stamp) = same.iter().max_by_key(|(_, stamp)| *stamp)?;
                let causal = self
                    .of_arrival(*arrival)
                    .map(|(_, causal, _)| causal)
                    .max()?;
                Some(stamp.as_nanos().saturating_sub(causal.as_nanos()))
            })
            .collect();
        if !apart.is_empty() {
            let middle = apart.len() / 2;
            self.aligned_ns = *apart.select_nth_unstable(middle).1;
        }
        self.moved(recorded)
    }

    /// What becomes of recorded (arrival, stamp).
    fn moved(&self, recorded: &[(HostTime, HostTime)]) -> Moved {
        let moves: Vec<_> = recorded
            .iter()
            .filter_map(|(arrival, stamp)| self.at(*stamp, *arrival))
            .map(|moved_ns| 1e-3 * moved_ns as f64)
            .collect();
        let power = moves.iter().map(|moved| moved * moved).sum::<f64>();
        let larger = |a: f64, b: &f64| if b.abs() > a.abs() { *b } else { a };
        Moved {
            samples: moves.len() as u64,
            rms_us: (power / moves.len().max(1) as f64).sqrt(),
            largest_us: moves.iter().fold(0.0, larger),
            kept: (recorded.len() - moves.len()) as u64,
        }
    }

    fn of_arrival(&self, arrival: HostTime) -> impl Iterator<Item = &(HostTime, HostTime, i64)> {
        let from = self.samples.partition_point(|(at, ..)| *at < arrival);
        let rest = self.samples.get(from..).unwrap_or_default();
        rest.iter().take_while(move |(at, ..)| *at == arrival)
    }

    /// The move of the sample that came at `arrival` and is stamped `stamp` by the causal translator too.
    fn at(&self, stamp: HostTime, arrival: HostTime) -> Option<i64> {
        let causal_ns = stamp.as_nanos().saturating_sub(self.aligned_ns);
        let off = |causal: &HostTime| causal.as_nanos().abs_diff(causal_ns);
        self.of_arrival(arrival)
            .filter(|(_, causal, _)| off(causal) <= SAME_NS)
            .min_by_key(|(_, causal, _)| off(causal))
            .map(|(.., moved_ns)| *moved_ns)
    }
}

impl fmt::Display for Retimed {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (name, moved) in &self.topics {
            writeln!(
                f,
                "{name}: {} samples moved by {:.1} us rms, {:+.1} us at most; {} stay, without a raw frame or stamped otherwise",
                moved.samples, moved.rms_us, moved.largest_us, moved.kept
            )?;
        }
        write!(f, "written to {}", self.path.display())
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "a test that cannot go on has failed")]

    use super::*;

    /// Root mean square error of the smoothed stamps, us: 30 s at 1 kHz whose device clock, or learned period, is 0.15 % off, in
    /// bursts of 16 ms.
    fn error_us(driver: Driver) -> f64 {
        let truth = |k: i64| 1_700_000_000_000_000_000 + k * 1_000_000;
        let seen: Vec<_> = (0..30_000)
            .map(|k| {
                let arrival = HostTime::from_nanos((truth(k) / 16_000_000 + 1) * 16_000_000);
                Seen {
                    clock_epoch: 0,
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

    /// What a listener hears of a counted sensor: 40 s at 100 Hz behind an adapter that hands over every 16 ms, without the samples in
    /// `lost`; beside it when each was true, ns.
    fn counted(lost: &[i64]) -> (Vec<Seen>, Vec<i64>) {
        use ft_drivers::reading::{Quality, Reading, WrenchReading};

        #[derive(Clone, Default)]
        struct Heard(Rc<RefCell<Vec<Item>>>);
        impl crate::channel::Intake for Heard {
            fn put(&mut self, item: Item, _: &crate::ledger::StreamCounters) {
                self.0.borrow_mut().push(item);
            }
        }

        let heard = Heard::default();
        let mut channel = crate::channel::Channel::new(
            0,
            heard.clone(),
            std::sync::Arc::default(),
            Duration::ZERO,
        )
        .sampling_evenly(Some(ft_drivers::translate::Handover::Polled));
        let true_ns = |k: i64| 1_700_000_000_000_000_000 + k * 10_000_000;
        for k in (0..4_000).filter(|k| !lost.contains(k)) {
            let arrival = HostTime::from_nanos((true_ns(k) / 16_000_000 + 1) * 16_000_000);
            let reading = Reading::Wrench(WrenchReading {
                at: SampleInstant {
                    arrival,
                    device_ns: None,
                },
                wrench: ft_wire::frames::Wrench::from_array([0.0; 6]),
                temperature_celsius: None,
                quality: Quality::Good,
                status_bits: k as u32,
            });
            ft_drivers::pump::Outlet::<ft_wire::CanFrame>::reading(&mut channel, reading);
        }
        let heard = heard.0.borrow();
        let seen = heard.iter().filter_map(|item| match &item.body {
            Body::Wrench(reading) => {
                let seen = seen_of(item, reading.at)?;
                Some((seen, true_ns(i64::from(reading.status_bits))))
            }
            _ => None,
        });
        seen.unzip()
    }

    #[test]
    fn a_period_that_was_mended_bends_no_stamps() {
        let config = clock_of(Driver::RobotousUart, 0.0);
        let (seen, truth) = counted(&[40, 41, 42, 90, 91]);
        let epochs = seen.last().unwrap().clock_epoch;
        assert_eq!(epochs, 1, "the period was mended once");
        let moves = Moves::of(&seen, &config);
        let off = |((_, causal, moved), truth): (&(HostTime, HostTime, i64), &i64)| {
            (causal.as_nanos() + moved - truth).abs() / 1_000
        };
        let worst = moves.samples.iter().zip(&truth).map(off).max().unwrap();
        println!("worst {worst} us");
        // Up to 16 ms as they came.
        assert!(worst < 3_000, "{worst} us");
    }

    #[test]
    fn only_stamps_of_this_translator_are_moved_and_an_alignment_is_kept() {
        let at = |k: i64| HostTime::from_nanos(1_700_000_000_000_000_000 + k * 1_000_000);
        // Two come together.
        let seen: Vec<_> = (0..100)
            .map(|k| Seen {
                clock_epoch: 0,
                device_ns: k * 1_000_000,
                arrival: at(k / 2 * 2 + 3),
                causal: at(k),
            })
            .collect();
        let mut moves = Moves::of(&seen, &clock_of(Driver::BotaSerial, 0.0));
        let recorded = |by_us: &dyn Fn(i64) -> i64| -> Vec<_> {
            let stamp = |k: i64| HostTime::from_nanos(at(k).as_nanos() + 1_000 * by_us(k));
            seen.iter()
                .zip(0..)
                .map(|(one, k)| (one.arrival, stamp(k)))
                .collect()
        };
        let moved = moves.fit(&recorded(&|_| 0));
        assert_eq!((moved.samples, moved.kept), (100, 0));
        let aligned = moves.fit(&recorded(&|_| -40_000));
        assert_eq!((aligned.samples, aligned.kept), (100, 0));
        assert_eq!(aligned.rms_us, moved.rms_us);
        assert_eq!(
            moves.at(HostTime::from_nanos(at(4).as_nanos() - 40_000_000), at(7)),
            moves.at(HostTime::from_nanos(at(4).as_nanos() - 39_999_000), at(7))
        );
        // Another translator stamped the last quarter.
        let other = moves.fit(&recorded(&|k| if k >= 75 { 100 + k } else { 0 }));
        assert_eq!((other.samples, other.kept), (75, 25));
        assert_eq!(moves.at(at(80), at(99)), None);
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
