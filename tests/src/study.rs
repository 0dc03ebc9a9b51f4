//! The study's objects, and its tables and plots. Everything here is simulation but the columns that say "published".

mod objects;
mod plot;

pub use objects::{objects, picked};
pub use plot::inertia_plot;

use crate::truth::Comparison;

/// Quantiles and means of what a study found.
#[derive(Clone, Debug, Default)]
pub struct Spread(Vec<f64>);

impl Spread {
    /// Of the finite ones among `values`.
    #[must_use]
    pub fn of(values: impl IntoIterator<Item = f64>) -> Self {
        let mut values: Vec<f64> = values.into_iter().filter(|v| v.is_finite()).collect();
        values.sort_by(f64::total_cmp);
        Self(values)
    }

    /// Median; NaN when there is none.
    #[must_use]
    pub fn median(&self) -> f64 {
        let (count, half) = (self.0.len(), self.0.len() / 2);
        match count % 2 {
            _ if count == 0 => f64::NAN,
            0 => 0.5 * (self.0[half - 1] + self.0[half]),
            _ => self.0[half],
        }
    }

    /// Mean.
    #[must_use]
    pub fn mean(&self) -> f64 {
        self.0.iter().sum::<f64>() / self.0.len() as f64
    }

    /// Standard deviation.
    #[must_use]
    pub fn deviation(&self) -> f64 {
        let mean = self.mean();
        let squares: f64 = self.0.iter().map(|v| (v - mean).powi(2)).sum();
        (squares / (self.0.len() as f64 - 1.0).max(1.0)).sqrt()
    }

    /// Largest.
    #[must_use]
    pub fn most(&self) -> f64 {
        self.0.last().copied().unwrap_or(f64::NAN)
    }

    /// How many there are.
    #[must_use]
    pub fn count(&self) -> usize {
        self.0.len()
    }
}

/// The report of a study as Markdown: the paper's axis table and inertia figure beside ours, by object, and the coverage of the
/// stated intervals.
#[must_use]
pub fn markdown(results: &[Comparison], names: &[&str]) -> String {
    let mut out = String::from(
        "# Study\n\nPublished: Engelbracht et al., *ForceTwin*, real objects. Everything else here is simulated; nothing was measured.\n\n",
    );
    out += "| figure | published, theirs | simulated, `paper` | simulated, ours | simulated, joint fit |\n|---|---|---|---|---|\n";
    let all = |f: fn(&Comparison) -> f64| Spread::of(results.iter().map(f));
    let inertia = |f: fn(&Comparison) -> Option<f64>| {
        Spread::of(results.iter().filter_map(f).map(|v| 100.0 * v.abs()))
    };
    let right = results.iter().filter(|one| one.kind_is_right).count();
    out += &format!(
        "| type accuracy | 100 % | - | {right} of {} | - |\n",
        results.len()
    );
    let (deg, mm) = (all(|one| one.axis_deg), all(|one| one.axis_mm));
    out += &format!(
        "| axis direction, deg | 1.4 (slides), 1.5 (hinges), mean | - | {:.3} median, {:.3} worst | - |\n| axis position, mm | 23, mean | - | {:.2} median, {:.2} worst | - |\n",
        deg.median(),
        deg.most(),
        mm.median(),
        mm.most()
    );
    let (theirs, ours) = (inertia(|one| one.paper[0]), inertia(|one| one.relative[0]));
    let joint = inertia(|one| one.joint_relative[0]);
    out += &format!(
        "| inertia, mean error, % | 29.5 (a visual prior: 53.0) | {:.1} | {:.2} | {:.2} |\n| inertia, worst, % | 63.8 | {:.1} | {:.2} | {:.2} |\n",
        theirs.mean(),
        ours.mean(),
        joint.mean(),
        theirs.most(),
        ours.most(),
        joint.most()
    );
    let signed = |f: fn(&Comparison) -> Option<f64>| {
        Spread::of(results.iter().filter_map(f).map(|v| 100.0 * v)).mean()
    };
    out += &format!(
        "| inertia, signed mean error, % | positive on all four | {:+.1} | {:+.2} | {:+.2} |\n\n",
        signed(|one| one.paper[0]),
        signed(|one| one.relative[0]),
        signed(|one| one.joint_relative[0])
    );
    out += &objects_table(results, names);
    out += "\n95 % intervals that hold the truth, of those that were given (simulated):\n\n| parameter | given | hold | share |\n|---|---|---|---|\n";
    let names = ["inertia", "coulomb", "viscous"];
    let of_joint = names.map(|name| format!("{name}, joint fit"));
    let rows = names
        .iter()
        .copied()
        .chain(of_joint.iter().map(String::as_str));
    for (k, name) in rows.enumerate() {
        let j = k % names.len();
        let sigmas = |one: &Comparison| {
            if k < names.len() {
                one.sigmas[j]
            } else {
                one.joint_sigmas[j]
            }
        };
        let given: Vec<f64> = results.iter().filter_map(sigmas).collect();
        let hold = given.iter().filter(|s| s.abs() < 1.96).count();
        out += &format!(
            "| {name} | {} of {} | {hold} | {:.1} % |\n",
            given.len(),
            results.len(),
            100.0 * hold as f64 / given.len() as f64
        );
    }
    out
}

fn objects_table(results: &[Comparison], names: &[&str]) -> String {
    let mut out = String::from(
        "By object (simulated): mean absolute errors, % (how many of the seeds had the parameter withdrawn); held-out error of the \
         full model and of the joint fit over what the true parameters leave of the effort along the differentiated motion; share of the base model's held-out error that effects and mechanism take away.\n\n\
         | object | I | I `paper` | I ours | I joint | mu `paper` | mu ours | mu joint | b `paper` | b ours | b joint | held-out / floor, median, worst | joint fit's | reduction |\n\
         |---|---|---|---|---|---|---|---|---|---|---|---|---|---|\n",
    );
    for name in names {
        let of: Vec<&Comparison> = results.iter().filter(|one| one.scenario == *name).collect();
        let Some(first) = of.first() else { continue };
        let error = |f: &dyn Fn(&Comparison) -> Option<f64>| {
            let errors = Spread::of(of.iter().filter_map(|one| f(one)).map(|v| 100.0 * v.abs()));
            match of.len() - errors.count() {
                0 => format!("{:.1}", errors.mean()),
                null if errors.count() == 0 => format!("({null})"),
                null => format!("{:.1} ({null})", errors.mean()),
            }
        };
        let floor = Spread::of(of.iter().map(|one| one.held_out / one.floor_true));
        let joint = Spread::of(of.iter().map(|one| one.joint_held_out / one.floor_true));
        let reduction = Spread::of(of.iter().map(|one| 100.0 * one.reduction));
        out += &format!(
            "| {name} | {} | {} | {} | {} | {} | {} | {} | {} | {} | {} | {:.2}, {:.2} | {:.2}, {:.2} | {:.0} % |\n",
            first.inertia,
            error(&|one| one.paper[0]),
            error(&|one| one.relative[0]),
            error(&|one| one.joint_relative[0]),
            error(&|one| one.paper[1]),
            error(&|one| one.relative[1]),
            error(&|one| one.joint_relative[1]),
            error(&|one| one.paper[2]),
            error(&|one| one.relative[2]),
            error(&|one| one.joint_relative[2]),
            floor.median(),
            floor.most(),
            joint.median(),
            joint.most(),
            reduction.median()
        );
    }
    out
}
