//! Which devices a scenario has, and what an operator knows about them.

use std::collections::BTreeMap;
use std::sync::Arc;

use ft_wire::Chunk;
use nalgebra::Isometry3;
use serde::Serialize;

use super::sensor;
use super::slot::{Slot, SlotKind, Wired};
use crate::amt21::{self, Amt21};
use crate::bus::{Bus, Carried, Line, Port, TimeSource};
use crate::clock::DeviceClock;
use crate::device::Played;
use crate::dynamixel::Dynamixel;
use crate::encoder_line::{self, EncoderLine};
use crate::pose_stream::{self, PoseStream};
use crate::pose_tracker::PoseTracker;
use crate::random::{Random, Stream};
use crate::scenario::{GripperDriver, GripperSpec, Scenario};
use crate::tool::Tool;
use crate::truth::{ClockTruth, SensorTruth};
use crate::wrench_sensor::WrenchSensor;

/// A value of an operator's config.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(untagged)]
pub enum SettingValue {
    /// A number, in the unit that the key names.
    Number(f64),
    /// Several, x y z.
    Numbers(Vec<f64>),
    /// A text.
    Text(String),
}

/// A device that is there, as an operator would write it into the config.
#[derive(Clone, Debug, PartialEq)]
pub struct Fitted {
    /// `ft_sensor`, `gripper` or `aria`.
    pub name: String,
    /// The driver that takes it, as the configuration of `ft-capture` names it.
    pub driver: &'static str,
    /// What it hangs on.
    pub bus: Bus,
    /// What the driver must be told: `rate_hz`, `id`, `force_counts_per_newton`, ...
    pub settings: BTreeMap<String, SettingValue>,
}

/// What is known about the set-up before measuring: the mounting, and a payload from a calibration long ago.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct KnownSetup {
    /// Position (m) and quaternion x y z w; takes `tcp` coordinates to `aria_device`.
    pub aria_device_from_tcp: ([f64; 3], [f64; 4]),
    /// Position (m) and quaternion x y z w; takes `ft_sensor` coordinates to `tcp`.
    pub tcp_from_ft_sensor: ([f64; 3], [f64; 4]),
    /// The part of the gripper in front of the sensor.
    pub payload: PayloadEstimate,
}

/// Mass properties with their standard deviations, axes of `ft_sensor`.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PayloadEstimate {
    /// kg.
    pub mass_kg: f64,
    /// kg.
    pub mass_std_kg: f64,
    /// From the sensor's origin, m.
    pub com_m: [f64; 3],
    /// m.
    pub com_std_m: [f64; 3],
    /// About the centre of mass, kg m^2: xx xy yy xz yz zz.
    pub inertia_kgm2: [f64; 6],
    /// kg m^2.
    pub inertia_std_kgm2: [f64; 6],
}

impl KnownSetup {
    pub(super) fn draw(scenario: &Scenario, seed: u64, tool: &Tool) -> Self {
        let mut random = Random::new(seed, Stream::Calibration);
        let spec = &scenario.tool;
        let mass_std_kg = 0.01 * spec.mass_kg;
        let com_std = 0.8e-3;
        let inertia_std = spec.inertia_kgm2.map(|moment| 0.08 * moment.abs() + 2e-5);
        // A standard deviation off, one way or the other, so that it is never the truth by chance.
        let mut off = |std: f64| {
            std * random.uniform(0.6, 1.3) * if random.normal() < 0.0 { -1.0 } else { 1.0 }
        };
        Self {
            aria_device_from_tcp: pose(&tool.aria_device_from_tcp),
            tcp_from_ft_sensor: pose(&tool.tcp_from_ft_sensor),
            payload: PayloadEstimate {
                mass_kg: spec.mass_kg + off(mass_std_kg),
                mass_std_kg,
                com_m: spec.com_m.map(|component| component + off(com_std)),
                com_std_m: [com_std; 3],
                inertia_kgm2: std::array::from_fn(|term| {
                    spec.inertia_kgm2[term] + off(inertia_std[term])
                }),
                inertia_std_kgm2: inertia_std,
            },
        }
    }
}

pub(crate) fn pose(isometry: &Isometry3<f64>) -> ([f64; 3], [f64; 4]) {
    (
        isometry.translation.vector.into(),
        isometry.rotation.coords.into(),
    )
}

pub(super) fn build(
    scenario: &Scenario,
    seed: u64,
    tool: &Tool,
    time: &TimeSource,
) -> (Vec<Slot>, (SensorTruth, Vec<ClockTruth>)) {
    let mut clocks = Random::new(seed, Stream::Clocks);
    let sensor_reads = clocks.uniform(10.0, 4000.0);
    let tracker_reads = clocks.uniform(10.0, 90_000.0);
    let sensor_clock = DeviceClock::new(&scenario.sensor.clock, sensor_reads);
    let tracker_clock = DeviceClock::new(&scenario.tracker.clock, tracker_reads);
    let gauges = WrenchSensor::new(&scenario.sensor, Random::new(seed, Stream::Sensor));
    let sensor_truth = SensorTruth {
        bias: gauges.bias(0.0),
        drift_per_s: gauges.drift_per_s(),
    };

    let tracker = PoseTracker::new(
        &scenario.tracker,
        &tool.aria_device_from_tcp,
        Random::new(seed, Stream::Tracker),
    );
    let stream = PoseStream::new(tracker, tracker_clock, scenario.tracker.rate_hz);
    let aria = serial(
        "aria",
        "pose_stream",
        pose_stream::BAUD_BPS,
        [number("rate_hz", scenario.tracker.rate_hz)],
    );
    let slots = vec![
        sensor::slot(
            &scenario.sensor,
            gauges,
            sensor_clock,
            Random::new(seed, Stream::SensorLine),
            time,
        )
        .behind(&scenario.sensor.link),
        jaws_slot(
            &scenario.gripper,
            &sensor_clock,
            Random::new(seed, Stream::Gripper),
            Random::new(seed, Stream::GripperLine),
            time,
        ),
        serial_slot(aria, stream, Random::new(seed, Stream::TrackerLine), time)
            .behind(&scenario.tracker.link),
    ];
    let clock_truth = |device: &str, reads_s: f64, skew_ppm: f64| ClockTruth {
        device: device.to_owned(),
        reads_s,
        skew_ppm,
    };
    let (sensor, track) = (&scenario.sensor.clock, &scenario.tracker.clock);
    let clocks = vec![
        clock_truth(
            "ft_sensor",
            sensor.reads_s.unwrap_or(sensor_reads),
            sensor.skew_ppm,
        ),
        clock_truth(
            "aria",
            track.reads_s.unwrap_or(tracker_reads),
            track.skew_ppm,
        ),
    ];
    (slots, (sensor_truth, clocks))
}

fn jaws_slot(
    spec: &GripperSpec,
    clock: &DeviceClock,
    random: Random,
    line: Random,
    time: &TimeSource,
) -> Slot {
    let rate = number("rate_hz", spec.rate_hz);
    match spec.driver {
        GripperDriver::Dynamixel => {
            let settings = [number("id", f64::from(spec.id)), rate];
            let fitted = serial("gripper", "dynamixel", spec.baud_bps, settings);
            serial_slot(fitted, Dynamixel::new(spec, random), line, time)
        }
        GripperDriver::Amt21 => {
            let fitted = serial("gripper", "amt21", amt21::BAUD_BPS, [rate]);
            serial_slot(fitted, Amt21::new(spec.jitter_m, random), line, time)
        }
        GripperDriver::EncoderLine => {
            let settings = [number("counts_per_turn", encoder_line::COUNTS_PER_TURN)];
            let fitted = serial("gripper", "encoder_line", encoder_line::BAUD_BPS, settings);
            // A crystal like the sensor's will do.
            let device = EncoderLine::new(*clock, spec.rate_hz, spec.jitter_m, random);
            serial_slot(fitted, device, line, time)
        }
    }
}

pub(super) fn number(key: &str, value: f64) -> (String, SettingValue) {
    (key.to_owned(), SettingValue::Number(value))
}

pub(super) fn serial(
    name: &str,
    driver: &'static str,
    baud_bps: u32,
    settings: impl IntoIterator<Item = (String, SettingValue)>,
) -> Fitted {
    Fitted {
        name: name.to_owned(),
        driver,
        bus: Bus::Serial { baud_bps },
        settings: settings.into_iter().collect(),
    }
}

pub(super) fn serial_slot(
    fitted: Fitted,
    device: impl Played<Chunk> + 'static,
    random: Random,
    time: &TimeSource,
) -> Slot {
    let bits_per_second = match fitted.bus {
        Bus::Serial { baud_bps } => baud_bps,
        Bus::Can { bitrate_bps } => bitrate_bps,
    };
    let wired = wire::<Chunk>(
        &fitted.name,
        bits_per_second,
        Box::new(device),
        random,
        time,
    );
    Slot {
        fitted,
        kind: SlotKind::Serial(wired),
    }
}

pub(super) fn wire<F: Carried>(
    name: &str,
    bits_per_second: u32,
    device: Box<dyn Played<F>>,
    random: Random,
    time: &TimeSource,
) -> Wired<F> {
    Wired {
        device,
        port: Arc::new(Port::new(
            &format!("simulated {name}"),
            bits_per_second,
            time.clone(),
        )),
        line: Line::new(bits_per_second, random),
    }
}
