//! The recording: an MCAP file that other people's tools open.

use std::collections::BTreeMap;
use std::path::Path;

use ft_recording::message::{
    DiagnosticArray, JointState, Message, PoseStamped, TFMessage, Temperature, Text, WrenchStamped,
};
use ft_recording::qos::Qos;
use ft_recording::writer::{
    ChannelId, Finished, MessageStamps, RecordingWriter, WriteError, WriterOptions,
};
use ft_wire::HostTime;

use super::{Sink, SinkError};
use crate::encode::{Encoder, Topic};
use crate::item::{Body, Item};

/// What a recording says about itself from its first bytes on.
#[derive(Debug)]
pub struct Preamble {
    /// Metadata `ft.session`.
    pub session: BTreeMap<String, String>,
    /// Metadata `ft.calibration`, when one is known.
    pub calibration: Option<BTreeMap<String, String>>,
    /// `/tf_static`.
    pub static_transforms: TFMessage,
    /// When the session began.
    pub start: HostTime,
    /// Names of the devices, in the order of the configuration.
    pub devices: Vec<String>,
}

/// Writes items into a recording.
#[derive(Debug)]
pub struct McapSink {
    writer: RecordingWriter,
    channels: [ChannelId; Topic::ALL.len()],
    raw: Vec<ChannelId>,
    encoder: Encoder,
}

impl McapSink {
    /// Creates `path` (as `path.partial` until it is finished) and writes the preamble.
    ///
    /// # Errors
    /// The file exists and may not be overwritten, or the disk refuses.
    pub fn create(
        path: &Path,
        options: &WriterOptions,
        preamble: &Preamble,
    ) -> Result<Self, WriteError> {
        let mut writer = RecordingWriter::create(path, options)?;
        let [first, others @ ..] = Topic::ALL;
        let mut channels = [add_channel(&mut writer, first)?; Topic::ALL.len()];
        for (channel, topic) in channels.iter_mut().skip(1).zip(others) {
            *channel = add_channel(&mut writer, topic)?;
        }
        let mut raw = Vec::with_capacity(preamble.devices.len());
        for device in &preamble.devices {
            raw.push(writer.add_raw_channel(&format!("/raw/{device}"))?);
        }
        writer.write_metadata("ft.session", &preamble.session)?;
        if let Some(calibration) = &preamble.calibration {
            writer.write_metadata("ft.calibration", calibration)?;
        }
        let mut buffer = Vec::new();
        preamble.static_transforms.encode(&mut buffer);
        let stamps = MessageStamps {
            log_time: preamble.start,
            publish_time: preamble.start,
        };
        writer.write(channels[Topic::TfStatic.index()], stamps, &buffer)?;
        writer.flush_if_due(preamble.start)?;
        Ok(Self {
            writer,
            channels,
            raw,
            encoder: Encoder::default(),
        })
    }

    /// Bytes written so far.
    #[must_use]
    pub fn bytes_written(&self) -> u64 {
        self.writer.bytes_written()
    }

    /// A second handle of the file, to sync it to the disk from another thread.
    ///
    /// # Errors
    /// The system refuses a second handle.
    pub fn sync_handle(&self) -> Result<std::fs::File, WriteError> {
        self.writer.sync_handle()
    }

    /// Writes the ledger and finishes the file.
    ///
    /// # Errors
    /// The disk refuses; what was flushed stays in the partial file.
    pub fn finish(mut self, ledger: &BTreeMap<String, String>) -> Result<Finished, WriteError> {
        self.writer.write_metadata("ft.ledger", ledger)?;
        self.writer.finish()
    }
}

impl Sink for McapSink {
    fn take(&mut self, item: &Item) -> Result<(), SinkError> {
        let stamps = MessageStamps {
            log_time: item.arrival,
            publish_time: item.sample_time,
        };
        if let (Body::Raw(bytes), Some(channel)) = (
            &item.body,
            item.device.and_then(|index| self.raw.get(index)),
        ) {
            return Ok(self.writer.write(*channel, stamps, bytes.as_slice())?);
        }
        let (writer, channels) = (&mut self.writer, &self.channels);
        self.encoder.encode(item, |topic, payload| {
            writer.write(channels[topic.index()], stamps, payload)
        })?;
        Ok(())
    }

    fn tick(&mut self, now: HostTime) -> Result<(), SinkError> {
        Ok(self.writer.flush_if_due(now)?)
    }
}

fn add_channel(writer: &mut RecordingWriter, topic: Topic) -> Result<ChannelId, WriteError> {
    let (name, stream, event) = (topic.name(), Qos::SENSOR, Qos::RELIABLE);
    match topic {
        Topic::Wrench => writer.add_channel::<WrenchStamped>(name, stream),
        Topic::Temperature => writer.add_channel::<Temperature>(name, stream),
        Topic::JointStates => writer.add_channel::<JointState>(name, stream),
        Topic::AriaPose => writer.add_channel::<PoseStamped>(name, stream),
        Topic::TfStatic => writer.add_channel::<TFMessage>(name, Qos::LATCHED),
        Topic::Marks => writer.add_channel::<Text>(name, event),
        Topic::Diagnostics => writer.add_channel::<DiagnosticArray>(name, event),
    }
}
