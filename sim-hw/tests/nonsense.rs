//! Devices that are told nonsense: they never panic, and they still do their work.
#![allow(clippy::unwrap_used)]

use std::time::Duration;

use ft_drivers::Link;
use ft_sim_hw::{Scenario, Simulation};
use ft_wire::{CanFrame, Chunk, HostTime};
use proptest::prelude::*;

const START: HostTime = HostTime::from_nanos(1_750_000_000_000_000_000);

/// Bytes that look like commands more often than chance would have it.
fn bytes() -> impl Strategy<Value = Vec<u8>> {
    let likely = prop::sample::select(
        b"CRIslwcfbm#,.0123456789-\x55\xAA\x0B\x0C\xFF\xFD\x00\x01\x02\x03\xFE".to_vec(),
    );
    prop::collection::vec(prop_oneof![3 => likely, 1 => any::<u8>()], 0..200)
}

fn simulation(name: &str) -> Simulation {
    Simulation::new(&Scenario::builtin(name).unwrap(), 1, START, None).unwrap()
}

/// Sends `messages` 20 ms apart.
fn tell<L: Link>(
    simulation: &mut Simulation,
    link: &mut L,
    messages: impl Iterator<Item = L::Frame>,
) -> HostTime {
    let mut now = START;
    for message in messages {
        now = now + Duration::from_millis(20);
        simulation.advance_to(now);
        link.send(&message).unwrap();
    }
    let now = now + Duration::from_millis(700);
    simulation.advance_to(now);
    while link.recv(now).unwrap().is_some() {}
    now
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    #[test]
    fn a_gripper_answers_a_ping_after_any_bytes(messages in prop::collection::vec(bytes(), 1..6)) {
        let mut simulation = simulation("wood_door");
        let mut link = simulation.serial_link("gripper").unwrap();
        let chunks = messages.iter().filter_map(|message| Chunk::new(message));
        let mut now = tell(&mut simulation, &mut link, chunks);
        // A header with a long length may swallow what follows; enough padding ends it.
        for _ in 0..2 {
            link.send(&Chunk::new(&[0; 256]).unwrap()).unwrap();
        }
        link.send(&Chunk::new(&[0xFF, 0xFF, 0xFD, 0x00, 0x01, 0x03, 0x00, 0x01, 0x19, 0x4E]).unwrap()).unwrap();
        now = now + Duration::from_millis(300);
        simulation.advance_to(now);
        let mut heard = Vec::new();
        while let Some((chunk, _)) = link.recv(now).unwrap() {
            heard.extend_from_slice(chunk.as_slice());
        }
        prop_assert!(heard.windows(9).any(|window| window == [0xFF, 0xFF, 0xFD, 0x00, 0x01, 0x07, 0x00, 0x55, 0x00]));
    }

    #[test]
    fn a_bota_resets_after_any_bytes(messages in prop::collection::vec(bytes(), 1..6)) {
        let mut simulation = simulation("wood_door");
        let mut link = simulation.serial_link("ft_sensor").unwrap();
        let chunks = messages.iter().filter_map(|message| Chunk::new(message));
        let mut now = tell(&mut simulation, &mut link, chunks);
        link.send(&Chunk::new(b"#").unwrap()).unwrap();
        now = now + Duration::from_secs(1);
        simulation.advance_to(now);
        let mut heard = Vec::new();
        while let Some((chunk, _)) = link.recv(now).unwrap() {
            heard.extend_from_slice(chunk.as_slice());
        }
        prop_assert!(heard.windows(8).any(|window| window == b"App Init"));
    }

    #[test]
    fn a_robotous_on_uart_stops_and_answers_after_any_bytes(messages in prop::collection::vec(bytes(), 1..6)) {
        let mut simulation = simulation("drawer_light");
        let mut link = simulation.serial_link("ft_sensor").unwrap();
        let chunks = messages.iter().filter_map(|message| Chunk::new(message));
        let mut now = tell(&mut simulation, &mut link, chunks);
        let stop = [0x55, 0x0C, 0, 0, 0, 0, 0, 0, 0, 0x0C, 0xAA];
        let ask = [0x55, 0x10, 0, 0, 0, 0, 0, 0, 0, 0x10, 0xAA];
        for command in [[0; 11], stop, ask] {
            link.send(&Chunk::new(&command).unwrap()).unwrap();
        }
        now = now + Duration::from_millis(200);
        simulation.advance_to(now);
        let mut heard = Vec::new();
        while let Some((chunk, _)) = link.recv(now).unwrap() {
            heard.extend_from_slice(chunk.as_slice());
        }
        prop_assert!(heard.windows(2).any(|window| window == [0x55, 0x10]));
    }

    #[test]
    fn a_robotous_on_can_stops_and_answers_after_any_frames(
        messages in prop::collection::vec((prop_oneof![Just(0x64_u16), 0..0x7FF_u16], prop::collection::vec(any::<u8>(), 0..=8)), 1..40),
    ) {
        let mut simulation = simulation("metal_door");
        let mut link = simulation.can_link("ft_sensor").unwrap();
        let frames = messages.iter().filter_map(|(id, payload)| CanFrame::standard(*id, payload));
        let mut now = tell(&mut simulation, &mut link, frames);
        for code in [0x0C, 0x10] {
            link.send(&CanFrame::standard(0x64, &[code, 0, 0, 0, 0, 0, 0, 0]).unwrap()).unwrap();
        }
        now = now + Duration::from_millis(50);
        simulation.advance_to(now);
        let mut answered = false;
        while let Some((frame, _)) = link.recv(now).unwrap() {
            answered |= frame.arbitration_id() == 1 && frame.payload()[0] == 0x10;
        }
        prop_assert!(answered);
    }
}
