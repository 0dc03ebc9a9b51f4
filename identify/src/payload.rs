//! The part of the tool in front of the force-torque sensor, and the sensor's bias, from its motion in free air.
//!
//! With `s` = gravity minus the acceleration of the sensor's origin, `w` its angular rate, `dw` its angular acceleration,
//! all in `ft_sensor`, and `h = m c` the first moment, a tool in free air reads (design 2, written at the origin)
//!
//! ```text
//! force  = m s - (dw x h) - w x (w x h) + bias
//! torque = h x s - (Jo dw + w x Jo w) + bias          Jo = J + m (|c|^2 - c c')
//! ```
//!
//! which is linear in m, h, Jo and the bias. Both sides go through one zero-phase low-pass, the wrench read as much later as it comes after the
//! pose. A calibration is a prior; without one the inertia J is that of a compact tool, as far as the shaking does not tell.

mod rows;

use core::ops::Range;

use ft_recording::Calibration;
use nalgebra::{Matrix3, SMatrix, SVector, Vector3};

use crate::filter::FilterError;
use crate::screw::{JointKind, ScrewAxis};
use crate::tool::{ToolKinematics, ToolSamples};
use rows::{FreeAir, of_a_point, tensor};

/// Why the tool's own wrench cannot be taken off.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum PayloadError {
    /// Neither free air nor a calibration.
    #[error(
        "the tool's own weight is unknown: the recording has {free_air_s:.1} s in free air before the grasp (need {needed_s:.1} s there or after the release) and no calibration; \
         move the tool in free air before grasping, or put a [calibration] of the tool into capture.toml"
    )]
    Unknown {
        /// Free air before `grasp`, s.
        free_air_s: f64,
        /// Needed, s.
        needed_s: f64,
    },
    /// Free air, but the tool was hardly turned or shaken, and no calibration.
    #[error(
        "the tool's own weight is unknown: its motion in free air shows the mass only to +-{mass_std_kg:.3} kg (need {needed_kg:.3} kg) and there is no calibration; \
         turn the tool over and shake it before grasping"
    )]
    NotExcited {
        /// Standard deviation of the mass, kg.
        mass_std_kg: f64,
        /// Needed, kg.
        needed_kg: f64,
    },
    /// The poses cannot be filtered.
    #[error(transparent)]
    Filter(#[from] FilterError),
}

/// Where a payload comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum PayloadSource {
    /// The recording's free-air part alone.
    FreeAir,
    /// The calibration alone.
    Calibration,
    /// Free air with the calibration as a prior.
    Both,
}

/// Places in a matrix of the six numbers of an inertia: xx xy yy xz yz zz.
const TENSOR: [(usize, usize); 6] = [(0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2)];

/// Mass, first moment, inertia and bias, with standard deviations.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct Payload {
    /// Where it comes from.
    pub source: PayloadSource,
    /// Mass, kg.
    pub mass_kg: f64,
    /// Its standard deviation.
    pub mass_std_kg: f64,
    /// Centre of mass in `ft_sensor`, m.
    pub com_m: [f64; 3],
    /// Standard deviation of the first moment over the mass, m.
    pub com_std_m: [f64; 3],
    /// Inertia about the centre of mass, kg m^2: xx xy yy xz yz zz.
    pub inertia_kgm2: [f64; 6],
    /// Its standard deviation, of a calibration.
    #[serde(skip)]
    pub(crate) inertia_std: [f64; 6],
    /// Covariance of mass, first moment and inertia about the sensor's origin.
    #[serde(skip)]
    pub(crate) covariance: Option<Box<SMatrix<f64, 10, 10>>>,
    /// By how much the wrench comes later than the pose, as free air shows it, and the standard deviation, s.
    pub late_s: Option<(f64, f64)>,
    /// Bias at `bias_at_s`: N, N m.
    pub bias: [f64; 6],
    /// Standard deviation of the bias.
    pub bias_std: [f64; 6],
    /// Middle of the time over which the bias was seen, s; nothing when it comes from a calibration or is unknown.
    pub bias_at_s: Option<f64>,
    /// Rate at which the bias drifts, N/s and N m/s, as free air after the release shows it.
    pub bias_rate: [f64; 6],
    /// Mass of a calibration that free air contradicts, kg; it was not used then.
    pub contradicted_kg: Option<f64>,
    /// Root mean square of what free air leaves unexplained below the cut-off: force N, torque N m.
    pub free_air_rms: Option<[f64; 2]>,
    /// A mass that was put on after the free air, kg, with its first moment in `ft_sensor`, kg m; not in `mass_kg`.
    pub attached: Option<Attached>,
}

/// A mass that free air after the release shows and free air before the grasp does not.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct Attached {
    /// kg.
    pub mass_kg: f64,
    /// First moment in `ft_sensor`, kg m, without its part along gravity, which a still tool does not show.
    pub first_moment: [f64; 3],
}

/// What free air after the release says of a change since the free air before the grasp.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Since {
    /// Nothing, or no more than a sensor usually drifts.
    Nothing,
    /// A mass was put on.
    Mass(f64),
    /// The bias went away by so much, N.
    Drift(f64),
}

const MIN_FREE_AIR_S: f64 = 1.5;
/// Of free air no more is used, s.
const MOST_FREE_AIR_S: f64 = 120.0;
/// Free air after the release from which a still tool shows what it weighs, s.
const LEAST_AFTER_S: f64 = 0.4;
/// A change of the wrench over a recording that is more than a warm sensor's usual drift: N, N m.
const LEAST_CHANGE_N: f64 = 0.35;
const LEAST_CHANGE_NM: f64 = 0.025;
/// What a sensor usually drifts over a recording of so many seconds, or a shorter one, N and N m.
const USUAL_DRIFT: [f64; 2] = [0.15, 0.01];
const USUAL_OVER_S: f64 = 60.0;
/// No mass sits farther from the sensor, m.
const FARTHEST_M: f64 = 0.4;
const NEEDED_MASS_STD_KG: f64 = 0.05;
/// A calibrated bias may have drifted by so much since: N, N m (one standard deviation).
const DRIFT_SINCE: [f64; 2] = [0.5, 0.02];

/// Standard deviations by which free air and a calibration may disagree about the mass.
const CONTRADICTS: f64 = 5.0;

impl Payload {
    /// Estimates from the free-air parts `before` the grasp and `after` the release, from the latter alone where the former is too short.
    ///
    /// # Errors
    /// [`PayloadError`].
    pub fn estimate(
        tool: &ToolSamples,
        kinematics: &ToolKinematics,
        before: &[Range<usize>],
        after: &[Range<usize>],
        calibration: Option<&Calibration>,
    ) -> Result<Self, PayloadError> {
        let seconds =
            |runs: &[Range<usize>]| runs.iter().map(Range::len).sum::<usize>() as f64 * tool.period;
        // Of long free air what is next to the grasp tells enough.
        let most = (MOST_FREE_AIR_S / tool.period) as usize;
        let (before, after) = (&latest(before, most), &earliest(after, most));
        if seconds(before) < MIN_FREE_AIR_S && seconds(after) >= MIN_FREE_AIR_S {
            return Self::after_alone(tool, kinematics, after, calibration);
        }
        if seconds(before) < MIN_FREE_AIR_S {
            let calibration = calibration.ok_or(PayloadError::Unknown {
                free_air_s: seconds(before),
                needed_s: MIN_FREE_AIR_S,
            })?;
            return Ok(Self::calibrated(calibration));
        }
        let free_air = FreeAir::of(tool, kinematics, before)?;
        let weighed = |start: Option<&Self>, of: Self, late: f64| {
            let rows = free_air.rows(late);
            let mut payload = of;
            let mut noise = [0.1, 0.005];
            for _ in 0..4 {
                (payload, noise) = rows.fit(&payload, start, noise);
            }
            (payload, noise)
        };
        let start = calibration.map(Self::calibrated);
        let begin = || start.clone().unwrap_or_else(Self::nothing);
        let (mut payload, noise) = weighed(start.as_ref(), begin(), 0.0);
        let late_s = free_air.late(&payload, start.as_ref(), noise);
        let late = late_s.filter(is_seen).map_or(0.0, |(late, _)| late);
        if late != 0.0 {
            payload = weighed(start.as_ref(), begin(), late).0;
        }
        if let Some(start) = start {
            let (alone, _) = weighed(None, start.clone(), late);
            let apart = (alone.mass_kg - start.mass_kg).abs();
            if apart > CONTRADICTS * alone.mass_std_kg.hypot(start.mass_std_kg) {
                payload = Self {
                    contradicted_kg: Some(start.mass_kg),
                    ..alone
                };
            }
        }
        payload.late_s = late_s;
        payload.bias_at_s = Some(mean_time(tool, before));
        if payload.source == PayloadSource::FreeAir && payload.mass_std_kg > NEEDED_MASS_STD_KG {
            return Err(PayloadError::NotExcited {
                mass_std_kg: payload.mass_std_kg,
                needed_kg: NEEDED_MASS_STD_KG,
            });
        }
        if seconds(after) >= LEAST_AFTER_S {
            payload.learn_drift(tool, kinematics, after)?;
        }
        Ok(payload)
    }

    /// As [`Self::estimate`], where only free air after the release is long enough. The tool may have been put down there: beside a calibration it counts
    /// when it was turned enough to be weighed, and left nothing like a push.
    fn after_alone(
        tool: &ToolSamples,
        kinematics: &ToolKinematics,
        after: &[Range<usize>],
        calibration: Option<&Calibration>,
    ) -> Result<Self, PayloadError> {
        let alone = Self::estimate(tool, kinematics, after, &[], None);
        let Some(calibration) = calibration else {
            return alone;
        };
        let calibrated = Self::calibrated(calibration);
        let near = |payload: &Self| {
            let mut each = payload
                .bias
                .iter()
                .zip(&calibrated.bias)
                .zip(&calibrated.bias_std);
            each.all(|((there, here), std)| (there - here).abs() < CONTRADICTS * std)
        };
        if !alone.is_ok_and(|payload| near(&payload)) {
            return Ok(calibrated);
        }
        Self::estimate(tool, kinematics, after, &[], Some(calibration))
    }

    /// The payload with what free air after the release shows of a mass that was put on, or of a bias that went away, and which
    /// of the two it is: a mass weighs downwards, and what it turns is across its weight.
    #[must_use]
    pub fn after_release(
        &self,
        tool: &ToolSamples,
        kinematics: &ToolKinematics,
        after: &[Range<usize>],
    ) -> (Self, Since) {
        let mut payload = self.clone();
        payload.bias_rate = [0.0; 6];
        let samples: Vec<usize> = after.iter().flat_map(Clone::clone).collect();
        let Some(seen) = self.bias_at_s else {
            return (self.clone(), Since::Nothing);
        };
        if (samples.len() as f64) * tool.period < LEAST_AFTER_S {
            return (self.clone(), Since::Nothing);
        }
        let mut sums = [Vector3::zeros(); 3];
        for &i in &samples {
            let [force, torque] = payload.contact(tool, kinematics, i);
            for (sum, value) in sums.iter_mut().zip([force, torque, kinematics.specific[i]]) {
                *sum += value / samples.len() as f64;
            }
        }
        let [force, torque, specific] = sums;
        let down = specific.normalize();
        let mass = force.dot(&specific) / specific.norm_squared();
        let moment = specific.cross(&torque) / specific.norm_squared();
        let aside = (force - specific * mass).norm();
        let along = torque.dot(&down).abs();
        let is_mass = mass * specific.norm() > LEAST_CHANGE_N
            && aside < f64::max(USUAL_DRIFT[0], 0.15 * force.norm())
            && along < f64::max(USUAL_DRIFT[1], 0.2 * torque.norm())
            && moment.norm() < FARTHEST_M * mass;
        if is_mass {
            payload.attached = Some(Attached {
                mass_kg: mass,
                first_moment: moment.into(),
            });
            return (payload, Since::Mass(mass));
        }
        if force.norm() < LEAST_CHANGE_N && torque.norm() < LEAST_CHANGE_NM {
            return (self.clone(), Since::Nothing);
        }
        let apart = (mean_time(tool, after) - seen).max(1.0);
        for k in 0..3 {
            payload.bias_rate[k] = force[k] / apart;
            payload.bias_rate[3 + k] = torque[k] / apart;
        }
        (payload, Since::Drift(force.norm()))
    }

    /// Wrench that the tool's weight and inertia put on the sensor, without bias.
    #[must_use]
    pub fn wrench(
        &self,
        specific: &Vector3<f64>,
        rate: &Vector3<f64>,
        angular: &Vector3<f64>,
    ) -> [Vector3<f64>; 2] {
        let h = Vector3::from(self.com_m) * self.mass_kg;
        let inertia = self.inertia_at_origin();
        let force = specific * self.mass_kg - angular.cross(&h) - rate.cross(&rate.cross(&h));
        let torque = h.cross(specific) - inertia * angular - rate.cross(&(inertia * rate));
        [force, torque]
    }

    /// Bias at `time` s.
    #[must_use]
    pub fn bias_at(&self, time: f64) -> [Vector3<f64>; 2] {
        let since = self.bias_at_s.map_or(0.0, |at| time - at);
        let value = |k: usize| self.bias[k] + self.bias_rate[k] * since;
        [
            Vector3::new(value(0), value(1), value(2)),
            Vector3::new(value(3), value(4), value(5)),
        ]
    }

    /// What the environment puts on the tool at sample `i`: force and torque about the sensor's origin, in `ft_sensor`.
    #[must_use]
    pub fn contact(
        &self,
        tool: &ToolSamples,
        kinematics: &ToolKinematics,
        i: usize,
    ) -> [Vector3<f64>; 2] {
        self.contact_beside(&self.own(kinematics.at(i)), tool, i)
    }

    /// As [`Payload::contact`]; `own` = [`Payload::own`] at that sample.
    pub(crate) fn contact_beside(
        &self,
        own: &[Vector3<f64>; 2],
        tool: &ToolSamples,
        i: usize,
    ) -> [Vector3<f64>; 2] {
        let bias = self.bias_at(tool.time[i]);
        let w = &tool.wrench[i];
        [
            Vector3::new(w[0], w[1], w[2]) - bias[0] - own[0],
            Vector3::new(w[3], w[4], w[5]) - bias[1] - own[1],
        ]
    }

    /// What the tool and a mass attached to it put on the sensor, without bias, moving as [`ToolKinematics::at`] has it.
    #[must_use]
    pub fn own(&self, [specific, rate, angular]: [Vector3<f64>; 3]) -> [Vector3<f64>; 2] {
        let [force, torque] = self.wrench(&specific, &rate, &angular);
        let on = self.attached.map_or([Vector3::zeros(); 2], |attached| {
            attached.wrench(&specific, &rate, &angular)
        });
        [force + on[0], torque + on[1]]
    }

    fn calibrated(calibration: &Calibration) -> Self {
        let bias = calibration.wrench_bias.as_ref();
        let mut bias_std: [f64; 6] = core::array::from_fn(|k| DRIFT_SINCE[k / 3]);
        if let Some(bias) = bias {
            for (total, std) in bias_std.iter_mut().zip(&bias.std) {
                *total = total.hypot(*std);
            }
        } else {
            bias_std = [20.0, 20.0, 20.0, 1.0, 1.0, 1.0];
        }
        let (mass, com) = (&calibration.payload_mass_kg, &calibration.payload_com_m);
        let mut covariance = SMatrix::<f64, 10, 10>::zeros();
        covariance[(0, 0)] = mass.std.powi(2);
        for k in 0..3 {
            let moment = (mass.value * com.std[k]).hypot(mass.std * com.value[k]);
            covariance[(1 + k, 1 + k)] = moment.powi(2);
        }
        for k in 0..6 {
            let std = calibration.payload_inertia_kgm2.std[k];
            covariance[(4 + k, 4 + k)] = std.powi(2);
        }
        Self {
            source: PayloadSource::Calibration,
            mass_kg: calibration.payload_mass_kg.value,
            mass_std_kg: calibration.payload_mass_kg.std,
            com_m: calibration.payload_com_m.value,
            com_std_m: calibration.payload_com_m.std,
            inertia_kgm2: calibration.payload_inertia_kgm2.value,
            inertia_std: calibration.payload_inertia_kgm2.std,
            covariance: Some(Box::new(covariance)),
            late_s: None,
            bias: bias.map_or([0.0; 6], |bias| bias.value),
            bias_std,
            bias_at_s: None,
            bias_rate: [0.0; 6],
            contradicted_kg: None,
            free_air_rms: None,
            attached: None,
        }
    }

    fn nothing() -> Self {
        Self {
            source: PayloadSource::FreeAir,
            mass_kg: 0.0,
            mass_std_kg: f64::INFINITY,
            com_m: [0.0; 3],
            com_std_m: [f64::INFINITY; 3],
            inertia_kgm2: [0.0; 6],
            inertia_std: [0.0; 6],
            covariance: None,
            late_s: None,
            bias: [0.0; 6],
            bias_std: [f64::INFINITY; 6],
            bias_at_s: None,
            bias_rate: [0.0; 6],
            contradicted_kg: None,
            free_air_rms: None,
            attached: None,
        }
    }

    fn inertia_at_origin(&self) -> Matrix3<f64> {
        tensor(self.inertia_kgm2) + of_a_point(self.mass_kg, self.com_m)
    }

    /// Standard deviation of the inertia that the tool adds to a joint that carries it: kg m^2 or kg. `axis` in `ft_sensor`.
    #[must_use]
    pub fn inertia_std_about(&self, axis: &ScrewAxis) -> f64 {
        let Some(covariance) = &self.covariance else {
            return self.mass_std_kg * axis.velocity_at(&self.com_m.into()).norm_squared();
        };
        // n' Jo n + 2 r . h + m r . r, where r is the way from the axis to the sensor's origin.
        let mut by = SVector::<f64, 10>::zeros();
        if axis.kind == JointKind::Prismatic {
            by[0] = 1.0;
        } else {
            let n = axis.direction.into_inner();
            let r = -axis.point.coords;
            let r = r - n * n.dot(&r);
            by[0] = r.norm_squared();
            by.fixed_rows_mut::<3>(1).copy_from(&(r * 2.0));
            for (k, (i, j)) in TENSOR.into_iter().enumerate() {
                by[4 + k] = n[i] * n[j] * if i == j { 1.0 } else { 2.0 };
            }
        }
        (covariance.as_ref() * by).dot(&by).max(0.0).sqrt()
    }

    /// Takes what the bias went by from the free air before the grasp to that after the release as a straight line, as far as it is surer than
    /// how much sensors drift; nothing when short free air says that it went by more than they usually do.
    fn learn_drift(
        &mut self,
        tool: &ToolSamples,
        kinematics: &ToolKinematics,
        after: &[Range<usize>],
    ) -> Result<(), PayloadError> {
        let late = self.late_s.filter(is_seen).map_or(0.0, |(late, _)| late);
        let free_air = FreeAir::of(tool, kinematics, after)?;
        let rows = free_air.rows(late);
        let (mean, std) = rows.mean_residual(self);
        let Some(seen) = self.bias_at_s else {
            return Ok(());
        };
        let apart = mean_time(tool, after) - seen;
        let usual = USUAL_DRIFT.map(|usual| usual * (apart / USUAL_OVER_S).max(1.0));
        let went = [0, 3].map(|k| Vector3::new(mean[k], mean[k + 1], mean[k + 2]).norm());
        let short =
            after.iter().map(Range::len).sum::<usize>() as f64 * tool.period < MIN_FREE_AIR_S;
        let unusual = went.iter().zip(usual).any(|(went, usual)| *went > usual);
        if apart < 1.0 || short && unusual {
            return Ok(());
        }
        for k in 0..6 {
            let sure = usual[k / 3].powi(2);
            let unsure = std[k].powi(2) + self.bias_std[k].powi(2);
            self.bias_rate[k] = mean[k] / apart * sure / (sure + unsure);
        }
        Ok(())
    }
}

impl Attached {
    /// What it adds to the sensor's reading, as a point mass.
    fn wrench(
        &self,
        specific: &Vector3<f64>,
        rate: &Vector3<f64>,
        angular: &Vector3<f64>,
    ) -> [Vector3<f64>; 2] {
        let h = Vector3::from(self.first_moment);
        let at = h / self.mass_kg;
        let force = specific * self.mass_kg - angular.cross(&h) - rate.cross(&rate.cross(&h));
        [force, at.cross(&force)]
    }
}

/// Whether a lateness of the wrench, s, is more than its standard deviation allows to doubt and than matters.
pub(crate) fn is_seen(&(late, std): &(f64, f64)) -> bool {
    late.abs() > (LATE_SURE * std).max(LEAST_LATE_S)
}

/// Whether free air, which shows a lateness of the wrench, says that it is not `lag` s.
pub(crate) fn is_another(lag: f64, (late, std): (f64, f64)) -> bool {
    std < LATE_KNOWN_S && (lag - late).abs() > LATE_SURE * std + LATE_APART_S
}

/// Free air says what a lag is when it knows it so well, s, and that it is another one beyond this and its standard deviations: filters of sensors delay
/// one motion more than another.
const LATE_KNOWN_S: f64 = 2e-3;
const LATE_APART_S: f64 = 1e-3;
const LATE_SURE: f64 = 5.0;
const LEAST_LATE_S: f64 = 1.5e-3;

/// The last `most` samples of `runs`.
fn latest(runs: &[Range<usize>], most: usize) -> Vec<Range<usize>> {
    let mut left = most;
    let mut out: Vec<Range<usize>> = Vec::new();
    for run in runs.iter().rev() {
        let taken = run.len().min(left);
        left -= taken;
        out.push(run.end - taken..run.end);
    }
    out.reverse();
    out.retain(|run| !run.is_empty());
    out
}

/// The first `most` samples of `runs`.
fn earliest(runs: &[Range<usize>], most: usize) -> Vec<Range<usize>> {
    let mut left = most;
    let first = runs.iter().map(|run| {
        let taken = run.len().min(left);
        left -= taken;
        run.start..run.start + taken
    });
    first.filter(|run| !run.is_empty()).collect()
}

fn mean_time(tool: &ToolSamples, runs: &[Range<usize>]) -> f64 {
    let (sum, count) = runs
        .iter()
        .flat_map(Clone::clone)
        .fold((0.0, 0), |(sum, n), i| (sum + tool.time[i], n + 1));
    sum / f64::from(count.max(1))
}
