//! The motion prepared for a fit: smoothed, differentiated, cut into strokes, gated, and a filter for every regressor.
//!
//! Position and effort are brought to a work rate by the same anti-alias filter. Then
//! - linear regressors are `F(D q)`, `F(D^2 q)`, the effort `F(tau)`, with one zero-phase low-pass `F`;
//! - nonlinear ones are evaluated on the motion smoothed at twice the cut-off and then go through `F` too
//!   ([`Motion::regressor`]), also `sgn(dq)`.
//!
//! Where the joint rests, friction takes up whatever the hand gives: there, before the filter, all of these count without what the
//! smoothing leaves of them, so that no effort at rest is spread over the samples nearby ([`Motion::regressor`]).
//!
//! Samples for the fit are then taken at about four times the cut-off and gated by name.

mod cover;
mod gate;
mod kernel;
mod quiet;
mod rows;
mod sparse;
mod stroke;
mod turn;
mod variables;
mod visits;

pub use sparse::SparseColumns;
pub use stroke::strokes;

use core::ops::Range;
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError};

use nalgebra::DMatrix;

use crate::effect::slip;
use crate::filter::{FilterError, LowPass, first_derivative, second_derivative};
use crate::noise;
use crate::parallel::in_parallel;
use crate::samples::{JointSamples, Slid, quantile};
use crate::screw::JointKind;

/// How the motion is prepared.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MotionSettings {
    /// Cut-off of the filter for effort and regressors, Hz.
    pub cutoff_hz: f64,
    /// Butterworth order of that filter, one way.
    pub order: usize,
    /// Rate at which regressors are evaluated, Hz; the nearest whole fraction of that of the samples.
    pub work_rate_hz: f64,
    /// Whether the cut-off may be lowered for a slow motion, see [`MotionSettings::quiet_for`].
    pub gives_way: bool,
    /// Whether the search, too, lets friction be unknown about turns, as about rests: a joint that breaks away with a jerk is nowhere near sliding there.
    pub turns_left_out: bool,
}

impl Default for MotionSettings {
    /// 6 Hz, order 4: hands reach about 5 Hz, and tracker noise grows with the fifth power of the cut-off.
    fn default() -> Self {
        Self {
            cutoff_hz: 6.0,
            order: 4,
            work_rate_hz: 200.0,
            gives_way: true,
            turns_left_out: false,
        }
    }
}

/// Why a motion cannot be prepared.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum MotionError {
    /// Less motion than a fit needs.
    #[error(
        "{got_s:.1} s without a gap is too short, need at least {needed_s:.0} s; record longer"
    )]
    TooShort {
        /// Longest gapless run, s.
        got_s: f64,
        /// Needed, s.
        needed_s: f64,
    },
    /// The joint stands still.
    #[error(
        "the joint never moves: q stays within {range:.4} {unit}; open and close it while recording"
    )]
    NeverMoves {
        /// Range of the coordinate.
        range: f64,
        /// Its unit.
        unit: &'static str,
    },
    /// All samples are gated.
    #[error("only {kept} of {total} samples pass the gates; move faster and over a larger range")]
    AllGated {
        /// Samples left.
        kept: usize,
        /// Samples before the gates.
        total: usize,
    },
    /// The filter does not fit the data.
    #[error(transparent)]
    Filter(#[from] FilterError),
}

/// A prepared motion. Series are at the work rate unless said otherwise.
#[derive(Clone, Debug)]
pub struct Motion {
    /// Revolute or prismatic.
    pub kind: JointKind,
    /// Work period, s.
    pub period: f64,
    /// Gapless runs.
    pub runs: Vec<Range<usize>>,
    /// Time, s.
    pub time: Vec<f64>,
    /// Coordinate smoothed at twice the cut-off.
    pub q: Vec<f64>,
    /// Its first derivative.
    pub dq: Vec<f64>,
    /// Its second derivative.
    pub ddq: Vec<f64>,
    /// Velocity smoothed less, as far as the position's noise allows: for the moments at which the joint turns.
    pub turning: Vec<f64>,
    /// Cut-off of its smoothing, Hz; of the measured coordinate's in a motion that a fit gave.
    pub turning_hz: f64,
    /// Sign of `turning`, averaged over the half steps around each sample.
    pub sign: Vec<f64>,
    /// Effort through the anti-alias filter only.
    pub tau: Vec<f64>,
    /// Coordinate through the anti-alias filter only.
    pub q_measured: Vec<f64>,
    /// Series of the position sensor's noise at the work rate; may be empty.
    pub noise_of_q: Vec<Vec<f64>>,
    /// Force across the joint at the work rate, as [`crate::samples::Aside`] has it; may be empty.
    pub across: Vec<Vec<f64>>,
    /// As [`crate::samples::Aside`] has it, kg m^2 or kg.
    pub tool_inertia: f64,
    /// As [`crate::samples::Aside`] has it.
    pub lies: bool,
    /// Stroke of each sample, counted from 0 through the recording.
    pub stroke: Vec<usize>,
    /// Whether the joint slides at each sample. Where it rests friction takes up what the hand gives, and no model of the motion can
    /// say how much, see [`Motion::regressor`].
    pub slides: Vec<bool>,
    /// When the tool slid on the handle.
    pub slips: Vec<Slip>,
    /// Indices of the samples used in fits, ascending.
    pub kept: Vec<usize>,
    /// Samples (at the fit's rate) taken out, by gate.
    pub gated: BTreeMap<&'static str, usize>,
    /// Speed below which the joint is taken as stuck.
    pub slow_speed: f64,
    smoothing: LowPass,
    filter: LowPass,
    kernel: kernel::Kernel,
    /// `smoothing` as weights.
    smoother: kernel::Kernel,
    smoothed_tau: OnceLock<Vec<f64>>,
    rows: Made,
}

/// What was last made of `runs`, `kept` and `slides`, which may change.
#[derive(Debug, Default)]
struct Made(Mutex<Option<Arc<rows::Rows>>>);

impl Clone for Made {
    fn clone(&self) -> Self {
        Self(Mutex::new(self.last().clone()))
    }
}

impl Made {
    fn last(&self) -> MutexGuard<'_, Option<Arc<rows::Rows>>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// An instant at which the tool slid on the handle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Slip {
    /// s from the start of the recording.
    pub at: f64,
    /// How far across the path, in the unit of the coordinate.
    pub across: f64,
    /// How far along it, as far as it is known.
    pub along: f64,
    /// Whether the pose shows it whatever the effort says.
    pub is_plain: bool,
}

const MIN_RUN_S: f64 = 1.0;
const MIN_MOTION_S: f64 = 3.0;
const MIN_KEPT: usize = 30;

/// Standard deviation of what a smoothed series leaves, by its median over the samples that count; over all where none does.
fn fast_noise(series: &[f64], smooth: &[f64], counts: &[bool]) -> f64 {
    let all = counts.iter().all(|counts| !counts);
    let both = series.iter().zip(smooth).zip(counts);
    let left: Vec<f64> = both
        .filter(|(_, counts)| **counts || all)
        .map(|((value, smooth), _)| (value - smooth).abs())
        .collect();
    1.4826 * quantile(&left, 0.5)
}

impl Motion {
    /// Prepares `samples`.
    ///
    /// # Errors
    /// [`MotionError`].
    pub fn prepare(samples: &JointSamples, settings: &MotionSettings) -> Result<Self, MotionError> {
        let (mut motion, beside, cutoff) = Self::smoothed_states(samples, settings)?;
        let total = gate::apply(&mut motion, cutoff);
        if motion.find_slips(beside, &samples.aside.slid)? {
            // How slow is stuck depends on the noise.
            (motion.kept, motion.gated) = Default::default();
            gate::apply(&mut motion, cutoff);
            if !samples.aside.slips_left_in {
                motion.leave_out_slips();
            }
        }
        if motion.kept.len() < MIN_KEPT {
            return Err(MotionError::AllGated {
                kept: motion.kept.len(),
                total,
            });
        }
        if settings.turns_left_out {
            motion.leave_out_turns();
        }
        Ok(motion)
    }

    /// Prepares `samples` of the same motion, which need no gates and no search for slips: fits use the same samples of them.
    ///
    /// # Errors
    /// As [`Motion::prepare`], but for [`MotionError::AllGated`].
    pub(crate) fn prepare_alike(
        &self,
        samples: &JointSamples,
        settings: &MotionSettings,
    ) -> Result<Self, MotionError> {
        let (mut motion, ..) = Self::smoothed_states(samples, settings)?;
        motion.kept.clone_from(&self.kept);
        motion.slides.clone_from(&self.slides);
        // Their filters are the same but for how a rate was rounded.
        (motion.kernel, motion.smoother) = (self.kernel.clone(), self.smoother.clone());
        motion.rows = self.rows.clone();
        Ok(motion)
    }

    /// The motion before the gates, the pose across the path at the work rate, and the cut-off of the filter, Hz.
    fn smoothed_states(
        samples: &JointSamples,
        settings: &MotionSettings,
    ) -> Result<(Self, Vec<Vec<f64>>, f64), MotionError> {
        let rate = samples.rate_hz();
        let cutoff_hz = settings.cutoff_hz;
        // The default gives way to a slow sensor; what was asked for does not.
        if !(cutoff_hz <= MotionSettings::default().cutoff_hz || cutoff_hz < rate / 2.0) {
            let rate_hz = rate;
            return Err(FilterError::Cutoff { cutoff_hz, rate_hz }.into());
        }
        let factor = (rate / settings.work_rate_hz).round().max(1.0) as usize;
        let work_rate = rate / factor as f64;
        let cutoff = cutoff_hz.min(work_rate / 6.0);
        let mut work = Work {
            factor,
            rate,
            ..Work::default()
        };
        let longest =
            samples.runs.iter().map(Range::len).max().unwrap_or(0) as f64 * samples.period;
        if longest < MIN_MOTION_S {
            return Err(MotionError::TooShort {
                got_s: longest,
                needed_s: MIN_MOTION_S,
            });
        }
        work.noise = vec![Vec::new(); samples.noise_of_q.len()];
        work.across = vec![Vec::new(); samples.aside.across.len()];
        work.beside = vec![Vec::new(); samples.aside.beside.len()];
        for run in samples
            .runs
            .iter()
            .filter(|run| run.len() as f64 * samples.period >= MIN_RUN_S)
        {
            work.append(samples, run.clone())?;
        }
        let period = 1.0 / work_rate;
        let range = quantile(&work.q, 0.99) - quantile(&work.q, 0.01);
        if range < smallest_range(samples, &work) {
            return Err(MotionError::NeverMoves {
                range,
                unit: samples.kind.position_unit(),
            });
        }
        let smooth_hz = (2.0 * cutoff).min(0.4 * work_rate);
        let smooth_filter = LowPass::butterworth(4, smooth_hz, work_rate)?;
        let q = by_run(&work.runs, &work.q, |part| {
            smooth_filter.zero_phase_settled(part)
        })?;
        let dq = by_run(&work.runs, &q, |part| Ok(first_derivative(part, period)))?;
        let ddq = by_run(&work.runs, &q, |part| Ok(second_derivative(part, period)))?;
        let (turning, turning_hz) = turn::velocity(&work, [&dq, &ddq], 2.0 * cutoff, period)?;
        let filter = LowPass::butterworth(settings.order, cutoff, work_rate)?;
        let motion = Self {
            kind: samples.kind,
            period,
            sign: by_run(&work.runs, &turning, |part| Ok(mean_sign(part)))?,
            stroke: strokes(&work.runs, &q, 0.03 * range),
            runs: work.runs,
            time: work.time,
            q,
            dq,
            ddq,
            turning,
            turning_hz,
            tau: work.tau,
            q_measured: work.q,
            noise_of_q: work.noise,
            across: work.across,
            tool_inertia: samples.aside.tool_inertia,
            lies: samples.aside.lies,
            slides: Vec::new(),
            slips: Vec::new(),
            kept: Vec::new(),
            gated: BTreeMap::new(),
            slow_speed: 0.0,
            kernel: kernel::Kernel::of(&filter, cutoff, work_rate)?,
            smoother: kernel::Kernel::of(&smooth_filter, smooth_hz, work_rate)?,
            smoothing: smooth_filter,
            filter,
            smoothed_tau: OnceLock::new(),
            rows: Made::default(),
        };
        Ok((motion, work.beside, cutoff))
    }

    /// Frees the position's noise of the path and of what the tool slid by; whether it slid.
    fn find_slips(&mut self, beside: Vec<Vec<f64>>, slid: &[Slid]) -> Result<bool, MotionError> {
        let measured = self.noise_of_q.clone();
        self.free_noise_of_path(measured.clone())?;
        let beside = beside.into_iter().map(|one| noise::less_path(self, one));
        let beside = beside.collect::<Result<Vec<_>, _>>()?;
        self.slips = if beside.is_empty() {
            slip::all(self, &self.noise_of_q, slid)
        } else {
            slip::all(self, &beside, slid)
        };
        if self.slips.is_empty() {
            return Ok(false);
        }
        let level = |series: &Vec<f64>| noise::level(self, series);
        let level = measured.iter().map(level).collect();
        self.free_noise_of_path(level)?;
        Ok(true)
    }

    /// Leaves the instants at which the tool slid on the handle out of fits.
    fn leave_out_slips(&mut self) {
        for (slides, t) in self.slides.iter_mut().zip(&self.time) {
            *slides &= !slip::slides(&self.slips, *t);
        }
        let before = self.kept.len();
        self.kept
            .retain(|i| !slip::slides(&self.slips, self.time[*i]));
        self.gated.insert("slip", before - self.kept.len());
    }

    fn free_noise_of_path(&mut self, series: Vec<Vec<f64>>) -> Result<(), MotionError> {
        let free = series.into_iter().map(|one| noise::less_path(self, one));
        self.noise_of_q = free.collect::<Result<_, _>>()?;
        Ok(())
    }

    /// Lets friction be unknown where the joint turns, too; gives [`Motion::slides`] as it was.
    pub(crate) fn leave_out_turns(&mut self) -> Vec<bool> {
        let turns = gate::turns(self);
        let slides = self.slides.iter().zip(turns);
        let left = slides.map(|(slides, turns)| *slides && !turns).collect();
        core::mem::replace(&mut self.slides, left)
    }

    /// The same samples with another coordinate, velocity and acceleration.
    pub(crate) fn with_states(&self, [q, dq, ddq]: [Vec<f64>; 3]) -> Self {
        let mut sign = Vec::with_capacity(dq.len());
        for run in &self.runs {
            sign.extend(mean_sign(&dq[run.clone()]));
        }
        Self {
            q_measured: q.clone(),
            turning: dq.clone(),
            q,
            dq,
            ddq,
            sign,
            ..self.clone()
        }
    }

    /// The same motion with another effort.
    pub(crate) fn with_effort(mut self, tau: Vec<f64>) -> Self {
        self.tau = tau;
        self.smoothed_tau = OnceLock::new();
        self
    }

    /// A series at the work rate through the fit's filter, run by run.
    ///
    /// # Errors
    /// [`MotionError::Filter`] when the length differs from the motion's.
    pub fn filtered(&self, series: &[f64]) -> Result<Vec<f64>, MotionError> {
        by_run(&self.runs, series, |part| {
            self.filter.zero_phase_settled(part)
        })
        .map_err(MotionError::from)
    }

    /// A series at the work rate through the filter that smooths the coordinate, run by run.
    ///
    /// # Errors
    /// As [`Motion::filtered`].
    pub fn smoothed(&self, series: &[f64]) -> Result<Vec<f64>, MotionError> {
        by_run(&self.runs, series, |part| {
            self.smoothing.zero_phase_settled(part)
        })
        .map_err(MotionError::from)
    }

    /// Standard deviation of the measured coordinate's noise while it slides, by what is faster than the smoothed one; jerks are few and do
    /// not count.
    pub(crate) fn fast_noise_of_q(&self) -> f64 {
        fast_noise(&self.q_measured, &self.q, &self.slides)
    }

    /// As [`Motion::fast_noise_of_q`], of the effort.
    pub(crate) fn fast_noise_of_tau(&self) -> f64 {
        let smooth = self.smoothed_effort();
        smooth.map_or(0.0, |smooth| fast_noise(&self.tau, smooth, &self.slides))
    }

    /// The effort as smooth as the coordinate; made once.
    pub(crate) fn smoothed_effort(&self) -> Result<&[f64], MotionError> {
        if let Some(effort) = self.smoothed_tau.get() {
            return Ok(effort);
        }
        let effort = self.smoothed(&self.tau)?;
        Ok(self.smoothed_tau.get_or_init(|| effort))
    }

    /// The weights of what smooths the coordinate, the middle one that of the sample itself.
    pub(crate) fn smoothing(&self) -> &[f64] {
        &self.smoother.both_ways
    }

    /// The samples of a series that fits use.
    #[must_use]
    pub fn at_kept(&self, series: &[f64]) -> Vec<f64> {
        self.kept.iter().map(|&i| series[i]).collect()
    }

    /// A regressor: a series at the work rate, without what the smoothing leaves of it where the joint rests, filtered like the effort,
    /// at the samples that fits use.
    ///
    /// Taken off whole at rest, a series would bring its noise, most of it above the cut-off, through the filter at the edges; and were some
    /// series taken off whole and others smoothed, the edges would differ by what jumps where a rest begins and ends.
    ///
    /// # Errors
    /// [`MotionError::Filter`] when the length differs from the motion's.
    pub fn regressor(&self, series: &[f64]) -> Result<Vec<f64>, MotionError> {
        if series.len() != self.q.len() {
            return Err(MotionError::Filter(FilterError::TooShort {
                got: series.len(),
                needed: self.q.len(),
            }));
        }
        Ok(self.rows().filtered(series))
    }

    /// Regressors that are zero nearly everywhere, as [`Motion::regressor`]; (kept samples, `columns`).
    #[must_use]
    pub fn sparse_regressor(&self, entries: &SparseColumns, columns: usize) -> DMatrix<f64> {
        entries.filtered(&self.rows(), columns)
    }

    fn rows(&self) -> Arc<rows::Rows> {
        // Who comes meanwhile waits for what is made.
        let mut last = self.rows.last();
        let made = last.take();
        let rows = made
            .filter(|rows| rows.is_of(&self.runs, &self.kept, &self.slides))
            .unwrap_or_else(|| {
                let kernels = [&self.kernel, &self.smoother];
                let rows = rows::Rows::of(kernels, &self.runs, &self.kept, &self.slides);
                Arc::new(rows)
            });
        *last = Some(Arc::clone(&rows));
        rows
    }

    /// First derivative of a series at the work rate, run by run.
    #[must_use]
    pub fn derivative(&self, series: &[f64]) -> Vec<f64> {
        let mut out = vec![0.0; series.len()];
        for run in &self.runs {
            out[run.clone()].copy_from_slice(&first_derivative(&series[run.clone()], self.period));
        }
        out
    }

    /// Second derivative of a series at the work rate, run by run.
    #[must_use]
    pub fn second_derivative(&self, series: &[f64]) -> Vec<f64> {
        let mut out = vec![0.0; series.len()];
        for run in &self.runs {
            out[run.clone()].copy_from_slice(&second_derivative(&series[run.clone()], self.period));
        }
        out
    }

    /// Power gain of the zero-phase filter at `hz`.
    #[must_use]
    pub fn power_gain(&self, hz: f64) -> f64 {
        self.filter.gain(hz, 1.0 / self.period).powi(4)
    }

    /// Fold of each kept sample for held-out errors, `0..folds`: pairs of strokes (out and back) take turns. With fewer
    /// than three pairs, blocks of time.
    #[must_use]
    pub fn folds(&self) -> (Vec<usize>, usize) {
        let kept_strokes: Vec<usize> = self.kept.iter().map(|&i| self.stroke[i]).collect();
        let pairs = kept_strokes.iter().max().map_or(1, |s| s / 2 + 1);
        if pairs < 3 {
            let count = 4;
            let size = self.kept.len().div_ceil(count).max(1);
            return ((0..self.kept.len()).map(|i| i / size).collect(), count);
        }
        let count = pairs.min(6);
        (
            kept_strokes.iter().map(|s| (s / 2) % count).collect(),
            count,
        )
    }
}

impl Motion {
    /// Which kept samples count for held-out errors: those whose coordinate, direction and speed other folds of
    /// [`Motion::folds`] have probed from both sides.
    #[must_use]
    pub fn covered(&self) -> Vec<bool> {
        let (folds, count) = self.folds();
        cover::covered(self, &folds, count)
    }
}

/// Range below which a joint counts as standing still: fixed for a tracker, whose drift moves a joint that stands; for other
/// sensors thirty times what changes from one sample to the next at random.
fn smallest_range(samples: &JointSamples, work: &Work) -> f64 {
    if !samples.noise_of_q.is_empty() {
        return if samples.kind == JointKind::Revolute {
            0.02
        } else {
            0.01
        };
    }
    (30.0 * work.white_noise()).max(1e-6)
}

#[derive(Default)]
struct Work {
    factor: usize,
    rate: f64,
    runs: Vec<Range<usize>>,
    time: Vec<f64>,
    q: Vec<f64>,
    tau: Vec<f64>,
    noise: Vec<Vec<f64>>,
    across: Vec<Vec<f64>>,
    beside: Vec<Vec<f64>>,
}

impl Work {
    /// What the coordinate changes by from one sample to the next at random: half of the samples change by less.
    fn white_noise(&self) -> f64 {
        let third = |w: &[f64]| (w[3] - 3.0 * w[2] + 3.0 * w[1] - w[0]).abs() / 20.0_f64.sqrt();
        let bends: Vec<f64> = self.q.windows(4).map(third).collect();
        quantile(&bends, 0.5)
    }

    fn append(&mut self, samples: &JointSamples, run: Range<usize>) -> Result<(), FilterError> {
        let factor = self.factor;
        let aside = &samples.aside;
        let more = samples.noise_of_q.iter();
        let more = more.chain(&aside.across).chain(&aside.beside);
        let from: Vec<&[f64]> = [&samples.q, &samples.tau]
            .into_iter()
            .chain(more)
            .map(|series| &series[run.clone()])
            .collect();
        let start = self.time.len();
        let times = samples.time[run.clone()].iter();
        self.time.extend(times.step_by(factor));
        let more = self.noise.iter_mut();
        let more = more.chain(&mut self.across).chain(&mut self.beside);
        let to: Vec<&mut Vec<f64>> = [&mut self.q, &mut self.tau]
            .into_iter()
            .chain(more)
            .collect();
        for (all, new) in to.into_iter().zip(reduced(&from, factor, self.rate)?) {
            all.extend(new);
        }
        self.runs.push(start..self.time.len());
        Ok(())
    }
}

/// Series through the anti-alias filter, every `factor`-th sample.
fn reduced(series: &[&[f64]], factor: usize, rate: f64) -> Result<Vec<Vec<f64>>, FilterError> {
    if factor == 1 {
        return Ok(series.iter().map(|one| one.to_vec()).collect());
    }
    // Flat to a tenth of the work rate, and the same for every series, so it cancels in the fit.
    let filter = LowPass::butterworth(4, 0.3 * rate / factor as f64, rate)?;
    let groups: Vec<&[&[f64]]> = series.chunks(4).collect();
    let reduced = in_parallel(&groups, |group| -> Result<Vec<Vec<f64>>, FilterError> {
        let at = |i: usize| core::array::from_fn(|k| group.get(k).map_or(0.0, |one| one[i]));
        let together: Vec<[f64; 4]> = (0..group[0].len()).map(at).collect();
        let smooth = filter.zero_phase_settled_each(&together)?;
        let of = |k: usize| smooth.iter().step_by(factor).map(|one| one[k]).collect();
        Ok((0..group.len()).map(of).collect())
    });
    let reduced: Result<Vec<_>, _> = reduced.into_iter().collect();
    Ok(reduced?.into_iter().flatten().collect())
}

pub(crate) fn by_run(
    runs: &[Range<usize>],
    series: &[f64],
    mut f: impl FnMut(&[f64]) -> Result<Vec<f64>, FilterError>,
) -> Result<Vec<f64>, FilterError> {
    let mut out = Vec::with_capacity(series.len());
    for run in runs {
        let part = series.get(run.clone()).ok_or(FilterError::TooShort {
            got: series.len(),
            needed: run.end,
        })?;
        out.extend(f(part)?);
    }
    Ok(out)
}

/// Sign of a velocity, averaged over the half steps around each sample: between -1 and 1 next to a change. A mean over the
/// step before would come half a step late, and friction that comes late looks like inertia.
fn mean_sign(velocity: &[f64]) -> Vec<f64> {
    let mut out: Vec<f64> = velocity.iter().map(|v| v.signum()).collect();
    for (i, pair) in velocity.windows(2).enumerate() {
        let (before, after) = (pair[0], pair[1]);
        if before * after < 0.0 {
            // The change lies this far behind sample i, in steps; it is in the cell of the nearer sample.
            let at = before.abs() / (before.abs() + after.abs());
            let (cell, share) = if at < 0.5 {
                (i, at + 0.5)
            } else {
                (i + 1, at - 0.5)
            };
            out[cell] +=
                before.signum() * share + after.signum() * (1.0 - share) - velocity[cell].signum();
        }
    }
    out
}

#[cfg(test)]
mod tests;
