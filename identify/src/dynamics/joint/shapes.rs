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

/// Those of the effects that have a shape, moved.
pub(super) struct Moved(Vec<Option<Box<dyn Effect>>>);

impl Shapes {
    /// Those of `effects`, which were found on `motion`.
    pub(super) fn of(effects: &[&dyn Effect], motion: &Motion) -> Self {
        let limits = effects.iter().map(|effect| effect.shape_limits(motion));
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
    pub(super) fn moved(&self, effects: &[&dyn Effect], found_on: &Motion, steps: &[f64]) -> Moved {
        let mut rest = steps;
        let moved = self.limits.iter().zip(effects).map(|(limits, effect)| {
            let (own, others) = rest.split_at(limits.len());
            rest = others;
            effect.moved(found_on, own)
        });
        Moved(moved.collect())
    }

    /// What a step of each shape does to the effort along `motion`, where the effects have so many `terms` each and `theta` for them; its last are the
    /// steps.
    pub(super) fn derivatives(
        &self,
        (effects, terms): (&[&dyn Effect], &[usize]),
        (found_on, motion): (&Motion, &Motion),
        theta: &DVector<f64>,
    ) -> Result<Vec<Vec<f64>>, MotionError> {
        let mut theta = theta.as_slice();
        let mut steps = &theta[theta.len() - self.len()..];
        let mut out = Vec::with_capacity(steps.len());
        let each = effects.iter().zip(terms).zip(&self.limits);
        for ((effect, terms), limits) in each {
            let (own_theta, own_steps);
            (own_theta, theta) = theta.split_at(*terms);
            (own_steps, steps) = steps.split_at(limits.len());
            let effort = |steps: &[f64]| -> Result<Vec<f64>, MotionError> {
                let mut out = vec![0.0; motion.q.len()];
                let Some(moved) = effect.moved(found_on, steps) else {
                    return Ok(out);
                };
                for (series, theta) in moved.series(motion)?.iter().zip(own_theta) {
                    let each = out.iter_mut().zip(series);
                    each.for_each(|(out, value)| *out += theta * value);
                }
                Ok(out)
            };
            for (j, [low, high]) in limits.iter().enumerate() {
                let half = HALF_STEP[0].min(HALF_STEP[1] * 0.5 * (high - low));
                let ends = [-half, half].map(|step| (own_steps[j] + step).clamp(*low, *high));
                let [before, after] = ends.map(|end| {
                    let mut steps = own_steps.to_vec();
                    steps[j] = end;
                    effort(&steps)
                });
                let (before, mut derivative) = (before?, after?);
                for (after, before) in derivative.iter_mut().zip(before) {
                    *after = (*after - before) / (ends[1] - ends[0]);
                }
                out.push(derivative);
            }
        }
        Ok(out)
    }
}

impl Moved {
    /// All effects, of which those that have no shape are as they were.
    pub(super) fn effects<'a>(
        &'a self,
        all: &'a [&'a dyn Effect],
    ) -> impl Iterator<Item = &'a dyn Effect> {
        let moved = self.0.iter().map(Option::as_deref);
        let moved = moved.chain(core::iter::repeat(None));
        all.iter()
            .zip(moved)
            .map(|(as_was, moved)| moved.unwrap_or(*as_was))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::effect::Column;
    use crate::motion::MotionSettings;
    use crate::samples::JointSamples;
    use crate::screw::JointKind;

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

    /// Two terms, `sin(q + place)` and 1, of which the place is free where `limits` has something.
    #[derive(Debug)]
    struct Wave {
        place: f64,
        limits: Vec<[f64; 2]>,
    }

    impl Effect for Wave {
        fn name(&self) -> &'static str {
            "wave"
        }

        fn columns(&self, _: &Motion) -> Result<Vec<Column>, MotionError> {
            Ok(Vec::new())
        }

        fn series(&self, motion: &Motion) -> Result<Vec<Vec<f64>>, MotionError> {
            let wave = motion.q.iter().map(|q| (q + self.place).sin()).collect();
            Ok(vec![wave, vec![1.0; motion.q.len()]])
        }

        fn shape_limits(&self, _: &Motion) -> Vec<[f64; 2]> {
            self.limits.clone()
        }

        fn moved(&self, _: &Motion, steps: &[f64]) -> Option<Box<dyn Effect>> {
            let limits = self.limits.clone();
            let place = self.place + steps.first()?;
            Some(Box::new(Self { place, limits }))
        }
    }

    #[test]
    fn derivatives_are_those_of_the_effort_in_the_order_of_the_shapes() {
        let time: Vec<f64> = (0..8000).map(|i| f64::from(i) * 1e-3).collect();
        let samples = JointSamples {
            kind: JointKind::Revolute,
            period: 1e-3,
            runs: vec![0..time.len()],
            q: time.iter().map(|t| 0.5 * (2.0 * t).sin()).collect(),
            tau: vec![1.0; time.len()],
            time,
            noise_of_q: Vec::new(),
            aside: crate::samples::Aside::default(),
        };
        let motion = Motion::prepare(&samples, &MotionSettings::default()).unwrap();
        let wave = |place: f64, limits: &[[f64; 2]]| Wave {
            place,
            limits: limits.to_vec(),
        };
        // The last is at its limit: its derivative is taken on one side.
        let all = [
            wave(0.3, &[[-1.0, 1.0]]),
            wave(0.0, &[]),
            wave(-0.2, &[[-0.5, 0.0]]),
        ];
        let all: Vec<&dyn Effect> = all.iter().map(|wave| wave as &dyn Effect).collect();
        let shapes = Shapes::of(&all, &motion);
        let theta = DVector::from_row_slice(&[2.0, 7.0, 5.0, 7.0, 3.0, 7.0, 0.1, 0.0]);
        let found = shapes.derivatives((&all, &[2, 2, 2]), (&motion, &motion), &theta);
        let found = found.unwrap();
        assert_eq!(found.len(), 2);
        for (found, (size, place)) in found.iter().zip([(2.0, 0.4), (3.0, -0.2)]) {
            for (q, found) in motion.q.iter().zip(found) {
                let true_value = size * (q + place).cos();
                assert!(
                    (found - true_value).abs() < 0.02 * size,
                    "{found} {true_value}"
                );
            }
        }
    }
}
