//! Drivers on a CAN interface of the kernel.

use std::process::Command;
use std::sync::Once;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::Duration;

use ft_capture::settings::in_effect;
use ft_drivers::link::can_errors::CanErrors;
use ft_drivers::link::socketcan::SocketCanLink;
use ft_drivers::{Clock as _, Link as _, LinkError, MonotonicClock};
use ft_sim_hw::ServeOptions;
use ft_wire::CanFrame;
use socketcan::frame::can_frame_default;
use socketcan::{CanErrorFrame, CanSocket, EmbeddedFrame as _, Socket as _, StandardId};

use crate::Case;
use crate::hear::{Heard, Played, hear};
use crate::machine::{load, run, set_kernel};

/// Room of a socket that is opened, bytes.
const QUEUE_BYTES: &str = "rmem_default";

pub(crate) const CASES: &[Case] = &[
    ("can_robotous", can_robotous),
    ("can_optoforce", can_optoforce),
    ("can_ati", can_ati),
    (
        "can_flooded_bus_costs_no_sample",
        can_flooded_bus_costs_no_sample,
    ),
    (
        "can_frames_without_room_are_counted",
        can_frames_without_room_are_counted,
    ),
    (
        "can_error_frames_are_counted_by_class",
        can_error_frames_are_counted_by_class,
    ),
    ("can_bus_off_ends_the_link", can_bus_off_ends_the_link),
    (
        "can_interface_that_is_down_says_so",
        can_interface_that_is_down_says_so,
    ),
    ("can_nobody_acknowledges", can_nobody_acknowledges),
    (
        "can_sensors_read_by_a_strangers_program",
        can_sensors_read_by_a_strangers_program,
    ),
];

/// A virtual bus that is up.
pub(crate) fn bus() -> &'static str {
    static MADE: Once = Once::new();
    MADE.call_once(|| {
        for module in ["vcan", "can_raw"] {
            load(module);
        }
        run("ip link add vcan0 type vcan");
    });
    run("ip link set vcan0 up");
    "vcan0"
}

pub(crate) fn played(driver: &str, rate_hz: f64) -> Played {
    let options = ServeOptions {
        vcan: Some(bus().to_owned()),
        ..ServeOptions::default()
    };
    Played::with_sensor(driver, rate_hz, options, |_| bus().to_owned())
}

fn can_robotous() {
    played("robotous_can", 200.0)
        .weighs_the_tool(300)
        .is_nearly_whole();
}

fn can_optoforce() {
    played("optoforce_can", 333.0)
        .weighs_the_tool(300)
        .is_nearly_whole();
}

fn can_ati() {
    played("ati_netcanoem", 100.0)
        .weighs_the_tool(150)
        .is_nearly_whole();
}

/// Frames that nobody asked for, about nine a millisecond, with other ids than the sensor's.
fn can_flooded_bus_costs_no_sample() {
    let played = played("robotous_can", 200.0);
    let (stop, clock) = (AtomicBool::new(false), MonotonicClock::anchored_now());
    // What is held against must not lack frames, however slow the guest is; the driver's own queue stays as it is.
    let usual = set_kernel(QUEUE_BYTES, "8388608");
    let mut beside = SocketCanLink::open(bus(), &[0x01, 0x02], clock).unwrap();
    set_kernel(QUEUE_BYTES, &usual);
    let flood = AtomicU64::new(0);
    let (heard, sent) = std::thread::scope(|scope| {
        let sent = scope.spawn(|| {
            let mut halves = Vec::new();
            while !stop.load(Ordering::Relaxed) {
                let came = beside.recv(clock.now() + Duration::from_millis(20));
                halves.extend(came.unwrap().map(|(frame, _)| frame));
            }
            // What the driver has heard may wait here still.
            while let Some((frame, _)) = beside.recv(clock.now()).unwrap() {
                halves.push(frame);
            }
            let _ = beside.take_notice();
            assert_eq!(beside.overflows(), 0, "what is held against lacks frames");
            halves
        });
        let flooding = scope.spawn(|| {
            let socket = CanSocket::open(bus()).unwrap();
            let clock = MonotonicClock::anchored_now();
            while !stop.load(Ordering::Relaxed) {
                for id in [0x123, 0x7FF, 0x003] {
                    let id = StandardId::new(id).unwrap();
                    let frame = socketcan::CanFrame::new(id, &[0x0B; 8]).unwrap();
                    flood.fetch_add(socket.write_frame(&frame).is_ok().into(), Ordering::Relaxed);
                }
                clock.wait_until(clock.now() + Duration::from_micros(300));
            }
        });
        let enough = || flood.load(Ordering::Relaxed) > 2_000;
        let heard = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| {
            played.weighs_the_tool_until(600, &enough)
        }));
        stop.store(true, Ordering::Relaxed);
        flooding.join().unwrap();
        let sent = sent.join().unwrap();
        (
            heard.unwrap_or_else(|cause| std::panic::resume_unwind(cause)),
            sent,
        )
    });
    heard.is_nearly_whole();
    let flood = flood.into_inner();
    assert!(flood > 2_000, "only {flood} foreign frames");
    let scale = |key: &str| {
        let settings = in_effect(played.device("ft_sensor")).unwrap();
        settings[key].as_float().unwrap()
    };
    let scales = [
        scale("force_counts_per_newton"),
        scale("torque_counts_per_newton_metre"),
    ];
    is_all_that_was_sent(&heard, &samples(&sent, scales));
}

/// The wrenches of a Robotous sensor's halves, by the maker's table and nothing of the driver.
fn samples(halves: &[CanFrame], [per_newton, per_newton_metre]: [f64; 2]) -> Vec<[f64; 6]> {
    let pairs = halves.windows(2).filter_map(|pair| {
        let (first, second) = (&pair[0], &pair[1]);
        let ids = [first.arbitration_id(), second.arbitration_id()];
        (ids == [1, 2] && first.payload()[0] == 0x0B)
            .then(|| [first.payload(), second.payload()].concat())
    });
    let wrench = |bytes: Vec<u8>| {
        let axis = |axis: usize| {
            let count = i16::from_be_bytes([bytes[1 + 2 * axis], bytes[2 + 2 * axis]]);
            f64::from(count)
                / if axis < 3 {
                    per_newton
                } else {
                    per_newton_metre
                }
        };
        [0, 1, 2, 3, 4, 5].map(axis)
    };
    pairs.map(wrench).collect()
}

/// Asserts that from the first sample heard to the last one nothing is missing that is not counted, and nothing was made up.
fn is_all_that_was_sent(heard: &Heard, sent: &[[f64; 6]]) {
    let samples: Vec<_> = heard
        .wrenches()
        .map(|reading| reading.wrench.to_array())
        .collect();
    // Samples may be alike: the first one heard is any of those that are.
    let begins = (0..sent.len()).filter(|begin| sent[*begin] == samples[0]);
    let missing = begins.filter_map(|begin| missing(&samples, &sent[begin..]));
    let missing = missing.min();
    let missing = missing.expect("all that was heard was sent, and in this order");
    let counts = heard.counts;
    let told = counts.refused + counts.skipped + counts.overflows;
    assert!(
        missing as u64 <= told,
        "{missing} samples are missing: {counts:?}"
    );
}

/// How many of `sent` are missing between the samples heard; `None` when those are not all among them in this order.
fn missing(samples: &[[f64; 6]], sent: &[[f64; 6]]) -> Option<usize> {
    let mut left = sent.iter();
    samples
        .iter()
        .map(|sample| left.by_ref().position(|sent| sent == sample))
        .sum()
}

/// Frames for which the queue of a reader that does not read has no room.
fn can_frames_without_room_are_counted() {
    // Or the kernel drops frames before that queue when it is slow, which it counts elsewhere.
    set_kernel("netdev_max_backlog", "10000");
    let (mut link, clock) = link();
    let socket = CanSocket::open(bus()).unwrap();
    let id = StandardId::new(0x123).unwrap();
    let frame = socketcan::CanFrame::new(id, &[7; 8]).unwrap();
    let sent = (0..3_000).filter(|_| socket.write_frame(&frame).is_ok());
    let sent = sent.count() as u64;
    let mut came = 0;
    while let Some(_frame) = link.recv(clock.now() + Duration::from_millis(100)).unwrap() {
        came += 1;
    }
    let notice = link.take_notice().unwrap();
    assert!(notice.contains("no room in the kernel's queue"), "{notice}");
    assert_eq!(came + link.overflows(), sent, "{came} came");
    assert!(link.overflows() > 100, "{}", link.overflows());
    // Told once, counted on.
    assert_eq!(link.take_notice(), None);
}

/// Writes an error frame of these classes, as a controller's driver would.
pub(crate) fn complain(classes: u32) {
    const ERROR: u32 = 0x2000_0000;
    let mut raw = can_frame_default();
    raw.can_id = ERROR | classes;
    raw.can_dlc = 8;
    let frame = CanErrorFrame::try_from(raw).unwrap();
    CanSocket::open(bus()).unwrap().write_frame(&frame).unwrap();
}

fn link() -> (SocketCanLink, MonotonicClock) {
    let clock = MonotonicClock::anchored_now();
    (SocketCanLink::open(bus(), &[], clock).unwrap(), clock)
}

fn can_error_frames_are_counted_by_class() {
    let (mut link, clock) = link();
    // Not acknowledged, a protocol error, restarted after bus-off.
    for classes in [0x20, 0x08, 0x100] {
        complain(classes);
    }
    let came = link.recv(clock.now() + Duration::from_millis(300)).unwrap();
    assert!(came.is_none(), "an error frame is no data: {came:?}");
    let counted = CanErrors {
        frames: 3,
        no_acknowledge: 1,
        restarted: 1,
    };
    assert_eq!(link.errors(), counted);
    let notice = link.take_notice().unwrap();
    assert!(notice.contains("3 error frames"), "{notice}");
}

fn can_bus_off_ends_the_link() {
    let (mut link, clock) = link();
    complain(0x40);
    let ended = link.recv(clock.now() + Duration::from_millis(300));
    assert!(matches!(ended, Err(LinkError::BusOff { .. })), "{ended:?}");
    // Opened again it works.
    let played = played("robotous_can", 200.0);
    hear(played.device("ft_sensor"), 20).unwrap();
}

fn can_interface_that_is_down_says_so() {
    let (mut link, clock) = link();
    run("ip link set vcan0 down");
    let ended = link.recv(clock.now() + Duration::from_millis(300));
    assert!(matches!(ended, Err(LinkError::Down { .. })), "{ended:?}");
    drop(link);
    let again = SocketCanLink::open("vcan0", &[1], clock);
    assert!(matches!(again, Err(LinkError::Down { .. })), "{again:?}");
}

/// A queue that is never emptied is what a controller without a partner looks like from above.
fn can_nobody_acknowledges() {
    load("sch_netem");
    let (mut link, _) = link();
    run("tc qdisc add dev vcan0 root netem delay 100s limit 1");
    let frame = CanFrame::standard(0x64, &[0x0C; 8]).unwrap();
    let refused = (0..4).find_map(|_| link.send(&frame).err());
    run("tc qdisc del dev vcan0 root");
    assert!(
        matches!(refused, Some(LinkError::NoAcknowledge { .. })),
        "{refused:?}"
    );
}

/// A script that knows the makers' tables and nothing of this project, with python-can.
fn can_sensors_read_by_a_strangers_program() {
    let python = std::env::var("FT_LAB_PYTHON").unwrap();
    if python.is_empty() {
        // The host has said why.
        return;
    }
    let script = format!(
        "{}/tests/peers/read_can.py",
        std::env::var("FT_LAB_ROOT").unwrap()
    );
    for (driver, rate_hz) in [
        ("robotous_can", 200.0),
        ("optoforce_can", 333.0),
        ("ati_netcanoem", 100.0),
    ] {
        let played = played(driver, rate_hz);
        let output = Command::new("timeout")
            .args(["90", &python, &script, driver, bus(), "150"])
            .output()
            .unwrap();
        let complaint = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.success(), "{driver}: {complaint}");
        let read: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
        let samples: Vec<[f64; 6]> = serde_json::from_value(read["samples"].clone()).unwrap();
        played.is_the_tools_weight(samples.into_iter());
    }
}
