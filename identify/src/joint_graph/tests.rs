use super::*;
use crate::screw::select;
use nalgebra::Unit;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

/// A hand's strokes over a range: sums of sines that start at rest at 0.
fn strokes(t: f64, range: f64) -> f64 {
    let wave = 0.5 - 0.5 * (0.7 * t).cos() * (0.8 + 0.2 * (0.19 * t).cos());
    range * wave * (1.0 - (-t).exp())
}

/// Tool poses on `axis` at 50 Hz with white noise and an exponentially correlated wander.
fn track(
    axis: &ScrewAxis,
    handle: Point3<f64>,
    range: f64,
    seed: u64,
    wander: [f64; 2],
) -> PoseSamples {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut draw = || Vector3::from_fn(|_, _| StandardNormal.sample(&mut rng));
    let (period, rho) = (0.02, (-0.02_f64 / 10.0).exp());
    let start: UnitQuaternion<f64> = UnitQuaternion::from_scaled_axis(Vector3::new(0.3, -0.8, 1.1));
    let mut drift = [draw() * wander[0], draw() * wander[1]];
    let mut samples = PoseSamples {
        starts: vec![0],
        period,
        ..PoseSamples::default()
    };
    for i in 0..3000 {
        for (d, size) in drift.iter_mut().zip(wander) {
            let kick: Vector3<f64> = draw();
            *d = *d * rho + kick * (size * (1.0 - rho * rho).sqrt());
        }
        let motion = axis.motion(strokes(i as f64 * period, range));
        samples
            .positions
            .push(motion * handle + drift[0] + draw() * 1e-5);
        let error = drift[1] + draw() * 1e-4;
        samples
            .rotations
            .push(UnitQuaternion::from_scaled_axis(error) * motion.rotation * start);
    }
    samples
}

fn door() -> (ScrewAxis, Point3<f64>) {
    let direction = Unit::new_normalize(Vector3::new(0.05, -0.02, 1.0));
    let axis = ScrewAxis {
        direction,
        point: Point3::new(0.4, -1.2, 0.0),
        kind: JointKind::Revolute,
    };
    (axis, Point3::new(1.15, -1.0, 1.05))
}

#[test]
fn a_door_axis_is_found_despite_the_trackers_wander() {
    let (truth, handle) = door();
    for seed in 0..10 {
        let samples = track(&truth, handle, 1.2, seed, [3e-3, 3.5e-3]);
        let chosen = select(&samples).unwrap();
        assert_eq!(chosen.kind, JointKind::Revolute, "seed {seed}");
        let joint = refine(&samples, &chosen);
        let (angle, distance) = joint.axis.separation(&truth);
        assert!(
            angle.to_degrees() < 0.5,
            "seed {seed}: {} deg",
            angle.to_degrees()
        );
        assert!(distance < 5e-3, "seed {seed}: {distance} m");
        assert!(joint.uses_rotations);
    }
}

#[test]
fn the_stated_uncertainty_covers_the_error() {
    let (truth, handle) = door();
    let (mut direction, mut position, mut radius) = (0.0, 0.0, 0.0);
    let true_radius = truth.distance(&handle);
    for seed in 0..40 {
        let samples = track(&truth, handle, 1.0, 100 + seed, [2e-3, 3e-3]);
        let joint = refine(&samples, &select(&samples).unwrap());
        let (angle, _) = joint.axis.separation(&truth);
        let offset = truth.point - joint.axis.point;
        let across = offset - truth.direction.into_inner() * truth.direction.dot(&offset);
        direction += (angle / joint.direction_std).powi(2) / 40.0;
        position += (across.norm() / joint.position_std).powi(2) / 40.0;
        let error = joint.axis.distance(&joint.tool_position) - true_radius;
        radius += (error / joint.radius_std).powi(2) / 40.0;
    }
    // Mean squared error over stated variance: 1 when the covariance is honest.
    assert!((0.3..2.5).contains(&direction), "direction: {direction}");
    assert!((0.3..2.5).contains(&position), "position: {position}");
    assert!((0.3..2.5).contains(&radius), "radius: {radius}");
}

#[test]
fn a_short_arc_is_one_when_the_tool_turns_as_it_does() {
    let (truth, handle) = door();
    for seed in 0..10 {
        // 7 degrees bend by a millimetre, and each position is off by nearly as much.
        let mut samples = track(&truth, handle, 0.12, 300 + seed, [1e-4, 1e-3]);
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        for position in &mut samples.positions {
            let off = Vector3::from_fn(|_, _| StandardNormal.sample(&mut rng));
            *position += off * 7e-4;
        }
        let chosen = select(&samples).unwrap();
        assert_eq!(chosen.kind, JointKind::Revolute, "seed {seed}");
        let joint = refine(&samples, &chosen);
        let error = joint.axis.distance(&joint.tool_position) - truth.distance(&handle);
        let std = joint.radius_std;
        assert!(error.abs() < 4.0 * std, "seed {seed}: {error} ± {std} m");
    }
}

#[test]
fn a_drawer_is_a_line_also_when_the_wander_bends_it() {
    let direction = Unit::new_normalize(Vector3::new(1.0, 0.2, -0.03));
    let truth = ScrewAxis {
        direction,
        point: Point3::new(0.2, 0.1, 0.6),
        kind: JointKind::Prismatic,
    };
    for seed in 0..10 {
        let samples = track(&truth, truth.point, 0.4, 200 + seed, [3e-3, 3.5e-3]);
        let chosen = select(&samples).unwrap();
        assert_eq!(chosen.kind, JointKind::Prismatic, "seed {seed}");
        let joint = refine(&samples, &chosen);
        let (angle, _) = joint.axis.separation(&truth);
        assert!(
            angle.to_degrees() < 0.5,
            "seed {seed}: {} deg",
            angle.to_degrees()
        );
        assert_eq!(joint.position_std, 0.0);
    }
}

#[test]
fn positions_alone_give_the_door_too() {
    let (truth, handle) = door();
    let mut samples = track(&truth, handle, 1.2, 5, [5e-4, 0.0]);
    samples.rotations.clear();
    let joint = refine(&samples, &select(&samples).unwrap());
    let (angle, distance) = joint.axis.separation(&truth);
    assert!(!joint.uses_rotations);
    assert!(
        angle.to_degrees() < 0.5 && distance < 5e-3,
        "{} deg, {distance} m",
        angle.to_degrees()
    );
}

#[test]
fn single_outliers_do_not_move_the_axis() {
    let (truth, handle) = door();
    let mut samples = track(&truth, handle, 1.2, 6, [1e-3, 1e-3]);
    for i in (0..samples.positions.len()).step_by(97) {
        samples.positions[i] += Vector3::new(0.2, -0.1, 0.3);
        samples.rotations[i] =
            UnitQuaternion::from_scaled_axis(Vector3::new(1.0, 0.0, 0.4)) * samples.rotations[i];
    }
    let joint = refine(&samples, &select(&samples).unwrap());
    let (angle, distance) = joint.axis.separation(&truth);
    assert!(
        angle.to_degrees() < 0.5 && distance < 5e-3,
        "{} deg, {distance} m",
        angle.to_degrees()
    );
}

#[test]
fn a_tool_that_turns_in_the_hand_is_not_believed() {
    let (truth, handle) = door();
    let mut samples = track(&truth, handle, 1.2, 7, [1e-3, 1e-3]);
    let still = samples.rotations[0];
    samples.rotations.fill(still);
    let chosen = select(&samples).unwrap();
    assert_eq!(chosen.kind, JointKind::Revolute);
    assert!(!chosen.orientation_agrees);
}

#[test]
fn jacobians_agree_with_finite_differences() {
    for kind in [JointKind::Revolute, JointKind::Prismatic] {
        let direction = Unit::new_normalize(Vector3::new(0.3, -0.4, 0.9));
        let state = State {
            axis: ScrewAxis {
                direction,
                point: Point3::new(0.1, 0.2, 0.3),
                kind,
            },
            p0: Point3::new(0.9, -0.3, 0.5),
            r0: UnitQuaternion::from_scaled_axis(Vector3::new(0.2, 0.1, -0.5)),
            q: vec![0.8],
            wander: vec![[Vector3::zeros(); 2]],
        };
        let analytic = Frame::new(&state).jacobians(&state, 0.8, &state.axis.motion(0.8).rotation);
        let predict = |s: &State| {
            let motion = s.axis.motion(s.q[0]);
            (motion * s.p0, motion.rotation * s.r0)
        };
        let skip: &[usize] = if kind == JointKind::Prismatic {
            &[2, 3]
        } else {
            &[]
        };
        let derivative = |moved: &dyn Fn(f64) -> State| {
            let h = 1e-6;
            let ((p1, r1), (p0, r0)) = (predict(&moved(h)), predict(&moved(-h)));
            let turn = (r1 * r0.inverse()).scaled_axis();
            ((p1 - p0) / (2.0 * h), turn / (2.0 * h))
        };
        let (along, _) = derivative(&|h| State {
            q: vec![0.8 + h],
            ..state.clone()
        });
        assert!((along - analytic.along).norm() < 1e-6, "{kind:?}");
        for column in (0..GEOMETRY).filter(|c| !skip.contains(c)) {
            let (position, rotation) = derivative(&|h| {
                let mut geometry = SVector::zeros();
                geometry[column] = h;
                let mut moved = state.clone();
                moved.shift(&geometry);
                moved
            });
            assert!(
                (position - analytic.geometry[0][column]).norm() < 1e-6,
                "{kind:?} position, column {column}"
            );
            assert!(
                (rotation - analytic.geometry[1][column]).norm() < 1e-6,
                "{kind:?} rotation, column {column}"
            );
        }
    }
}

/// The step that one dense least squares over geometry, every joint coordinate and every wander gives: its geometry and wanders.
fn dense_step(
    state: &State,
    track: &PoseSamples,
    noise: &[Wander; 2],
    active: &[usize],
) -> DVector<f64> {
    let count = track.positions.len();
    let of_wander = |i: usize, part: usize| active.len() + count + 6 * i + 3 * part;
    let unknowns = of_wander(count, 0);
    let (mut h, mut right) = (DMatrix::zeros(unknowns, unknowns), DVector::zeros(unknowns));
    let mut add = |row: &DVector<f64>, residual: f64, std: f64| {
        h += row * row.transpose() / (std * std);
        right += row * (residual / (std * std));
    };
    let frame = Frame::new(state);
    for i in 0..count {
        let motion = state.axis.motion(state.q[i]);
        let jacobians = frame.jacobians(state, state.q[i], &motion.rotation);
        let direction = state.axis.direction.into_inner();
        let leftover = state.leftover(track, i, true);
        for part in 0..2 {
            let Wander {
                white,
                wander,
                time_constant,
            } = noise[part];
            for k in 0..3 {
                let mut row = DVector::zeros(unknowns);
                let mut residual = leftover[part] - state.wander[i][part];
                let across = |v: Vector3<f64>| {
                    if part == 1 && state.axis.kind == JointKind::Revolute {
                        v - direction * direction.dot(&v)
                    } else {
                        v
                    }
                };
                residual = across(residual);
                for (j, column) in active.iter().enumerate() {
                    row[j] = across(jacobians.geometry[part][*column])[k];
                }
                if part == 0 {
                    row[active.len() + i] = jacobians.along[k];
                }
                for other in 0..3 {
                    row[of_wander(i, part) + other] = across(Vector3::ith(other, 1.0))[k];
                }
                add(&row, residual[k], white);
                let rho = (-track.period / time_constant).exp();
                let mut row = DVector::zeros(unknowns);
                row[of_wander(i, part) + k] = 1.0;
                if track.follows(i) {
                    row[of_wander(i - 1, part) + k] = -rho;
                    let error = state.wander[i][part][k] - rho * state.wander[i - 1][part][k];
                    add(&row, -error, wander * (1.0 - rho * rho).sqrt());
                } else {
                    add(&row, -state.wander[i][part][k], wander);
                }
            }
        }
    }
    h.cholesky().unwrap().solve(&right)
}

#[test]
fn a_step_is_that_of_one_dense_least_squares() {
    for kind in [JointKind::Revolute, JointKind::Prismatic] {
        let (axis, handle) = door();
        let point = match kind {
            JointKind::Revolute => axis.point,
            // Of a slide the line that the tool follows.
            JointKind::Prismatic => handle,
        };
        let axis = ScrewAxis {
            kind,
            point,
            ..axis
        };
        let mut samples = track(&axis, handle, 1.2, 8, [1e-3, 1e-3]);
        samples.positions.truncate(60);
        samples.rotations.truncate(60);
        samples.starts = vec![0, 25];
        let mut state = State::start(
            &samples,
            &Candidates {
                axis,
                ..select(&track(&axis, handle, 1.2, 8, [1e-3, 1e-3])).unwrap()
            },
            true,
        );
        for (i, wander) in state.wander.iter_mut().enumerate() {
            let size = 1e-4 * (i as f64).sin();
            *wander = [Vector3::new(size, -size, 2.0 * size); 2];
        }
        let noise = [2e-3, 3e-3].map(|size| Wander {
            white: size,
            wander: 2.0 * size,
            time_constant: 0.7,
        });
        let linear = state.linearize(&samples, true, &noise);
        let active: &[usize] = if kind == JointKind::Revolute {
            &[0, 1, 2, 3, 4, 5, 6, 7]
        } else {
            &[0, 1, 4, 5, 6, 7, 8]
        };
        let (step, dense) = (
            linear.unwrap().solve().unwrap(),
            dense_step(&state, &samples, &noise, active),
        );
        let near = |a: f64, b: f64| (a - b).abs() < 1e-6 * (1e-3 + b.abs());
        for (j, column) in active.iter().enumerate() {
            assert!(
                near(step.geometry[*column], dense[j]),
                "{kind:?}, column {column}: {} {}",
                step.geometry[*column],
                dense[j]
            );
        }
        for (i, wander) in (0..60).flat_map(|i| [(i, 0), (i, 1)]) {
            for k in 0..3 {
                let there = dense[active.len() + 60 + 6 * i + 3 * wander + k];
                assert!(
                    near(step.wanders[wander][i][k], there),
                    "{kind:?}, sample {i}"
                );
            }
        }
    }
}

#[test]
fn each_coordinate_follows_to_where_the_path_is_nearest() {
    for kind in [JointKind::Revolute, JointKind::Prismatic] {
        let (axis, handle) = door();
        let axis = ScrewAxis { kind, ..axis };
        let mut samples = track(&axis, handle, 1.2, 9, [5e-3, 1e-3]);
        samples.positions.truncate(50);
        let mut state = State {
            axis,
            p0: handle,
            r0: UnitQuaternion::identity(),
            // One of them a turn and more away.
            q: (0..50).map(|i| if i == 7 { 7.0 } else { 0.3 }).collect(),
            wander: vec![[Vector3::new(1e-3, 0.0, -2e-3); 2]; 50],
        };
        state.follow(&samples);
        for (i, (position, wander)) in samples.positions.iter().zip(&state.wander).enumerate() {
            let far = |q: f64| (position - wander[0] - axis.motion(q) * handle).norm();
            let q = state.q[i];
            assert!(far(q) <= far(q + 1e-4).min(far(q - 1e-4)), "{kind:?} {i}");
            if kind == JointKind::Revolute {
                let before = if i == 7 { 7.0 } else { 0.3 };
                assert!((q - before).abs() <= core::f64::consts::PI, "{i}: {q}");
            }
        }
    }
}
