//! When the joint turns: friction changes its sign then, and what smoothing shifts of that moment looks like inertia.

use core::ops::Range;

use super::{Work, by_run};
use crate::filter::{FilterError, LowPass, first_derivative};
use crate::least_squares::rms;

/// Cut-offs tried for the velocity whose sign is taken, as multiples of that which smooths the coordinate, the best first.
const QUICKER: [f64; 3] = [2.5, 2.0, 1.5];
/// What noise may shift a turn by at the usual acceleration, s; turns have some times that. A joint that sticks as it turns comes to
/// rest at once and leaves slowly, and a cut-off of 12 Hz makes it turn up to a hundredth of a second late.
const SURE_S: f64 = 5e-3;

/// The velocity whose sign friction has: smoothed as little as the position's noise allows where the joint turns, `dq` (from a
/// coordinate smoothed at `cutoff_hz`) where it allows no less; and the cut-off of its smoothing, Hz.
pub(super) fn velocity(
    work: &Work,
    [dq, ddq]: [&[f64]; 2],
    cutoff_hz: f64,
    period: f64,
) -> Result<(Vec<f64>, f64), FilterError> {
    let acceleration = rms(ddq);
    for factor in QUICKER {
        let hz = factor * cutoff_hz;
        if hz > 0.4 / period {
            continue;
        }
        let filter = LowPass::butterworth(4, hz, 1.0 / period)?;
        let noise = if work.noise.is_empty() {
            velocity_of_white(work.white_noise(), hz, period)
        } else {
            let mut most = 0.0_f64;
            for series in &work.noise {
                most = most.max(rms(&smooth(&filter, &work.runs, series, period)?));
            }
            most
        };
        if noise < SURE_S * acceleration {
            return Ok((smooth(&filter, &work.runs, &work.q, period)?, hz));
        }
    }
    Ok((dq.to_vec(), cutoff_hz))
}

fn smooth(
    filter: &LowPass,
    runs: &[Range<usize>],
    series: &[f64],
    period: f64,
) -> Result<Vec<f64>, FilterError> {
    by_run(runs, series, |part| {
        let smooth = filter.zero_phase_settled(part)?;
        Ok(first_derivative(&smooth, period))
    })
}

/// Velocity, rms, that white noise of the coordinate makes below `hz`.
fn velocity_of_white(std: f64, hz: f64, period: f64) -> f64 {
    let omega = core::f64::consts::TAU * hz;
    std * omega * (2.0 * period * hz / 3.0).sqrt()
}
