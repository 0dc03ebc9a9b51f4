//! What a recording of a scenario will be like, without noise.

use nalgebra::{DMatrix, DVector, Vector3};
use serde::Serialize;

use crate::scenario::{Scenario, ScenarioError};
use crate::scene::Scene;
use crate::tool::ContactWrench;
use crate::truth::Declared;

const RATE_HZ: f64 = 500.0;
const CUT_OFF_HZ: f64 = 6.0;

/// How far undeclared effects move the effort that devices without noise would give, N m or N, rms from grasp to release.
///
/// The difference is taken between the effort that is measured and the one that the declared parts need for the motion that
/// is measured; at rest, only what exceeds the declared breakaway counts, and on
/// a stop nothing does. All of it goes through one low-pass without lag,
/// half power at 6 Hz, as accelerations from a tracker must.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct EffortMoved {
    /// Of the measured effort itself.
    pub effort_rms: f64,
    /// Of the difference.
    pub moved_rms: f64,
    /// Of what inertia, dry and viscous friction and a constant, fitted to the difference while the hand moves at more than
    /// 0.01 m/s, leave of it there.
    pub unabsorbed_rms: f64,
}

/// A trial run.
#[derive(Clone, Copy, Debug)]
pub(super) struct Probed {
    pub(super) moved: EffortMoved,
    rest_share: f64,
    open_share: f64,
    fastest: f64,
    strongest_n: f64,
    strength_n: f64,
    moving_share: f64,
}

struct Sample {
    effort: f64,
    moved: f64,
    moves: bool,
    basis: [f64; 4],
}

impl Probed {
    pub(super) fn of(scenario: &Scenario, seed: u64) -> Result<Self, ScenarioError> {
        let mut scene = Scene::new(scenario, seed, None)?;
        let setting = scene.setting().clone();
        let declared = Declared::new(scenario, &setting);
        let [closed, open] = setting.joint.range;
        let share = |q: f64| (q - closed) / (open - closed);
        let lever = setting.lever();
        let mut made = Self {
            moved: EffortMoved {
                effort_rms: 0.0,
                moved_rms: 0.0,
                unabsorbed_rms: 0.0,
            },
            rest_share: share(scene.world.state().q),
            open_share: 0.0,
            fastest: 0.0,
            strongest_n: 0.0,
            strength_n: scenario.person.max_force_n,
            moving_share: 0.0,
        };
        let (mut samples, mut moving) = (Vec::new(), 0);
        let steps = ((scene.timeline.release - scene.timeline.grasp) * RATE_HZ) as u32;
        for step in 1..steps {
            let t = scene.timeline.grasp + f64::from(step) / RATE_HZ;
            scene.advance_to(t);
            let (wrench, seen) = scene.perceived(t);
            let own = scene
                .tool
                .sensor_wrench(&seen.tcp, &ContactWrench::default());
            let rotation = seen.tcp.rotation * scene.tool.tcp_from_ft_sensor.rotation;
            let origin = seen.tcp.position
                + seen.tcp.rotation * scene.tool.tcp_from_ft_sensor.translation.vector;
            let on_object = |first: usize| {
                -(rotation * Vector3::from_fn(|row, _| wrench[first + row] - own[first + row]))
            };
            let effort = setting.joint.effort_of(origin, on_object(0), on_object(3));
            let hand = seen.hand;
            let needed = declared.effort(hand.value, hand.rate, hand.rate_change);
            let on_a_stop = |q: f64| !(closed..=open).contains(&q);
            let moved = if on_a_stop(hand.value) || on_a_stop(seen.moment.state.q) {
                0.0
            } else if hand.rate == 0.0 {
                let held = effort - needed;
                held.signum() * (held.abs() - declared.breakaway()).max(0.0)
            } else {
                effort - needed
            };
            let direction = if hand.rate == 0.0 {
                0.0
            } else {
                hand.rate.signum()
            };
            samples.push(Sample {
                effort,
                moved,
                moves: hand.rate.abs() * lever > 0.01,
                basis: [hand.rate_change, direction, hand.rate, 1.0],
            });
            moving += usize::from(hand.rate.abs() * lever > 0.02);
            made.open_share = made.open_share.max(share(seen.moment.state.q));
            made.fastest = made.fastest.max(hand.rate.abs() * lever);
            made.strongest_n = made.strongest_n.max(seen.moment.tool_effort.abs() / lever);
        }
        made.moving_share = moving as f64 / samples.len() as f64;
        made.moved = summary(&samples);
        Ok(made)
    }

    /// Whether a person would have called it a recording.
    pub(super) fn is_sound(&self) -> bool {
        self.rest_share < 0.06
            && (0.75..1.05).contains(&self.open_share)
            && (0.25..3.0).contains(&self.fastest)
            && self.strongest_n < 1.5 * self.strength_n
            && self.moving_share > 0.35
            && self.moved.effort_rms.is_finite()
    }
}

fn summary(samples: &[Sample]) -> EffortMoved {
    let rms = |values: &DVector<f64>| (values.norm_squared() / values.len() as f64).sqrt();
    let column = |of: &dyn Fn(&Sample) -> f64| {
        let mut values: Vec<f64> = samples.iter().map(of).collect();
        smooth(&mut values);
        DVector::from_vec(values)
    };
    let moves: Vec<usize> = (0..samples.len())
        .filter(|row| samples[*row].moves)
        .collect();
    let effort = column(&|sample| sample.effort);
    let moved = column(&|sample| sample.moved);
    let basis: [DVector<f64>; 4] = std::array::from_fn(|term| column(&|sample| sample.basis[term]));
    let basis = DMatrix::from_columns(&basis).select_rows(&moves);
    let moving = moved.select_rows(&moves);
    let fitted = (basis.transpose() * &basis)
        .cholesky()
        .map(|normal| normal.solve(&(basis.transpose() * &moving)));
    let left = fitted.map_or_else(|| moving.clone(), |theta| &moving - &basis * theta);
    EffortMoved {
        effort_rms: rms(&effort),
        moved_rms: rms(&moved),
        unabsorbed_rms: rms(&left),
    }
}

/// Two first-order low-passes, forth and back each.
fn smooth(values: &mut [f64]) {
    // Four poles of that kind have half power at the cut-off when each has it at this many times the cut-off.
    let each_hz = CUT_OFF_HZ / (2.0_f64.powf(0.25) - 1.0).sqrt();
    let weight = 1.0 - (-std::f64::consts::TAU * each_hz / RATE_HZ).exp();
    for _ in 0..2 {
        for _ in 0..2 {
            let mut state = values.first().copied().unwrap_or(0.0);
            for value in values.iter_mut() {
                state += weight * (*value - state);
                *value = state;
            }
            values.reverse();
        }
    }
}
