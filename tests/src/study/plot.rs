//! The inertia figure as SVG: estimate over truth on logarithmic axes.

use std::fmt::Write as _;

use crate::truth::Comparison;

const SIZE: f64 = 460.0;
const EDGE: f64 = 56.0;
/// Decades of the axes.
const DECADES: [f64; 2] = [-2.0, 2.0];

/// Estimate against truth, ours filled and `paper`'s open; on the diagonal an estimate is exact. Simulated.
#[must_use]
pub fn inertia_plot(results: &[Comparison]) -> String {
    let at = |value: f64| {
        let share = (value.log10() - DECADES[0]) / (DECADES[1] - DECADES[0]);
        EDGE + share.clamp(0.0, 1.0) * (SIZE - 2.0 * EDGE)
    };
    let mut out = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {SIZE} {SIZE}\" font-family=\"sans-serif\" font-size=\"12\">\n\
         <rect width=\"{SIZE}\" height=\"{SIZE}\" fill=\"white\"/>\n"
    );
    let (low, high) = (EDGE, SIZE - EDGE);
    let _ = writeln!(
        out,
        "<path d=\"M{low} {high}L{high} {low}\" stroke=\"#999\"/><path d=\"M{low} {low}V{high}H{high}\" fill=\"none\" stroke=\"black\"/>"
    );
    for decade in DECADES[0] as i32..=DECADES[1] as i32 {
        let value = 10.0_f64.powi(decade);
        let (x, y) = (at(value), SIZE - at(value));
        let _ = writeln!(
            out,
            "<text x=\"{x}\" y=\"{}\" text-anchor=\"middle\">{value}</text><text x=\"{}\" y=\"{}\" text-anchor=\"end\">{value}</text>",
            high + 18.0,
            low - 6.0,
            y + 4.0
        );
    }
    for one in results {
        let dot = |relative: Option<f64>, style: &str| {
            relative.map(|relative| {
                format!(
                    "<circle cx=\"{:.1}\" cy=\"{:.1}\" r=\"3.5\" {style}/>\n",
                    at(one.inertia),
                    SIZE - at(one.inertia * (1.0 + relative))
                )
            })
        };
        out.extend(dot(one.paper[0], "fill=\"none\" stroke=\"#d55e00\""));
        out.extend(dot(one.relative[0], "fill=\"#0072b2\""));
    }
    let _ = writeln!(
        out,
        "<text x=\"{}\" y=\"{}\" text-anchor=\"middle\">true inertia, kg or kg m² (simulated)</text>\n\
         <text transform=\"translate(16 {}) rotate(-90)\" text-anchor=\"middle\">estimate</text>\n\
         <circle cx=\"{}\" cy=\"20\" r=\"3.5\" fill=\"#0072b2\"/><text x=\"{}\" y=\"24\">ours</text>\n\
         <circle cx=\"{}\" cy=\"20\" r=\"3.5\" fill=\"none\" stroke=\"#d55e00\"/><text x=\"{}\" y=\"24\">paper</text>\n</svg>",
        SIZE / 2.0,
        SIZE - 14.0,
        SIZE / 2.0,
        EDGE + 10.0,
        EDGE + 20.0,
        EDGE + 70.0,
        EDGE + 80.0
    );
    out
}
