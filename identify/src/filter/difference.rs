//! Derivatives of uniformly sampled series.

/// First derivative by central differences, second order; one-sided at the ends. `period` in s.
#[must_use]
pub fn central_difference(x: &[f64], period: f64) -> Vec<f64> {
    let n = x.len();
    if n < 2 {
        return vec![0.0; n];
    }
    let mut out = Vec::with_capacity(n);
    out.push((x[1] - x[0]) / period);
    out.extend(x.windows(3).map(|w| (w[2] - w[0]) / (2.0 * period)));
    out.push((x[n - 1] - x[n - 2]) / period);
    out
}

/// First derivative with five points, fourth order inside (error (w h)^4 / 30 at w rad/s); second order near the ends.
#[must_use]
pub fn first_derivative(x: &[f64], period: f64) -> Vec<f64> {
    let mut out = central_difference(x, period);
    for (i, w) in x.windows(5).enumerate() {
        out[i + 2] = (w[0] - 8.0 * w[1] + 8.0 * w[3] - w[4]) / (12.0 * period);
    }
    out
}

/// Second derivative with five points, fourth order inside; second order near the ends, which repeat their neighbours.
#[must_use]
pub fn second_derivative(x: &[f64], period: f64) -> Vec<f64> {
    let n = x.len();
    let mut out = vec![0.0; n];
    if n < 3 {
        return out;
    }
    let square = period * period;
    for (i, w) in x.windows(3).enumerate() {
        out[i + 1] = (w[0] - 2.0 * w[1] + w[2]) / square;
    }
    for (i, w) in x.windows(5).enumerate() {
        out[i + 2] = (-w[0] + 16.0 * w[1] - 30.0 * w[2] + 16.0 * w[3] - w[4]) / (12.0 * square);
    }
    out[0] = out[1];
    out[n - 1] = out[n - 2];
    out
}
