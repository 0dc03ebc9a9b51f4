//! Poses of Project Aria glasses, computed after the recording (MPS), into a recording of the wrench.
//!
//! The trajectory has the glasses' clock. Its utc column (a phone's clock, seconds off at worst) says roughly where it
//! belongs; the tool's own wrench in free air then says so to below a millisecond (see [`crate::calibrate`]).

use std::collections::BTreeMap;
use std::path::Path;

use ft_recording::rewrite::Rewrite;
use ft_recording::{
    KnownFrames, Pose7, PoseTrack, Recording, Stamped, TopicMap, TrackedFrame, metadata, topic,
};
use ft_wire::HostTime;
use ft_wire::frames::{AriaDevice, Frame, FtSensor, Tcp};

mod folder;
mod report;

use folder::MpsFolder;
pub use report::AriaReport;

use super::clock_map::ClockMap;
use super::cover::Uncovered;
use super::drift::{self, move_by};
use super::mps::{MpsPose, Trajectory};
use super::topics::{add_poses, import_entries};
use super::{ImportError, plausible};
use crate::calibrate::{CalibrateOptions, align_recording, free_air_parts};
use crate::config::{Frames, SaidFrames, StaticPose};
use crate::gyro::{self, Gyroscope};

/// How to import.
#[derive(Clone, Debug)]
pub struct AriaOptions {
    /// Where the frames stand; what is not said here is taken from the recording's `/tf_static`.
    pub frames: Option<SaidFrames>,
    /// Seconds after the first wrench at which the trajectory begins; else its utc says.
    pub starts_at_s: Option<f64>,
    /// Align by the tool's own wrench.
    pub align: bool,
    /// Where free air is and how far the offset is searched.
    pub calibrate: CalibrateOptions,
    /// Poses of a lower quality are left out, 0 to 1.
    pub min_quality: f64,
    /// Take the open-loop trajectory even when there is a closed-loop one.
    pub open_loop: bool,
    /// Topics of the source by other names.
    pub map: TopicMap,
    /// Replace an existing recording.
    pub overwrite: bool,
}

impl Default for AriaOptions {
    fn default() -> Self {
        Self {
            frames: None,
            starts_at_s: None,
            align: true,
            calibrate: CalibrateOptions::default(),
            min_quality: 0.0,
            open_loop: false,
            map: TopicMap::default(),
            overwrite: false,
        }
    }
}

/// Writes `out`: the recording `source` with the poses of the trajectory in `mps`, a folder of MPS results or a file.
///
/// # Errors
/// [`ImportError`].
pub fn import_aria(
    source: &Path,
    mps: &Path,
    out: &Path,
    options: &AriaOptions,
) -> Result<AriaReport, ImportError> {
    let (mut recording, known) = Recording::load_without_pose(source, &options.map)?;
    let folder = MpsFolder::find(mps)?;
    let path = folder.trajectory(options.open_loop)?;
    let trajectory = Trajectory::open(path, options.min_quality)?;
    let wrench = [
        &recording.wrench[0].at,
        &recording.wrench[recording.wrench.len() - 1].at,
    ];
    let (start, end) = (*wrench[0], *wrench[1]);
    let (utc, open_not_read) = folder.utc_map(&trajectory);
    let to_host = HostMap::of(&trajectory, utc, start, options.starts_at_s)?;
    let begins_s = to_host.at(&trajectory, 0).seconds_since(start);
    let duration_s = trajectory.duration_s();
    let search_s = if options.align {
        options.calibrate.search_s
    } else {
        0.0
    };
    if begins_s > end.seconds_since(start) + search_s || begins_s + duration_s < -search_s {
        return Err(ImportError::Apart {
            trajectory_s: duration_s,
            wrench_s: end.seconds_since(start),
            begins_s,
        });
    }
    let frames = match &options.frames {
        Some(said) => Some(complete(said, &known, source)?),
        None => frames_of(&known),
    };
    recording.pose = PoseTrack {
        frame: TrackedFrame::AriaDevice,
        samples: (0..trajectory.poses.len())
            .map(|k| Stamped {
                at: to_host.at(&trajectory, k),
                value: trajectory.poses[k].pose,
            })
            .collect(),
    };
    let alignment = match (options.align, &frames) {
        (false, _) => None,
        (true, None) => {
            return Err(ImportError::Missing {
                path: source.to_owned(),
                missing:
                    "no /tf_static from aria_device to tcp and ft_sensor, which alignment needs"
                        .to_owned(),
                hint: "pass --frames with a capture.toml that has [frames.aria_device_from_tcp] and [frames.tcp_from_ft_sensor], \
                       or --no-align to keep the times of utc",
            });
        }
        (true, Some(frames)) => {
            recording.aria_device_from_tcp = pose7(&frames.aria_device_from_tcp, source)?;
            recording.tcp_from_ft_sensor = pose7(&frames.tcp_from_ft_sensor, source)?;
            let found = align_recording(&recording, 0.0, &options.calibrate);
            Some(found.map_err(|source| ImportError::Align {
                source,
                hint: "Or give the times by hand: --no-align with --starts-at",
            })?)
        }
    };
    let mut drift = None;
    let alignment = alignment.map(|first| {
        move_by(&mut recording, &first);
        let parts = free_air_parts(&recording, &options.calibrate);
        let (alignment, found) = drift::of_aligned(&mut recording, first, &parts);
        drift = Some(found);
        alignment
    });
    let (imu_offsets_ms, calibration_not_read) = folder.imu_offsets();
    let not_read: Vec<String> = open_not_read
        .into_iter()
        .chain(calibration_not_read)
        .collect();
    let mut doubts = plausible::of_poses(&recording.pose.samples);
    if let Some(frames) = &frames {
        doubts.extend(plausible::of_mounts([
            (
                "glasses and tool",
                &pose7(&frames.aria_device_from_tcp, source)?,
            ),
            (
                "tool and sensor",
                &pose7(&frames.tcp_from_ft_sensor, source)?,
            ),
        ]));
    }
    let report = AriaReport {
        path: out.to_owned(),
        sources: folder.hashes(source)?,
        kind: trajectory.kind,
        poses: trajectory.poses.len() as u64,
        counts: trajectory.counts,
        utc_rms_ms: utc.map(|map| 1e-6 * map.rms_ns),
        begins_s,
        alignment,
        drift,
        replaced: replaced(&recording, &options.map),
        uncovered: Uncovered::of(&recording.wrench, &recording.pose.samples),
        doubts,
        has_tcp: frames.is_some(),
        imu_offsets_ms,
        gyroscope: Gyroscope::of(&recording, &recording.pose.samples),
        own_rate: own_rate(&trajectory),
        not_read: (!not_read.is_empty()).then(|| not_read.join("; ")),
    };
    write(source, &recording, frames.as_ref(), &report, options)?;
    Ok(report)
}

/// The trajectory's own angular rates against its rotations, both by the glasses' clock; `None` without rates, or where it hardly turns.
fn own_rate(trajectory: &Trajectory) -> Option<gyro::GyroCheck> {
    let at = |pose: &MpsPose| HostTime::from_nanos(pose.device_ns);
    let poses: Vec<_> = trajectory
        .poses
        .iter()
        .map(|pose| Stamped {
            at: at(pose),
            value: pose.pose,
        })
        .collect();
    let rates = trajectory
        .poses
        .iter()
        .filter(|pose| pose.rate.iter().all(|rate| rate.is_finite()));
    let rates: Vec<_> = rates
        .map(|pose| Stamped {
            at: at(pose),
            value: pose.rate,
        })
        .collect();
    // Of one clock.
    let check = gyro::check(&poses, &rates)?;
    Some(gyro::GyroCheck {
        skew_ppm: None,
        ..check
    })
}

/// Poses that the source has, which those of the trajectory replace.
fn replaced(recording: &Recording, map: &TopicMap) -> BTreeMap<String, u64> {
    let is_pose =
        |name: &str| matches!(map.resolve(name), Some(topic::ARIA_POSE | topic::TCP_POSE));
    let topics = recording.health.topics.iter();
    topics
        .filter(|(name, health)| is_pose(name) && health.messages > 0)
        .map(|(name, health)| (name.clone(), health.messages))
        .collect()
}

fn write(
    source: &Path,
    recording: &Recording,
    frames: Option<&Frames>,
    report: &AriaReport,
    options: &AriaOptions,
) -> Result<(), ImportError> {
    let mut rewrite = Rewrite::new();
    add_poses(&mut rewrite, topic::ARIA_POSE, &recording.pose.samples);
    rewrite.leave_out(topic::TCP_POSE);
    for name in report.replaced.keys() {
        rewrite.leave_out(name);
    }
    if let Some(frames) = frames {
        let device_from_tcp = pose7(&frames.aria_device_from_tcp, source)?;
        let tcp: Vec<_> = recording
            .pose
            .samples
            .iter()
            .map(|sample| Stamped {
                at: sample.at,
                value: sample.value.then(&device_from_tcp),
            })
            .collect();
        add_poses(&mut rewrite, topic::TCP_POSE, &tcp);
    }
    // What the recording says itself stays as it is.
    if let Some(said) = &options.frames {
        let at = recording.wrench[0].at;
        for (base, frame, pose) in [
            (AriaDevice::NAME, Tcp::NAME, &said.aria_device_from_tcp),
            (Tcp::NAME, FtSensor::NAME, &said.tcp_from_ft_sensor),
        ] {
            if let Some(pose) = pose {
                rewrite.set_frame(base, frame, pose7(pose, source)?, &options.map, at);
            }
        }
    }
    rewrite.metadata(metadata::IMPORT, import_entries("aria", report));
    rewrite.write(Some(source), &report.path, options.overwrite)?;
    Ok(())
}

/// What is said, and the rest by the recording.
fn complete(said: &SaidFrames, known: &KnownFrames, source: &Path) -> Result<Frames, ImportError> {
    let or_known = |said: Option<StaticPose>, known: Option<Pose7>, name: &str| {
        let pose = said.or_else(|| known.as_ref().map(static_pose));
        pose.ok_or_else(|| ImportError::Missing {
            path: source.to_owned(),
            missing: format!(
                "no such transform on /tf_static, and --frames has no [frames.{name}]"
            ),
            hint: "say it in the file of --frames",
        })
    };
    Ok(Frames {
        aria_device_from_tcp: or_known(
            said.aria_device_from_tcp,
            known.aria_device_from_tcp,
            "aria_device_from_tcp",
        )?,
        tcp_from_ft_sensor: or_known(
            said.tcp_from_ft_sensor,
            known.tcp_from_ft_sensor,
            "tcp_from_ft_sensor",
        )?,
    })
}

fn frames_of(known: &KnownFrames) -> Option<Frames> {
    let aria_device_from_tcp = static_pose(&known.aria_device_from_tcp?);
    Some(Frames {
        aria_device_from_tcp,
        tcp_from_ft_sensor: known
            .tcp_from_ft_sensor
            .map_or_else(StaticPose::default, |pose| static_pose(&pose)),
    })
}

pub(super) fn static_pose(pose: &Pose7) -> StaticPose {
    StaticPose {
        position_m: pose.position,
        quaternion_xyzw: pose.quaternion,
    }
}

fn pose7(pose: &StaticPose, path: &Path) -> Result<Pose7, ImportError> {
    Pose7::normalised(pose.position_m, pose.quaternion_xyzw).ok_or_else(|| ImportError::Content {
        path: path.to_owned(),
        reason: format!("{:?} is no rotation", pose.quaternion_xyzw),
    })
}

/// From the glasses' clock to the host's, before alignment.
enum HostMap {
    Utc(ClockMap),
    Start(HostTime),
}

impl HostMap {
    fn of(
        trajectory: &Trajectory,
        utc: Option<ClockMap>,
        wrench_start: HostTime,
        starts_at_s: Option<f64>,
    ) -> Result<Self, ImportError> {
        match (starts_at_s, utc) {
            (Some(s), _) => Ok(Self::Start(super::shifted(wrench_start, s))),
            (None, Some(map)) => Ok(Self::Utc(map)),
            (None, None) => Err(ImportError::NoUtc {
                path: trajectory.path.clone(),
                why: match trajectory.utc_pairs().len() {
                    0 => "its utc column is missing or -1",
                    _ => "its utc column stands still, and only a step says when it was true",
                },
            }),
        }
    }

    fn at(&self, trajectory: &Trajectory, k: usize) -> HostTime {
        let device_ns = trajectory.poses[k].device_ns;
        match self {
            Self::Utc(map) => HostTime::from_nanos(map.at(device_ns)),
            Self::Start(start) => {
                let since = device_ns - trajectory.poses[0].device_ns;
                HostTime::from_nanos(start.as_nanos().saturating_add(since))
            }
        }
    }
}
