//! How much more it takes to leave rest than to slide, and whether that is felt while it slides slowly, too: read off the effort about rests, which
//! no fit of the motion sees.

use core::ops::Range;

use super::model::{Found, RIGID, slopes_of};
use crate::effect::friction::falling;
use crate::effect::slip;
use crate::motion::Motion;
use crate::samples::{extrema, quantile};

/// The median of some values.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Median {
    pub(super) value: f64,
    /// Its standard deviation.
    pub(super) std: f64,
    /// Of how many.
    pub(super) count: usize,
}

/// What the joint took to break away beyond what it took to slide from there on.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Breakaway {
    /// Beyond sliding, as it left rest, if that is gone at once: N m or N.
    pub(super) at_once: Median,
    /// Sliding friction there, the median: N m or N.
    pub(super) sliding: f64,
    /// If it falls with the speed, by [`RATES`].
    pub(super) falls: Vec<Fall>,
}

/// What it took to break away falls while it slides, as a Stribeck friction does.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Fall {
    /// Speed by which half of it is gone, rad/s or m/s.
    pub(super) speed: f64,
    /// Beyond sliding, as it left rest: N m or N. Taken for gone at once it would look larger.
    pub(super) excess: Median,
    /// Logarithm of the squared error about a rest without the fall over that with it.
    pub(super) gain: Median,
}

/// Speeds of a fall, as multiples of one below which the joint is taken to rest. A faster one shows in the fits of the motion.
const RATES: [f64; 6] = [1.0, 1.4, 2.0, 2.8, 4.0, 5.6];
/// A rest lasts at least so long, s.
const RESTS_S: f64 = 0.1;
/// It leaves at most so long before and after its smoothed speed shows that, s; so it comes, the other way round in time.
const LEAVES_S: [f64; 2] = [0.1, 0.02];
/// The instant is told by the motion so long before and after it shows, s.
const TOLD_S: f64 = 0.06;
/// What it took to leave by a straight line through the effort of so long before, s.
const LINE_S: f64 = 0.04;
/// of so many samples.
const LEAST_LINE: usize = 3;
/// It has left when it is this share of the range away after so long, s.
const LEFT: f64 = 0.01;
const AFTER_S: f64 = 0.15;
/// Rests this near to an end are at a stop or on a catch, as a share of the range.
const END: f64 = 0.06;

impl Median {
    fn of(values: &[f64]) -> Option<Self> {
        let value = quantile(values, 0.5);
        let apart: Vec<f64> = values.iter().map(|one| (one - value).abs()).collect();
        (!values.is_empty()).then(|| Self {
            value,
            // From the median deviation, for normal scatter.
            std: 1.2533 * 1.4826 * quantile(&apart, 0.5) / (values.len() as f64).sqrt(),
            count: values.len(),
        })
    }

    /// It and another, each by how many it is of.
    fn with(self, other: Self) -> Self {
        let count = self.count + other.count;
        let [of_self, of_other] = [self, other].map(|part| part.count as f64 / count as f64);
        Self {
            value: of_self * self.value + of_other * other.value,
            std: (of_self * self.std).hypot(of_other * other.std),
            count,
        }
    }
}

impl Breakaway {
    /// Of a motion whose effort while it slides is inertia, friction and `found` with the estimates `theta`; nothing when it never
    /// left a rest away from the ends. [`RATES`] are multiples of `slow_speed`.
    pub(super) fn of(
        motion: &Motion,
        found: &[Found],
        theta: &[f64],
        slow_speed: f64,
    ) -> Option<Self> {
        let sliding = Sliding::of(motion, found, theta);
        if sliding.samples(LINE_S) < LEAST_LINE {
            return None;
        }
        let edges = edges(motion);
        let (leaves, comes): (Vec<&Edge>, Vec<&Edge>) = edges.iter().partition(|edge| edge.leaves);
        // Squared errors about each edge, and the median excess.
        let with = |speed: Option<f64>| {
            let mut told: Vec<Told> = leaves
                .iter()
                .map(|edge| sliding.told(edge, speed, None))
                .collect();
            let excesses: Vec<f64> = told.iter().map(|told| told.excess).collect();
            let excess = Median::of(&excesses)?;
            let came = comes.iter();
            told.extend(came.map(|edge| sliding.told(edge, speed, Some(excess.value))));
            let errors: Vec<f64> = told.iter().map(|told| told.error).collect();
            Some((excess, errors))
        };
        let (at_once, without) = with(None)?;
        let fall = |rate: &f64| {
            let speed = rate * slow_speed;
            let (excess, with) = with(Some(speed))?;
            let pairs = without.iter().zip(with);
            let gains: Vec<f64> = pairs.map(|(without, with)| (without / with).ln()).collect();
            let gain = Median::of(&gains)?;
            Some(Fall {
                speed,
                excess,
                gain,
            })
        };
        let levels: Vec<f64> = leaves
            .iter()
            .map(|edge| edge.way * (sliding.at(edge.at, edge.way) - sliding.load(edge.at)))
            .collect();
        Some(Self {
            at_once,
            sliding: quantile(&levels, 0.5),
            falls: RATES.iter().filter_map(fall).collect(),
        })
    }

    /// It and those of other recordings together, each by how often the joint rested there.
    pub(super) fn with<'a>(&self, others: impl Iterator<Item = &'a Self>) -> Self {
        others.fold(self.clone(), |all, one| {
            let both = all.falls.iter().zip(&one.falls);
            let count = (all.at_once.count + one.at_once.count) as f64;
            let [of_all, of_one] = [&all, one].map(|part| part.at_once.count as f64 / count);
            Self {
                at_once: all.at_once.with(one.at_once),
                sliding: of_all * all.sliding + of_one * one.sliding,
                falls: both
                    .map(|(all, one)| Fall {
                        speed: all.speed,
                        excess: all.excess.with(one.excess),
                        gain: all.gain.with(one.gain),
                    })
                    .collect(),
            }
        })
    }
}

/// The joint leaves a rest away from the ends, or comes to one.
struct Edge {
    leaves: bool,
    /// The sample of the motion that is next to the rest.
    at: usize,
    /// Sign of the velocity.
    way: f64,
    /// How many samples it rests.
    rests: usize,
    run: Range<usize>,
}

fn edges(motion: &Motion) -> Vec<Edge> {
    let samples = |s: f64| (s / motion.period).round() as usize;
    let (low, high) = extrema(&motion.q);
    let (from, to) = (low + END * (high - low), high - END * (high - low));
    let far = samples(AFTER_S);
    let mut out = Vec::new();
    for run in &motion.runs {
        let mut rests = 0;
        for i in run.clone() {
            if motion.dq[i].abs() < motion.slow_speed {
                rests += 1;
                continue;
            }
            let rests = core::mem::take(&mut rests);
            if rests < samples(RESTS_S) {
                continue;
            }
            for leaves in [false, true] {
                let (at, start, end) = if leaves {
                    (Some(i), Some(i), Some(i + far))
                } else {
                    let before = (i - rests).checked_sub(1);
                    (before, before.and_then(|at| at.checked_sub(far)), before)
                };
                let (Some(at), Some(start), Some(end)) = (at, start, end) else {
                    continue;
                };
                let inside = (from..to).contains(&motion.q[at])
                    && !slip::slides(&motion.slips, motion.time[at]);
                if !inside || start < run.start || end >= run.end {
                    continue;
                }
                let moved = motion.q[end] - motion.q[start];
                let way = moved.signum();
                // What it does when it turns or rests again is none of this edge's.
                let goes_on = motion.dq[start..=end].iter().all(|dq| way * dq > 0.0);
                if goes_on && moved.abs() >= LEFT * (high - low) {
                    out.push(Edge {
                        leaves,
                        at,
                        way,
                        rests,
                        run: run.clone(),
                    });
                }
            }
        }
    }
    out
}

/// The model's effort as the joint just slides, by sample.
struct Sliding<'a> {
    motion: &'a Motion,
    found: &'a [Found],
    theta: &'a [f64],
    /// Effects that are no function of the state, as they are at each sample were it to slide forward, and backward.
    rest: [Vec<f64>; 2],
    /// Inertia, which may change in the course of the recording.
    inertia: Vec<f64>,
}

/// What the motion about an edge says.
struct Told {
    /// What it leaves of the effort, squared.
    error: f64,
    /// What it took beyond sliding, or was known.
    excess: f64,
}

impl<'a> Sliding<'a> {
    fn of(motion: &'a Motion, found: &'a [Found], theta: &'a [f64]) -> Self {
        let rest = [1.0, -1.0].map(|way| {
            let mut rest = vec![0.0; motion.q.len()];
            let mut slides = motion.clone();
            slides.sign.fill(way);
            let mut at = RIGID;
            for found in found {
                let terms = found.terms().count();
                if found.kind.at.is_none() && !found.is_inertia() {
                    let series = found.series(&slides);
                    for (series, theta) in series.iter().zip(&theta[at..at + terms]) {
                        for (rest, value) in rest.iter_mut().zip(series) {
                            *rest += theta * value;
                        }
                    }
                }
                at += terms;
            }
            rest
        });
        let mut inertia = slopes_of(motion, found, theta).inertia;
        for inertia in &mut inertia {
            *inertia += theta[0];
        }
        Self {
            motion,
            found,
            theta,
            rest,
            inertia,
        }
    }

    fn samples(&self, s: f64) -> usize {
        (s / self.motion.period).round() as usize
    }

    /// About to slide towards `way` at sample `i`.
    fn at(&self, i: usize, way: f64) -> f64 {
        self.at_speed(i, way * SLOWEST * self.motion.slow_speed)
    }

    /// At sample `i` with the velocity `dq`, without inertia and viscous friction.
    fn at_speed(&self, i: usize, dq: f64) -> f64 {
        let q = self.motion.q[i];
        let rest = &self.rest[usize::from(dq < 0.0)];
        let mut sum = self.theta[1] * dq.signum() + rest[i];
        let mut at = RIGID;
        for found in self.found {
            let terms = found.terms().count();
            if let Some(state) = found.kind.at {
                let all = state(&found.shape, q + found.datum, dq);
                let used = all.into_iter().zip(&found.used).filter(|(_, used)| **used);
                for ((value, _), theta) in used.zip(&self.theta[at..at + terms]) {
                    sum += theta * value;
                }
            }
            at += terms;
        }
        sum
    }

    /// What it takes at sample `i` without friction: midway between sliding one way and the other.
    fn load(&self, i: usize) -> f64 {
        0.5 * (self.at(i, 1.0) + self.at(i, -1.0))
    }

    /// The squared error about an edge, and what it took there beyond sliding where that is not `known`.
    ///
    /// While it moves, the effort beyond sliding is what inertia and viscous friction take, and what falls with the `speed` where that is so. The
    /// instant of the edge is the one at which both are most alike through the same smoothing; the effort itself, which is not smoothed, then has
    /// what it took. The peak of the smoothed one would be lower by a third.
    fn told(&self, edge: &Edge, speed: Option<f64>, known: Option<f64>) -> Told {
        let motion = self.motion;
        let weights = motion.smoothing();
        let reach = weights.len() / 2;
        let dq = |k: usize| (edge.way * motion.dq[k]).max(SLOWEST * motion.slow_speed);
        let beyond = |k: usize| edge.way * (motion.tau[k] - self.at_speed(k, edge.way * dq(k)));
        let line = self.samples(LINE_S);
        let [rested, moved] = LEAVES_S.map(|s| self.samples(s));
        let rested = rested.min(edge.rests - line);
        let told = edge.at - self.samples(TOLD_S)..edge.run.end.min(edge.at + self.samples(TOLD_S));
        // From the motion towards the rest, and the instants that may be the edge.
        let (order, may_be): (Vec<usize>, _) = if edge.leaves {
            let end = edge.run.end.min(told.end + reach);
            let from = edge.at - rested;
            ((from..end).rev().collect(), from..=edge.at + moved)
        } else {
            let start = edge.run.start.max(told.start.saturating_sub(reach));
            let to = edge.at + rested;
            ((start..=to).collect(), edge.at - moved..=to)
        };
        let mut sums = vec![[0.0; 2]; told.len()];
        let carried: Vec<f64> = told
            .clone()
            .map(|j| edge.way * (self.inertia[j] * motion.ddq[j] + self.theta[2] * motion.dq[j]))
            .collect();
        let mut best = Told {
            error: f64::INFINITY,
            excess: 0.0,
        };
        for k in order {
            let moves = [beyond(k), speed.map_or(0.0, |speed| falling(speed, dq(k)))];
            for (sums, j) in sums.iter_mut().zip(told.clone()) {
                if let Some(weight) = (k + reach).checked_sub(j).and_then(|at| weights.get(at)) {
                    for (sum, value) in sums.iter_mut().zip(moves) {
                        *sum += weight * value;
                    }
                }
            }
            if !may_be.contains(&k) {
                continue;
            }
            let excess = known.unwrap_or_else(|| last_of_line(line, |d| beyond(k - d)));
            let left = sums.iter().zip(&carried);
            let error = left
                .map(|([moves, falls], carried)| (moves - excess * falls - carried).powi(2))
                .sum();
            if error < best.error {
                best = Told { error, excess };
            }
        }
        best
    }
}

/// A straight line through `count` values, `back` from the last, at the last.
fn last_of_line(count: usize, back: impl Fn(usize) -> f64) -> f64 {
    let weight = |d: usize| 2.0 * count as f64 - 1.0 - 3.0 * d as f64;
    let sum: f64 = (0..count).map(|d| weight(d) * back(d)).sum();
    sum / (0..count).map(weight).sum::<f64>()
}

/// Speed at which sliding begins, as a share of that below which the joint rests.
const SLOWEST: f64 = 1e-3;
