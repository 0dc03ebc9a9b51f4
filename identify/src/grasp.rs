//! When the tool held the object, and when it moved in free air.

use core::ops::Range;

use ft_recording::{Recording, Stamped};
use nalgebra::Vector3;

use crate::payload::Payload;
use crate::tool::{ToolKinematics, ToolSamples};

/// How the grasp was found.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum GraspSource {
    /// The operator's marks.
    Marks,
    /// The wrench without the tool's own.
    Wrench,
    /// Nothing says: the whole recording.
    WholeRecording,
}

/// The parts of a recording.
#[derive(Clone, Debug, PartialEq)]
pub struct Grasp {
    /// How it was found.
    pub source: GraspSource,
    /// While the object was held.
    pub held: Vec<Range<usize>>,
    /// From when the fingers close to the first of that: the tool may move the object already.
    pub closing: Range<usize>,
    /// In free air before.
    pub free_before: Vec<Range<usize>>,
    /// In free air after.
    pub free_after: Vec<Range<usize>>,
}

/// Time left out on either side of a grasp and a release, s: fingers closing, the object settling.
const MARGIN_S: f64 = 0.3;
/// A tool that is pushed by so much touches something, N.
pub(crate) const TOUCHING_N: f64 = 2.0;

impl Grasp {
    /// From the marks `free_air_begin`, `grasp`, `release` of a recording, the longest hold when there are several; `None`
    /// without a `grasp`.
    #[must_use]
    pub fn from_marks(tool: &ToolSamples, recording: &Recording) -> Option<Self> {
        let end = tool.time.last().copied()?;
        let named = |name: &'static str| times_of(tool, &recording.marks, name);
        let releases = named("release");
        let release_after = |t: f64| {
            releases
                .iter()
                .copied()
                .find(|r| *r > t)
                .unwrap_or(f64::INFINITY)
        };
        let (grasp, release) = named("grasp")
            .into_iter()
            .map(|t| (t, release_after(t)))
            .max_by(|a, b| (a.1.min(end) - a.0).total_cmp(&(b.1.min(end) - b.0)))?;
        let begin = named("free_air_begin")
            .into_iter()
            .rfind(|t| *t < grasp)
            .unwrap_or(f64::NEG_INFINITY);
        Some(Self {
            source: GraspSource::Marks,
            closing: closing(tool, grasp),
            held: tool.runs_within(grasp + MARGIN_S, release - MARGIN_S),
            free_before: tool.runs_within(begin, grasp - MARGIN_S),
            free_after: tool.runs_within(release + MARGIN_S, f64::INFINITY),
        })
    }

    /// From the contact force with a calibrated tool: from the first to the last time that its mean over 0.2 s passes 2 N for 0.4 s. The noise of
    /// accelerations, by which a shaken tool seems to push, goes out of such a mean.
    #[must_use]
    pub fn from_wrench(
        tool: &ToolSamples,
        kinematics: &ToolKinematics,
        payload: &Payload,
    ) -> Option<Self> {
        let window = ((0.2 / tool.period) as usize).max(1);
        let mut span: Option<[f64; 2]> = None;
        for run in &tool.runs {
            let mut before = false;
            for start in run.clone().step_by(window) {
                let part = start..(start + window).min(run.end);
                let count = part.len() as f64;
                let sum: Vector3<f64> = part.map(|i| payload.contact(tool, kinematics, i)[0]).sum();
                let touches = sum.norm() / count > TOUCHING_N;
                if touches && before {
                    let from = tool.time[start - window];
                    span = Some(span.map_or([from, tool.time[start]], |[first, _]| {
                        [first, tool.time[start]]
                    }));
                }
                before = touches;
            }
        }
        let [first, last] = span?;
        Some(Self {
            source: GraspSource::Wrench,
            closing: closing(tool, first),
            held: tool.runs_within(first + MARGIN_S, last - MARGIN_S),
            free_before: tool.runs_within(f64::NEG_INFINITY, first - MARGIN_S),
            free_after: tool.runs_within(last + MARGIN_S, f64::INFINITY),
        })
    }

    /// The whole recording as one grasp.
    #[must_use]
    pub fn whole(tool: &ToolSamples) -> Self {
        Self {
            source: GraspSource::WholeRecording,
            closing: 0..0,
            held: tool.runs.clone(),
            free_before: Vec::new(),
            free_after: Vec::new(),
        }
    }
}

/// What [`MARGIN_S`] leaves out after `grasp`, of the last run there.
fn closing(tool: &ToolSamples, grasp: f64) -> Range<usize> {
    let mut runs = tool.runs_within(grasp, grasp + MARGIN_S);
    runs.pop().unwrap_or(0..0)
}

fn times_of(tool: &ToolSamples, marks: &[Stamped<String>], name: &str) -> Vec<f64> {
    marks
        .iter()
        .filter(|mark| mark.value.trim().eq_ignore_ascii_case(name))
        .map(|mark| tool.seconds(mark.at))
        .collect()
}
