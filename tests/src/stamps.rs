//! What stamps and the tool's mass are worth: the same simulated motion identified with stamps and calibrations of several qualities.
//!
//! The wrench comes through an FTDI adapter at its latency timer of 16 ms, behind a filter of 6 ms that nobody was told of; the gripper
//! carries 20 % more than its nominal mass (new pads, a cable). All of it simulated.

use std::path::Path;

use ft_capture::calibrate::{CalibrateError, CalibrateOptions, align_recording, calibrate};
use ft_identify::motion::{Motion, MotionSettings};
use ft_identify::pipeline::identify_loaded;
use ft_identify::samples::JointSamples;
use ft_recording::rewrite::Rewrite;
use ft_recording::{Calibration, Estimate, ReadError, Recording, TopicMap};
use ft_sim_hw::scenario::{LinkSpec, SensorSpec, ToolSpec};
use ft_sim_hw::{Scenario, Truth};

use nalgebra::{Matrix4, Vector4};

use crate::truth::record_scenario;

/// The adapter's timer and the sensor's filter, ms.
const LINK: LinkSpec = LinkSpec {
    burst_ms: 16.0,
    delay_ms: 6.0,
};
/// True mass over nominal mass.
const HEAVIER: f64 = 1.2;

/// How a recording was treated before it was identified.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Treatment {
    /// Arrival stamps, calibrated tool.
    Arrival,
    /// Device clocks translated, calibrated tool.
    Translated,
    /// Translated, and poses aligned to the wrench, calibrated tool.
    Aligned,
    /// As [`Self::Aligned`], with the tool's nominal mass and its bias, and without the free air that would contradict the mass.
    NominalMass,
}

impl Treatment {
    /// All, in the order of the table.
    pub const ALL: [Self; 4] = [
        Self::Arrival,
        Self::Translated,
        Self::Aligned,
        Self::NominalMass,
    ];

    /// How the table calls it.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Arrival => "arrival stamps, calibrated mass",
            Self::Translated => "translated, calibrated mass",
            Self::Aligned => "translated + aligned, calibrated mass",
            Self::NominalMass => "translated + aligned, nominal mass",
        }
    }
}

/// Errors of inertia, Coulomb and viscous friction, (estimate - truth) / truth; `None` where not identified.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Errors {
    /// Plain least squares of inertia, friction and an offset, which takes the stamps as they are.
    pub plain: [Option<f64>; 3],
    /// Ours, which looks for a lag of its own.
    pub ours: [Option<f64>; 3],
}

/// What one simulated recording gives under each treatment.
#[derive(Clone, Debug)]
pub struct StampEffect {
    /// Errors by treatment, in the order of [`Treatment::ALL`].
    pub errors: [Errors; 4],
    /// What alignment added to the poses' stamps, ms.
    pub offset_ms: f64,
    /// True and calibrated mass, kg.
    pub mass_kg: [f64; 2],
}

/// Why there is no effect to show.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum StampError {
    /// The simulated recording cannot be read or written anew.
    #[error(transparent)]
    Recording(#[from] ReadError),
    /// It cannot be calibrated.
    #[error(transparent)]
    Calibrate(#[from] CalibrateError),
}

/// Records `scenario` through the slow link and identifies it under each treatment; files go into `folder`.
///
/// # Errors
/// [`StampError`].
///
/// # Panics
/// The scenario cannot be played.
pub fn effect(scenario: &Scenario, seed: u64, folder: &Path) -> Result<StampEffect, StampError> {
    let mut scenario = scenario.clone();
    let nominal = scenario.tool.clone();
    // One with a clock of its own.
    scenario.sensor = SensorSpec {
        link: LINK,
        ..SensorSpec::of("bota_serial").unwrap_or_else(|| scenario.sensor.clone())
    };
    scenario.tool.mass_kg *= HEAVIER;
    scenario.tool.inertia_kgm2 = nominal.inertia_kgm2.map(|moment| HEAVIER * moment);
    let (file, arrival) = (folder.join("stamps.mcap"), folder.join("arrival.mcap"));
    let truth = record_scenario(&scenario, seed, &file);
    let mut rewrite = Rewrite::new();
    rewrite.restamp(|_, _, arrival| arrival);
    rewrite.write(Some(&file), &arrival, true)?;

    let load = |path: &Path| Recording::load(path, &TopicMap::default());
    let options = CalibrateOptions::default();
    let mut translated = load(&file)?;
    let mut arrived = load(&arrival)?;
    // Nothing was known of the tool before.
    translated.calibration = None;
    let alignment = align_recording(&translated, 0.0, &options)?;
    let start = translated
        .wrench
        .first()
        .map_or_else(Default::default, |first| first.at);
    let mut aligned = translated.clone();
    for sample in &mut aligned.pose.samples {
        sample.at = alignment.shifted(sample.at, start);
    }
    let found = calibrate(&aligned, &options)?.calibration;
    let mass_kg = [scenario.tool.mass_kg, found.payload_mass_kg.value];
    let mut with_nominal = aligned.clone();
    with_nominal.calibration = Some(Calibration {
        wrench_bias: found.wrench_bias,
        ..sure(&nominal)
    });
    let grasp = with_nominal
        .marks
        .iter()
        .find(|mark| mark.value == "grasp")
        .map_or(start, |mark| mark.at.offset_by_seconds(-1.0));
    with_nominal.wrench.retain(|sample| sample.at > grasp);
    for recording in [&mut translated, &mut arrived, &mut aligned] {
        recording.calibration = Some(found.clone());
    }
    let errors = [&arrived, &translated, &aligned, &with_nominal];
    Ok(StampEffect {
        errors: errors.map(|recording| errors_of(recording, &truth)),
        offset_ms: 1e3 * alignment.offset_s,
        mass_kg,
    })
}

/// The nominal tool, as if it were sure.
fn sure(tool: &ToolSpec) -> Calibration {
    Calibration {
        payload_mass_kg: Estimate {
            value: tool.mass_kg,
            std: 1e-6,
        },
        payload_com_m: Estimate {
            value: tool.com_m,
            std: [1e-6; 3],
        },
        payload_inertia_kgm2: Estimate {
            value: tool.inertia_kgm2,
            std: [1e-8; 6],
        },
        wrench_bias: None,
        covariance: None,
    }
}

fn errors_of(recording: &Recording, truth: &Truth) -> Errors {
    let settings = MotionSettings::default();
    let Ok(identified) = identify_loaded(recording, &settings, &mut |_| {}) else {
        return Errors::default();
    };
    let wanted = [
        ("inertia", truth.object.inertia),
        ("coulomb", truth.object.coulomb),
        ("viscous", truth.object.viscous),
    ];
    let term = |(name, true_value): (&str, f64)| {
        let value = identified.report.term(name)?.value?;
        Some(value / true_value - 1.0)
    };
    let plain = plain(&identified.samples);
    Errors {
        plain: core::array::from_fn(|j| plain.map(|values| values[j] / wanted[j].1 - 1.0)),
        ours: wanted.map(term),
    }
}

/// Inertia, Coulomb and viscous friction by least squares on filtered samples: no lag, no mechanism.
fn plain(samples: &JointSamples) -> Option<[f64; 3]> {
    let motion = Motion::prepare(samples, &MotionSettings::default()).ok()?;
    let sign: Vec<f64> = motion.dq.iter().map(|dq| dq.signum()).collect();
    let ones = vec![1.0; motion.dq.len()];
    let column = |values: &[f64]| motion.regressor(values).ok();
    let columns = [
        column(&motion.ddq)?,
        column(&sign)?,
        column(&motion.dq)?,
        column(&ones)?,
    ];
    let effort = column(&motion.tau)?;
    let (mut normal, mut right) = (Matrix4::<f64>::zeros(), Vector4::<f64>::zeros());
    for (i, effort) in effort.iter().enumerate() {
        let row = Vector4::from_fn(|j, _| columns[j][i]);
        normal += row * row.transpose();
        right += row * *effort;
    }
    let theta = normal.cholesky()?.solve(&right);
    Some([theta[0], theta[1], theta[2]])
}
