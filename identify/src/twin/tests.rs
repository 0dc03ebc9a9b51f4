use nalgebra::{Isometry3, Point3, Vector3};

use super::*;
use crate::analysis::analyse;
use crate::mechanism::Mechanism as _;
use crate::motion::MotionSettings;
use crate::samples::JointSamples;

fn twin() -> (Twin, crate::analysis::Analysis) {
    let time: Vec<f64> = (0..6000).map(|i| 0.005 * f64::from(i)).collect();
    let state: Vec<[f64; 3]> = time
        .iter()
        .map(|t| crate::dynamics::probing(*t, 0.8))
        .collect();
    let samples = JointSamples {
        kind: JointKind::Revolute,
        period: 0.005,
        runs: vec![0..6000],
        q: state.iter().map(|s| s[0]).collect(),
        tau: state
            .iter()
            .map(|[q, dq, ddq]| 2.0 * ddq + 0.6 * dq.signum() + 0.9 * dq + 3.0 * q * q)
            .collect(),
        time,
        noise_of_q: Vec::new(),
        aside: crate::samples::Aside::default(),
    };
    let analysis = analyse(&samples, &MotionSettings::default()).unwrap();
    let axis = ScrewAxis {
        direction: nalgebra::Unit::new_normalize(Vector3::new(0.0, 0.1, 1.0)),
        point: Point3::new(1.0, 2.0, 3.0),
        kind: JointKind::Revolute,
    };
    let twin = Twin::new(
        JointKind::Revolute,
        Some(&axis),
        analysis.q_range,
        [-1.0, 1.0],
        &analysis.full,
        Provenance::default(),
    )
    .with_effects(TwinEffect::of(&analysis));
    (twin, analysis)
}

#[test]
fn the_twin_gives_the_efforts_of_its_model() {
    let (twin, analysis) = twin();
    let model = &analysis.full;
    let (q, dq, ddq) = (0.4, -0.7, 1.5);
    let expected = model.theta[0] * ddq - model.theta[1]
        + model.theta[2] * dq
        + model.mechanism.as_ref().unwrap().effort(q, dq)
        + twin.evaluator().terms(q, dq, ddq).effects;
    assert!((twin.evaluator().effort(q, dq, ddq) - expected).abs() < 1e-9);
    assert!(
        (expected - (3.0 - 0.6 - 0.63 + 0.48)).abs() < 0.15,
        "{expected}"
    );
}

#[test]
fn another_frame_or_coordinate_does_not_change_the_effort() {
    let (twin, _) = twin();
    let motion = Isometry3::new(Vector3::new(1.0, 0.0, 2.0), Vector3::new(0.3, 0.2, 0.1));
    let moved = twin
        .in_frame("asset", &motion)
        .in_coordinate(true, 0.25)
        .in_coordinate(false, -1.0);
    for (q, dq, ddq) in [(0.1, 0.5, 1.0), (0.7, -0.9, 0.0), (0.4, -0.2, -3.0)] {
        let there = moved.evaluator().effort(-q + 0.25 - 1.0, -dq, -ddq);
        assert!(
            (there + twin.evaluator().effort(q, dq, ddq)).abs() < 1e-12,
            "effort turns its sign with the coordinate"
        );
    }
    let [low, high] = twin.joint.q_range;
    assert_eq!(moved.joint.q_range, [-high + 0.25 - 1.0, -low + 0.25 - 1.0]);
    let back = moved
        .in_coordinate(true, -0.75)
        .in_frame("world", &motion.inverse());
    assert!(
        (Vector3::from(back.joint.axis_direction.unwrap())
            - Vector3::from(twin.joint.axis_direction.unwrap()))
        .norm()
            < 1e-12
    );
}

proptest::proptest! {
    #![proptest_config(proptest::test_runner::Config::with_cases(1000))]
    #[test]
    fn any_frame_and_coordinate_gives_the_same_effort(
        turn in proptest::array::uniform3(-3.0..3.0), way in proptest::array::uniform3(-5.0..5.0),
        reversed: bool, offset in -4.0..4.0, q in 0.0..0.8, dq in -1.5..1.5, ddq in -9.0..9.0,
    ) {
        let (twin, _) = shared();
        let motion = Isometry3::new(Vector3::from(way), Vector3::from(turn));
        let moved = twin.in_frame("asset", &motion).in_coordinate(reversed, offset);
        let s = if reversed { -1.0 } else { 1.0 };
        let (here, there) = (twin.evaluator(), moved.evaluator());
        let (before, after) = (here.effort(q, dq, ddq), s * there.effort(s * q + offset, s * dq, s * ddq));
        proptest::prop_assert!((before - after).abs() <= 1e-9 * before.abs().max(1e-3), "{before} {after}");
        proptest::prop_assert_eq!(here.outside(q, dq).is_some(), there.outside(s * q + offset, s * dq).is_some());
        // Power: the effort works on the point of the axis that carries the tool, wherever the frame.
        let twist = |twin: &Twin, dq: f64| dq * Vector3::from(twin.joint.axis_direction.unwrap());
        let turned = motion.rotation * twist(twin, dq);
        proptest::prop_assert!((turned - twist(&moved, s * dq)).norm() < 1e-9);
    }
}

fn shared() -> &'static (Twin, crate::analysis::Analysis) {
    static SHARED: std::sync::OnceLock<(Twin, crate::analysis::Analysis)> =
        std::sync::OnceLock::new();
    SHARED.get_or_init(twin)
}

#[test]
fn a_gradient_is_the_slope_of_the_effort_and_stays_on_its_side_of_rest() {
    let evaluator = shared().0.evaluator();
    let [by_q, by_dq, by_ddq] = evaluator.gradient(0.4, 0.6);
    let slope = |h: f64| {
        (evaluator.effort(0.4 + h, 0.6, 0.0) - evaluator.effort(0.4 - h, 0.6, 0.0)) / (2.0 * h)
    };
    assert!(
        (by_q - slope(1e-4)).abs() < 0.05 * by_q.abs().max(1.0),
        "{by_q} {}",
        slope(1e-4)
    );
    assert!(by_dq > 0.0 && (by_ddq - evaluator.inertia()).abs() < 1e-12);
    // Across rest the Coulomb friction would jump by more than a newton metre over a thousandth of the range.
    assert!(evaluator.gradient(0.4, 1e-6)[1] < 20.0);
    assert_eq!(evaluator.outside(0.4, 0.1), None);
    assert_eq!(evaluator.outside(f64::NAN, 0.1), Some(Outside::Coordinate));
    assert_eq!(evaluator.outside(3.0, 0.1), Some(Outside::Coordinate));
    assert_eq!(evaluator.outside(0.4, 30.0), Some(Outside::Velocity));
}

#[test]
fn many_efforts_at_once_are_those_one_by_one() {
    // More than a block of states and not a whole number of blocks; named effects too; either sense.
    let (twin, _) = shared();
    let states: Vec<[f64; 3]> = (0..333)
        .map(|k| {
            let t = f64::from(k);
            [
                0.4 + 0.7 * t.sin(),
                1.2 * (0.7 * t).cos(),
                3.0 * (1.3 * t).sin(),
            ]
        })
        .chain([[0.3, 0.0, 1.0], [f64::NAN, 0.2, 0.0], [0.2, f64::NAN, 0.0]])
        // In the order of their time, there and back.
        .chain((0..1000).map(|k| {
            let (sin, cos) = (0.01 * f64::from(k)).sin_cos();
            [0.4 - 0.5 * cos, 0.5 * sin, 0.5 * cos]
        }))
        .collect();
    let of = |i: usize| -> Vec<f64> { states.iter().map(|state| state[i]).collect() };
    // Load and damping without a common grid, as another program's file may have them.
    let mut apart = twin.clone();
    apart.mechanism.as_mut().unwrap().load.interval[1] += 0.1;
    for twin in [twin.clone(), twin.in_coordinate(true, 0.3), apart] {
        let evaluator = twin.evaluator();
        let mut out = vec![0.0; states.len()];
        evaluator.efforts(&of(0), &of(1), &of(2), &mut out).unwrap();
        for ([q, dq, ddq], effort) in states.iter().zip(&out) {
            let one = evaluator.effort(*q, *dq, *ddq);
            assert!((one - effort).abs() < 1e-12 || (one.is_nan() && effort.is_nan()));
        }
        evaluator.efforts(&of(0), 0.4, 0.0, &mut out).unwrap();
        assert!((out[7] - evaluator.effort(states[7][0], 0.4, 0.0)).abs() < 1e-12);
        let wrong = evaluator
            .efforts(0.1, &of(1)[1..], 0.0, &mut out)
            .unwrap_err();
        assert_eq!((wrong.name, wrong.expected, wrong.got), ("dq", 1336, 1335));
    }
}

#[test]
fn several_threads_give_the_efforts_of_one() {
    let (twin, _) = shared();
    let evaluator = twin.evaluator();
    let count = 750_001;
    let of = |from: f64, rate: f64| -> Vec<f64> {
        let at = (0..count).map(f64::from);
        at.map(|k| from + (rate * k).sin()).collect()
    };
    let (mut one, mut several) = (vec![0.0; 750_001], vec![f64::NAN; 750_001]);
    // In no order, and in that of their time: there the last digits may differ where the states are cut.
    for (rates, tolerance) in [([0.3, 0.7], 0.0), ([1e-3, 3e-3], 1e-12)] {
        let (q, dq) = (of(0.4, rates[0]), of(0.0, rates[1]));
        evaluator.efforts(&q, &dq, 0.5, &mut one).unwrap();
        evaluator.efforts_by(3, &q, &dq, 0.5, &mut several).unwrap();
        for (one, several) in one.iter().zip(&several) {
            assert!((one - several).abs() <= tolerance, "{one} {several}");
        }
    }
    let (q, dq) = (of(0.4, 0.3), of(0.0, 0.7));
    evaluator.efforts_by(3, 0.1, 0.2, 0.5, &mut []).unwrap();
    let wrong = evaluator.efforts_by(3, &q, &dq[1..], 0.5, &mut several);
    assert_eq!(wrong.unwrap_err().name, "dq");
}

#[test]
fn json_gives_the_twin_back() {
    let (twin, _) = twin();
    let back: Twin = serde_json::from_str(&twin.to_json().unwrap()).unwrap();
    assert!(
        (back.evaluator().effort(0.3, 0.4, 0.5) - twin.evaluator().effort(0.3, 0.4, 0.5)).abs()
            < 1e-12
    );
    assert_eq!(back.joint.coordinate, twin.joint.coordinate);
}

#[test]
fn an_effect_of_several_forms_is_the_one_of_as_many_shapes() {
    let spring = |terms: [(&str, f64); 2], shape: &[(&str, f64)]| {
        let number = |(name, value): &(&str, f64)| crate::report::effects::TwinNumber {
            name: (*name).to_owned(),
            value: *value,
            unit: String::new(),
        };
        TwinEffect {
            name: "spring".to_owned(),
            terms: terms.iter().map(number).collect(),
            shape: shape.iter().map(number).collect(),
            memoryless: true,
        }
    };
    let mut bare = shared().0.clone();
    bare.effects = Vec::new();
    let added = |effect: TwinEffect| {
        let with = bare.clone().with_effects(vec![effect]);
        let with = Twin::from_json(&with.to_json().unwrap()).unwrap();
        with.evaluator().effort(0.4, 0.1, 0.0) - bare.evaluator().effort(0.4, 0.1, 0.0)
    };
    let straight = added(spring([("stiffness", 5.0), ("preload", 1.0)], &[]));
    assert!((straight - 3.0).abs() < 1e-9, "{straight}");
    let strut = added(spring(
        [("stiffness", 34.5), ("pull", -80.5)],
        &[("angle", 0.05), ("ratio", 0.24)],
    ));
    let (length, (sin, cos)) = (
        |cos: f64| f64::hypot(0.25, 0.06).powi(2) - 0.03 * cos,
        0.45_f64.sin_cos(),
    );
    let length = length(cos).sqrt();
    let wanted = 2300.0 * (length - 0.14) * (0.25 * 0.06 * sin / length);
    assert!((strut - wanted).abs() < 1e-9, "{strut} {wanted}");
    let odd = bare.clone().with_effects(vec![spring(
        [("stiffness", 5.0), ("preload", 1.0)],
        &[("angle", 0.0)],
    )]);
    assert!(Twin::from_json(&odd.to_json().unwrap()).is_err());
    // As files had it before the pads behind a play gave way.
    let mut play = spring([("share", 1.0), ("", 0.0)], &[("gap", 0.002)]);
    (play.name, play.memoryless) = ("backlash".to_owned(), false);
    assert!(Twin::from_json(&bare.with_effects(vec![play]).to_json().unwrap()).is_ok());
}
