//! Low-pass filters as second-order sections, run forward and backward so that they shift nothing in time.
//!
//! Every regressor of a fit goes through the same filter as the effort; a filter is linear, so the parameters stay what
//! they were. Design by pole placement and bilinear transform with pre-warping; zero phase as
//! `scipy.signal.sosfiltfilt` (odd extension, steady-state start).

mod difference;

pub use difference::{central_difference, first_derivative, second_derivative};

use core::array::from_fn;
use core::f64::consts::PI;

use crate::products::in_vectors;

/// Why a filter could not be made or run.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum FilterError {
    /// The cut-off lies outside (0, rate / 2).
    #[error(
        "cut-off {cutoff_hz} Hz is not between 0 and half the rate of {rate_hz} Hz; choose a lower cut-off"
    )]
    Cutoff {
        /// Asked for, Hz.
        cutoff_hz: f64,
        /// Sample rate, Hz.
        rate_hz: f64,
    },
    /// The order is outside 1..=12.
    #[error("filter order {order} is not between 1 and 12")]
    Order {
        /// Asked for.
        order: usize,
    },
    /// The series is shorter than the filter's edge extension.
    #[error("series of {got} samples is too short for the filter, which needs more than {needed}")]
    TooShort {
        /// Samples there.
        got: usize,
        /// Samples of edge extension.
        needed: usize,
    },
}

/// One second-order section: `b` and `a` in powers of 1/z, `a[0]` = 1.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Section {
    b: [f64; 3],
    a: [f64; 3],
}

impl Section {
    /// In the state that a constant input of `level` leaves.
    fn running<const N: usize>(self, level: [f64; N]) -> Running<N> {
        Running {
            section: self,
            state: self.steady_state().map(|state| level.map(|l| state * l)),
        }
    }

    /// Gain at zero frequency.
    fn dc_gain(&self) -> f64 {
        self.b.iter().sum::<f64>() / self.a.iter().sum::<f64>()
    }

    /// State that a constant input of 1 leaves.
    fn steady_state(&self) -> [f64; 2] {
        let gain = self.dc_gain();
        let s1 = self.b[2] - self.a[2] * gain;
        [self.b[1] - self.a[1] * gain + s1, s1]
    }
}

/// A section with the states that it carries along for series side by side, in the direct form II transposed.
struct Running<const N: usize> {
    section: Section,
    state: [[f64; N]; 2],
}

impl<const N: usize> Running<N> {
    #[inline(always)]
    fn next(&mut self, input: [f64; N]) -> [f64; N] {
        let ([b0, b1, b2], [_, a1, a2]) = (self.section.b, self.section.a);
        let [s0, s1] = self.state;
        let output: [f64; N] = from_fn(|k| b0 * input[k] + s0[k]);
        self.state = [
            from_fn(|k| b1 * input[k] - a1 * output[k] + s1[k]),
            from_fn(|k| b2 * input[k] - a2 * output[k]),
        ];
        output
    }
}

/// Which end of a series a filter begins at.
#[derive(Clone, Copy)]
enum Way {
    Forward,
    Backward,
}

impl Way {
    fn first<T>(self, series: &[T]) -> Option<&T> {
        match self {
            Self::Forward => series.first(),
            Self::Backward => series.last(),
        }
    }

    #[inline(always)]
    fn each<T>(self, series: &mut [T], f: impl FnMut(&mut T)) {
        match self {
            Self::Forward => series.iter_mut().for_each(f),
            Self::Backward => series.iter_mut().rev().for_each(f),
        }
    }
}

/// A low-pass filter of second-order sections.
#[derive(Clone, Debug, PartialEq)]
pub struct LowPass {
    sections: Vec<Section>,
    /// Cut-off over rate.
    cutoff: f64,
}

impl LowPass {
    /// Butterworth of `order` with its -3 dB point (one way) at `cutoff_hz`.
    ///
    /// # Errors
    /// [`FilterError::Cutoff`], [`FilterError::Order`].
    pub fn butterworth(order: usize, cutoff_hz: f64, rate_hz: f64) -> Result<Self, FilterError> {
        Self::from_poles(order, cutoff_hz, rate_hz, 1.0, |angle| {
            (angle.cos(), angle.sin())
        })
    }

    /// Chebyshev type I of `order` with `ripple_db` in the pass band, which ends at `cutoff_hz`.
    ///
    /// # Errors
    /// [`FilterError::Cutoff`], [`FilterError::Order`].
    pub fn chebyshev1(
        order: usize,
        ripple_db: f64,
        cutoff_hz: f64,
        rate_hz: f64,
    ) -> Result<Self, FilterError> {
        let epsilon = (10.0_f64.powf(ripple_db / 10.0) - 1.0).sqrt();
        let mu = (1.0 / epsilon).asinh() / order.max(1) as f64;
        let gain = if order.is_multiple_of(2) {
            10.0_f64.powf(-ripple_db / 20.0)
        } else {
            1.0
        };
        Self::from_poles(order, cutoff_hz, rate_hz, gain, |angle| {
            (mu.sinh() * angle.cos(), mu.cosh() * angle.sin())
        })
    }

    /// `pole` gives the prototype pole (cut-off 1 rad/s) of an angle in (pi/2, pi].
    fn from_poles(
        order: usize,
        cutoff_hz: f64,
        rate_hz: f64,
        gain: f64,
        pole: impl Fn(f64) -> (f64, f64),
    ) -> Result<Self, FilterError> {
        if !(1..=12).contains(&order) {
            return Err(FilterError::Order { order });
        }
        if !(cutoff_hz > 0.0 && cutoff_hz < rate_hz / 2.0) {
            return Err(FilterError::Cutoff { cutoff_hz, rate_hz });
        }
        let warped = (PI * cutoff_hz / rate_hz).tan();
        let mut sections = Vec::with_capacity(order.div_ceil(2));
        for k in 0..order / 2 {
            let angle = PI * (2 * k + 1 + order) as f64 / (2 * order) as f64;
            let (re, im) = pole(angle);
            let (re, im) = (re * warped, im * warped);
            // s = (z - 1) / (z + 1): denominator s^2 - 2 re s + |p|^2.
            let square = re * re + im * im;
            let a0 = 1.0 - 2.0 * re + square;
            let a = [
                1.0,
                2.0 * (square - 1.0) / a0,
                (1.0 + 2.0 * re + square) / a0,
            ];
            let unit = (a[0] + a[1] + a[2]) / 4.0;
            sections.push(Section {
                b: [unit, 2.0 * unit, unit],
                a,
            });
        }
        if !order.is_multiple_of(2) {
            let (re, _) = pole(PI);
            let re = re * warped;
            let a1 = (-1.0 - re) / (1.0 - re);
            let unit = (1.0 + a1) / 2.0;
            sections.push(Section {
                b: [unit, unit, 0.0],
                a: [1.0, a1, 0.0],
            });
        }
        if let Some(first) = sections.first_mut() {
            first.b = first.b.map(|b| b * gain);
        }
        Ok(Self {
            sections,
            cutoff: cutoff_hz / rate_hz,
        })
    }

    /// Samples by which each end is extended, as scipy chooses them.
    #[must_use]
    pub fn edge_samples(&self) -> usize {
        let first_order = self
            .sections
            .iter()
            .filter(|section| section.b[2] == 0.0)
            .count();
        3 * (2 * self.sections.len() + 1 - first_order)
    }

    /// The series filtered forward and backward: no phase, gain squared.
    ///
    /// # Errors
    /// [`FilterError::TooShort`].
    pub fn zero_phase(&self, series: &[f64]) -> Result<Vec<f64>, FilterError> {
        self.alone(series, self.edge_samples())
    }

    /// As [`LowPass::zero_phase`], with each end extended by three times the order, as MATLAB's `filtfilt` does.
    ///
    /// # Errors
    /// [`FilterError::TooShort`].
    pub fn zero_phase_matlab(&self, series: &[f64]) -> Result<Vec<f64>, FilterError> {
        self.alone(series, self.edge_samples() - 3)
    }

    /// As [`LowPass::zero_phase`], with each end extended by three periods of the cut-off (or all there is), so that
    /// what the filter does at the ends has died out before the series begins.
    ///
    /// # Errors
    /// [`FilterError::TooShort`].
    pub fn zero_phase_settled(&self, series: &[f64]) -> Result<Vec<f64>, FilterError> {
        self.alone(series, self.settling(series.len()))
    }

    /// As [`LowPass::zero_phase_settled`], of several series side by side: a filter waits for its own last output, and
    /// several take hardly longer than one.
    ///
    /// # Errors
    /// [`FilterError::TooShort`].
    pub fn zero_phase_settled_each<const N: usize>(
        &self,
        series: &[[f64; N]],
    ) -> Result<Vec<[f64; N]>, FilterError> {
        self.zero_phase_extended(series, self.settling(series.len()))
    }

    /// Samples of edge extension that let the filter settle.
    fn settling(&self, count: usize) -> usize {
        let least = self.edge_samples();
        ((3.0 / self.cutoff) as usize).clamp(least, count.max(least + 1) - 1)
    }

    fn alone(&self, series: &[f64], pad: usize) -> Result<Vec<f64>, FilterError> {
        let (series, _) = series.as_chunks::<1>();
        self.zero_phase_extended(series, pad)
            .map(Vec::into_flattened)
    }

    fn zero_phase_extended<const N: usize>(
        &self,
        series: &[[f64; N]],
        pad: usize,
    ) -> Result<Vec<[f64; N]>, FilterError> {
        let count = series.len();
        if count <= pad {
            return Err(FilterError::TooShort {
                got: count,
                needed: pad,
            });
        }
        let beyond =
            |end: usize, i: usize| -> [f64; N] { from_fn(|k| 2.0 * series[end][k] - series[i][k]) };
        let last = count - 1;
        let mut extended = Vec::with_capacity(count + 2 * pad);
        extended.extend((1..=pad).rev().map(|i| beyond(0, i)));
        extended.extend_from_slice(series);
        extended.extend((1..=pad).map(|i| beyond(last, last - i)));
        self.run_once(&mut extended, Way::Forward);
        self.run_once(&mut extended, Way::Backward);
        extended.truncate(count + pad);
        extended.drain(..pad);
        Ok(extended)
    }

    fn run_once<const N: usize>(&self, series: &mut [[f64; N]], way: Way) {
        in_vectors(
            #[inline(always)]
            || self.run_inline(series, way),
        );
    }

    #[inline(always)]
    fn run_inline<const N: usize>(&self, series: &mut [[f64; N]], way: Way) {
        let mut level = way.first(series).copied().unwrap_or([0.0; N]);
        let mut start = |section: &Section| {
            let start = section.running(level);
            level = level.map(|l| l * section.dc_gain());
            start
        };
        // A section waits for its own last output only: two together take as long as one.
        let (pairs, last) = self.sections.as_chunks::<2>();
        for [first, second] in pairs {
            let (mut one, mut other) = (start(first), start(second));
            way.each(series, |value| *value = other.next(one.next(*value)));
        }
        for section in last {
            let mut one = start(section);
            way.each(series, |value| *value = one.next(*value));
        }
    }

    /// Gain of one pass at `hz`; zero phase applies it twice.
    #[must_use]
    pub fn gain(&self, hz: f64, rate_hz: f64) -> f64 {
        let angle = 2.0 * PI * hz / rate_hz;
        let magnitude = |c: &[f64; 3]| {
            let re = c[0] + c[1] * angle.cos() + c[2] * (2.0 * angle).cos();
            let im = c[1] * angle.sin() + c[2] * (2.0 * angle).sin();
            re.hypot(im)
        };
        self.sections
            .iter()
            .map(|section| magnitude(&section.b) / magnitude(&section.a))
            .product()
    }
}

/// Keeps every `factor`-th sample after an anti-alias filter: Chebyshev-I order 8, 0.05 dB, 0.8 / `factor` of the
/// half rate, zero phase. Edges and first sample as MATLAB's `decimate` has them: the samples kept end with the last.
///
/// # Errors
/// [`FilterError::TooShort`]; [`FilterError::Cutoff`] when `factor` is 0.
pub fn decimate(series: &[f64], factor: usize) -> Result<Vec<f64>, FilterError> {
    if factor == 1 {
        return Ok(series.to_vec());
    }
    let filter = LowPass::chebyshev1(8, 0.05, 0.8 / factor as f64, 2.0)?;
    let filtered = filter.zero_phase_matlab(series)?;
    Ok(every(&filtered, factor).copied().collect())
}

/// Every `factor`-th sample, the last among them.
pub(crate) fn every<T>(series: &[T], factor: usize) -> impl Iterator<Item = &T> {
    series
        .iter()
        .skip(series.len().saturating_sub(1) % factor)
        .step_by(factor)
}

#[cfg(test)]
mod tests;
