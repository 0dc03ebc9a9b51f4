//! candleLight adapters: a device of FunctionFS, its host frames through libusb.

use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Duration;

use ft_capture::config::Device;
use ft_drivers::discover;
use ft_drivers::link::can_port::{CanName, CanPort};
use ft_drivers::{Clock as _, Link as _, LinkError, MonotonicClock};
use ft_sim_hw::ServeOptions;
use ft_wire::CanFrame;

use crate::Case;
use crate::gadget::Gadget;
use crate::hear::{Played, hear};
use crate::machine::{load, run, wait_for};

pub(crate) const CASES: &[Case] = &[
    ("candle_is_ours_alone", candle_is_ours_alone),
    (
        "candle_two_of_a_kind_are_told_apart",
        candle_two_of_a_kind_are_told_apart,
    ),
    (
        "candle_without_a_name_stays_the_one_that_was_found",
        candle_without_a_name_stays_the_one_that_was_found,
    ),
    (
        "candle_comes_at_the_bit_rate_of_its_sensor",
        candle_comes_at_the_bit_rate_of_its_sensor,
    ),
    ("candle_weighs_for_long", candle_weighs_for_long),
    ("candle_at_a_wrong_bit_rate", candle_at_a_wrong_bit_rate),
    ("candle_unplugged_is_gone", candle_unplugged_is_gone),
    (
        "candle_under_linuxs_own_driver",
        candle_under_linuxs_own_driver,
    ),
];

const CANDLELIGHT: (u16, u16) = (0x1D50, 0x606F);
/// For the host to notice a device.
const LONGEST: Duration = Duration::from_secs(15);

/// A simulated gripper whose sensor is behind an adapter of its own.
pub(crate) struct Plugged {
    played: Option<Played>,
    pub(crate) gadget: Gadget,
    folder: PathBuf,
    serial_number: &'static str,
}

impl Drop for Plugged {
    /// The adapter's threads end once it is unplugged and nobody serves it; only then may its function go.
    fn drop(&mut self) {
        self.gadget.unplug();
        self.played = None;
        wait_for("the FunctionFS to be free", LONGEST, || {
            let ended = Command::new("umount").arg(&self.folder).output();
            ended.is_ok_and(|output| output.status.success())
        });
    }
}

impl Plugged {
    pub(crate) fn new(socket: usize, serial_number: &'static str) -> Self {
        Self::with_sensor(socket, serial_number, "robotous_can", 200.0)
    }

    fn with_sensor(socket: usize, serial_number: &'static str, driver: &str, rate_hz: f64) -> Self {
        load("usb_f_fs");
        let (vendor, product) = CANDLELIGHT;
        let gadget = Gadget::new(socket, vendor, product, serial_number);
        gadget.add(&format!("ffs.{serial_number}"));
        let folder = Path::new("/run").join(serial_number);
        std::fs::create_dir_all(&folder).unwrap();
        run(&format!(
            "mount -t functionfs {serial_number} {}",
            folder.display()
        ));
        let options = ServeOptions {
            candlelights: [("ft_sensor".to_owned(), folder.clone())].into(),
            ..ServeOptions::default()
        };
        let played = Played::with_sensor(driver, rate_hz, options, |_| {
            format!("gs_usb:{serial_number}")
        });
        let plugged = Self {
            played: Some(played),
            gadget,
            folder,
            serial_number,
        };
        plugged.plug_in();
        plugged
    }

    pub(crate) fn plug_in(&self) {
        self.gadget.plug_in();
        wait_for("the host's adapter", LONGEST, || self.is_there());
    }

    fn is_there(&self) -> bool {
        let mut adapters = discover::can_adapters().into_iter();
        adapters.any(|adapter| adapter.serial_number == self.serial_number)
    }

    fn played(&self) -> &Played {
        self.played.as_ref().unwrap()
    }

    pub(crate) fn sensor(&self) -> Device {
        self.played().device("ft_sensor").clone()
    }

    fn weighs_the_tool(&self, samples: usize) {
        self.weighs_the_tool_by(&self.sensor(), samples);
    }

    fn weighs_the_tool_by(&self, sensor: &Device, samples: usize) {
        self.played()
            .weighs_the_tool_by(sensor, samples)
            .is_nearly_whole();
    }
}

fn open(port: &str) -> Result<CanPort, LinkError> {
    CanName::parse(port)?.open(&[], 1_000_000, MonotonicClock::anchored_now())
}

fn candle_is_ours_alone() {
    let _plugged = Plugged::new(0, "LABCANDLE");
    let none = open("gs_usb:LABCANDLE/5");
    assert!(
        matches!(none, Err(LinkError::Channel { channel: 5, .. })),
        "{none:?}"
    );
    let _first = open("gs_usb:LABCANDLE").unwrap();
    let second = open("gs_usb:LABCANDLE");
    assert!(matches!(second, Err(LinkError::Busy { .. })), "{second:?}");
}

fn candle_two_of_a_kind_are_told_apart() {
    let pair = [Plugged::new(0, "LABCANDLEA"), Plugged::new(1, "LABCANDLEB")];
    let either = open("gs_usb:");
    assert!(
        matches!(either, Err(LinkError::Ambiguous { count: 2, .. })),
        "{either:?}"
    );
    pair[1].weighs_the_tool(50);
    for plugged in &pair {
        plugged.gadget.unplug();
    }
    // The other order: the serial number is what counts.
    pair[1].plug_in();
    let absent = open("gs_usb:LABCANDLEA");
    assert!(
        matches!(absent, Err(LinkError::NotFound { .. })),
        "{absent:?}"
    );
    pair[0].plug_in();
    pair[0].weighs_the_tool(50);
    pair[1].weighs_the_tool(50);
}

fn candle_without_a_name_stays_the_one_that_was_found() {
    let clock = MonotonicClock::anchored_now();
    let mut bus = CanName::parse("gs_usb:").unwrap();
    let mut open = || bus.open(&[], 1_000_000, clock);
    let mine = Plugged::new(0, "LABCANDLEA");
    drop(open().unwrap());
    mine.gadget.unplug();
    let _other = Plugged::new(1, "LABCANDLEB");
    let taken = open();
    assert!(
        matches!(&taken, Err(LinkError::NotFound { port }) if port == "gs_usb:LABCANDLEA"),
        "{taken:?}"
    );
    mine.plug_in();
    open().unwrap();
}

/// ATI's boards leave the factory with 250 kbit/s.
fn candle_comes_at_the_bit_rate_of_its_sensor() {
    let plugged = Plugged::with_sensor(0, "LABCANDLE", "ati_netcanoem", 100.0);
    plugged.weighs_the_tool(50);
}

fn candle_weighs_for_long() {
    let plugged = Plugged::new(0, "LABCANDLE");
    plugged.weighs_the_tool(1000);
    // Closed and opened again.
    plugged.weighs_the_tool(50);
}

/// Nobody understands what is sent at another rate: the adapter goes off the bus, and opening it at the right one ends that.
fn candle_at_a_wrong_bit_rate() {
    let plugged = Plugged::new(0, "LABCANDLE");
    let mut sensor = plugged.sensor();
    sensor.port = "gs_usb:LABCANDLE@500000".to_owned();
    let ended = hear(&sensor, 1);
    assert!(matches!(ended, Err(LinkError::BusOff { .. })), "{ended:?}");
    plugged.weighs_the_tool(50);
}

fn candle_unplugged_is_gone() {
    let plugged = Plugged::new(0, "LABCANDLE");
    let clock = MonotonicClock::anchored_now();
    let mut link = open("gs_usb:LABCANDLE").unwrap();
    let quiet = link.recv(clock.now() + Duration::from_millis(50));
    assert!(matches!(quiet, Ok(None)), "{quiet:?}");
    plugged.gadget.unplug();
    let ended = link.recv(clock.now() + LONGEST);
    assert!(matches!(ended, Err(LinkError::Gone { .. })), "{ended:?}");
    let stop = CanFrame::standard(0x64, &[0x0C; 8]).unwrap();
    let unsent = link.send(&stop);
    assert!(matches!(unsent, Err(LinkError::Gone { .. })), "{unsent:?}");
    drop(link);
    plugged.plug_in();
    plugged.weighs_the_tool(50);
}

/// Linux's driver knows the adapter by the maker's protocol alone: it brings the simulated one up. While it is up it is not ours;
/// when it is down we take it from the kernel, and give it back.
fn candle_under_linuxs_own_driver() {
    load("gs_usb");
    load("can_raw");
    let plugged = Plugged::new(0, "LABCANDLE");
    let interface = || {
        let adapter = discover::can_adapters().into_iter().next()?;
        Some(adapter.interface?.name)
    };
    wait_for("the kernel's interface", LONGEST, || interface().is_some());
    let name = interface().unwrap();
    run(&format!("ip link set {name} up type can bitrate 1000000"));
    let taken = open("gs_usb:LABCANDLE");
    assert!(matches!(taken, Err(LinkError::Busy { .. })), "{taken:?}");
    let mut sensor = plugged.sensor();
    sensor.port = name.clone();
    plugged.weighs_the_tool_by(&sensor, 200);
    run(&format!("ip link set {name} down"));
    plugged.weighs_the_tool(50);
    wait_for("the kernel's interface again", LONGEST, || {
        interface().is_some()
    });
    drop(plugged);
    run("rmmod gs_usb");
}
