//! How far parameters move when a stretch of the recording is left out: variance estimated by blocks of time.
//!
//! What a fit leaves is far from white: the tracker's noise, differentiated twice, has nothing at the low frequencies where the strokes are, and what
//! wanders with the poses or with the hand stays on one side for a stroke. Whole blocks keep both. Left out altogether, as by the jackknife, a
//! block that decides much moves the parameters further than they are uncertain, for the others have to say what it says. The root of that
//! (CR2: unbiased for white noise without penalties) is the mean of moves over the shares at which Gauss and Chebyshev's quadrature asks:
//!
//! ```text
//! d_b = H^-1/2 (1 - A_b)^-1/2 H^-1/2 Z_b' r_b          A_b = H^-1/2 Z_b' Z_b H^-1/2
//!     ~ mean over t of (H - t Z_b' Z_b)^-1 Z_b' r_b     Z_b, r_b: rows and residuals of block b;  H: normal matrix of all with penalties
//! covariance = sum over b of (d_b - mean d)(d_b - mean d)'
//! ```
//!
//! Penalties pull the sum of all Z_b' r_b away from 0: hence the mean. A block that decides half of a parameter or more is left out altogether:
//! its residuals no longer tell how wrong it may be.
//!
//! # Source
//! Bell and McCaffrey, *Bias reduction in standard errors for linear regression with multi-stage samples*, Survey Methodology 28, 2002; Künsch, *The
//! jackknife and the bootstrap for general stationary observations*, Annals of Statistics 17, 1989; Efron, *The jackknife, the bootstrap and
//! other resampling plans*, 1982, chapter 3.

use core::ops::Range;

use nalgebra::{DMatrix, DVector};

use crate::factor::Factor;
use crate::motion::Motion;
use crate::parallel::in_parallel;
use crate::products::{crossed, dot, gram};

/// Length of a block, s: a stroke.
const BLOCK_S: f64 = 2.0;
/// Of a short recording there are so many, which then are shorter.
const FEWEST: usize = 10;
/// Shares of a block that are left out: the nodes of the quadrature. Two give the root of a block that decides half of a parameter to 0.2 %.
const SHARES: [f64; 2] = [0.146_446_609_406_726_24, 0.853_553_390_593_273_8];
/// Share of what is known of a parameter from which on a block decides it.
const DECIDES: f64 = 0.5;
/// A block without which a parameter is known by less than this share of what all blocks say of it is the only one that shows it.
const ALONE: f64 = 1e-4;

/// The blocks of a motion's kept samples.
pub(super) fn blocks(motion: &Motion) -> impl Iterator<Item = Range<usize>> + use<> {
    let kept = &motion.kept;
    let mut steps: Vec<usize> = kept.windows(2).map(|pair| pair[1] - pair[0]).collect();
    steps.sort_unstable();
    let step = steps.get(steps.len() / 2).copied().unwrap_or(1);
    let length = BLOCK_S / (step as f64 * motion.period);
    cut(kept.len(), length.round() as usize)
}

/// Blocks of `length` of so many samples.
fn cut(samples: usize, length: usize) -> impl Iterator<Item = Range<usize>> + use<> {
    let length = length.min(samples / FEWEST).max(1);
    (0..samples)
        .step_by(length)
        .map(move |from| from..(from + length).min(samples))
}

/// Whether `rest` says of each parameter, beside those before it, at least [`ALONE`] of what `all` say.
fn shows_all(rest: &Factor, all: &Factor) -> bool {
    let mut both = rest.diagonal().zip(all.diagonal());
    both.all(|(rest, all)| rest * rest >= ALONE * all * all)
}

/// Variances of the first `params`, the others unknown.
fn variances(factor: &Factor, params: usize) -> Vec<f64> {
    let units = DMatrix::identity(factor.size(), params);
    let inverse = factor.solve(units);
    (0..params).map(|j| inverse[(j, j)]).collect()
}

/// Moves of the first parameters by what was left out.
pub(super) struct LeftOut<'a> {
    /// Normal matrix with penalties, its factor, and the variances by it.
    h: &'a DMatrix<f64>,
    whole: Option<(Factor, Vec<f64>)>,
    params: usize,
    /// Of the block that is being added.
    gram: DMatrix<f64>,
    asked: DMatrix<f64>,
    moves: Vec<DVector<f64>>,
}

impl<'a> LeftOut<'a> {
    /// Of the first `params` that have the normal matrix `h`.
    pub(super) fn new(h: &'a DMatrix<f64>, params: usize) -> Self {
        let whole = Factor::of(h);
        Self {
            h,
            whole: whole.map(|factor| {
                let known = variances(&factor, params);
                (factor, known)
            }),
            params,
            gram: DMatrix::zeros(h.nrows(), h.ncols()),
            asked: DMatrix::zeros(h.nrows(), 1),
            moves: Vec::new(),
        }
    }

    /// Rows `z` and their residuals are of the block that is left out next.
    pub(super) fn add(&mut self, z: &DMatrix<f64>, residual: &[f64]) {
        self.gram += gram(z);
        self.asked += crossed(z, &DMatrix::from_column_slice(residual.len(), 1, residual));
    }

    /// Leaves out the block of what was added since the last one.
    pub(super) fn leave_out(&mut self) {
        self.moves
            .extend(self.move_without(&self.gram, &self.asked));
        self.gram.fill(0.0);
        self.asked.fill(0.0);
    }

    /// Leaves out each block of samples, the others in; `rows` = those of a block, and their residuals. The moves keep the blocks' order.
    pub(super) fn leave_out_each<'r>(
        &mut self,
        blocks: impl Iterator<Item = Range<usize>>,
        rows: impl Fn(Range<usize>) -> (DMatrix<f64>, &'r [f64]) + Sync,
    ) {
        let blocks: Vec<Range<usize>> = blocks.collect();
        let moves = in_parallel(&blocks, |block| {
            let (z, residual) = rows(block.clone());
            let residual = DMatrix::from_column_slice(residual.len(), 1, residual);
            self.move_without(&gram(&z), &crossed(&z, &residual))
        });
        self.moves.extend(moves.into_iter().flatten());
    }

    /// The move by a block with this normal matrix and these products with the residuals. Nothing where all blocks together do
    /// not show every parameter.
    fn move_without(&self, of_block: &DMatrix<f64>, asked: &DMatrix<f64>) -> Option<DVector<f64>> {
        let (whole, known) = self.whole.as_ref()?;
        let without = |share: f64| Factor::of(&(self.h - of_block * share));
        let [less, rest] = [without(SHARES[0])?, without(SHARES[1])?];
        // Of what is known, a block that decides the share a leaves 1 - t a without its share t.
        let left = 1.0 - DECIDES * SHARES[1];
        let is_decided = |(known, rest): (&f64, f64)| *known < left * rest;
        let moved = if (known.iter().zip(variances(&rest, self.params))).any(is_decided) {
            // What only this block shows is not known without it: then it is weighed less instead of left out.
            let rest = without(1.0).filter(|rest| shows_all(rest, whole));
            rest.as_ref().unwrap_or(whole).solve(asked.clone())
        } else {
            0.5 * (less.solve(asked.clone()) + rest.solve(asked.clone()))
        };
        Some(moved.column(0).rows(0, self.params).into_owned())
    }

    /// Covariance of the parameters, so that 1.96 standard deviations hold as much as Student's distribution does for so few blocks; of
    /// those, only as many count as share in what moves a parameter. Infinite where no two blocks could be left out.
    pub(super) fn covariance(&self) -> DMatrix<f64> {
        if self.moves.len() < 2 {
            return DMatrix::from_diagonal_element(self.params, self.params, f64::INFINITY);
        }
        let blocks = self.moves.len() as f64;
        let mean = self.moves.iter().sum::<DVector<f64>>() / blocks;
        let (mut squares, mut fourths) = (DVector::zeros(self.params), DVector::zeros(self.params));
        let mut out = DMatrix::zeros(self.params, self.params);
        for moved in &self.moves {
            let away = moved - &mean;
            out += &away * away.transpose();
            let square = away.component_mul(&away);
            fourths += square.component_mul(&square);
            squares += square;
        }
        let wider = squares.zip_map(&fourths, |square: f64, fourth: f64| {
            // Satterthwaite's freedom. Of normal numbers with variances v the sum of the squares has the square (sum v)^2 + 2 sum v^2 on the
            // mean, the sum of the fourth powers is 3 sum v^2: three times their ratio is two more than (sum v)^2 / sum v^2.
            let freedom = 3.0 * square * square / fourth.max(f64::MIN_POSITIVE) - 2.0;
            student_over_normal(freedom.min(blocks - 1.0))
        });
        out.component_mul(&(&wider * wider.transpose()))
    }
}

/// Covariance of the parameters of filtered `columns` by what each stretch of the motion moves them, where `residual` is left, whose square is worth
/// `variance` per sample; `within` = how far from where they are, one standard deviation, parameters may be whatever the data say.
/// Zero for those that are `fixed`, nothing where no two stretches say enough.
pub(crate) fn covariance_of_columns(
    motion: &Motion,
    columns: &[Vec<f64>],
    (residual, variance): (&[f64], f64),
    within: impl Fn(usize) -> Option<f64>,
    fixed: impl Fn(usize) -> bool,
) -> Option<DMatrix<f64>> {
    let free: Vec<usize> = (0..columns.len()).filter(|&j| !fixed(j)).collect();
    let known: Vec<f64> = free
        .iter()
        .map(|&j| within(j).map_or(0.0, |within| variance / within.powi(2)))
        .collect();
    let size = |(j, known): (&usize, &f64)| (dot(&columns[*j], &columns[*j]) + known).sqrt();
    let scale: Vec<f64> = free.iter().zip(&known).map(size).collect();
    let z = DMatrix::from_fn(residual.len(), free.len(), |i, j| {
        columns[free[j]][i] / scale[j]
    });
    let known = known.iter().zip(&scale).map(|(k, scale)| k / scale.powi(2));
    let known = DMatrix::from_diagonal(&DVector::from_iterator(free.len(), known));
    let h = gram(&z) + &known;
    let inverse = Factor::of(&h)?.solve(DMatrix::identity(free.len(), free.len()));
    let mut left_out = LeftOut::new(&h, free.len());
    left_out.leave_out_each(blocks(motion), |block| {
        (z.rows_range(block.clone()).into_owned(), &residual[block])
    });
    // What was known before is as uncertain as it says; no stretch of the motion moves it.
    let inner = left_out.covariance() + &inverse * known * &inverse * variance;
    let mut out = DMatrix::zeros(columns.len(), columns.len());
    for (i, &row) in free.iter().enumerate() {
        for (j, &column) in free.iter().enumerate() {
            out[(row, column)] = inner[(i, j)] / (scale[i] * scale[j]);
        }
    }
    out.iter().all(|value| value.is_finite()).then_some(out)
}

/// 95 % interval of Student's distribution over the normal one's: Abramowitz and Stegun, 26.7.5.
fn student_over_normal(freedom: f64) -> f64 {
    const NORMAL: f64 = 1.96;
    let (n, z) = (freedom.max(1.0), NORMAL * NORMAL);
    let terms = [
        (z + 1.0) / 4.0,
        ((5.0 * z + 16.0) * z + 3.0) / 96.0,
        (((3.0 * z + 19.0) * z + 17.0) * z - 15.0) / 384.0,
    ];
    1.0 + (terms[0] + (terms[1] + terms[2] / n) / n) / n
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, StandardNormal};

    /// Covariance of least squares estimates of the columns of `y`.
    fn covariance(y: &DMatrix<f64>, tau: &DVector<f64>) -> DMatrix<f64> {
        let h = gram(y);
        let theta = h.clone().cholesky().unwrap().solve(&y.tr_mul(tau));
        let residual = tau - y * theta;
        let mut left_out = LeftOut::new(&h, y.ncols());
        let rows = |block: Range<usize>| {
            let rows = y.rows_range(block.clone()).into_owned();
            (rows, &residual.as_slice()[block])
        };
        left_out.leave_out_each(cut(residual.len(), 48), rows);
        // In two parts, one block after the other, it is the same.
        let mut in_turn = LeftOut::new(&h, y.ncols());
        for block in cut(residual.len(), 48) {
            let half = block.start + block.len() / 2;
            for part in [block.start..half, half..block.end] {
                let (rows, residual) = rows(part);
                in_turn.add(&rows, residual);
            }
            in_turn.leave_out();
        }
        let apart = left_out.covariance() - in_turn.covariance();
        assert!(apart.amax() <= 1e-9 * in_turn.covariance().amax());
        left_out.covariance()
    }

    #[test]
    fn numbers_left_out_tell_how_far_their_mean_is_certain() {
        // The mean of n numbers: their variance over n, widened for few of them.
        let numbers = DVector::from_row_slice(&[1.0, 4.0, 2.0, 7.0, 6.0, 4.0]);
        let n = numbers.len() as f64;
        let square = numbers.add_scalar(-numbers.mean()).norm_squared();
        let student = student_over_normal(n - 1.0);
        let expected = square / (n - 1.0) / n * student.powi(2);
        let found = covariance(&DMatrix::from_element(6, 1, 1.0), &numbers)[(0, 0)];
        // The quadrature is a hair off.
        assert!((found / expected - 1.0).abs() < 1e-4, "{found} {expected}");
    }

    #[test]
    fn a_block_left_out_moves_the_estimate_by_the_root_of_its_share() {
        let y = DMatrix::from_fn(30, 2, |i, j| ((i * (j + 2)) as f64).sin());
        let tau = DVector::from_fn(30, |i, _| (0.7 * i as f64).cos());
        let h = gram(&y);
        let residual = &tau - &y * h.clone().cholesky().unwrap().solve(&y.tr_mul(&tau));
        let mut left_out = LeftOut::new(&h, 2);
        let rows = y.rows(0, 7).into_owned();
        left_out.add(&rows, &residual.as_slice()[..7]);
        left_out.leave_out();
        let of_all = h.clone().cholesky().unwrap();
        let left = DMatrix::identity(7, 7) - &rows * of_all.solve(&rows.transpose());
        let root = left.symmetric_eigen();
        let inverse = &root.eigenvectors
            * DMatrix::from_diagonal(&root.eigenvalues.map(|left| left.sqrt().recip()))
            * root.eigenvectors.transpose();
        let expected = of_all.solve(&rows.tr_mul(&(inverse * residual.rows(0, 7))));
        let found = &left_out.moves[0];
        assert!(
            (found - &expected).amax() < 2e-3 * expected.amax(),
            "{found} {expected}"
        );
    }

    #[test]
    fn what_one_block_decides_is_as_uncertain_as_without_it() {
        // Of 480 samples 48 say nine tenths of the second parameter.
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let y = DMatrix::from_fn(480, 2, |i, j| match (j, i) {
            (0, _) => 1.0,
            (_, 48..96) => 3.0 * (i as f64).sin().signum(),
            _ => (1.3 * i as f64).cos().signum() / 3.0,
        });
        let mut square = 0.0;
        let mut stated = 0.0;
        for _ in 0..300 {
            let tau = DVector::from_fn(480, |_, _| StandardNormal.sample(&mut rng));
            let theta = gram(&y).cholesky().unwrap().solve(&y.tr_mul(&tau));
            square += theta[1] * theta[1];
            stated += covariance(&y, &tau)[(1, 1)];
        }
        assert!(stated > square, "{stated} {square}");
    }

    #[test]
    fn a_parameter_that_one_block_alone_shows_does_not_blur_the_others() {
        let mut rng = ChaCha8Rng::seed_from_u64(12);
        let tau = DVector::from_fn(480, |_, _| StandardNormal.sample(&mut rng));
        let y = DMatrix::from_fn(480, 2, |i, j| match (j, i) {
            (0, _) | (1, 48..96) => 1.0,
            _ => 1e-5 * (1.0 + 0.1 * (i as f64).sin()),
        });
        let alone = covariance(&y.columns(0, 1).into_owned(), &tau)[(0, 0)];
        let beside = covariance(&y, &tau)[(0, 0)];
        assert!(beside < 2.0 * alone, "{beside} {alone}");
    }

    /// Share of 300 draws of noise that a filter with memory `pole` makes of white noise and of its differences, if `differenced`, in
    /// which the interval of a slow wave's size holds the truth.
    fn coverage(pole: f64, differenced: bool) -> f64 {
        let n = 1200;
        let y = DMatrix::from_fn(n, 2, |i, j| {
            if j == 0 {
                (0.13 * i as f64).sin()
            } else {
                (0.031 * i as f64).cos().signum()
            }
        });
        let mut rng = ChaCha8Rng::seed_from_u64(11);
        let mut inside = 0;
        for _ in 0..300 {
            let (mut noise, mut before) = (0.0, 0.0);
            let tau = DVector::from_fn(n, |i, _| {
                let new: f64 = StandardNormal.sample(&mut rng);
                noise = pole * noise + new - if differenced { before } else { 0.0 };
                before = new;
                2.0 * y[(i, 0)] + noise
            });
            let h = gram(&y);
            let theta = h.cholesky().unwrap().solve(&y.tr_mul(&tau));
            let std = covariance(&y, &tau)[(0, 0)].sqrt();
            inside += u32::from((theta[0] - 2.0).abs() < 1.96 * std);
        }
        f64::from(inside) / 300.0
    }

    #[test]
    fn intervals_hold_in_noise_that_is_white_that_wanders_and_that_was_differentiated() {
        for (pole, differenced) in [(0.0, false), (0.9, false), (0.3, true)] {
            let share = coverage(pole, differenced);
            assert!(
                (0.91..=0.99).contains(&share),
                "{pole} {differenced}: {share}"
            );
        }
    }

    #[test]
    fn what_two_of_twelve_blocks_decide_is_as_uncertain_as_two() {
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        let h = DMatrix::from_element(1, 1, 1e6);
        let mut inside = 0;
        for _ in 0..2000 {
            let moves: Vec<f64> = (0..12)
                .map(|k| {
                    let normal: f64 = StandardNormal.sample(&mut rng);
                    normal * if k < 2 { 1.0 } else { 1e-3 }
                })
                .collect();
            let mut left_out = LeftOut::new(&h, 1);
            left_out.moves = moves.iter().map(|m| DVector::from_element(1, *m)).collect();
            // What the blocks leave over in a fit says nothing of how far it is off.
            let error: f64 = StandardNormal.sample(&mut rng);
            let interval = 1.96 * left_out.covariance()[(0, 0)].sqrt();
            inside += u32::from((2.0_f64.sqrt() * error).abs() < interval);
        }
        let share = f64::from(inside) / 2000.0;
        assert!((0.905..0.97).contains(&share), "{share}");
    }

    #[test]
    fn of_one_block_nothing_is_certain() {
        let h = DMatrix::from_element(1, 1, 1.0);
        assert_eq!(LeftOut::new(&h, 1).covariance()[(0, 0)], f64::INFINITY);
    }

    #[test]
    fn students_interval_is_that_of_the_tables() {
        for (freedom, table) in [
            (2.0, 4.303),
            (3.0, 3.182),
            (5.0, 2.571),
            (10.0, 2.228),
            (1e6, 1.96),
        ] {
            let found = 1.96 * student_over_normal(freedom);
            assert!((found / table - 1.0).abs() < 0.035, "{freedom}: {found}");
        }
    }

    #[test]
    fn what_the_data_do_not_say_is_as_uncertain_as_it_was() {
        use crate::motion::MotionSettings;
        use crate::samples::JointSamples;
        use crate::screw::JointKind;
        const RATE: f64 = 250.0;
        let n = 50_000;
        let time: Vec<f64> = (0..n).map(|i| f64::from(i) / RATE).collect();
        let samples = JointSamples {
            kind: JointKind::Prismatic,
            period: 1.0 / RATE,
            runs: vec![0..time.len()],
            q: time.iter().map(|t| 0.2 * (2.0 * t).sin()).collect(),
            tau: time.iter().map(|t| t.sin()).collect(),
            time,
            noise_of_q: Vec::new(),
            aside: crate::samples::Aside::default(),
        };
        let motion = Motion::prepare(&samples, &MotionSettings::default()).unwrap();
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        let mut normal = || -> Vec<f64> {
            motion
                .kept
                .iter()
                .map(|_| StandardNormal.sample(&mut rng))
                .collect()
        };
        let (seen, residual) = (normal(), normal());
        let size = dot(&seen, &seen).sqrt();
        let faint: Vec<f64> = seen.iter().map(|v| 1e-6 * v).rev().collect();
        let nothing = vec![0.0; seen.len()];
        let columns = [seen, nothing, faint, normal()];
        let within = |j: usize| (j == 1 || j == 2).then_some(0.3);
        let found = covariance_of_columns(&motion, &columns, (&residual, 1.0), within, |j| j == 3);
        let found = found.unwrap();
        let std = |j: usize| found[(j, j)].sqrt();
        assert!((0.8..1.25).contains(&(std(0) * size)), "{}", std(0) * size);
        for j in [1, 2] {
            assert!((0.295..0.305).contains(&std(j)), "{}", std(j));
        }
        assert_eq!(std(3), 0.0);
    }
}
