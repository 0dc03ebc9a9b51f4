//! What lies between the truth and the devices besides their own noise: age, drift, and a mass that nobody knows of.

use std::collections::VecDeque;

use nalgebra::Vector3;

use crate::motion::RigidMotion;
use crate::scenario::EffectSpec;
use crate::scene::Sight;
use crate::world::STEP;

/// The undeclared effects of the measurement.
#[derive(Debug, Default)]
pub(crate) struct Measurement {
    lag: f64,
    /// First slope, N/s and N m/s, and the time constant, s.
    drift: Option<([f64; 6], f64)>,
    /// Mass and where it sits in `ft_sensor`.
    pub(crate) attached: Option<(f64, Vector3<f64>)>,
    past: VecDeque<(f64, Sight)>,
}

impl Measurement {
    pub(crate) fn new(effects: &[EffectSpec]) -> Self {
        let mut made = Self::default();
        for effect in effects {
            match effect {
                EffectSpec::TimeLag { lag_s } => made.lag = *lag_s,
                EffectSpec::SensorDrift {
                    force_n_per_min: force,
                    torque_nm_per_min: torque,
                    warm_up_s,
                } => {
                    let per_min = [
                        force[0], force[1], force[2], torque[0], torque[1], torque[2],
                    ];
                    let time = warm_up_s.unwrap_or(f64::INFINITY);
                    made.drift = Some((per_min.map(|slope| slope / 60.0), time));
                }
                EffectSpec::ToolMass { mass_kg, at_m } => {
                    made.attached = Some((*mass_kg, Vector3::from(*at_m)));
                }
                _ => {}
            }
        }
        made
    }

    /// Whether what was so must be remembered, step by step.
    pub(crate) fn remembers(&self) -> bool {
        self.lag != 0.0
    }

    /// Takes in what is so at `t`; in order.
    pub(crate) fn remember(&mut self, t: f64, sight: Sight) {
        self.past.push_back((t, sight));
        let kept = t - self.lag.abs() - 3.0 * STEP;
        while self.past.get(1).is_some_and(|(second, _)| *second < kept) {
            self.past.pop_front();
        }
    }

    /// What the gauges feel at `t` without noise and bias, `now` being so.
    pub(crate) fn felt(&self, now: &Sight, t: f64) -> [f64; 6] {
        let wrench = if self.lag > 0.0 {
            self.wrench_at(t - self.lag).unwrap_or(now.wrench)
        } else {
            now.wrench
        };
        match self.drift {
            None => wrench,
            Some((slope, time)) => {
                let grown = if time.is_finite() {
                    time * (1.0 - (-t / time).exp())
                } else {
                    t
                };
                std::array::from_fn(|axis| wrench[axis] + slope[axis] * grown)
            }
        }
    }

    /// Where the tracker finds the tool centre point at `t` without noise, `now` being so, and the hand in the joint's
    /// coordinate.
    pub(crate) fn seen(&self, now: &Sight, t: f64) -> Sight {
        if self.lag >= 0.0 {
            return *now;
        }
        let t = t + self.lag;
        let nearest = self.past.partition_point(|(at, _)| *at < t);
        let Some((at, sight)) = self.past.get(nearest).or(self.past.back()) else {
            return *now;
        };
        let mut seen = *sight;
        // Within a step of 1/8000 s; before the first of them nothing moves.
        let back = (t - at).max(-STEP);
        seen.tcp = moved(&sight.tcp, back);
        seen
    }

    fn wrench_at(&self, t: f64) -> Option<[f64; 6]> {
        let after = self.past.partition_point(|(at, _)| *at < t);
        let (late, upper) = self.past.get(after).or(self.past.back())?;
        let Some((early, lower)) = after
            .checked_sub(1)
            .and_then(|before| self.past.get(before))
        else {
            return Some(upper.wrench);
        };
        let share = ((t - early) / (late - early)).clamp(0.0, 1.0);
        Some(std::array::from_fn(|axis| {
            lower.wrench[axis] + share * (upper.wrench[axis] - lower.wrench[axis])
        }))
    }
}

/// The motion `seconds` later, for a time so short that its accelerations stay.
fn moved(motion: &RigidMotion, seconds: f64) -> RigidMotion {
    let mut moved = *motion;
    moved.position += seconds * (motion.velocity + 0.5 * seconds * motion.acceleration);
    moved.velocity += seconds * motion.acceleration;
    let turn = seconds * (motion.rate + 0.5 * seconds * motion.rate_change);
    moved.rotation = nalgebra::UnitQuaternion::from_scaled_axis(turn) * motion.rotation;
    moved.rate += seconds * motion.rate_change;
    moved
}
