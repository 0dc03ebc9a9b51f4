//! What the measurement does to the inertia: `cargo run --release -p ft-tests --bin bias-table -- --help`.

use clap::Parser;
use ft_tests::bias::{markdown, trials};
use ft_tests::truth::{each_of, study_of};

/// What a late wrench, an unknown mass, a long smoother and a noisy tracker do to the inertia, by the paper's estimator and by ours.
///
/// All figures are simulated.
#[derive(Parser)]
#[command(after_help = "Example:\n  bias-table 8 501 late")]
struct Arguments {
    /// Recordings of each trial
    #[arg(default_value_t = 8, value_parser = clap::value_parser!(u64).range(1..))]
    seeds: u64,
    /// Seed of the first
    #[arg(default_value_t = 101)]
    first_seed: u64,
    /// Only trials that have it in their name
    #[arg(default_value = "", hide_default_value = true)]
    word: String,
}

fn main() {
    let Arguments {
        seeds,
        first_seed: first,
        word,
    } = Arguments::parse();
    let mut trials = trials();
    let known: Vec<String> = trials.iter().map(|t| t.scenario.name.clone()).collect();
    trials.retain(|trial| trial.scenario.name.contains(&word));
    if trials.is_empty() {
        eprintln!(
            "no trial with {word:?} in its name among {}",
            known.join(", ")
        );
        std::process::exit(2);
    }
    let results = study_of(&each_of(trials, first..first + seeds), |one| {
        eprintln!("{} {}: {:?}", one.scenario, one.seed, one.relative[0]);
    });
    print!("{}", markdown(&results));
}
