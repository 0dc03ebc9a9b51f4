//! `capture.toml`: which devices, where they are, and where the frames stand to each other.

use std::net::SocketAddr;
use std::path::{Path, PathBuf};

use ft_drivers::translate::Handover;
use ft_recording::calibration::Calibration;
use ft_recording::message::TransformStamped;
use ft_wire::frames::{AriaDevice, Frame as _, FtSensor, Tcp};
use serde::{Deserialize, Serialize};

use crate::encode::Topic;
use crate::ledger::OWN_STREAM;
use crate::rmw::{Offer, Profile};

/// The whole configuration. Keys that are not listed here are refused.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Config {
    /// Names this gripper in control keys (`ft_capture/<id>/status`) and in the ROS node's name.
    #[serde(default = "default_id")]
    pub id: String,
    /// The devices.
    #[serde(default, rename = "device")]
    pub devices: Vec<Device>,
    /// How the frames stand to each other.
    #[serde(default)]
    pub frames: Frames,
    /// The gripper's part in front of the sensor, when it was calibrated.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub calibration: Option<Calibration>,
    /// How the file is written.
    #[serde(default)]
    pub recording: RecordingConfig,
    /// Where the live topics go.
    #[serde(default)]
    pub network: Network,
}

fn default_id() -> String {
    "gripper".to_owned()
}

/// One device.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Device {
    /// Names its stream: `/raw/<name>`, ledger, diagnostics.
    pub name: String,
    /// Which driver takes it.
    pub driver: Driver,
    /// Serial port (`/dev/ttyUSB0`, better `/dev/serial/by-id/...`), CAN interface (`can0`), candleLight adapter in user space
    /// (`gs_usb:SERIAL`, with `/CHANNEL` and `@BIT_RATE` where they are not 0 and the sensor's from the factory), HID device (`/dev/hidraw0`), or the key on which a byte stream comes over the network (`zenoh:ft_capture/blue/aria`).
    pub port: String,
    /// Time from the sample to the arrival of its last byte that is the same for every sample, us.
    #[serde(default)]
    pub latency_us: f64,
    /// The driver's own settings.
    #[serde(default, skip_serializing_if = "toml::Table::is_empty")]
    pub settings: toml::Table,
}

/// The drivers.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Driver {
    /// Bota Rokubi, SensONE, MiniONE over USB or RS-422.
    BotaSerial,
    /// Robotous RFT over CAN.
    RobotousCan,
    /// Robotous RFT over USB, RS-232, RS-422.
    RobotousUart,
    /// OptoForce or OnRobot HEX over USB or UART.
    OptoforceSerial,
    /// OptoForce or OnRobot HEX over CAN.
    OptoforceCan,
    /// Kunwei KWR75 over USB or RS-422.
    KunweiKwr75,
    /// Leptrino CFS or PFS over USB.
    Leptrino,
    /// ATI NETCANOEM over CAN.
    AtiNetcanoem,
    /// A Dynamixel as the gripper's encoder.
    Dynamixel,
    /// A CUI AMT21 as the gripper's encoder.
    Amt21,
    /// A microcontroller that prints the gripper's encoder in our own line format.
    EncoderLine,
    /// An axis of a USB HID device (joystick, dial, slider) as the gripper's encoder.
    HidAxis,
    /// A tracker that streams poses in our own format.
    PoseStream,
}

impl Driver {
    /// The topic that the driver fills; no two devices may fill the same.
    #[must_use]
    pub const fn topic(self) -> &'static str {
        match self {
            Self::BotaSerial
            | Self::RobotousCan
            | Self::RobotousUart
            | Self::OptoforceSerial
            | Self::OptoforceCan
            | Self::KunweiKwr75
            | Self::Leptrino
            | Self::AtiNetcanoem => "/ft/wrench",
            Self::Dynamixel | Self::Amt21 | Self::EncoderLine | Self::HidAxis => {
                "/gripper/joint_states"
            }
            Self::PoseStream => "/aria/pose",
        }
    }

    /// Whether the device itself says at set-up what its numbers mean, so that a replay needs those frames too.
    #[must_use]
    pub const fn learns_scale(self) -> bool {
        matches!(self, Self::Leptrino | Self::AtiNetcanoem | Self::HidAxis)
    }

    /// How what the device sends is handed over, where it samples at its own even pace without a clock or a counter, so that the
    /// number of its samples is one.
    #[must_use]
    pub const fn samples_evenly(self) -> Option<Handover> {
        match self {
            Self::RobotousCan => Some(Handover::Prompt),
            Self::RobotousUart | Self::KunweiKwr75 | Self::Leptrino => Some(Handover::Polled),
            _ => None,
        }
    }

    /// As in the configuration.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::BotaSerial => "bota_serial",
            Self::RobotousCan => "robotous_can",
            Self::RobotousUart => "robotous_uart",
            Self::OptoforceSerial => "optoforce_serial",
            Self::OptoforceCan => "optoforce_can",
            Self::KunweiKwr75 => "kunwei_kwr75",
            Self::Leptrino => "leptrino",
            Self::AtiNetcanoem => "ati_netcanoem",
            Self::Dynamixel => "dynamixel",
            Self::Amt21 => "amt21",
            Self::EncoderLine => "encoder_line",
            Self::HidAxis => "hid_axis",
            Self::PoseStream => "pose_stream",
        }
    }

    /// The driver with that name.
    #[must_use]
    pub fn by_name(name: &str) -> Option<Self> {
        [
            Self::BotaSerial,
            Self::RobotousCan,
            Self::RobotousUart,
            Self::OptoforceSerial,
            Self::OptoforceCan,
            Self::KunweiKwr75,
            Self::Leptrino,
            Self::AtiNetcanoem,
            Self::Dynamixel,
            Self::Amt21,
            Self::EncoderLine,
            Self::HidAxis,
            Self::PoseStream,
        ]
        .into_iter()
        .find(|driver| driver.name() == name)
    }
}

/// How the frames on the gripper stand to each other; identity where not said.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Frames {
    /// Takes coordinates in `tcp` to `aria_device`.
    pub aria_device_from_tcp: StaticPose,
    /// Takes coordinates in `ft_sensor` to `tcp`.
    pub tcp_from_ft_sensor: StaticPose,
}

impl Frames {
    /// Takes over a transform of `/tf_static` that is one of these.
    pub(crate) fn take(&mut self, said: &TransformStamped) {
        let pose = match (said.header.frame_id.as_str(), said.child_frame_id.as_str()) {
            (AriaDevice::NAME, Tcp::NAME) => &mut self.aria_device_from_tcp,
            (Tcp::NAME, FtSensor::NAME) => &mut self.tcp_from_ft_sensor,
            _ => return,
        };
        let (at, turn) = (said.transform.translation, said.transform.rotation);
        *pose = StaticPose {
            position_m: [at.x, at.y, at.z],
            quaternion_xyzw: [turn.x, turn.y, turn.z, turn.w],
        };
    }

    fn check(&self, path: &Path) -> Result<(), ConfigError> {
        SaidFrames::from(self.clone()).check(path)
    }
}

/// Those of the frames that somebody said.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SaidFrames {
    /// Takes coordinates in `tcp` to `aria_device`.
    pub aria_device_from_tcp: Option<StaticPose>,
    /// Takes coordinates in `ft_sensor` to `tcp`.
    pub tcp_from_ft_sensor: Option<StaticPose>,
}

impl From<Frames> for SaidFrames {
    fn from(frames: Frames) -> Self {
        Self {
            aria_device_from_tcp: Some(frames.aria_device_from_tcp),
            tcp_from_ft_sensor: Some(frames.tcp_from_ft_sensor),
        }
    }
}

impl SaidFrames {
    /// Those of a file, whose other sections are not looked at.
    ///
    /// # Errors
    /// It cannot be read, is no TOML, says none, or says one that is no pose.
    pub fn load(path: &Path) -> Result<Self, ConfigError> {
        Self::of(&read(path)?, path)
    }

    fn of(text: &str, path: &Path) -> Result<Self, ConfigError> {
        #[derive(Deserialize)]
        struct File {
            #[serde(default)]
            frames: SaidFrames,
        }
        let File { frames } = toml::from_str(text).map_err(syntax(path))?;
        if frames.aria_device_from_tcp.is_none() && frames.tcp_from_ft_sensor.is_none() {
            return Err(ConfigError::Value {
                path: path.to_owned(),
                what: "there is no [frames.aria_device_from_tcp] and no [frames.tcp_from_ft_sensor] with position_m and quaternion_xyzw: say \
                       where they are, or leave --frames out to keep what the recording says"
                    .to_owned(),
            });
        }
        frames.check(path)?;
        Ok(frames)
    }

    fn check(&self, path: &Path) -> Result<(), ConfigError> {
        for (name, pose) in [
            ("aria_device_from_tcp", &self.aria_device_from_tcp),
            ("tcp_from_ft_sensor", &self.tcp_from_ft_sensor),
        ] {
            let Some(pose) = pose else { continue };
            let [x, y, z, w] = pose.quaternion_xyzw;
            let norm = (x * x + y * y + z * z + w * w).sqrt();
            if !((norm - 1.0).abs() < 1e-3 && pose.position_m.iter().all(|part| part.is_finite())) {
                return Err(ConfigError::Value {
                    path: path.to_owned(),
                    what: format!("frames.{name}: quaternion_xyzw has the norm {norm}, wanted 1"),
                });
            }
        }
        Ok(())
    }
}

/// The `[calibration]` of a file, as `calibrate --toml` writes it. Its other sections are not looked at.
///
/// # Errors
/// It cannot be read, is no TOML, or has no such section.
pub fn load_calibration(path: &Path) -> Result<Calibration, ConfigError> {
    #[derive(Deserialize)]
    struct File {
        calibration: Option<Calibration>,
    }
    let File { calibration } = toml::from_str(&read(path)?).map_err(syntax(path))?;
    calibration.ok_or_else(|| ConfigError::Value {
        path: path.to_owned(),
        what: "there is no [calibration]: `ft-capture calibrate --toml` writes one".to_owned(),
    })
}

/// The text of a configuration.
fn read(path: &Path) -> Result<String, ConfigError> {
    std::fs::read_to_string(path).map_err(|source| ConfigError::Unreadable {
        path: path.to_owned(),
        source,
    })
}

fn syntax(path: &Path) -> impl FnOnce(toml::de::Error) -> ConfigError {
    move |source| ConfigError::Syntax {
        path: path.to_owned(),
        source: Box::new(source),
    }
}

/// A pose that does not change.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StaticPose {
    /// m.
    pub position_m: [f64; 3],
    /// Unit quaternion x y z w.
    pub quaternion_xyzw: [f64; 4],
}

impl Default for StaticPose {
    fn default() -> Self {
        Self {
            position_m: [0.0; 3],
            quaternion_xyzw: [0.0, 0.0, 0.0, 1.0],
        }
    }
}

/// How the file is written.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RecordingConfig {
    /// A chunk is closed and handed to the system after this time, ms, 10 to 150. A crash can cost this and about 50 ms more.
    pub flush_period_ms: u64,
    /// The file is forced to the disk this often; what a power cut can cost, ms, 100 to 60000.
    pub sync_period_ms: u64,
}

impl Default for RecordingConfig {
    fn default() -> Self {
        Self {
            flush_period_ms: 100,
            sync_period_ms: 1000,
        }
    }
}

/// Where the live topics go.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Network {
    /// Zenoh endpoints to listen on, such as `tcp/0.0.0.0:7447`; none = this host only.
    pub listen: Vec<String>,
    /// Zenoh endpoints to connect to.
    pub connect: Vec<String>,
    /// Be a router, so that ROS 2 nodes find each other through this program.
    pub router: bool,
    /// Folder of keys made by `ft-capture keys`: then everything is encrypted and everybody has a role; none = in the clear.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub keys: Option<PathBuf>,
    /// Address of the live page, such as `127.0.0.1:8080`; none = no page.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub view: Option<SocketAddr>,
    /// Address for Foxglove, Lichtblick and PlotJuggler, such as `127.0.0.1:8765`; none = not served.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub foxglove: Option<SocketAddr>,
    /// What the page's commands must carry, at least 16 characters; none = a new one each time. Not written into recordings.
    #[serde(skip_serializing)]
    pub token: Option<String>,
    /// `ROS_DOMAIN_ID`.
    pub domain_id: u32,
    /// Namespace of the topics, so that several grippers share a network: `blue` makes `/blue/ft/wrench`; empty = none.
    pub namespace: String,
    /// Messages that are kept of each stream for recorders on other machines that missed some: at 1 kHz 65536 are a minute,
    /// and about 20 MB.
    pub cache_samples: usize,
    /// Which ROS 2 distributions are to see the topics.
    pub profile: Profile,
    /// Read and ignored: earlier configurations, and the recordings made with them, may name a processor here.
    #[serde(skip_serializing)]
    pub processor: Option<usize>,
}

impl Default for Network {
    fn default() -> Self {
        Self {
            listen: Vec::new(),
            connect: Vec::new(),
            router: false,
            keys: None,
            view: None,
            foxglove: None,
            token: None,
            domain_id: 0,
            namespace: String::new(),
            cache_samples: 65_536,
            profile: Profile::default(),
            processor: None,
        }
    }
}

impl Network {
    /// Messages that are kept of `topic`.
    #[must_use]
    pub fn cached(&self, topic: Topic) -> usize {
        match topic.offer() {
            Offer::Stream => self.cache_samples.max(1),
            Offer::Event => self.cache_samples.clamp(1, 1024),
        }
    }

    /// The topic's name on the network: with the namespace in front.
    #[must_use]
    pub fn topic(&self, name: &str) -> String {
        match self.namespace.as_str() {
            "" => name.to_owned(),
            namespace => format!("/{namespace}{name}"),
        }
    }

    /// Whether the operator said nothing about where to listen or connect, nor how.
    #[must_use]
    pub fn asks_for_nothing(&self) -> bool {
        self.listen.is_empty() && self.connect.is_empty() && !self.router && self.keys.is_none()
    }
}

impl Config {
    /// Reads and checks a configuration.
    ///
    /// # Errors
    /// The file cannot be read, is no TOML, has unknown keys or values that make no sense; each says where.
    pub fn load(path: &Path) -> Result<Self, ConfigError> {
        Self::from_toml(&read(path)?, path)
    }

    /// Reads and checks a configuration that `path` is said to hold.
    ///
    /// # Errors
    /// As for [`Config::load`].
    pub fn from_toml(text: &str, path: &Path) -> Result<Self, ConfigError> {
        let config: Self = toml::from_str(text).map_err(syntax(path))?;
        config.check(path)?;
        Ok(config)
    }

    /// Checks what types cannot.
    ///
    /// # Errors
    /// A value makes no sense.
    pub fn check(&self, path: &Path) -> Result<(), ConfigError> {
        let wrong = |what: String| {
            Err(ConfigError::Value {
                path: path.to_owned(),
                what,
            })
        };
        if self.devices.is_empty() {
            return wrong("there is no [[device]]: name at least one, or use --sim".to_owned());
        }
        if !is_name(&self.id) {
            return wrong(format!(
                "id = {:?}: letters, digits, - and _ make a key",
                self.id
            ));
        }
        for (index, device) in self.devices.iter().enumerate() {
            if !is_name(&device.name) {
                return wrong(format!(
                    "device {index}: name = {:?}: letters, digits, - and _ make a name",
                    device.name
                ));
            }
            if device.name == OWN_STREAM {
                return wrong(format!(
                    "device {index}: name = {OWN_STREAM:?}: so the recording's own account is named"
                ));
            }
            if !(0.0..=1e6).contains(&device.latency_us) {
                return wrong(format!(
                    "{}: latency_us = {}: 0 to 1000000",
                    device.name, device.latency_us
                ));
            }
            for other in self.devices.iter().take(index) {
                if other.name == device.name {
                    return wrong(format!("two devices are named {:?}", device.name));
                }
                if other.driver.topic() == device.driver.topic() {
                    let (topic, first, second) = (device.driver.topic(), &other.name, &device.name);
                    return wrong(format!("{first} and {second} would both fill {topic}"));
                }
            }
        }
        self.frames.check(path)?;
        if let Some(Err(error)) = self.calibration.as_ref().map(Calibration::to_json) {
            return wrong(format!("calibration: {error}"));
        }
        if !(self.network.namespace.is_empty() || is_name(&self.network.namespace)) {
            return wrong(format!(
                "network.namespace = {:?}: letters, digits, - and _, without slashes",
                self.network.namespace
            ));
        }
        if !(1..=10_000_000).contains(&self.network.cache_samples) {
            return wrong(format!(
                "network.cache_samples = {}: 1 to 10000000",
                self.network.cache_samples
            ));
        }
        if let Some(token) = &self.network.token
            && (token.len() < 16 || !is_name(token))
        {
            return wrong(format!(
                "network.token has {} characters: at least 16 letters, digits, - and _",
                token.len()
            ));
        }
        if !(10..=150).contains(&self.recording.flush_period_ms) {
            return wrong(format!(
                "recording.flush_period_ms = {}: 10 to 150",
                self.recording.flush_period_ms
            ));
        }
        if !(100..=60_000).contains(&self.recording.sync_period_ms) {
            return wrong(format!(
                "recording.sync_period_ms = {}: 100 to 60000",
                self.recording.sync_period_ms
            ));
        }
        Ok(())
    }
}

/// Whether `text` can be part of a key and of a ROS node's name: letters, digits, - and _.
#[must_use]
pub fn is_name(text: &str) -> bool {
    !text.is_empty()
        && text
            .chars()
            .all(|c| c.is_ascii_alphanumeric() || c == '-' || c == '_')
}

/// How to get a file that is not there.
fn beginning(error: &std::io::Error) -> &'static str {
    match error.kind() {
        std::io::ErrorKind::NotFound => "; `ft-capture init` writes one",
        _ => "",
    }
}

/// Why a configuration was refused.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ConfigError {
    /// The file cannot be read.
    #[error("{}: cannot be read: {source}{}; give another with --config, or use --sim", path.display(), beginning(source))]
    Unreadable {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// No TOML, a value of the wrong type, or a key that is not known.
    #[error("{}: {source}", path.display())]
    Syntax {
        /// The file.
        path: PathBuf,
        /// Where and what.
        source: Box<toml::de::Error>,
    },
    /// A value makes no sense.
    #[error("{}: {what}", path.display())]
    Value {
        /// The file.
        path: PathBuf,
        /// Key, value and what is wanted.
        what: String,
    },
}

#[cfg(test)]
mod tests {
    use super::*;

    const GOOD: &str = r#"
        id = "blue"
        [[device]]
        name = "ft_sensor"
        driver = "bota_serial"
        port = "/dev/ttyUSB0"
        [[device]]
        name = "gripper"
        driver = "dynamixel"
        port = "/dev/ttyUSB1"
    "#;

    fn refusal(text: &str) -> String {
        Config::from_toml(text, Path::new("capture.toml"))
            .unwrap_err()
            .to_string()
    }

    #[test]
    fn frames_that_are_asked_for_must_be_said() {
        let pose = "position_m = [0.0, 0.0, 0.1]\nquaternion_xyzw = [0.0, 0.0, 0.0, 1.0]\n";
        let said = |names: &[&str]| {
            let frames = names.iter().map(|name| format!("[frames.{name}]\n{pose}"));
            let text = format!("{GOOD}\n{}", frames.collect::<String>());
            SaidFrames::of(&text, Path::new("a.toml"))
        };
        let (device, sensor) = ("aria_device_from_tcp", "tcp_from_ft_sensor");
        for names in [&[device, sensor][..], &[device], &[sensor]] {
            let frames = said(names).unwrap();
            let position = |pose: Option<StaticPose>| pose.map(|pose| pose.position_m);
            let wanted = |name| names.contains(&name).then_some([0.0, 0.0, 0.1]);
            assert_eq!(position(frames.aria_device_from_tcp), wanted(device));
            assert_eq!(position(frames.tcp_from_ft_sensor), wanted(sensor));
        }
        let message = said(&[]).unwrap_err().to_string();
        for name in [device, sensor] {
            assert!(
                message.contains(&format!("no [frames.{name}]")),
                "{message}"
            );
        }
    }

    #[test]
    fn frames_are_read_from_a_file_that_has_nothing_else() {
        let pose = "position_m = [0.0, 0.0, 0.1]\nquaternion_xyzw = [0.0, 0.0, 0.0, 1.0]\n";
        let frames =
            format!("[frames.aria_device_from_tcp]\n{pose}[frames.tcp_from_ft_sensor]\n{pose}");
        // `calibrate --find-rotation --toml` writes them after the calibration.
        let after = format!("[calibration.payload_mass_kg]\nvalue = 0.4\nstd = 0.01\n{frames}");
        for text in [&frames, &after] {
            let frames = SaidFrames::of(text, Path::new("a.toml")).unwrap();
            let device_from_tcp = frames.aria_device_from_tcp.unwrap();
            assert_eq!(device_from_tcp.position_m, [0.0, 0.0, 0.1]);
        }
        for (changed, wanted) in [
            (frames.replace("1.0]\n[", "2.0]\n["), "norm 2"),
            (
                frames.replace("tcp_from_ft", "tpc_from_ft"),
                "tpc_from_ft_sensor",
            ),
            ("frames = 3".to_owned(), "frames"),
        ] {
            let message = SaidFrames::of(&changed, Path::new("a.toml")).unwrap_err();
            assert!(message.to_string().contains(wanted), "{message}");
        }
    }

    #[test]
    fn a_short_configuration_is_enough() {
        let config = Config::from_toml(GOOD, Path::new("capture.toml")).unwrap();
        assert_eq!(config.devices.len(), 2);
        assert_eq!(config.recording.flush_period_ms, 100);
    }

    #[test]
    fn an_unknown_key_is_named_with_its_line() {
        let text = refusal(&GOOD.replace("port = \"/dev/ttyUSB1\"", "prot = \"/dev/ttyUSB1\""));
        assert!(
            text.contains("prot") && text.contains("line") && text.contains("port"),
            "{text}"
        );
    }

    #[test]
    fn an_unknown_driver_is_answered_with_the_known_ones() {
        let text = refusal(&GOOD.replace("dynamixel", "dynamixle"));
        assert!(
            text.contains("dynamixle") && text.contains("robotous_can"),
            "{text}"
        );
    }

    #[test]
    fn two_devices_may_not_fill_one_topic() {
        let text = refusal(&GOOD.replace("dynamixel", "robotous_can"));
        assert!(
            text.contains("ft_sensor and gripper would both fill /ft/wrench"),
            "{text}"
        );
    }

    #[test]
    fn no_device_is_refused_with_a_way_out() {
        assert!(refusal("id = \"blue\"").contains("--sim"));
    }

    #[test]
    fn a_name_that_cannot_be_is_refused() {
        for name in ["", "a/b", "a\\u0000b", "a b", "ft_capture"] {
            let text = refusal(&GOOD.replace("ft_sensor", name));
            assert!(text.contains("device 0: name"), "{name}: {text}");
        }
    }

    #[test]
    fn a_calibration_that_cannot_be_is_refused() {
        let with = |mass: &str, com: &str| {
            format!(
                "{GOOD}\n[calibration]\npayload_mass_kg = {{ value = {mass}, std = 0.01 }}\n\
                 payload_com_m = {{ value = [{com}, 0.0, 0.05], std = [0.0, 0.0, 0.0] }}\n\
                 payload_inertia_kgm2 = {{ value = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0], std = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0] }}\n"
            )
        };
        Config::from_toml(&with("0.4", "0.0"), Path::new("a.toml")).unwrap();
        assert!(refusal(&with("-0.4", "0.0")).contains("payload_mass_kg"));
        assert!(refusal(&with("nan", "0.0")).contains("payload_mass_kg"));
        assert!(refusal(&with("0.4", "inf")).contains("payload_com_m"));
    }

    #[test]
    fn values_out_of_range_are_named() {
        assert!(
            refusal(&format!("{GOOD}\n[recording]\nflush_period_ms = 900")).contains("10 to 150")
        );
        let bent = "[frames.tcp_from_ft_sensor]\nposition_m=[0,0,0]\nquaternion_xyzw=[0,0,0,2]";
        assert!(refusal(&format!("{GOOD}\n{bent}")).contains("norm 2"));
    }
}
