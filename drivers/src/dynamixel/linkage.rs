//! The mechanism between a gripper's actuator and its jaws.

use std::f64::consts::TAU;

/// From the actuator's angle to the jaw opening: two crank-and-rod halves that move against each other.
///
/// `alpha = angle - zero_angle`, `x = crank cos(alpha) + sqrt(rod^2 - (crank sin(alpha))^2)`, `width = 2 x`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Linkage {
    /// Actuator's angle at which the cranks point outwards, rad.
    pub zero_angle_rad: f64,
    /// Crank, m.
    pub crank_m: f64,
    /// Connecting rod, m; longer than the crank.
    pub rod_m: f64,
}

impl Linkage {
    /// The Hoi! gripper: 64 deg, 38 mm, 44.4 mm.
    pub const HOI: Self = Self {
        zero_angle_rad: 64.0 * TAU / 360.0,
        crank_m: 0.038,
        rod_m: 0.0444,
    };

    /// Jaw opening, m, at the actuator's angle, rad.
    #[must_use]
    pub fn width_m(&self, angle_rad: f64) -> f64 {
        let (sin, cos) = (angle_rad - self.zero_angle_rad).sin_cos();
        2.0 * (self.crank_m * cos + self.reach(sin))
    }

    /// Change of the jaw opening with the angle, m/rad.
    #[must_use]
    pub fn width_slope_m_per_rad(&self, angle_rad: f64) -> f64 {
        let (sin, cos) = (angle_rad - self.zero_angle_rad).sin_cos();
        let reach = self.reach(sin).max(f64::MIN_POSITIVE);
        -2.0 * self.crank_m * sin * (1.0 + self.crank_m * cos / reach)
    }

    fn reach(&self, sin: f64) -> f64 {
        (self.rod_m.powi(2) - (self.crank_m * sin).powi(2))
            .max(0.0)
            .sqrt()
    }
}
