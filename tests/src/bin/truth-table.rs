//! Estimates beside the truth, by scenario: `cargo run --release -p ft-tests --bin truth-table -- --help`.

use clap::Parser;
use ft_sim_hw::Scenario;
use ft_tests::study::Spread;
use ft_tests::truth::{Comparison, study};

const SCENARIOS: [&str; 6] = [
    "wood_door",
    "metal_door",
    "drawer_light",
    "drawer_loaded",
    "sliding_door",
    "oven_door",
];

/// Built-in scenarios, recorded through the drivers, identified, and compared with what was simulated.
///
/// All figures are simulated.
#[derive(Parser)]
#[command(after_help = "Example:\n  truth-table 3 wood_door")]
struct Arguments {
    /// Recordings of each scenario
    #[arg(default_value_t = 10, value_parser = clap::value_parser!(u64).range(1..))]
    seeds: u64,
    /// Built-in scenarios
    #[arg(value_name = "SCENARIO", default_values_t = SCENARIOS.map(str::to_owned), value_parser = Scenario::builtin_names())]
    scenarios: Vec<String>,
}

fn main() {
    let Arguments { seeds, scenarios } = Arguments::parse();
    let scenarios: Vec<&str> = scenarios.iter().map(String::as_str).collect();
    let results = study(&scenarios, 1..seeds + 1, |one| eprintln!("{}", line(one)));
    println!(
        "| scenario | seeds | type right | axis deg med/max | axis mm med/max | I error % mean/worst | mu % mean abs | b % mean abs | base held-out | held-out | floor est. | floor true |"
    );
    println!("|---|---|---|---|---|---|---|---|---|---|---|---|");
    for scenario in &scenarios {
        let of: Vec<_> = results
            .iter()
            .filter(|one| one.scenario == *scenario)
            .collect();
        println!("{}", row(scenario, &of));
    }
}

fn line(one: &Comparison) -> String {
    let percent = |value: Option<f64>| {
        value.map_or("null".to_owned(), |value| {
            format!("{:+.1} %", value * 100.0)
        })
    };
    let sigma = |value: Option<f64>| value.map_or("-".to_owned(), |value| format!("{value:+.1} s"));
    format!(
        "{:<14} {:>3} {} axis {:.3} deg {:.2} mm  I {} ({})  mu {} ({})  b {} ({})  base {:.3} held-out {:.3} floor {:.3}/{:.3} {}",
        one.scenario,
        one.seed,
        if one.kind_is_right {
            "ok"
        } else {
            "WRONG TYPE"
        },
        one.axis_deg,
        one.axis_mm,
        percent(one.relative[0]),
        sigma(one.sigmas[0]),
        percent(one.relative[1]),
        sigma(one.sigmas[1]),
        percent(one.relative[2]),
        sigma(one.sigmas[2]),
        one.base_held_out,
        one.held_out,
        one.floor_estimated,
        one.floor_true,
        one.verdict
    )
}

fn row(scenario: &str, of: &[&Comparison]) -> String {
    let spread = |value: fn(&Comparison) -> f64| Spread::of(of.iter().map(|one| value(one)));
    let relative = |index: usize| {
        let values: Vec<f64> = of
            .iter()
            .filter_map(|one| one.relative[index])
            .map(|value| value * 100.0)
            .collect();
        let mean = values.iter().sum::<f64>() / values.len() as f64;
        let mean_abs = values.iter().map(|value| value.abs()).sum::<f64>() / values.len() as f64;
        let worst = values
            .iter()
            .copied()
            .max_by(|a, b| a.abs().total_cmp(&b.abs()))
            .unwrap_or(f64::NAN);
        (mean, mean_abs, worst, of.len() - values.len())
    };
    let (inertia, coulomb, viscous) = (relative(0), relative(1), relative(2));
    let (deg, mm) = (spread(|one| one.axis_deg), spread(|one| one.axis_mm));
    format!(
        "| {scenario} | {} | {} | {:.3} / {:.3} | {:.2} / {:.2} | {:+.2} / {:+.2} ({} null) | {:.1} ({} null) | {:.1} ({} null) | {:.3} | {:.3} | {:.3} | {:.3} |",
        of.len(),
        of.iter().filter(|one| one.kind_is_right).count(),
        deg.median(),
        deg.most(),
        mm.median(),
        mm.most(),
        inertia.0,
        inertia.2,
        inertia.3,
        coulomb.1,
        coulomb.3,
        viscous.1,
        viscous.3,
        spread(|one| one.base_held_out).median(),
        spread(|one| one.held_out).median(),
        spread(|one| one.floor_estimated).median(),
        spread(|one| one.floor_true).median(),
    )
}
