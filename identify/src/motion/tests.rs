use super::*;
use core::f64::consts::PI;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Normal};

fn sine(seconds: f64, rate: f64, amplitude: f64) -> JointSamples {
    let count = (seconds * rate) as usize;
    let time: Vec<f64> = (0..count).map(|i| i as f64 / rate).collect();
    let q: Vec<f64> = time
        .iter()
        .map(|t| amplitude * (1.0 - (PI * t).cos()))
        .collect();
    JointSamples {
        kind: JointKind::Revolute,
        period: 1.0 / rate,
        runs: vec![0..count],
        tau: q.iter().map(|q| q * 0.5).collect(),
        q,
        time,
        noise_of_q: Vec::new(),
        aside: crate::samples::Aside::default(),
    }
}

#[test]
fn derivatives_are_those_of_the_motion() {
    let motion = Motion::prepare(&sine(10.0, 1000.0, 0.4), &MotionSettings::default()).unwrap();
    for &i in &motion.kept {
        let t = motion.time[i];
        assert!((motion.dq[i] - 0.4 * PI * (PI * t).sin()).abs() < 1e-3);
        assert!((motion.ddq[i] - 0.4 * PI * PI * (PI * t).cos()).abs() < 5e-3);
    }
}

#[test]
fn strokes_change_at_reversals_only() {
    let motion = Motion::prepare(&sine(10.0, 500.0, 0.4), &MotionSettings::default()).unwrap();
    for (i, stroke) in motion.stroke.iter().enumerate() {
        let t = motion.time[i];
        if (t - t.round()).abs() > 0.02 {
            assert_eq!(*stroke, t.floor() as usize, "at {t} s");
        }
    }
}

#[test]
fn both_directions_are_in_every_fold() {
    let motion = Motion::prepare(&sine(24.0, 500.0, 0.4), &MotionSettings::default()).unwrap();
    let (folds, count) = motion.folds();
    assert_eq!(count, 6);
    for fold in 0..count {
        let signs: Vec<f64> = motion
            .kept
            .iter()
            .zip(&folds)
            .filter(|(_, f)| **f == fold)
            .map(|(&i, _)| motion.sign[i])
            .collect();
        assert!(signs.contains(&1.0) && signs.contains(&-1.0), "fold {fold}");
    }
}

#[test]
fn slow_samples_are_gated_by_name() {
    let mut samples = sine(10.0, 1000.0, 0.4);
    // Held for a second in the middle of a stroke; the quick reversals of the sine are not slow.
    let held = samples.q[4500];
    samples
        .q
        .splice(4500..4500, std::iter::repeat_n(held, 1000));
    samples.q.truncate(10_000);
    let motion = Motion::prepare(&samples, &MotionSettings::default()).unwrap();
    assert!(
        (24..34).contains(&motion.gated["slow"]),
        "{:?}",
        motion.gated
    );
    assert!(motion.gated["border"] > 5);
    assert!(motion.gated["limit"] > 5);
    assert!(
        motion
            .kept
            .iter()
            .all(|&i| !(4.5..5.5).contains(&motion.time[i]))
    );
}

#[test]
fn nothing_is_filtered_across_a_gap() {
    let mut samples = sine(20.0, 500.0, 0.4);
    samples.runs = vec![0..4000, 4000..10000];
    for value in &mut samples.tau[4000..] {
        *value += 100.0;
    }
    let motion = Motion::prepare(&samples, &MotionSettings::default()).unwrap();
    let filtered = motion.filtered(&motion.tau).unwrap();
    let seam = motion.runs[0].end;
    assert!(filtered[seam - 1] < 1.0 && filtered[seam] > 99.0);
}

#[test]
fn a_still_a_short_and_a_crawling_joint_are_refused() {
    // A tracker drifts by as much; a table of a still joint has as much noise.
    let tracked = JointSamples {
        noise_of_q: vec![vec![0.0; 5000]],
        aside: crate::samples::Aside::default(),
        ..sine(10.0, 500.0, 1e-4)
    };
    let settings = MotionSettings::default();
    assert!(matches!(
        Motion::prepare(&tracked, &settings),
        Err(MotionError::NeverMoves { .. })
    ));
    assert!(matches!(
        Motion::prepare(&sine(2.0, 500.0, 0.4), &settings),
        Err(MotionError::TooShort { .. })
    ));
    let mut held = sine(6.0, 500.0, 0.4);
    for (i, q) in held.q.iter_mut().enumerate() {
        *q = if i < 1500 { 0.0 } else { 0.5 };
    }
    assert!(matches!(
        Motion::prepare(&held, &settings),
        Err(MotionError::AllGated { .. })
    ));
}

#[test]
fn the_sign_is_averaged_where_it_changes() {
    // Changes at 0.75, in the cell of sample 1, and at 2.5, on the border of two cells.
    let signs = mean_sign(&[-3.0, 1.0, 2.0, -2.0]);
    assert_eq!(signs, vec![-1.0, 0.5, 1.0, -1.0]);
}

#[test]
fn the_sign_of_a_velocity_changes_when_the_velocity_does_and_not_half_a_step_later() {
    for crossing in [20.1, 20.4, 20.5, 20.75, 20.99] {
        let velocity: Vec<f64> = (0..41).map(|i| f64::from(i) - crossing).collect();
        let sum: f64 = super::mean_sign(&velocity).iter().sum();
        // The integral of the true sign over the cells, from -1/2 to 40 1/2.
        let exact = (40.5 - crossing) - (crossing + 0.5);
        assert!((sum - exact).abs() < 1e-12, "{crossing}: {sum} {exact}");
    }
}

#[test]
fn a_blow_against_the_stop_is_left_out_with_the_filters_ringing_and_a_gentle_turn_is_not() {
    // Strokes of a second between 0.05 and 0.95 turned by hand; at 7.5 s and 8.5 s the joint runs into a stop at 1.0.
    let path = |t: f64| {
        if (7.0..=8.0).contains(&t) || (8.0..=9.0).contains(&t) {
            let u = (t - t.floor() - 0.5).abs();
            (1.0 - 1.9 * u).min(1.0)
        } else {
            0.5 - 0.45 * (core::f64::consts::TAU * t).cos()
        }
    };
    let time: Vec<f64> = (0..16_000).map(|i| 1e-3 * f64::from(i)).collect();
    let q: Vec<f64> = time.iter().map(|t| path(*t)).collect();
    let samples = JointSamples {
        kind: JointKind::Prismatic,
        period: 1e-3,
        runs: vec![0..q.len()],
        tau: q
            .windows(2)
            .map(|w| 2.0 * (w[1] - w[0]).signum())
            .chain([0.0])
            .collect(),
        noise_of_q: Vec::new(),
        aside: crate::samples::Aside::default(),
        q,
        time,
    };
    let motion = Motion::prepare(&samples, &MotionSettings::default()).unwrap();
    let kept = |from: f64, to: f64| {
        motion
            .kept
            .iter()
            .filter(|&&i| motion.time[i] > from && motion.time[i] < to)
            .count()
    };
    assert_eq!(kept(7.3, 7.7) + kept(8.3, 8.7), 0);
    assert!(kept(3.3, 3.7) > 5, "{}", kept(3.3, 3.7));
}

#[test]
fn single_samples_are_filtered_as_the_whole_series() {
    let motion = Motion::prepare(&sine(10.0, 1000.0, 0.4), &MotionSettings::default()).unwrap();
    let series: Vec<f64> = motion.dq.iter().map(|v| v.signum() + v).collect();
    // Where the joint rests what is smooth does not count.
    let smooth = motion.smoothed(&series).unwrap();
    let sliding = series.iter().zip(&smooth).zip(&motion.slides);
    let sliding: Vec<f64> = sliding
        .map(|((v, smooth), slides)| if *slides { *v } else { v - smooth })
        .collect();
    assert!(motion.slides.iter().any(|slides| !slides));
    let whole = motion.at_kept(&motion.filtered(&sliding).unwrap());
    let mut sparse = SparseColumns::with_capacity(series.len(), 1);
    for value in &series {
        sparse.push([(1, *value)]);
    }
    let sparse = motion.sparse_regressor(&sparse, 2);
    let single = motion.regressor(&series).unwrap();
    for (k, whole) in whole.iter().enumerate() {
        assert!((single[k] - whole).abs() < 1e-3, "{k}");
        assert!((sparse[(k, 1)] - single[k]).abs() < 1e-12, "{k}");
        assert_eq!(sparse[(k, 0)], 0.0);
    }
}

/// A series through a kernel at one sample, summed one by one.
fn through(kernel: &kernel::Kernel, runs: &[Range<usize>], at: usize, series: &[f64]) -> f64 {
    let run = runs.iter().find(|run| run.contains(&at)).unwrap();
    let mut sum = 0.0;
    kernel.each(run, at, |i, weight| sum += weight * series[i]);
    sum
}

#[test]
fn a_regressor_is_what_its_two_filters_make_one_after_the_other() {
    // Quick strokes, one that is longer than the filters reach, quick ones; runs that begin and end in motion, one of a second.
    let mut samples = sine(15.6, 1000.0, 0.4);
    for (q, t) in samples.q.iter_mut().zip(&samples.time) {
        let turns = match *t {
            t if t < 6.0 => t,
            t if t < 12.0 => (t - 6.0) / 6.0,
            t => t - 11.0,
        };
        *q = 0.4 * (1.0 - (PI * turns).cos());
    }
    samples.runs = vec![0..5300, 5300..6400, 6400..samples.q.len()];
    let mut motion = Motion::prepare(&samples, &MotionSettings::default()).unwrap();
    let series: Vec<f64> = (0..motion.q.len())
        .map(|i| (i as f64 * 0.7).sin() + motion.q[i])
        .collect();
    let check = |motion: &Motion| {
        let sliding: Vec<f64> = (0..series.len())
            .map(|i| match motion.slides[i] {
                true => series[i],
                false => series[i] - through(&motion.smoother, &motion.runs, i, &series),
            })
            .collect();
        let regressor = motion.regressor(&series).unwrap();
        assert_eq!(regressor.len(), motion.kept.len());
        for (&i, value) in motion.kept.iter().zip(&regressor) {
            let expected = through(&motion.kernel, &motion.runs, i, &sliding);
            assert!((value - expected).abs() < 1e-12, "{i}: {value} {expected}");
        }
        regressor
    };
    assert_eq!(motion.runs.len(), 3);
    assert!(motion.slides.iter().any(|slides| !slides));
    let before = check(&motion);
    // Some samples see no rest and no end, some see the end of the series.
    let (rows, samples) = (motion.rows(), series.len());
    let common = rows.places.iter().filter(|(_, at)| at.start == 0).count();
    assert!((1..rows.places.len()).contains(&common), "{common}");
    let ends = |(from, at): &(usize, Range<usize>)| from + at.len() == samples;
    assert!(rows.places.iter().any(ends));
    assert!(rows.weights.len().is_multiple_of(crate::products::LANES));
    // Other samples and other rests are seen at once, in a clone too.
    let other = motion.clone();
    motion.kept.truncate(100);
    assert_eq!(check(&motion), before[..100]);
    motion.slides[..1000].fill(false);
    assert_ne!(check(&motion), before[..100]);
    assert_eq!(check(&other), before);
}

#[test]
fn columns_that_come_and_go_are_filtered_like_whole_series() {
    // Two runs, of which the second begins in the midst of a stroke.
    let mut samples = sine(10.0, 1000.0, 0.4);
    samples.runs = vec![0..5300, 5300..samples.q.len()];
    let motion = Motion::prepare(&samples, &MotionSettings::default()).unwrap();
    assert!(motion.slides.iter().any(|slides| !slides));
    let entries = |i: usize, dq: f64| -> Vec<(usize, f64)> {
        let value = 1.0 + dq;
        let few = (0..i / 13 % 7).map(|j| ((i / 13 + j) % 9, value * (j + 1) as f64));
        few.collect()
    };
    let mut sparse = SparseColumns::with_capacity(motion.q.len(), 3);
    let mut series = vec![vec![0.0; motion.q.len()]; 9];
    for (i, dq) in motion.dq.iter().enumerate() {
        sparse.push(entries(i, *dq));
        for (column, value) in entries(i, *dq) {
            series[column][i] += value;
        }
    }
    let sparse = motion.sparse_regressor(&sparse, series.len());
    for (j, series) in series.iter().enumerate() {
        let whole = motion.regressor(series).unwrap();
        for (k, whole) in whole.iter().enumerate() {
            assert!((sparse[(k, j)] - whole).abs() < 1e-12, "{j} {k}");
        }
    }
}

#[test]
fn the_one_stroke_faster_than_all_others_does_not_count_as_held_out() {
    let mut samples = sine(24.0, 500.0, 0.4);
    // One period at twice the speed, joined where the joint stands still.
    let fast: Vec<f64> = (0..500)
        .map(|i| 0.4 * (1.0 - (2.0 * PI * f64::from(i) / 500.0).cos()))
        .collect();
    samples.q.splice(10_000..11_000, fast);
    samples.tau.truncate(11_500);
    samples.time.truncate(11_500);
    samples.runs = vec![0..11_500];
    let motion = Motion::prepare(&samples, &MotionSettings::default()).unwrap();
    let covered = motion.covered();
    let speeds = motion.at_kept(&motion.dq);
    for (covered, speed) in covered.iter().zip(&speeds) {
        assert!(*covered || speed.abs() > 0.3, "{speed}");
    }
    let both = |fast: bool| {
        covered
            .iter()
            .zip(&speeds)
            .filter(|(covered, v)| (v.abs() > 1.5) == fast && **covered)
            .count()
    };
    assert!(both(false) > 300);
    assert_eq!(both(true), 0, "the fast period lies in one fold");
}

#[test]
fn the_one_stroke_that_goes_further_than_all_others_does_not_count_there() {
    let mut samples = sine(24.0, 500.0, 0.4);
    // One period is a little wider and slower.
    let wide: Vec<f64> = (0..2000)
        .map(|i| 0.43 * (1.0 - (2.0 * PI * f64::from(i) / 2000.0).cos()))
        .collect();
    samples.q.splice(10_000..11_000, wide);
    samples.q.truncate(12_000);
    let motion = Motion::prepare(&samples, &MotionSettings::default()).unwrap();
    let covered = motion.covered();
    let places = motion.at_kept(&motion.q);
    let counted = |from: f64, to: f64| {
        let at = places.iter().zip(&covered);
        at.filter(|(q, covered)| (from..to).contains(*q) && **covered)
            .count()
    };
    assert!(counted(0.7, 0.8) > 80);
    assert!(places.iter().filter(|q| **q > 0.8).count() > 3);
    assert_eq!(counted(0.8, 0.9), 0, "the others end at 0.8");
}

#[test]
fn a_bent_path_is_no_noise_and_a_slow_wander_stays() {
    let mut samples = sine(20.0, 500.0, 0.4);
    let jitter = |i: usize| 2e-4 * (0.37 * i as f64).sin() * (0.113 * i as f64).cos();
    let bent = |q: &f64| 0.01 * (4.0 * q).sin();
    let wander = |t: &f64| 5e-4 * (0.3 * t).sin();
    samples.noise_of_q = vec![
        samples.q.iter().map(bent).collect(),
        samples.time.iter().map(wander).collect(),
    ];
    for series in &mut samples.noise_of_q {
        for (i, value) in series.iter_mut().enumerate() {
            *value += jitter(i);
        }
    }
    let motion = Motion::prepare(&samples, &MotionSettings::default()).unwrap();
    let [bent, wandering] = [0, 1].map(|k| crate::least_squares::rms(&motion.noise_of_q[k]));
    assert!(bent < 2e-4, "{bent} of a path that bends by 7 mm");
    assert!(wandering > 3e-4, "{wandering} of a wander of 0.35 mm");
}

/// A joint that comes to rest at once at the end of each opening stroke, sticks for 40 ms, and leaves slowly.
#[test]
fn a_joint_that_sticks_turns_when_it_comes_to_rest_unless_noise_forbids_to_look_that_closely() {
    let late = |noise: f64| {
        let mut samples = sine(12.0, 1000.0, 0.4);
        let mut stops = Vec::new();
        let (mut q, mut speed) = (0.0, 0.0);
        for i in 0..samples.q.len() {
            match i % 800 {
                0..300 => speed += 2e-3,
                300..400 => speed -= 6e-3,
                400 => {
                    stops.push(samples.time[i]);
                    speed = 0.0;
                }
                401..440 => {}
                440..620 => speed -= 1.5e-3,
                620..800 => speed += 1.5e-3,
                _ => unreachable!("of 800"),
            }
            q += 1e-3 * speed;
            samples.q[i] = q;
        }
        let random = |i| noise * ((i * 6007 % 4003) as f64 / 4003.0 - 0.5);
        samples.noise_of_q = vec![(0..samples.q.len()).map(random).collect()];
        let motion = Motion::prepare(&samples, &MotionSettings::default()).unwrap();
        let turns =
            (1..motion.sign.len()).filter(|&i| motion.sign[i - 1] > 0.0 && motion.sign[i] <= 0.0);
        let times: Vec<f64> = turns.map(|i| motion.time[i]).collect();
        let after = |stop: &f64| times.iter().map(|t| t - stop).find(|late| *late > -0.1);
        let late: Vec<f64> = stops.iter().filter_map(after).collect();
        assert!(late.len() > 10, "{late:?}");
        quantile(&late, 0.5)
    };
    let (quiet, noisy) = (late(1e-5), late(1e-2));
    assert!(quiet + 0.004 < noisy, "{quiet} {noisy}");
}

/// Four strokes of so many seconds each and four that are twice as fast: of one kind alone load and inertia are one. With noise of 0.2 mrad.
fn of_two_paces(seconds: f64) -> JointSamples {
    let mut samples = sine(6.0 * seconds, 500.0, 0.4);
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let white = Normal::new(0.0, 2e-4).unwrap();
    let series: Vec<f64> = samples.q.iter().map(|_| white.sample(&mut rng)).collect();
    for ((q, t), noise) in samples.q.iter_mut().zip(&samples.time).zip(&series) {
        let strokes = t / seconds;
        let strokes = strokes + (strokes - 4.0).max(0.0);
        *q = 0.4 * (1.0 - (PI * strokes).cos()) + noise;
    }
    samples.noise_of_q = vec![series];
    samples
}

fn quiet_hz(settings: MotionSettings, samples: &JointSamples, others: &[JointSamples]) -> f64 {
    let quiet = settings.quiet_for(samples, others.iter());
    quiet.unwrap().cutoff_hz
}

#[test]
fn a_slow_motion_is_smoothed_until_its_noise_hides_no_acceleration() {
    let hz = |seconds| quiet_hz(MotionSettings::default(), &of_two_paces(seconds), &[]);
    let [slow, quick] = [hz(6.0), hz(1.0)];
    assert!((1.5..5.0).contains(&slow), "{slow} Hz");
    assert!(quick == 6.0, "{quick} Hz");
}

#[test]
fn a_cutoff_that_was_asked_for_or_that_another_recording_needs_stays() {
    let (slow, short) = (of_two_paces(6.0), of_two_paces(0.7));
    let asked = MotionSettings {
        gives_way: false,
        ..MotionSettings::default()
    };
    assert!(quiet_hz(asked, &slow, &[]) == 6.0);
    let alone = quiet_hz(MotionSettings::default(), &slow, &[]);
    let beside = quiet_hz(MotionSettings::default(), &slow, &[short]);
    assert!(alone < beside, "{alone} and {beside} Hz");
}

#[test]
fn three_passes_show_what_time_does() {
    // One pass one way takes a second.
    let shows = |seconds: f64| {
        let motion = Motion::prepare(&sine(seconds, 500.0, 0.4), &MotionSettings::default());
        motion.unwrap().shows_time()
    };
    assert!(!shows(4.2));
    assert!(shows(8.0));
}

#[test]
fn a_visit_to_the_low_end_is_one_until_the_motion_has_gone_away() {
    let mut samples = sine(10.0, 1000.0, 0.4);
    // Back after a few millimetres, and then closed no further than 20 mm.
    for i in 3900..4100 {
        samples.q[i] += 2e-3 * (1.0 - (PI * (i as f64 - 3900.0) / 25.0).cos());
    }
    for q in &mut samples.q[7000..9000] {
        *q = 0.02 + 0.975 * *q;
    }
    let motion = Motion::prepare(&samples, &MotionSettings::default()).unwrap();
    let lowest = motion.visits_to_the_low_end();
    assert_eq!(lowest.len(), 6, "{lowest:?}");
    for (k, lowest) in lowest.iter().enumerate() {
        let there = if k == 4 { 0.02 } else { 0.0 };
        assert!((lowest - there).abs() < 2e-3, "visit {k} at {lowest}");
    }
}
