//! What is done with a twin: let it go, export it, compare several.

use std::path::{Path, PathBuf};

use clap::{Args, ValueEnum};
use ft_identify::export::{self, export};
use ft_identify::output::{refuse_existing, replace};
use ft_identify::screw::JointKind;
use ft_identify::simulate::{
    Opening, Release, demand, page, refuse_outside, release, said, shortest,
};
use ft_identify::twin::Twin;

use crate::UseError;

/// `ft-identify simulate`.
#[derive(Args)]
#[command(after_help = "\
Examples:
  ft-identify simulate twin/twin.json --release 45deg
  ft-identify simulate twin/twin.json --release 0.3m --until 0m -o swing
  ft-identify simulate twin/twin.json --open 70deg --within 6 --limit 60     can a robot that pulls 60 N at the handle open it?")]
pub(crate) struct Simulate {
    /// twin.json
    twin: PathBuf,
    /// Where it is let go, at rest: 45deg, 0.8rad, 0.3m, 300mm; in the twin's coordinate
    #[arg(
        long,
        value_name = "PLACE",
        allow_hyphen_values = true,
        required_unless_present = "open"
    )]
    release: Option<String>,
    /// Where it has arrived; by default the lower end of the probed range
    #[arg(long, value_name = "PLACE", allow_hyphen_values = true)]
    until: Option<String>,
    /// Longest time to simulate, s
    #[arg(long, value_name = "SECONDS", default_value = "30", value_parser = positive)]
    longest: f64,
    /// Instead: what it takes to move it from the lower end of the range to here
    #[arg(long, value_name = "PLACE", allow_hyphen_values = true, conflicts_with_all = ["release", "until", "longest", "output"])]
    open: Option<String>,
    // clap asks for no `open` where `release` is, which excludes it.
    /// Time of the opening, s
    #[arg(long, value_name = "SECONDS", default_value = "6", value_parser = positive, requires = "open", conflicts_with = "release")]
    within: f64,
    /// Force that a robot has at the handle, N
    #[arg(long, value_name = "N", value_parser = positive, requires = "open", conflicts_with = "release")]
    limit: Option<f64>,
    /// Directory for swing.json and swing.html (plots and an animation)
    #[arg(short, long, value_name = "DIR")]
    output: Option<PathBuf>,
    /// Replace the files of an earlier run
    #[arg(long)]
    force: bool,
    /// Print JSON instead of a sentence
    #[arg(long)]
    json: bool,
}

/// `ft-identify export`.
#[derive(Args)]
#[command(after_help = "\
Examples:
  ft-identify export twin/twin.json --to mjcf -o mujoco
  ft-identify export twin/twin.json --to usd,urdf,onnx --name fridge -o assets")]
pub(crate) struct Export {
    /// twin.json
    twin: PathBuf,
    /// Formats
    #[arg(
        long,
        value_name = "FORMAT",
        value_enum,
        required = true,
        value_delimiter = ','
    )]
    to: Vec<Format>,
    /// Directory for the files
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
    /// Name of the body and of the files: a letter, then letters, digits and _
    #[arg(long, value_name = "NAME", default_value = "object", value_parser = identifier)]
    name: String,
    /// Replace the files of an earlier export
    #[arg(long)]
    force: bool,
}

/// `ft-identify compare`.
#[derive(Args)]
#[command(after_help = "\
Examples:
  ft-identify compare monday/twin.json friday/twin.json")]
pub(crate) struct Compare {
    /// Two or more twin.json of one kind of joint; the first is what the others are compared with
    #[arg(required = true, num_args = 2..)]
    twins: Vec<PathBuf>,
    /// Print JSON instead of a table
    #[arg(long)]
    json: bool,
}

#[derive(Clone, Copy, ValueEnum)]
enum Format {
    Mjcf,
    Urdf,
    Usd,
    Onnx,
}

impl Simulate {
    pub(crate) fn run(&self) -> Result<(), UseError> {
        if let Some(directory) = &self.output {
            refuse_existing(directory, &["swing.json", "swing.html"], self.force)?;
        }
        let twin = read(&self.twin)?;
        let kind = twin.joint.kind;
        let Some(release_at) = &self.release else {
            return self.open(&twin);
        };
        let until = match &self.until {
            Some(text) => place(text, kind)?,
            None => twin.joint.q_range[0],
        };
        let how = Release {
            from: place(release_at, kind)?,
            until,
            step: 1e-4,
            longest: self.longest,
        };
        let swing = release(&twin.evaluator(), twin.joint.q_range, &how)?;
        tell_left_out(&twin);
        let document = serde_json::json!({
            "schema": "ft-identify/swing/1", "kind": kind, "from": how.from, "until": how.until, "end": swing.end,
            "beyond_probed_speed": swing.beyond_probed_speed, "time": swing.time, "q": swing.q, "dq": swing.dq,
        });
        if self.json {
            println!("{document:#}");
        } else {
            let (scale, unit) = shown(kind);
            println!("{}", said(&swing, scale, unit));
        }
        if let Some(directory) = &self.output {
            let name = self.twin.display().to_string();
            write(&directory.join("swing.json"), &format!("{document:#}\n"))?;
            write(&directory.join("swing.html"), &page(&name, kind, &swing))?;
            eprintln!("wrote {}", directory.join("swing.html").display());
        }
        Ok(())
    }
}

impl Simulate {
    fn open(&self, twin: &Twin) -> Result<(), UseError> {
        let kind = twin.joint.kind;
        let opening = Opening {
            from: twin.joint.q_range[0],
            to: place(self.open.as_deref().unwrap_or_default(), kind)?,
            duration: self.within,
        };
        let evaluator = twin.evaluator();
        refuse_outside(&evaluator, twin.joint.q_range, opening.to)?;
        let needed = demand(&evaluator, &opening);
        tell_left_out(twin);
        let radius = twin.radius();
        let lever = if kind == JointKind::Revolute {
            radius
        } else {
            Some(1.0)
        };
        if self.json {
            let limit = lever.zip(self.limit).map(|(lever, limit)| lever * limit);
            println!(
                "{:#}",
                serde_json::json!({"schema": "ft-identify/opening/1", "kind": kind, "handle_radius": radius,
                    "exceeds_at": limit.and_then(|limit| needed.exceeds(limit)),
                    "enough_within_s": limit.and_then(|limit| shortest(&evaluator, &opening, limit)), "needed": needed})
            );
            return Ok(());
        }
        let effort = kind.effort_unit();
        let at_handle =
            lever
                .filter(|_| kind == JointKind::Revolute)
                .map_or(String::new(), |lever| {
                    format!(
                        " ({:.1} N at the handle, {lever:.2} m from the axis)",
                        needed.peak.abs() / lever
                    )
                });
        println!(
            "to {} within {} s takes up to {:.2} {effort} at {}{at_handle}",
            at(kind, opening.to),
            self.within,
            needed.peak,
            at(kind, needed.peak_at)
        );
        if needed.not_probed > 0.0 {
            println!(
                "{:.0} % of the time at states that were not probed",
                100.0 * needed.not_probed
            );
        }
        match (self.limit, lever) {
            (Some(limit), Some(lever)) => match needed.exceeds(limit * lever) {
                Some(q) => println!(
                    "{limit} N are not enough: more is needed from {} on; {}",
                    at(kind, q),
                    match shortest(&evaluator, &opening, limit * lever) {
                        Some(time) => format!("within {time:.1} s they are"),
                        None => "nor are they however slowly".to_owned(),
                    }
                ),
                None => println!("{limit} N are enough"),
            },
            (Some(_), None) => return Err(UseError::NoLever),
            (None, _) => {}
        }
        Ok(())
    }
}

/// Says what no evaluation has: effects with memory, and parameters that nobody knows.
fn tell_left_out(twin: &Twin) {
    for name in twin.not_identified() {
        eprintln!("not identified: `{name}` counts as 0");
    }
    for effect in twin.left_out() {
        eprintln!("left out: `{effect}`, which has a memory and is no function of q and dq");
    }
}

/// Factor and unit in which a coordinate is shown.
fn shown(kind: JointKind) -> (f64, &'static str) {
    match kind {
        JointKind::Revolute => (1.0_f64.to_degrees(), "deg"),
        JointKind::Prismatic => (1.0, "m"),
    }
}

/// A coordinate as people read it.
fn at(kind: JointKind, q: f64) -> String {
    let (scale, unit) = shown(kind);
    // No minus before what is rounded to zero.
    match kind {
        JointKind::Revolute => format!("{:.1} {unit}", (10.0 * scale * q).round() / 10.0 + 0.0),
        JointKind::Prismatic => format!("{:.3} {unit}", (1e3 * scale * q).round() / 1e3 + 0.0),
    }
}

pub(crate) fn positive(text: &str) -> Result<f64, String> {
    let number: Option<f64> = text.parse().ok();
    number
        .filter(|value| value.is_finite() && *value > 0.0)
        .ok_or_else(|| format!("{text:?} is not a number above 0"))
}

impl Export {
    pub(crate) fn run(&self) -> Result<(), UseError> {
        let twin = read(&self.twin)?;
        tell_left_out(&twin);
        let mut targets = Vec::new();
        for format in &self.to {
            let target = match format {
                Format::Mjcf => export::Target::Mjcf,
                Format::Urdf => export::Target::Urdf,
                Format::Usd => export::Target::Usd,
                Format::Onnx => export::Target::Onnx,
            };
            if !targets.contains(&target) {
                targets.push(target);
            }
        }
        for done in export(&twin, &targets, &self.output, &self.name, self.force)? {
            for file in &done.files {
                println!("{}", file.display());
            }
            if let Some(error) = done.native.and_then(|native| native.relative_error) {
                println!(
                    "  joint attributes alone: {:.1} % off the twin's effort over the probed domain; with the table: {:.2} %",
                    100.0 * error,
                    100.0 * done.table_error
                );
            } else {
                println!("  {:.2} % off the twin's effort", 100.0 * done.table_error);
            }
        }
        Ok(())
    }
}

impl Compare {
    pub(crate) fn run(&self) -> Result<(), UseError> {
        let twins: Vec<Twin> = self
            .twins
            .iter()
            .map(|path| read(path))
            .collect::<Result<_, _>>()?;
        let first = &twins[0];
        if let Some((path, other)) = self
            .twins
            .iter()
            .zip(&twins)
            .find(|(_, t)| t.joint.kind != first.joint.kind)
        {
            return Err(UseError::Kinds {
                path: path.clone(),
                kind: other.joint.kind,
                first: first.joint.kind,
            });
        }
        let rows: Vec<serde_json::Value> = self
            .twins
            .iter()
            .zip(&twins)
            .map(|(path, twin)| {
                let value = |name: &str| {
                    let at = twin.beta.names.iter().position(|n| n == name)?;
                    twin.beta.values.get(at).copied().flatten()
                };
                serde_json::json!({
                    "twin": path, "inertia": value("inertia"), "coulomb": value("coulomb"), "viscous": value("viscous"),
                    "effects": twin.effects.iter().map(|e| e.name.clone()).collect::<Vec<_>>(),
                    "effort_difference": twin.evaluator().difference(&first.evaluator()),
                })
            })
            .collect();
        if self.json {
            println!("{:#}", serde_json::Value::Array(rows));
            return Ok(());
        }
        let number = |value: &serde_json::Value| {
            value
                .as_f64()
                .map_or("null".to_owned(), |v| format!("{v:.4}"))
        };
        println!(
            "efforts are compared at equal q: each twin counts from where its own grasp began"
        );
        println!(
            "{:>10} {:>10} {:>10} {:>12}  twin, effects",
            "inertia", "coulomb", "viscous", "effort diff."
        );
        for row in &rows {
            let percent = row["effort_difference"]
                .as_f64()
                .map_or("no overlap".to_owned(), |v| format!("{:.1} %", 100.0 * v));
            println!(
                "{:>10} {:>10} {:>10} {percent:>12}  {} {}",
                number(&row["inertia"]),
                number(&row["coulomb"]),
                number(&row["viscous"]),
                row["twin"].as_str().unwrap_or_default(),
                row["effects"]
            );
        }
        Ok(())
    }
}

fn read(path: &Path) -> Result<Twin, UseError> {
    let text = std::fs::read_to_string(path).map_err(|source| UseError::Read {
        path: path.to_owned(),
        source,
    })?;
    Twin::from_json(&text).map_err(|source| UseError::Twin {
        path: path.to_owned(),
        source,
    })
}

fn write(path: &Path, text: &str) -> Result<(), UseError> {
    let put = || {
        path.parent().map_or(Ok(()), std::fs::create_dir_all)?;
        replace(path, text)
    };
    put().map_err(|source| UseError::Write {
        path: path.to_owned(),
        source,
    })
}

/// `45deg` as 0.785 rad.
fn place(text: &str, kind: JointKind) -> Result<f64, UseError> {
    let units: &[(&str, f64)] = match kind {
        JointKind::Revolute => &[("deg", core::f64::consts::PI / 180.0), ("rad", 1.0)],
        JointKind::Prismatic => &[("mm", 1e-3), ("cm", 1e-2), ("m", 1.0)],
    };
    units
        .iter()
        .find_map(|(unit, scale)| {
            Some(text.strip_suffix(unit)?.trim().parse::<f64>().ok()? * scale)
        })
        .filter(|value| value.is_finite())
        .ok_or_else(|| UseError::Place {
            text: text.to_owned(),
            kind,
            units: units
                .iter()
                .map(|(unit, _)| *unit)
                .collect::<Vec<_>>()
                .join(" or "),
        })
}

fn identifier(text: &str) -> Result<String, String> {
    let mut letters = text.chars();
    let good = letters.next().is_some_and(|c| c.is_ascii_alphabetic())
        && letters.all(|c| c.is_ascii_alphanumeric() || c == '_');
    if good {
        Ok(text.to_owned())
    } else {
        Err("a letter, then letters, digits and _".to_owned())
    }
}
