//! Drivers on serial ports of USB devices: the device's side is a simulated device, the host's a `/dev/ttyACM0`.

use std::path::Path;
use std::time::Duration;

use ft_capture::config::Device;
use ft_drivers::discover::RememberedPort;
use ft_drivers::link::serial::SerialLink;
use ft_drivers::reading::Reading;
use ft_drivers::{Clock as _, Link as _, LinkError, MonotonicClock};
use ft_sim_hw::scenario::GripperDriver;
use ft_sim_hw::{Scenario, ServeOptions};

use crate::Case;
use crate::gadget::Gadget;
use crate::hear::{Heard, Played, hear};
use crate::machine::wait_for;

pub(crate) const CASES: &[Case] = &[
    ("acm_bota", || sensor("bota_serial", 400.0)),
    ("acm_robotous", || sensor("robotous_uart", 200.0)),
    ("acm_optoforce", || sensor("optoforce_serial", 333.0)),
    ("acm_kunwei", || sensor("kunwei_kwr75", 1000.0)),
    ("acm_leptrino", || sensor("leptrino", 1200.0)),
    ("acm_encoders_agree", acm_encoders_agree),
    ("acm_pose_stream", acm_pose_stream),
    ("acm_port_is_ours_alone", acm_port_is_ours_alone),
    ("acm_unplugged_is_gone", acm_unplugged_is_gone),
    (
        "acm_two_of_a_kind_are_told_apart",
        acm_two_of_a_kind_are_told_apart,
    ),
];

/// The virtual serial port of STM32 controllers.
pub(crate) const STM32: (u16, u16) = (0x0483, 0x5740);

/// A simulated gripper of which the device `name` is behind USB.
pub(crate) struct Plugged {
    // In this order: a gadget's side must not be opened while its function goes away (Linux 6.1 would crash).
    pub(crate) played: Played,
    pub(crate) gadget: Gadget,
}

impl Drop for Plugged {
    /// Its side would wait for its buffer to be emptied when it is closed, but for an unplugged one it does not.
    fn drop(&mut self) {
        self.gadget.unplug();
    }
}

impl Plugged {
    pub(crate) fn new(scenario: &Scenario, name: &str, socket: usize, serial_number: &str) -> Self {
        let (gadget, tty) = Gadget::serial(socket, STM32.0, STM32.1, serial_number);
        let options = ServeOptions {
            gadgets: [(name.to_owned(), tty)].into(),
            ..ServeOptions::default()
        };
        gadget.plug_in();
        let port = gadget.port().path.display().to_string();
        let played = Played::new(scenario, options, |_| port.clone());
        Self { played, gadget }
    }

    pub(crate) fn sensor(driver: &str, rate_hz: f64, socket: usize, serial_number: &str) -> Self {
        let scenario = Played::scenario(driver, rate_hz);
        Self::new(&scenario, "ft_sensor", socket, serial_number)
    }
}

fn sensor(driver: &str, rate_hz: f64) {
    let plugged = Plugged::sensor(driver, rate_hz, 0, "LAB1");
    plugged.played.weighs_the_tool(300).is_whole();
}

fn acm_encoders_agree() {
    let mut openings = Vec::new();
    for driver in GripperDriver::names() {
        let mut scenario = Scenario::builtin("wood_door").unwrap();
        scenario.gripper.driver = GripperDriver::named(driver).unwrap();
        let plugged = Plugged::new(&scenario, "gripper", 0, "LAB1");
        let heard = hear_without_a_late_answer(plugged.played.device("gripper"));
        heard.is_whole();
        let widths = heard.widths();
        openings.push(widths.iter().sum::<f64>() / widths.len() as f64);
    }
    // A Dynamixel's count is 0.1 mm of opening at most.
    for opening in &openings {
        assert!((opening - openings[0]).abs() < 2e-4, "{openings:?}");
        assert!((0.02..0.15).contains(opening), "{openings:?}");
    }
}

/// Sixty samples in a row. Where the guest stands still for longer than an answer may take, the poll is a gap, and that is right:
/// then it is listened to once more, three times at most. A driver that loses answers loses them each time.
fn hear_without_a_late_answer(gripper: &Device) -> Heard {
    let mut tries = (0..3).map(|_| hear(gripper, 60).unwrap());
    tries
        .find(|heard| heard.counts.gaps == 0)
        .expect("every answer in time, in one of three tries")
}

fn acm_pose_stream() {
    let scenario = Scenario::builtin("wood_door").unwrap();
    let plugged = Plugged::new(&scenario, "aria", 0, "LAB1");
    let heard = hear(plugged.played.device("aria"), 300).unwrap();
    heard.is_whole();
    for reading in &heard.readings {
        if let Reading::Pose(pose) = reading {
            let norm: f64 = pose.pose.quaternion.iter().map(|part| part * part).sum();
            assert!((norm - 1.0).abs() < 1e-6, "{pose:?}");
        }
    }
}

fn open(port: &Path) -> Result<SerialLink, LinkError> {
    SerialLink::open(port, 460_800, MonotonicClock::anchored_now())
}

fn acm_port_is_ours_alone() {
    let plugged = Plugged::sensor("bota_serial", 400.0, 0, "LAB1");
    let port = plugged.gadget.port().path;
    let _first = open(&port).unwrap();
    let second = open(&port);
    assert!(matches!(second, Err(LinkError::Busy { .. })), "{second:?}");
}

fn acm_unplugged_is_gone() {
    let plugged = Plugged::sensor("bota_serial", 400.0, 0, "LAB1");
    let port = plugged.gadget.port().path;
    let mut link = open(&port).unwrap();
    let clock = MonotonicClock::anchored_now();
    link.recv(clock.now() + Duration::from_millis(50)).unwrap();
    plugged.gadget.unplug();
    let end = clock.now() + Duration::from_secs(2);
    let ended = loop {
        match link.recv(end) {
            Ok(None) => panic!("the port lives on without its device"),
            Ok(Some(_)) => {}
            Err(error) => break error,
        }
    };
    assert!(matches!(ended, LinkError::Gone { .. }), "{ended:?}");
    wait_for("its name to go", Duration::from_secs(5), || !port.exists());
    let again = open(&port);
    assert!(
        matches!(again, Err(LinkError::NotFound { .. })),
        "{again:?}"
    );
}

/// Two sensors of one identity, plugged in again in the other order: each is found by its serial number.
fn acm_two_of_a_kind_are_told_apart() {
    let pair = [
        Plugged::sensor("bota_serial", 400.0, 0, "LABLEFT"),
        Plugged::sensor("bota_serial", 400.0, 1, "LABRIGHT"),
    ];
    let ports = || [0, 1].map(|index: usize| pair[index].gadget.port().path);
    let before = ports();
    let mut remembered = [0, 1].map(|index: usize| RememberedPort::serial(&before[index]));
    for (port, path) in remembered.iter_mut().zip(&before) {
        assert_eq!(port.path().unwrap(), *path);
    }
    for plugged in &pair {
        plugged.gadget.unplug();
    }
    pair[1].gadget.plug_in();
    let right = pair[1].gadget.port().path;
    assert_eq!(right, before[0], "the kernel gave it another name");
    let left = remembered[0].path();
    assert!(
        matches!(left, Err(LinkError::Other { .. })),
        "another device is where the left one was: {left:?}"
    );
    pair[0].gadget.plug_in();
    let after = ports();
    assert_eq!([&after[1], &after[0]], [&before[0], &before[1]]);
    for (port, path) in remembered.iter_mut().zip(&after) {
        assert_eq!(port.path().unwrap(), *path);
    }
    pair[0].played.weighs_the_tool_at(&after[0], 200);
}
