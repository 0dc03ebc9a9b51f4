//! Measured data from `$FT_DATA` (default: `shared/data` beside the checkout). Without it each test says what it skips.
#![allow(clippy::unwrap_used)]

use std::io::Write as _;
use std::path::PathBuf;

use ft_identify::analysis::Verdict;
use ft_identify::motion::MotionSettings;
use ft_identify::screw::JointKind;
use ft_identify::table::{Recipe, TableColumns, identify_published, read_table};
use ft_identify::track::{TrackJoint, identify_track};

fn data(part: &str) -> Option<PathBuf> {
    let root = std::env::var_os("FT_DATA").map_or_else(
        || PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../shared/data"),
        PathBuf::from,
    );
    let path = root.join(part);
    if !path.exists() {
        let _ = writeln!(
            std::io::stderr(),
            "skipped: {part} is not in {}; set FT_DATA",
            root.display()
        );
        return None;
    }
    Some(path)
}

fn logs(folder: &str) -> Vec<PathBuf> {
    let Some(path) = data(folder) else {
        return Vec::new();
    };
    let mut files: Vec<PathBuf> = std::fs::read_dir(path)
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .filter(|path| path.extension().is_some_and(|e| e == "log"))
        .collect();
    files.sort();
    files
}

#[test]
fn kitchen_doors_turn_and_kitchen_drawers_slide() {
    const DRAWERS: [&str; 4] = ["M2U00394", "M2U00395", "M2U00407", "M2U00408"];
    for file in logs("articulation_tum/kitchen") {
        let found = identify_track(&file).unwrap();
        let name = file.file_stem().unwrap().to_str().unwrap();
        if DRAWERS.contains(&name) {
            assert_eq!(found.candidates.kind, JointKind::Prismatic, "{name}");
            let length = found.q_range[1] - found.q_range[0];
            assert!((0.42..0.48).contains(&length), "{name}: {length} m");
            // Straight lines through the positions leave 1.0 to 1.6 mm.
            let rms = found.joint.position_rms;
            assert!(rms < 2e-3, "{name}: {rms} m");
        } else {
            assert_eq!(found.candidates.kind, JointKind::Revolute, "{name}");
            // 0.31-0.33, 0.40-0.43 and 0.51-0.53 m, to the digits given.
            let known = [(0.305, 0.335), (0.395, 0.435), (0.505, 0.535)];
            assert!(
                known
                    .iter()
                    .any(|range| within_one_deviation(&found, *range)),
                "{name}: {:?} m",
                found.radius
            );
        }
    }
}

/// Whether the radius is in the range or less than its own standard deviation outside.
fn within_one_deviation(found: &TrackJoint, (low, high): (f64, f64)) -> bool {
    let (radius, std) = (found.radius.unwrap(), found.joint.radius_std);
    assert!(std > 0.0 && std < 0.02, "{std} m");
    (low - std..=high + std).contains(&radius)
}

#[test]
fn dishwasher_and_left_door_have_their_radii() {
    // 0.644-0.674 m and 0.330-0.362 m by an algebraic circle fit, to the digits given. The geometric fit of left_door gives
    // up to 0.366 m: a robot's hook slides on its handle by millimetres.
    for (folder, low, high) in [
        ("dishwasher", 0.6435, 0.6745),
        ("left_door", 0.3295, 0.3625),
    ] {
        for file in logs(&format!("articulation_tum/mechanisms_iros_2010/{folder}")) {
            let found = identify_track(&file).unwrap();
            assert_eq!(
                found.candidates.kind,
                JointKind::Revolute,
                "{}",
                file.display()
            );
            assert!(
                within_one_deviation(&found, (low, high)),
                "{}: {:?} m",
                file.display(),
                found.radius
            );
        }
    }
}

fn emps() -> Option<ft_identify::samples::JointSamples> {
    let columns = TableColumns {
        time: "t_s".into(),
        position: "qm_m".into(),
        effort: "force_N".into(),
    };
    Some(read_table(&data("emps/DATA_EMPS.csv")?, &columns, JointKind::Prismatic).unwrap())
}

#[test]
fn the_published_recipe_gives_the_published_emps_parameters() {
    let Some(samples) = emps() else { return };
    let recipe = Recipe {
        lowpass_hz: 100.0,
        lowpass_order: 4,
        decimate: 10,
        drop_border: 50,
        offset: true,
    };
    let analysis = identify_published(&samples, &recipe).unwrap();
    for (name, published) in [
        ("inertia", 95.1089),
        ("viscous", 203.5034),
        ("coulomb", 20.3935),
        ("load", -3.1648),
    ] {
        let value = analysis.full.value(name).unwrap();
        assert!(
            (value - published).abs() < 2e-4,
            "{name}: {value}, published {published}"
        );
    }
    let percent = 100.0 * analysis.full.relative_error;
    assert!((percent - 4.0834).abs() < 1e-4, "{percent} %");
}

/// Name and held-out errors of the effects found in `samples`.
fn lacked(
    samples: &ft_identify::samples::JointSamples,
) -> (ft_identify::analysis::Analysis, Vec<&'static str>) {
    let analysis = ft_identify::analysis::analyse(samples, &MotionSettings::default()).unwrap();
    let found = analysis.diagnosis.as_ref().unwrap();
    for effect in &found.effects {
        println!(
            "{} {:?} {:.4?}",
            effect.found.kind.name, effect.found.shape, effect.held_out_rms
        );
    }
    println!(
        "named {:.2} % of the effort, floor {:.4}",
        100.0 * analysis.named.relative_error,
        analysis.floor.rms
    );
    let names = found.effects.iter().map(|e| e.found.kind.name).collect();
    (analysis, names)
}

#[test]
fn the_axis_of_emps_lacks_what_depends_on_its_direction() {
    let Some(samples) = emps() else { return };
    let (analysis, names) = lacked(&samples);
    assert!(
        analysis.base.relative_error > 0.06,
        "{}",
        analysis.base.relative_error
    );
    assert!(
        analysis.named.relative_error < 0.025,
        "{}",
        analysis.named.relative_error
    );
    assert!(names[0].starts_with("asymmetric"), "{names:?}");
}

/// At 50 Hz the position's upper band holds motion, and what seems its noise would explain all that I, mu, b leave.
#[test]
fn the_axis_of_emps_is_not_called_explained_for_want_of_samples() {
    let Some(whole) = emps() else { return };
    let thin = |series: &[f64]| series.iter().step_by(20).copied().collect::<Vec<f64>>();
    let (time, q, tau) = (thin(&whole.time), thin(&whole.q), thin(&whole.tau));
    let samples = ft_identify::samples::JointSamples {
        period: 20.0 * whole.period,
        runs: core::iter::once(0..time.len()).collect(),
        time,
        q,
        tau,
        ..whole
    };
    let (analysis, names) = lacked(&samples);
    assert!(names[0].starts_with("asymmetric"), "{names:?}");
    assert!(analysis.floor.rms < 0.3 * analysis.base.held_out_rms);
    let turned = ft_identify::samples::JointSamples {
        tau: samples.tau.iter().map(|tau| -tau).collect(),
        ..samples.clone()
    };
    let (analysis, _) = lacked(&turned);
    assert_eq!(analysis.verdict, Verdict::NotIdentifiable);
    let why = &analysis.full.not_identified["inertia"];
    assert!(why.contains("sign of the effort"), "{why}");
    let silent = ft_identify::samples::JointSamples {
        tau: vec![0.0; samples.tau.len()],
        ..samples
    };
    let (analysis, names) = lacked(&silent);
    assert_eq!(
        (analysis.verdict, names),
        (Verdict::NotIdentifiable, vec![])
    );
}

/// The tribometer: quasi-static, reversals at 0.24 mm/s under 5 N. Columns: s, uN, mm, uN (friction on the probe).
#[test]
fn the_tribometer_has_friction_with_memory_and_no_memoryless_effect_does_it() {
    let Some(path) = data("tribometer_presliding/test_data_2.txt") else {
        return;
    };
    let mut text = "t,q,tau\n".to_owned();
    for line in std::fs::read_to_string(path).unwrap().lines().skip(1) {
        let row: Vec<f64> = line
            .split('\t')
            .map(|cell| cell.trim().parse().unwrap())
            .collect();
        if row[1] > 4.5e6 {
            text += &format!("{},{:.9},{}\n", row[0], 1e-3 * row[2], -1e-6 * row[3]);
        }
    }
    let samples = table_of(&text, JointKind::Prismatic);
    let (analysis, names) = lacked(&samples);
    assert_eq!(names[0], "presliding");
    let found = analysis.diagnosis.unwrap();
    let first = &found.effects[0];
    assert!(
        first.ambiguous_with.is_empty(),
        "{:?}",
        first.ambiguous_with
    );
    assert!(
        first.held_out_rms[1] < 0.25 * first.held_out_rms[0],
        "{:?}",
        first.held_out_rms
    );
    // The ramp after a reversal is about 120 um long and goes from -1 to 1 times the friction.
    let length = 2.0 * first.found.shape[0];
    assert!((0.7e-4..1.7e-4).contains(&length), "{length} m");
}

/// One pull of a cabinet door with a self-closing hinge: positions and forces alone. The joint is a circle through the
/// positions; the force's tangential part times its radius is the effort.
#[test]
fn the_cabinet_door_has_a_load_that_depends_on_where_it_stands() {
    for (file, rate) in [("ikea_cabinet_log.csv", 72.0), ("ikea_cabinet_2.csv", 53.0)] {
        let Some(path) = data(&format!("hrl_pr2_door/{file}")) else {
            return;
        };
        let mut reader = csv::Reader::from_path(path).unwrap();
        let rows: Vec<[f64; 4]> = reader
            .deserialize::<std::collections::HashMap<String, f64>>()
            .map(|row| row.unwrap())
            .map(|row| ["ee_x", "ee_y", "f_ati_x", "f_ati_y"].map(|name| row[name]))
            .collect();
        let [cx, cy, r] = circle(&rows);
        assert!((0.28..0.33).contains(&r), "{file}: radius {r} m");
        let angle = |row: &[f64; 4]| (row[1] - cy).atan2(row[0] - cx);
        let wrapped = |a: f64| {
            (a + core::f64::consts::PI).rem_euclid(core::f64::consts::TAU) - core::f64::consts::PI
        };
        let start = angle(&rows[0]);
        let sense = wrapped(angle(&rows[rows.len() - 1]) - start).signum();
        let mut text = "t,q,tau\n".to_owned();
        for (i, row) in rows.iter().enumerate() {
            let at = angle(row);
            // The file has the force on the wrist; the effort is that of the tool on the door.
            let along = -sense * (-at.sin() * row[2] + at.cos() * row[3]);
            text += &format!(
                "{},{},{}\n",
                i as f64 / rate,
                sense * wrapped(at - start),
                along * r
            );
        }
        let (analysis, names) = lacked(&table_of(&text, JointKind::Revolute));
        assert!(
            ["catch", "detent", "spring", "gravity"].contains(&names[0]),
            "{file}: {names:?}"
        );
        let before_after = analysis.diagnosis.unwrap().effects[0].held_out_rms;
        assert!(
            before_after[1] < 0.4 * before_after[0],
            "{file}: {before_after:?}"
        );
    }
}

/// Centre and radius of a circle through the first two columns (algebraic fit: x^2 + y^2 = 2 a x + 2 b y + c).
fn circle(rows: &[[f64; 4]]) -> [f64; 3] {
    let y = nalgebra::DMatrix::from_fn(
        rows.len(),
        3,
        |i, j| if j < 2 { 2.0 * rows[i][j] } else { 1.0 },
    );
    let squares =
        nalgebra::DVector::from_fn(rows.len(), |i, _| rows[i][0].powi(2) + rows[i][1].powi(2));
    let fit = y.clone().svd(true, true).solve(&squares, 1e-12).unwrap();
    [
        fit[0],
        fit[1],
        (fit[2] + fit[0] * fit[0] + fit[1] * fit[1]).sqrt(),
    ]
}

fn table_of(text: &str, kind: JointKind) -> ft_identify::samples::JointSamples {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("table.csv");
    std::fs::write(&path, text).unwrap();
    let columns = TableColumns {
        time: "t".into(),
        position: "q".into(),
        effort: "tau".into(),
    };
    read_table(&path, &columns, kind).unwrap()
}

#[test]
fn our_pipeline_agrees_with_the_published_emps_mass() {
    let Some(samples) = emps() else { return };
    let analysis = ft_identify::analysis::analyse(&samples, &MotionSettings::default()).unwrap();
    let mass = analysis.full.value("inertia").unwrap();
    assert!((mass / 95.1 - 1.0).abs() < 0.03, "{mass} kg");
    assert!(analysis.full.held_out_rms < analysis.base.held_out_rms);
}
