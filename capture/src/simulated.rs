//! Sessions with simulated devices: what an operator would know of them, and the session on the simulated clock.
//!
//! The configuration comes from the scenario, never from its truth.

use std::sync::Arc;
use std::time::Duration;

use ft_drivers::RxStamps;
use ft_drivers::hid_axis::HidFrame;
use ft_drivers::link::replay::ReplayLink;
use ft_drivers::options::Startup;
use ft_recording::calibration::{Calibration, Estimate};
use ft_sim_hw::{Bus, Fitted, KnownSetup, SettingValue, Simulation};
use ft_wire::HostTime;

use crate::channel::Channel;
use crate::config::{Config, Device, Driver, Frames, Network, RecordingConfig, StaticPose};
use crate::item::Body;
use crate::ledger::StreamCounters;
use crate::open::{StepBuilder, SteppedLink};
use crate::session::stepped::{Buffer, Stepping};
use crate::session::{Plan, SessionError};
use crate::summary::Summary;

/// The configuration for the simulated devices; `port` names each one's port.
///
/// # Errors
/// The simulation fits a device that no driver takes.
pub fn config(
    scenario: &str,
    fitted: &[Fitted],
    known: &KnownSetup,
    mut port: impl FnMut(&Fitted) -> String,
) -> Result<Config, SessionError> {
    let mut devices = Vec::new();
    for device in fitted {
        let driver = Driver::by_name(device.driver).ok_or_else(|| {
            SessionError::Simulation(format!(
                "{}: no driver is named {:?}",
                device.name, device.driver
            ))
        })?;
        devices.push(Device {
            name: device.name.clone(),
            driver,
            port: port(device),
            latency_us: transmission_us(device, driver),
            settings: settings(device, driver),
        });
    }
    let pose = |(position_m, quaternion_xyzw)| StaticPose {
        position_m,
        quaternion_xyzw,
    };
    Ok(Config {
        id: scenario.to_owned(),
        devices,
        frames: Frames {
            aria_device_from_tcp: pose(known.aria_device_from_tcp),
            tcp_from_ft_sensor: pose(known.tcp_from_ft_sensor),
        },
        calibration: Some(calibration(known)),
        recording: RecordingConfig::default(),
        network: Network::default(),
    })
}

/// Bytes on the line from the sample to the end of its frame, from the makers' frame lengths.
fn transmission_us(device: &Fitted, driver: Driver) -> f64 {
    let serial = |bytes: f64| match device.bus {
        Bus::Serial { baud_bps } => bytes * 10.0 / f64::from(baud_bps) * 1e6,
        Bus::Can { .. } => 0.0,
    };
    let can = |frames: f64, bytes: f64| match device.bus {
        Bus::Can { bitrate_bps } => (47.0 * frames + 8.0 * bytes) / f64::from(bitrate_bps) * 1e6,
        Bus::Serial { .. } => 0.0,
    };
    match driver {
        Driver::BotaSerial => serial(37.0),
        Driver::RobotousUart => serial(19.0),
        Driver::OptoforceSerial => serial(22.0),
        Driver::KunweiKwr75 => serial(28.0),
        Driver::Leptrino => serial(25.0),
        Driver::Dynamixel => serial(29.0),
        Driver::Amt21 => serial(2.0),
        // A line of usual length; it varies with its numbers.
        Driver::EncoderLine => serial(23.0),
        Driver::HidAxis => 0.0,
        Driver::PoseStream => serial(74.0),
        // 47 bits and 8 for each byte of every frame with an 11-bit id, without stuffing.
        Driver::RobotousCan => can(2.0, 16.0),
        Driver::OptoforceCan => can(3.0, 22.0),
        // Question and answer; the sample is taken when the question has come.
        Driver::AtiNetcanoem => can(2.0, 14.0),
    }
}

/// Where simulated sessions begin: 2026-01-01 00:00:00 UTC, so that files of the same seed are the same.
pub const START: HostTime = HostTime::from_nanos(1_767_225_600_000_000_000);

/// One step of the simulated clock.
const STEP: Duration = Duration::from_millis(1);

/// Runs a simulation to its end; `progress` hears of the time gone by, `wants_end` may end it early.
///
/// # Errors
/// A driver's settings make no sense, or the recording fails. What was recorded is kept.
pub fn run(
    plan: &Plan,
    simulation: &mut Simulation,
    mut progress: impl FnMut(Duration),
    mut wants_end: impl FnMut() -> bool,
) -> Result<Summary, SessionError> {
    let buffer = Buffer::default();
    let counters: Vec<_> = plan
        .config
        .devices
        .iter()
        .map(|_| Arc::new(StreamCounters::default()))
        .collect();
    let links = open_links(plan, simulation, &buffer, &counters)?;
    let mut stepping = Stepping::begin(plan, links, &counters, buffer, START, "simulated")?;
    let end = plan
        .duration
        .map_or(simulation.end(), |duration| START + duration);
    let mut now = START;
    while now < end && !simulation.is_over() && !wants_end() {
        now = now + STEP;
        simulation.advance_to(now);
        for (at, text) in simulation.drain_marks() {
            stepping.own(at, Body::Mark(text));
        }
        stepping.step(now)?;
        progress(now.saturating_since(START));
    }
    stepping.finish()
}

fn open_links(
    plan: &Plan,
    simulation: &Simulation,
    buffer: &Buffer,
    counters: &[Arc<StreamCounters>],
) -> Result<Vec<Box<dyn SteppedLink>>, SessionError> {
    let mut links = Vec::new();
    for (index, (device, counters)) in plan.config.devices.iter().zip(counters).enumerate() {
        let link_delay = Duration::from_secs_f64(device.latency_us * 1e-6);
        let builder = StepBuilder {
            device,
            channel: Channel::new(index, buffer.clone(), Arc::clone(counters), link_delay)
                .sampling_evenly(device.driver.samples_evenly()),
            counters: Arc::clone(counters),
            serial: || simulation.serial_link(&device.name),
            can: || simulation.can_link(&device.name),
            hid: no_hid,
        };
        links.push(builder.build(Startup::Configure)?);
    }
    Ok(links)
}

/// HID devices are not simulated.
fn no_hid() -> Option<ReplayLink<std::iter::Empty<(HidFrame, RxStamps)>>> {
    None
}

/// What the driver must be told, and the line's rate.
fn settings(device: &Fitted, driver: Driver) -> toml::Table {
    let mut table: toml::Table = device
        .settings
        .iter()
        .map(|(key, value)| (key.clone(), setting(value)))
        .collect();
    if let Bus::Serial { baud_bps } = device.bus {
        table.insert(
            "baud_bps".to_owned(),
            toml::Value::Integer(i64::from(baud_bps)),
        );
    }
    if driver == Driver::PoseStream {
        // A tracker has a rate of its own; the driver takes what comes.
        table.remove("rate_hz");
    }
    table
}

/// Whole numbers are written as such.
fn setting(value: &SettingValue) -> toml::Value {
    match value {
        #[allow(
            clippy::cast_possible_truncation,
            reason = "whole and within what f64 holds exactly"
        )]
        SettingValue::Number(number) if number.fract() == 0.0 && number.abs() < 9e15 => {
            toml::Value::Integer(*number as i64)
        }
        SettingValue::Number(number) => toml::Value::Float(*number),
        SettingValue::Numbers(numbers) => {
            toml::Value::Array(numbers.iter().copied().map(toml::Value::Float).collect())
        }
        SettingValue::Text(text) => toml::Value::String(text.clone()),
    }
}

fn calibration(known: &KnownSetup) -> Calibration {
    let payload = &known.payload;
    Calibration {
        payload_mass_kg: Estimate {
            value: payload.mass_kg,
            std: payload.mass_std_kg,
        },
        payload_com_m: Estimate {
            value: payload.com_m,
            std: payload.com_std_m,
        },
        payload_inertia_kgm2: Estimate {
            value: payload.inertia_kgm2,
            std: payload.inertia_std_kgm2,
        },
        wrench_bias: None,
        covariance: None,
    }
}
