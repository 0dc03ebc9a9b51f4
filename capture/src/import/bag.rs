//! ROS 1 bags, as far as a wrench needs: format 2.0, chunks that are not packed.
//!
//! ```text
//! "#ROSBAG V2.0\n", then records: u32 length, header, u32 length, data; a header is fields: u32 length, name "=" value
//! op 5 chunk: compression, size; its data are records   op 7 connection: conn, topic; data: type=, md5sum=, ...
//! op 2 message: conn, time (u32 s, u32 ns)              op 3, 4, 6: bag header, indices; not needed
//! ```
//!
//! All numbers are little endian. The indices are not used, so a bag whose recorder was killed reads as far as it goes.
//!
//! # Source
//! wiki.ros.org/Bags/Format/2.0; messages: geometry_msgs/WrenchStamped, sensor_msgs/Temperature of ROS 1.

use std::collections::BTreeMap;
use std::fmt;
use std::path::{Path, PathBuf};

use ft_recording::message::{Header, Temperature, WrenchStamped};
use ft_recording::qos::Qos;
use ft_recording::rewrite::Rewrite;
use ft_recording::{MessageStamps, Stamped, metadata, topic};
use ft_wire::HostTime;
use ft_wire::frames::{Frame, FtSensor};
use serde::Serialize;

use super::aria::import_entries;
use super::mps::SourceFile;
use super::{ImportError, io};

const MAGIC: &[u8] = b"#ROSBAG V2.0\n";
const OP_MESSAGE: u8 = 2;
const OP_CHUNK: u8 = 5;
const OP_CONNECTION: u8 = 7;

/// A bag in memory.
#[derive(Debug)]
pub struct Bag {
    bytes: Vec<u8>,
    connections: BTreeMap<u32, Connection>,
    /// (connection, where its data stand).
    messages: Vec<(u32, core::ops::Range<usize>)>,
    /// Whether the end of the file cut a record.
    pub cut_short: bool,
}

#[derive(Clone, Debug, PartialEq, Eq)]
struct Connection {
    topic: String,
    kind: String,
}

impl Bag {
    /// Reads a bag.
    ///
    /// # Errors
    /// It cannot be read, is no bag of format 2.0, or its chunks are packed.
    pub fn open(path: &Path) -> Result<Self, ImportError> {
        let bytes = std::fs::read(path).map_err(io("read", path))?;
        Self::from_bytes(bytes).map_err(|reason| ImportError::Content {
            path: path.to_owned(),
            reason,
        })
    }

    fn from_bytes(bytes: Vec<u8>) -> Result<Self, String> {
        if !bytes.starts_with(MAGIC) {
            return Err(
                "it is no ROS 1 bag of format 2.0 (a ROS 2 bag is read with --map as it is)"
                    .to_owned(),
            );
        }
        let mut bag = Self {
            connections: BTreeMap::new(),
            messages: Vec::new(),
            cut_short: false,
            bytes,
        };
        bag.scan(MAGIC.len()..bag.bytes.len(), true)?;
        Ok(bag)
    }

    fn scan(&mut self, range: core::ops::Range<usize>, outer: bool) -> Result<(), String> {
        let mut at = range.start;
        while at < range.end {
            let Some((header, data)) = record(&self.bytes[..range.end], at) else {
                self.cut_short = true;
                return Ok(());
            };
            at = data.end;
            let fields = fields(&self.bytes[header]);
            let number = |name: &str| {
                let value: [u8; 4] = fields.get(name)?.get(..4)?.try_into().ok()?;
                Some(u32::from_le_bytes(value))
            };
            match fields.get("op").and_then(|op| op.first()) {
                Some(&OP_CHUNK) if outer => {
                    let packed = fields.get("compression").copied().unwrap_or(b"none");
                    if packed != b"none" {
                        return Err(format!(
                            "its chunks are packed by {}: unpack it first with `rosbag decompress`",
                            String::from_utf8_lossy(packed)
                        ));
                    }
                    self.scan(data, false)?;
                }
                Some(&OP_CONNECTION) => {
                    let text = |bytes: Option<&&[u8]>| {
                        bytes.map_or(String::new(), |bytes| {
                            String::from_utf8_lossy(bytes).into_owned()
                        })
                    };
                    let inner = self::fields(&self.bytes[data]);
                    let connection = Connection {
                        topic: text(fields.get("topic")),
                        kind: text(inner.get("type")),
                    };
                    if let Some(id) = number("conn") {
                        self.connections.insert(id, connection);
                    }
                }
                Some(&OP_MESSAGE) => {
                    if let Some(id) = number("conn") {
                        self.messages.push((id, data));
                    }
                }
                _ => {}
            }
        }
        Ok(())
    }

    /// Topics and their types.
    #[must_use]
    pub fn topics(&self) -> BTreeMap<&str, &str> {
        self.connections
            .values()
            .map(|one| (one.topic.as_str(), one.kind.as_str()))
            .collect()
    }

    /// Messages of `topic` and type `kind` by their header's stamp, decoded by `decode`; those that cannot be are left out.
    fn stamped<T>(
        &self,
        topic: &str,
        kind: &str,
        decode: impl Fn(&mut Fields<'_>) -> Option<T>,
    ) -> Vec<Stamped<T>> {
        let mut found: Vec<_> = self
            .messages
            .iter()
            .filter(|(id, _)| {
                self.connections
                    .get(id)
                    .is_some_and(|one| one.topic == topic && one.kind == kind)
            })
            .filter_map(|(_, range)| {
                let mut fields = Fields(self.bytes.get(range.clone())?);
                let at = fields.header()?;
                Some(Stamped {
                    at,
                    value: decode(&mut fields)?,
                })
            })
            .collect();
        found.sort_by_key(|sample| sample.at);
        found
    }

    /// `geometry_msgs/WrenchStamped`: force then torque, by stamp. Values that are not finite are left out.
    #[must_use]
    pub fn wrenches(&self, topic: &str) -> Vec<Stamped<[f64; 6]>> {
        let mut found = self.stamped(topic, "geometry_msgs/WrenchStamped", |fields| {
            fields.numbers::<6>()
        });
        found.retain(|sample| sample.value.iter().all(|number| number.is_finite()));
        found
    }

    /// `sensor_msgs/Temperature`: degrees Celsius, by stamp.
    #[must_use]
    pub fn temperatures(&self, topic: &str) -> Vec<Stamped<f64>> {
        self.stamped(topic, "sensor_msgs/Temperature", |fields| {
            fields.numbers::<1>().map(|[value]| value)
        })
    }
}

/// Topics of the Hoi! gripper's sensor.
pub const HOI_WRENCH: &str = "/force_torque/ft_sensor0/ft_sensor_readings/wrench";
/// Beside it.
pub const HOI_TEMPERATURE: &str = "/force_torque/ft_sensor0/ft_sensor_readings/temperature";

/// What came out of a bag.
#[derive(Clone, Debug, Serialize)]
pub struct BagReport {
    /// The recording.
    pub path: PathBuf,
    /// The bag.
    pub source: SourceFile,
    /// Wrenches and temperatures.
    pub samples: [u64; 2],
    /// Whether the bag's end is missing.
    pub cut_short: bool,
}

/// Writes `out` with the wrench (and the temperature, if there is one) of a bag; poses come by
/// [`import_aria`](super::aria::import_aria).
///
/// # Errors
/// The bag cannot be read, has no such topic or no wrench on it, or `out` cannot be written.
pub fn import_bag(
    bag: &Path,
    wrench: &str,
    temperature: &str,
    out: &Path,
    overwrite: bool,
) -> Result<BagReport, ImportError> {
    let read = Bag::open(bag)?;
    let wrenches = read.wrenches(wrench);
    if wrenches.is_empty() {
        let there: Vec<_> = read
            .topics()
            .into_iter()
            .map(|(topic, kind)| format!("{topic} ({kind})"))
            .collect();
        return Err(ImportError::Content {
            path: bag.to_owned(),
            reason: format!(
                "no geometry_msgs/WrenchStamped on {wrench}; name the topic with --wrench, there are {}",
                there.join(", ")
            ),
        });
    }
    let temperatures = read.temperatures(temperature);
    let stamps = |at| MessageStamps {
        log_time: at,
        publish_time: at,
    };
    let report = BagReport {
        path: out.to_owned(),
        source: SourceFile::of(bag)?,
        samples: [wrenches.len() as u64, temperatures.len() as u64],
        cut_short: read.cut_short,
    };
    let mut rewrite = Rewrite::new();
    let messages = wrenches.into_iter().map(|sample| {
        let (header, wrench) = (Header::new(sample.at, FtSensor::NAME), sample.value.into());
        (stamps(sample.at), WrenchStamped { header, wrench })
    });
    rewrite.add(topic::WRENCH, Qos::SENSOR, messages);
    if !temperatures.is_empty() {
        let messages = temperatures.into_iter().map(|sample| {
            let header = Header::new(sample.at, FtSensor::NAME);
            let (temperature, variance) = (sample.value, 0.0);
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
        if self.cut_short {
            write!(f, "; the bag ends in the middle of a record")?;
        }
        Ok(())
    }
}

/// Header and data of the record at `at`; `None` when it does not fit.
fn record(bytes: &[u8], at: usize) -> Option<(core::ops::Range<usize>, core::ops::Range<usize>)> {
    let length = |at: usize| {
        let field: [u8; 4] = bytes.get(at..at.checked_add(4)?)?.try_into().ok()?;
        usize::try_from(u32::from_le_bytes(field)).ok()
    };
    let part = |at: usize| {
        let start = at.checked_add(4)?;
        let end = start.checked_add(length(at)?)?;
        (end <= bytes.len()).then_some(start..end)
    };
    let header = part(at)?;
    let data = part(header.end)?;
    Some((header, data))
}

/// `name=value` fields of a header.
fn fields(mut bytes: &[u8]) -> BTreeMap<&str, &[u8]> {
    let mut found = BTreeMap::new();
    while let Some((length, rest)) = bytes.split_first_chunk::<4>() {
        let Some((field, rest)) = usize::try_from(u32::from_le_bytes(*length))
            .ok()
            .and_then(|length| rest.split_at_checked(length))
        else {
            break;
        };
        bytes = rest;
        if let Some(equals) = field.iter().position(|byte| *byte == b'=')
            && let Ok(name) = std::str::from_utf8(&field[..equals])
        {
            found.insert(name, &field[equals + 1..]);
        }
    }
    found
}

/// What is left of a serialized message.
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
mod tests {
    use super::*;

    fn sized(bytes: &[u8]) -> Vec<u8> {
        let length = u32::try_from(bytes.len()).unwrap().to_le_bytes();
        [&length, bytes].concat()
    }

    fn header(fields: &[(&str, &[u8])]) -> Vec<u8> {
        let field =
            |(name, value): &(&str, &[u8])| sized(&[name.as_bytes(), b"=", *value].concat());
        sized(&fields.iter().map(field).collect::<Vec<_>>().concat())
    }

    fn record(fields: &[(&str, &[u8])], data: &[u8]) -> Vec<u8> {
        [header(fields), sized(data)].concat()
    }

    /// One chunk of one connection and two wrenches.
    fn bag(compression: &[u8]) -> Vec<u8> {
        let id: &[u8] = &7_u32.to_le_bytes();
        let kind = header(&[("type", b"geometry_msgs/WrenchStamped"), ("topic", b"/w")]);
        let mut chunk = record(
            &[("op", &[OP_CONNECTION]), ("conn", id), ("topic", b"/w")],
            &kind[4..],
        );
        for second in [5_u32, 4] {
            let mut data = [9_u32, second, 250, 2].map(u32::to_le_bytes).concat();
            data.extend(b"ft");
            for axis in 0..6 {
                data.extend((f64::from(second) + 0.5 * f64::from(axis)).to_le_bytes());
            }
            chunk.extend(record(
                &[("op", &[OP_MESSAGE]), ("conn", id), ("time", &[0; 8])],
                &data,
            ));
        }
        let whole = record(
            &[
                ("op", &[OP_CHUNK]),
                ("compression", compression),
                ("size", &[0; 4]),
            ],
            &chunk,
        );
        [MAGIC, &record(&[("op", &[3])], &[b' '; 64]), &whole].concat()
    }

    #[test]
    fn wrenches_are_read_by_their_stamps() {
        let bag = Bag::from_bytes(bag(b"none")).unwrap();
        assert_eq!(
            bag.topics(),
            BTreeMap::from([("/w", "geometry_msgs/WrenchStamped")])
        );
        let found = bag.wrenches("/w");
        let stamps: Vec<_> = found.iter().map(|sample| sample.at.as_nanos()).collect();
        assert_eq!(stamps, [4_000_000_250, 5_000_000_250]);
        assert_eq!(found[0].value, [4.0, 4.5, 5.0, 5.5, 6.0, 6.5]);
        assert!(bag.wrenches("/other").is_empty() && !bag.cut_short);
    }

    #[test]
    fn a_bag_that_was_cut_or_damaged_reads_as_far_as_it_goes() {
        let whole = bag(b"none");
        for cut in MAGIC.len()..whole.len() {
            let read = Bag::from_bytes(whole[..cut].to_vec()).unwrap();
            assert!(
                read.wrenches("/w").len() < 2 || cut + 4 > whole.len(),
                "{cut}"
            );
            let mut wrong = whole.clone();
            wrong[cut] ^= 0xff;
            if let Ok(read) = Bag::from_bytes(wrong) {
                assert!(read.wrenches("/w").len() <= 2);
            }
        }
        assert!(
            Bag::from_bytes(whole[..whole.len() - 1].to_vec())
                .unwrap()
                .cut_short
        );
    }

    #[test]
    fn packed_chunks_and_other_files_are_refused_with_what_to_do() {
        let packed = Bag::from_bytes(bag(b"lz4")).unwrap_err();
        assert!(
            packed.contains("lz4") && packed.contains("rosbag decompress"),
            "{packed}"
        );
        assert!(
            Bag::from_bytes(b"#ROSBAG V1.2".to_vec())
                .unwrap_err()
                .contains("format 2.0")
        );
    }
}
