//! What good stamps are worth: `cargo run --release -p ft-tests --bin stamps-table -- --help`.

use clap::Parser;
use ft_sim_hw::Scenario;
use ft_tests::stamps::{Errors, StampEffect, Treatment, effect};

/// Inertia and friction by the quality of stamps and of the tool's mass, as Markdown.
///
/// All figures are simulated.
#[derive(Parser)]
#[command(after_help = "Example:\n  stamps-table 3 501 wood_door")]
struct Arguments {
    /// Recordings of each scenario
    #[arg(default_value_t = 3, value_parser = clap::value_parser!(u64).range(1..))]
    seeds: u64,
    /// Seed of the first
    #[arg(default_value_t = 1)]
    first_seed: u64,
    /// Built-in scenarios, or files of others
    #[arg(value_name = "SCENARIO", default_values = ["sliding_door", "drawer_light", "wood_door"], value_parser = Scenario::load)]
    scenarios: Vec<Scenario>,
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let Arguments {
        seeds,
        first_seed: first,
        scenarios,
    } = Arguments::parse();
    let folder = tempfile::tempdir()?;
    println!(
        "Simulated; mean and largest error over seeds {first} to {}.\n",
        first + seeds - 1
    );
    println!(
        "| object | stamps and tool | I % | mu % | b % | I % (plain least squares) | mu % | b % |"
    );
    println!("|---|---|---|---|---|---|---|---|");
    for scenario in &scenarios {
        let name = &scenario.name;
        let mut found: Vec<StampEffect> = Vec::new();
        for seed in first..first + seeds {
            let one = effect(scenario, seed, folder.path())?;
            eprintln!(
                "{name} seed {seed}: poses aligned by {:+.3} ms, mass {:.4} kg (true {:.4})",
                one.offset_ms, one.mass_kg[1], one.mass_kg[0]
            );
            found.push(one);
        }
        for (k, treatment) in Treatment::ALL.into_iter().enumerate() {
            let of = |pick: fn(&Errors) -> [Option<f64>; 3]| {
                let cells = (0..3).map(|j| cell(found.iter().map(|one| pick(&one.errors[k])[j])));
                cells.collect::<Vec<_>>().join(" | ")
            };
            println!(
                "| {name} | {} | {} | {} |",
                treatment.name(),
                of(|errors| errors.ours),
                of(|errors| errors.plain)
            );
        }
    }
    Ok(())
}

/// Mean and largest of the errors, and how many recordings gave none.
fn cell(errors: impl Iterator<Item = Option<f64>>) -> String {
    let (mut found, mut missing) = (Vec::new(), 0);
    for error in errors {
        match error {
            Some(error) => found.push(100.0 * error),
            None => missing += 1,
        }
    }
    let largest = found
        .iter()
        .copied()
        .max_by(|a, b| a.abs().total_cmp(&b.abs()));
    let none = if missing > 0 {
        format!(" ({missing} null)")
    } else {
        String::new()
    };
    match largest {
        Some(largest) => {
            let mean = found.iter().sum::<f64>() / found.len() as f64;
            format!("{mean:+.2} ({largest:+.2}){none}")
        }
        None => "null".to_owned(),
    }
}
