//! `cargo run -p ft-tests --bin sealed-table -- [DRAWS] [FIRST_SEED] [--bare]`: sealed draws recorded through the drivers,
//! diagnosed with a confirming recording, and compared with the truth, by effect. All figures are simulated.

use std::collections::BTreeMap;
use std::path::Path;

use ft_capture::session::Plan;
use ft_capture::simulated;
use ft_identify::motion::MotionSettings;
use ft_identify::pipeline::identify_confirmed;
use ft_identify::report::Report;
use ft_recording::TopicMap;
use ft_sim_hw::sealed::{Mechanisms, SealedDraw, SealedOptions, SealedTruth};
use ft_sim_hw::{Scenario, Simulation};

/// Judgements of the draws of one effect (or of none).
#[derive(Default)]
struct Row {
    draws: usize,
    first: usize,
    among: usize,
    later: usize,
    missed: usize,
    wrong: usize,
    explained: usize,
    ratios: Vec<f64>,
}

fn main() {
    let (flags, numbers): (Vec<String>, Vec<String>) = std::env::args()
        .skip(1)
        .partition(|argument| argument.starts_with("--"));
    let number = |index: usize, otherwise: u64| {
        numbers
            .get(index)
            .and_then(|text| text.parse().ok())
            .unwrap_or(otherwise)
    };
    let (draws, start) = (number(0, 20), number(1, 1000));
    let mechanisms = if flags.iter().any(|flag| flag == "--bare") {
        Mechanisms::Dropped
    } else {
        Mechanisms::Kept
    };
    let options = SealedOptions {
        two: 0.0,
        mechanisms,
        ..SealedOptions::default()
    };
    let mut rows: BTreeMap<&'static str, Row> = BTreeMap::new();
    for seed in start..start + draws {
        match one(seed, &options) {
            Ok((truth, report)) => judge(&mut rows, &truth, &report),
            Err(reason) => eprintln!("{seed}: {reason}"),
        }
    }
    println!(
        "| effect | draws | first | among look-alikes | later | missed | wrong names | explained | after / floor, median |"
    );
    println!("|---|---|---|---|---|---|---|---|---|");
    for (name, row) in &mut rows {
        row.ratios.sort_by(f64::total_cmp);
        println!(
            "| {name} | {} | {} | {} | {} | {} | {} | {} | {:.2} |",
            row.draws,
            row.first,
            row.among,
            row.later,
            row.missed,
            row.wrong,
            row.explained,
            row.ratios
                .get(row.ratios.len() / 2)
                .copied()
                .unwrap_or(f64::NAN)
        );
    }
}

/// Records and identifies one draw.
fn one(seed: u64, options: &SealedOptions) -> Result<(SealedTruth, Report), String> {
    let draw = SealedDraw::draw(seed, options).map_err(|error| error.to_string())?;
    let folder = tempfile::tempdir().map_err(|error| error.to_string())?;
    let (main, confirm) = (
        folder.path().join("main.mcap"),
        folder.path().join("confirm.mcap"),
    );
    record(&draw.main, seed, &main)?;
    record(&draw.confirm, seed + 1, &confirm)?;
    let (map, settings) = (TopicMap::default(), MotionSettings::default());
    let found = identify_confirmed(&main, &[confirm], &map, &settings, &mut |_| ())
        .map_err(|error| error.to_string())?;
    Ok((draw.truth, found.report))
}

fn record(scenario: &Scenario, seed: u64, file: &Path) -> Result<(), String> {
    let mut simulation = Simulation::new(scenario, seed, simulated::START, None)
        .map_err(|error| error.to_string())?;
    let port = |_: &ft_sim_hw::Fitted| "in-process".to_owned();
    let (fitted, known) = (simulation.fitted(), simulation.known_setup());
    let config =
        simulated::config("sealed", fitted, &known, port).map_err(|error| error.to_string())?;
    let plan = Plan {
        config,
        record: Some(file.to_owned()),
        overwrite: true,
        duration: None,
        publish: false,
    };
    simulated::run(&plan, &mut simulation, |_| {}, || false).map_err(|error| error.to_string())?;
    Ok(())
}

/// Effects that move the effort by less than twice the floor count as `small`: they must not produce a wrong name.
fn judge(rows: &mut BTreeMap<&'static str, Row>, truth: &SealedTruth, report: &Report) {
    let floor = report.last.noise_floor_rms.unwrap_or(f64::INFINITY);
    let expected: Vec<&str> = truth.effects.iter().map(|effect| effect.name).collect();
    let large = truth
        .effects
        .iter()
        .any(|e| e.alone.main.unabsorbed_rms >= 2.0 * floor);
    let key = match truth.effects.first() {
        None => "(none)",
        Some(effect) if large => effect.name,
        Some(_) => "(small)",
    };
    let row = rows.entry(key).or_default();
    row.draws += 1;
    // The object's own mechanism is no false effect, and may well be the stronger one.
    let others: Vec<_> = report
        .effects
        .iter()
        .filter(|e| expected.contains(&e.name) || !truth.mechanism_effects.contains(&e.name))
        .collect();
    let holds = |e: &ft_identify::report::effects::EffectEntry| {
        expected.contains(&e.name) || e.ambiguous_with.iter().any(|name| expected.contains(name))
    };
    match others.iter().position(|e| holds(e)) {
        Some(0) if expected.contains(&others[0].name) => row.first += 1,
        Some(0) => row.among += 1,
        Some(_) => row.later += 1,
        None => row.missed += 1,
    }
    row.wrong += others.iter().filter(|e| !holds(e)).count();
    row.explained += usize::from(report.last.verdict == ft_identify::analysis::Verdict::Explained);
    if let Some(named) = &report.last.named {
        row.ratios.push(named.held_out_rms / floor);
    }
    let named: Vec<&str> = report.effects.iter().map(|e| e.name).collect();
    eprintln!(
        "{} {}: true {expected:?}, named {named:?}",
        truth.seed, truth.object
    );
}
