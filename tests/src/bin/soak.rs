//! Half an hour of frames with faults: `cargo run --release -p ft-tests --bin soak -- --help`.

use std::process::ExitCode;
use std::time::Duration;

use clap::{Parser, Subcommand};
use ft_tests::arguments::positive;
use ft_tests::soak::{Plan, run};

/// Bota at 800 Hz, Robotous at 1 kHz, an encoder at 100 Hz and a tracker at 1 kHz, played to the service's own drivers and link threads.
///
/// They come by pseudo-terminals, SPEED times as fast, with bits flipped, bytes lost, noise, frames sent twice, silences and unplugging. Fails
/// unless memory is flat, no thread is stuck, and every frame is accounted for.
#[derive(Parser)]
#[command(
    args_conflicts_with_subcommands = true,
    after_help = "Examples:\n  soak 60 4 7\n  soak eight 60"
)]
struct Arguments {
    /// Length, s; by default half an hour's frames at the default speed
    #[arg(default_value_t = 450.0, value_parser = positive)]
    seconds: f64,
    /// Times as fast as the devices
    #[arg(default_value_t = 4.0, value_parser = positive)]
    speed: f64,
    /// Seed of the faults
    #[arg(default_value_t = 1)]
    seed: u64,
    #[command(subcommand)]
    other: Option<Other>,
}

#[derive(Subcommand)]
enum Other {
    /// Eight force-torque sensors at 1 kHz without a fault; not one sample may be missing
    Eight {
        /// Length, s
        #[arg(default_value_t = 60.0, value_parser = positive)]
        seconds: f64,
    },
}

fn main() -> Result<ExitCode, Box<dyn std::error::Error>> {
    let arguments = Arguments::parse();
    let plan = if let Some(Other::Eight { seconds }) = arguments.other {
        Plan::eight(Duration::try_from_secs_f64(seconds)?)
    } else {
        let length = Duration::try_from_secs_f64(arguments.seconds)?;
        Plan::gripper(length, arguments.speed, arguments.seed)
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
