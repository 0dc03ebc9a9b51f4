//! What the true model would leave, from the simulator: the same person, the same motion, sensors without noise.

use ft_identify::dynamics::EffortModel;
use ft_identify::effect::{Effect, RigidBody};
use ft_identify::motion::{Motion, MotionError};
use ft_identify::pipeline::Identified;
use ft_identify::samples::JointSamples;
use nalgebra::{DMatrix, DVector};

/// The rms by which the named model's residual differs between the recording and `quiet`, its twin without noise, less what
/// the model's own terms would take up: N m or N. Nothing when there are no dynamics.
///
/// A model that is wrong is wrong in both, and leaves the difference that noise makes.
#[must_use]
pub fn simulated_floor(found: &Identified, quiet: &JointSamples) -> Option<f64> {
    let analysis = found.analysis.as_ref()?;
    let diagnosis = analysis.diagnosis.as_ref()?;
    let lag = analysis.lag.filter(|lag| lag.applied);
    let quiet = quiet
        .with_effort_earlier(lag.map_or(0.0, |lag| lag.value_s))
        .rid_of(&diagnosis.samples.aside.slid);
    let noisy = &diagnosis.motion;
    let mut motion = Motion::prepare(&quiet, &analysis.settings).ok()?;
    let both = motion.q.len().min(noisy.q.len());
    let kept: Vec<usize> = noisy.kept.iter().copied().filter(|i| *i < both).collect();
    motion.kept.clone_from(&kept);
    for (here, there) in motion.slides.iter_mut().zip(&noisy.slides) {
        *here = *there;
    }
    let (columns, without) = left(&motion, &diagnosis.found(), &diagnosis.model).ok()?;
    let noise: Vec<f64> = diagnosis
        .model
        .residual
        .iter()
        .zip(without)
        .map(|(with, without)| with - without)
        .collect();
    let (x, noise) = (
        DMatrix::from_columns(&columns)
            .rows(0, noise.len())
            .into_owned(),
        DVector::from_vec(noise),
    );
    let taken_up = x.clone().svd(true, true).solve(&noise, 1e-9).ok()?;
    let rest = &noise - x * taken_up;
    Some((rest.norm_squared() / rest.len() as f64).sqrt())
}

type Columns = Vec<DVector<f64>>;

/// The columns of a model on another motion, and what the model leaves there.
fn left(
    motion: &Motion,
    found: &[ft_identify::diagnose::Found],
    model: &EffortModel,
) -> Result<(Columns, Vec<f64>), MotionError> {
    let mut columns = RigidBody.columns(motion)?;
    for found in found {
        columns.extend(found.columns(motion)?);
    }
    let mut rest = motion.regressor(&motion.tau)?;
    for (column, theta) in columns.iter().zip(model.theta.iter()) {
        for (rest, value) in rest.iter_mut().zip(&column.values) {
            *rest -= theta * value;
        }
    }
    let mut columns: Columns = columns
        .into_iter()
        .map(|c| DVector::from_vec(c.values))
        .collect();
    // Either recording has a zero of its own for the coordinate.
    let mut at = 3;
    for found in found {
        let terms = found.terms().count();
        let slope = found.slope(motion, &model.theta.as_slice()[at..at + terms]);
        columns.push(DVector::from_vec(motion.regressor(&slope)?));
        at += terms;
    }
    Ok((columns, rest))
}
