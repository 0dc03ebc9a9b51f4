//! ROS 1 bags, as far as a wrench needs: the wrench, the sensor's temperature and its gyroscope.
//!
//! A bag is read once, from its begin to its end, record by record; only the samples that are wanted stay in memory.

use std::fmt;
use std::fs::File;
use std::io::BufReader;
use std::path::{Path, PathBuf};

use ft_recording::rewrite::Rewrite;
use ft_recording::{Stamped, metadata};
use ft_wire::HostTime;
use serde::Serialize;

mod records;

use records::{Connection, Records, ScanError, Sink};

use super::mps::SourceFile;
use super::order::{SET_BACK, in_order};
use super::topics::{add_rates, add_temperature, add_wrench, import_entries};
use super::{ImportError, io, plausible};

/// Topics of the sensor in a bag.
#[derive(Clone, Copy, Debug)]
pub struct BagTopics<'a> {
    /// `geometry_msgs/WrenchStamped`.
    pub wrench: &'a str,
    /// `sensor_msgs/Temperature`; may be missing.
    pub temperature: &'a str,
    /// `sensor_msgs/Imu`, of which the angular rate is taken; may be missing.
    pub imu: &'a str,
}

impl BagTopics<'static> {
    /// Those of the Hoi! gripper.
    pub const HOI: Self = Self {
        wrench: "/force_torque/ft_sensor0/ft_sensor_readings/wrench",
        temperature: "/force_torque/ft_sensor0/ft_sensor_readings/temperature",
        imu: "/force_torque/ft_sensor0/ft_sensor_readings/imu",
    };
}

const WRENCH_TYPE: &str = "geometry_msgs/WrenchStamped";
const TEMPERATURE_TYPE: &str = "sensor_msgs/Temperature";
const IMU_TYPE: &str = "sensor_msgs/Imu";
/// Numbers of an `Imu` before its angular rate: an orientation and its covariance.
const BEFORE_RATE: usize = 4 + 9;

/// What came out of a bag.
#[derive(Clone, Debug, Serialize)]
pub struct BagReport {
    /// The recording.
    pub path: PathBuf,
    /// The bag.
    pub source: SourceFile,
    /// Wrenches, temperatures and angular rates.
    pub samples: [u64; 3],
    /// Of each those that are not finite, not measured, stamped hours away or cannot be decoded.
    pub left_out: [u64; 3],
    /// Of these, by a clock that was set back, or by the one before it.
    pub set_back: [u64; 3],
    /// Topics of the temperature's and the inertial unit's name that have another type.
    pub other_types: Vec<String>,
    /// Chunks whose rest was left out, because a record in it does not fit.
    pub damaged_chunks: u64,
    /// Whether the bag's end is missing.
    pub cut_short: bool,
    /// What looks like other units.
    pub doubts: Vec<String>,
}

impl BagReport {
    /// Whether anything of the bag, wrenches by another clock, or more than half of the wrench, are missing.
    #[must_use]
    pub const fn lost_data(&self) -> bool {
        let [wrenches, ..] = self.left_out;
        self.cut_short
            || self.damaged_chunks > 0
            || self.set_back[0] > 0
            || wrenches > self.samples[0]
    }
}

/// Samples of a topic on their way in.
struct Wanted<'a, const N: usize> {
    topic: &'a str,
    kind: &'static str,
    /// Numbers before those that are wanted.
    skip: usize,
    samples: Vec<Stamped<[f64; N]>>,
    left_out: u64,
    /// Of these, by a clock that was set back, or by the one before it.
    set_back: u64,
}

impl<'a, const N: usize> Wanted<'a, N> {
    const fn new(topic: &'a str, kind: &'static str, skip: usize) -> Self {
        Self {
            topic,
            kind,
            skip,
            samples: Vec::new(),
            left_out: 0,
            set_back: 0,
        }
    }

    /// By time, without those that are stamped as another, at another time, or by another clock.
    fn sort(&mut self) {
        let taken = std::mem::take(&mut self.samples).into_iter();
        let ordered = in_order(taken.map(|one| (one.at.as_nanos(), one.value)).collect());
        self.set_back = ordered.set_back;
        self.left_out += ordered.far + ordered.repeated + ordered.set_back;
        self.samples = ordered.stamped();
        self.left_out += plausible::leave_out_far(&mut self.samples);
    }

    fn is(&self, connection: &Connection) -> bool {
        connection.topic == self.topic && connection.kind == self.kind
    }

    /// By the header's stamp; the bag's own time is that of the recorder.
    fn take(&mut self, data: &[u8]) {
        let mut fields = Fields(data);
        let sample = fields.header().and_then(|at| {
            fields.skip(self.skip)?;
            Some((at, fields.numbers::<N>()?))
        });
        match sample.filter(|(_, value)| value.iter().all(|number| number.is_finite())) {
            Some((at, value)) => self.samples.push(Stamped { at, value }),
            None => self.left_out += 1,
        }
    }
}

/// A sample of the same instant.
const fn of<T, const N: usize>(sample: &Stamped<[f64; N]>, value: T) -> Stamped<T> {
    Stamped {
        at: sample.at,
        value,
    }
}

impl Wanted<'_, 4> {
    /// Angular rates, by time; a covariance that begins with -1 says that there are none.
    fn measured(&mut self) -> Vec<Stamped<[f64; 3]>> {
        self.sort();
        let rate = |sample: &Stamped<[f64; 4]>| {
            let [x, y, z, covariance] = sample.value;
            (covariance >= 0.0).then(|| of(sample, [x, y, z]))
        };
        let rates: Vec<_> = self.samples.iter().filter_map(rate).collect();
        self.left_out += (self.samples.len() - rates.len()) as u64;
        rates
    }
}

struct Samples<'a> {
    wrench: Wanted<'a, 6>,
    temperature: Wanted<'a, 1>,
    /// Rate, and the first number of its covariance.
    imu: Wanted<'a, 4>,
}

impl Sink for Samples<'_> {
    fn wants(&self, connection: &Connection) -> bool {
        self.wrench.is(connection) || self.temperature.is(connection) || self.imu.is(connection)
    }

    fn take(&mut self, connection: &Connection, data: &[u8]) {
        if self.wrench.is(connection) {
            self.wrench.take(data);
        } else if self.temperature.is(connection) {
            self.temperature.take(data);
        } else {
            self.imu.take(data);
        }
    }
}

/// Writes `out` with the wrench (and temperature and angular rate, if they are there) of a bag; poses come by
/// [`import_aria`](super::aria::import_aria). `progress` hears how many bytes of how many were read.
///
/// # Errors
/// The bag cannot be read, is none of format 2.0, has packed chunks, has no such topic or no wrench on it, or `out` cannot be written.
pub fn import_bag(
    bag: &Path,
    topics: &BagTopics<'_>,
    out: &Path,
    overwrite: bool,
    progress: &mut dyn FnMut(u64, u64),
) -> Result<BagReport, ImportError> {
    let file = File::open(bag).map_err(io("open", bag))?;
    let length = file.metadata().map_err(io("read", bag))?.len();
    let mut samples = Samples {
        wrench: Wanted::new(topics.wrench, WRENCH_TYPE, 0),
        temperature: Wanted::new(topics.temperature, TEMPERATURE_TYPE, 0),
        imu: Wanted::new(topics.imu, IMU_TYPE, BEFORE_RATE),
    };
    let mut records = Records::new(BufReader::with_capacity(1 << 20, file));
    let scanned = records.scan(&mut samples, &mut |at| progress(at, length));
    let Samples {
        mut wrench,
        mut temperature,
        mut imu,
    } = samples;
    let scanned = scanned.map_err(|error| match error {
        ScanError::Io(source) => io("read", bag)(source),
        ScanError::Format(reason) => ImportError::Content {
            path: bag.to_owned(),
            reason,
        },
    })?;
    wrench.sort();
    temperature.sort();
    if wrench.samples.is_empty() {
        let there: Vec<_> = records
            .topics()
            .iter()
            .map(|(topic, kind)| format!("{topic} ({kind})"))
            .collect();
        return Err(ImportError::Content {
            path: bag.to_owned(),
            reason: format!(
                "no usable {WRENCH_TYPE} on {} ({} unusable); name the topic with --wrench, there are {}",
                topics.wrench,
                wrench.left_out,
                there.join(", ")
            ),
        });
    }
    let temperatures: Vec<_> = temperature
        .samples
        .iter()
        .map(|sample| of(sample, sample.value[0]))
        .collect();
    let rates = imu.measured();
    let other_types = [
        (topics.temperature, TEMPERATURE_TYPE),
        (topics.imu, IMU_TYPE),
    ];
    let other_types = other_types.into_iter().filter_map(|(topic, wanted)| {
        let kind = records.topics().get(topic).copied()?;
        (kind != wanted).then(|| format!("{topic} ({kind})"))
    });
    let report = BagReport {
        path: out.to_owned(),
        source: SourceFile::named(bag, scanned.sha256),
        samples: [wrench.samples.len(), temperatures.len(), rates.len()].map(|n| n as u64),
        left_out: [wrench.left_out, temperature.left_out, imu.left_out],
        set_back: [wrench.set_back, temperature.set_back, imu.set_back],
        other_types: other_types.collect(),
        damaged_chunks: scanned.damaged_chunks,
        cut_short: scanned.cut_short,
        doubts: plausible::of_wrench(&wrench.samples),
    };
    let mut rewrite = Rewrite::new();
    add_wrench(&mut rewrite, &wrench.samples);
    add_temperature(&mut rewrite, &temperatures);
    add_rates(&mut rewrite, &rates);
    rewrite.metadata(metadata::IMPORT, import_entries("bag", &report));
    rewrite.write(None, out, overwrite)?;
    Ok(report)
}

impl fmt::Display for BagReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [wrenches, temperatures, rates] = self.samples;
        write!(
            f,
            "{}: {wrenches} wrenches, {temperatures} temperatures, {rates} angular rates",
            self.path.display()
        )?;
        let names = ["wrenches", "temperatures", "angular rates"];
        for (count, what) in self.left_out.into_iter().zip(names) {
            if count > 0 {
                write!(
                    f,
                    "; {count} {what} left out: not finite, not measured, stamped as another or at another time, or cut short"
                )?;
            }
        }
        for (count, what) in self.set_back.into_iter().zip(names) {
            if count > 0 {
                write!(f, "; {count} of these {what} are {SET_BACK}")?;
            }
        }
        for other in &self.other_types {
            write!(f, "; not read: {other} is of another type")?;
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
/// geometry_msgs/WrenchStamped, sensor_msgs/Temperature and sensor_msgs/Imu of ROS 1; wiki.ros.org/msg.
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

    fn skip(&mut self, numbers: usize) -> Option<()> {
        self.0 = self.0.get(8 * numbers..)?;
        Some(())
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
