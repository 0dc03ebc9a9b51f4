use super::*;
use crate::dynamics::fit_base;
use crate::motion::{Motion, MotionSettings};
use crate::noise;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use std::io::Write;

fn table(text: &str) -> tempfile::NamedTempFile {
    let mut file = tempfile::NamedTempFile::new().unwrap();
    file.write_all(text.as_bytes()).unwrap();
    file
}

fn columns() -> TableColumns {
    TableColumns {
        time: "t".into(),
        position: "q".into(),
        effort: "f".into(),
    }
}

fn read(text: &str) -> Result<JointSamples, TableError> {
    read_table(table(text).path(), &columns(), JointKind::Prismatic)
}

fn rows(count: usize) -> String {
    let mut text = "t, q, other, f\n".to_owned();
    for i in 0..count {
        text += &format!("{}, {}, x, {}\n", i as f64 * 0.01, i, 2 * i);
    }
    text
}

#[test]
fn named_columns_are_read_and_others_ignored() {
    let samples = read(&rows(200)).unwrap();
    assert_eq!(samples.runs, vec![0..200]);
    assert_eq!((samples.q[7], samples.tau[7]), (7.0, 14.0));
    assert!((samples.period - 0.01).abs() < 1e-12);
}

#[test]
fn a_missing_column_names_those_there() {
    let error = read("t,x,f\n0,0,0\n").unwrap_err().to_string();
    assert!(
        error.contains("no column `q`") && error.contains("t, x, f"),
        "{error}"
    );
}

#[test]
fn text_in_a_cell_is_shown_with_its_place() {
    let error = read("t,q,f\n0,0,0\n0.1,oops,0\n").unwrap_err().to_string();
    assert!(
        error.contains("row 3, column `q`: `oops` is not a number"),
        "{error}"
    );
    let error = read("t;q;f\n0;0;0\n0,1;0;0\n").unwrap_err().to_string();
    assert!(
        error.contains("`0,1` is not a number (decimals come after a point)"),
        "{error}"
    );
}

#[test]
fn an_empty_cell_a_short_row_and_a_recording_say_what_to_do() {
    for (content, says) in [
        (
            "t,q,f\n0,0,0\n0.1,,0\n",
            "row 3, column `q`: `` is not a number; remove the row or fill it in",
        ),
        (
            "t,q,f\n0,0,0\n0.1,0\n",
            "row 3 has 2 cells and the header 3; mend the row or remove it",
        ),
    ] {
        let error = read(content).unwrap_err().to_string();
        assert!(error.contains(says), "{error}");
    }
    let mut file = tempfile::NamedTempFile::new().unwrap();
    file.write_all(b"\x89MCAP0\r\n").unwrap();
    let error = read_table(file.path(), &columns(), JointKind::Revolute).unwrap_err();
    assert!(error.to_string().contains("without `table`"), "{error}");
}

#[test]
fn a_nan_is_shown_with_its_place() {
    let error = read("t,q,f\n0,0,NaN\n").unwrap_err().to_string();
    assert!(
        error.contains("row 2, column `f`: NaN is not finite"),
        "{error}"
    );
}

#[test]
fn time_that_does_not_increase_is_shown_with_its_row() {
    let error = read("t,q,f\n0,0,0\n0.2,0,0\n0.2,0,0\n")
        .unwrap_err()
        .to_string();
    assert!(
        error.contains("row 4: time 0.2 s does not come after 0.2 s"),
        "{error}"
    );
}

#[test]
fn too_few_rows_are_refused() {
    assert!(matches!(
        read(&rows(50)),
        Err(TableError::TooShort {
            rows: 50,
            needed: 100,
            ..
        })
    ));
    assert!(matches!(
        read_table(
            Path::new("/nonexistent/x.csv"),
            &columns(),
            JointKind::Revolute
        ),
        Err(TableError::Io { .. })
    ));
}

#[test]
fn an_effort_that_never_changes_is_shown_with_its_column() {
    let text = "t,q,f\n".to_owned()
        + &(0..300)
            .map(|i| {
                format!(
                    "{},{},2.5\n",
                    0.01 * f64::from(i),
                    (0.1 * f64::from(i)).sin()
                )
            })
            .collect::<String>();
    let error = read(&text).unwrap_err();
    assert!(
        matches!(&error, TableError::ConstantEffort { column, value: 2.5, .. } if column == "f"),
        "{error}"
    );
}

#[test]
fn a_gap_ends_a_run_and_uneven_steps_are_interpolated() {
    let mut text = "t,q,f\n".to_owned();
    for i in 0..300 {
        let jitter = if i % 2 == 0 { 0.003 } else { 0.0 };
        let t = f64::from(i) * 0.01 + jitter + if i >= 150 { 1.0 } else { 0.0 };
        text += &format!("{t},{},{t}\n", 2.0 * t);
    }
    let samples = read(&text).unwrap();
    assert_eq!(samples.runs.len(), 2);
    for (t, q) in samples.time.iter().zip(&samples.q) {
        assert!((q - 2.0 * (t + 0.003)).abs() < 1e-9);
    }
}

#[test]
fn columns_may_be_separated_by_semicolons_or_tabs() {
    let commas = rows(200).replace("t, q", "Time [s], q");
    let columns = TableColumns {
        time: "Time [s]".into(),
        ..columns()
    };
    let read = |text: &str| read_table(table(text).path(), &columns, JointKind::Prismatic).unwrap();
    for separator in [";", "\t", "; "] {
        let samples = read(&commas.replace(", ", separator));
        assert_eq!((samples.q[7], samples.tau[7]), (7.0, 14.0));
    }
    // One that stands in names is none.
    assert_eq!(read(&commas.replace("other", "a;b;c;d;e")).q[7], 7.0);
}

#[test]
fn a_column_that_is_there_or_named_twice_is_refused() {
    let error = read("t,q,f,q\n0,0,0,0\n").unwrap_err().to_string();
    assert!(error.contains("more than one column `q`"), "{error}");
    // Those that are not read may be alike.
    let alike = rows(200)
        .replace("other, f", "other, other, f")
        .replace(" x,", " x, x,");
    assert!(read(&alike).is_ok());
    let columns = TableColumns {
        effort: "q".into(),
        ..columns()
    };
    let same = read_table(Path::new("/nonexistent"), &columns, JointKind::Revolute);
    assert!(matches!(same, Err(TableError::SameColumn { name }) if name == "q"));
}

/// A joint that goes to and fro over `span` in 4 s, its time told in `per_s` units.
fn to_and_fro(kind: JointKind, span: f64, per_s: f64) -> JointSamples {
    let mut text = "t,q,f\n".to_owned();
    for i in 0..2000 {
        let t = f64::from(i) * 0.01;
        let q = 0.5 * span * (1.6 * t).sin();
        text += &format!("{},{q},{q}\n", t * per_s);
    }
    read_table(table(&text).path(), &columns(), kind).unwrap()
}

#[test]
fn an_effort_that_is_cut_off_is_doubted() {
    let mut whole = to_and_fro(JointKind::Prismatic, 0.4, 1.0);
    whole.tau = whole.q.iter().map(|q| 50.0 * q).collect();
    let mut cut = whole.clone();
    for tau in &mut cut.tau {
        *tau = tau.clamp(-8.0, 8.0);
    }
    assert_eq!(doubts(&whole), Vec::<String>::new());
    let doubts = doubts(&cut);
    assert!(
        doubts.len() == 1 && doubts[0].contains("end of its range"),
        "{doubts:?}"
    );
}

#[test]
fn other_units_are_doubted() {
    use JointKind::{Prismatic, Revolute};
    for (kind, span, per_s, expected) in [
        (Prismatic, 0.4, 1.0, None),
        (Revolute, 1.6, 1.0, None),
        (Prismatic, 0.4, 1e3, Some("is the time in s?")),
        (Prismatic, 0.4, 1e-6, Some("is the time in s?")),
        (Prismatic, 40.0, 1.0, Some("and not in cm or mm?")),
        (Revolute, 90.0, 1.0, Some("and not in degrees?")),
        (
            Prismatic,
            0.4,
            0.05,
            Some("are positions in m and times in s?"),
        ),
    ] {
        let doubts = doubts(&to_and_fro(kind, span, per_s));
        match expected {
            None => assert_eq!(doubts, Vec::<String>::new()),
            Some(text) => assert!(
                doubts.iter().any(|doubt| doubt.contains(text)),
                "{doubts:?}"
            ),
        }
    }
}

/// Put on a grid between two samples, white noise has less of what is fast: the floor counts with what it had.
#[test]
fn times_that_jitter_leave_the_noise_its_size() {
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let mut noise = || -> f64 { StandardNormal.sample(&mut rng) };
    let mut floor = |jitter: f64| {
        let mut text = "t,q,f\n".to_owned();
        for i in 0..30_000 {
            // Each third sample comes late.
            let t = f64::from(i) * 1e-3 + if i % 3 == 0 { jitter } else { 0.0 };
            let q = 0.3 * (2.0 * t).sin() + 1e-4 * noise();
            text += &format!("{t},{q},{}\n", noise());
        }
        let samples = read(&text).unwrap();
        let motion = Motion::prepare(&samples, &MotionSettings::default()).unwrap();
        let mut model = fit_base(&motion).unwrap();
        model.theta[0] = 10.0;
        let floor = noise::floor(
            &samples,
            &motion,
            &model,
            noise::Slopes::none(motion.q.len()),
        );
        floor.unwrap()
    };
    let [even, late] = [0.0, 4e-4].map(&mut floor);
    let position = late.position_rms / even.position_rms;
    let wrench = late.wrench_rms / even.wrench_rms;
    assert!((0.95..1.05).contains(&position), "{even:?} {late:?}");
    assert!((0.95..1.05).contains(&wrench), "{even:?} {late:?}");
}
