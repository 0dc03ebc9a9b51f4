//! `cargo run --release -p ft-tests --bin control-study -- [SEEDS] [FIRST]`: an impedance controller opens five simulated objects with
//! two arms, its feed-forward from the identified twin, from a guess, or none. All figures are simulated but the row that says
//! "published". The arms and what is assumed of them: `tests/src/control/robots.rs`.

use ft_tests::control::{Attempt, attempts, markdown, tasks};

fn main() {
    let mut numbers = std::env::args()
        .skip(1)
        .map(|text| text.parse::<u64>().ok());
    let seeds = numbers.next().flatten().unwrap_or(5);
    let first = numbers.next().flatten().unwrap_or(1);
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
