//! ROS 1 bags, as far as a wrench needs.
//!
//! A bag is read once, from its begin to its end, record by record; only the samples that are wanted stay in memory.

use std::fmt;
use std::fs::File;
use std::io::BufReader;
use std::path::{Path, PathBuf};

use ft_recording::message::{Header, Temperature, WrenchStamped};
use ft_recording::qos::Qos;
use ft_recording::rewrite::Rewrite;
use ft_recording::{MessageStamps, Stamped, metadata, topic};
use ft_wire::HostTime;
use ft_wire::frames::{Frame, FtSensor};
use serde::Serialize;

mod records;

use records::{Connection, Records, ScanError, Sink};

use super::aria::import_entries;
use super::mps::SourceFile;
use super::{ImportError, io};

/// Topics of the Hoi! gripper's sensor.
pub const HOI_WRENCH: &str = "/force_torque/ft_sensor0/ft_sensor_readings/wrench";
/// Beside it.
pub const HOI_TEMPERATURE: &str = "/force_torque/ft_sensor0/ft_sensor_readings/temperature";

const WRENCH_TYPE: &str = "geometry_msgs/WrenchStamped";
const TEMPERATURE_TYPE: &str = "sensor_msgs/Temperature";

/// What came out of a bag.
#[derive(Clone, Debug, Serialize)]
pub struct BagReport {
    /// The recording.
    pub path: PathBuf,
    /// The bag.
    pub source: SourceFile,
    /// Wrenches and temperatures.
    pub samples: [u64; 2],
    /// Wrenches and temperatures that are not finite or cannot be decoded.
    pub left_out: [u64; 2],
    /// A topic of the temperature's name that has another type.
    pub other_temperature: Option<String>,
    /// Chunks whose rest was left out, because a record in it does not fit.
    pub damaged_chunks: u64,
    /// Whether the bag's end is missing.
    pub cut_short: bool,
    /// What looks like other units.
    pub doubts: Vec<String>,
}

impl BagReport {
    /// Whether anything of the bag is missing.
    #[must_use]
    pub const fn lost_data(&self) -> bool {
        self.cut_short || self.damaged_chunks > 0
    }
}

/// Samples of a topic on their way in.
struct Wanted<'a, const N: usize> {
    topic: &'a str,
    kind: &'static str,
    samples: Vec<Stamped<[f64; N]>>,
    left_out: u64,
}

impl<'a, const N: usize> Wanted<'a, N> {
    const fn new(topic: &'a str, kind: &'static str) -> Self {
        Self {
            topic,
            kind,
            samples: Vec::new(),
            left_out: 0,
        }
    }

    fn is(&self, connection: &Connection) -> bool {
        connection.topic == self.topic && connection.kind == self.kind
    }

    /// By the header's stamp; the bag's own time is that of the recorder.
    fn take(&mut self, data: &[u8]) {
        let mut fields = Fields(data);
        let sample = fields.header().zip(fields.numbers::<N>());
        match sample.filter(|(_, value)| value.iter().all(|number| number.is_finite())) {
            Some((at, value)) => self.samples.push(Stamped { at, value }),
            None => self.left_out += 1,
        }
    }
}

struct Samples<'a> {
    wrench: Wanted<'a, 6>,
    temperature: Wanted<'a, 1>,
}

impl Sink for Samples<'_> {
    fn wants(&self, connection: &Connection) -> bool {
        self.wrench.is(connection) || self.temperature.is(connection)
    }

    fn take(&mut self, connection: &Connection, data: &[u8]) {
        if self.wrench.is(connection) {
            self.wrench.take(data);
        } else {
            self.temperature.take(data);
        }
    }
}

/// Writes `out` with the wrench (and the temperature, if there is one) of a bag; poses come by
/// [`import_aria`](super::aria::import_aria). `progress` hears how many bytes of how many were read.
///
/// # Errors
/// The bag cannot be read, is none of format 2.0, has packed chunks, has no such topic or no wrench on it, or `out` cannot be written.
pub fn import_bag(
    bag: &Path,
    wrench: &str,
    temperature: &str,
    out: &Path,
    overwrite: bool,
    progress: &mut dyn FnMut(u64, u64),
) -> Result<BagReport, ImportError> {
    let file = File::open(bag).map_err(io("open", bag))?;
    let length = file.metadata().map_err(io("read", bag))?.len();
    let mut samples = Samples {
        wrench: Wanted::new(wrench, WRENCH_TYPE),
        temperature: Wanted::new(temperature, TEMPERATURE_TYPE),
    };
    let mut records = Records::new(BufReader::with_capacity(1 << 20, file));
    let scanned = records.scan(&mut samples, &mut |at| progress(at, length));
    let (mut wrenches, mut temperatures) = (samples.wrench, samples.temperature);
    let scanned = scanned.map_err(|error| match error {
        ScanError::Io(source) => io("read", bag)(source),
        ScanError::Format(reason) => ImportError::Content {
            path: bag.to_owned(),
            reason,
        },
    })?;
    if wrenches.samples.is_empty() {
        let topics = records.topics();
        let there: Vec<_> = topics
            .iter()
            .map(|(topic, kind)| format!("{topic} ({kind})"))
            .collect();
        return Err(ImportError::Content {
            path: bag.to_owned(),
            reason: format!(
                "no usable {WRENCH_TYPE} on {wrench} ({} unusable); name the topic with --wrench, there are {}",
                wrenches.left_out,
                there.join(", ")
            ),
        });
    }
    wrenches.samples.sort_by_key(|sample| sample.at);
    temperatures.samples.sort_by_key(|sample| sample.at);
    let other = records.topics().get(temperature).copied();
    let report = BagReport {
        path: out.to_owned(),
        source: SourceFile::named(bag, scanned.sha256),
        samples: [wrenches.samples.len(), temperatures.samples.len()].map(|n| n as u64),
        left_out: [wrenches.left_out, temperatures.left_out],
        other_temperature: other
            .filter(|kind| *kind != TEMPERATURE_TYPE)
            .map(|kind| format!("{temperature} ({kind})")),
        damaged_chunks: scanned.damaged_chunks,
        cut_short: scanned.cut_short,
        doubts: super::plausible::of_wrench(&wrenches.samples),
    };
    let mut rewrite = Rewrite::new();
    let stamps = |at| MessageStamps {
        log_time: at,
        publish_time: at,
    };
    let messages = wrenches.samples.into_iter().map(|sample| {
        let (header, wrench) = (Header::new(sample.at, FtSensor::NAME), sample.value.into());
        (stamps(sample.at), WrenchStamped { header, wrench })
    });
    rewrite.add(topic::WRENCH, Qos::SENSOR, messages);
    if !temperatures.samples.is_empty() {
        let messages = temperatures.samples.into_iter().map(|sample| {
            let header = Header::new(sample.at, FtSensor::NAME);
            let ([temperature], variance) = (sample.value, 0.0);
            (
                stamps(sample.at),
                Temperature {
                    header,
                    temperature,
                    variance,
                },
            )
        });
        rewrite.add(topic::TEMPERATURE, Qos::SENSOR, messages);
    }
    rewrite.metadata(metadata::IMPORT, import_entries("bag", &report));
    rewrite.write(None, out, overwrite)?;
    Ok(report)
}

impl fmt::Display for BagReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [wrenches, temperatures] = self.samples;
        write!(
            f,
            "{}: {wrenches} wrenches, {temperatures} temperatures",
            self.path.display()
        )?;
        for (count, what) in self.left_out.into_iter().zip(["wrenches", "temperatures"]) {
            if count > 0 {
                write!(f, "; {count} {what} left out: not finite, or cut short")?;
            }
        }
        if let Some(other) = &self.other_temperature {
            write!(f, "; no temperature: {other} is of another type")?;
        }
        if self.damaged_chunks > 0 {
            write!(
                f,
                "; {} chunks are damaged: what came after the damage in each is missing",
                self.damaged_chunks
            )?;
        }
        if self.cut_short {
            write!(f, "; the bag ends in the middle of a record")?;
        }
        for doubt in &self.doubts {
            write!(f, "\n  doubtful: {doubt}")?;
        }
        Ok(())
    }
}

/// What is left of a serialized message.
///
/// # Source
/// geometry_msgs/WrenchStamped and sensor_msgs/Temperature of ROS 1; wiki.ros.org/msg.
struct Fields<'a>(&'a [u8]);

impl Fields<'_> {
    fn take<const N: usize>(&mut self) -> Option<[u8; N]> {
        let (first, rest) = self.0.split_first_chunk::<N>()?;
        self.0 = rest;
        Some(*first)
    }

    fn word(&mut self) -> Option<u32> {
        self.take().map(u32::from_le_bytes)
    }

    /// `std_msgs/Header`: sequence, stamp, frame.
    fn header(&mut self) -> Option<HostTime> {
        let [_, seconds, nanos] = [self.word()?, self.word()?, self.word()?];
        let frame = usize::try_from(self.word()?).ok()?;
        self.0 = self.0.get(frame..)?;
        Some(HostTime::from_nanos(
            i64::from(seconds) * 1_000_000_000 + i64::from(nanos),
        ))
    }

    fn numbers<const N: usize>(&mut self) -> Option<[f64; N]> {
        let mut found = [0.0; N];
        for number in &mut found {
            *number = f64::from_le_bytes(self.take()?);
        }
        Some(found)
    }
}

#[cfg(test)]
mod tests;
