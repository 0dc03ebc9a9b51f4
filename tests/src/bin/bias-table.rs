//! `cargo run --release -p ft-tests --bin bias-table -- [SEEDS] [FIRST_SEED] [WORD]`: what a late wrench, an unknown mass, a long smoother
//! and a noisy tracker do to the inertia, by the paper's estimator and by ours; WORD picks the trials that have it in their name. All
//! figures are simulated.

use ft_tests::bias::{markdown, trials};
use ft_tests::truth::{each_of, study_of};

fn main() {
    let numbers: Vec<u64> = std::env::args()
        .skip(1)
        .filter_map(|text| text.parse().ok())
        .collect();
    let seeds = numbers.first().copied().unwrap_or(8);
    let first = numbers.get(1).copied().unwrap_or(101);
    let word = std::env::args().nth(3).unwrap_or_default();
    let mut trials = trials();
    trials.retain(|trial| trial.scenario.name.contains(&word));
    let results = study_of(&each_of(trials, first..first + seeds), |one| {
        eprintln!("{} {}: {:?}", one.scenario, one.seed, one.relative[0]);
    });
    print!("{}", markdown(&results));
}
