//! `cargo run --release -p ft-tests --bin mechanism-table -- [SEEDS] [FIRST_SEED] [OBJECT]...`: the mechanism as splines and as the paper's
//! network on the study's objects: error on left-out strokes and time. All figures are simulated.

use ft_tests::mechanisms::{forms_of, markdown};
use ft_tests::study::objects;

fn main() -> std::io::Result<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let (numbers, names): (Vec<&String>, Vec<&String>) = arguments
        .iter()
        .partition(|text| text.parse::<u64>().is_ok());
    let number = |k: usize, default: u64| {
        numbers
            .get(k)
            .and_then(|n| n.parse().ok())
            .unwrap_or(default)
    };
    let (seeds, first) = (number(0, 1), number(1, 101));
    let folder = tempfile::tempdir()?;
    let file = folder.path().join("recording.mcap");
    let mut results = Vec::new();
    for object in objects() {
        if !names.is_empty() && !names.contains(&&object.name) {
            continue;
        }
        for seed in first..first + seeds {
            eprintln!("{} {seed}", object.name);
            results.push(forms_of(&object, seed, &file));
        }
    }
    print!("{}", markdown(&results));
    Ok(())
}
