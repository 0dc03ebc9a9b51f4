//! The position sensor's noise as an autoregression: what is left of it after its own past is white.

use core::ops::Range;

/// `e_i = a_1 e_(i-1) + a_2 e_(i-2) + ... + white noise`.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Colour {
    /// Weights of the past, the newest first.
    pub(super) past: Vec<f64>,
    /// Standard deviation of what is new in each sample.
    pub(super) new_std: f64,
}

/// Samples of the past.
const ORDER: usize = 4;

impl Colour {
    /// White noise.
    pub(super) fn white(std: f64) -> Self {
        Self {
            past: Vec::new(),
            new_std: std,
        }
    }

    /// From series of the noise, cut into runs, by Burg's recursion over all of them; nothing when there is no noise.
    ///
    /// # Source
    /// J. P. Burg, *Maximum entropy spectral analysis*, 1975.
    pub(super) fn of(series: &[Vec<f64>], runs: &[Range<usize>]) -> Option<Self> {
        let parts = series.iter().flat_map(|series| {
            runs.iter()
                .filter(|run| run.len() > 10 * ORDER)
                .map(|run| &series[run.clone()])
        });
        let mut forward: Vec<Vec<f64>> = parts.map(<[f64]>::to_vec).collect();
        let mut backward = forward.clone();
        let count: usize = forward.iter().map(Vec::len).sum();
        let total: f64 = forward.iter().flatten().map(|v| v * v).sum();
        if count == 0 || total <= 0.0 {
            return None;
        }
        let mut past: Vec<f64> = Vec::new();
        let mut variance = total / count as f64;
        for order in 1..=ORDER {
            let (mut both, mut each) = (0.0, 0.0);
            for (f, b) in forward.iter().zip(&backward) {
                for i in order..f.len() {
                    both += f[i] * b[i - 1];
                    each += f[i] * f[i] + b[i - 1] * b[i - 1];
                }
            }
            if each <= 0.0 {
                break;
            }
            let reflection = (2.0 * both / each).clamp(-0.999_999, 0.999_999);
            for (f, b) in forward.iter_mut().zip(&mut backward) {
                for i in (order..f.len()).rev() {
                    let (ahead, behind) = (f[i], b[i - 1]);
                    f[i] = ahead - reflection * behind;
                    b[i] = behind - reflection * ahead;
                }
            }
            let turned: Vec<f64> = past.iter().rev().map(|a| reflection * a).collect();
            past.iter_mut().zip(turned).for_each(|(a, t)| *a -= t);
            past.push(reflection);
            variance *= 1.0 - reflection * reflection;
        }
        Some(Self {
            past,
            new_std: variance.sqrt(),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, StandardNormal};

    #[test]
    fn an_autoregression_is_found_again() {
        let mut random = ChaCha8Rng::seed_from_u64(5);
        let mut series = vec![0.0, 0.0];
        for i in 2..20_000 {
            let new: f64 = StandardNormal.sample(&mut random);
            series.push(1.6 * series[i - 1] - 0.63 * series[i - 2] + 0.2 * new);
        }
        let colour = Colour::of(&[series], &[0..9_000, 9_000..20_000]).unwrap();
        for (found, wanted) in colour.past.iter().zip([1.6, -0.63, 0.0, 0.0]) {
            assert!((found - wanted).abs() < 0.03, "{colour:?}");
        }
        assert!((colour.new_std - 0.2).abs() < 0.005, "{colour:?}");
    }

    #[test]
    fn no_noise_has_no_colour() {
        assert_eq!(Colour::of(&[vec![0.0; 100]], &[0..100]), None);
        assert_eq!(Colour::of(&[], &[0..100]), None);
    }
}
