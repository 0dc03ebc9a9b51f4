//! The force-torque sensor that a scenario asks for, on its bus.

use ft_wire::CanFrame;

use super::fitted::{Fitted, SettingValue, number, serial, serial_slot, wire};
use super::slot::{Slot, SlotKind};
use crate::ati_netcanoem::{self, AtiNetcanoem};
use crate::bota_serial::{self, BotaSerial};
use crate::bus::{Bus, TimeSource};
use crate::clock::DeviceClock;
use crate::device::Played;
use crate::kunwei_kwr75::{self, KunweiKwr75};
use crate::leptrino::{self, Leptrino};
use crate::optoforce::{self, Hex, OptoforceCan, OptoforceSerial};
use crate::random::Random;
use crate::robotous::can::{self, RobotousCan};
use crate::robotous::uart::RobotousUart;
use crate::robotous::{self, Interface, Model, Rft};
use crate::scenario::{SensorDriver, SensorSpec};
use crate::wrench_sensor::WrenchSensor;

const NAME: &str = "ft_sensor";

type Settings = Vec<(String, SettingValue)>;

/// The sensor of `spec`, made of its gauges and its clock.
pub(super) fn slot(
    spec: &SensorSpec,
    gauges: WrenchSensor,
    clock: DeviceClock,
    random: Random,
    time: &TimeSource,
) -> Slot {
    let driver = spec.driver.name();
    let rate = number("rate_hz", spec.rate_hz);
    let model = Model::named(&spec.model);
    let on_can = |settings: Settings, bitrate_bps, device: Box<dyn Played<CanFrame>>, random| {
        can_slot(driver, settings, bitrate_bps, device, random, time)
    };
    match (spec.driver, model) {
        (SensorDriver::RobotousCan, Some(model)) => {
            let device = RobotousCan::new(rft(spec, gauges, clock, Interface::Can, model));
            on_can(
                rft_settings(rate, model),
                can::BITRATE_BPS,
                Box::new(device),
                random,
            )
        }
        (SensorDriver::RobotousUart, Some(model)) => {
            let baud = robotous::baud_for(model.rate_code(spec.rate_hz).unwrap_or(0));
            let interface = Interface::Uart {
                baud_code: robotous::baud_code(baud).unwrap_or(0),
            };
            let device = RobotousUart::new(rft(spec, gauges, clock, interface, model));
            let fitted = serial(NAME, driver, baud, rft_settings(rate, model));
            serial_slot(fitted, device, random, time)
        }
        (SensorDriver::OptoforceSerial, _) => {
            let fitted = serial(NAME, driver, optoforce::BAUD_BPS, hex_settings(rate));
            let device = OptoforceSerial(Hex::new(gauges, clock));
            serial_slot(fitted, device, random, time)
        }
        (SensorDriver::OptoforceCan, _) => {
            let device = OptoforceCan(Hex::new(gauges, clock));
            on_can(
                hex_settings(rate),
                optoforce::BITRATE_BPS,
                Box::new(device),
                random,
            )
        }
        (SensorDriver::KunweiKwr75, _) => {
            let fitted = serial(NAME, driver, kunwei_kwr75::BAUD_BPS, []);
            let device = KunweiKwr75::new(gauges, clock, spec.already_streaming);
            serial_slot(fitted, device, random, time)
        }
        (SensorDriver::Leptrino, _) => {
            let fitted = serial(NAME, driver, leptrino::BAUD_BPS, []);
            let device = Leptrino::new(gauges, clock, spec.rate_hz, spec.already_streaming);
            serial_slot(fitted, device, random, time)
        }
        (SensorDriver::AtiNetcanoem, _) => {
            let device = Box::new(AtiNetcanoem::new(gauges));
            on_can(vec![rate], ati_netcanoem::BITRATE_BPS, device, random)
        }
        // A scenario whose Robotous model is unknown does not pass the check.
        (SensorDriver::BotaSerial, _) | (_, None) => {
            let fitted = serial(NAME, "bota_serial", bota_serial::BAUD_BPS, [rate]);
            let device = BotaSerial::new(gauges, clock, spec.rate_hz);
            serial_slot(fitted, device, random, time)
        }
    }
}

fn rft(
    spec: &SensorSpec,
    gauges: WrenchSensor,
    clock: DeviceClock,
    interface: Interface,
    model: Model,
) -> Rft {
    let rft = Rft::new(model, gauges, clock, interface);
    if spec.already_streaming {
        rft.left_streaming(spec.rate_hz)
    } else {
        rft
    }
}

fn rft_settings(rate: (String, SettingValue), model: Model) -> Settings {
    vec![
        rate,
        number("force_counts_per_newton", model.counts_per_newton),
        number(
            "torque_counts_per_newton_metre",
            model.counts_per_newton_metre,
        ),
    ]
}

fn hex_settings(rate: (String, SettingValue)) -> Settings {
    let (force, torque) = optoforce::COUNTS_PER_UNIT.split_at(3);
    let numbers =
        |key: &str, values: &[f64]| (key.to_owned(), SettingValue::Numbers(values.to_vec()));
    vec![
        rate,
        numbers("force_counts_per_newton", force),
        numbers("torque_counts_per_newton_metre", torque),
    ]
}

fn can_slot(
    driver: &'static str,
    settings: Settings,
    bitrate_bps: u32,
    device: Box<dyn Played<CanFrame>>,
    random: Random,
    time: &TimeSource,
) -> Slot {
    let fitted = Fitted {
        name: NAME.to_owned(),
        driver,
        bus: Bus::Can { bitrate_bps },
        settings: settings.into_iter().collect(),
    };
    let wired = wire::<CanFrame>(NAME, bitrate_bps, device, random, time);
    Slot {
        fitted,
        kind: SlotKind::Can(wired),
    }
}
