use super::*;
use std::io::Write as _;

fn os_error(errno: Errno) -> io::Error {
    errno.into()
}

#[test]
fn each_error_of_the_system_gets_its_advice() {
    let text = |call, errno| link_error("can0", call, os_error(errno)).to_string();
    assert_eq!(
        text("write", Errno::NOBUFS),
        "nobody acknowledges on can0: check bit rate, termination, power"
    );
    assert!(text("read", Errno::NETDOWN).contains("ip link set can0 up"));
    assert!(text("read", Errno::NODEV).contains("gone"));
    assert!(text("open", Errno::NODEV).contains("does not exist"));
    assert!(text("open", Errno::PERM).contains("may not be opened"));
    assert_eq!(text("open", Errno::AFNOSUPPORT), "open on can0 failed");
}

#[test]
fn an_interface_that_is_not_there_is_an_error_and_no_panic() {
    let missing = SocketCanLink::open("can-none", &[1, 2], MonotonicClock::anchored_now());
    assert!(
        matches!(
            missing,
            Err(LinkError::NotFound { .. } | LinkError::Io { .. })
        ),
        "{missing:?}"
    );
}

#[test]
fn frames_go_to_the_kernel_and_back() {
    for frame in [
        CanFrame::standard(0x64, &[0x0B, 0, 0]),
        CanFrame::extended(0x1234_5678, &[]),
    ] {
        let frame = frame.unwrap();
        assert_eq!(from_kernel(&to_kernel(&frame).unwrap()), Some(frame));
    }
}

/// Needs a virtual interface: `ip link add vcan0 type vcan && ip link set vcan0 up`.
#[test]
fn frames_cross_a_virtual_bus_with_the_kernels_stamps() {
    let clock = MonotonicClock::anchored_now();
    let open = |ids: &[u16]| SocketCanLink::open("vcan0", ids, clock);
    let (Ok(mut sender), Ok(mut receiver)) = (open(&[]), open(&[0x01])) else {
        let _ = writeln!(std::io::stderr(), "skipped: no interface vcan0");
        return;
    };
    let before = clock.now();
    let [unwanted, wanted] = [2, 1].map(|id| CanFrame::standard(id, &[7; 8]).unwrap());
    for frame in [unwanted, wanted] {
        sender.send(&frame).unwrap();
    }
    let (frame, stamps) = receiver
        .recv(before + Duration::from_secs(1))
        .unwrap()
        .unwrap();
    assert_eq!(frame, wanted);
    assert!(before <= stamps.arrival && stamps.arrival <= clock.now());
    assert_eq!(
        receiver
            .recv(clock.now() + Duration::from_millis(5))
            .unwrap(),
        None
    );
}
