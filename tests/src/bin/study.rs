//! `cargo run --release -p ft-tests --bin study -- [SEEDS] [FIRST_SEED] [OBJECT]... [-o DIR]`: thirteen objects, recorded through the drivers
//! and identified by ours and by the paper's estimator. `study.md`, `inertia.svg` and a line per recording come out. All
//! figures are simulated unless they say "published".

use std::path::PathBuf;
use std::sync::atomic::{AtomicUsize, Ordering};

use ft_tests::study::{inertia_plot, markdown, objects};
use ft_tests::truth::{Trial, study_of};

fn main() -> std::io::Result<()> {
    let (mut numbers, mut names) = (Vec::new(), Vec::new());
    let mut folder = PathBuf::from("study");
    let mut arguments = std::env::args().skip(1);
    while let Some(argument) = arguments.next() {
        if argument == "-o" {
            folder = arguments.next().map_or(folder, PathBuf::from);
        } else if let Ok(number) = argument.parse::<u64>() {
            numbers.push(number);
        } else {
            names.push(argument);
        }
    }
    let seeds = numbers.first().copied().unwrap_or(10);
    let first = numbers.get(1).copied().unwrap_or(101);
    let mut objects = objects();
    if let Some(unknown) = names.iter().find(|n| objects.iter().all(|o| o.name != **n)) {
        let known: Vec<&str> = objects.iter().map(|object| object.name.as_str()).collect();
        eprintln!(
            "usage: study [SEEDS] [FIRST_SEED] [OBJECT]... [-o DIR]\nno object {unknown:?} among {}",
            known.join(", ")
        );
        std::process::exit(2);
    }
    objects.retain(|object| names.is_empty() || names.contains(&object.name));
    let total = objects.len() * seeds as usize;
    let done = AtomicUsize::new(0);
    let trials: Vec<Trial> = objects.iter().cloned().map(Trial::plain).collect();
    let results = study_of(&trials, first..first + seeds, |one| {
        let percent =
            |v: Option<f64>| v.map_or("null".to_owned(), |v| format!("{:+.1}%", 100.0 * v));
        let sigmas = |v: Option<f64>| v.map_or(String::new(), |v| format!("({v:+.1}s)"));
        eprintln!(
            "[{}/{total}] {} {}: I {}{} mu {}{} b {}{}, paper's I {}; held-out {:.3}, floor {:.3}",
            done.fetch_add(1, Ordering::Relaxed) + 1,
            one.scenario,
            one.seed,
            percent(one.relative[0]),
            sigmas(one.sigmas[0]),
            percent(one.relative[1]),
            sigmas(one.sigmas[1]),
            percent(one.relative[2]),
            sigmas(one.sigmas[2]),
            percent(one.paper[0]),
            one.held_out,
            one.floor_true,
        );
    });
    let names: Vec<&str> = objects.iter().map(|object| object.name.as_str()).collect();
    let text = markdown(&results, &names);
    std::fs::create_dir_all(&folder)?;
    std::fs::write(folder.join("study.md"), &text)?;
    std::fs::write(folder.join("inertia.svg"), inertia_plot(&results))?;
    print!("{text}");
    println!("\nwrote {}", folder.display());
    Ok(())
}
