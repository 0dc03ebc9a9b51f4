//! The drivers' own settings: `[device.settings]` of the configuration, checked, and the drivers made of them.

mod encoders;
mod optoforce;
mod sensors;

use ft_drivers::device::Counted;
use ft_drivers::hid_axis::HidFrame;
use ft_drivers::options::{Sign, Startup};
use ft_drivers::reading::Reading;
use ft_drivers::robotous::{self, Filter, Scale};
use ft_drivers::{
    Device as Protocol, amt21, ati_netcanoem, bota_serial, dynamixel, encoder_line, hid_axis,
    kunwei_kwr75, leptrino, optoforce_can, optoforce_serial, pose_stream, robotous_can,
    robotous_uart,
};
use ft_wire::bota_serial::BaudRate;
use ft_wire::robotous_rft::{CanIds, FilterSetting};
use ft_wire::{CanFrame, Chunk};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use crate::config::{Config, Device, Driver};
use crate::session::SessionError;

/// Does something with a driver and the bus that it needs. Drivers differ in type, so this is generic.
pub trait DriverUser {
    /// What comes of it.
    type Output;

    /// For drivers of byte streams; `make` makes the driver anew after its link was lost.
    fn serial<D>(self, make: impl Fn() -> D + Send + 'static, baud_bps: u32) -> Self::Output
    where
        D: Protocol<Frame = Chunk, Reading = Reading> + Counted + Send + 'static;

    /// For drivers on CAN that listen to `ids`; `usual_bps` is the bit rate of their device unless the port says another.
    fn can<D>(
        self,
        make: impl Fn() -> D + Send + 'static,
        ids: Vec<u16>,
        usual_bps: u32,
    ) -> Self::Output
    where
        D: Protocol<Frame = CanFrame, Reading = Reading> + Counted + Send + 'static;

    /// For drivers of HID devices.
    fn hid<D>(self, make: impl Fn() -> D + Send + 'static) -> Self::Output
    where
        D: Protocol<Frame = HidFrame, Reading = Reading> + Counted + Send + 'static;
}

/// Hands the driver that `device` names to `user`.
///
/// # Errors
/// A setting is unknown or makes no sense.
pub fn with_driver<U: DriverUser>(
    device: &Device,
    startup: Startup,
    user: U,
) -> Result<U::Output, SessionError> {
    match device.driver {
        Driver::BotaSerial => {
            let settings: BotaSettings = read(device)?;
            let config = settings
                .config(startup)
                .map_err(|what| wrong(device, what))?;
            Ok(user.serial(
                move || bota_serial::BotaSerial::new(config),
                settings.baud_bps,
            ))
        }
        Driver::RobotousCan => {
            let settings: RobotousSettings = read(device)?;
            let ids = CanIds {
                command: settings.command_id,
                first: settings.first_id,
                second: settings.second_id,
            };
            let sensor = settings
                .config(startup)
                .map_err(|what| wrong(device, what))?;
            let config = robotous_can::Config {
                sensor,
                ids,
                ..Default::default()
            };
            let listened = vec![u16::from(settings.first_id), u16::from(settings.second_id)];
            let make = move || robotous_can::RobotousCan::new(config);
            Ok(user.can(make, listened, robotous_can::BITRATE_BPS))
        }
        Driver::RobotousUart => {
            let settings: RobotousSettings = read(device)?;
            let sensor = settings
                .config(startup)
                .map_err(|what| wrong(device, what))?;
            let config = robotous_uart::Config {
                sensor,
                baud_bps: settings.baud_bps,
            };
            Ok(user.serial(
                move || robotous_uart::RobotousUart::new(config),
                settings.baud_bps,
            ))
        }
        Driver::OptoforceSerial => {
            let settings: optoforce::Settings = read(device)?;
            let config = settings
                .config(startup)
                .map_err(|what| wrong(device, what))?;
            let make = move || optoforce_serial::OptoforceSerial::new(config);
            Ok(user.serial(make, settings.baud_bps))
        }
        Driver::OptoforceCan => {
            let settings: optoforce::Settings = read(device)?;
            let config = settings
                .can_config(startup)
                .map_err(|what| wrong(device, what))?;
            let make = move || optoforce_can::OptoforceCan::new(config);
            Ok(user.can(make, vec![settings.data_id], optoforce_can::BITRATE_BPS))
        }
        Driver::KunweiKwr75 => {
            let settings: sensors::Kunwei = read(device)?;
            let config = settings
                .config(startup)
                .map_err(|what| wrong(device, what))?;
            let make = move || kunwei_kwr75::KunweiKwr75::new(config);
            Ok(user.serial(make, settings.baud_bps))
        }
        Driver::Leptrino => {
            let settings: sensors::Leptrino = read(device)?;
            let config = settings.config(startup);
            let make = move || leptrino::Leptrino::new(config);
            Ok(user.serial(make, settings.baud_bps))
        }
        Driver::AtiNetcanoem => {
            let settings: sensors::Ati = read(device)?;
            let config = settings
                .config(startup)
                .map_err(|what| wrong(device, what))?;
            let make = move || ati_netcanoem::AtiNetcanoem::new(config);
            let usual_bps = ati_netcanoem::FACTORY_BITRATE_BPS;
            Ok(user.can(make, settings.ids(), usual_bps))
        }
        Driver::Dynamixel => {
            let settings: encoders::Dynamixel = read(device)?;
            let config = settings
                .config(startup)
                .map_err(|what| wrong(device, what))?;
            Ok(user.serial(move || dynamixel::Dynamixel::new(config), settings.baud_bps))
        }
        Driver::Amt21 => {
            let settings: encoders::Amt21 = read(device)?;
            let config = settings
                .config(startup)
                .map_err(|what| wrong(device, what))?;
            Ok(user.serial(move || amt21::Amt21::new(config), settings.baud_bps))
        }
        Driver::EncoderLine => {
            let settings: encoders::EncoderLine = read(device)?;
            let config = settings.config().map_err(|what| wrong(device, what))?;
            let make = move || encoder_line::EncoderLine::new(config);
            Ok(user.serial(make, settings.baud_bps))
        }
        Driver::HidAxis => {
            let settings: encoders::HidAxis = read(device)?;
            let config = settings.config().map_err(|what| wrong(device, what))?;
            Ok(user.hid(move || hid_axis::HidAxis::new(config)))
        }
        Driver::PoseStream => {
            let settings: PoseSettings = read(device)?;
            Ok(user.serial(
                || pose_stream::PoseStream::new(pose_stream::Config::default()),
                settings.baud_bps,
            ))
        }
    }
}

/// The settings of `device` as configured, with every default.
///
/// # Errors
/// A setting is unknown, missing or of the wrong kind.
pub fn in_effect(device: &Device) -> Result<toml::Table, SessionError> {
    match device.driver {
        Driver::BotaSerial => complete::<BotaSettings>(device),
        Driver::RobotousUart => complete::<RobotousSettings>(device),
        Driver::RobotousCan => complete::<RobotousSettings>(device).map(without_line),
        Driver::OptoforceSerial => complete::<optoforce::Settings>(device),
        Driver::OptoforceCan => complete::<optoforce::Settings>(device).map(without_line),
        Driver::KunweiKwr75 => complete::<sensors::Kunwei>(device),
        Driver::Leptrino => complete::<sensors::Leptrino>(device),
        Driver::AtiNetcanoem => complete::<sensors::Ati>(device),
        Driver::Dynamixel => complete::<encoders::Dynamixel>(device),
        Driver::Amt21 => complete::<encoders::Amt21>(device),
        Driver::EncoderLine => complete::<encoders::EncoderLine>(device),
        Driver::HidAxis => complete::<encoders::HidAxis>(device),
        Driver::PoseStream => complete::<PoseSettings>(device),
    }
}

/// A sensor on CAN has no serial line.
fn without_line(mut settings: toml::Table) -> toml::Table {
    settings.remove("baud_bps");
    settings
}

fn complete<T: DeserializeOwned + Serialize>(device: &Device) -> Result<toml::Table, SessionError> {
    toml::Table::try_from(read::<T>(device)?).map_err(|error| wrong(device, error.to_string()))
}

/// `config` with the settings of every device as they are in effect: what a recording holds, so that it says what was so even where a
/// later version has other defaults.
///
/// # Errors
/// As [`in_effect`].
pub fn with_defaults(config: &Config) -> Result<Config, SessionError> {
    let mut config = config.clone();
    for device in &mut config.devices {
        device.settings = in_effect(device)?;
    }
    Ok(config)
}

fn read<T: DeserializeOwned>(device: &Device) -> Result<T, SessionError> {
    device
        .settings
        .clone()
        .try_into()
        .map_err(|error: toml::de::Error| wrong(device, error.message().to_owned()))
}

fn wrong(device: &Device, what: String) -> SessionError {
    SessionError::Settings {
        device: device.name.clone(),
        driver: device.driver.name(),
        what,
    }
}

/// Settings of `bota_serial`.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
struct BotaSettings {
    baud_bps: u32,
    /// The filter's length follows from it: 51 200 Hz divided by the rate, 51 to 4096.
    rate_hz: f64,
    chop: bool,
    fast: bool,
    fir_disable: bool,
    temperature_compensation: bool,
    sign: SignSetting,
}

impl Default for BotaSettings {
    fn default() -> Self {
        Self {
            baud_bps: 460_800,
            rate_hz: 800.0,
            chop: false,
            fast: false,
            fir_disable: true,
            temperature_compensation: false,
            sign: SignSetting::default(),
        }
    }
}

impl BotaSettings {
    fn config(&self, startup: Startup) -> Result<bota_serial::Config, String> {
        let baud = BaudRate::from_bps(self.baud_bps).ok_or_else(|| {
            format!(
                "baud_bps = {}: 9600, 57600, 115200, 230400 or 460800",
                self.baud_bps
            )
        })?;
        if !(12.5..=1000.0).contains(&self.rate_hz) {
            return Err(format!("rate_hz = {}: 12.5 to 1000", self.rate_hz));
        }
        #[allow(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "51 to 4096 by the check above"
        )]
        let sinc_length = (bota_serial::GAUGE_RATE_HZ / self.rate_hz).round() as u16;
        Ok(bota_serial::Config {
            baud,
            filter: ft_wire::bota_serial::Filter {
                sinc_length,
                chop: self.chop,
                fast: self.fast,
                fir_disable: self.fir_disable,
            },
            temperature_compensation: self.temperature_compensation,
            sign: self.sign.into(),
            startup,
            ..bota_serial::Config::default()
        })
    }
}

/// Settings of `robotous_can` and `robotous_uart`.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
struct RobotousSettings {
    rate_hz: u16,
    /// 0: the sensor's own filter is off.
    low_pass_hz: u16,
    force_counts_per_newton: f64,
    torque_counts_per_newton_metre: f64,
    sign: SignSetting,
    /// UART only.
    baud_bps: u32,
    /// CAN only.
    command_id: u8,
    /// CAN only.
    first_id: u8,
    /// CAN only.
    second_id: u8,
}

impl Default for RobotousSettings {
    fn default() -> Self {
        let (sensor, ids) = (robotous::Config::default(), CanIds::default());
        Self {
            rate_hz: sensor.rate_hz,
            low_pass_hz: 0,
            force_counts_per_newton: sensor.scale.counts_per_newton,
            torque_counts_per_newton_metre: sensor.scale.counts_per_newton_metre,
            sign: SignSetting::default(),
            baud_bps: robotous_uart::Config::default().baud_bps,
            command_id: ids.command,
            first_id: ids.first,
            second_id: ids.second,
        }
    }
}

impl RobotousSettings {
    fn config(&self, startup: Startup) -> Result<robotous::Config, String> {
        if ft_wire::robotous_rft::rate_code(self.rate_hz).is_none() {
            return Err(format!(
                "rate_hz = {}: 10, 20, 50, 100, 200, 333, 500 or 1000",
                self.rate_hz
            ));
        }
        for (key, value) in [
            ("force_counts_per_newton", self.force_counts_per_newton),
            (
                "torque_counts_per_newton_metre",
                self.torque_counts_per_newton_metre,
            ),
        ] {
            if !(value.is_finite() && value > 0.0) {
                return Err(format!(
                    "{key} = {value}: a positive number, see the manual's table of models"
                ));
            }
        }
        if self.low_pass_hz != 0 && FilterSetting::low_pass(self.low_pass_hz).is_none() {
            let allowed = "0 (off), 1, 2, 3, 5, 10, 20, 30, 40, 50, 100, 150, 200, 300 or 500";
            return Err(format!("low_pass_hz = {}: {allowed}", self.low_pass_hz));
        }
        let ids = [self.command_id, self.first_id, self.second_id];
        if ids.contains(&0) || ids[0] == ids[1] || ids[1] == ids[2] || ids[0] == ids[2] {
            return Err(format!(
                "command_id, first_id, second_id = {ids:?}: three different ids, 1 to 255"
            ));
        }
        Ok(robotous::Config {
            rate_hz: self.rate_hz,
            filter: match self.low_pass_hz {
                0 => Filter::Off,
                cut_off_hz => Filter::LowPass { cut_off_hz },
            },
            scale: Scale {
                counts_per_newton: self.force_counts_per_newton,
                counts_per_newton_metre: self.torque_counts_per_newton_metre,
            },
            sign: self.sign.into(),
            startup,
            ..robotous::Config::default()
        })
    }
}

/// Settings of `pose_stream`.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
struct PoseSettings {
    /// A USB CDC port ignores it.
    baud_bps: u32,
}

impl Default for PoseSettings {
    fn default() -> Self {
        Self {
            baud_bps: 2_000_000,
        }
    }
}

/// Which side's wrench a sensor reports.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
enum SignSetting {
    #[default]
    EnvironmentOnTool,
    ToolOnEnvironment,
}

impl From<SignSetting> for Sign {
    fn from(setting: SignSetting) -> Self {
        match setting {
            SignSetting::EnvironmentOnTool => Self::EnvironmentOnTool,
            SignSetting::ToolOnEnvironment => Self::ToolOnEnvironment,
        }
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use std::path::Path;

    use super::*;

    struct Accepted;

    impl DriverUser for Accepted {
        type Output = ();

        fn serial<D>(self, _: impl Fn() -> D + Send + 'static, _: u32)
        where
            D: Protocol<Frame = Chunk, Reading = Reading> + Counted + Send + 'static,
        {
        }

        fn can<D>(self, _: impl Fn() -> D + Send + 'static, _: Vec<u16>, _: u32)
        where
            D: Protocol<Frame = CanFrame, Reading = Reading> + Counted + Send + 'static,
        {
        }

        fn hid<D>(self, _: impl Fn() -> D + Send + 'static)
        where
            D: Protocol<Frame = HidFrame, Reading = Reading> + Counted + Send + 'static,
        {
        }
    }

    /// Whether a driver can be made of `device`.
    pub(crate) fn is_accepted(device: &Device) -> Result<(), SessionError> {
        with_driver(device, Startup::Configure, Accepted)
    }

    fn device(driver: &str, settings: &str) -> Device {
        let text = format!(
            "[[device]]\nname = \"a\"\ndriver = {driver:?}\nport = \"b\"\n[device.settings]\n{settings}"
        );
        let config = Config::from_toml(&text, Path::new("a.toml")).unwrap();
        config.devices[0].clone()
    }

    #[test]
    fn settings_in_effect_are_complete_and_mean_the_same() {
        let drivers = ft_drivers::discover::IDENTITIES
            .iter()
            .flat_map(|identity| identity.takers)
            .chain(&["hid_axis"]);
        for driver in drivers {
            let needed = match *driver {
                "optoforce_serial" | "optoforce_can" => {
                    "force_counts_per_newton = [1, 2, 3]\ntorque_counts_per_newton_metre = [4, 5, 6]"
                }
                "encoder_line" => "counts_per_turn = 4096",
                _ => "",
            };
            let mut device = device(driver, needed);
            let complete = in_effect(&device).unwrap();
            assert!(!complete.is_empty(), "{driver}");
            device.settings = complete.clone();
            is_accepted(&device).unwrap();
            assert_eq!(in_effect(&device).unwrap(), complete, "{driver}");
        }
    }

    #[test]
    fn a_recording_says_which_rate_filter_and_scale_were_in_effect() {
        let settings = in_effect(&device("robotous_can", "rate_hz = 1000")).unwrap();
        let text = toml::to_string(&settings).unwrap();
        for line in [
            "rate_hz = 1000",
            "low_pass_hz = 0",
            "force_counts_per_newton = 50.0",
            "torque_counts_per_newton_metre = 2000.0",
            "sign = \"environment_on_tool\"",
        ] {
            assert!(text.contains(line), "{line}: {text}");
        }
        // A serial line's.
        assert!(!text.contains("baud_bps"), "{text}");
    }

    #[test]
    fn each_sensor_on_can_has_its_factorys_bit_rate() {
        struct BitRate;
        impl DriverUser for BitRate {
            type Output = Option<u32>;

            fn serial<D>(self, _: impl Fn() -> D + Send + 'static, _: u32) -> Option<u32>
            where
                D: Protocol<Frame = Chunk, Reading = Reading> + Counted + Send + 'static,
            {
                None
            }

            fn can<D>(
                self,
                _: impl Fn() -> D + Send + 'static,
                _: Vec<u16>,
                usual_bps: u32,
            ) -> Option<u32>
            where
                D: Protocol<Frame = CanFrame, Reading = Reading> + Counted + Send + 'static,
            {
                Some(usual_bps)
            }

            fn hid<D>(self, _: impl Fn() -> D + Send + 'static) -> Option<u32>
            where
                D: Protocol<Frame = HidFrame, Reading = Reading> + Counted + Send + 'static,
            {
                None
            }
        }
        let scale =
            "force_counts_per_newton = [1, 2, 3]\ntorque_counts_per_newton_metre = [4, 5, 6]";
        for (driver, settings, bps) in [
            ("robotous_can", "", 1_000_000),
            ("optoforce_can", scale, 1_000_000),
            ("ati_netcanoem", "", 250_000),
        ] {
            let device = device(driver, settings);
            let usual = with_driver(&device, Startup::Configure, BitRate).unwrap();
            assert_eq!(usual, Some(bps), "{driver}");
        }
    }
}
