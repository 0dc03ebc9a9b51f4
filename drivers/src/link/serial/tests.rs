use std::fs::File;
use std::os::fd::OwnedFd;
use std::path::PathBuf;

use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};

use super::*;

/// The far end of a pty, and the path of the near one.
fn pty() -> (File, PathBuf) {
    let far: OwnedFd = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY).unwrap();
    grantpt(&far).unwrap();
    unlockpt(&far).unwrap();
    let path = ptsname(&far, Vec::new()).unwrap().into_string().unwrap();
    (File::from(far), PathBuf::from(path))
}

fn in_ms(clock: &MonotonicClock, ms: u64) -> HostTime {
    clock.now() + Duration::from_millis(ms)
}

#[test]
fn bytes_go_both_ways_on_a_pty_at_any_bit_rate() {
    let clock = MonotonicClock::anchored_now();
    for baud in [57_600, 460_800, 1_234_567] {
        let (mut far, path) = pty();
        let mut link = SerialLink::open(&path, baud, clock).unwrap();
        far.write_all(&[0xAA, 1, 2]).unwrap();
        let (chunk, stamps) = link.recv(in_ms(&clock, 1_000)).unwrap().unwrap();
        assert_eq!(chunk.as_slice(), [0xAA, 1, 2]);
        assert!(stamps.arrival <= clock.now());
        link.send(&Chunk::new(b"C\r\x03").unwrap()).unwrap();
        let mut got = [0; 3];
        far.read_exact(&mut got).unwrap();
        assert_eq!(&got, b"C\r\x03");
        assert_eq!(link.latency_timer_ms(), None);
    }
}

#[test]
fn a_converter_that_collects_bytes_is_warned_about_once() {
    let (_far, path) = pty();
    let mut link = SerialLink::open(&path, 115_200, MonotonicClock::anchored_now()).unwrap();
    link.latency_timer_ms = Some(16);
    let told = link.take_notice().unwrap();
    assert!(
        told.contains("latency timer is 16 ms") && told.contains("udev/"),
        "{told}"
    );
    assert_eq!(link.take_notice(), None);
    // The least that there is needs no word.
    let (_far, path) = pty();
    let mut quick = SerialLink::open(&path, 115_200, MonotonicClock::anchored_now()).unwrap();
    quick.latency_timer_ms = Some(1);
    assert_eq!(quick.take_notice(), None);
}

#[test]
fn silence_ends_at_the_deadline() {
    let clock = MonotonicClock::anchored_now();
    let (_far, path) = pty();
    let mut link = SerialLink::open(&path, 115_200, clock).unwrap();
    let deadline = in_ms(&clock, 20);
    assert_eq!(link.recv(deadline).unwrap(), None);
    assert!(clock.now() >= deadline);
    // A deadline that has passed is a look without a wait.
    assert_eq!(link.recv(HostTime::EPOCH).unwrap(), None);
}

#[test]
fn a_far_end_that_closes_is_gone() {
    let clock = MonotonicClock::anchored_now();
    let (far, path) = pty();
    let mut link = SerialLink::open(&path, 115_200, clock).unwrap();
    drop(far);
    assert!(matches!(
        link.recv(in_ms(&clock, 100)),
        Err(LinkError::Gone { .. })
    ));
}

#[test]
fn a_port_that_we_hold_is_busy_for_others() {
    let clock = MonotonicClock::anchored_now();
    let (_far, path) = pty();
    let _held = SerialLink::open(&path, 115_200, clock).unwrap();
    let second = SerialLink::open(&path, 115_200, clock);
    assert!(matches!(second, Err(LinkError::Busy { .. })), "{second:?}");
}

#[test]
fn what_cannot_be_opened_says_why() {
    let clock = MonotonicClock::anchored_now();
    let missing = SerialLink::open(Path::new("/dev/ttyUSB-none"), 115_200, clock).unwrap_err();
    assert!(
        missing
            .to_string()
            .contains("/dev/ttyUSB-none does not exist"),
        "{missing}"
    );
    let no_tty = SerialLink::open(Path::new("/dev/null"), 115_200, clock);
    assert!(
        matches!(no_tty, Err(LinkError::Io { call: "open", .. })),
        "{no_tty:?}"
    );
    let denied = open_error(
        "p",
        serialport::Error::new(ErrorKind::Io(io::ErrorKind::PermissionDenied), ""),
    );
    assert!(matches!(denied, LinkError::Denied { .. }));
}
