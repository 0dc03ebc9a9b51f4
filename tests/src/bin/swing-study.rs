//! Swing times of doors and of their twins: `cargo run --release -p ft-tests --bin swing-study -- --help`.

use clap::Parser;
use ft_tests::swing::{Closing, DOORS, closings};

/// Swing times of the built-in doors, let go at two angles each, against their identified twins and a guess.
///
/// All figures are simulated; the paper's, measured on its own doors, stand below in their own table.
#[derive(Parser)]
#[command(after_help = "Example:\n  swing-study 3 501")]
struct Arguments {
    /// Recordings of each door
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
    let file = std::env::temp_dir().join(format!("swing-study-{}.mcap", std::process::id()));
    let mut all: Vec<Closing> = Vec::new();
    for (door, angles) in DOORS {
        for seed in first..first + seeds {
            all.extend(closings(door, seed, &angles, &file));
            eprintln!("{door} {seed} done");
        }
    }
    let _ = std::fs::remove_file(&file);
    println!(
        "Simulated, {seeds} seeds from {first}; times are means, errors mean absolute relative ones.\n"
    );
    println!(
        "| door | from deg | door s | twin s | twin error % | guess s | guess error % |\n|---|---|---|---|---|---|---|"
    );
    let (mut twin_errors, mut prior_errors) = (Vec::new(), Vec::new());
    for (door, angles) in DOORS {
        for from in angles {
            let of: Vec<&Closing> = all
                .iter()
                .filter(|c| c.scenario == door && c.from_deg == from)
                .collect();
            let (twin, prior) = (errors(&of, |c| c.twin), errors(&of, |c| c.prior));
            println!(
                "| {door} | {from} | {} | {} | {} | {} | {} |",
                text(mean(of.iter().map(|c| c.truth)), 1.0),
                text(mean(of.iter().map(|c| c.twin)), 1.0),
                text(twin, 100.0),
                text(mean(of.iter().map(|c| c.prior)), 1.0),
                text(prior, 100.0),
            );
            twin_errors.push(twin);
            prior_errors.push(prior);
        }
    }
    println!(
        "| macro mean | | | | {} | | {} |",
        text(mean(twin_errors.into_iter()), 100.0),
        text(mean(prior_errors.into_iter()), 100.0)
    );
    println!(
        "\nPublished, measured on real doors (ForceTwin, table on free swing): twin 16.3 %, visual-language prior 57.7 %."
    );
}

fn errors(of: &[&Closing], time: impl Fn(&Closing) -> Option<f64>) -> Option<f64> {
    mean(of.iter().map(|c| c.error(time(c))))
}

/// The mean; nothing when one is missing.
fn mean(values: impl Iterator<Item = Option<f64>>) -> Option<f64> {
    let values: Option<Vec<f64>> = values.collect();
    let values = values.filter(|values| !values.is_empty())?;
    Some(values.iter().sum::<f64>() / values.len() as f64)
}

fn text(value: Option<f64>, scale: f64) -> String {
    value.map_or("stays".to_owned(), |value| format!("{:.2}", scale * value))
}
