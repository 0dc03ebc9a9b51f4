//! The two forms of the mechanism side by side: `cargo run --release -p ft-tests --bin mechanism-table -- --help`.

use clap::Parser;
use ft_tests::mechanisms::{forms_of, markdown};
use ft_tests::study::picked;

/// The mechanism as splines and as the paper's network on the study's objects: error on left-out strokes and time.
///
/// All figures are simulated.
#[derive(Parser)]
#[command(after_help = "Example:\n  mechanism-table 3 501 wood_door")]
struct Arguments {
    /// Recordings of each object
    #[arg(default_value_t = 1, value_parser = clap::value_parser!(u64).range(1..))]
    seeds: u64,
    /// Seed of the first
    #[arg(default_value_t = 101)]
    first_seed: u64,
    /// Objects of the study; all when none is given
    #[arg(value_name = "OBJECT")]
    objects: Vec<String>,
}

fn main() -> std::io::Result<()> {
    let Arguments {
        seeds,
        first_seed: first,
        objects,
    } = Arguments::parse();
    let objects = picked(&objects).unwrap_or_else(|reason| {
        eprintln!("{reason}");
        std::process::exit(2);
    });
    let folder = tempfile::tempdir()?;
    let file = folder.path().join("recording.mcap");
    let mut results = Vec::new();
    for object in objects {
        for seed in first..first + seeds {
            eprintln!("{} {seed}", object.name);
            results.push(forms_of(&object, seed, &file));
        }
    }
    print!("{}", markdown(&results));
    Ok(())
}
