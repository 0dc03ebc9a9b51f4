//! A page with the wrench in free air before and after the tool's own wrench and the bias are taken off.

use std::fmt::Write as _;

use ft_recording::Recording;

use super::{Calibrated, FreeAirSample};

const WIDTH: f64 = 900.0;
const HEIGHT: f64 = 110.0;
const AXES: [&str; 6] = ["Fx N", "Fy N", "Fz N", "Mx N m", "My N m", "Mz N m"];

/// A page that needs nothing else.
pub(super) fn page(recording: &Recording, found: &Calibrated) -> String {
    let name = recording.path.file_name().unwrap_or_default();
    let name = name
        .to_string_lossy()
        .replace('&', "&amp;")
        .replace('<', "&lt;");
    let mut out = format!(
        "<!doctype html><meta charset=utf-8><title>calibration of {name}</title>\
         <style>body{{font:14px sans-serif;max-width:960px;margin:2em auto}}svg{{display:block}}pre{{overflow:auto}}</style>\
         <h1>Calibration</h1><p>{name}</p><pre>{found}</pre>\
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
