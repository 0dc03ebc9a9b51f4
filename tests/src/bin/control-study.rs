//! What a controller gains by the twin: `cargo run --release -p ft-tests --bin control-study -- --help`.

use clap::Parser;
use ft_tests::control::{Attempt, attempts, markdown, tasks};

/// An impedance controller opens five simulated objects with two arms, its feed-forward from the identified twin, from a guess, or none.
///
/// All figures are simulated but the row that says "published". The arms and what is assumed of them: `tests/src/control/robots.rs`.
#[derive(Parser)]
#[command(after_help = "Example:\n  control-study 3 501")]
struct Arguments {
    /// Recordings of each object
    #[arg(default_value_t = 5, value_parser = clap::value_parser!(u64).range(1..))]
    seeds: u64,
    /// Seed of the first
    #[arg(default_value_t = 1)]
    first_seed: u64,
}

fn main() {
    let Arguments {
        seeds,
        first_seed: first,
    } = Arguments::parse();
    let file = std::env::temp_dir().join(format!("control-study-{}.mcap", std::process::id()));
    let mut all: Vec<Attempt> = Vec::new();
    for task in tasks() {
        for seed in first..first + seeds {
            all.extend(attempts(&task, seed, &file));
            eprintln!("{} {seed} done", task.scenario.name);
        }
    }
    let _ = std::fs::remove_file(&file);
    println!("{seeds} seeds from {first}.");
    print!("{}", markdown(&all));
}
