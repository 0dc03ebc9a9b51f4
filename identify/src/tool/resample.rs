//! Streams of irregular stamps, read at any time; nothing inside a hole.

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};

const HOLE_S: f64 = 0.020;

/// Wrenches with their times, ascending.
pub(super) struct Stream {
    samples: Vec<(f64, [f64; 6])>,
    hole: f64,
    period: f64,
}

impl Stream {
    /// Each sample the mean of `every` following ones.
    pub(super) fn averaged(samples: impl Iterator<Item = (f64, [f64; 6])>, every: usize) -> Self {
        let mut stream = Self::new(means(samples, every, |sum: &mut [f64; 6], value, share| {
            for (sum, value) in sum.iter_mut().zip(value) {
                *sum += share * (value - *sum);
            }
        }));
        // Means on either side of a loss are farther apart than what they are of.
        stream.hole += stream.period * (every.max(1) - 1) as f64 / every.max(1) as f64;
        stream
    }

    pub(super) fn new(samples: Vec<(f64, [f64; 6])>) -> Self {
        let period = median_step(samples.iter().map(|s| s.0));
        Self {
            samples,
            hole: HOLE_S.max(3.0 * period),
            period,
        }
    }

    pub(super) fn len(&self) -> usize {
        self.samples.len()
    }

    /// Median time between samples, s.
    pub(super) fn period(&self) -> f64 {
        self.period
    }

    pub(super) fn span(&self) -> (f64, f64) {
        (
            self.samples.first().map_or(0.0, |s| s.0),
            self.samples.last().map_or(0.0, |s| s.0),
        )
    }

    /// Time of the first sample that is not before `t`; of the last where there is none.
    pub(super) fn first_from(&self, t: f64) -> f64 {
        let first = self.samples.partition_point(|sample| sample.0 < t);
        let sample = self.samples.get(first).or(self.samples.last());
        sample.map_or(t, |sample| sample.0)
    }

    /// Where reading at `t` begins.
    pub(super) fn place(&self, t: f64) -> usize {
        place(&self.samples, t)
    }

    /// What reading at `times` (ascending) takes of white noise, as [`crate::samples::Aside::interpolated`] has it.
    pub(super) fn interpolated(&self, times: &[f64]) -> f64 {
        let mut from = times.first().map_or(0, |t| self.place(*t));
        let part = |t: &f64| Some(bracket(&self.samples, *t, &mut from, self.hole)?.1);
        let parts: Vec<f64> = times.iter().filter_map(part).collect();
        let sum: f64 = parts.iter().map(|u| 2.0 * u * (1.0 - u)).sum();
        sum / parts.len().max(1) as f64
    }

    /// Linear interpolation at `t`; `from` moves along with rising `t`.
    pub(super) fn at(&self, t: f64, from: &mut usize) -> Option<[f64; 6]> {
        let (i, part) = bracket(&self.samples, t, from, self.hole)?;
        let (a, b) = (&self.samples[i].1, &self.samples[i + 1].1);
        // What stays the same stays so to the last bit: a sensor at the end of its range is found by that.
        Some(core::array::from_fn(|k| a[k] + (b[k] - a[k]) * part))
    }
}

/// Poses with their times, ascending.
pub(super) struct PoseStream {
    samples: Vec<(f64, Isometry3<f64>)>,
    hole: f64,
}

/// Where a [`PoseStream`] is read, with the step there.
pub(super) struct PosePlace {
    from: usize,
    step: Option<(usize, Step)>,
}

/// How a tool goes from one sample to the next: displacement in `world`, turn in the axes of the first, and their rates at either end.
struct Step {
    moved: Vector3<f64>,
    turned: Vector3<f64>,
    velocities: [Vector3<f64>; 2],
    rates: [Vector3<f64>; 2],
}

impl PoseStream {
    pub(super) fn new(samples: Vec<(f64, Isometry3<f64>)>) -> Self {
        let hole = HOLE_S.max(3.0 * median_step(samples.iter().map(|s| s.0)));
        Self { samples, hole }
    }

    pub(super) fn span(&self) -> (f64, f64) {
        (
            self.samples.first().map_or(0.0, |s| s.0),
            self.samples.last().map_or(0.0, |s| s.0),
        )
    }

    /// Where reading at `t` begins.
    pub(super) fn place(&self, t: f64) -> PosePlace {
        PosePlace {
            from: place(&self.samples, t),
            step: None,
        }
    }

    /// Hermite position and rotation at `t`.
    pub(super) fn at(&self, t: f64, place: &mut PosePlace) -> Option<Isometry3<f64>> {
        let (i, u) = bracket(&self.samples, t, &mut place.from, self.hole)?;
        let (t0, a) = &self.samples[i];
        let here = place.step.take_if(|(of, _)| *of == i);
        let (_, step) = place
            .step
            .insert(here.unwrap_or_else(|| (i, Step::of(&self.samples, i, self.hole))));
        let long = self.samples[i + 1].0 - t0;
        let (u2, u3) = (u * u, u * u * u);
        let weights = [
            3.0 * u2 - 2.0 * u3,
            long * (u3 - 2.0 * u2 + u),
            long * (u3 - u2),
        ];
        let between = |whole: &Vector3<f64>, rates: &[Vector3<f64>; 2]| {
            whole * weights[0] + rates[0] * weights[1] + rates[1] * weights[2]
        };
        let turned = between(&step.turned, &step.rates);
        Some(Isometry3::from_parts(
            Translation3::from(a.translation.vector + between(&step.moved, &step.velocities)),
            a.rotation * UnitQuaternion::from_scaled_axis(turned),
        ))
    }
}

/// Time, displacement and turn of a sample as another sees it.
type Seen = (f64, Vector3<f64>, Vector3<f64>);

impl Step {
    /// From sample `i` to the next. A rate is the slope of the parabola through three samples, so that a lost sample bends none; next to a hole it
    /// is that of the step.
    fn of(samples: &[(f64, Isometry3<f64>)], i: usize, hole: f64) -> Self {
        let (t0, a) = &samples[i];
        let seen = |k: usize| -> Seen {
            let (t, pose) = &samples[k];
            let turned = (a.rotation.inverse() * pose.rotation).scaled_axis();
            (
                t - t0,
                pose.translation.vector - a.translation.vector,
                turned,
            )
        };
        let apart = |k: usize| samples[k].0 - samples[k - 1].0;
        let here = (0.0, Vector3::zeros(), Vector3::zeros());
        let next = seen(i + 1);
        let (_, moved, turned) = next;
        // Mean rates from one to another, and how long that is.
        let over = |(from, p, r): Seen, (to, q, s): Seen| {
            let long = (to - from).max(f64::MIN_POSITIVE);
            ((q - p) / long, (s - r) / long, long)
        };
        let is_there = |k: usize| k > 0 && k < samples.len() && apart(k) <= hole && apart(k) > 0.0;
        let own = is_there(i + 1).then(|| over(here, next));
        let before = is_there(i).then(|| over(seen(i - 1), here));
        let after = is_there(i + 2).then(|| over(next, seen(i + 2)));
        let rate = |beside: Option<(Vector3<f64>, Vector3<f64>, f64)>| match (own, beside) {
            (None, _) => (Vector3::zeros(), Vector3::zeros()),
            (Some((velocity, rate, long)), Some((v, w, other))) => {
                let share = other / (long + other);
                (velocity.lerp(&v, 1.0 - share), rate.lerp(&w, 1.0 - share))
            }
            (Some((velocity, rate, _)), None) => (velocity, rate),
        };
        let ((v0, w0), (v1, w1)) = (rate(before), rate(after));
        Self {
            moved,
            turned,
            velocities: [v0, v1],
            rates: [w0, w1],
        }
    }
}

/// Poses without those that come less than a quarter period after the one before: trackers stamp some 1 us apart.
pub(super) fn thinned(mut samples: Vec<(f64, Isometry3<f64>)>) -> Vec<(f64, Isometry3<f64>)> {
    let least = 0.25 * median_step(samples.iter().map(|s| s.0));
    let mut before: Option<(f64, Isometry3<f64>)> = None;
    // In place: an hour of them is much memory.
    samples.retain_mut(|(t, pose)| {
        if let Some((last, before)) = before {
            if *t - last < least {
                return false;
            }
            // Both quaternions stand for one rotation: stay on one side.
            if before.rotation.coords.dot(&pose.rotation.coords) < 0.0 {
                pose.rotation = UnitQuaternion::new_unchecked(-pose.rotation.into_inner());
            }
        }
        before = Some((*t, *pose));
        true
    });
    samples
}

/// Each pose the mean of `every` following ones.
pub(super) fn averaged(
    samples: Vec<(f64, Isometry3<f64>)>,
    every: usize,
) -> Vec<(f64, Isometry3<f64>)> {
    means(
        samples.into_iter(),
        every,
        |mean: &mut Isometry3<f64>, pose, share| {
            mean.translation.vector += share * (pose.translation.vector - mean.translation.vector);
            mean.rotation = mean.rotation.nlerp(&pose.rotation, share);
        },
    )
}

/// Means of `every` following samples, and of their times; none goes over a hole. `add` moves a mean by a share towards a
/// value. What is left over at a hole is a mean of fewer.
fn means<T>(
    samples: impl Iterator<Item = (f64, T)>,
    every: usize,
    add: impl Fn(&mut T, T, f64),
) -> Vec<(f64, T)> {
    if every <= 1 {
        return samples.collect();
    }
    let mut out: Vec<(f64, T)> = Vec::with_capacity(samples.size_hint().0 / every + 1);
    let (mut inside, mut last) = (every, f64::NEG_INFINITY);
    for (t, value) in samples {
        let open = inside < every && t - last <= HOLE_S;
        last = t;
        match out.last_mut().filter(|_| open) {
            Some((time, mean)) => {
                inside += 1;
                let share = 1.0 / inside as f64;
                *time += share * (t - *time);
                add(mean, value, share);
            }
            None => {
                inside = 1;
                out.push((t, value));
            }
        }
    }
    out
}

/// Index of the last sample but one that is at or before `t`; 0 when none is.
fn place<T>(samples: &[(f64, T)], t: f64) -> usize {
    let before = samples.partition_point(|sample| sample.0 <= t);
    before
        .min(samples.len().saturating_sub(1))
        .saturating_sub(1)
}

/// Index of the sample at or before `t` and the part of the step passed; `None` in a hole or outside.
fn bracket<T>(samples: &[(f64, T)], t: f64, from: &mut usize, hole: f64) -> Option<(usize, f64)> {
    while *from + 2 < samples.len() && samples[*from + 1].0 <= t {
        *from += 1;
    }
    let (a, b) = (samples.get(*from)?.0, samples.get(*from + 1)?.0);
    let step = b - a;
    if t < a - 1e-9 || t > b + 1e-9 || step > hole {
        return None;
    }
    Some((
        *from,
        if step > 0.0 {
            ((t - a) / step).clamp(0.0, 1.0)
        } else {
            0.0
        },
    ))
}

/// Median time between samples, s; 1 when there is none.
pub(super) fn median_step(times: impl Iterator<Item = f64>) -> f64 {
    let times: Vec<f64> = times.collect();
    let steps: Vec<f64> = times
        .windows(2)
        .map(|w| w[1] - w[0])
        .filter(|s| *s > 0.0)
        .collect();
    let median = crate::samples::quantile(&steps, 0.5);
    if median > 0.0 { median } else { 1.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn positions_between_samples_follow_a_smooth_path() {
        let path = |t: f64| Vector3::new((3.0 * t).sin(), t * t, 0.0);
        let samples = (0..100)
            .map(|i| 0.01 * f64::from(i))
            .map(|t| (t, Isometry3::new(path(t), Vector3::z() * t)))
            .collect();
        let stream = PoseStream::new(samples);
        let mut from = stream.place(0.0);
        for k in 0..180 {
            let t = 0.02 + 0.005 * f64::from(k);
            let pose = stream.at(t, &mut from).unwrap();
            assert!((pose.translation.vector - path(t)).norm() < 1e-6);
            assert!((pose.rotation.angle() - t).abs() < 1e-9);
        }
    }

    #[test]
    fn a_lost_pose_bends_neither_path_nor_turn() {
        // 1 m/s^2 and 20 rad/s^2, every sixth pose lost.
        let times = (0..100).filter(|i| i % 6 != 0).map(|i| f64::from(i) / 60.0);
        let angle = |t: f64| 0.5 * (5.0 * t).sin();
        let poses = times.map(|t| {
            (
                t,
                Isometry3::new(Vector3::x() * (0.5 * t * t), Vector3::z() * angle(t)),
            )
        });
        let stream = PoseStream::new(poses.collect());
        let mut from = stream.place(0.0);
        for k in 0..1400 {
            let t = 0.1 + 0.001 * f64::from(k);
            let pose = stream.at(t, &mut from).unwrap();
            assert!((pose.translation.vector.x - 0.5 * t * t).abs() < 1e-9);
            let turned = pose.rotation.scaled_axis().z;
            assert!(
                (turned - angle(t)).abs() < 1e-4,
                "{t}: {turned} {}",
                angle(t)
            );
        }
    }

    #[test]
    fn what_stays_the_same_stays_so_to_the_last_bit_between_samples() {
        let samples = (0..100).map(|i| (0.001 * f64::from(i), [133.700_3; 6]));
        let stream = Stream::averaged(samples, 1);
        let mut from = 0;
        for k in 0..300 {
            let between = stream.at(1e-4 + 3.1e-4 * f64::from(k), &mut from).unwrap();
            assert_eq!(between, [133.700_3; 6]);
        }
    }

    #[test]
    fn means_keep_a_ramp_and_do_not_go_over_a_hole() {
        let times = (0..1000).filter(|i| !(400..450).contains(i));
        let samples = times.map(|i| (0.001 * f64::from(i), [f64::from(i); 6]));
        let stream = Stream::averaged(samples, 4);
        let mut from = 0;
        for k in 1..98 {
            let t = 0.004 * f64::from(k);
            assert!((stream.at(t, &mut from).unwrap()[3] - 1000.0 * t).abs() < 1e-9);
        }
        assert_eq!(stream.at(0.42, &mut from), None);
        assert!((stream.at(0.7, &mut from).unwrap()[0] - 700.0).abs() < 1e-9);

        let turning = (0..400).map(|i| 0.001 * f64::from(i));
        let poses = turning.map(|t| (t, Isometry3::new(Vector3::x() * t, Vector3::z() * t)));
        for (t, mean) in averaged(poses.collect(), 5) {
            assert!((mean.translation.vector.x - t).abs() < 1e-12);
            assert!((mean.rotation.angle() - t).abs() < 1e-9);
        }
    }

    #[test]
    fn nothing_is_read_inside_a_hole() {
        let samples = (0..100)
            .filter(|i| !(40..45).contains(i))
            .map(|i| (0.01 * f64::from(i), [f64::from(i); 6]))
            .collect();
        let stream = Stream::new(samples);
        let mut from = 0;
        assert_eq!(stream.at(0.385, &mut from).unwrap()[0], 38.5);
        assert_eq!(stream.at(0.42, &mut from), None);
        assert_eq!(stream.at(0.455, &mut from).unwrap()[0], 45.5);
        assert_eq!(stream.at(1.5, &mut from), None);
    }
}
