//! Which samples a fit may use, and how many each gate took.

mod stop;

use super::Motion;
use crate::samples::quantile;
use stop::Stop;

/// Fills `kept`, `gated` and `slow_speed`; gives the number of samples before the gates.
///
/// | gate | takes out |
/// |---|---|
/// | `border` | the filter's length at either end of a run |
/// | `slow` | within half a filter length of a stretch of 30 ms or more below the threshold speed: stuck, or about to be; a quick reversal, as in shaking, stays |
/// | `limit` | within half a filter length of the outermost 1 % of the range; where the joint is thrown against its stop, from where the weakest blow turns it; where it is pushed into a soft stop, from where the stop begins to give; and for as long as the filter rings of what the stop carries |
/// | `acceleration` | beyond three times what 99 % of the samples reach: a tracker that jumped |
///
/// The gate `slip`, about each instant at which the tool slid on the handle, is [`Motion::prepare`]'s.
pub(super) fn apply(motion: &mut Motion, cutoff_hz: f64) -> usize {
    let step = ((1.0 / (4.0 * cutoff_hz)) / motion.period).round().max(1.0) as usize;
    let border = (1.5 / cutoff_hz / motion.period).ceil() as usize;
    let window = (0.5 / cutoff_hz / motion.period).ceil() as usize;
    let (slow_speed, rest_shows) = slow_speed(motion);
    motion.slow_speed = slow_speed;
    let slow: Vec<bool> = motion
        .dq
        .iter()
        .map(|v| v.abs() < motion.slow_speed)
        .collect();
    let stuck = widened(motion, &lasting(motion, &slow, STUCK_S), window);
    let rests = lasting(motion, &slow, RESTS_S);
    let blur = (BLUR_S / motion.period).ceil() as usize;
    motion.slides = widened(motion, &rests, blur)
        .iter()
        .map(|rests| !(rest_shows && *rests))
        .collect();
    let speeds: Vec<f64> = motion.ddq.iter().map(|a| a.abs()).collect();
    let implausible = 3.0 * quantile(&speeds, 0.99);
    let near_limit = near_limit(motion, [window, border]);
    let mut total = 0;
    for run in motion.runs.clone() {
        for i in run.clone().step_by(step) {
            total += 1;
            let gate = if i < run.start + border || i + border >= run.end {
                Some("border")
            } else if stuck[i] {
                Some("slow")
            } else if near_limit[i] {
                Some("limit")
            } else if motion.ddq[i].abs() > implausible {
                Some("acceleration")
            } else {
                None
            };
            match gate {
                Some(name) => *motion.gated.entry(name).or_insert(0) += 1,
                None => motion.kept.push(i),
            }
        }
    }
    total
}

/// How long the joint is slow where fits leave out what is near, and where it is taken to rest, s: the smoothed speed passes zero
/// quickly where a joint sticks for some hundredths of a second.
const STUCK_S: f64 = 0.03;
const RESTS_S: f64 = 0.01;

/// What the smoothing of the coordinate blurs the end of a rest by, s.
const BLUR_S: f64 = 0.03;

/// Samples near which the joint turns, where friction is taken not to be known; none where the velocity's noise alone turns it.
pub(super) fn turns(motion: &Motion) -> Vec<bool> {
    let mut turns = vec![false; motion.q.len()];
    if slow_speed(motion).1 {
        for run in &motion.runs {
            for i in run.start + 1..run.end {
                if motion.turning[i - 1] * motion.turning[i] <= 0.0 {
                    turns[i - 1..=i].fill(true);
                }
            }
        }
    }
    let window = (TURN_S / motion.period).ceil() as usize;
    widened(motion, &turns, window.saturating_sub(1))
}

/// How long before and after a turn friction is not known, s: a light joint sticks for some ms, and neither when it stopped nor what
/// friction took up meanwhile is seen through the smoothing. Friction that turns 1 ms late is 1.5 % of the inertia of a drawer of 0.8 kg.
const TURN_S: f64 = 0.025;

/// Samples about an end stop. `windows` = samples to leave out about touching it and about a blow.
fn near_limit(motion: &Motion, windows: [usize; 2]) -> Vec<bool> {
    let range @ [low, high] = [quantile(&motion.q, 0.0), quantile(&motion.q, 1.0)];
    let blows = blows(motion, low, high);
    let stops = [false, true].map(|at_high| Stop::find(motion, range, at_high, &blows));
    let touches = |q: f64| stops.iter().any(|stop| stop.touches(q));
    let touching: Vec<bool> = motion.q.iter().map(|q| touches(*q)).collect();
    let mut struck = vec![false; motion.q.len()];
    for &i in &blows {
        struck[i] = true;
    }
    let mut out = widened(motion, &touching, windows[0]);
    let struck = widened(motion, &struck, windows[1]);
    for (out, near) in out.iter_mut().zip(&struck) {
        *out |= near;
    }
    let [least, _, most] = stop::between(motion, range, &motion.tau);
    let ringing = |at_blows_only: bool| -> Vec<bool> {
        let states = motion.q.iter().zip(&motion.tau).zip(&struck);
        let carried: Vec<f64> = states
            .map(|((&q, &tau), &struck)| {
                let whole = struck || !at_blows_only;
                stops.iter().map(|stop| stop.carries(q, tau, whole)).sum()
            })
            .collect();
        let rings = motion.kernel.reach_of(&motion.runs, &carried);
        rings
            .iter()
            .map(|ring| *ring > RINGS * (most - least))
            .collect()
    };
    let mut rings = ringing(false);
    let left = out.iter().filter(|out| !**out).count();
    let more = out
        .iter()
        .zip(&rings)
        .filter(|(out, rings)| !**out && **rings)
        .count();
    if more as f64 > MOST_RINGING * left as f64 {
        rings = ringing(true);
    }
    for (out, rings) in out.iter_mut().zip(rings) {
        *out |= rings;
    }
    out
}

/// Whoever turns just short of a stop at every stroke would have no samples left: beyond this share of them, what is carried there
/// counts only about blows.
const MOST_RINGING: f64 = 0.3;
/// Share of the effort between the ends that a stop's may leave through the filter.
const RINGS: f64 = 2e-3;

/// Where the joint turns in the outermost 4 % of its range with an acceleration that no hand has: most of it above the
/// fit's cut-off, far over the noise there, and not small beside what the hand does.
fn blows(motion: &Motion, low: f64, high: f64) -> Vec<usize> {
    let (outer, inner) = (0.04 * (high - low), 0.1 * (high - low));
    let Ok(slow) = motion.filtered(&motion.ddq) else {
        return Vec::new();
    };
    let quick: Vec<f64> = motion
        .ddq
        .iter()
        .zip(&slow)
        .map(|(a, s)| (a - s).abs())
        .collect();
    let between = |series: &[f64], level: f64| {
        let values = inside(motion, [low + inner, high - inner], series);
        quantile(&values.map(f64::abs).collect::<Vec<f64>>(), level)
    };
    let least = (9.0 * between(&quick, 0.5)).max(0.3 * between(&motion.ddq, 0.99));
    let reach = (0.05 / motion.period).ceil() as usize;
    let mut out = Vec::new();
    for run in &motion.runs {
        for i in run.start + reach + 1..run.end.saturating_sub(reach) {
            let q = motion.q[i];
            let outside = q < low + outer || q > high - outer;
            let turns = motion.dq[i - 1] * motion.dq[i] <= 0.0;
            if outside && turns && quick[i - reach..i + reach].iter().any(|a| *a > least) {
                out.push(i);
            }
        }
    }
    out
}

/// The values of a series where the coordinate is within `range`.
fn inside(motion: &Motion, [low, high]: [f64; 2], series: &[f64]) -> impl Iterator<Item = f64> {
    motion
        .q
        .iter()
        .zip(series)
        .filter(move |(q, _)| **q > low && **q < high)
        .map(|(_, value)| *value)
}

/// 2 % of the fast strokes' speed, but four times the velocity noise where that is known and larger, and never more
/// than a third of the typical speed, so that slow strokes survive. And whether rest shows: not where the noise alone is as fast.
fn slow_speed(motion: &Motion) -> (f64, bool) {
    let speeds: Vec<f64> = motion.dq.iter().map(|v| v.abs()).collect();
    let fast = quantile(&speeds, 0.95);
    let moving: Vec<f64> = speeds
        .iter()
        .copied()
        .filter(|v| *v > 0.02 * fast)
        .collect();
    let noise = motion
        .noise_of_q
        .iter()
        .filter_map(|series| motion.filtered(&motion.derivative(series)).ok())
        .map(|series| crate::least_squares::rms(&series))
        .fold(0.0, f64::max);
    let most = quantile(&moving, 0.5) / 3.0;
    ((0.02 * fast).max(4.0 * noise).min(most), 4.0 * noise < most)
}

/// The flags that hold for at least `least_s` on end.
fn lasting(motion: &Motion, flags: &[bool], least_s: f64) -> Vec<bool> {
    let least = (least_s / motion.period).ceil() as usize;
    let mut out = vec![false; flags.len()];
    for run in &motion.runs {
        let mut start = run.start;
        for i in run.clone() {
            if !flags[i] {
                start = i + 1;
            } else if i + 1 - start > least {
                out[i] = true;
            } else if i + 1 - start == least {
                out[start..=i].fill(true);
            }
        }
    }
    out
}

/// True within `window` samples of a flag, not across gaps.
fn widened(motion: &Motion, flags: &[bool], window: usize) -> Vec<bool> {
    let mut out = vec![false; flags.len()];
    for run in &motion.runs {
        let mut until = 0;
        for i in run.clone() {
            if flags[i] {
                until = i + window + 1;
            }
            out[i] = i < until;
        }
        let mut from = usize::MAX;
        for i in run.clone().rev() {
            if flags[i] {
                from = i.saturating_sub(window);
            }
            out[i] |= i >= from;
        }
    }
    out
}
