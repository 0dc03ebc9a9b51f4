//! Rigid motions with their first two derivatives, all analytic, and the curves they follow.

use nalgebra::{Unit, UnitQuaternion, Vector3};

/// A pose, its rates and its accelerations, in the axes of the frame it moves in.
#[derive(Clone, Copy, Debug)]
pub(crate) struct RigidMotion {
    /// Origin, m.
    pub(crate) position: Vector3<f64>,
    /// Its velocity, m/s.
    pub(crate) velocity: Vector3<f64>,
    /// Its acceleration, m/s^2.
    pub(crate) acceleration: Vector3<f64>,
    /// Rotation.
    pub(crate) rotation: UnitQuaternion<f64>,
    /// Angular rate, rad/s.
    pub(crate) rate: Vector3<f64>,
    /// Angular acceleration, rad/s^2.
    pub(crate) rate_change: Vector3<f64>,
}

impl RigidMotion {
    /// A body that stands still.
    pub(crate) fn still(position: Vector3<f64>, rotation: UnitQuaternion<f64>) -> Self {
        let zero = Vector3::zeros();
        Self {
            position,
            velocity: zero,
            acceleration: zero,
            rotation,
            rate: zero,
            rate_change: zero,
        }
    }

    /// Position, velocity and acceleration of the body's point that is `lever` (world axes) away from the origin.
    pub(crate) fn acceleration_at(&self, lever: Vector3<f64>) -> Vector3<f64> {
        self.acceleration
            + self.rate_change.cross(&lever)
            + self.rate.cross(&self.rate.cross(&lever))
    }

    /// The motion with a further turn about an axis fixed in the body.
    pub(crate) fn turned(mut self, axis: Unit<Vector3<f64>>, angle: Jet) -> Self {
        let along = self.rotation * axis.into_inner();
        let added = along * angle.rate;
        self.rate_change += self.rate.cross(&added) + along * angle.rate_change;
        self.rate += added;
        self.rotation *= UnitQuaternion::from_axis_angle(&axis, angle.value);
        self
    }

    /// The motion with a further shift along a direction fixed in the world.
    pub(crate) fn shifted(mut self, direction: Vector3<f64>, distance: Jet) -> Self {
        self.position += direction * distance.value;
        self.velocity += direction * distance.rate;
        self.acceleration += direction * distance.rate_change;
        self
    }
}

/// A scalar with its first two time derivatives.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Jet {
    pub(crate) value: f64,
    pub(crate) rate: f64,
    pub(crate) rate_change: f64,
}

impl Jet {
    pub(crate) fn constant(value: f64) -> Self {
        Self {
            value,
            rate: 0.0,
            rate_change: 0.0,
        }
    }

    pub(crate) fn scaled(self, factor: f64) -> Self {
        Self {
            value: self.value * factor,
            rate: self.rate * factor,
            rate_change: self.rate_change * factor,
        }
    }

    pub(crate) fn plus(self, other: Self) -> Self {
        Self {
            value: self.value + other.value,
            rate: self.rate + other.rate,
            rate_change: self.rate_change + other.rate_change,
        }
    }

    pub(crate) fn times(self, other: Self) -> Self {
        Self {
            value: self.value * other.value,
            rate: self.rate * other.value + self.value * other.rate,
            rate_change: self.rate_change * other.value
                + 2.0 * self.rate * other.rate
                + self.value * other.rate_change,
        }
    }

    /// `amplitude * sin(2 pi hz t + phase)`.
    pub(crate) fn sine(amplitude: f64, hz: f64, phase: f64, t: f64) -> Self {
        let omega = std::f64::consts::TAU * hz;
        let (sin, cos) = (omega * t + phase).sin_cos();
        Self {
            value: amplitude * sin,
            rate: amplitude * omega * cos,
            rate_change: -amplitude * omega * omega * sin,
        }
    }

    /// From 0 to 1 over `seconds`, at rest and without acceleration at both ends (minimum jerk).
    pub(crate) fn rise(t: f64, seconds: f64) -> Self {
        if t <= 0.0 || seconds <= 0.0 {
            return Self::constant(if t > 0.0 { 1.0 } else { 0.0 });
        }
        if t >= seconds {
            return Self::constant(1.0);
        }
        let s = t / seconds;
        Self {
            value: s * s * s * (10.0 - 15.0 * s + 6.0 * s * s),
            rate: 30.0 * s * s * (1.0 - 2.0 * s + s * s) / seconds,
            rate_change: 60.0 * s * (1.0 - 3.0 * s + 2.0 * s * s) / (seconds * seconds),
        }
    }

    /// Up over the first and down over the last `ramp` of `seconds`, 1 between.
    pub(crate) fn window(t: f64, seconds: f64, ramp: f64) -> Self {
        let ramp = ramp.min(0.5 * seconds);
        let down = Self::rise(t - (seconds - ramp), ramp);
        Self::rise(t, ramp).plus(down.scaled(-1.0))
    }
}

/// The quintic from `from` (value, rate, no acceleration) to rest at `to` after `seconds`.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Quintic {
    from: f64,
    rate: f64,
    to: f64,
    seconds: f64,
}

impl Quintic {
    pub(crate) fn new(from: f64, rate: f64, to: f64, seconds: f64) -> Self {
        Self {
            from,
            rate,
            to,
            seconds: seconds.max(1e-6),
        }
    }

    pub(crate) fn at(&self, t: f64) -> Jet {
        let (t, span) = (t.clamp(0.0, self.seconds), self.seconds);
        let rise = Jet::rise(t, span).scaled(self.to - self.from);
        let s = t / span;
        // s - 6 s^3 + 8 s^4 - 3 s^5 starts with slope 1 and ends flat at 0.
        let glide = Jet {
            value: s - 6.0 * s.powi(3) + 8.0 * s.powi(4) - 3.0 * s.powi(5),
            rate: (1.0 - 18.0 * s * s + 32.0 * s.powi(3) - 15.0 * s.powi(4)) / span,
            rate_change: (-36.0 * s + 96.0 * s * s - 60.0 * s.powi(3)) / (span * span),
        };
        Jet::constant(self.from)
            .plus(rise)
            .plus(glide.scaled(self.rate * span))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn assert_derivatives_agree(curve: impl Fn(f64) -> Jet, t: f64) {
        let h = 1e-4;
        let (before, here, after) = (curve(t - h), curve(t), curve(t + h));
        let scale = 1.0 + here.rate.abs() + here.rate_change.abs();
        assert!(
            ((after.value - before.value) / (2.0 * h) - here.rate).abs() < 1e-5 * scale,
            "rate at {t}"
        );
        assert!(
            ((after.rate - before.rate) / (2.0 * h) - here.rate_change).abs() < 1e-4 * scale,
            "acceleration at {t}"
        );
    }

    #[test]
    fn every_curve_is_the_derivative_of_itself() {
        for step in 1..19 {
            let t = 0.1 * f64::from(step) + 0.013;
            assert_derivatives_agree(|t| Jet::rise(t, 1.9), t);
            assert_derivatives_agree(|t| Jet::sine(0.3, 2.2, 0.4, t), t);
            assert_derivatives_agree(
                |t| Jet::sine(0.3, 2.2, 0.4, t).times(Jet::window(t, 2.0, 0.6)),
                t,
            );
            assert_derivatives_agree(|t| Quintic::new(0.2, -0.7, 1.4, 2.0).at(t), t);
        }
    }

    #[test]
    fn a_quintic_ends_at_rest_where_it_should() {
        let end = Quintic::new(0.2, 0.9, -1.0, 1.5).at(1.5);
        assert!(
            (end.value + 1.0).abs() < 1e-12
                && end.rate.abs() < 1e-12
                && end.rate_change.abs() < 1e-9
        );
        let start = Quintic::new(0.2, 0.9, -1.0, 1.5).at(0.0);
        assert_eq!((start.value, start.rate), (0.2, 0.9));
    }

    #[test]
    fn chained_turns_keep_their_rates() {
        let pose = |t: f64| {
            RigidMotion::still(
                Vector3::new(0.1, 0.2, 0.3),
                UnitQuaternion::from_euler_angles(0.3, -0.2, 1.0),
            )
            .turned(Vector3::x_axis(), Jet::sine(0.5, 1.1, 0.2, t))
            .turned(Vector3::z_axis(), Jet::sine(0.4, 1.7, 1.2, t))
            .turned(Vector3::y_axis(), Jet::sine(0.3, 2.3, 2.2, t))
        };
        let h = 1e-5;
        for t in [0.1, 0.37, 0.9] {
            let (before, here, after) = (pose(t - h), pose(t), pose(t + h));
            let rate = (after.rotation * before.rotation.inverse()).scaled_axis() / (2.0 * h);
            let rate_change = (after.rate - before.rate) / (2.0 * h);
            assert!((rate - here.rate).norm() < 1e-7, "{rate} {}", here.rate);
            assert!((rate_change - here.rate_change).norm() < 1e-6);
        }
    }
}
