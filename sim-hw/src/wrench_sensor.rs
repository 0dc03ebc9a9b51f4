//! The gauges of a force-torque sensor: noise, bias, drift, warmth. Quantisation and rate belong to the device around them.

use crate::random::Random;
use crate::scenario::SensorSpec;

/// Gauges behind a device's electronics.
#[derive(Debug)]
pub(crate) struct WrenchSensor {
    noise: [f64; 6],
    bias: [f64; 6],
    drift_per_s: [f64; 6],
    room_c: f64,
    random: Random,
}

impl WrenchSensor {
    pub(crate) fn new(spec: &SensorSpec, mut random: Random) -> Self {
        let per_axis = |force: f64, torque: f64| [force, force, force, torque, torque, torque];
        let bias = per_axis(spec.force_bias_n, spec.torque_bias_nm)
            .map(|size| size * signed(&mut random, 0.2, 1.0));
        let torque_drift =
            spec.force_drift_n_per_min * spec.torque_bias_nm / spec.force_bias_n.max(1e-9);
        let drift = per_axis(spec.force_drift_n_per_min, torque_drift.min(1.0));
        Self {
            noise: per_axis(spec.force_noise_n, spec.torque_noise_nm),
            bias,
            drift_per_s: drift.map(|size| size / 60.0 * signed(&mut random, 0.3, 1.0)),
            room_c: random.uniform(24.0, 30.0),
            random,
        }
    }

    /// The bias at `t` seconds.
    pub(crate) fn bias(&self, t: f64) -> [f64; 6] {
        std::array::from_fn(|axis| self.bias[axis] + self.drift_per_s[axis] * t)
    }

    /// Drift, N/s and N m/s.
    pub(crate) fn drift_per_s(&self) -> [f64; 6] {
        self.drift_per_s
    }

    /// What the gauges give at `t` for a true `wrench`.
    pub(crate) fn read(&mut self, wrench: [f64; 6], t: f64) -> [f64; 6] {
        let bias = self.bias(t);
        let noise = self.random.normals::<6>();
        std::array::from_fn(|axis| wrench[axis] + bias[axis] + self.noise[axis] * noise[axis])
    }

    /// Temperature of the electronics, deg C.
    pub(crate) fn temperature(&self, t: f64) -> f64 {
        self.room_c + 3.0 * (1.0 - (-t / 400.0).exp())
    }
}

/// A sensor's own first-order filter, at its output rate.
#[derive(Debug, Default)]
pub(crate) struct LowPass(Option<[f64; 6]>);

impl LowPass {
    /// Takes the next sample in.
    pub(crate) fn smooth(&mut self, fresh: [f64; 6], cut_off_hz: f64, rate_hz: f64) -> [f64; 6] {
        let weight = 1.0 - (-std::f64::consts::TAU * cut_off_hz / rate_hz).exp();
        let past = self.0.unwrap_or(fresh);
        let smooth = std::array::from_fn(|axis| past[axis] + weight * (fresh[axis] - past[axis]));
        self.0 = Some(smooth);
        smooth
    }
}

fn signed(random: &mut Random, least: f64, most: f64) -> f64 {
    let size = random.uniform(least, most);
    if random.uniform(0.0, 1.0) < 0.5 {
        -size
    } else {
        size
    }
}
