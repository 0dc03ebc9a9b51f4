//! `report.html`: one file with everything in it (no network), readable in light and dark and on a telephone.
//!
//! Long series are thinned so that in each stretch the smallest and the largest residual and effort stay.

use serde::Serialize;

use crate::analysis::{Analysis, FitSeries, Verdict};
use crate::digits::{figure, with_std};
use crate::dynamics::not_white;
use crate::pipeline::Identified;
use crate::report::Report;
use crate::report::effects::EffectEntry;
use crate::samples::quantile;
use crate::screw::{JointKind, ScrewAxis};
use crate::twin::Evaluator;

const TEMPLATE: &str = include_str!("page/page.html");
/// At most about so many samples per plot.
const MOST_SAMPLES: usize = 6000;

#[derive(Serialize)]
struct Data<'a> {
    report: &'a Report,
    sentences: Vec<String>,
    verdict: String,
    unit_q: &'static str,
    unit_tau: &'static str,
    fit: Option<FitData>,
    probing: Option<Probing>,
    model: Option<Curves>,
    space: Option<Space>,
    autocorrelation: Vec<[f64; 2]>,
}

/// Values rounded to six digits, to keep the file small.
#[derive(Serialize)]
struct FitData {
    t: Vec<f32>,
    q: Vec<f32>,
    dq: Vec<f32>,
    tau: Vec<f32>,
    base: Vec<f32>,
    full: Vec<f32>,
}

#[derive(Serialize)]
struct Probing {
    t: Vec<f32>,
    q: Vec<f32>,
    dq: Vec<f32>,
}

/// What the whole twin says over the probed range.
#[derive(Serialize)]
struct Curves {
    q: Vec<f32>,
    load: Vec<f32>,
    opening: Vec<f32>,
    closing: Vec<f32>,
    speed: f64,
}

#[derive(Serialize)]
struct Space {
    path: Vec<[f32; 3]>,
    point: [f64; 3],
    direction: [f64; 3],
}

/// The page of a result.
///
/// # Errors
/// Never for values of these types; the serializer's own error type is kept.
pub fn page(identified: &Identified) -> Result<String, serde_json::Error> {
    let report = &identified.report;
    let kind = report.joint.kind;
    let analysis = identified.analysis.as_ref();
    let data = Data {
        sentences: sentences(report),
        verdict: report.verdict_line(),
        unit_q: kind.position_unit(),
        unit_tau: kind.effort_unit(),
        fit: analysis.map(fit_data),
        probing: analysis.map(|analysis| probing(&analysis.probing)),
        model: analysis
            .zip(identified.twin.as_ref())
            .map(|(analysis, twin)| curves(&twin.evaluator(), analysis)),
        space: identified.axis.as_ref().map(|axis| space(axis, identified)),
        autocorrelation: analysis.map_or_else(Vec::new, autocorrelation),
        report,
    };
    // A `<` in a file name must not end the script element.
    let json = serde_json::to_string(&data)?.replace('<', "\\u003c");
    Ok(TEMPLATE.replace("/*DATA*/null", &json))
}

/// What a person wants to know first.
fn sentences(report: &Report) -> Vec<String> {
    let joint = &report.joint;
    let [low, high] = joint.q_range;
    let unit = joint.kind.effort_unit();
    let mut out = vec![match joint.kind {
        JointKind::Revolute => format!(
            "It turns about a hinge{}; it was moved over {:.0} degrees.",
            joint
                .radius_m
                .map_or_else(String::new, |r| format!(" {r:.2} m from where it was held")),
            (high - low).to_degrees()
        ),
        JointKind::Prismatic => format!(
            "It slides along a straight line; it was moved over {} m.",
            two_decimals(high - low)
        ),
    }];
    let known = |name: &str| {
        report
            .term(name)
            .and_then(|term| Some((term.value?, term.std?, term.unit.clone())))
    };
    match known("inertia") {
        Some((value, std, unit)) => out.push(format!(
            "{} is {} {unit}.",
            if joint.kind == JointKind::Revolute {
                "Its inertia about the hinge"
            } else {
                "Its moving mass"
            },
            with_std(value, std)
        )),
        None => out.push("Its inertia is not known from this recording.".to_owned()),
    }
    let friction: Vec<String> = [
        ("coulomb", "a constant"),
        ("viscous", "a part that grows with speed of"),
    ]
    .into_iter()
    .filter_map(|(name, words)| {
        known(name).map(|(v, s, unit)| format!("{words} {} {unit}", with_std(v, s)))
    })
    .collect();
    if !friction.is_empty() {
        out.push(format!("Friction has {}.", friction.join(" and ")));
    }
    if let (Some(first), Some(last)) = (report.effects.first(), report.effects.last()) {
        let mut names: Vec<String> = Vec::new();
        for (k, effect) in report.effects.iter().enumerate() {
            let same = |other: &&EffectEntry| other.name == effect.name;
            if report.effects[..k].iter().any(|other| same(&other)) {
                continue;
            }
            let name = effect.name.replace('_', " ");
            names.push(match report.effects.iter().filter(same).count() {
                1 => name,
                count => format!("{name} ({count} times)"),
            });
        }
        out.push(format!(
            "Inertia and friction alone leave {} {unit}; what they lack looks like: {}. With that, {} {unit} is left.",
            two_decimals(first.held_out_rms[0]),
            names.join(", "),
            two_decimals(last.held_out_rms[1])
        ));
    }
    // Named effects that leave nothing but noise have said it all.
    let said = !report.effects.is_empty() && report.last.verdict == Verdict::Explained;
    if let Some(mechanism) = report.mechanism.as_ref().filter(|_| !said) {
        let [least, most] = mechanism.load_range;
        let noise = report.last.noise_floor_rms.unwrap_or(0.0);
        if most - least < 3.0 * noise && least.abs().max(most.abs()) < 3.0 * noise {
            if report.effects.is_empty() {
                out.push(
                    "No mechanism shows: no spring, closer or weight beyond the noise.".to_owned(),
                );
            }
        } else {
            out.push(format!(
                "{} asks for {least:.1} to {most:.1} {unit} depending on where it stands (positive holds it back from opening).",
                if report.effects.is_empty() {
                    "Besides, a mechanism or weight"
                } else if mechanism.holds_named {
                    "All that depends on where it stands, named or not,"
                } else {
                    "What has no name"
                }
            ));
        }
    }
    if let (Some(error), Some(floor)) = (report.last.held_out_rms, report.last.noise_floor_rms) {
        let alone;
        let quality = match report.last.verdict {
            Verdict::Explained if error > NOISE_ALONE * floor => {
                "more than noise, though what is named leaves no more than that without the mechanism"
            }
            Verdict::Explained => "which is all that the sensors' noise allows",
            Verdict::Unexplained if error <= NOISE_ALONE * floor => {
                alone = match not_white(&report.last.structure) {
                    Some(one) => format!(
                        "about as little as noise with the mechanism, but what the named effects leave alone depends on {}",
                        one.variable.in_words()
                    ),
                    None => "about as little as noise with the mechanism, but what is named leaves more alone"
                        .to_owned(),
                };
                alone.as_str()
            }
            Verdict::Unexplained => {
                "more than the sensors' noise explains: something may be missing in the model"
            }
            Verdict::NotIdentifiable => "but the parameters behind it cannot be told apart",
        };
        out.push(format!(
            "On strokes it had not seen, the model is off by {} {unit} (noise alone: {}), {quality}.",
            two_decimals(error),
            two_decimals(floor)
        ));
    }
    out
}

/// Two decimals, and more of what is smaller.
fn two_decimals(value: f64) -> String {
    if value.abs() < 0.1 {
        figure(value)
    } else {
        format!("{value:.2}")
    }
}

/// Above so many times the floor an error is not called noise alone.
const NOISE_ALONE: f64 = 1.2;

fn fit_data(analysis: &Analysis) -> FitData {
    let FitSeries { time, q, dq, tau } = &analysis.series;
    let keep = thinned(tau, &analysis.full.residual);
    let pick = |series: &[f64]| keep.iter().map(|&i| rounded(series[i])).collect();
    FitData {
        t: pick(time),
        q: pick(q),
        dq: pick(dq),
        tau: pick(tau),
        base: pick(&analysis.base.predicted),
        full: pick(&analysis.full.predicted),
    }
}

fn probing(series: &FitSeries) -> Probing {
    let keep = thinned(&series.q, &series.dq);
    let pick = |series: &[f64]| keep.iter().map(|&i| rounded(series[i])).collect();
    Probing {
        t: pick(&series.time),
        q: pick(&series.q),
        dq: pick(&series.dq),
    }
}

/// Indices that keep each stretch's extremes of both series.
fn thinned(a: &[f64], b: &[f64]) -> Vec<usize> {
    if a.len() <= MOST_SAMPLES {
        return (0..a.len()).collect();
    }
    let stretch = (4 * a.len()).div_ceil(MOST_SAMPLES);
    let mut keep = Vec::new();
    for start in (0..a.len()).step_by(stretch) {
        let part = start..(start + stretch).min(a.len());
        for series in [a, b] {
            keep.extend(
                part.clone()
                    .min_by(|&i, &j| series[i].total_cmp(&series[j])),
            );
            keep.extend(
                part.clone()
                    .max_by(|&i, &j| series[i].total_cmp(&series[j])),
            );
        }
    }
    keep.sort_unstable();
    keep.dedup();
    keep
}

fn rounded(value: f64) -> f32 {
    let text = format!("{value:.5e}");
    text.parse().unwrap_or(0.0)
}

fn curves(evaluator: &Evaluator, analysis: &Analysis) -> Curves {
    let [low, high] = evaluator.domain().q;
    let speeds: Vec<f64> = analysis.series.dq.iter().map(|v| v.abs()).collect();
    let speed = quantile(&speeds, 0.5);
    let q: Vec<f64> = (0..=200)
        .map(|i| low + (high - low) * f64::from(i) / 200.0)
        .collect();
    let each = |f: &dyn Fn(f64) -> f64| q.iter().map(|q| rounded(f(*q))).collect();
    // How the effort grows from a crawl to that speed.
    let damping = |q: f64, dq: f64| {
        let crawl = CRAWL * dq;
        (evaluator.effort(q, dq, 0.0) - evaluator.effort(q, crawl, 0.0)) / (dq - crawl)
    };
    Curves {
        load: each(&|q| f64::midpoint(evaluator.rest_band(q)[0], evaluator.rest_band(q)[1])),
        opening: each(&|q| damping(q, speed)),
        closing: each(&|q| damping(q, -speed)),
        q: q.iter().map(|q| rounded(*q)).collect(),
        speed,
    }
}

/// Share of a speed that is a crawl.
const CRAWL: f64 = 1e-6;

fn space(axis: &ScrewAxis, identified: &Identified) -> Space {
    let step = identified.path.len().div_ceil(1500).max(1);
    let path = identified
        .path
        .iter()
        .step_by(step)
        .map(|p| [rounded(p.x), rounded(p.y), rounded(p.z)])
        .collect();
    Space {
        path,
        point: axis.point.coords.into(),
        direction: axis.direction.into_inner().into(),
    }
}

/// Autocorrelation of the residual against lag, s, over pairs that are there.
fn autocorrelation(analysis: &Analysis) -> Vec<[f64; 2]> {
    let (time, residual) = (&analysis.series.time, &analysis.full.residual);
    let steps: Vec<f64> = time.windows(2).map(|w| w[1] - w[0]).collect();
    let step = quantile(&steps, 0.5);
    if step <= 0.0 || residual.len() < 10 {
        return Vec::new();
    }
    let mean = residual.iter().sum::<f64>() / residual.len() as f64;
    let power = residual.iter().map(|r| (r - mean).powi(2)).sum::<f64>() / residual.len() as f64;
    let grid: Vec<i64> = time.iter().map(|t| (t / step).round() as i64).collect();
    let most = (1.5 / step).min(60.0) as i64;
    (0..=most)
        .map(|lag| {
            let (mut sum, mut count, mut j) = (0.0, 0.0, 0);
            for (i, at) in grid.iter().enumerate() {
                while j < grid.len() && grid[j] < at + lag {
                    j += 1;
                }
                if j < grid.len() && grid[j] == at + lag {
                    sum += (residual[i] - mean) * (residual[j] - mean);
                    count += 1.0;
                }
            }
            [
                lag as f64 * step,
                if count > 0.0 {
                    sum / count / power
                } else {
                    0.0
                },
            ]
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn thinning_keeps_extremes_and_bounds_the_size() {
        let mut a = vec![0.0; 100_000];
        a[54_321] = 9.0;
        let b = vec![0.0; 100_000];
        let keep = thinned(&a, &b);
        assert!(keep.contains(&54_321));
        assert!(keep.len() <= MOST_SAMPLES + 4);
    }
}
