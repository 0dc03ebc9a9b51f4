//! Every simulated device, read by its driver: bytes written from the maker's document on one side, read on the other.
#![allow(clippy::unwrap_used)]

use std::time::Duration;

use ft_drivers::device::Counted;
use ft_drivers::pump::{Outlet, Pump, Turn};
use ft_drivers::reading::{Counts, DeviceEvent, Reading};
use ft_drivers::robotous::Scale as RftScale;
use ft_drivers::{
    Device, Link, RxStamps, SteppedClock, amt21, ati_netcanoem, bota_serial, dynamixel,
    encoder_line, kunwei_kwr75, leptrino, optoforce, optoforce_can, optoforce_serial, robotous,
    robotous_can, robotous_uart,
};
use ft_sim_hw::scenario::{GripperDriver, SensorDriver, SensorSpec};
use ft_sim_hw::{Scenario, SettingValue, Simulation};
use ft_wire::HostTime;

const START: HostTime = HostTime::from_nanos(1_750_000_000_000_000_000);
/// The gripper is held still in free air for this long.
const STILL: Duration = Duration::from_millis(1_900);
const WEIGHT_N: f64 = 0.49 * 9.80665;

#[derive(Default)]
struct Kept(Vec<Reading>);

impl<F> Outlet<F> for Kept {
    fn frame(&mut self, _frame: &F, _stamps: RxStamps) {}
    fn reading(&mut self, reading: Reading) {
        self.0.push(reading);
    }
}

/// Turns driver and simulation together while the gripper is still.
fn read<D, L>(simulation: &mut Simulation, device: D, link: L) -> (Counts, Vec<Reading>)
where
    D: Device<Reading = Reading> + Counted,
    L: Link<Frame = D::Frame>,
{
    let clock = SteppedClock::new(START);
    let mut pump = Pump::new(device, link);
    let mut kept = Kept::default();
    let mut now = START;
    while now < START + STILL {
        now = now + Duration::from_millis(1);
        simulation.advance_to(now);
        clock.advance_to(now);
        while pump.turn(&clock, now, &mut kept).unwrap() == Turn::Frame {}
    }
    (pump.counts(), kept.0)
}

/// A setting of the fitted sensor, as an operator would type it.
fn numbers<const N: usize>(simulation: &Simulation, key: &str) -> [f64; N] {
    let fitted = &simulation.fitted()[0];
    let values = match &fitted.settings[key] {
        SettingValue::Number(number) => vec![*number],
        SettingValue::Numbers(numbers) => numbers.clone(),
        SettingValue::Text(text) => panic!("{key} is {text}"),
    };
    values.try_into().unwrap()
}

fn hex_config(simulation: &Simulation) -> optoforce::Config {
    let scale = optoforce::Scale {
        counts_per_newton: numbers(simulation, "force_counts_per_newton"),
        counts_per_newton_metre: numbers(simulation, "torque_counts_per_newton_metre"),
    };
    optoforce::Config {
        rate_hz: 1000,
        ..optoforce::Config::new(scale)
    }
}

fn rft_config(simulation: &Simulation) -> robotous::Config {
    let [counts_per_newton] = numbers(simulation, "force_counts_per_newton");
    let [counts_per_newton_metre] = numbers(simulation, "torque_counts_per_newton_metre");
    robotous::Config {
        rate_hz: 1000,
        scale: RftScale {
            counts_per_newton,
            counts_per_newton_metre,
        },
        ..robotous::Config::default()
    }
}

fn sensor(driver: &str) -> (Simulation, Counts, Vec<Reading>) {
    let mut scenario = Scenario::builtin("wood_door").unwrap();
    scenario.sensor = SensorSpec::of(driver).unwrap();
    let mut simulation = Simulation::new(&scenario, 5, START, None).unwrap();
    let serial = simulation.serial_link("ft_sensor");
    let can = simulation.can_link("ft_sensor");
    let simulated = &mut simulation;
    let (counts, readings) = match driver {
        "bota_serial" => {
            let device = bota_serial::BotaSerial::new(bota_serial::Config::default());
            read(simulated, device, serial.unwrap())
        }
        "robotous_can" => {
            let config = robotous_can::Config {
                sensor: rft_config(simulated),
                ..robotous_can::Config::default()
            };
            read(
                simulated,
                robotous_can::RobotousCan::new(config),
                can.unwrap(),
            )
        }
        "robotous_uart" => {
            let config = robotous_uart::Config {
                sensor: rft_config(simulated),
                baud_bps: 921_600,
            };
            let device = robotous_uart::RobotousUart::new(config);
            read(simulated, device, serial.unwrap())
        }
        "optoforce_serial" => {
            let device = optoforce_serial::OptoforceSerial::new(hex_config(simulated));
            read(simulated, device, serial.unwrap())
        }
        "optoforce_can" => {
            let config = optoforce_can::Config::new(hex_config(simulated));
            read(
                simulated,
                optoforce_can::OptoforceCan::new(config),
                can.unwrap(),
            )
        }
        "kunwei_kwr75" => {
            let device = kunwei_kwr75::KunweiKwr75::new(kunwei_kwr75::Config::default());
            read(simulated, device, serial.unwrap())
        }
        "leptrino" => {
            let device = leptrino::Leptrino::new(leptrino::Config::default());
            read(simulated, device, serial.unwrap())
        }
        "ati_netcanoem" => {
            let device = ati_netcanoem::AtiNetcanoem::new(ati_netcanoem::Config::default());
            read(simulated, device, can.unwrap())
        }
        other => panic!("{other}: no driver is tried here"),
    };
    (simulation, counts, readings)
}

fn gripper(driver: &str) -> (Counts, Vec<Reading>) {
    let mut scenario = Scenario::builtin("wood_door").unwrap();
    scenario.gripper.driver = GripperDriver::named(driver).unwrap();
    scenario.gripper.rate_hz = 100.0;
    let mut simulation = Simulation::new(&scenario, 5, START, None).unwrap();
    let link = simulation.serial_link("gripper").unwrap();
    let simulated = &mut simulation;
    let period = Duration::from_millis(10);
    match driver {
        "dynamixel" => {
            let config = dynamixel::Config {
                period,
                ..dynamixel::Config::default()
            };
            read(simulated, dynamixel::Dynamixel::new(config), link)
        }
        "amt21" => {
            let config = amt21::Config {
                period,
                ..amt21::Config::default()
            };
            read(simulated, amt21::Amt21::new(config), link)
        }
        "encoder_line" => {
            let [counts_per_turn] = gripper_numbers(simulated);
            let config = encoder_line::Config::new(counts_per_turn);
            read(simulated, encoder_line::EncoderLine::new(config), link)
        }
        other => panic!("{other}: no driver is tried here"),
    }
}

fn gripper_numbers(simulation: &Simulation) -> [f64; 1] {
    let fitted = simulation
        .fitted()
        .iter()
        .find(|fitted| fitted.name == "gripper");
    match fitted.unwrap().settings["counts_per_turn"] {
        SettingValue::Number(number) => [number],
        _ => panic!("counts_per_turn is a number"),
    }
}

#[test]
fn every_simulated_encoder_is_read_right_by_its_driver() {
    let mut openings = Vec::new();
    for driver in GripperDriver::names() {
        let (counts, readings) = gripper(driver);
        assert_eq!(
            (
                counts.gaps,
                counts.refused,
                counts.duplicated,
                counts.skipped
            ),
            (0, 0, 0, 0),
            "{driver}"
        );
        let widths: Vec<_> = readings
            .iter()
            .filter_map(|reading| match reading {
                Reading::Width(width) => Some(width.width_m),
                _ => None,
            })
            .collect();
        assert!(
            (170..=190).contains(&widths.len()),
            "{driver}: {}",
            widths.len()
        );
        openings.push(widths.iter().sum::<f64>() / widths.len() as f64);
    }
    // A Dynamixel's count is 0.1 mm of opening at most.
    for opening in &openings {
        assert!((opening - openings[0]).abs() < 1e-4, "{openings:?}");
        assert!((0.02..0.15).contains(opening), "{openings:?}");
    }
}

#[test]
fn every_simulated_sensor_is_read_right_by_its_driver() {
    for driver in SensorDriver::names() {
        let (simulation, counts, readings) = sensor(driver);
        assert_eq!(
            (
                counts.gaps,
                counts.refused,
                counts.duplicated,
                counts.skipped
            ),
            (0, 0, 0, 0),
            "{driver}"
        );
        let wrenches: Vec<_> = readings
            .iter()
            .filter_map(|reading| match reading {
                Reading::Wrench(wrench) => Some(wrench),
                _ => None,
            })
            .collect();
        let (first, last) = (wrenches.first().unwrap(), wrenches.last().unwrap());
        let seconds = last.at.arrival.seconds_since(first.at.arrival);
        let rate = SensorSpec::of(driver).unwrap().rate_hz;
        let expected = seconds * rate;
        assert!(
            (wrenches.len() as f64 - expected).abs() < 0.01 * expected + 2.0,
            "{driver}: {} samples in {seconds} s",
            wrenches.len()
        );
        // Set-up takes what its drains and its writing at 5 ms a character take.
        assert!(seconds > 0.9, "{driver}: samples for {seconds} s only");
        let errors = simulation.truth().sensor_errors;
        let mut mean = [0.0; 6];
        for wrench in &wrenches {
            for (axis, value) in wrench.wrench.to_array().into_iter().enumerate() {
                mean[axis] += (value - errors.bias[axis]) / wrenches.len() as f64;
            }
        }
        let weight = mean[..3]
            .iter()
            .map(|force| force * force)
            .sum::<f64>()
            .sqrt();
        // A count of the coarsest axis is half a newton: its mean is off by less than half of that.
        assert!((weight - WEIGHT_N).abs() < 0.25, "{driver}: {weight} N");
        assert!(
            mean[3..].iter().all(|torque| torque.abs() < 0.4),
            "{driver}: {mean:?}"
        );
        for reading in &readings {
            if let Reading::Event { event, .. } = reading {
                let fine = !matches!(
                    event,
                    DeviceEvent::Lost { .. } | DeviceEvent::Warning { .. }
                );
                assert!(fine, "{driver}: {event:?}");
            }
        }
    }
}
