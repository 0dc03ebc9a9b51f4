//! The shapes of effects in the joint fit: where a magnet's pull ends is blurred along the smoothed motion by as much as the position sensor wanders, and
//! along the fitted one it is not.

use nalgebra::DVector;

use crate::effect::Effect;
use crate::motion::{Motion, MotionError};

/// Half the step over which an effort changes with a shape, at most, and as a share of what the limits leave.
const HALF_STEP: [f64; 2] = [0.02, 0.1];

/// The shapes that are fitted.
#[derive(Default)]
pub(super) struct Shapes {
    /// Limits of the steps, effect by effect.
    limits: Vec<Vec<[f64; 2]>>,
}

/// The effects at a place, with their shapes there.
pub(in super::super) struct Moves {
    /// Those that have moved.
    moved: Vec<Option<Box<dyn Effect>>>,
    /// What a step of each shape does to the effort.
    pub(super) derivatives: Vec<Vec<f64>>,
}

impl Shapes {
    /// Those of `effects`, which were found on `motion`.
    pub(super) fn of(effects: &[&dyn Effect], motion: &Motion) -> Self {
        let limits = effects.iter().map(|effect| effect.freedom(motion));
        Self {
            limits: limits.collect(),
        }
    }

    fn each(&self) -> impl Iterator<Item = &[f64; 2]> {
        self.limits.iter().flatten()
    }

    pub(super) fn len(&self) -> usize {
        self.each().count()
    }

    pub(super) fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Half of what the limits leave of each, within which it is known beforehand.
    pub(super) fn looseness(&self) -> impl Iterator<Item = f64> {
        self.each().map(|[low, high]| 0.5 * (high - low))
    }

    /// Those of `steps` that are beyond their limits, and these.
    pub(super) fn beyond(&self, steps: &[f64]) -> Vec<(usize, f64)> {
        let all = self.each().zip(steps).enumerate();
        all.filter(|(_, ([low, high], step))| !(*low..=*high).contains(step))
            .map(|(k, ([low, high], step))| (k, step.clamp(*low, *high)))
            .collect()
    }

    /// The effects moved by `steps`; `found_on` = the motion that they were found on.
    pub(super) fn moved(&self, effects: &[&dyn Effect], found_on: &Motion, steps: &[f64]) -> Moves {
        let mut rest = steps;
        let moved = self.limits.iter().zip(effects).map(|(limits, effect)| {
            let (own, others) = rest.split_at(limits.len());
            rest = others;
            if own.is_empty() {
                None
            } else {
                effect.moved(found_on, own)
            }
        });
        Moves {
            moved: moved.collect(),
            derivatives: Vec::new(),
        }
    }
}

impl Moves {
    /// The effects as they are here, of which those that have no shape are as they were.
    pub(in super::super) fn effects<'a>(
        &'a self,
        all: &'a [&'a dyn Effect],
    ) -> impl Iterator<Item = &'a dyn Effect> {
        let moved = self.moved.iter().map(Option::as_deref);
        let moved = moved.chain(core::iter::repeat(None));
        all.iter()
            .zip(moved)
            .map(|(as_was, moved)| moved.unwrap_or(*as_was))
    }

    /// Takes the derivatives along `motion`; `theta` = the parameters there, of which each effect has so many `terms` and the last ones are the steps.
    pub(super) fn derive(
        &mut self,
        (shapes, effects): (&Shapes, &[&dyn Effect]),
        found_on: &Motion,
        motion: &Motion,
        (theta, terms): (&DVector<f64>, &[usize]),
    ) -> Result<(), MotionError> {
        let mut theta = theta.as_slice();
        let mut steps = &theta[theta.len() - shapes.len()..];
        let each = effects.iter().zip(terms).zip(&shapes.limits);
        for ((effect, terms), limits) in each {
            let (own_theta, own_steps);
            (own_theta, theta) = theta.split_at(*terms);
            (own_steps, steps) = steps.split_at(limits.len());
            for (j, [low, high]) in limits.iter().enumerate() {
                let half = HALF_STEP[0].min(HALF_STEP[1] * 0.5 * (high - low));
                let ends = [-half, half].map(|step| (own_steps[j] + step).clamp(*low, *high));
                let effort = |step: f64| -> Result<Vec<f64>, MotionError> {
                    let mut steps = own_steps.to_vec();
                    steps[j] = step;
                    let moved = effect.moved(found_on, &steps);
                    let series = moved.map_or(Ok(Vec::new()), |moved| moved.series(motion))?;
                    let mut out = vec![0.0; motion.q.len()];
                    for (series, theta) in series.iter().zip(own_theta) {
                        out.iter_mut()
                            .zip(series)
                            .for_each(|(out, value)| *out += theta * value);
                    }
                    Ok(out)
                };
                let (before, mut derivative) = (effort(ends[0])?, effort(ends[1])?);
                for (after, before) in derivative.iter_mut().zip(before) {
                    *after = (*after - before) / (ends[1] - ends[0]);
                }
                self.derivatives.push(derivative);
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_beyond_its_limits_is_named_with_them() {
        let shapes = Shapes {
            limits: vec![vec![], vec![[-1.0, 0.5], [0.0, 2.0]], vec![[-0.1, 0.1]]],
        };
        assert_eq!(shapes.len(), 3);
        assert!(shapes.beyond(&[0.5, 0.0, -0.1]).is_empty());
        assert_eq!(shapes.beyond(&[0.6, 1.0, -0.2]), [(0, 0.5), (2, -0.1)]);
        assert_eq!(shapes.looseness().collect::<Vec<_>>(), [0.75, 1.0, 0.1]);
    }
}
