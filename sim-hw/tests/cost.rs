//! What the simulation costs: stepped as fast as it goes, and beside real time.
#![allow(clippy::unwrap_used)]

use std::time::Duration;

use ft_drivers::Link;
use ft_drivers::{Clock, MonotonicClock};
use ft_sim_hw::{Scenario, ServeOptions, Server, Simulation};
use ft_wire::HostTime;

/// CPU seconds that this process has used, from `/proc`.
fn cpu_seconds() -> f64 {
    let stat = std::fs::read_to_string("/proc/self/stat").unwrap();
    let after_name = stat.rsplit(')').next().unwrap();
    let ticks: Vec<f64> = after_name
        .split_whitespace()
        .skip(11)
        .take(2)
        .map(|field| field.parse().unwrap())
        .collect();
    (ticks[0] + ticks[1]) / 100.0
}

// One test, so that the process does nothing else while it is measured.
#[test]
fn a_whole_run_takes_seconds_and_real_time_takes_a_fraction_of_a_core() {
    let scenario = Scenario::builtin("wood_door").unwrap();
    let start = HostTime::from_nanos(1_750_000_000_000_000_000);
    let before = cpu_seconds();
    let mut simulation = Simulation::new(&scenario, 1, start, None).unwrap();
    let mut links =
        ["ft_sensor", "aria", "gripper"].map(|name| simulation.serial_link(name).unwrap());
    let (mut now, mut chunks) = (start, 0);
    while !simulation.is_over() {
        now = now + Duration::from_millis(5);
        simulation.advance_to(now);
        for link in &mut links {
            while link.recv(now).unwrap().is_some() {
                chunks += 1;
            }
        }
    }
    let stepped = cpu_seconds() - before;
    println!("71 s stepped: {stepped:.2} s of CPU, {chunks} chunks");
    assert!(stepped < 10.0, "{stepped} s");

    let clock = MonotonicClock::anchored_now();
    let server = Server::start(&scenario, 1, None, clock, ServeOptions::default()).unwrap();
    let before = cpu_seconds();
    clock.wait_until(clock.now() + Duration::from_secs(4));
    let share = (cpu_seconds() - before) / 4.0;
    println!("served in real time: {:.1} % of a core", 100.0 * share);
    assert!(share < 0.25, "{share}");
    server.stop();
}
