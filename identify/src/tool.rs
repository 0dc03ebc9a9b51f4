//! The tool's pose and wrench from a recording, on one uniform grid.
//!
//! The grid has the wrench's own median rate, or that of its means over 5 ms ([`ToolSamples::means_from_recording`]), with which faster poses are
//! averaged, too. Wrenches are interpolated linearly, positions and rotations by cubic
//! Hermite pieces. Where either stream has a hole (over 20 ms and over three of its periods) there is a gap: runs end and
//! begin there, and nothing is interpolated across. Poses that only repeat the one before under a new stamp are left out.

mod kinematics;
mod resample;

pub use kinematics::ToolKinematics;
pub(crate) use kinematics::{GRAVITY, smoothing_hz};

use core::ops::Range;

use ft_recording::recording::fresh;
use ft_recording::{Pose7, Recording, Stamped, TrackedFrame};
use ft_wire::time::HostTime;
use nalgebra::{Isometry3, Point3, Quaternion, Translation3, UnitQuaternion};

use crate::parallel::{both, in_parallel};
use crate::saturation::{Stretch, stretches};
use resample::{PoseStream, Stream, averaged, median_step, thinned};

/// Why a recording has no common grid.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum AlignError {
    /// A stream has too few samples.
    #[error(
        "{stream} has {samples} samples, need at least {needed}; check the sensor's connection and record again"
    )]
    TooFewSamples {
        /// `wrench` or `pose`.
        stream: &'static str,
        /// Samples there.
        samples: usize,
        /// Samples needed.
        needed: usize,
    },
    /// The streams do not overlap in time.
    #[error(
        "wrench and pose do not overlap in time: the wrench spans {wrench_s:.1} s, the pose {pose_s:.1} s, and they are {apart_s:.1} s apart; \
         check that both are stamped on one clock"
    )]
    NoOverlap {
        /// Length of the wrench stream, s.
        wrench_s: f64,
        /// Length of the pose stream, s.
        pose_s: f64,
        /// From the end of the earlier to the start of the later, s.
        apart_s: f64,
    },
    /// Holes leave too little.
    #[error(
        "{covered_s:.1} s of {total_s:.1} s have both wrench and pose ({gaps} gaps); the longest piece is {longest_s:.3} s and at least \
         {needed_s:.0} s are needed; look at the losses with `ft-capture check`"
    )]
    Gaps {
        /// Time covered by both, s.
        covered_s: f64,
        /// Time of overlap, s.
        total_s: f64,
        /// Number of gaps.
        gaps: usize,
        /// Longest piece, s.
        longest_s: f64,
        /// Needed, s.
        needed_s: f64,
    },
}

/// Pose and wrench of the tool, sampled uniformly within each run.
#[derive(Clone, Debug)]
pub struct ToolSamples {
    /// Stamp of time 0.
    pub start: HostTime,
    /// Time between samples within a run, s.
    pub period: f64,
    /// Gapless runs, as ranges into the series.
    pub runs: Vec<Range<usize>>,
    /// Time, s.
    pub time: Vec<f64>,
    /// Origin of `tcp` in `world`, m.
    pub position: Vec<Point3<f64>>,
    /// `world_from_tcp`.
    pub rotation: Vec<UnitQuaternion<f64>>,
    /// As recorded: force then torque, environment on tool, in `ft_sensor`.
    pub wrench: Vec<[f64; 6]>,
    /// Where the sensor sits.
    pub tcp_from_ft_sensor: Isometry3<f64>,
    /// Number of gaps between the runs.
    pub gaps: usize,
    /// What reading the wrench between its samples took of its white noise, as [`crate::samples::Aside::interpolated`] has it.
    pub interpolated: f64,
    /// Where the wrench as measured stays at its extremes.
    pub(crate) at_extremes: Vec<Stretch>,
}

const MIN_SAMPLES: usize = 50;
const MIN_PIECE_S: f64 = 3.0;
/// Means of the wrench are over so long, s: what is identified lies below 20 Hz.
const MEAN_S: f64 = 0.005;
/// Longer recordings are brought onto a coarser grid, of means: 8 min at 1 kHz are not, an hour is seen at 125 Hz. Memory stays bounded.
const MOST_SAMPLES: usize = 500_000;
/// Samples of the grid that are read in a row.
const STRETCH: usize = 2048;
/// The time of overlap may be so many times what the samples last.
const MOST_HOLES: f64 = 100.0;

impl ToolSamples {
    /// Brings a recording's streams onto one grid, at the rate of the wrench.
    ///
    /// # Errors
    /// [`AlignError`].
    pub fn from_recording(recording: &Recording) -> Result<Self, AlignError> {
        Self::in_means(recording, 0.0)
    }

    /// The same in means over 5 ms of a wrench that is faster, for what moves as slowly as a joint.
    ///
    /// # Errors
    /// [`AlignError`].
    pub fn means_from_recording(recording: &Recording) -> Result<Self, AlignError> {
        Self::in_means(recording, MEAN_S)
    }

    /// Each sample the mean over about `mean_s`, one at least.
    fn in_means(recording: &Recording, mean_s: f64) -> Result<Self, AlignError> {
        let start = recording
            .wrench
            .first()
            .map_or(HostTime::EPOCH, |first| first.at);
        let wrenches = || {
            let measured = fresh(&recording.wrench);
            let of = |s: &Stamped<[f64; 6]>| (s.at.seconds_since(start), s.value);
            let within = mean_s / mean_period(measured.iter().map(|s| of(s).0));
            let every = (within.round() as usize)
                .max(measured.len().div_ceil(MOST_SAMPLES))
                .max(1);
            let stream = Stream::averaged(measured.iter().map(of), every);
            (stream, every, measured.len(), stretches(&measured, start))
        };
        let poses = || {
            let measured = fresh(&recording.pose.samples);
            let of = |s: &Stamped<Pose7>| (s.at.seconds_since(start), isometry(&s.value));
            thinned(measured.iter().map(of).collect())
        };
        let ((wrench, every, wrenches, at_extremes), poses) = both(wrenches, poses);
        for (stream, samples) in [("wrench", wrenches), ("pose", poses.len())] {
            if samples < MIN_SAMPLES {
                return Err(AlignError::TooFewSamples {
                    stream,
                    samples,
                    needed: MIN_SAMPLES,
                });
            }
        }
        let poses_every = if every > 1 {
            let pose_period = mean_period(poses.iter().map(|s| s.0));
            ((wrench.period() / pose_period) as usize).max(1)
        } else {
            1
        };
        let pose = PoseStream::new(averaged(poses, poses_every));
        let (wrench_span, pose_span) = (wrench.span(), pose.span());
        // Wrenches of one rate are read where they are, and not between.
        let from = wrench.first_from(pose_span.0);
        let to = wrench_span.1.min(pose_span.1);
        if to <= from {
            return Err(AlignError::NoOverlap {
                wrench_s: wrench_span.1 - wrench_span.0,
                pose_s: pose_span.1 - pose_span.0,
                apart_s: wrench_span.0.max(pose_span.0) - to,
            });
        }
        let tracked_from_tcp = match recording.pose.frame {
            TrackedFrame::Tcp => Isometry3::identity(),
            TrackedFrame::AriaDevice => isometry(&recording.aria_device_from_tcp),
        };
        let mut samples = Self {
            start,
            period: wrench.period(),
            runs: Vec::new(),
            time: Vec::new(),
            position: Vec::new(),
            rotation: Vec::new(),
            wrench: Vec::new(),
            tcp_from_ft_sensor: isometry(&recording.tcp_from_ft_sensor),
            gaps: 0,
            interpolated: 0.0,
            at_extremes,
        };
        // A stamp that is years off would ask for years of grid.
        let there = wrench.len() as f64 * wrench.period();
        if to - from > MOST_HOLES * there {
            return Err(AlignError::Gaps {
                covered_s: there,
                total_s: to - from,
                gaps: 1,
                longest_s: there,
                needed_s: (to - from) / MOST_HOLES,
            });
        }
        samples.fill(&wrench, &pose, &tracked_from_tcp, from, to);
        samples.check(to - from)?;
        Ok(samples)
    }

    fn fill(
        &mut self,
        wrench: &Stream,
        pose: &PoseStream,
        tracked_from_tcp: &Isometry3<f64>,
        from: f64,
        to: f64,
    ) {
        let count = ((to - from) / self.period).floor() as usize + 1;
        let time = |k: usize| from + k as f64 * self.period;
        let starts: Vec<usize> = (0..count).step_by(STRETCH).collect();
        let read = in_parallel(&starts, |&start| {
            let (mut at_wrench, mut at_pose) = (wrench.place(time(start)), pose.place(time(start)));
            let of = |k: usize| {
                let t = time(k);
                let (wrench, tracked) =
                    wrench.at(t, &mut at_wrench).zip(pose.at(t, &mut at_pose))?;
                Some((k, wrench, tracked * tracked_from_tcp))
            };
            let stretch = start..(start + STRETCH).min(count);
            stretch.filter_map(of).collect::<Vec<_>>()
        });
        let total = read.iter().map(Vec::len).sum();
        self.time.reserve_exact(total);
        self.wrench.reserve_exact(total);
        self.position.reserve_exact(total);
        self.rotation.reserve_exact(total);
        let mut next = None;
        for (k, wrench, tcp) in read.into_iter().flatten() {
            let at = self.time.len();
            match self.runs.last_mut().filter(|_| next == Some(k)) {
                Some(run) => run.end = at + 1,
                None => self.runs.push(at..at + 1),
            }
            next = Some(k + 1);
            self.time.push(time(k));
            self.wrench.push(wrench);
            self.position.push(Point3::from(tcp.translation.vector));
            self.rotation.push(tcp.rotation);
        }
        self.gaps = self.runs.len().saturating_sub(1);
        self.interpolated = wrench.interpolated(&self.time);
    }

    fn check(&self, total_s: f64) -> Result<(), AlignError> {
        let longest_s = self.runs.iter().map(Range::len).max().unwrap_or(0) as f64 * self.period;
        let covered_s = self.time.len() as f64 * self.period;
        if longest_s < MIN_PIECE_S {
            return Err(AlignError::Gaps {
                covered_s,
                total_s,
                gaps: self.gaps,
                longest_s,
                needed_s: MIN_PIECE_S,
            });
        }
        Ok(())
    }

    /// Seconds from time 0 to a stamp.
    #[must_use]
    pub fn seconds(&self, at: HostTime) -> f64 {
        at.seconds_since(self.start)
    }

    /// The parts of the runs whose time lies within `[from, to]` s.
    #[must_use]
    pub fn runs_within(&self, from: f64, to: f64) -> Vec<Range<usize>> {
        let clip = |run: &Range<usize>| {
            let times = &self.time[run.clone()];
            run.start + times.partition_point(|t| *t < from)
                ..run.start + times.partition_point(|t| *t <= to)
        };
        self.runs
            .iter()
            .map(clip)
            .filter(|run| !run.is_empty())
            .collect()
    }
}

/// Period of samples at `times` (ascending) that may come in bursts and have holes, s; infinite of a few.
fn mean_period(times: impl ExactSizeIterator<Item = f64>) -> f64 {
    const MANY: usize = 64;
    if times.len() <= 2 * MANY {
        return f64::INFINITY;
    }
    median_step(times.step_by(MANY)) / MANY as f64
}

fn isometry(pose: &Pose7) -> Isometry3<f64> {
    let [x, y, z, w] = pose.quaternion;
    Isometry3::from_parts(
        Translation3::from(pose.position),
        UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z)),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_period_of_bursts_with_holes_is_that_of_the_samples() {
        // 16 samples every 16 ms, 1 us apart, and a hole of 10 s.
        let at = |k: i32| {
            let hole = if k > 5000 { 10.0 } else { 0.0 };
            0.016 * f64::from(k / 16) + 1e-6 * f64::from(k % 16) + hole
        };
        assert!((mean_period((0..10_000).map(at)) - 1e-3).abs() < 1e-6);
        assert_eq!(mean_period((0..100).map(at)), f64::INFINITY);
    }
}
