//! From tool poses and wrenches to the joint coordinate and the effort, by virtual work.
//!
//! The tool puts on the object what the environment puts on the tool, reversed. With that force `f` and moment `m` about
//! the sensor's origin `s`, all in `world`: `tau = omega . (m + (s - o) x f)` for an axis through `o`, `tau = v . f` for a
//! slide. What does no work (forces across the path, moments across the axis) is reported: it grows when the axis is wrong.

mod coordinate;
mod lead;
mod rigid;

use core::ops::Range;

use nalgebra::{Point3, UnitQuaternion, Vector3};

use crate::dynamics::fit_with_mechanism;
use crate::effect::RigidBody;
use crate::grasp::{self, Grasp};
use crate::joint_graph::RefinedJoint;
use crate::least_squares::rms;
use crate::motion::{Motion, MotionError, MotionSettings};
use crate::parallel::{both, in_parallel};
use crate::payload::{Payload, Since};
use crate::samples::{Aside, Change, JointSamples, Lean, opening_sign};
use crate::screw::{JointKind, PoseSamples, ScrewAxis, perpendiculars};
use crate::tool::{GRAVITY, ToolKinematics, ToolSamples};
use coordinate::Coordinate;
use rigid::{Grip, Rigid};

/// Root mean squares of the part of the contact wrench that does no work.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct NonWork {
    /// Force across the path at the TCP, N.
    pub force_rms_n: f64,
    /// Moment across the axis (revolute) or all of it (prismatic) at the TCP, N m.
    pub moment_rms_nm: f64,
    /// Contact force as a whole, N.
    pub contact_rms_n: f64,
}

/// The held part of a recording as joint samples.
#[derive(Clone, Debug)]
pub struct JointEffort {
    /// Coordinate and effort.
    pub samples: JointSamples,
    /// The axis with its final sense; `point` is the foot of the perpendicular from the tool at q = 0.
    pub axis: ScrewAxis,
    /// Where the tool holds the part at q = 0, m.
    pub tool_position: Point3<f64>,
    /// Share of the coordinate that positions make; of a hinge they are its path over the lever, and rotations make the rest.
    pub by_path: f64,
    /// Retained positions of the TCP, m.
    pub path: Vec<Point3<f64>>,
    /// What does no work.
    pub nonwork: NonWork,
    /// Whether the tool was taken to be where the joint carries it.
    pub carried: bool,
}

/// Positions and rotations of the held part, block means at about `rate_hz`, for kinematics.
#[must_use]
pub fn kinematic_track(tool: &ToolSamples, held: &[Range<usize>], rate_hz: f64) -> PoseSamples {
    let block = ((1.0 / tool.period / rate_hz).round() as usize).max(1);
    let mut track = PoseSamples {
        period: block as f64 * tool.period,
        ..PoseSamples::default()
    };
    for run in held.iter().filter(|run| run.len() >= block) {
        track.starts.push(track.positions.len());
        let mut start = run.start;
        while start + block <= run.end {
            let part = start..start + block;
            let mean = part
                .clone()
                .map(|i| tool.position[i].coords)
                .sum::<Vector3<f64>>()
                / block as f64;
            let middle = tool.rotation[start + block / 2];
            let turn = part
                .map(|i| (tool.rotation[i] * middle.inverse()).scaled_axis())
                .sum::<Vector3<f64>>()
                / block as f64;
            track.positions.push(Point3::from(mean));
            track
                .rotations
                .push(UnitQuaternion::from_scaled_axis(turn) * middle);
            start += block;
        }
    }
    track
}

/// Projects every held sample onto the joint and takes the effort; a mass that was put on the tool, or a drift of the sensor, that free air after the
/// release shows is taken out of it, and told in the samples.
///
/// # Errors
/// When the poses cannot be filtered.
pub fn changed_effort(
    tool: &ToolSamples,
    kinematics: &ToolKinematics,
    grasp: &Grasp,
    joint: &RefinedJoint,
    payload: Option<&Payload>,
    settings: &MotionSettings,
) -> Result<JointEffort, MotionError> {
    let effort =
        |payload, carried| effort_of(tool, kinematics, grasp, joint, (payload, carried), settings);
    let Some(payload) = payload else {
        return effort(None, None);
    };
    let (changed, since) = payload.after_release(tool, kinematics, &grasp.free_after);
    let (name, size) = match since {
        Since::Nothing => return effort(Some(payload), None),
        Since::Mass(mass) => ("tool_mass", mass),
        Since::Drift(force) => ("sensor_drift", force),
    };
    let as_measured = Payload {
        bias_rate: [0.0; 6],
        ..payload.clone()
    };
    let mut out = effort(Some(&changed), None)?;
    // By the same poses, so that nothing but the change is between the two.
    let tau = effort(Some(&as_measured), Some(out.carried))?.samples.tau;
    out.samples.aside.change = Some(Change { name, size, tau });
    Ok(out)
}

/// Projects every held sample onto the joint and takes the effort; `settings` are the fit's (whose cut-off may be lowered later): positions are weighed
/// against orientations by what their noise does to the acceleration below the cut-off. `carried` = whether the tool is where the joint carries it, when
/// that is known.
fn effort_of(
    tool: &ToolSamples,
    kinematics: &ToolKinematics,
    grasp: &Grasp,
    joint: &RefinedJoint,
    (payload, carried): (Option<&Payload>, Option<bool>),
    settings: &MotionSettings,
) -> Result<JointEffort, MotionError> {
    let index: Vec<usize> = grasp.held.iter().flat_map(Clone::clone).collect();
    let path: Vec<Point3<f64>> = index.iter().map(|&i| tool.position[i]).collect();
    let mut runs = Vec::new();
    let mut next = 0;
    for run in &grasp.held {
        runs.push(next..next + run.len());
        next += run.len();
    }
    let coordinate = Coordinate::of(tool, &index, &path, &runs, joint, settings.cutoff_hz)?;
    let touches = |i: usize| {
        payload.is_some_and(|payload| {
            payload.contact(tool, kinematics, i)[0].norm() > grasp::TOUCHING_N
        })
    };
    let lead = lead::lead(tool, grasp, &joint.axis, touches);
    let start = coordinate.q.first().copied().unwrap_or(0.0);
    let all: Vec<f64> = lead
        .iter()
        .map(|q| start + q)
        .chain(coordinate.q.iter().copied())
        .collect();
    let sense = opening_sign(&all);
    let mut axis = if sense < 0.0 {
        joint.axis.reversed()
    } else {
        joint.axis
    };
    let origin = all.first().copied().unwrap_or(0.0);
    let q: Vec<f64> = coordinate.q.iter().map(|q| sense * (q - origin)).collect();
    if let Some(first) = path.first() {
        let along = axis.direction.into_inner() * axis.direction.dot(&(first - axis.point));
        axis.point = if axis.kind == JointKind::Prismatic {
            first - axis.direction.into_inner() * q.first().copied().unwrap_or(0.0)
        } else {
            axis.point + along
        };
    }
    // Every held position, taken back to q = 0.
    let places: Vec<(&Point3<f64>, &f64)> = path.iter().zip(&q).collect();
    let taken_back = in_parallel(&places, |(p, q)| (axis.motion(-*q) * *p).coords);
    let tool_position = taken_back.iter().sum::<Vector3<f64>>() / path.len().max(1) as f64;
    let mut samples = JointSamples {
        kind: axis.kind,
        period: tool.period,
        runs,
        time: index.iter().map(|&i| tool.time[i]).collect(),
        q,
        tau: Vec::new(),
        noise_of_q: coordinate.noise,
        aside: Aside {
            lean: lean(&axis, tool_position, joint.direction_std),
            most_weight: most_weight(&axis, tool_position, joint.direction_std),
            lies: axis.kind == JointKind::Revolute
                && off_upright(&axis) - 5.0 * joint.direction_std > MOST_LEAN,
            beside: coordinate.beside,
            interpolated: [0.0, tool.interpolated],
            ..Aside::default()
        },
    };
    let (work, carried) = match payload {
        None => (Work::unknown(samples.len()), false),
        Some(payload) => {
            let handle = Point3::from(tool_position);
            let (held, q) = (samples.runs.as_slice(), samples.q.as_slice());
            let places = (&taken_back[..], handle);
            let grip = Grip::of(tool, (&index, held, q), (joint, &axis), places)?;
            let work = |rigid: Option<&Rigid<'_>>| {
                let held = (index.as_slice(), q, rigid);
                Work::of(tool, kinematics, held, payload, &axis, &handle)
            };
            match (grip, carried) {
                (Grip::Loose, _) | (_, Some(false)) => (work(None), false),
                (Grip::Firm(rigid), _) | (Grip::Doubtful(rigid), Some(true)) => {
                    (work(Some(&rigid)), true)
                }
                (Grip::Doubtful(rigid), None) => {
                    let both_works = both(|| work(Some(&rigid)), || work(None));
                    better_explained(&samples, both_works, settings)
                }
            }
        }
    };
    samples.tau = work.tau;
    samples.aside.across = work.across;
    samples.aside.tool = work.own;
    samples.aside.tool_inertia = work.tool_inertia;
    samples.aside.offset_std = work.offset_std;
    samples.aside.late = payload.and_then(|payload| payload.late_s);
    Ok(JointEffort {
        samples,
        axis,
        tool_position: tool_position.into(),
        by_path: coordinate.by_path,
        path,
        nonwork: work.nonwork,
        carried,
    })
}

/// See [`Aside::offset_std`]; `turned` = how far the tracker turns the tool wrongly, rad. Without free air the bias is as good as unknown, and
/// what it leaves is the load's.
fn offset_std(payload: &Payload, axis: &ScrewAxis, handle: &Point3<f64>, turned: f64) -> f64 {
    let part = |k: usize| match payload.bias_at_s {
        Some(_) => rms(&payload.bias_std[k..k + 3]),
        None => 0.0,
    };
    let force = part(0).hypot(payload.mass_kg * GRAVITY * turned);
    let torque = match axis.kind {
        JointKind::Prismatic => 0.0,
        JointKind::Revolute => part(3),
    };
    torque.hypot(axis.velocity_at(handle).norm() * force)
}

/// The one whose effort the most flexible model foretells better on held-out strokes, and whether that is the one by the joint.
fn better_explained(
    samples: &JointSamples,
    (by_joint, by_tracker): (Work, Work),
    settings: &MotionSettings,
) -> (Work, bool) {
    // One after the other: two motions of an hour are much memory.
    let left = [&by_joint, &by_tracker].map(|work| {
        let tau = work.tau.clone();
        let samples = JointSamples {
            tau,
            ..samples.clone()
        };
        let motion = Motion::prepare(&samples, settings).ok()?;
        let model = fit_with_mechanism(&motion, &[&RigidBody]).ok()?;
        Some(model.held_out_rms)
    });
    match left {
        [Some(joint), Some(tracker)] if joint < tracker => (by_joint, true),
        _ => (by_tracker, false),
    }
}

/// How far an upright hinge leans; nothing when it may as well be upright.
fn lean(axis: &ScrewAxis, tool_position: Vector3<f64>, std: f64) -> Option<Lean> {
    let (up, angle) = (axis.direction.into_inner(), off_upright(axis));
    let sure = angle > LEAST_LEAN && angle > 5.0 * std && angle < MOST_LEAN;
    if axis.kind != JointKind::Revolute || !sure {
        return None;
    }
    let arm = tool_position - axis.point.coords;
    let arm = (arm - up * up.dot(&arm)).normalize();
    // Weight about the axis is m g r (cos q (up x arm) - sin q arm), upwards components.
    Some(Lean {
        angle,
        lowest: (-up.cross(&arm).z).atan2(-arm.z),
    })
}

/// See [`Aside::most_weight`]: a part of the handle's reach `r` weighs 1.5 g / r of its inertia when it is a panel, and with much of it near the hinge
/// more.
fn most_weight(axis: &ScrewAxis, tool_position: Vector3<f64>, std: f64) -> Option<f64> {
    let leans = off_upright(axis) + 5.0 * std + UPRIGHT_TO;
    if axis.kind != JointKind::Revolute || leans > MOST_LEAN {
        return None;
    }
    let reach = axis.distance(&tool_position.into());
    (reach > 0.0).then(|| NEAR_THE_HINGE * 1.5 * GRAVITY / reach * leans.sin())
}

/// A tracker knows what is up to so much, rad.
const UPRIGHT_TO: f64 = 0.005;
const NEAR_THE_HINGE: f64 = 3.0;

/// Angle between an axis and the vertical, rad.
fn off_upright(axis: &ScrewAxis) -> f64 {
    axis.direction.xy().norm().atan2(axis.direction.z.abs())
}

/// Hinges are hung as upright as that, and trackers know what is up; beyond the other, weight is no small thing, rad.
const LEAST_LEAN: f64 = 0.008;
const MOST_LEAN: f64 = 0.15;

/// What the tool does at the joint.
struct Work {
    /// Effort of each sample.
    tau: Vec<f64>,
    /// What was taken off for the tool to get it.
    own: Vec<f64>,
    /// Force along the two directions [`across`].
    across: Vec<Vec<f64>>,
    nonwork: NonWork,
    /// Mean inertia of the tool about the joint, its mass taken as a point: kg m^2 or kg.
    tool_inertia: f64,
    /// See [`Aside::offset_std`].
    offset_std: f64,
}

/// Two perpendiculars of the axis: of a hinge the first is the way from it to the tool at `q = 0`, and the second is that along which
/// the tool then goes.
fn across(axis: &ScrewAxis, handle: &Point3<f64>) -> (Vector3<f64>, Vector3<f64>) {
    let along = axis.velocity_at(handle);
    match (axis.kind, along.try_normalize(0.0)) {
        (JointKind::Revolute, Some(along)) => (along.cross(&axis.direction), along),
        _ => perpendiculars(&axis.direction),
    }
}

/// [`Work`] at one sample, and the size of what does none.
struct AtSample {
    tau: f64,
    own: f64,
    across: [f64; 2],
    force: f64,
    moment: f64,
    contact: f64,
    /// Square of the way that the tool's centre of mass goes per unit of the coordinate.
    way: f64,
}

impl Work {
    fn unknown(samples: usize) -> Self {
        Self {
            tau: vec![f64::NAN; samples],
            own: Vec::new(),
            across: Vec::new(),
            nonwork: NonWork {
                force_rms_n: f64::NAN,
                moment_rms_nm: f64::NAN,
                contact_rms_n: f64::NAN,
            },
            tool_inertia: 0.0,
            offset_std: 0.0,
        }
    }

    fn of(
        tool: &ToolSamples,
        kinematics: &ToolKinematics,
        (index, q, rigid): (&[usize], &[f64], Option<&Rigid<'_>>),
        payload: &Payload,
        axis: &ScrewAxis,
        handle: &Point3<f64>,
    ) -> Self {
        let direction = axis.direction.into_inner();
        let (first, second) = across(axis, handle);
        let com = tool.tcp_from_ft_sensor * Point3::from(payload.com_m);
        let tcp_from_ft_sensor = &tool.tcp_from_ft_sensor;
        let places: Vec<(usize, usize)> = index.iter().copied().enumerate().collect();
        let samples = in_parallel(&places, |&(k, i)| {
            let (tcp, rotation) =
                rigid.map_or((tool.position[i], tool.rotation[i]), |rigid| rigid.at(q[k]));
            let along = axis.velocity_at(&tcp);
            let arm = rotation * tcp_from_ft_sensor.translation.vector;
            let world_from_ft_sensor = rotation * tcp_from_ft_sensor.rotation;
            // Force and torque about the tool's point, on the object, and what of them turns the axis.
            let on_object = |wrench: [Vector3<f64>; 2]| {
                let [force, torque] = wrench.map(|v| -(world_from_ft_sensor * v));
                let at_tcp = torque + arm.cross(&force);
                let turning = if axis.kind == JointKind::Revolute {
                    direction.dot(&at_tcp)
                } else {
                    0.0
                };
                (force, at_tcp, turning)
            };
            let of_tool = rigid.map_or_else(|| kinematics.at(i), |rigid| rigid.moving(k, q[k]));
            let own = payload.own(of_tool);
            let contact = payload.contact_beside(&own, tool, i);
            let (force, at_tcp, turning) = on_object(contact);
            let (own, _, own_turning) = on_object(own);
            let unit = along.normalize();
            let way = axis.velocity_at(&(tcp + rotation * com.coords));
            AtSample {
                tau: turning + along.dot(&force),
                own: own_turning + along.dot(&own),
                across: [first.dot(&force), second.dot(&force)],
                force: (force - unit * unit.dot(&force)).norm(),
                moment: (at_tcp - direction * turning).norm(),
                contact: force.norm(),
                way: way.norm_squared(),
            }
        });
        let series = |value: fn(&AtSample) -> f64| samples.iter().map(value).collect::<Vec<f64>>();
        let ways: f64 = samples.iter().map(|sample| sample.way).sum();
        Self {
            tau: series(|sample| sample.tau),
            own: series(|sample| sample.own),
            across: vec![
                series(|sample| sample.across[0]),
                series(|sample| sample.across[1]),
            ],
            nonwork: NonWork {
                force_rms_n: rms(&series(|sample| sample.force)),
                moment_rms_nm: rms(&series(|sample| sample.moment)),
                contact_rms_n: rms(&series(|sample| sample.contact)),
            },
            tool_inertia: payload.mass_kg * ways / index.len().max(1) as f64,
            offset_std: offset_std(payload, axis, handle, rigid.map_or(0.0, |r| r.turned)),
        }
    }
}
