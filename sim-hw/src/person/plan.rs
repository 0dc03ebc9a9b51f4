//! The probing protocol: slow passes over the whole range, strokes at a spread of speeds, shakes at several places, and
//! following with a hand that yields.

use crate::random::Random;

/// A stretch of probing; positions in the joint's coordinate.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Segment {
    Hold {
        seconds: f64,
    },
    Reach {
        to: f64,
        seconds: f64,
    },
    Shake {
        amplitude: f64,
        hz: f64,
        seconds: f64,
    },
    /// With `lead` the hand leads softly; without it it only follows.
    Follow {
        seconds: f64,
        lead: Option<f64>,
    },
}

impl Segment {
    pub(crate) fn seconds(&self) -> f64 {
        match *self {
            Self::Hold { seconds } | Self::Reach { seconds, .. } => seconds,
            Self::Shake { seconds, .. } | Self::Follow { seconds, .. } => seconds,
        }
    }
}

/// What the person knows of the object before probing it; positions and rates in the joint's coordinate.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Occasion {
    /// Where the object rests when it is grasped.
    pub(crate) closed: f64,
    /// The open stop.
    pub(crate) open: f64,
    /// Fastest stroke.
    pub(crate) top_rate: f64,
    /// Peak acceleration of strokes and shakes.
    pub(crate) peak_acceleration: f64,
    /// Where the object moves by itself from, when it does: start, and whether it closes or opens.
    pub(crate) goes_by_itself: Option<f64>,
}

const CYCLE_S: f64 = 60.0;
const FINAL_HOLD_S: f64 = 0.9;
/// Peak rate of a minimum-jerk stroke over its mean, and peak acceleration times square of time over length.
const PEAK_RATE: f64 = 1.875;
const PEAK_ACCELERATION: f64 = 5.7735;

/// The protocol, exactly `seconds` long, repeated when there is time; ends closed and at rest.
pub(crate) fn protocol(occasion: &Occasion, seconds: f64, random: &mut Random) -> Vec<Segment> {
    let cycles = (seconds / CYCLE_S).round().max(1.0);
    let mut plan = Vec::new();
    for _ in 0..cycles as u32 {
        plan.extend(cycle(occasion, seconds / cycles, random));
    }
    plan
}

fn cycle(occasion: &Occasion, seconds: f64, random: &mut Random) -> Vec<Segment> {
    let strokes = strokes(occasion, 0.27 * seconds, random);
    let shakes = shakes(occasion, 0.24 * seconds, random);
    let following = following(occasion, 0.24 * seconds);
    let close = occasion
        .stroke_seconds(occasion.closed - occasion.open, 0.7)
        .clamp(0.0, 0.3 * seconds);
    let hold = FINAL_HOLD_S.min(0.3 * seconds);
    let fixed = strokes
        .iter()
        .chain(&shakes)
        .chain(&following)
        .map(Segment::seconds)
        .sum::<f64>()
        + close
        + hold;
    // The slow passes take what is left.
    let each = 0.5 * (seconds - fixed);
    // In a short run they go no further than the top rate takes them.
    let reach = each * occasion.top_rate / (PEAK_RATE * (occasion.open - occasion.closed));
    let slow = [occasion.at(reach.min(0.98)), occasion.at(0.015)]
        .map(|to| Segment::Reach { to, seconds: each });
    let mut plan = slow.to_vec();
    plan.extend(strokes);
    plan.extend(shakes);
    plan.extend(following);
    plan.push(Segment::Reach {
        to: occasion.closed,
        seconds: close,
    });
    plan.push(Segment::Hold { seconds: hold });
    plan
}

impl Occasion {
    fn at(&self, share: f64) -> f64 {
        self.closed + share * (self.open - self.closed)
    }

    /// How long a stroke of `length` takes at `share` of the top rate, within the peak acceleration.
    fn stroke_seconds(&self, length: f64, share: f64) -> f64 {
        let by_rate = PEAK_RATE * length.abs() / (share * self.top_rate);
        let by_acceleration = (PEAK_ACCELERATION * length.abs() / self.peak_acceleration).sqrt();
        by_rate.max(by_acceleration).max(0.3)
    }
}

fn strokes(occasion: &Occasion, budget: f64, random: &mut Random) -> Vec<Segment> {
    let mut plan = Vec::new();
    let mut left = budget;
    let mut opens = true;
    for share in [0.55, 0.55, 1.0, 1.0, 0.33, 0.33, 0.8, 0.8]
        .into_iter()
        .cycle()
        .take(40)
    {
        let to = if opens {
            occasion.at(random.uniform(0.82, 0.94))
        } else {
            occasion.at(random.uniform(0.04, 0.12))
        };
        let length = 0.86 * (occasion.open - occasion.closed);
        let seconds = occasion.stroke_seconds(length, share * random.uniform(0.9, 1.0));
        if seconds > left {
            break;
        }
        left -= seconds;
        opens = !opens;
        plan.push(Segment::Reach { to, seconds });
    }
    plan
}

fn shakes(occasion: &Occasion, budget: f64, random: &mut Random) -> Vec<Segment> {
    if budget < 1.2 {
        return Vec::new();
    }
    let places = ((budget / 3.2).round() as usize).clamp(1, 4);
    let each = budget / places as f64;
    let mut plan = Vec::new();
    for place in [0.22, 0.5, 0.78, 0.36].into_iter().take(places) {
        let travel = 0.28 * each;
        let hz = random.uniform(2.0, 3.6);
        let omega = std::f64::consts::TAU * hz;
        // The second sine of a shake adds 0.35 * 1.618^2 of the acceleration of the first.
        let amplitude = occasion.peak_acceleration / (1.92 * omega * omega);
        let amplitude = amplitude.min(0.15 * (occasion.open - occasion.closed));
        plan.push(Segment::Reach {
            to: occasion.at(place + random.uniform(-0.06, 0.06)),
            seconds: travel,
        });
        plan.push(Segment::Shake {
            amplitude,
            hz,
            seconds: each - travel,
        });
    }
    plan
}

fn following(occasion: &Occasion, budget: f64) -> Vec<Segment> {
    if budget < 2.0 {
        return Vec::new();
    }
    // A long one from nearly the end, and a short one from half-way when there is time.
    let parts: &[(f64, f64)] = if budget > 9.0 {
        &[(0.62, 1.0), (0.38, 0.5)]
    } else {
        &[(1.0, 1.0)]
    };
    let mut plan = Vec::new();
    for (part, share) in parts {
        let (start, lead) = match occasion.goes_by_itself {
            Some(start) => (start * share, None),
            None => (occasion.at(0.85 * share), Some(occasion.at(0.1))),
        };
        let whole = part * budget;
        let travel = occasion
            .stroke_seconds(occasion.open - occasion.closed, 0.6)
            .min(0.3 * whole);
        plan.push(Segment::Reach {
            to: start,
            seconds: travel,
        });
        plan.push(Segment::Follow {
            seconds: whole - travel,
            lead,
        });
    }
    plan
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Stream;

    const DOOR: Occasion = Occasion {
        closed: 0.0,
        open: 1.66,
        top_rate: 1.5,
        peak_acceleration: 11.0,
        goes_by_itself: Some(1.4),
    };

    fn planned(seconds: f64) -> Vec<Segment> {
        protocol(&DOOR, seconds, &mut Random::new(1, Stream::Plan))
    }

    #[test]
    fn the_protocol_takes_exactly_the_time_it_is_given() {
        for seconds in [2.0, 5.0, 10.0, 30.0, 60.0, 100.0, 400.0] {
            let plan = planned(seconds);
            let total: f64 = plan.iter().map(Segment::seconds).sum();
            assert!((total - seconds).abs() < 1e-9, "{total} of {seconds}");
            assert!(
                plan.iter().all(|segment| segment.seconds() > 0.15),
                "{seconds}: {plan:?}"
            );
        }
    }

    #[test]
    fn a_minute_has_every_kind_of_probing() {
        let plan = planned(60.0);
        let shakes = plan
            .iter()
            .filter(|segment| matches!(segment, Segment::Shake { .. }))
            .count();
        let follows = plan
            .iter()
            .filter(|segment| matches!(segment, Segment::Follow { .. }))
            .count();
        let slow = plan
            .iter()
            .filter(|segment| matches!(segment, Segment::Reach { seconds, .. } if *seconds > 4.0))
            .count();
        let fast = plan
            .iter()
            .filter(|segment| matches!(segment, Segment::Reach { seconds, .. } if *seconds < 2.4))
            .count();
        assert!(
            shakes == 4 && follows == 2 && slow >= 2 && fast >= 3,
            "{plan:?}"
        );
    }

    #[test]
    fn two_minutes_are_two_rounds_that_differ() {
        let plan = planned(120.0);
        assert_ne!(plan[..plan.len() / 2], plan[plan.len() / 2..]);
        assert_eq!(
            plan.iter()
                .filter(|segment| matches!(segment, Segment::Shake { .. }))
                .count(),
            8
        );
    }

    #[test]
    fn the_protocol_ends_closed_and_at_rest() {
        let plan = planned(60.0);
        assert!(matches!(
            plan[plan.len() - 2..],
            [Segment::Reach { to: 0.0, .. }, Segment::Hold { .. }]
        ));
    }
}
