//! A joint coordinate and a generalized effort on one uniform grid: what every fit of the dynamics starts from.

use core::ops::Range;

use crate::effect::slip;
use crate::screw::JointKind;

/// Joint coordinate and effort, sampled uniformly, possibly with gaps between runs.
#[derive(Clone, Debug, PartialEq)]
pub struct JointSamples {
    /// Revolute (rad, N m) or prismatic (m, N).
    pub kind: JointKind,
    /// Time between samples within a run, s.
    pub period: f64,
    /// Gapless runs, ascending, as ranges into the series.
    pub runs: Vec<Range<usize>>,
    /// Time of each sample, s from the start of the recording.
    pub time: Vec<f64>,
    /// Joint coordinate as measured.
    pub q: Vec<f64>,
    /// Effort applied to the object as measured.
    pub tau: Vec<f64>,
    /// Series that carry the position sensor's noise and nothing else, in the unit of `q` (for a tracker: the residuals
    /// across the motion, with what its rotations do along it). Empty when there are none.
    pub noise_of_q: Vec<Vec<f64>>,
    /// What else the tool knows.
    pub aside: Aside,
}

/// What is known beside coordinate and effort, of a recording's tool mostly.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Aside {
    /// Force on the object along two perpendiculars of the joint's axis, fixed in `world`, N: of a hinge the first is the way from it to
    /// the tool at `q = 0`, and with the axis the second makes a right-handed frame of them; of a slide they are those that
    /// [`crate::screw::perpendiculars`] gives.
    pub across: Vec<Vec<f64>>,
    /// Effort of the tool's own weight and inertia, which was taken off what the sensor measured to get `tau`: it belongs to the
    /// time of the poses, not of the wrench. Empty when nothing was taken off.
    pub tool: Vec<f64>,
    /// The tool's own inertia about the joint, taken off with `tool`, kg m^2 or kg: noise of the poses acts on it as on the
    /// object's.
    pub tool_inertia: f64,
    /// Standard deviation of what the sensor's bias and the tool's weight, tilted as wrongly as the tracker has it, leave in `tau` all the time or
    /// slowly changing.
    pub offset_std: f64,
    /// How far the axis of a hinge leans from upright, when that is sure.
    pub lean: Option<Lean>,
    /// Whether the axis of a hinge is seen to be far from upright, so that the part's weight acts about it.
    pub lies: bool,
    /// A change of the tool or its sensor that free air after the release showed, and that the effort is rid of.
    pub change: Option<Change>,
    /// Where the tool is across its path, in the unit of `q`, where `noise_of_q` is not that alone because orientations are in it, too.
    pub beside: Vec<Vec<f64>>,
    /// What the floor is at most, in the unit of the effort: the held-out error of the most flexible model, where the noise that the
    /// position seems to have would make more than that. For tables only.
    pub floor_at_most: Option<f64>,
    /// Of position and effort the mean of `2 u (1 - u)`, where samples were put on the grid between two others (of positions in tables only), at the share `u` of
    /// the way: half of what that takes of the power of the fastest noise.
    pub interpolated: [f64; 2],
    /// What weight does at most about a hinge that is seen to stand upright, N m per kg m^2 of its inertia; nothing where the axis is not known or lies.
    pub most_weight: Option<f64>,
    /// By how much the wrench comes later than the pose, as free air shows it, and the standard deviation, s.
    pub late: Option<(f64, f64)>,
    /// Whether fits are to use the instants, too, at which the pose across the path shows that the tool slid on the handle.
    pub slips_left_in: bool,
    /// What the effort showed of how the tool slid along the path; the coordinate is rid of it.
    pub slid: Vec<Slid>,
}

/// The tool slid on the handle, along the path.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Slid {
    /// s from the start of the recording.
    pub at: f64,
    /// How far, in the unit of the coordinate.
    pub along: f64,
}

/// An upright hinge that leans: weight acts on it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lean {
    /// From upright, rad.
    pub angle: f64,
    /// The coordinate at which a part whose centre of mass is on the tool's side rests: weight needs `sin(q - lowest)`, rad.
    pub lowest: f64,
}

/// A change between the free air before the grasp and after the release.
#[derive(Clone, Debug, PartialEq)]
pub struct Change {
    /// `tool_mass` or `sensor_drift`, of the vocabulary of effects.
    pub name: &'static str,
    /// kg of mass, or N of force.
    pub size: f64,
    /// The effort as it was measured.
    pub tau: Vec<f64>,
}

impl JointSamples {
    /// Sample rate, Hz.
    #[must_use]
    pub fn rate_hz(&self) -> f64 {
        1.0 / self.period
    }

    /// Number of samples.
    #[must_use]
    pub fn len(&self) -> usize {
        self.q.len()
    }

    /// Whether there are no samples.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.q.is_empty()
    }

    /// Smallest and largest coordinate.
    #[must_use]
    pub fn q_range(&self) -> (f64, f64) {
        extrema(&self.q)
    }

    /// The same motion with the measured effort read `lag_s` later, for a sensor that reports late by that much; what was taken off
    /// for the tool stays where it is.
    #[must_use]
    pub fn with_effort_earlier(&self, lag_s: f64) -> Self {
        let steps = lag_s / self.period;
        let earlier = |series: &[f64]| {
            let mut out = series.to_vec();
            for run in &self.runs {
                let Some(last) = run.len().checked_sub(1) else {
                    continue;
                };
                for i in 0..run.len() {
                    let at = (i as f64 + steps).clamp(0.0, last as f64);
                    let low = (at.floor() as usize).min(last.saturating_sub(1));
                    let part = at - low as f64;
                    let high = (low + 1).min(last);
                    out[run.start + i] =
                        series[run.start + low] * (1.0 - part) + series[run.start + high] * part;
                }
            }
            out
        };
        // What was taken off for the tool stays where it is.
        let of_sensor = |series: &[f64]| {
            if self.aside.tool.is_empty() {
                return earlier(series);
            }
            let add = |(a, b): (&f64, &f64)| a + b;
            let measured: Vec<f64> = series.iter().zip(&self.aside.tool).map(add).collect();
            let own = self.aside.tool.iter();
            earlier(&measured)
                .iter()
                .zip(own)
                .map(|(a, b)| a - b)
                .collect()
        };
        let mut out = self.clone();
        out.tau = of_sensor(&self.tau);
        let (part, before) = (steps - steps.floor(), self.aside.interpolated[1]);
        let more = 2.0 * part * (1.0 - part);
        out.aside.interpolated[1] = before + more - 2.0 * before * more;
        for series in &mut out.aside.across {
            *series = earlier(series);
        }
        if let Some((late, _)) = &mut out.aside.late {
            *late -= lag_s;
        }
        if let Some(change) = &mut out.aside.change {
            change.tau = of_sensor(&change.tau);
        }
        out
    }

    /// The same with the effort as it was measured, where a change of the tool had been taken out of it.
    #[must_use]
    pub fn with_change_left_in(&self) -> Self {
        let mut out = self.clone();
        if let Some(change) = out.aside.change.take() {
            out.tau = change.tau;
        }
        out
    }

    /// The same with the instants left in at which the tool slid on the handle.
    #[must_use]
    pub fn with_slips_left_in(&self) -> Self {
        let mut out = self.clone();
        for slid in core::mem::take(&mut out.aside.slid) {
            out.shift(slid.at, slid.along);
        }
        out.aside.slips_left_in = true;
        out
    }

    /// The same where the tool slid by `slid`, on top of what the coordinate is rid of.
    #[must_use]
    pub fn rid_of(&self, slid: &[Slid]) -> Self {
        let mut out = self.clone();
        for slid in slid {
            out.shift(slid.at, -slid.along);
            let known = &mut out.aside.slid;
            match known
                .iter_mut()
                .find(|known| slip::is_one(known.at, slid.at))
            {
                Some(known) => known.along += slid.along,
                None => known.push(*slid),
            }
        }
        out.aside
            .slid
            .sort_unstable_by(|a, b| a.at.total_cmp(&b.at));
        out
    }

    fn shift(&mut self, at: f64, way: f64) {
        for (q, t) in self.q.iter_mut().zip(&self.time) {
            *q += way * slip::gone(t - at);
        }
    }
}

/// Smallest and largest value; (0, 0) when empty.
pub(crate) fn extrema(series: &[f64]) -> (f64, f64) {
    let fold = series
        .iter()
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| {
            (low.min(*v), high.max(*v))
        });
    if series.is_empty() { (0.0, 0.0) } else { fold }
}

/// The value below which `fraction` of the series lies; 0 when empty.
pub(crate) fn quantile(series: &[f64], fraction: f64) -> f64 {
    if series.is_empty() {
        return 0.0;
    }
    let mut sorted = series.to_vec();
    let index = ((sorted.len() - 1) as f64 * fraction.clamp(0.0, 1.0)).round() as usize;
    *sorted.select_nth_unstable_by(index, f64::total_cmp).1
}

/// The sign that makes the first sustained displacement positive: -1 when the coordinate first goes down by a fifth of
/// its range, else 1.
#[must_use]
pub fn opening_sign(q: &[f64]) -> f64 {
    let (low, high) = extrema(q);
    let start = q.first().copied().unwrap_or(0.0);
    let far = q.iter().find(|v| (*v - start).abs() > 0.2 * (high - low));
    if far.is_some_and(|v| *v < start) {
        -1.0
    } else {
        1.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ramp() -> JointSamples {
        let time: Vec<f64> = (0..100).map(|i| 0.01 * f64::from(i)).collect();
        JointSamples {
            kind: JointKind::Prismatic,
            period: 0.01,
            runs: vec![0..40, 40..100],
            q: time.clone(),
            tau: time.iter().map(|t| 3.0 * t).collect(),
            noise_of_q: Vec::new(),
            aside: Aside::default(),
            time,
        }
    }

    #[test]
    fn a_late_effort_is_brought_forward_within_its_run() {
        let moved = ramp().with_effort_earlier(0.025);
        assert!((moved.tau[10] - 3.0 * 0.125).abs() < 1e-12);
        assert!(
            (moved.tau[39] - 3.0 * 0.39).abs() < 1e-12,
            "a run's last sample stays"
        );
    }

    #[test]
    fn what_was_taken_off_for_the_tool_stays_in_its_time() {
        let mut samples = ramp();
        samples.aside.tool = samples.time.iter().map(|t| (20.0 * t).sin()).collect();
        for (tau, tool) in samples.tau.iter_mut().zip(&samples.aside.tool) {
            *tau -= tool;
        }
        let moved = samples.with_effort_earlier(0.025);
        assert!((moved.tau[10] - (3.0 * 0.125 - samples.aside.tool[10])).abs() < 1e-12);
    }

    #[test]
    fn the_first_sustained_displacement_opens() {
        assert_eq!(opening_sign(&[0.0, -0.01, 0.3, 1.0, -0.1]), 1.0);
        assert_eq!(opening_sign(&[0.0, 0.01, -0.3, -1.0, 0.1]), -1.0);
    }
}
