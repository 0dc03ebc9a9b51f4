//! `cargo run -p ft-tests --bin soak -- [SECONDS] [SPEED] [SEED]`: Bota at 800 Hz, Robotous at 1 kHz, an encoder at 100 Hz and a
//! tracker at 1 kHz, SPEED times as fast, by pseudo-terminals before the service's own drivers and link threads, with bits
//! flipped, bytes lost, noise, frames sent twice, silences and unplugging. Fails unless memory is flat, no thread is stuck, and
//! every frame is accounted for. Default: 450 s at 4 times the rate, half an hour's frames.
//!
//! `cargo run -p ft-tests --bin soak -- eight [SECONDS]`: eight force-torque sensors at 1 kHz without a fault; not one sample may be
//! missing.

use std::process::ExitCode;
use std::time::Duration;

use ft_tests::soak::{Plan, run};

fn main() -> Result<ExitCode, Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let argument = |at: usize, default: f64| -> Result<f64, std::num::ParseFloatError> {
        arguments.get(at).map_or(Ok(default), |text| text.parse())
    };
    let plan = if arguments.first().is_some_and(|first| first == "eight") {
        Plan::eight(Duration::try_from_secs_f64(argument(1, 60.0)?)?)
    } else {
        let length = Duration::try_from_secs_f64(argument(0, 450.0)?)?;
        Plan::gripper(length, argument(1, 4.0)?, argument(2, 1.0)? as u64)
    };
    let report = run(&plan)?;
    println!("{report}");
    let faults = report.faults();
    for fault in &faults {
        println!("does not hold: {fault}");
    }
    Ok(if faults.is_empty() {
        ExitCode::SUCCESS
    } else {
        ExitCode::FAILURE
    })
}
