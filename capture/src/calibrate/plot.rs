//! A page with the wrench in free air before and after the tool's own wrench and the bias are taken off.

use std::fmt::Write as _;
use std::path::Path;

use super::{Calibrated, FreeAirSample};

const WIDTH: f64 = 900.0;
const HEIGHT: f64 = 110.0;
const AXES: [&str; 6] = ["Fx N", "Fy N", "Fz N", "Mx N m", "My N m", "Mz N m"];

/// A page that needs nothing else.
pub(super) fn page(path: &Path, found: &Calibrated) -> String {
    let name = path.file_name().unwrap_or_default();
    let name = escaped(&name.to_string_lossy());
    // It names topics of the file.
    let summary = escaped(&found.to_string());
    let mut out = format!(
        "<!doctype html><meta charset=utf-8><title>calibration of {name}</title>\
         <style>body{{font:14px sans-serif;max-width:960px;margin:2em auto}}svg{{display:block}}pre{{overflow:auto}}</style>\
         <h1>Calibration</h1><p>{name}</p><pre>{summary}</pre>\
         <p>Grey: measured in free air, about its mean. Blue: what is left, ten times enlarged. Both below 8 Hz.</p>"
    );
    let span = match (found.series.first(), found.series.last()) {
        (Some(first), Some(last)) => (first.time_s, last.time_s.max(first.time_s + 1e-3)),
        _ => (0.0, 1.0),
    };
    for (axis, label) in AXES.iter().enumerate() {
        let mean = found.series.iter().map(|s| s.measured[axis]).sum::<f64>()
            / found.series.len().max(1) as f64;
        let largest = found
            .series
            .iter()
            .map(|s| {
                (s.measured[axis] - mean)
                    .abs()
                    .max(10.0 * s.left[axis].abs())
            })
            .fold(1e-9, f64::max);
        let x = |t: f64| (t - span.0) / (span.1 - span.0) * WIDTH;
        let y = |value: f64| HEIGHT * 0.5 * (1.0 - value / largest);
        let line = |pick: &dyn Fn(&FreeAirSample) -> f64| {
            let mut points = String::new();
            for sample in &found.series {
                let _ = write!(points, "{:.1},{:.1} ", x(sample.time_s), y(pick(sample)));
            }
            points
        };
        let _ = write!(
            out,
            "<h3>{label}</h3><svg viewBox=\"0 0 {WIDTH} {HEIGHT}\" role=img aria-label=\"{label}\">\
             <line x1=0 x2={WIDTH} y1={0} y2={0} stroke=\"#ccc\"/>\
             <polyline fill=none stroke=\"#999\" points=\"{1}\"/>\
             <polyline fill=none stroke=\"#06c\" points=\"{2}\"/>\
             <text x=4 y=12 font-size=11>+-{largest:.3}, {3:.1} to {4:.1} s</text></svg>",
            HEIGHT * 0.5,
            line(&|s| s.measured[axis] - mean),
            line(&|s| 10.0 * s.left[axis]),
            span.0,
            span.1
        );
    }
    out
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;")
}

#[cfg(test)]
mod tests {
    use ft_recording::{Calibration, Estimate};

    use super::*;
    use crate::gyro::Gyroscope;

    #[test]
    fn names_from_the_file_are_no_part_of_the_page() {
        let found = Calibrated {
            calibration: Calibration {
                payload_mass_kg: Estimate {
                    value: 0.5,
                    std: 0.01,
                },
                payload_com_m: Estimate {
                    value: [0.0; 3],
                    std: [0.001; 3],
                },
                payload_inertia_kgm2: Estimate {
                    value: [0.001; 6],
                    std: [0.001; 6],
                },
                wrench_bias: None,
                covariance: None,
            },
            bias_rate: None,
            bias_per_kelvin: None,
            rotation: None,
            alignment: None,
            not_aligned: None,
            damage: None,
            gyroscope: Some(Gyroscope::NotCompared("/<script>&".to_owned())),
            residual_rms: [0.0; 2],
            before_rms: [0.0; 2],
            free_air_s: 10.0,
            repeats: [0; 2],
            inertia_made_possible: false,
            series: Vec::new(),
        };
        let page = page(Path::new("a<script>.mcap"), &found);
        assert!(page.contains("/&lt;script>&amp;"), "{page}");
        assert!(!page.contains("<script>"), "{page}");
    }
}
