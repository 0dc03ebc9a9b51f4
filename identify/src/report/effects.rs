//! The named and the refused effects as the report and the twin write them.

use nalgebra::DMatrix;
use serde::{Deserialize, Serialize};

use crate::analysis::Analysis;
use crate::diagnose::{Ambiguity, Evidence, NamedEffect};
use crate::dynamics::{EffortModel, Term};
use crate::effect::library::{Belongs, Search, Unit};
use crate::screw::JointKind;

/// An effect that was added, as written.
#[derive(Clone, Debug, Default, Serialize)]
pub struct EffectEntry {
    /// Name from the project's vocabulary.
    pub name: &'static str,
    /// What it adds to the effort, by the names of these numbers.
    pub equation: &'static str,
    /// Terms and shape parameters.
    pub terms: Vec<Term>,
    /// How many of them are terms: they come first.
    #[serde(skip)]
    pub fitted: usize,
    /// Their covariance, or nothing where it is not known.
    #[serde(skip)]
    pub spread: DMatrix<f64>,
    /// Error on held-out strokes before and after, N m or N.
    pub held_out_rms: [f64; 2],
    /// The same over the effort.
    pub relative: [f64; 2],
    /// Error on each confirming recording before and after.
    pub confirm_rms: Vec<[f64; 2]>,
    /// Share of simulated recordings of the model without it in which the search found as much; 0 of what no search found: what free air, the pose or rests
    /// show.
    pub p_value: f64,
    /// Effects that fit nearly as well.
    pub ambiguous_with: Vec<&'static str>,
    /// What would tell it from each of them, in their order.
    pub told_apart_by: Vec<&'static str>,
    /// Of the object, or of this recording.
    pub belongs_to: &'static str,
    /// Residual against the effect's variable, without it and with it.
    pub evidence: Option<Evidence>,
}

impl EffectEntry {
    /// Standard deviation of what changes by so much per unit of each of these numbers.
    pub(super) fn std_of(&self, slopes: &[(usize, f64)]) -> Option<f64> {
        let mut variance = 0.0;
        for (i, a) in slopes {
            for (j, b) in slopes {
                variance += a * b * self.spread.get((*i, *j))?;
            }
        }
        Some(variance.max(0.0).sqrt())
    }
}

/// A candidate that improved the fit and was turned down.
#[derive(Clone, Debug, Serialize)]
pub struct RefusedEntry {
    /// Its name.
    pub name: &'static str,
    /// Why.
    pub reason: String,
    /// Error on held-out strokes without and with it.
    pub held_out_rms: [f64; 2],
}

/// The model of the named effects, without a mechanism.
#[derive(Clone, Debug, Serialize)]
pub struct NamedModel {
    /// Inertia and friction beside the named effects; what the full model does not know is `null` here too.
    pub terms: Vec<Term>,
    /// Root mean square residual.
    pub rms: f64,
    /// Residual over effort.
    pub relative_error: f64,
    /// Error on held-out strokes.
    pub held_out_rms: f64,
    /// Effects that hide in a parameter.
    pub aliases: Vec<Alias>,
}

/// Of the terms of the named model those of the full one, as far as that knows them.
pub(super) fn known_beside(named: &[Term], full: &[Term]) -> Vec<Term> {
    let both = named.iter().zip(full);
    both.map(|(named, full)| Term {
        value: named.value.filter(|_| full.value.is_some()),
        std: named.std.filter(|_| full.value.is_some()),
        ..named.clone()
    })
    .collect()
}

/// An effect that a parameter holds unseen, whatever the motion.
#[derive(Clone, Debug, Serialize)]
pub struct Alias {
    /// The parameter.
    pub term: &'static str,
    /// The effect.
    pub effect: &'static str,
    /// What would tell them apart.
    pub told_apart_by: &'static str,
}

/// An error of the tool's mass adds to the inertia of every object, exactly.
pub(super) const ALIASES: [Alias; 1] = [Alias {
    term: "inertia",
    effect: "tool_mass",
    told_apart_by: "shaking the tool in free air with everything on it that it has in contact",
}];

/// Everything that `effects`, `refused` and `final.named` hold.
pub(super) fn entries(analysis: &Analysis) -> (Vec<EffectEntry>, Vec<RefusedEntry>) {
    let Some(diagnosis) = &analysis.diagnosis else {
        return (Vec::new(), Vec::new());
    };
    let effort = analysis.named.rms / analysis.named.relative_error.max(f64::MIN_POSITIVE);
    let mut at = 3;
    let effects = diagnosis
        .effects
        .iter()
        .enumerate()
        .map(|(i, effect)| {
            let terms = if effect.found.kind.name == "time_lag" {
                lag_terms(analysis)
            } else {
                terms_of(effect, &analysis.named, analysis.kind, &mut at)
            };
            entry(analysis, effect, i, terms, effort)
        })
        .collect();
    let refused = diagnosis
        .refused
        .iter()
        .map(|refused| RefusedEntry {
            name: refused.name,
            reason: refused.reason.clone(),
            held_out_rms: refused.held_out_rms,
        })
        .collect();
    (effects, refused)
}

fn entry(
    analysis: &Analysis,
    effect: &NamedEffect,
    index: usize,
    terms: Vec<Term>,
    effort: f64,
) -> EffectEntry {
    let confirm = analysis.confirmed.iter();
    // Two variants of one effect may be told apart by the same.
    let mut alike: Vec<&Ambiguity> = Vec::new();
    for one in &effect.ambiguous_with {
        let is_one =
            |other: &&Ambiguity| (other.name, other.told_apart_by) == (one.name, one.told_apart_by);
        if !alike.iter().any(is_one) {
            alike.push(one);
        }
    }
    EffectEntry {
        name: effect.found.kind.name,
        equation: effect.found.kind.equation,
        terms,
        fitted: effect.found.terms().count(),
        spread: effect.spread.clone(),
        held_out_rms: effect.held_out_rms,
        relative: effect
            .held_out_rms
            .map(|rms| rms / effort.max(f64::MIN_POSITIVE)),
        confirm_rms: confirm.filter_map(|c| c.rms.get(index).copied()).collect(),
        p_value: effect.p_value,
        ambiguous_with: alike.iter().map(|a| a.name).collect(),
        told_apart_by: alike.iter().map(|a| a.told_apart_by).collect(),
        belongs_to: match effect.found.kind.belongs {
            Belongs::Object => "object",
            Belongs::Recording => "recording",
        },
        evidence: analysis.evidence.get(index).cloned().flatten(),
    }
}

fn lag_terms(analysis: &Analysis) -> Vec<Term> {
    vec![Term {
        name: "lag".to_owned(),
        value: analysis.diagnosis.as_ref().and_then(|d| d.lag_s),
        std: analysis.lag.map(|lag| lag.std_s),
        unit: "s".to_owned(),
    }]
}

/// Terms of one effect out of the model's, from `at` on, then its shape.
fn terms_of(
    effect: &NamedEffect,
    model: &EffortModel,
    joint: JointKind,
    at: &mut usize,
) -> Vec<Term> {
    let found = &effect.found;
    let mut out = Vec::new();
    let variance = |k: usize| effect.spread.get((k, k)).copied();
    for (k, term) in found.terms().enumerate() {
        let by_model = model.covariance.get((*at, *at)).copied();
        out.push(Term {
            name: term.0.to_owned(),
            value: model.theta.get(*at).copied(),
            // At a bound there is none.
            std: variance(k).or(by_model).filter(|v| *v > 0.0).map(f64::sqrt),
            unit: term.1.text(joint),
        });
        *at += 1;
    }
    // What share says of a size.
    let relative = out
        .first()
        .and_then(|share| Some(share.std? / share.value?));
    let relative = relative.filter(|relative| relative.is_finite() && *relative > 0.0);
    let all_used = found.used.iter().all(|used| *used);
    let shapes = found.kind.shape.iter().zip(&found.shape);
    for (k, (shape, value)) in (out.len()..).zip(shapes) {
        // A relief that no term asks for, an instant at which nothing happens.
        let relief = !all_used && shape.2 == Search::Below;
        if relief || shape.1 == Unit::Time && *value < 0.0 {
            continue;
        }
        out.push(Term {
            name: shape.0.to_owned(),
            value: Some(*value),
            std: match shape.2 {
                Search::ByShare => relative.map(|relative| relative * value),
                _ => variance(k).filter(|v| *v > 0.0).map(f64::sqrt),
            },
            unit: shape.1.text(joint),
        });
    }
    out
}

/// An effect in a twin.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TwinEffect {
    /// Name from the project's vocabulary.
    pub name: String,
    /// Name, value and unit of each linear term.
    pub terms: Vec<TwinNumber>,
    /// Name, value and unit of each shape parameter.
    pub shape: Vec<TwinNumber>,
    /// Whether the effect is a function of q and dq; others (memory, measurement) count as 0 in an evaluation.
    pub memoryless: bool,
}

/// A number of an effect.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TwinNumber {
    /// Name.
    pub name: String,
    /// SI.
    pub value: f64,
    /// Unit.
    pub unit: String,
}

impl TwinEffect {
    /// The object's effects of an analysis; a constant load too, as it cannot be told from one of the sensor. One that the full
    /// model leaves to the mechanism is not among them.
    #[must_use]
    pub fn of(analysis: &Analysis) -> Vec<Self> {
        let Some(diagnosis) = &analysis.diagnosis else {
            return Vec::new();
        };
        let number = |name: &str, value: f64, unit: String| TwinNumber {
            name: name.to_owned(),
            value,
            unit,
        };
        let mut theta = analysis.full.theta.iter().skip(3);
        let mut out = Vec::new();
        for found in diagnosis.effects.iter().map(|effect| effect.found.clone()) {
            let terms: Vec<TwinNumber> = found
                .terms()
                .zip(&mut theta)
                .map(|(term, value)| number(term.0, *value, term.1.text(analysis.kind)))
                .collect();
            let shape = found.kind.shape.iter().zip(&found.shape);
            let of_object = found.kind.belongs == Belongs::Object || found.kind.at.is_some();
            // Stiction has no regressor and no term, and is the object's all the same.
            let there = found.kind.terms.is_empty() || terms.iter().any(|term| term.value != 0.0);
            if of_object && there {
                out.push(Self {
                    name: found.kind.name.to_owned(),
                    terms,
                    shape: shape
                        .map(|(s, v)| number(s.0, *v, s.1.text(analysis.kind)))
                        .collect(),
                    memoryless: found.kind.at.is_some(),
                });
            }
        }
        out
    }
}
