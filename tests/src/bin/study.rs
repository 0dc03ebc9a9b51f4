//! `cargo run --release -p ft-tests --bin study -- [SEEDS] [FIRST_SEED] [OBJECT]... [-o DIR]`: thirteen objects, recorded through the drivers
//! and identified by ours and by the paper's estimator. `study.md`, `inertia.svg` and a line per recording come out. All
//! figures are simulated unless they say "published".
//!
//! Each object has SEEDS seeds of its own, the first object those from FIRST_SEED on: two recordings with one seed have one tracker's
//! noise, and would say little more than one about how often an interval holds the truth.

use std::path::PathBuf;
use std::sync::atomic::{AtomicUsize, Ordering};

use ft_tests::study::{inertia_plot, markdown, objects};
use ft_tests::truth::{Trial, each_of, study_of};

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
    let mut jobs = Vec::new();
    for (object, first) in objects.iter().zip((first..).step_by(seeds.max(1) as usize)) {
        if names.is_empty() || names.contains(&object.name) {
            let trial = Trial::plain(object.clone());
            jobs.extend(each_of(vec![trial], first..first + seeds));
        }
    }
    // Before the work, so that none is lost to a folder that cannot be.
    if let Err(error) = std::fs::create_dir_all(&folder) {
        eprintln!("no folder {}: {error}", folder.display());
        std::process::exit(1);
    }
    objects.retain(|object| names.is_empty() || names.contains(&object.name));
    let total = jobs.len();
    let done = AtomicUsize::new(0);
    let results = study_of(&jobs, |one| {
        let percent =
            |v: Option<f64>| v.map_or("null".to_owned(), |v| format!("{:+.1}%", 100.0 * v));
        let sigmas = |v: Option<f64>| v.map_or(String::new(), |v| format!("({v:+.1}s)"));
        eprintln!(
            "[{}/{total}] {} {}: I {}{} mu {}{} b {}{}, joint I {}{} mu {}{} b {}{}, paper's I {}; held-out {:.3}, floor {:.3}",
            done.fetch_add(1, Ordering::Relaxed) + 1,
            one.scenario,
            one.seed,
            percent(one.relative[0]),
            sigmas(one.sigmas[0]),
            percent(one.relative[1]),
            sigmas(one.sigmas[1]),
            percent(one.relative[2]),
            sigmas(one.sigmas[2]),
            percent(one.joint_relative[0]),
            sigmas(one.joint_sigmas[0]),
            percent(one.joint_relative[1]),
            sigmas(one.joint_sigmas[1]),
            percent(one.joint_relative[2]),
            sigmas(one.joint_sigmas[2]),
            percent(one.paper[0]),
            one.held_out,
            one.floor_true,
        );
    });
    let names: Vec<&str> = objects.iter().map(|object| object.name.as_str()).collect();
    let text = markdown(&results, &names);
    std::fs::write(folder.join("study.md"), &text)?;
    std::fs::write(folder.join("inertia.svg"), inertia_plot(&results))?;
    print!("{text}");
    println!("\nwrote {}", folder.display());
    Ok(())
}
