//! A twin let go: the joint moves by itself until it reaches its end, or friction holds it.
//!
//! Between reversals the motion is smooth and integrated by Runge and Kutta's fourth-order method; a reversal is located
//! inside its step. At rest the joint stays while no effort is needed beyond dry friction ([`Evaluator::rest_band`]), so
//! sticking is exact and nothing creeps.

mod demand;
mod page;

use crate::screw::JointKind;
use crate::twin::Evaluator;

pub use demand::{Demand, Opening, demand, shortest};
pub use page::{page, said};

/// How to let go.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Release {
    /// Coordinate at which the joint is let go, at rest, rad or m.
    pub from: f64,
    /// Coordinate at which it has arrived; where the joint ends.
    pub until: f64,
    /// Step of the integration, s.
    pub step: f64,
    /// Longest time that is simulated, s.
    pub longest: f64,
}

/// Why a twin cannot be let go.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum SimulateError {
    /// Without inertia there is no motion to compute.
    #[error(
        "the twin has no inertia: it was not identifiable; probe with fast strokes and identify again"
    )]
    NoInertia,
    /// The twin knows nothing there.
    #[error("{} lies outside the range {} to {} in which the twin was probed; choose a place within it", shown(*.kind, *.place), shown(*.kind, *.low), shown(*.kind, *.high))]
    Outside {
        /// Revolute or prismatic.
        kind: JointKind,
        /// Asked for, rad or m.
        place: f64,
        /// Probed range, rad or m.
        low: f64,
        /// Probed range, rad or m.
        high: f64,
    },
    /// So little inertia against so much damping takes too many steps.
    #[error(
        "the inertia of {inertia:e} is too small against the damping to be simulated; it is likely below its own error, see the twin's covariance"
    )]
    TooLight {
        /// kg m^2 or kg.
        inertia: f64,
    },
    /// The step or the longest time is not above 0, or there would be more than ten million steps.
    #[error(
        "steps of {step} s over {longest} s cannot be simulated; take a step of 0.0001 s and at most 600 s"
    )]
    Steps {
        /// Asked for, s.
        step: f64,
        /// Asked for, s.
        longest: f64,
    },
}

/// How a motion ended.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
#[serde(rename_all = "snake_case", tag = "how")]
pub enum End {
    /// At the end of the joint.
    Arrived {
        /// Time since the release, s.
        time: f64,
        /// Speed there, rad/s or m/s.
        speed: f64,
    },
    /// Dry friction holds it.
    Held {
        /// Time since the release, s.
        time: f64,
        /// Where, rad or m.
        q: f64,
    },
    /// It went beyond the range of the joint, where the twin knows nothing.
    Left {
        /// Time since the release, s.
        time: f64,
        /// Where, rad or m.
        q: f64,
    },
    /// Still moving after the longest time.
    Moving {
        /// Where, rad or m.
        q: f64,
    },
}

/// Time between the states that a [`Swing`] keeps, s.
const PLOTTED: f64 = 0.01;
/// Most steps of one motion.
const MOST_STEPS: usize = 10_000_000;
/// Step over the time in which damping takes up a motion; Runge and Kutta's method is stable up to 2.78.
const STABLE: f64 = 0.5;

/// A motion after a release.
#[derive(Clone, Debug, PartialEq)]
pub struct Swing {
    /// Time since the release, s; every hundredth of a second and at the end.
    pub time: Vec<f64>,
    /// Coordinate, rad or m.
    pub q: Vec<f64>,
    /// Velocity, rad/s or m/s.
    pub dq: Vec<f64>,
    /// How it ended.
    pub end: End,
    /// Share of the time in which it was faster than anything that was probed.
    pub beyond_probed_speed: f64,
}

/// Refuses a place, rad or m, beyond `ends`, the range of the joint as far as it is known, by more than a hundredth of it: there a twin is
/// made up.
///
/// # Errors
/// [`SimulateError::Outside`].
pub fn refuse_outside(twin: &Evaluator, ends: [f64; 2], place: f64) -> Result<(), SimulateError> {
    let [low, high] = ends;
    let slack = 1e-6 + 0.01 * (high - low);
    if place >= low - slack && place <= high + slack {
        return Ok(());
    }
    Err(SimulateError::Outside {
        kind: twin.kind(),
        place,
        low,
        high,
    })
}

/// Lets the joint go. `ends` is the range of the joint as far as it is known ([`crate::twin::TwinJoint::q_range`]): there are no
/// stops in a twin, and a motion that leaves it ends.
///
/// # Errors
/// [`SimulateError`].
pub fn release(twin: &Evaluator, ends: [f64; 2], how: &Release) -> Result<Swing, SimulateError> {
    for place in [how.from, how.until] {
        refuse_outside(twin, ends, place)?;
    }
    if twin.inertia() <= 0.0 {
        return Err(SimulateError::NoInertia);
    }
    let count = how.longest / how.step;
    if !(how.step > 0.0 && count > 0.0 && count <= MOST_STEPS as f64) {
        return Err(SimulateError::Steps {
            step: how.step,
            longest: how.longest,
        });
    }
    let side = (how.from - how.until).signum();
    let mut state = [how.from, 0.0];
    let (mut time, mut beyond, mut steps) = (0.0, 0.0, 0_usize);
    let mut swing = Swing {
        time: vec![0.0],
        q: vec![how.from],
        dq: vec![0.0],
        end: End::Moving { q: how.from },
        beyond_probed_speed: 0.0,
    };
    let end = loop {
        let direction = if state[1] == 0.0 {
            match from_rest(twin, state[0]) {
                Some(direction) => direction,
                None => break End::Held { time, q: state[0] },
            }
        } else {
            state[1].signum()
        };
        let damping = twin.gradient(state[0], state[1] + 1e-9 * direction)[1].abs();
        let mut taken = how.step.min(STABLE * twin.inertia() / damping.max(1e-12));
        let mut next = advance(twin, state, direction, taken);
        if next[1] * direction < 0.0 {
            // It turns inside the step: up to there, then at rest.
            taken *= (state[1] / (state[1] - next[1])).clamp(1e-6, 1.0);
            next = advance(twin, state, direction, taken);
            next[1] = 0.0;
        }
        if (next[0] - how.until) * side <= 0.0 && next[0] != state[0] {
            let share = ((how.until - state[0]) / (next[0] - state[0])).clamp(0.0, 1.0);
            time += share * taken;
            let speed = state[1] + share * (next[1] - state[1]);
            state = [how.until, speed];
            break End::Arrived {
                time,
                speed: speed.abs(),
            };
        }
        state = next;
        time += taken;
        steps += 1;
        let [slowest, fastest] = twin.domain().dq;
        if state[1] < slowest || state[1] > fastest {
            beyond += taken;
        }
        if refuse_outside(twin, ends, state[0]).is_err() {
            break End::Left { time, q: state[0] };
        }
        if steps >= MOST_STEPS {
            return Err(SimulateError::TooLight {
                inertia: twin.inertia(),
            });
        }
        if time >= swing.time.last().copied().unwrap_or(0.0) + PLOTTED {
            swing.push(time, state);
        }
        if time >= how.longest {
            break End::Moving { q: state[0] };
        }
    };
    swing.push(time, state);
    swing.end = end;
    swing.beyond_probed_speed = beyond / f64::max(time, f64::MIN_POSITIVE);
    Ok(swing)
}

impl Swing {
    fn push(&mut self, time: f64, [q, dq]: [f64; 2]) {
        self.time.push(time);
        self.q.push(q);
        self.dq.push(dq);
    }
}

/// A place with its unit, degrees for an angle.
fn shown(kind: JointKind, place: f64) -> String {
    match kind {
        JointKind::Revolute => format!("{:.1} deg", place.to_degrees()),
        JointKind::Prismatic => format!("{place:.3} m"),
    }
}

/// Which way the joint starts to move from rest with nobody's hand on it; nothing when friction holds it.
fn from_rest(twin: &Evaluator, q: f64) -> Option<f64> {
    let [backward, forward] = twin.rest_band(q);
    if forward < 0.0 {
        Some(1.0)
    } else if backward > 0.0 {
        Some(-1.0)
    } else {
        None
    }
}

/// One step with the direction of friction held.
fn advance(twin: &Evaluator, [q, dq]: [f64; 2], direction: f64, step: f64) -> [f64; 2] {
    let slope = |q: f64, dq: f64| {
        let speed = direction * (direction * dq).max(1e-9);
        [dq, -twin.effort(q, speed, 0.0) / twin.inertia()]
    };
    let [v1, a1] = slope(q, dq);
    let [v2, a2] = slope(q + 0.5 * step * v1, dq + 0.5 * step * a1);
    let [v3, a3] = slope(q + 0.5 * step * v2, dq + 0.5 * step * a2);
    let [v4, a4] = slope(q + step * v3, dq + step * a3);
    [
        q + step / 6.0 * (v1 + 2.0 * v2 + 2.0 * v3 + v4),
        dq + step / 6.0 * (a1 + 2.0 * a2 + 2.0 * a3 + a4),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::twin::Twin;

    const ENDS: [f64; 2] = [-2.0, 2.0];

    /// `I ddq + mu sgn(dq) + b dq + k q`, from the fields of a twin's file.
    fn twin(inertia: f64, coulomb: f64, viscous: f64, stiffness: f64) -> Evaluator {
        let text = serde_json::json!({
            "schema": "ft-identify/twin/1",
            "joint": {"frame": "world", "kind": "revolute", "axis_direction": [0, 0, 1], "axis_point": [0, 0, 0],
                      "q_range": [-2.0, 2.0], "coordinate": {"sign": 1.0, "offset": 0.0}},
            "beta": {"names": ["inertia", "coulomb", "viscous"], "units": ["kg m^2", "N m", "N m s/rad"],
                     "values": [inertia, coulomb, viscous], "covariance": []},
            "effects": [], "domain": {"q": [-2.0, 2.0], "dq": [-9.0, 9.0]},
            "mechanism": {"kind": "spline",
                "load": {"interval": [-2.0, 2.0], "pieces": 1, "degree": 1, "coefficients": [-2.0 * stiffness, 2.0 * stiffness]},
                "damping": [flat(), flat()]},
            "provenance": {"recordings": [], "version": "", "calibration": null, "held_out_rms": null}
        });
        serde_json::from_value::<Twin>(text).unwrap().evaluator()
    }

    fn flat() -> serde_json::Value {
        serde_json::json!({"interval_q": [-2.0, 2.0], "interval_sqrt_speed": [0.0, 3.0], "pieces": [1, 1],
                           "degree": [1, 1], "coefficients": [0.0, 0.0, 0.0, 0.0]})
    }

    fn how(from: f64, until: f64) -> Release {
        Release {
            from,
            until,
            step: 1e-4,
            longest: 30.0,
        }
    }

    #[test]
    fn a_spring_swings_a_quarter_period_to_its_middle() {
        let (inertia, stiffness) = (2.0, 8.0);
        let swing = release(&twin(inertia, 0.0, 0.0, stiffness), ENDS, &how(1.0, 0.0)).unwrap();
        let End::Arrived { time, speed } = swing.end else {
            panic!("{:?}", swing.end)
        };
        let omega = (stiffness / inertia).sqrt();
        assert!(
            (time - core::f64::consts::FRAC_PI_2 / omega).abs() < 1e-6,
            "{time}"
        );
        assert!((speed - omega).abs() < 1e-6, "{speed}");
    }

    #[test]
    fn dry_friction_takes_the_same_from_every_half_swing_and_then_holds() {
        // Each half swing loses 2 mu / k = 0.1; from 0.95 the turns are -0.85, 0.75, ... until |q| <= mu / k = 0.05.
        let swing = release(&twin(2.0, 0.4, 0.0, 8.0), ENDS, &how(0.97, -1.9)).unwrap();
        let End::Held { time, q } = swing.end else {
            panic!("{:?}", swing.end)
        };
        let half = core::f64::consts::PI / (8.0_f64 / 2.0).sqrt();
        assert!((q.abs() - 0.03).abs() < 1e-5, "{q}");
        assert!((time - 10.0 * half).abs() < 1e-4, "{time} {}", 10.0 * half);
    }

    #[test]
    fn a_joint_at_rest_within_friction_stays() {
        let swing = release(&twin(2.0, 5.0, 0.0, 8.0), ENDS, &how(0.5, 0.0)).unwrap();
        assert_eq!(swing.end, End::Held { time: 0.0, q: 0.5 });
    }

    #[test]
    fn a_load_that_opens_takes_the_joint_out_of_its_range() {
        let swing = release(&twin(2.0, 0.0, 0.0, -8.0), ENDS, &how(0.5, 0.0)).unwrap();
        let End::Left { q, .. } = swing.end else {
            panic!("{:?}", swing.end)
        };
        assert!((q - 2.04).abs() < 0.01, "{q}");
    }

    #[test]
    fn light_joints_are_damped_and_not_shaken_by_the_step() {
        // Inertia / damping is 0.1 ms: it follows k q + b dq = 0 but for the start, exp(-k t / b).
        let swing = release(&twin(2e-4, 0.0, 2.0, 8.0), ENDS, &how(1.0, 0.1)).unwrap();
        let End::Arrived { time, .. } = swing.end else {
            panic!("{:?}", swing.end)
        };
        assert!((time - 0.25 * 10.0_f64.ln()).abs() < 1e-3, "{time}");
        let error = release(&twin(1e-12, 0.0, 2.0, 8.0), ENDS, &how(1.0, 0.1)).unwrap_err();
        assert!(matches!(error, SimulateError::TooLight { .. }), "{error}");
    }

    #[test]
    fn refusals_say_what_to_do() {
        let ask =
            |twin: &Evaluator, how: Release| release(twin, ENDS, &how).unwrap_err().to_string();
        let good = twin(2.0, 0.0, 0.0, 8.0);
        assert!(ask(&good, how(3.0, 0.0)).contains("-114.6 deg to 114.6 deg"));
        assert!(ask(&twin(0.0, 0.0, 0.0, 8.0), how(1.0, 0.0)).contains("no inertia"));
        let endless = Release {
            step: 0.0,
            ..how(1.0, 0.0)
        };
        assert!(ask(&good, endless).contains("step"));
    }

    #[test]
    fn an_opening_needs_what_spring_friction_and_inertia_take() {
        let opening = Opening {
            from: 0.0,
            to: 1.0,
            duration: 2.0,
        };
        let [q, dq, ddq] = opening.at(1.0);
        assert!((q - 0.5).abs() < 1e-12 && (dq - 0.9375).abs() < 1e-12 && ddq.abs() < 1e-12);
        let h = 1e-5;
        let [slope, bend] =
            [0, 1].map(|i| (opening.at(0.7 + h)[i] - opening.at(0.7 - h)[i]) / (2.0 * h));
        assert!(
            (slope - opening.at(0.7)[1]).abs() < 1e-8 && (bend - opening.at(0.7)[2]).abs() < 1e-8
        );
        let found = demand(&twin(2.0, 0.4, 0.5, 8.0), &opening);
        let at = 400;
        let [q, dq, ddq] = opening.at(found.time[at]);
        assert!((found.effort[at] - (2.0 * ddq + 0.4 + 0.5 * dq + 8.0 * q)).abs() < 1e-9);
        // A spring is hardest near its end.
        assert!(
            (0.9..=1.0).contains(&found.peak_at) && found.peak > 8.0,
            "{found:?}"
        );
        let first = (0..200_000)
            .map(|k| opening.at(1e-5 * f64::from(k)))
            .find(|[q, dq, ddq]| 2.0 * ddq + 0.4 + 0.5 * dq + 8.0 * q > 4.0);
        assert!(
            (found.exceeds(4.0).unwrap() - first.unwrap()[0]).abs() < 2e-3,
            "{first:?}"
        );
        assert_eq!(found.exceeds(20.0), None);
        // At 8.7 N m the spring and dry friction (8.4 N m) leave 0.3 N m for damping and inertia: slowly enough they are no more.
        let quick = Opening {
            duration: 0.5,
            ..opening
        };
        let spring = twin(2.0, 0.4, 0.5, 8.0);
        let slow = shortest(&spring, &quick, 8.7).unwrap();
        let taking = |duration: f64| demand(&spring, &Opening { duration, ..quick }).peak;
        assert!(
            taking(slow) <= 8.7 && taking(0.998 * slow) > 8.7,
            "{slow} s take {}",
            taking(slow)
        );
        assert_eq!(shortest(&spring, &quick, 8.3), None);
        assert_eq!(shortest(&spring, &opening, 20.0), Some(2.0));
        assert_eq!(found.not_probed, 0.0);
    }
}
