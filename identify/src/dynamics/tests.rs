use core::f64::consts::TAU;

use super::*;
use crate::effect::BiasDrift;
use crate::effect::library::Variable;
use crate::filter::{LowPass, second_derivative};
use crate::mechanism::Mechanism as _;
use crate::motion::MotionSettings;
use crate::noise;
use crate::samples::JointSamples;
use crate::screw::JointKind;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

/// A probing motion: slow strokes, then faster ones of changing length; q, dq, ddq.
pub(crate) fn probing(t: f64, range: f64) -> [f64; 3] {
    // q = range (1 - cos phi(t)) / 2 with a phase whose speed grows.
    let (a, b, c) = (0.5, 0.055, 0.35);
    let phi = a * t + b * t * t + c * (1.3 * t).sin();
    let d1 = a + 2.0 * b * t + 1.3 * c * (1.3 * t).cos();
    let d2 = 2.0 * b - 1.69 * c * (1.3 * t).sin();
    [
        range * (1.0 - phi.cos()) / 2.0,
        range * phi.sin() * d1 / 2.0,
        range * (phi.cos() * d1 * d1 + phi.sin() * d2) / 2.0,
    ]
}

struct Object {
    inertia: f64,
    coulomb: f64,
    viscous: f64,
    mechanism: fn(f64, f64) -> f64,
}

fn record(object: &Object, seconds: f64, noise: [f64; 2], seed: u64) -> JointSamples {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut draw = || -> f64 { StandardNormal.sample(&mut rng) };
    let rate = 1000.0;
    let count = (seconds * rate) as usize;
    let mut samples = JointSamples {
        kind: JointKind::Revolute,
        period: 1.0 / rate,
        runs: vec![0..count],
        time: (0..count).map(|i| i as f64 / rate).collect(),
        q: Vec::new(),
        tau: Vec::new(),
        noise_of_q: vec![Vec::new()],
        aside: crate::samples::Aside::default(),
    };
    for i in 0..count {
        let [q, dq, ddq] = probing(i as f64 / rate, 1.2);
        let tau = object.inertia * ddq
            + object.coulomb * dq.signum()
            + object.viscous * dq
            + (object.mechanism)(q, dq);
        samples.q.push(q + noise[0] * draw());
        samples.noise_of_q[0].push(noise[0] * draw());
        samples.tau.push(tau + noise[1] * draw());
    }
    samples
}

/// A plain door, drawn over its range for 40 s.
pub(crate) fn drawn() -> JointSamples {
    record(&PLAIN, 40.0, [4e-5, 0.1], 9)
}

const PLAIN: Object = Object {
    inertia: 2.5,
    coulomb: 1.2,
    viscous: 0.8,
    mechanism: |_, _| 0.0,
};
const CLOSER: Object = Object {
    inertia: 3.0,
    coulomb: 1.0,
    viscous: 0.5,
    mechanism: |q, dq| {
        6.0 + 3.0 * q
            + if dq < 0.0 {
                6.0 * dq * ((0.45 - q) / 0.15).clamp(0.0, 1.0)
            } else {
                2.0 * dq
            }
    },
};

#[test]
fn a_bias_that_drifts_is_not_taken_for_friction() {
    let mut samples = record(&PLAIN, 40.0, [2e-5, 0.02], 5);
    let drifting = samples.tau.iter_mut().zip(&samples.time);
    drifting.for_each(|(tau, t)| *tau += 0.3 * t / 40.0);
    let motion = Motion::prepare(&samples, &MotionSettings::default()).unwrap();
    let error = |effects: &[&dyn Effect]| {
        let model = fit_with_mechanism(&motion, effects).unwrap();
        (model.value("coulomb").unwrap() / PLAIN.coulomb - 1.0).abs()
    };
    let (without, with) = (error(&[&RigidBody]), error(&[&RigidBody, &BiasDrift]));
    assert!(with < 2e-3 && 3.0 * with < without, "{with} {without}");
}

#[test]
fn a_plain_object_is_recovered_by_the_base_model() {
    for seed in 0..3 {
        let motion = Motion::prepare(
            &record(&PLAIN, 30.0, [4e-5, 0.1], seed),
            &MotionSettings::default(),
        )
        .unwrap();
        let model = fit_base(&motion).unwrap();
        assert!(
            (model.value("inertia").unwrap() / 2.5 - 1.0).abs() < 0.01,
            "{:?}",
            model.terms
        );
        assert!(
            (model.value("coulomb").unwrap() / 1.2 - 1.0).abs() < 0.03,
            "{:?}",
            model.terms
        );
        assert!(
            (model.value("viscous").unwrap() / 0.8 - 1.0).abs() < 0.06,
            "{:?}",
            model.terms
        );
        assert_eq!(model.rank, 3);
    }
}

#[test]
fn the_residual_of_a_complete_model_is_the_noise_floor() {
    let samples = record(&PLAIN, 40.0, [6e-5, 0.15], 3);
    let motion = Motion::prepare(&samples, &MotionSettings::default()).unwrap();
    let model = fit_base(&motion).unwrap();
    let floor = noise::floor(
        &samples,
        &motion,
        &model,
        noise::Slopes::none(motion.q.len()),
    )
    .unwrap();
    let ratio = model.held_out_rms / floor.rms;
    assert!(
        (0.8..1.25).contains(&ratio),
        "held out {} and floor {floor:?}",
        model.held_out_rms
    );
}

/// What a fit leaves on held-out strokes, over the estimated floor.
fn over_floor(samples: &JointSamples) -> f64 {
    let mut motion = Motion::prepare(samples, &MotionSettings::default()).unwrap();
    motion.leave_out_turns();
    let model = fit_base(&motion).unwrap();
    let none = noise::Slopes::none(motion.q.len());
    model.held_out_rms / noise::floor(samples, &motion, &model, none).unwrap().rms
}

/// A table has no residuals across its path: its positions alone must show their noise, at the edges of rests, too.
#[test]
fn the_floor_of_a_table_is_what_a_complete_model_leaves() {
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let mut draw = || -> f64 { StandardNormal.sample(&mut rng) };
    let heavy = Object {
        inertia: 14.0,
        coulomb: 7.0,
        viscous: 9.0,
        mechanism: |_, _| 0.0,
    };
    let mut samples = sticking(&heavy, 60.0);
    samples.noise_of_q.clear();
    samples.q.iter_mut().for_each(|q| *q += 1e-4 * draw());
    samples.tau.iter_mut().for_each(|tau| *tau += 0.1 * draw());
    let even = over_floor(&samples);
    assert!((0.93..1.07).contains(&even), "{even}");
}

#[test]
fn a_closer_biases_the_base_model_and_not_the_joint_fit() {
    for seed in 0..3 {
        let motion = Motion::prepare(
            &record(&CLOSER, 40.0, [4e-5, 0.1], seed),
            &MotionSettings::default(),
        )
        .unwrap();
        let model = fit_with_mechanism(&motion, &[&RigidBody]).unwrap();
        let base = fit_base(&motion).unwrap();
        assert!(
            (model.value("inertia").unwrap() / 3.0 - 1.0).abs() < 0.03,
            "{:?}",
            model.terms
        );
        assert!(
            (model.value("coulomb").unwrap() / 1.0 - 1.0).abs() < 0.1,
            "{:?}",
            model.terms
        );
        assert!(
            model.held_out_rms < 0.15 * base.held_out_rms,
            "{} {}",
            model.held_out_rms,
            base.held_out_rms
        );
        let mechanism = model.mechanism.unwrap();
        let load = mechanism.load(0.9) - mechanism.load(0.5);
        assert!((load - 1.2).abs() < 0.15, "{load}");
        assert!(mechanism.damping(0.2, -1.0) > 3.0 + mechanism.damping(0.8, -1.0));
        assert!(
            mechanism
                .damping_coefficients
                .iter()
                .flatten()
                .all(|c| *c >= 0.0)
        );
    }
}

#[test]
fn a_mechanism_without_damping_is_one_whose_other_columns_are_struck_out() {
    let samples = record(&CLOSER, 30.0, [2e-5, 0.02], 3);
    let motion = Motion::prepare(&samples, &MotionSettings::default()).unwrap();
    let parametric = Design::new(&motion, &[&RigidBody], None).unwrap();
    let mechanism = SplineMechanism::over(&motion);
    let design = parametric.with_surfaces(&motion, &mechanism);
    let undamped = design.undamped();
    let used = design.params + mechanism.load_basis().len();
    let solution = undamped.solve(&MIDDLING);
    let h = design.penalized(&design.gram, &MIDDLING, 1.0);
    let direct = h
        .view((0, 0), (used, used))
        .into_owned()
        .cholesky()
        .unwrap();
    let direct = direct.solve(&design.right.rows(0, used).into_owned());
    assert!((solution.rows(0, used) - &direct).amax() < 1e-7 * direct.amax());
    assert_eq!(solution.rows_range(used..).amax(), 0.0);
    let [without, with] = [&undamped, &design].map(|design| design.held_out(&MIDDLING));
    assert!(without > 1.1 * with, "{without} {with}");
}

#[test]
fn slow_strokes_alone_leave_the_inertia_unknown_and_say_what_to_do() {
    let mut samples = record(&PLAIN, 30.0, [4e-5, 0.3], 4);
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    for i in 0..samples.len() {
        let t = i as f64 * samples.period;
        let (q, dq) = (0.6 - 0.6 * (0.25 * t).cos(), 0.15 * (0.25 * t).sin());
        let noise: f64 = StandardNormal.sample(&mut rng);
        samples.q[i] = q + 4e-5 * noise;
        samples.tau[i] =
            0.05 * 0.0375 * (0.25 * t).cos() + 1.2 * dq.signum() + 0.8 * dq + 0.3 * noise;
    }
    let motion = Motion::prepare(&samples, &MotionSettings::default()).unwrap();
    let model = fit_with_mechanism(&motion, &[&RigidBody]).unwrap();
    assert_eq!(model.value("inertia"), None, "{:?}", model.terms);
    assert!(model.not_identified["inertia"].contains("fast strokes"));
}

#[test]
fn the_regressors_are_derivatives_of_the_motion() {
    let samples = record(&PLAIN, 20.0, [0.0, 0.0], 0);
    let motion = Motion::prepare(&samples, &MotionSettings::default()).unwrap();
    let columns = RigidBody.columns(&motion).unwrap();
    // Exact series through the same filter must give the same regressors.
    let exact = |k: usize| {
        motion
            .time
            .iter()
            .map(|t| probing(*t, 1.2)[k])
            .collect::<Vec<f64>>()
    };
    for (column, k) in [(0, 2), (2, 1)] {
        let expected = motion.regressor(&exact(k)).unwrap();
        let scale = rms(&expected);
        assert!(
            columns[column]
                .values
                .iter()
                .zip(&expected)
                .all(|(a, b)| (a - b).abs() < 2e-3 * scale)
        );
    }
    let sign: Vec<f64> = exact(1).iter().map(|v| v.signum()).collect();
    let expected = motion.regressor(&sign).unwrap();
    assert!(
        columns[1]
            .values
            .iter()
            .zip(&expected)
            .all(|(a, b)| (a - b).abs() < 0.05)
    );
}

#[test]
fn a_late_wrench_is_found_to_a_fraction_of_a_millisecond() {
    for lag_ms in [0.0, 7.3, -12.0, 75.0, -140.0] {
        let samples = record(&CLOSER, 40.0, [4e-5, 0.1], 6).with_effort_earlier(-lag_ms * 1e-3);
        let (_, _, lag) = align(&samples, &MotionSettings::default(), &[&RigidBody]).unwrap();
        let lag = lag.unwrap();
        assert!(
            (lag.value_s * 1e3 - lag_ms).abs() < 0.8,
            "{lag:?} for {lag_ms} ms"
        );
    }
}

#[test]
fn a_lag_of_a_sample_that_stands_out_of_the_noise_is_taken_out() {
    for (lag_ms, applied) in [
        (0.0, Some(false)),
        (0.5, None),
        (0.9, Some(true)),
        (-0.9, Some(true)),
    ] {
        let samples = record(&PLAIN, 40.0, [4e-5, 0.1], 6).with_effort_earlier(-lag_ms * 1e-3);
        let (_, _, lag) = align(&samples, &MotionSettings::default(), &[&RigidBody]).unwrap();
        let lag = lag.unwrap();
        if let Some(applied) = applied {
            assert_eq!(lag.applied, applied, "{lag:?} for {lag_ms} ms");
        }
        assert!(!lag.applied || lag.value_s.abs() >= LEAST_LAG_S, "{lag:?}");
        assert!(
            (lag.value_s * 1e3 - lag_ms).abs() < 0.25,
            "{lag:?} for {lag_ms} ms"
        );
    }
}

#[test]
fn what_is_left_of_a_spring_stands_against_q() {
    let spring = Object {
        mechanism: |q, _| 8.0 * (q - 0.6),
        ..PLAIN
    };
    let motion = Motion::prepare(
        &record(&spring, 40.0, [4e-5, 0.1], 9),
        &MotionSettings::default(),
    )
    .unwrap();
    let model = fit_base(&motion).unwrap();
    let shares = structure(&motion, &model).unwrap();
    assert_eq!(shares[0].variable, Variable::Q);
    assert!(shares[0].share > 0.25, "{shares:?}");
    assert_eq!(not_white(&shares).unwrap().variable, Variable::Q);
}

/// White residuals of 400 samples, and the same beside a friction of a third of them, an off-axis force's and a part of the acceleration.
#[test]
fn noise_is_white_and_what_stands_against_a_variable_is_not() {
    let mut samples = record(&PLAIN, 60.0, [4e-5, 0.1], 9);
    // Along the handle at q = 0, and ahead of it; a pull away from the axis and one along the path.
    let [mut first, mut second] = [const { Vec::new() }; 2];
    let mut outwards = Vec::new();
    for (t, q) in samples.time.iter().zip(&samples.q) {
        let (out, ahead) = ((7.3 * t).sin(), (5.1 * t).cos());
        first.push(out * q.cos() - ahead * q.sin());
        second.push(out * q.sin() + ahead * q.cos());
        outwards.push(out);
    }
    samples.aside.across = vec![first, second];
    let motion = Motion::prepare(&samples, &MotionSettings::default()).unwrap();
    let mut rng = ChaCha8Rng::seed_from_u64(11);
    let every = motion.kept.len() / 400;
    let mut white = || -> Vec<f64> {
        let held: Vec<f64> = (0..=motion.kept.len() / every)
            .map(|_| StandardNormal.sample(&mut rng))
            .collect();
        (0..motion.kept.len()).map(|i| held[i / every]).collect()
    };
    let mut model = fit_base(&motion).unwrap();
    model.effective_samples = 400.0;
    let mut against = |residual: &[f64]| {
        model.residual = residual.to_vec();
        let structure = structure(&motion, &model).unwrap();
        assert_eq!(structure.len(), 7);
        not_white(&structure).map(|one| one.variable)
    };
    let often = (0..100).filter(|_| against(&white()).is_some()).count();
    assert!(often <= 7, "{often} of 100");

    for (variable, part) in [
        (Variable::Sign, 0.33),
        (Variable::OffAxis, 0.5),
        (Variable::Ddq, 0.5),
    ] {
        let series = motion.variable(variable).remove(0);
        if variable == Variable::OffAxis {
            let near = series.iter().zip(&motion.time);
            assert!(
                near.map(|(out, t)| (out - (7.3 * t).sin()).abs())
                    .all(|e| e < 0.01)
            );
        }
        let series = motion.at_kept(&series);
        let size = part / rms(&series);
        let seen = (0..20).filter(|_| {
            let residual = white().into_iter().zip(&series);
            let residual: Vec<f64> = residual.map(|(w, s)| w + size * s).collect();
            against(&residual) == Some(variable)
        });
        assert!(seen.count() >= 18, "{variable:?}");
    }
}

/// A motion that accelerates little, and what its errors leave of an inertia.
#[test]
fn what_errors_of_the_motion_leave_against_the_acceleration_is_white() {
    let settings = MotionSettings::default();
    let mut samples = record(&PLAIN, 120.0, [0.0, 0.1], 9);
    let mut rng = ChaCha8Rng::seed_from_u64(12);
    let [error, across @ ..] = [(); 3].map(|()| -> Vec<f64> {
        let normal = StandardNormal.sample_iter(&mut rng);
        normal
            .take(samples.q.len())
            .map(|v: f64| 6e-4 * v)
            .collect()
    });
    let slow = samples.time.iter().map(|t| probing(0.2 * t, 1.2)[0]);
    samples.q = slow.collect();
    samples.noise_of_q = vec![error.clone()];
    let motion = Motion::prepare(&samples, &settings).unwrap();
    let error_ddq = motion.second_derivative(&motion.noise_of_q[0]);
    samples.q.iter_mut().zip(&error).for_each(|(q, e)| *q += e);
    // Independent of the error that there is.
    samples.noise_of_q = across.to_vec();
    let motion = Motion::prepare(&samples, &settings).unwrap();
    let mut model = fit_base(&motion).unwrap();
    model.effective_samples = 1000.0;
    let left = motion.regressor(&error_ddq).unwrap();
    model.theta[0] = 1.8;
    model.residual = left.iter().map(|e| -1.8 * e).collect();
    let shares = structure(&motion, &model).unwrap();
    let ddq = shares.iter().find(|s| s.variable == Variable::Ddq).unwrap();
    assert!(ddq.share > 0.08, "{ddq:?}");
    assert_eq!(not_white(&shares), None);

    // Beside ten times as much noise of the wrench errors of the motion make none of it.
    let loud: Vec<f64> = StandardNormal
        .sample_iter(&mut rng)
        .take(left.len())
        .collect();
    let level = 10.0 * rms(&model.residual);
    let ddq = motion.at_kept(&motion.ddq);
    let part = 0.4 * level / rms(&ddq);
    let beside = loud.iter().zip(&ddq);
    model.residual = beside.map(|(v, ddq)| level * v + part * ddq).collect();
    let shares = structure(&motion, &model).unwrap();
    assert_eq!(not_white(&shares).map(|s| s.variable), Some(Variable::Ddq));

    let mut table = motion.clone();
    table.noise_of_q.clear();
    let shares = structure(&table, &model).unwrap();
    assert_ne!(not_white(&shares).map(|s| s.variable), Some(Variable::Ddq));
}

/// A tracker that wanders by more than it scatters, beside a path that is crooked by a centimetre.
#[test]
fn a_crooked_path_is_no_noise_and_takes_none_away() {
    let settings = MotionSettings::default();
    let mut straight = record(&PLAIN, 60.0, [4e-5, 0.1], 9);
    let mut rng = ChaCha8Rng::seed_from_u64(10);
    let mut wander = 0.0;
    let keeps = 1.0 - straight.period / 10.0;
    for noise in &mut straight.noise_of_q[0] {
        let step: f64 = StandardNormal.sample(&mut rng);
        wander = keeps * wander + (1.0 - keeps * keeps).sqrt() * 1.5e-3 * step;
        *noise += wander;
    }
    let mut crooked = straight.clone();
    for (noise, q) in crooked.noise_of_q[0].iter_mut().zip(&crooked.q) {
        *noise += 0.01 * (2.0 * q).cos();
    }
    let shake = |samples: &JointSamples| {
        let motion = Motion::prepare(samples, &settings).unwrap();
        let ddq = motion.second_derivative(&motion.noise_of_q[0]);
        rms(&motion.regressor(&ddq).unwrap())
    };
    let motion = Motion::prepare(&straight, &settings).unwrap();
    let raw = {
        let work = (motion.period / straight.period).round() as usize;
        let raw: Vec<f64> = straight.noise_of_q[0]
            .iter()
            .step_by(work)
            .copied()
            .collect();
        let smooth = LowPass::butterworth(4, 20.0, 1.0 / motion.period).unwrap();
        let raw = smooth.zero_phase(&raw[..motion.q.len()]).unwrap();
        rms(&motion.regressor(&motion.second_derivative(&raw)).unwrap())
    };
    for (name, shaken) in [("straight", shake(&straight)), ("crooked", shake(&crooked))] {
        assert!(
            (0.97..1.03).contains(&(shaken / raw)),
            "{name}: {shaken} of {raw}"
        );
    }
}

/// What a complete model leaves is no burst; a seal that sticks a little at every third opening is one, where it is; outliers are, at no one place.
#[test]
fn a_residual_that_bursts_is_no_noise() {
    let noisy = record(&PLAIN, 60.0, [4e-5, 0.1], 9);
    let motion = Motion::prepare(&noisy, &MotionSettings::default()).unwrap();
    let model = fit_base(&motion).unwrap();
    let seen = |residual: &[f64]| bursts(&motion, residual, model.effective_samples);
    assert_eq!(seen(&model.residual), None);

    let mut sealed = model.residual.clone();
    for (&i, r) in motion.kept.iter().zip(&mut sealed) {
        let opens = motion.stroke[i] % 6 < 2 && motion.sign[i] > 0.0;
        if opens && (0.04..0.13).contains(&motion.q[i]) {
            *r += 8.0 * model.rms;
        }
    }
    let seal = seen(&sealed).unwrap();
    assert!(seal.kurtosis > 6.0 && seal.forward, "{seal:?}");
    assert!(seal.at_a_place && seal.share > 0.8, "{seal:?}");
    assert!(seal.q[0] < 0.05 && seal.q[1] > 0.1, "{seal:?}");

    let mut rng = ChaCha8Rng::seed_from_u64(3);
    for count in [1, 3, 10, 40] {
        for _ in 0..20 {
            let mut jumps = model.residual.clone();
            for _ in 0..count {
                let at = rng.random_range(0..jumps.len());
                jumps[at] += 12.0 * model.rms;
            }
            let jumps = seen(&jumps).unwrap();
            assert!(!jumps.at_a_place, "{count}: {jumps:?}");
        }
    }
}

#[test]
fn the_stated_uncertainty_covers_the_truth() {
    let (mut inside, mut square) = (0, 0.0);
    for seed in 0..40 {
        let motion = Motion::prepare(
            &record(&PLAIN, 20.0, [8e-5, 0.2], 50 + seed),
            &MotionSettings::default(),
        )
        .unwrap();
        let model = fit_with_mechanism(&motion, &[&RigidBody]).unwrap();
        let (value, std) = (
            model.value("inertia").unwrap(),
            model.std("inertia").unwrap(),
        );
        inside += usize::from((value - 2.5).abs() < 1.96 * std);
        square += ((value - 2.5) / std).powi(2) / 40.0;
    }
    assert!(inside >= 34, "{inside} of 40 within 95 %");
    assert!(square > 0.4, "stated far too wide: {square}");
}

#[test]
fn the_joint_fits_stated_uncertainty_covers_the_truth() {
    let mut squares = [0.0; 3];
    for seed in 0..24 {
        // The tracker's noise is what the joint fit is for.
        let samples = record(&PLAIN, 30.0, [4e-4, 0.05], 150 + seed);
        let motion = Motion::prepare(&samples, &MotionSettings::default()).unwrap();
        let (_, jointly) = fit_jointly(&motion, &[&RigidBody], f64::INFINITY).unwrap();
        let terms = jointly.unwrap().terms;
        for ((term, truth), square) in terms.iter().zip([2.5, 1.2, 0.8]).zip(&mut squares) {
            let away = (term.value.unwrap() - truth) / term.std.unwrap();
            *square += away * away / 24.0;
        }
    }
    println!("{squares:.2?}");
    // Friction is stated 1.4 times as wide as it scatters, and all a little wider for Student's distribution.
    assert!((0.4..1.6).contains(&squares[0]), "{squares:?}");
    assert!(
        squares[1..]
            .iter()
            .all(|square| (0.2..1.2).contains(square)),
        "{squares:?}"
    );
}

#[test]
fn friction_along_one_way_is_not_told_from_a_load() {
    let samples = record(&PLAIN, 30.0, [2e-5, 0.02], 7);
    let mut motion = Motion::prepare(&samples, &MotionSettings::default()).unwrap();
    let mut model = fit_base(&motion).unwrap();
    model.withdraw_friction_of_one_way(&motion);
    assert!(model.value("coulomb").is_some() && model.value("viscous").is_some());
    let forward = motion.dq.clone();
    motion.kept.retain(|i| forward[*i] > 0.0);
    let mut model = fit_base(&motion).unwrap();
    model.withdraw_friction_of_one_way(&motion);
    for name in ["coulomb", "viscous"] {
        assert_eq!(model.value(name), None);
        let reason = &model.not_identified[name];
        assert!(
            reason.contains("0 % of its range") && reason.contains("there and back"),
            "{reason}"
        );
    }
    assert!(model.value("inertia").is_some());
}

#[test]
fn a_long_rest_at_the_end_leaves_the_drift_of_the_bias_known() {
    let samples = record(&PLAIN, 300.0, [2e-5, 0.02], 6);
    let mut motion = Motion::prepare(&samples, &MotionSettings::default()).unwrap();
    let rests = |t: f64| t > 185.0;
    let Motion {
        kept, slides, time, ..
    } = &mut motion;
    kept.retain(|i| !rests(time[*i]));
    slides
        .iter_mut()
        .zip(&*time)
        .for_each(|(slides, t)| *slides &= !rests(*t));
    let model = fit_with_mechanism(&motion, &[&RigidBody, &BiasDrift]).unwrap();
    let inertia = model.value("inertia").unwrap();
    assert!((inertia / PLAIN.inertia - 1.0).abs() < 0.01, "{inertia}");
}

/// A closer whose damping has an edge at 0.4 and a relief valve at 5 N m, past which a tenth builds up.
const RELIEVED: Object = Object {
    inertia: 3.0,
    coulomb: 1.0,
    viscous: 0.5,
    mechanism: |q, dq| {
        let oil = if q > 0.4 { 14.0 } else { 7.0 } * (-dq).max(0.0);
        6.0 + 3.0 * q
            - if oil > 5.0 {
                5.0 + 0.1 * (oil - 5.0)
            } else {
                oil
            }
    },
};

#[test]
fn a_relief_valve_and_an_edge_are_followed_and_friction_is_right_or_withdrawn() {
    let samples = record(&RELIEVED, 60.0, [2e-5, 0.08], 4);
    let motion = Motion::prepare(&samples, &MotionSettings::default()).unwrap();
    let model = fit_with_mechanism(&motion, &[&RigidBody]).unwrap();
    let mechanism = model.mechanism.as_ref().unwrap();
    let [opening, closing] = &mechanism.valves;
    assert!(opening.is_straight(), "{opening:?}");
    assert_eq!(closing.bends.len(), 1, "{closing:?}");
    assert!(
        (closing.bends[0].at - 5.0).abs() < 0.5 && (closing.bends[0].slope - 0.1).abs() < 0.05,
        "{closing:?}"
    );
    assert!(
        (model.value("inertia").unwrap() / 3.0 - 1.0).abs() < 0.02,
        "{:?}",
        model.terms
    );
    for (name, truth) in [("coulomb", 1.0), ("viscous", 0.5)] {
        match model.value(name) {
            Some(value) => assert!(
                (value - truth).abs() < 0.1 * truth
                    || (value - truth).abs() < 2.5 * model.std(name).unwrap(),
                "{:?}",
                model.terms
            ),
            None => assert!(
                model.not_identified.contains_key(name),
                "{:?}",
                model.not_identified
            ),
        }
    }
    assert!(
        model.held_out_rms < 0.05 * rms(&motion.regressor(&motion.tau).unwrap()),
        "{}",
        model.held_out_rms
    );
}

#[test]
fn an_unsure_lever_widens_inertia_by_force_and_path() {
    let motion = Motion::prepare(
        &record(&PLAIN, 30.0, [4e-5, 0.1], 1),
        &MotionSettings::default(),
    )
    .unwrap();
    let sure = fit_base(&motion).unwrap();
    // The angle is the path over the lever, or a rotation in part.
    for (by_path, power) in [(1.0, 2.0), (0.25, 1.25)] {
        let mut unsure = sure.clone();
        unsure.widen_for_lever(0.01, by_path);
        for (name, power) in [("inertia", power), ("coulomb", 1.0)] {
            let [own, widened] = [&sure, &unsure].map(|model| model.std(name).unwrap());
            let extra = (widened.powi(2) - own.powi(2)).sqrt();
            assert!(
                (extra / (0.01 * sure.value(name).unwrap()) - power).abs() < 1e-9,
                "{name}: {extra}"
            );
            assert_eq!(unsure.value(name), sure.value(name));
        }
    }
}

#[test]
fn the_wrench_tells_of_a_heavy_objects_acceleration() {
    let heavy = Object {
        inertia: 25.0,
        ..CLOSER
    };
    // A tracker whose noise, as acceleration of 25 kg m^2, is far above that of the wrench.
    let samples = record(&heavy, 40.0, [2e-4, 0.05], 3);
    let motion = Motion::prepare(&samples, &MotionSettings::default()).unwrap();
    let (plain, together) = fit_jointly(&motion, &[&RigidBody], f64::INFINITY).unwrap();
    let together = together.unwrap();
    assert!(
        together.held_out_rms < 0.8 * plain.held_out_rms,
        "{} {}",
        together.held_out_rms,
        plain.held_out_rms
    );
    let inertia = together.terms[0].value.unwrap();
    assert!((inertia / 25.0 - 1.0).abs() < 0.01, "{inertia}");
}

#[test]
fn the_tools_own_inertia_brings_the_trackers_noise_into_the_effort_and_the_joint_fit_knows_it() {
    let tool = 2.0;
    let noise = 1e-3;
    let mut samples = record(&PLAIN, 40.0, [noise, 0.05], 3);
    let true_to_life = record(&PLAIN, 40.0, [0.0, 0.05], 3);
    // What of the noise the tool's inertia brought with it when it was taken off.
    let filter = LowPass::butterworth(4, 20.0, 1000.0).unwrap();
    let of_poses: Vec<f64> = samples
        .q
        .iter()
        .zip(&true_to_life.q)
        .map(|(a, b)| a - b)
        .collect();
    let smooth = filter.zero_phase_settled(&of_poses).unwrap();
    let acceleration = second_derivative(&smooth, 1e-3);
    for (tau, a) in samples.tau.iter_mut().zip(acceleration) {
        *tau -= tool * a;
    }
    let error = |samples: &JointSamples, whole_below: f64| {
        let motion = Motion::prepare(samples, &MotionSettings::default()).unwrap();
        let (model, together) = fit_jointly(&motion, &[&RigidBody], whole_below).unwrap();
        let together = together.unwrap();
        let inertia = together.terms[0].value.unwrap();
        assert_eq!(together.stands, model.value("inertia") == Some(inertia));
        (inertia / 2.5 - 1.0, together.stands)
    };
    let (unaware, _) = error(&samples, f64::INFINITY);
    samples.aside.tool_inertia = tool;
    let (aware, stands) = error(&samples, f64::INFINITY);
    assert!(aware.abs() < 0.01, "{aware}");
    assert!(unaware.abs() > 3.0 * aware.abs(), "{unaware} {aware}");
    assert!(stands);
    let (_, stands) = error(&samples, 0.0);
    assert!(
        !stands,
        "where the model lacks something it presumes too much"
    );
}

#[test]
fn what_a_soft_stop_carries_is_in_no_sample_of_the_fit_and_what_a_catch_takes_is() {
    let stop = Object {
        mechanism: |q, _| -1500.0 * (0.06 - q).max(0.0),
        ..PLAIN
    };
    let settings = MotionSettings::default();
    let motion = Motion::prepare(&record(&stop, 25.0, [5e-5, 0.02], 3), &settings).unwrap();
    assert!(motion.kept.iter().all(|&i| motion.q[i] > 0.06));
    assert!(motion.kept.iter().any(|&i| motion.q[i] < 0.4));
    let model = fit_base(&motion).unwrap();
    for (name, truth) in [("inertia", 2.5), ("coulomb", 1.2), ("viscous", 0.8)] {
        let value = model.value(name).unwrap();
        assert!((value / truth - 1.0).abs() < 0.01, "{name} {value}");
    }
    assert!(model.rms < 0.03, "{}", model.rms);
    let catch = Object {
        mechanism: |q, _| {
            if q < 0.06 {
                8.0 * (1.0 - q / 0.06)
            } else {
                0.0
            }
        },
        ..PLAIN
    };
    let motion = Motion::prepare(&record(&catch, 40.0, [5e-5, 0.02], 3), &settings).unwrap();
    assert!(motion.kept.iter().any(|&i| motion.q[i] < 0.04));
}

#[test]
fn friction_that_turns_late_is_within_what_is_stated() {
    let rough = Object {
        inertia: 0.5,
        coulomb: 6.0,
        ..PLAIN
    };
    let samples = record(&rough, 40.0, [1e-5, 2e-3], 5);
    let mut late = samples.clone();
    let way = |i: usize| probing(samples.time[i], 1.2)[1].signum();
    for i in 2..late.tau.len() {
        late.tau[i] += rough.coulomb * (way(i - 2) - way(i));
    }
    let fit = |samples: &JointSamples, leave_out: bool| {
        let mut motion = Motion::prepare(samples, &MotionSettings::default()).unwrap();
        if leave_out {
            motion.leave_out_turns();
        }
        let fit = fit_with_mechanism(&motion, &[&RigidBody]).unwrap();
        (fit.value("inertia").unwrap(), fit.std("inertia").unwrap())
    };
    for leave_out in [false, true] {
        let [(on_time, std), (too_late, _)] = [&samples, &late].map(|one| fit(one, leave_out));
        let moved = (too_late - on_time).abs();
        // By 2 ms: some standard deviations.
        assert!((1.5..3.5).contains(&(moved / std)), "{moved} {std}");
    }
}

/// A light drawer that a hand's spring and damper shake: it sticks for some ms as it turns.
fn sticking(object: &Object, seconds: f64) -> JointSamples {
    const STEPS: usize = 10;
    let dt = 1e-3 / STEPS as f64;
    let mut samples = record(object, seconds, [0.0; 2], 0);
    samples.kind = JointKind::Prismatic;
    let [mut q, mut dq] = [0.1, 0.0];
    for i in 0..samples.q.len() {
        for k in 0..STEPS {
            let t = samples.time[i] + k as f64 * dt;
            // Two to three times a second, and slowly to and fro.
            let (fast, slow) = (TAU * (2.0 * t + 0.5 * (0.3 * t).sin()), 0.7 * t);
            let wanted = 0.2 - 0.1 * slow.cos() + 0.025 * fast.sin();
            let speed =
                0.07 * slow.sin() + 0.025 * TAU * (2.0 + 0.15 * (0.3 * t).cos()) * fast.cos();
            let hand = object.inertia * (400.0 * (wanted - q) + 30.0 * (speed - dq));
            if k == 0 {
                (samples.q[i], samples.tau[i]) = (q, hand);
            }
            let free = dq + dt * (hand - object.viscous * dq) / object.inertia;
            let most = dt * object.coulomb / object.inertia;
            let slid = free - free.clamp(-most, most);
            // Friction stops it and drives it nowhere.
            dq = if dq * slid < 0.0 { 0.0 } else { slid };
            q += dt * dq;
        }
    }
    samples
}

#[test]
fn a_joint_that_sticks_as_it_turns_leaves_nothing() {
    let light = Object {
        inertia: 1.0,
        coulomb: 1.5,
        viscous: 2.0,
        mechanism: |_, _| 0.0,
    };
    let samples = sticking(&light, 30.0);
    let mut motion = Motion::prepare(&samples, &MotionSettings::default()).unwrap();
    motion.leave_out_turns();
    let fit = fit_base(&motion).unwrap();
    for (name, truth) in [("inertia", 1.0), ("coulomb", 1.5), ("viscous", 2.0)] {
        let error = fit.value(name).unwrap() / truth - 1.0;
        assert!(error.abs() < 2e-3, "{name} {error}");
    }
    assert!(fit.relative_error < 1e-3, "{}", fit.relative_error);
}

#[test]
fn what_position_noise_takes_from_the_inertia_is_given_back() {
    let (mut found, mut untold) = (Vec::new(), Vec::new());
    for seed in 0..4 {
        let mut noisy = record(&PLAIN, 50.0, [4e-3, 0.02], seed);
        let inertia = |samples: &JointSamples| {
            let motion = Motion::prepare(samples, &MotionSettings::default()).unwrap();
            let fit = fit_with_mechanism(&motion, &[&RigidBody]).unwrap();
            fit.value("inertia").unwrap() / PLAIN.inertia - 1.0
        };
        found.push(inertia(&noisy));
        noisy.noise_of_q.clear();
        untold.push(inertia(&noisy));
    }
    let mean = |errors: &[f64]| errors.iter().sum::<f64>() / errors.len() as f64;
    let (found, untold) = (mean(&found), mean(&untold));
    assert!(found.abs() < 0.4 * untold.abs(), "{found} {untold}");
    assert!(untold < -0.005, "{untold}");
}

#[test]
fn what_a_spring_took_for_the_inertia_goes_back_with_it() {
    let spring = Object {
        mechanism: |q, _| 4.0 * q,
        ..PLAIN
    };
    let slope = |samples: &JointSamples| {
        let motion = Motion::prepare(samples, &MotionSettings::default()).unwrap();
        let fit = fit_with_mechanism(&motion, &[&RigidBody]).unwrap();
        let mechanism = fit.mechanism.unwrap();
        let load = |q| mechanism.effort(q, 0.0);
        (load(0.9) - load(0.3)) / 0.6 / 4.0 - 1.0
    };
    let (mut found, mut untold) = (0.0_f64, 0.0_f64);
    for seed in 0..4 {
        let mut noisy = record(&spring, 50.0, [6e-3, 0.02], seed);
        found += slope(&noisy) / 4.0;
        noisy.noise_of_q.clear();
        untold += slope(&noisy) / 4.0;
    }
    assert!(untold.abs() > 0.01, "{untold}");
    assert!(found.abs() < 0.5 * untold.abs(), "{found} {untold}");
}

#[test]
fn an_inertia_under_the_trackers_noise_is_not_claimed() {
    let samples = record(&PLAIN, 30.0, [0.04, 0.02], 1);
    let motion = Motion::prepare(&samples, &MotionSettings::default()).unwrap();
    let fit = fit_with_mechanism(&motion, &[&RigidBody]).unwrap();
    assert_eq!(fit.value("inertia"), None);
    let why = &fit.not_identified["inertia"];
    assert!(why.contains("noise of the poses"), "{why}");
}
