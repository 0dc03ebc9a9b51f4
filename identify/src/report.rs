//! `report.json` (schema `ft-identify/report/1`) and the short summary for a terminal.
//!
//! Numbers are SI; what is not identified is `null`, also a NaN.

pub mod effects;
mod summary;

use core::ops::Range;
use std::collections::BTreeMap;

use serde::Serialize;

use self::effects::{EffectEntry, NamedModel, RefusedEntry};
use crate::analysis::{Analysis, Verdict};
use crate::digits::figure;
use crate::dynamics::{Bursts, EffortModel, JointFit, Structure, Term};
use crate::effect::friction::STRIBECK;
use crate::effect::library::kind;
use crate::effort::NonWork;
use crate::joint_graph::RefinedJoint;
use crate::lag::{Lag, USUAL_S};
use crate::mechanism::{Domain, Mechanism};
use crate::motion::Motion;
use crate::paper::PaperFit;
use crate::payload::Payload;
use crate::screw::{Candidates, JointKind, ScrewAxis};

/// What is left of the effort on a confirming recording, in times of what is left here and at least of this share, tells of another object.
const ELSEWHERE: f64 = 3.0;
const SMALL: f64 = 0.03;
/// Names that leave so many noise floors are tentative.
const TENTATIVE: f64 = 3.0;
/// What the reason of a refusal begins with that a confirming recording gave.
const UNCONFIRMED: &str = "not confirmed";

/// Name of the schema.
pub const SCHEMA: &str = "ft-identify/report/1";

/// The report as written.
#[derive(Clone, Debug, Serialize)]
pub struct Report {
    schema: &'static str,
    /// What went in.
    pub input: Input,
    /// The joint.
    pub joint: Joint,
    /// The paper's model: I, mu, b.
    pub base: Base,
    /// What the model lacked, the strongest first.
    pub effects: Vec<EffectEntry>,
    /// What improved the fit and was turned down.
    pub refused: Vec<RefusedEntry>,
    /// The full model.
    #[serde(rename = "final")]
    pub last: Final,
    /// The mechanism residual.
    pub mechanism: Option<MechanismSummary>,
    /// What the data do not show, why, and what to do.
    pub not_identified: BTreeMap<String, String>,
    /// Things to know about the recording.
    pub notes: Vec<String>,
    /// The tool in front of the sensor.
    pub payload: Option<Payload>,
    /// Lag of the effort behind the motion.
    pub lag: Option<Lag>,
    /// The part of the contact wrench that does no work.
    pub nonwork: Option<NonWork>,
    /// Motion and dynamics fitted together: I, mu, b where the wrench tells of the acceleration. Where it `stands`, `final` has them;
    /// elsewhere it is a second opinion.
    pub joint_fit: Option<JointFit>,
    /// What the paper's own estimator gives for the same samples, when it was asked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub paper: Option<PaperEstimate>,
}

/// The paper's estimator: biased by its smoother, and without a covariance of its own, so no standard deviations.
#[derive(Clone, Debug, Serialize)]
pub struct PaperEstimate {
    /// Inertia, Coulomb and viscous friction.
    pub terms: Vec<Term>,
    /// Root mean square residual, N m or N, of an effort that no filter went over.
    pub rms: f64,
    /// `mlp`.
    pub mechanism: &'static str,
    /// Root mean square residual with the network.
    pub mechanism_rms: Option<f64>,
    /// Epochs that its training took.
    pub epochs: Option<usize>,
}

/// What went in.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Input {
    /// Files, names only.
    pub files: Vec<String>,
    /// Confirming files.
    pub confirm: Vec<String>,
    /// Length of the input, s.
    pub duration_s: f64,
    /// Samples that the fits used (at about four times the filter's cut-off).
    pub samples_used: usize,
    /// Samples taken out, by gate.
    pub samples_gated: BTreeMap<String, usize>,
    /// How the grasp was found.
    pub grasp: Option<String>,
    /// Gaps in the streams.
    pub gaps: usize,
    /// Begin and end of the longest of them, s from the first sample.
    pub longest_gap_s: Option<[f64; 2]>,
}

impl Input {
    /// With the gaps between the runs of samples at these times, s.
    #[must_use]
    pub fn with_gaps(mut self, runs: &[Range<usize>], time: &[f64]) -> Self {
        let start = time.first().copied().unwrap_or(0.0);
        let between = runs
            .windows(2)
            .map(|pair| [pair[0].end - 1, pair[1].start].map(|i| time[i] - start));
        let length = |gap: &[f64; 2]| gap[1] - gap[0];
        self.longest_gap_s = between.max_by(|a, b| length(a).total_cmp(&length(b)));
        self.gaps = runs.len().saturating_sub(1);
        self
    }

    fn gap_note(&self) -> Option<String> {
        let [from, to] = self.longest_gap_s?;
        let place = format!("from {from:.2} to {to:.2} s after the first sample");
        Some(match self.gaps {
            1 => format!("a gap in the data {place}; nothing was interpolated across it"),
            gaps => format!(
                "{gaps} gaps in the data, the longest {place}; nothing was interpolated across them"
            ),
        })
    }
}

/// The joint.
#[derive(Clone, Debug, Serialize)]
pub struct Joint {
    /// Revolute or prismatic.
    pub kind: JointKind,
    /// Unit direction in `world`; nothing for a table.
    pub axis_direction: Option<[f64; 3]>,
    /// A point on the axis in `world`, m.
    pub axis_point: Option<[f64; 3]>,
    /// Standard deviations.
    pub std: JointStd,
    /// Smallest and largest coordinate, rad or m.
    pub q_range: [f64; 2],
    /// Distance of the positions from the path, m.
    pub position_rms_m: Option<f64>,
    /// The criterion of either kind; lower is better.
    pub bic: JointBic,
    /// Distance of the tool from the axis, m; nothing for a slide.
    pub radius_m: Option<f64>,
    /// Whether orientations informed the joint.
    pub uses_orientation: Option<bool>,
}

/// Standard deviations of the axis.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub struct JointStd {
    /// Direction, degrees.
    pub direction_deg: Option<f64>,
    /// Position across the axis, m; nothing for a slide.
    pub position_m: Option<f64>,
    /// Distance of the tool from the axis, m; nothing for a slide.
    pub radius_m: Option<f64>,
}

/// The criterion of either kind.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub struct JointBic {
    /// Of a revolute joint.
    pub revolute: Option<f64>,
    /// Of a prismatic joint.
    pub prismatic: Option<f64>,
}

/// The paper's model.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Base {
    /// Inertia, Coulomb and viscous friction.
    pub terms: Vec<Term>,
    /// Root mean square residual.
    pub rms: Option<f64>,
    /// Residual over effort.
    pub relative_error: Option<f64>,
    /// Error on strokes left out of the fit.
    pub held_out_rms: Option<f64>,
}

/// The full model.
#[derive(Clone, Debug, Serialize)]
pub struct Final {
    /// Parameters.
    pub terms: Vec<Term>,
    /// Root mean square residual.
    pub rms: Option<f64>,
    /// Residual over effort.
    pub relative_error: Option<f64>,
    /// Error on strokes left out of the fit; smoothing was chosen by it.
    pub held_out_rms: Option<f64>,
    /// Errors on the confirming files.
    pub confirm_relative_error: Vec<f64>,
    /// Share of each confirming file at places and speeds that the first one has probed, too.
    pub confirm_share: Vec<f64>,
    /// What a complete model would leave.
    pub noise_floor_rms: Option<f64>,
    /// Share of the effort (amplitudes) that is neither named nor noise.
    pub unexplained_fraction: Option<f64>,
    /// How what the named effects leave comes in bursts, where it does: something acts at times, or the sensors' noise is not normal.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub bursts: Option<Bursts>,
    /// The verdict.
    pub verdict: Verdict,
    /// Condition of the parametric regressor.
    pub condition: Option<f64>,
    /// Its rank.
    pub rank: Option<usize>,
    /// Against what the residual of the named model stands.
    pub structure: Vec<Structure>,
    /// The model of I, mu, b and the named effects alone, without the mechanism: the verdict is about it. Nothing where nobody looked for effects.
    pub named: Option<NamedModel>,
}

/// The mechanism residual in numbers.
#[derive(Clone, Debug, Serialize)]
pub struct MechanismSummary {
    kind: &'static str,
    /// Error of the model with it on strokes left out.
    pub held_out_rms: f64,
    /// Where it was probed.
    pub domain: Domain,
    /// Smallest and largest load over the domain, N m or N.
    pub load_range: [f64; 2],
    /// Whether it holds the named effects too that depend on coordinate and velocity alone, but a friction of one way: in the shapes found they leave more.
    pub holds_named: bool,
}

impl MechanismSummary {
    /// What it holds, for sentences about it where effects are named.
    pub(crate) fn beside(&self) -> &'static str {
        if self.holds_named {
            "; the named effects of position and speed, but a friction of one way, are part of it, as it foretells better than the shapes found for them"
        } else {
            ", besides the named effects"
        }
    }
}

impl Joint {
    /// The joint of a recording or a track, with the sense of `axis`.
    #[must_use]
    pub fn of_poses(
        axis: &ScrewAxis,
        joint: &RefinedJoint,
        candidates: &Candidates,
        q_range: [f64; 2],
    ) -> Self {
        let revolute = axis.kind == JointKind::Revolute;
        Self {
            kind: axis.kind,
            axis_direction: Some(axis.direction.into_inner().into()),
            axis_point: Some(axis.point.coords.into()),
            std: JointStd {
                direction_deg: Some(joint.direction_std.to_degrees()),
                position_m: revolute.then_some(joint.position_std),
                radius_m: revolute.then_some(joint.radius_std),
            },
            q_range,
            position_rms_m: Some(joint.position_rms),
            bic: JointBic {
                revolute: Some(candidates.bic_revolute),
                prismatic: Some(candidates.bic_prismatic),
            },
            radius_m: revolute.then(|| axis.distance(&joint.tool_position)),
            uses_orientation: Some(joint.uses_rotations),
        }
    }

    /// The joint of a table, whose axis nobody knows.
    #[must_use]
    pub fn of_table(kind: JointKind, q_range: [f64; 2]) -> Self {
        Self {
            kind,
            axis_direction: None,
            axis_point: None,
            std: JointStd::default(),
            q_range,
            position_rms_m: None,
            bic: JointBic::default(),
            radius_m: None,
            uses_orientation: None,
        }
    }
}

impl Report {
    /// A report on a joint whose dynamics are not known yet.
    #[must_use]
    pub fn new(input: Input, joint: Joint) -> Self {
        let notes = input.gap_note().into_iter().collect();
        Self {
            schema: SCHEMA,
            base: Base {
                terms: unknown_terms(joint.kind),
                ..Base::default()
            },
            last: Final {
                terms: unknown_terms(joint.kind),
                rms: None,
                relative_error: None,
                held_out_rms: None,
                confirm_relative_error: Vec::new(),
                confirm_share: Vec::new(),
                noise_floor_rms: None,
                unexplained_fraction: None,
                bursts: None,
                verdict: Verdict::NotIdentifiable,
                condition: None,
                rank: None,
                structure: Vec::new(),
                named: None,
            },
            input,
            joint,
            effects: Vec::new(),
            refused: Vec::new(),
            mechanism: None,
            not_identified: BTreeMap::new(),
            notes,
            payload: None,
            lag: None,
            nonwork: None,
            joint_fit: None,
            paper: None,
        }
    }

    /// Adds the dynamics.
    #[must_use]
    pub fn with_dynamics(mut self, analysis: &Analysis) -> Self {
        self.input.samples_used = analysis.used;
        self.input.samples_gated = analysis
            .gated
            .iter()
            .map(|(gate, count)| ((*gate).to_owned(), *count))
            .collect();
        let base = &analysis.base;
        self.base = Base {
            terms: base.terms.clone(),
            rms: Some(base.rms),
            relative_error: Some(base.relative_error),
            held_out_rms: Some(base.held_out_rms),
        };
        let full = &analysis.full;
        self.last = Final {
            terms: full.terms.clone(),
            rms: Some(full.rms),
            relative_error: Some(full.relative_error),
            held_out_rms: Some(full.held_out_rms),
            confirm_relative_error: analysis
                .confirmed
                .iter()
                .map(|c| c.relative_error)
                .collect(),
            confirm_share: analysis.confirmed.iter().map(|c| c.share).collect(),
            noise_floor_rms: Some(analysis.floor.rms),
            unexplained_fraction: Some(analysis.unexplained_fraction),
            bursts: analysis.bursts.clone(),
            verdict: analysis.verdict,
            condition: Some(full.condition),
            rank: Some(full.rank),
            structure: analysis.structure.clone(),
            named: analysis.diagnosis.as_ref().map(|diagnosis| NamedModel {
                terms: effects::known_beside(&analysis.named.terms, &full.terms),
                rms: analysis.named.rms,
                relative_error: analysis.named.relative_error,
                held_out_rms: analysis.named.held_out_rms,
                // A table has no tool.
                aliases: if diagnosis.is_table {
                    Vec::new()
                } else {
                    effects::ALIASES.to_vec()
                },
            }),
        };
        (self.effects, self.refused) = effects::entries(analysis);
        for effect in &self.effects {
            if let (Some(size), Some(kind)) = (summary::undecided(effect), kind(effect.name)) {
                // No search named it: see `add_stiction`.
                let by_rests = kind.is(&STRIBECK) && effect.p_value == 0.0;
                let so = if by_rests {
                    " while it slides: what it takes to leave rest shows that it is there"
                } else {
                    ": with another shape, or beside the others, something else may be in its place"
                };
                self.notes.push(format!(
                    "the size of {} is not told from nothing ({size}){so}; what would tell: {}",
                    effect.name, kind.separate
                ));
            }
        }
        self.input.confirm = analysis.confirmed.iter().map(|c| c.file.clone()).collect();
        for other in &analysis.confirmed {
            let own = analysis.named.value("inertia");
            if let (Some(own), Some(there)) = (own, other.other_inertia) {
                self.notes.push(format!(
                    "{} shows an inertia of {there:.3} and not {own:.3}: is it another object, or another load? It cannot confirm much",
                    other.file
                ));
            }
        }
        for other in &analysis.confirmed {
            let [here, there] = [analysis.named.relative_error, other.relative_error];
            if other.other_inertia.is_none() && there > ELSEWHERE * here.max(SMALL) {
                self.notes.push(format!(
                    "the named effects leave {:.0} % of the effort on {} and {:.0} % here: is it another object, or was something changed? What was turned down for \
                     it may be right here, and what it confirmed may not",
                    100.0 * there, other.file, 100.0 * here
                ));
            }
        }
        for other in analysis.confirmed.iter().filter(|c| c.share < 1.0) {
            let (file, share) = (&other.file, 100.0 * other.share);
            self.notes.push(if other.is_over_all() {
                format!("only {share:.1} % of {file} is at places and speeds that this recording has probed: its errors are over all of it, and it may refuse what was right here")
            } else {
                format!("errors on {file} are over the {share:.1} % of it at places and speeds that this recording has probed, too")
            });
        }
        let left = analysis.named.held_out_rms / analysis.floor.rms;
        let unconfirmed = self
            .refused
            .iter()
            .filter(|r| r.reason.starts_with(UNCONFIRMED));
        let mut unconfirmed: Vec<&str> = unconfirmed.map(|refused| refused.name).collect();
        unconfirmed.dedup();
        if !unconfirmed.is_empty() && left > TENTATIVE {
            self.notes.push(format!(
                "without {}, not confirmed elsewhere, {left:.0} noise floors are left here: is {} of another object, or was something changed?",
                unconfirmed.join(", "),
                self.input.confirm.join(" or ")
            ));
        }
        if self.last.verdict == Verdict::Unexplained && !self.effects.is_empty() && left > TENTATIVE
        {
            self.notes.push(format!(
                "the named effects leave {left:.1} noise floors: beside so much that has no name, a name may be a part of something else"
            ));
        }
        let left = self.last.held_out_rms.unwrap_or(0.0) / analysis.floor.rms;
        if left > TENTATIVE {
            self.notes.push(format!(
                "even with a mechanism of no name {left:.1} noise floors are left on held-out strokes: inertia and friction may be off by more than their ±; probe longer, every place at many speeds"
            ));
        }
        if analysis.cutoff_lowered {
            let hz = analysis.settings.cutoff_hz;
            self.notes.push(format!(
                "the motion is so slow that the poses' noise would hide its acceleration: it was smoothed to {hz:.1} Hz; move faster for a better inertia"
            ));
        }
        if analysis.settings.turns_left_out {
            self.notes.push(
                "effects were looked for without the instants at which the joint turns: where it leaves rest with a jerk no friction that slides says what happens there"
                    .to_owned(),
            );
        }
        if let Some(bursts) = &self.last.bursts {
            self.notes.push(summary::bursts(bursts, self.joint.kind));
        }
        let motion = analysis.diagnosis.as_ref().map(|one| &one.motion);
        let shows_time = motion.is_none_or(Motion::shows_time);
        if !shows_time {
            self.notes.push("the motion comes to the same places fewer than three times, one way: what changes with time (sensor, friction, payload) was not looked for in the effort; go there and back more often".to_owned());
        }
        let samples = analysis.diagnosis.as_ref().map(|one| &one.samples);
        if samples.is_some_and(|samples| samples.aside.floor_at_most.is_some()) {
            self.notes.push("the position's noise cannot be told from its motion at this sample rate: the noise floor is taken as what the most flexible model leaves".to_owned());
        }
        let (floor, unit) = (analysis.floor.rms, self.joint.kind.effort_unit());
        if shows_time && full.bias_drift > floor {
            self.notes.push(format!(
                "the sensor's bias goes by {} {unit} in the recording, where the noise floor is {} {unit}: it was fitted beside the rest and is not in the twin",
                figure(full.bias_drift),
                figure(floor)
            ));
        }
        let far = analysis
            .lag
            .filter(|lag| lag.applied && lag.value_s.abs() > USUAL_S);
        if let Some(lag) = far {
            let how = if self.input.grasp.is_some() {
                let files = self.input.files.join(" ");
                format!(" (ft-capture calibrate {files} --align -o ALIGNED.mcap)")
            } else {
                String::new()
            };
            self.notes.push(format!(
                "the effort is {:.0} ms late: effects were looked for before that was taken out. Align the streams{how} and identify that",
                1e3 * lag.value_s,
            ));
        }
        self.mechanism = summary_of(full, analysis.left_to_mechanism);
        self.not_identified.extend(full.not_identified.clone());
        self.lag = analysis.lag;
        self.joint_fit.clone_from(&analysis.jointly);
        self
    }

    /// The report with the paper's estimates beside ours.
    #[must_use]
    pub fn with_paper(mut self, fit: &PaperFit) -> Self {
        let terms = fit.terms.iter().cloned();
        self.paper = Some(PaperEstimate {
            terms: terms.map(|term| Term { std: None, ..term }).collect(),
            rms: fit.rms,
            mechanism: "mlp",
            mechanism_rms: fit.mechanism_rms,
            epochs: fit.mechanism.as_ref().map(|mechanism| mechanism.epochs),
        });
        self
    }

    /// The report as JSON, indented.
    ///
    /// # Errors
    /// Never for values of this type; the serializer's own error type is kept.
    pub fn to_json(&self) -> Result<String, serde_json::Error> {
        serde_json::to_string_pretty(self)
    }

    /// A term of the full model.
    #[must_use]
    pub fn term(&self, name: &str) -> Option<&Term> {
        self.last.terms.iter().find(|term| term.name == name)
    }
}

fn unknown_terms(kind: JointKind) -> Vec<Term> {
    [
        ("inertia", kind.inertia_unit()),
        ("coulomb", kind.effort_unit()),
        ("viscous", kind.viscous_unit()),
    ]
    .map(|(name, unit)| Term {
        name: name.to_owned(),
        value: None,
        std: None,
        unit: unit.to_owned(),
    })
    .to_vec()
}

fn summary_of(model: &EffortModel, holds_named: bool) -> Option<MechanismSummary> {
    let mechanism = model.mechanism.as_ref()?;
    let [low, high] = mechanism.domain.q;
    let loads: Vec<f64> = (0..=100)
        .map(|i| mechanism.load(low + (high - low) * f64::from(i) / 100.0))
        .collect();
    let (least, most) = crate::samples::extrema(&loads);
    Some(MechanismSummary {
        kind: mechanism.kind(),
        held_out_rms: model.held_out_rms,
        domain: mechanism.domain.clone(),
        load_range: [least, most],
        holds_named,
    })
}
