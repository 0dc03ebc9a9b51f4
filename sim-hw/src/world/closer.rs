//! A door closer: a spring that is wound up by opening, and a piston whose oil flows through valves by zone and direction.

use super::passive::{JointState, Passive};
use crate::scenario::{SwingDirection, ZoneSpec};

#[derive(Clone, Debug)]
pub(crate) struct Closer {
    pub(crate) preload: f64,
    pub(crate) rate: f64,
    pub(crate) blend: f64,
    pub(crate) relief: Option<f64>,
    pub(crate) zones: Vec<ZoneSpec>,
}

impl Closer {
    fn damping(&self, at: JointState) -> f64 {
        let direction = if at.dq > 0.0 {
            SwingDirection::Opening
        } else {
            SwingDirection::Closing
        };
        self.zones
            .iter()
            .filter(|zone| zone.direction == direction)
            .map(|zone| zone.damping * self.open_share(zone, at.q))
            .sum()
    }

    /// 1 inside the zone, 0 outside, straight across the blend.
    fn open_share(&self, zone: &ZoneSpec, q: f64) -> f64 {
        let entering = ((q - zone.from) / self.blend + 0.5).clamp(0.0, 1.0);
        let leaving = ((zone.to - q) / self.blend + 0.5).clamp(0.0, 1.0);
        entering.min(leaving)
    }
}

impl Passive for Closer {
    fn effort(&self, at: JointState) -> f64 {
        let oil = self.damping(at) * at.dq.abs();
        // Past the relief pressure the valve lets a tenth of the rest build up.
        let oil = match self.relief {
            Some(relief) if oil > relief => relief + 0.1 * (oil - relief),
            _ => oil,
        };
        -(self.preload + self.rate * at.q) - oil * at.dq.signum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn closer() -> Closer {
        let zone = |from, to, direction, damping| ZoneSpec {
            from,
            to,
            direction,
            damping,
        };
        Closer {
            preload: 10.0,
            rate: 4.0,
            blend: 0.02,
            relief: Some(30.0),
            zones: vec![
                zone(0.3, 3.0, SwingDirection::Closing, 20.0),
                zone(-1.0, 0.3, SwingDirection::Closing, 8.0),
                zone(1.2, 3.0, SwingDirection::Opening, 15.0),
            ],
        }
    }

    fn effort(q: f64, dq: f64) -> f64 {
        closer().effort(JointState { t: 0.0, q, dq })
    }

    #[test]
    fn each_zone_damps_its_own_direction() {
        assert_eq!(effort(1.0, 0.0), -14.0);
        assert_eq!(effort(1.0, 0.5), -14.0);
        assert_eq!(effort(1.0, -0.5), -14.0 + 10.0);
        assert_eq!(effort(0.1, -0.5), -10.4 + 4.0);
        assert_eq!(effort(1.5, 0.5), -16.0 - 7.5);
    }

    #[test]
    fn the_relief_valve_limits_a_slammed_door() {
        assert!((effort(1.0, -2.0) - (-14.0 + 31.0)).abs() < 1e-12);
    }
}
