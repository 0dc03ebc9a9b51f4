//! The paper's tables and our estimates beside the truth: `cargo run --release -p ft-tests --bin study -- --help`.

use std::path::PathBuf;
use std::sync::atomic::{AtomicUsize, Ordering};

use clap::Parser;
use ft_tests::study::{inertia_plot, markdown, objects, picked};
use ft_tests::truth::{Trial, each_of, study_of};

/// Thirteen objects, recorded through the drivers and identified by ours and by the paper's estimator.
///
/// `study.md`, `inertia.svg` and a line per recording come out. All figures are simulated unless they say "published".
///
/// Each object has SEEDS seeds of its own, the first object those from FIRST_SEED on: two recordings with one seed have one tracker's
/// noise, and would say little more than one about how often an interval holds the truth.
#[derive(Parser)]
#[command(after_help = "Example:\n  study 10 501 tray wood_door -o study")]
struct Arguments {
    /// Recordings of each object
    #[arg(default_value_t = 10, value_parser = clap::value_parser!(u64).range(1..))]
    seeds: u64,
    /// Seed of the first
    #[arg(default_value_t = 101)]
    first_seed: u64,
    /// Objects of the study; all when none is given
    #[arg(value_name = "OBJECT")]
    objects: Vec<String>,
    /// Folder of what comes out
    #[arg(short, long, value_name = "DIR", default_value = "study")]
    output: PathBuf,
}

fn main() -> std::io::Result<()> {
    let Arguments {
        seeds,
        first_seed,
        objects: names,
        output: folder,
    } = Arguments::parse();
    let chosen = picked(&names).unwrap_or_else(|reason| {
        eprintln!("{reason}");
        std::process::exit(2);
    });
    let mut jobs = Vec::new();
    for (object, first) in objects().iter().zip((first_seed..).step_by(seeds as usize)) {
        if chosen.iter().any(|one| one.name == object.name) {
            let trial = Trial::plain(object.clone());
            jobs.extend(each_of(vec![trial], first..first + seeds));
        }
    }
    // Before the work, so that none is lost to a folder that cannot be.
    if let Err(error) = std::fs::create_dir_all(&folder) {
        eprintln!("no folder {}: {error}", folder.display());
        std::process::exit(1);
    }
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
    let names: Vec<&str> = chosen.iter().map(|object| object.name.as_str()).collect();
    let text = markdown(&results, &names);
    std::fs::write(folder.join("study.md"), &text)?;
    std::fs::write(folder.join("inertia.svg"), inertia_plot(&results))?;
    print!("{text}");
    println!("\nwrote {}", folder.display());
    Ok(())
}
