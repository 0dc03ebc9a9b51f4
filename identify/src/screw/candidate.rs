//! A line and a circle through a track of positions, and the choice between them.
//!
//! The circle is fitted by iteratively reweighted least squares (Tukey weights on the distance from it); the line, which is
//! a circle's limit, with the same weights. The choice is by the Bayesian information criterion with the number of samples that the *correlated* residual is worth:
//! `BIC = m ln(rms^2) + k ln(m)`, m = independent residuals. A line has k = 4 parameters, a circle 6; where orientations
//! are there, both have 3 more for the grasp. Samples of a tracker that wanders are far from independent, and counting
//! each one lets an arc of 20 m radius win over the line that a drawer is.
//!
//! Besides, an arc must bend: its sagitta must exceed three times its own residual, or the tool must turn as it has it, or it is a line.

use nalgebra::{Matrix3, Matrix6, Point3, Unit, Vector3, Vector6};

use super::orientation::orientation_criteria;
use super::{JointKind, PoseSamples, ScrewAxis, perpendiculars};
use crate::least_squares::{effective_count, rms};

/// Why no joint can be named.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum SelectError {
    /// Too few positions.
    #[error("{samples} poses are too few to fit a joint, need at least {needed}; record longer")]
    TooFewSamples {
        /// Poses there.
        samples: usize,
        /// Poses needed.
        needed: usize,
    },
    /// The tool stays where it is.
    #[error("the joint never moves: the tool stays within {:.1} mm, need at least {:.0} mm; open the object further", .extent_m * 1e3, .needed_m * 1e3)]
    NeverMoves {
        /// Length of the track, m.
        extent_m: f64,
        /// Needed, m.
        needed_m: f64,
    },
}

/// Both first fits and the choice.
#[derive(Clone, Debug, PartialEq)]
pub struct Candidates {
    /// The kind chosen.
    pub kind: JointKind,
    /// Criterion of the revolute candidate; lower is better.
    pub bic_revolute: f64,
    /// Criterion of the prismatic candidate.
    pub bic_prismatic: f64,
    /// Root mean square distance from the circle, m, outliers down-weighted.
    pub circle_rms: f64,
    /// Root mean square distance from the line, m.
    pub line_rms: f64,
    /// Radius of the circle, m.
    pub radius: f64,
    /// Axis of the chosen kind.
    pub axis: ScrewAxis,
    /// Whether the tool turned with the object, so that orientations inform the joint.
    pub orientation_agrees: bool,
}

pub(super) struct Curve {
    pub(super) axis: ScrewAxis,
    radius: f64,
    /// Two perpendicular distances per sample, m.
    residuals: [Vec<f64>; 2],
    weights: Vec<f64>,
}

/// A difference of the criteria that leaves no doubt.
const DECISIVE: f64 = 30.0;
const MIN_SAMPLES: usize = 20;
const MIN_EXTENT_M: f64 = 0.02;

/// Fits both kinds and chooses.
///
/// # Errors
/// [`SelectError`].
pub fn select(track: &PoseSamples) -> Result<Candidates, SelectError> {
    let samples = track.positions.len();
    if samples < MIN_SAMPLES {
        return Err(SelectError::TooFewSamples {
            samples,
            needed: MIN_SAMPLES,
        });
    }
    let (middle, axes, extent) = principal(&track.positions, &vec![1.0; samples]);
    if extent < MIN_EXTENT_M {
        return Err(SelectError::NeverMoves {
            extent_m: extent,
            needed_m: MIN_EXTENT_M,
        });
    }
    let circle = fit_circle(&track.positions, middle, axes);
    let line = fit_line(&track.positions, &circle.weights);
    let position_bic = criteria(&circle, &line);
    let (circle_rms, line_rms) = (weighted_rms(&circle), weighted_rms(&line));
    let bends =
        extent * extent / (8.0 * circle.radius) > 3.0 * circle_rms && circle.radius < 20.0 * extent;
    let (mut bic_revolute, mut bic_prismatic) = position_bic;
    let turn = track
        .has_rotations()
        .then(|| orientation_criteria(track, &circle));
    // Positions decide when they can; a tool that turns in the hand must not outvote an arc.
    let decisive = (bic_revolute - bic_prismatic).abs() > DECISIVE;
    if let Some(turn) = &turn
        && !decisive
    {
        bic_revolute += turn.bic_revolute;
        bic_prismatic += turn.bic_prismatic;
    }
    // A short arc bends less than positions wander; a tool that turns as the arc has it, and not as a slide would, says so too.
    let turns = turn
        .as_ref()
        .is_some_and(|turn| turn.follows() && turn.bic_revolute + DECISIVE < turn.bic_prismatic);
    let bends = bends || turns && circle.radius < 20.0 * extent;
    let kind = if bends && bic_revolute < bic_prismatic {
        JointKind::Revolute
    } else {
        JointKind::Prismatic
    };
    let chosen = if kind == JointKind::Revolute {
        circle.axis
    } else {
        line.axis
    };
    let orientation_agrees = turn.is_some_and(|turn| turn.agrees(kind));
    Ok(Candidates {
        kind,
        bic_revolute,
        bic_prismatic,
        circle_rms,
        line_rms,
        radius: circle.radius,
        axis: chosen,
        orientation_agrees,
    })
}

/// Mean, principal directions (largest first) and extent along the first.
fn principal(positions: &[Point3<f64>], weights: &[f64]) -> (Point3<f64>, [Vector3<f64>; 3], f64) {
    let total: f64 = weights.iter().sum();
    let middle = positions
        .iter()
        .zip(weights)
        .map(|(p, w)| p.coords * *w)
        .sum::<Vector3<f64>>()
        / total;
    let scatter = positions
        .iter()
        .zip(weights)
        .map(|(p, w)| (p.coords - middle) * (p.coords - middle).transpose() * *w)
        .sum::<Matrix3<f64>>();
    let eigen = scatter.symmetric_eigen();
    let mut order = [0, 1, 2];
    order.sort_by(|&a, &b| eigen.eigenvalues[b].total_cmp(&eigen.eigenvalues[a]));
    let axes = order.map(|i| eigen.eigenvectors.column(i).into_owned());
    let mut along: Vec<f64> = positions
        .iter()
        .map(|p| (p.coords - middle).dot(&axes[0]))
        .collect();
    along.sort_by(f64::total_cmp);
    let at = |fraction: f64| along[((along.len() - 1) as f64 * fraction) as usize];
    (Point3::from(middle), axes, at(0.99) - at(0.01))
}

/// The line that fits best with weights given: an arc must not pass for a line by its ends counting as outliers.
fn fit_line(positions: &[Point3<f64>], weights: &[f64]) -> Curve {
    let (middle, axes, _) = principal(positions, weights);
    let residuals = [1, 2].map(|i| {
        positions
            .iter()
            .map(|p| (p - middle).dot(&axes[i]))
            .collect()
    });
    let axis = ScrewAxis {
        direction: Unit::new_normalize(axes[0]),
        point: middle,
        kind: JointKind::Prismatic,
    };
    Curve {
        axis,
        radius: f64::INFINITY,
        residuals,
        weights: weights.to_vec(),
    }
}

fn fit_circle(positions: &[Point3<f64>], middle: Point3<f64>, axes: [Vector3<f64>; 3]) -> Curve {
    let mut weights = vec![1.0; positions.len()];
    let (centre, mut radius) = algebraic_circle(positions, middle, &axes);
    let mut axis = ScrewAxis {
        direction: Unit::new_normalize(axes[2]),
        point: centre,
        kind: JointKind::Revolute,
    };
    let mut residuals = distances(positions, &axis, radius);
    let mut damping = 1e-6;
    let mut cost = weighted_cost(&residuals, &weights);
    for round in 0..60 {
        let (first, second) = perpendiculars(&axis.direction);
        let step = circle_step(positions, &axis, &residuals, &weights, damping);
        let turned = axis.direction.into_inner() + first * step[0] + second * step[1];
        let shift = first * step[2] + second * step[3] + axis.direction.into_inner() * step[4];
        let next = ScrewAxis {
            direction: Unit::new_normalize(turned),
            point: axis.point + shift,
            kind: JointKind::Revolute,
        };
        let next_residuals = distances(positions, &next, radius + step[5]);
        let next_cost = weighted_cost(&next_residuals, &weights);
        if next_cost.is_finite() && next_cost <= cost {
            let settled = cost - next_cost < 1e-9 * cost;
            (axis, radius, residuals) = (next, radius + step[5], next_residuals);
            damping = (damping * 0.2).max(1e-12);
            if settled || round % 5 == 4 {
                let before = core::mem::replace(&mut weights, tukey(&residuals));
                let pairs = weights.iter().zip(&before);
                if settled && pairs.into_iter().all(|(w, b)| (w - b).abs() < 1e-3) {
                    break;
                }
            }
            cost = weighted_cost(&residuals, &weights);
        } else {
            damping *= 10.0;
        }
    }
    Curve {
        axis,
        radius: radius.abs(),
        residuals,
        weights,
    }
}

/// Circle in the plane of the two largest principal directions, from the linear equations of its points.
fn algebraic_circle(
    positions: &[Point3<f64>],
    middle: Point3<f64>,
    axes: &[Vector3<f64>; 3],
) -> (Point3<f64>, f64) {
    let mut normal = Matrix3::zeros();
    let mut right = Vector3::zeros();
    for p in positions {
        let (x, y) = ((p - middle).dot(&axes[0]), (p - middle).dot(&axes[1]));
        let row = Vector3::new(2.0 * x, 2.0 * y, 1.0);
        normal += row * row.transpose();
        right += row * (x * x + y * y);
    }
    let s = normal
        .try_inverse()
        .map_or_else(|| Vector3::new(0.0, 1e3, 0.0), |inverse| inverse * right);
    let radius = (s[2] + s[0] * s[0] + s[1] * s[1]).max(1e-9).sqrt();
    (middle + axes[0] * s[0] + axes[1] * s[1], radius)
}

/// Height above the plane and distance from the circle within it.
fn distances(positions: &[Point3<f64>], axis: &ScrewAxis, radius: f64) -> [Vec<f64>; 2] {
    let height = positions
        .iter()
        .map(|p| axis.direction.dot(&(p - axis.point)))
        .collect();
    [
        height,
        positions
            .iter()
            .map(|p| axis.distance(p) - radius)
            .collect(),
    ]
}

/// One Levenberg-Marquardt step in [tilt 2, centre 3, radius].
fn circle_step(
    positions: &[Point3<f64>],
    axis: &ScrewAxis,
    residuals: &[Vec<f64>; 2],
    weights: &[f64],
    damping: f64,
) -> Vector6<f64> {
    let (first, second) = perpendiculars(&axis.direction);
    let direction = axis.direction.into_inner();
    let mut normal = Matrix6::zeros();
    let mut right = Vector6::zeros();
    for (i, p) in positions.iter().enumerate() {
        let arm = p - axis.point;
        let height = residuals[0][i];
        let outward = (arm - direction * direction.dot(&arm)).normalize();
        let up = [first.dot(&arm), second.dot(&arm), 0.0, 0.0, -1.0, 0.0];
        let out = [
            -height * outward.dot(&first),
            -height * outward.dot(&second),
            -outward.dot(&first),
            -outward.dot(&second),
            0.0,
            -1.0,
        ];
        for (row, value) in [(up, residuals[0][i]), (out, residuals[1][i])] {
            let row = Vector6::from(row);
            normal += row * row.transpose() * weights[i];
            right -= row * (value * weights[i]);
        }
    }
    for k in 0..6 {
        normal[(k, k)] *= 1.0 + damping;
        normal[(k, k)] += 1e-12;
    }
    normal
        .cholesky()
        .map_or_else(Vector6::zeros, |c| c.solve(&right))
}

fn weighted_cost(residuals: &[Vec<f64>; 2], weights: &[f64]) -> f64 {
    weights
        .iter()
        .enumerate()
        .map(|(i, w)| w * (residuals[0][i].powi(2) + residuals[1][i].powi(2)))
        .sum()
}

fn weighted_rms(curve: &Curve) -> f64 {
    (weighted_cost(&curve.residuals, &curve.weights) / curve.weights.iter().sum::<f64>().max(1.0))
        .sqrt()
}

/// Tukey's biweight at 6 median absolute distances.
fn tukey(residuals: &[Vec<f64>; 2]) -> Vec<f64> {
    let distance: Vec<f64> = residuals[0]
        .iter()
        .zip(&residuals[1])
        .map(|(a, b)| a.hypot(*b))
        .collect();
    let mut sorted = distance.clone();
    sorted.sort_by(f64::total_cmp);
    let scale = 6.0 * sorted[sorted.len() / 2].max(1e-12);
    distance
        .iter()
        .map(|d| {
            if *d < scale {
                (1.0 - (d / scale).powi(2)).powi(2)
            } else {
                0.0
            }
        })
        .collect()
}

/// Independent residuals of a pair of series.
pub(super) fn independent(series: &[Vec<f64>]) -> f64 {
    // The weighted mean of the autocorrelations: the larger component counts more.
    let power: Vec<f64> = series.iter().map(|s| rms(s).powi(2)).collect();
    let total: f64 = power.iter().sum::<f64>().max(f64::MIN_POSITIVE);
    let inverse: f64 = series
        .iter()
        .zip(&power)
        .map(|(s, p)| p / total / effective_count(s))
        .sum();
    series.len() as f64 / inverse.max(f64::MIN_POSITIVE)
}

fn criteria(circle: &Curve, line: &Curve) -> (f64, f64) {
    // The better fit tells noise from shape, so its residual says how much is independent.
    let better = if weighted_rms(circle) < weighted_rms(line) {
        circle
    } else {
        line
    };
    let m = independent(&better.residuals);
    let bic =
        |curve: &Curve, k: f64| m * (weighted_rms(curve).powi(2).max(1e-18)).ln() + k * m.ln();
    (bic(circle, 6.0), bic(line, 4.0))
}
