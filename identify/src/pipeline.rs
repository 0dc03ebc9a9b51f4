//! A recording in, joint, dynamics, report and twin out.

use core::ops::Range;

use ft_recording::{Recording, TopicMap};
use nalgebra::{Isometry3, Point3, Vector3};
use std::path::{Path, PathBuf};

use crate::analysis::{Analysis, analyse_confirmed};
use crate::effort::{JointEffort, changed_effort, kinematic_track};
use crate::error::IdentifyError;
use crate::grasp::{Grasp, GraspSource};
use crate::joint_graph::{RefinedJoint, refine};
use crate::motion::MotionSettings;
use crate::parallel::both;
use crate::payload::{Payload, PayloadError, PayloadSource};
use crate::report::effects::TwinEffect;
use crate::report::{Input, Joint, Report};
use crate::samples::JointSamples;
use crate::saturation::{self, Saturated};
use crate::screw::{Candidates, JointKind, ScrewAxis, select};
use crate::tool::{ToolKinematics, ToolSamples};
use crate::twin::{Provenance, Source, Twin};

/// What has just been finished, for progress.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stage {
    /// The recording was read.
    Read,
    /// Streams are on one grid.
    Aligned,
    /// The tool's weight is known.
    Payload,
    /// The joint is known.
    Joint,
    /// The dynamics are known.
    Dynamics,
}

/// An identified recording or table.
#[derive(Clone, Debug)]
pub struct Identified {
    /// `report.json`.
    pub report: Report,
    /// `twin.json`; nothing when the dynamics are unknown.
    pub twin: Option<Twin>,
    /// The fits.
    pub analysis: Option<Analysis>,
    /// The joint's axis; nothing for a table.
    pub axis: Option<ScrewAxis>,
    /// Positions of the tool in `world` at about 50 Hz.
    pub path: Vec<Point3<f64>>,
    /// Joint coordinate and effort, as measured.
    pub samples: JointSamples,
}

const MIN_HELD_S: f64 = 5.0;
const MIN_CONTACT_N: f64 = 0.3;
/// Held by hand the tool also shifts on the handle.
const MOST_OFF_HELD_PATH_M: f64 = 0.02;
/// Share of the held time at the end of the sensor's range that a fit survives.
const MOST_SATURATED: f64 = 0.002;
/// Most that positions may be off a joint's path, m, root mean square: a tracker wanders by some mm; a tool that also moved freely is
/// farther from any joint's path.
pub const MOST_OFF_PATH_M: f64 = 0.01;
const KINEMATIC_RATE_HZ: f64 = 50.0;

/// How the note begins of a recording of which only a part could be used.
pub const DAMAGED: &str = "the file is damaged";

/// Identifies one recording.
///
/// # Errors
/// [`IdentifyError`]. A tool whose weight is unknown is no error: the joint is reported, the dynamics are `null`, and the
/// report says why and what to do.
pub fn identify_recording(
    path: &Path,
    map: &TopicMap,
    settings: &MotionSettings,
    progress: &mut dyn FnMut(Stage),
) -> Result<Identified, IdentifyError> {
    identify_confirmed(path, &[], map, settings, progress)
}

/// As [`identify_recording`]; what the model lacks must be there in each of `confirm` too.
///
/// # Errors
/// [`IdentifyError`].
pub fn identify_confirmed(
    path: &Path,
    confirm: &[PathBuf],
    map: &TopicMap,
    settings: &MotionSettings,
    progress: &mut dyn FnMut(Stage),
) -> Result<Identified, IdentifyError> {
    let read = || -> Result<_, IdentifyError> {
        let mut recording = Recording::load(path, map)?;
        progress(Stage::Read);
        let tool = ToolSamples::means_from_recording(&recording)
            .map_err(|error| beside_damage(&recording, error.into()))?;
        // Hours of samples, all of them in `tool` now.
        recording.wrench = Vec::new();
        recording.pose.samples = Vec::new();
        let held = Held::of(&recording, &tool, settings, progress)
            .map_err(|error| beside_damage(&recording, error))?;
        Ok((recording, tool, held))
    };
    let (others, read) = both(|| read_others(confirm, map, settings), read);
    let others = others?;
    let damages: Vec<String> = others.iter().filter_map(Other::damage).collect();
    let (others, hashes): (Vec<_>, Vec<_>) = others
        .into_iter()
        .map(|other| (other.named, other.sha256))
        .unzip();
    let (recording, tool, held) = read?;
    if let Some(at) = hashes.iter().position(|hash| *hash == recording.sha256) {
        return Err(cannot_confirm(&confirm[at], IdentifyError::ConfirmsItself));
    }
    let mut identified = identify_with(&recording, (tool, held), &others, settings, progress)?;
    identified.report.notes.extend(damages);
    Ok(identified)
}

/// That a recording is damaged, where that may be why.
fn beside_damage(recording: &Recording, error: IdentifyError) -> IdentifyError {
    match &recording.health.truncated {
        Some(damage) => IdentifyError::Damaged {
            damage: damage.clone(),
            source: Box::new(error),
        },
        None => error,
    }
}

fn cannot_confirm(path: &Path, source: IdentifyError) -> IdentifyError {
    IdentifyError::Confirm {
        path: path.to_owned(),
        source: Box::new(source),
    }
}

/// A confirming recording.
struct Other {
    /// Its name and what it says of the joint.
    named: (String, JointSamples),
    sha256: String,
    truncated: Option<String>,
}

impl Other {
    fn damage(&self) -> Option<String> {
        let damage = self.truncated.as_ref()?;
        let file = &self.named.0;
        Some(format!(
            "{DAMAGED}: {file}: {damage}; what came before was used to confirm"
        ))
    }
}

/// The confirming recordings.
fn read_others(
    confirm: &[PathBuf],
    map: &TopicMap,
    settings: &MotionSettings,
) -> Result<Vec<Other>, IdentifyError> {
    let read = |path: &PathBuf| -> Result<_, IdentifyError> {
        let recording = Recording::load(path, map)?;
        let samples = joint_samples(&recording, settings)
            .map_err(|error| beside_damage(&recording, error))?;
        Ok(Other {
            named: (file_name(path), samples),
            sha256: recording.sha256,
            truncated: recording.health.truncated,
        })
    };
    let each = confirm.iter();
    each.map(|path| read(path).map_err(|error| cannot_confirm(path, error)))
        .collect()
}

/// Joint coordinate and effort of the held part of a recording, by its own joint.
///
/// # Errors
/// [`IdentifyError`], also where the tool's weight is unknown.
pub fn joint_samples(
    recording: &Recording,
    settings: &MotionSettings,
) -> Result<JointSamples, IdentifyError> {
    let tool = ToolSamples::means_from_recording(recording)?;
    let held = Held::of(recording, &tool, settings, &mut |_| {})?;
    held.payload?;
    Ok(held.effort.samples)
}

/// Identifies a recording that was read before.
///
/// # Errors
/// As [`identify_recording`].
pub fn identify_loaded(
    recording: &Recording,
    settings: &MotionSettings,
    progress: &mut dyn FnMut(Stage),
) -> Result<Identified, IdentifyError> {
    let tool = ToolSamples::means_from_recording(recording)?;
    let held = Held::of(recording, &tool, settings, progress)?;
    identify_with(recording, (tool, held), &[], settings, progress)
}

/// Effort, dynamics, report and twin of the held part; `recording` may be rid of its samples.
fn identify_with(
    recording: &Recording,
    (tool, held): (ToolSamples, Held),
    others: &[(String, JointSamples)],
    settings: &MotionSettings,
    progress: &mut dyn FnMut(Stage),
) -> Result<Identified, IdentifyError> {
    let Held {
        grasp,
        payload,
        candidates,
        joint,
        saturated,
        effort,
    } = held;
    let here = joint.axis.kind;
    if let Some((file, there)) = others.iter().find(|(_, other)| other.kind != here) {
        let (here, there) = (here.name(), there.kind.name());
        return Err(IdentifyError::Confirm {
            path: PathBuf::from(file),
            source: Box::new(IdentifyError::OtherJoint { here, there }),
        });
    }
    let mut report = describe(recording, &tool, &grasp, &candidates, &joint, &effort);
    let period = tool.period;
    let of_tool = payload.as_ref().map_or(0.0, |payload| {
        tool_inertia_std(payload, &tool, &grasp, &effort.axis)
    });
    drop(tool);
    if let Some(found) = saturated {
        report.notes.push(format!(
            "{} stays at {:.1} {} for {:.2} s: the sensor was at the end of its range there",
            found.name(),
            found.value,
            found.unit(),
            found.seconds
        ));
    }
    let mut analysis = match &payload {
        Ok(_) => Some(analyse_confirmed(&effort.samples, settings, others)?),
        Err(error) => {
            for name in ["inertia", "coulomb", "viscous"] {
                report
                    .not_identified
                    .insert(name.to_owned(), error.to_string());
            }
            None
        }
    };
    if let Some(analysis) = &mut analysis {
        analysis.full.widen_inertia(of_tool);
        if let Some(fit) = &mut analysis.jointly {
            fit.widen_inertia(of_tool);
        }
    }
    if let (Some(analysis), JointKind::Revolute) = (&mut analysis, joint.axis.kind) {
        let lever = joint.axis.distance(&joint.tool_position).max(1e-3);
        let share = joint.radius_std / lever;
        analysis.full.widen_for_lever(share, effort.by_path);
        if let Some(fit) = &mut analysis.jointly {
            fit.widen_for_lever(share, effort.by_path);
        }
    }
    if let Ok(payload) = payload {
        note_payload(&mut report, &payload);
        report.nonwork = Some(effort.nonwork);
        report.payload = Some(payload);
    }
    if let Some(analysis) = &analysis {
        report = report.with_dynamics(analysis);
    }
    progress(Stage::Dynamics);
    let twin = analysis.as_ref().map(|analysis| {
        let provenance = Provenance {
            recordings: vec![Source {
                file: file_name(&recording.path),
                sha256: recording.sha256.clone(),
            }],
            version: version(),
            calibration: report
                .payload
                .as_ref()
                .map(|payload| payload.source.name().to_owned()),
            held_out_rms: Some([analysis.base.held_out_rms, analysis.full.held_out_rms]),
        };
        Twin::new(
            effort.axis.kind,
            Some(&effort.axis),
            report.joint.q_range,
            analysis.speeds(),
            &analysis.full,
            provenance,
        )
        .with_effects(TwinEffect::of(analysis))
        .held_at(effort.tool_position)
    });
    let step = ((0.02 / period) as usize).max(1);
    let path = effort.path.iter().step_by(step).copied().collect();
    Ok(Identified {
        report,
        twin,
        analysis,
        axis: Some(effort.axis),
        path,
        samples: effort.samples,
    })
}

/// Identifies a table of one joint; `sha256` of its file goes into the twin.
#[must_use]
pub fn identified_table(
    file: &Path,
    sha256: String,
    samples: &JointSamples,
    analysis: Analysis,
) -> Identified {
    let input = Input {
        files: vec![file_name(file)],
        duration_s: samples.time.last().copied().unwrap_or(0.0)
            - samples.time.first().copied().unwrap_or(0.0),
        ..Input::default()
    }
    .with_gaps(&samples.runs, &samples.time);
    let report = Report::new(input, Joint::of_table(samples.kind, analysis.q_range))
        .with_dynamics(&analysis);
    let provenance = Provenance {
        recordings: vec![Source {
            file: file_name(file),
            sha256,
        }],
        version: version(),
        calibration: None,
        held_out_rms: Some([analysis.base.held_out_rms, analysis.full.held_out_rms]),
    };
    let twin = Twin::new(
        samples.kind,
        None,
        analysis.q_range,
        analysis.speeds(),
        &analysis.full,
        provenance,
    )
    .with_effects(TwinEffect::of(&analysis));
    Identified {
        report,
        twin: Some(twin),
        analysis: Some(analysis),
        axis: None,
        path: Vec::new(),
        samples: samples.clone(),
    }
}

/// The held part of a recording: a recording and one that confirms it are treated alike so far, and refused alike.
struct Held {
    grasp: Grasp,
    payload: PayloadOutcome,
    candidates: Candidates,
    joint: RefinedJoint,
    saturated: Option<Saturated>,
    effort: JointEffort,
}

impl Held {
    /// `tool` holds the recording's samples, `recording` may be rid of them.
    fn of(
        recording: &Recording,
        tool: &ToolSamples,
        settings: &MotionSettings,
        progress: &mut dyn FnMut(Stage),
    ) -> Result<Self, IdentifyError> {
        let marked = Grasp::from_marks(tool, recording);
        let joint_of = |grasp: &Grasp| -> Result<_, IdentifyError> {
            let track = kinematic_track(tool, &grasp.held, KINEMATIC_RATE_HZ);
            let candidates = select(&track)?;
            let joint = refine(&track, &candidates);
            Ok((candidates, joint))
        };
        let held_s =
            |grasp: &Grasp| grasp.held.iter().map(Range::len).sum::<usize>() as f64 * tool.period;
        // Where marks say when the tool was held, its weight is found beside the joint.
        let (marked_joint, weighed) = both(
            || {
                let long = marked.as_ref().filter(|grasp| held_s(grasp) >= MIN_HELD_S);
                long.map(joint_of)
            },
            || -> Result<_, IdentifyError> {
                let kinematics = ToolKinematics::of(tool)?;
                progress(Stage::Aligned);
                let (grasp, payload) =
                    grasp_and_payload(recording, tool, &kinematics, marked.as_ref())?;
                let seconds = |part: &Range<usize>| {
                    let last = tool.time[part.end - 1] + tool.period;
                    tool.time[part.start]..last
                };
                let held: Vec<Range<f64>> = grasp.held.iter().map(seconds).collect();
                let saturated = saturation::find(&tool.at_extremes, &held);
                Ok((kinematics, grasp, payload, saturated))
            },
        );
        let (kinematics, grasp, payload, saturated) = weighed?;
        let held_s = held_s(&grasp);
        if held_s < MIN_HELD_S {
            return Err(IdentifyError::HeldTooShort {
                held_s,
                needed_s: MIN_HELD_S,
            });
        }
        progress(Stage::Payload);
        let (candidates, joint) = marked_joint.unwrap_or_else(|| joint_of(&grasp))?;
        if grasp.source == GraspSource::WholeRecording && joint.position_rms > MOST_OFF_PATH_M {
            return Err(IdentifyError::NotOneJoint {
                rms_m: joint.position_rms,
                allowed_m: MOST_OFF_PATH_M,
            });
        }
        if let Some(found) = saturated.filter(|found| found.share() > MOST_SATURATED) {
            return Err(IdentifyError::Saturated {
                channel: found.name(),
                value: found.value,
                unit: found.unit(),
                share: found.share(),
                allowed: MOST_SATURATED,
            });
        }
        let effort = changed_effort(
            tool,
            &kinematics,
            &grasp,
            &joint,
            payload.as_ref().ok(),
            settings,
        )?;
        if effort.nonwork.contact_rms_n < MIN_CONTACT_N {
            return Err(IdentifyError::NoContact {
                force_n: effort.nonwork.contact_rms_n,
                needed_n: MIN_CONTACT_N,
            });
        }
        if joint.position_rms > MOST_OFF_HELD_PATH_M {
            return Err(IdentifyError::NeitherJoint {
                rms_m: joint.position_rms,
                allowed_m: MOST_OFF_HELD_PATH_M,
            });
        }
        progress(Stage::Joint);
        Ok(Self {
            grasp,
            payload,
            candidates,
            joint,
            saturated,
            effort,
        })
    }
}

type PayloadOutcome = Result<Payload, PayloadError>;

/// The parts of the recording, as `marked` where there are marks, and the tool's weight from its free-air part.
fn grasp_and_payload(
    recording: &Recording,
    tool: &ToolSamples,
    kinematics: &ToolKinematics,
    marked: Option<&Grasp>,
) -> Result<(Grasp, PayloadOutcome), IdentifyError> {
    let calibration = recording.calibration.as_ref();
    let estimate = |grasp: &Grasp| match Payload::estimate(
        tool,
        kinematics,
        &grasp.free_before,
        &grasp.free_after,
        calibration,
    ) {
        Err(PayloadError::Filter(error)) => Err(IdentifyError::from(error)),
        outcome => Ok(outcome),
    };
    if let Some(grasp) = marked {
        let payload = estimate(grasp)?;
        return Ok((grasp.clone(), payload));
    }
    if recording
        .marks
        .iter()
        .any(|mark| mark.value == "free_air_begin")
    {
        return Err(IdentifyError::NeverGrasped);
    }
    let whole = Grasp::whole(tool);
    let calibrated = estimate(&whole)?;
    let Ok(calibrated) = calibrated else {
        return Ok((whole, calibrated));
    };
    let Some(grasp) = Grasp::from_wrench(tool, kinematics, &calibrated) else {
        return Ok((whole, Ok(calibrated)));
    };
    let payload = estimate(&grasp)?;
    Ok((grasp, payload))
}

/// What is not known of the tool's own inertia about the joint, kg m^2 or kg: one standard deviation.
fn tool_inertia_std(payload: &Payload, tool: &ToolSamples, grasp: &Grasp, axis: &ScrewAxis) -> f64 {
    let Some(held) = grasp.held.first().filter(|held| !held.is_empty()) else {
        return 0.0;
    };
    let i = held.start;
    let world_from_tcp = Isometry3::from_parts(tool.position[i].into(), tool.rotation[i]);
    let ft_sensor_from_world = (world_from_tcp * tool.tcp_from_ft_sensor).inverse();
    payload.inertia_std_about(&ScrewAxis {
        direction: ft_sensor_from_world * axis.direction,
        point: ft_sensor_from_world * axis.point,
        kind: axis.kind,
    })
}

fn describe(
    recording: &Recording,
    tool: &ToolSamples,
    grasp: &Grasp,
    candidates: &Candidates,
    joint: &RefinedJoint,
    effort: &JointEffort,
) -> Report {
    let (low, high) = effort.samples.q_range();
    let input = Input {
        files: vec![file_name(&recording.path)],
        duration_s: tool.time.last().copied().unwrap_or(0.0)
            - tool.time.first().copied().unwrap_or(0.0),
        grasp: Some(
            match grasp.source {
                GraspSource::Marks => "marks",
                GraspSource::Wrench => "wrench",
                GraspSource::WholeRecording => "whole_recording",
            }
            .to_owned(),
        ),
        ..Input::default()
    }
    .with_gaps(&tool.runs, &tool.time);
    let mut report = Report::new(
        input,
        Joint::of_poses(&effort.axis, joint, candidates, [low, high]),
    );
    if grasp.source == GraspSource::WholeRecording {
        report.notes.push(
            "no `grasp` mark and no contact found by the wrench: the whole recording was taken as held".to_owned(),
        );
    }
    if !joint.uses_rotations {
        report.notes.push("the tool's rotation does not follow the joint (it turned in the hand or the grasp); positions alone were used".to_owned());
    }
    if let Some(damage) = &recording.health.truncated {
        report
            .notes
            .push(format!("{DAMAGED}: {damage}; what came before was used"));
    }
    report
}

fn note_payload(report: &mut Report, payload: &Payload) {
    if payload.source == PayloadSource::Calibration && payload.bias_std.iter().any(|std| *std > 5.0)
    {
        report.notes.push(
            "no free air and no calibrated bias: a constant of the sensor is in the load g(q), and cannot be told from it"
                .to_owned(),
        );
    }
    if let Some(calibrated) = payload.contradicted_kg {
        report.notes.push(format!(
            "the calibration says {calibrated:.3} kg in front of the sensor, the free air of this recording {:.3} ± {:.3} kg; free air was believed. Weigh \
             the tool anew: ft-capture calibrate",
            payload.mass_kg, payload.mass_std_kg
        ));
    }
    let [force, torque] = [0, 3].map(|k| Vector3::from_column_slice(&payload.bias_rate[k..k + 3]));
    if force.norm() > 0.0 {
        report.notes.push(format!(
            "the sensor's bias drifted by {:.3} N and {:.4} N m per minute between the free-air parts; a straight line was taken off",
            60.0 * force.norm(),
            60.0 * torque.norm()
        ));
    }
}

impl PayloadSource {
    /// The name used in reports.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::FreeAir => "free_air",
            Self::Calibration => "calibration",
            Self::Both => "both",
        }
    }
}

fn version() -> String {
    concat!("ft-identify ", env!("CARGO_PKG_VERSION")).to_owned()
}

fn file_name(path: &Path) -> String {
    path.file_name()
        .map_or_else(|| PathBuf::from(path), PathBuf::from)
        .display()
        .to_string()
}
