//! The simulation in real time: what another program finds on the ports.
#![allow(clippy::unwrap_used)]

use std::fs::File;
use std::io::{Read, Write};
use std::path::PathBuf;
use std::time::Duration;

use ft_drivers::{Clock, Link, LinkError, MonotonicClock};
use ft_sim_hw::{Port, Scenario, ServeError, ServeOptions, Server};
use ft_wire::CanFrame;
use rustix::fs::OFlags;
use rustix::termios::{self, OptionalActions};

fn server(name: &str, clock: MonotonicClock) -> Server {
    let scenario = Scenario::builtin(name).unwrap();
    Server::start(
        &scenario,
        1,
        Some(Duration::from_secs(30)),
        clock,
        ServeOptions::default(),
    )
    .unwrap()
}

fn pty(server: &Server, name: &str) -> PathBuf {
    let served = server
        .ports()
        .into_iter()
        .find(|served| served.fitted.name == name)
        .unwrap();
    match served.port {
        Port::Pty(path) => path,
        other => panic!("{other:?}"),
    }
}

fn opened(path: &PathBuf) -> File {
    let flags = OFlags::RDWR | OFlags::NOCTTY | OFlags::NONBLOCK;
    File::from(rustix::fs::open(path, flags, rustix::fs::Mode::empty()).unwrap())
}

/// Reads for `seconds`.
fn heard(port: &mut File, clock: &MonotonicClock, seconds: f64) -> Vec<u8> {
    let end = clock.now().offset_by_seconds(seconds);
    let mut bytes = Vec::new();
    let mut buffer = [0; 4096];
    while clock.now() < end {
        match port.read(&mut buffer) {
            Ok(count) => bytes.extend_from_slice(&buffer[..count]),
            Err(error) => assert_eq!(error.kind(), std::io::ErrorKind::WouldBlock),
        }
        clock.wait_until(clock.now() + Duration::from_millis(5));
    }
    bytes
}

fn frames(bytes: &[u8]) -> usize {
    bytes
        .windows(75)
        .filter(|window| window[..4] == [0xA5, 0x5A, 1, 74] && window[74] == 0xA5)
        .count()
}

#[test]
fn a_pty_carries_the_stream_at_its_rate_and_can_be_opened_again() {
    let clock = MonotonicClock::anchored_now();
    let server = server("wood_door", clock);
    let path = pty(&server, "aria");
    for _ in 0..2 {
        let mut port = opened(&path);
        let _ = heard(&mut port, &clock, 0.1);
        let count = frames(&heard(&mut port, &clock, 1.0));
        // Wide, because a busy machine may keep this reader waiting.
        assert!((600..1400).contains(&count), "{count} frames in a second");
        drop(port);
        clock.wait_until(clock.now() + Duration::from_millis(300));
    }
    let lost = server.stop();
    assert!(
        lost < 20_000,
        "the 44 kB while the port was closed are nobody's loss: {lost}"
    );
}

#[test]
fn a_device_on_a_pty_hears_and_answers() {
    let clock = MonotonicClock::anchored_now();
    let server = server("wood_door", clock);
    let mut port = opened(&pty(&server, "gripper"));
    let ping = [0xFF, 0xFF, 0xFD, 0x00, 0x01, 0x03, 0x00, 0x01, 0x19, 0x4E];
    clock.wait_until(clock.now() + Duration::from_millis(20));
    port.write_all(&ping).unwrap();
    let answer = heard(&mut port, &clock, 0.2);
    assert_eq!(answer.len(), 14, "{answer:x?}");
    assert_eq!(
        answer[..9],
        [0xFF, 0xFF, 0xFD, 0x00, 0x01, 0x07, 0x00, 0x55, 0x00]
    );
}

#[test]
fn at_a_wrong_speed_there_is_only_garbage() {
    let clock = MonotonicClock::anchored_now();
    let server = server("wood_door", clock);
    let mut port = opened(&pty(&server, "aria"));
    let mut settings = termios::tcgetattr(&port).unwrap();
    assert_eq!(
        settings.output_speed(),
        2_000_000,
        "the speed it was made with"
    );
    settings.set_speed(115_200).unwrap();
    termios::tcsetattr(&port, OptionalActions::Now, &settings).unwrap();
    let _ = heard(&mut port, &clock, 0.1);
    let bytes = heard(&mut port, &clock, 0.4);
    assert!(bytes.len() > 1000 && frames(&bytes) == 0);
}

#[test]
fn a_reader_that_stalls_loses_bytes_and_they_are_counted() {
    let clock = MonotonicClock::anchored_now();
    let server = server("wood_door", clock);
    let port = opened(&pty(&server, "aria"));
    clock.wait_until(clock.now() + Duration::from_secs(1));
    let lost = server.stop();
    assert!(lost > 20_000, "74 kB/s into a few kB: {lost}");
    drop(port);
}

#[test]
fn can_without_an_interface_is_served_in_the_process_and_waits() {
    let clock = MonotonicClock::anchored_now();
    let server = server("metal_door", clock);
    let mut link = server.can_link("ft_sensor").unwrap();
    let began = clock.now();
    assert!(
        link.recv(began + Duration::from_millis(80))
            .unwrap()
            .is_none()
    );
    assert!(
        clock.now() >= began + Duration::from_millis(80),
        "it waits until the deadline"
    );
    link.send(&CanFrame::standard(0x64, &[0x0F, 8, 0, 0, 0, 0, 0, 0]).unwrap())
        .unwrap();
    let (answer, _) = link
        .recv(clock.now() + Duration::from_millis(500))
        .unwrap()
        .unwrap();
    assert_eq!(answer.payload()[..2], [0x0F, 1]);
    link.send(&CanFrame::standard(0x64, &[0x0B, 0, 0, 0, 0, 0, 0, 0]).unwrap())
        .unwrap();
    let end = clock.now() + Duration::from_secs(1);
    let mut count = 0;
    let mut last = began;
    while let Some((_, stamps)) = link.recv(end).unwrap() {
        assert!(stamps.arrival >= last && stamps.arrival <= clock.now());
        last = stamps.arrival;
        count += 1;
    }
    assert!((1500..=2100).contains(&count), "{count}");
    server.stop();
    assert!(matches!(
        link.recv(clock.now()),
        Err(LinkError::Gone { .. })
    ));
}

#[test]
fn a_can_interface_that_is_not_there_is_named_with_what_to_do() {
    let scenario = Scenario::builtin("metal_door").unwrap();
    let options = ServeOptions {
        vcan: Some("vcan_none".to_owned()),
        ..ServeOptions::default()
    };
    let error =
        Server::start(&scenario, 1, None, MonotonicClock::anchored_now(), options).unwrap_err();
    assert!(matches!(error, ServeError::Can { .. }));
    assert!(
        error.to_string().contains("vcan_none") && error.to_string().contains("ip link add"),
        "{error}"
    );
}

#[test]
fn marks_and_end_follow_the_clock() {
    let clock = MonotonicClock::anchored_now();
    let scenario = Scenario::builtin("drawer_light").unwrap();
    let duration = Some(Duration::from_secs(4));
    let mut server = Server::start(&scenario, 1, duration, clock, ServeOptions::default()).unwrap();
    let mut marks = Vec::new();
    while !server.is_over() {
        clock.wait_until(clock.now() + Duration::from_millis(20));
        marks.extend(server.drain_marks());
        assert!(marks.iter().all(|(at, _)| *at <= clock.now()));
    }
    let texts: Vec<&str> = marks.iter().map(|(_, text)| text.as_str()).collect();
    assert_eq!(texts, ["free_air_begin", "grasp", "release"]);
}
