//! The bytes of the built-in scenarios stay what they are.
#![allow(clippy::unwrap_used)]
// Sine and exponential come from the C library, which may round its last bit otherwise elsewhere.
#![cfg(all(target_arch = "x86_64", target_os = "linux", target_env = "gnu"))]

use std::time::Duration;

use ft_drivers::Link;
use ft_sim_hw::{Scenario, Simulation};
use ft_wire::HostTime;

const START: HostTime = HostTime::from_nanos(1_750_000_000_000_000_000);

/// FNV-1a over the bytes and arrivals of sensor and tracker, over a whole run.
fn digest(name: &str, seed: u64) -> u64 {
    let scenario = Scenario::builtin(name).unwrap();
    let mut simulation = Simulation::new(&scenario, seed, START, None).unwrap();
    let mut hash = 0xcbf2_9ce4_8422_2325_u64;
    let mut take = |bytes: &[u8]| {
        for byte in bytes {
            hash = (hash ^ u64::from(*byte)).wrapping_mul(0x0100_0000_01b3);
        }
    };
    let mut links: Vec<_> = ["ft_sensor", "aria"]
        .into_iter()
        .filter_map(|name| simulation.serial_link(name))
        .collect();
    let mut now = START;
    while !simulation.is_over() {
        now = now + Duration::from_millis(10);
        simulation.advance_to(now);
        for link in &mut links {
            while let Some((chunk, stamps)) = link.recv(now).unwrap() {
                take(chunk.as_slice());
                take(&stamps.arrival.as_nanos().to_le_bytes());
            }
        }
    }
    hash
}

#[test]
fn a_scenario_without_undeclared_effects_gives_the_bytes_that_it_always_gave() {
    assert_eq!(
        digest("wood_door", 1),
        16_535_524_483_191_840_672,
        "wood_door"
    );
    assert_eq!(
        digest("oven_door", 1),
        3_979_882_919_761_590_655,
        "oven_door"
    );
}
