//! Sealed draws: an object, a person and undeclared effects, drawn from a seed, to judge an identification that has not seen
//! them.
//!
//! A draw is a pair of scenarios, `main` and `confirm`: the same object with the same effects, another person on another
//! day. The truth stands apart from both.

mod effect;
mod object;
mod probe;

use std::path::{Path, PathBuf};

use serde::Serialize;

pub use object::Sizes;
pub use probe::EffortMoved;

use self::probe::Probed;
use crate::random::{Random, Stream};
use crate::scenario::{EffectSpec, Scenario, ScenarioError};

/// What may be drawn.
#[derive(Clone, Debug, PartialEq)]
pub struct SealedOptions {
    /// Probability that nothing is undeclared.
    pub none: f64,
    /// Probability of two effects of the report's vocabulary.
    pub two: f64,
    /// Probability of one effect that the vocabulary has no name for.
    pub outside: f64,
    /// Whether objects keep their closers, catches and counterbalances.
    pub mechanisms: Mechanisms,
    /// Draws one of these and nothing else; empty leaves the choice to the seed.
    pub only: Vec<String>,
}

impl Default for SealedOptions {
    fn default() -> Self {
        Self {
            none: 0.15,
            two: 0.2,
            outside: 0.12,
            mechanisms: Mechanisms::Kept,
            only: Vec::new(),
        }
    }
}

/// What becomes of the objects' own mechanisms.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Mechanisms {
    /// They stay, varied in size.
    Kept,
    /// Nothing but inertia and friction is left.
    Dropped,
}

/// A drawn pair with its truth.
#[derive(Clone, Debug)]
pub struct SealedDraw {
    /// To be recorded and identified.
    pub main: Scenario,
    /// To be recorded for confirmation.
    pub confirm: Scenario,
    /// For the judge.
    pub truth: SealedTruth,
}

/// What a draw is judged against.
#[derive(Clone, Debug, Serialize)]
pub struct SealedTruth {
    /// `"ft-sim-hw/sealed/1"`.
    pub schema: &'static str,
    /// The draw's seed.
    pub seed: u64,
    /// The built-in scenario that the object began as.
    pub object: String,
    /// How much of the built-in's each size is.
    pub sizes: Sizes,
    /// Whether objects kept their mechanisms.
    pub mechanisms: Mechanisms,
    /// Names in the report's vocabulary for what the object's own mechanisms and weight do: beyond inertia and friction,
    /// and no false effects when they are named.
    pub mechanism_effects: Vec<&'static str>,
    /// The undeclared effects.
    pub effects: Vec<SealedEffect>,
    /// All of them together.
    pub together: Moved,
}

/// A drawn effect.
#[derive(Clone, Debug, Serialize)]
pub struct SealedEffect {
    /// Its name.
    pub name: &'static str,
    /// Whether the report's vocabulary has that name.
    pub in_vocabulary: bool,
    /// Its parameters.
    pub parameters: EffectSpec,
    /// What it does to the effort when it is there alone.
    pub alone: Moved,
}

/// How far the effort is moved, in both recordings, at seed 1.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Moved {
    /// In the recording of `main`.
    pub main: EffortMoved,
    /// In the recording of `confirm`.
    pub confirm: EffortMoved,
}

/// Why there is no draw.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SealedError {
    /// No effect has that name.
    #[error("there is no effect {name:?}: give one of {known}")]
    UnknownEffect {
        /// What was asked for.
        name: String,
        /// What there is.
        known: String,
    },
    /// Nothing that a person could probe was drawn.
    #[error(
        "seed {seed} gave no object that can be probed in {attempts} attempts: take another seed"
    )]
    NoObject {
        /// The seed.
        seed: u64,
        /// How many were tried.
        attempts: u32,
    },
    /// A scenario that cannot be written.
    #[error(transparent)]
    Scenario(#[from] ScenarioError),
    /// The truth is no JSON.
    #[error("the truth cannot be written as JSON: {0}")]
    Json(#[from] serde_json::Error),
    /// A file or folder cannot be written.
    #[error("cannot write {}: {source}{}", path.display(), if source.kind() == std::io::ErrorKind::AlreadyExists {
        "; choose another folder with -o"
    } else {
        ""
    })]
    Write {
        /// Which.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
}

const ROUNDS: u32 = 6;
const ATTEMPTS_PER_ROUND: u32 = 60;
/// The seed at which a draw is tried out.
const TRIAL_SEED: u64 = 1;

impl SealedDraw {
    /// Draws object, effects and sizes from `seed`.
    ///
    /// Objects that cannot be probed (they open by themselves, or the hand does not get them open) are drawn again; the
    /// kinds of effect stay, unless no object has two of them.
    ///
    /// # Errors
    /// `options.only` has an unknown name, or nothing that can be probed was drawn.
    pub fn draw(seed: u64, options: &SealedOptions) -> Result<Self, SealedError> {
        let mut random = Random::new(seed, Stream::Sealed);
        for _ in 0..ROUNDS {
            let names = effect::names(options, &mut random)?;
            for _ in 0..ATTEMPTS_PER_ROUND {
                if let Some(draw) = Self::attempt(seed, options, &names, &mut random) {
                    return Ok(draw);
                }
            }
        }
        Err(SealedError::NoObject {
            seed,
            attempts: ROUNDS * ATTEMPTS_PER_ROUND,
        })
    }

    fn attempt(
        seed: u64,
        options: &SealedOptions,
        names: &[&'static str],
        random: &mut Random,
    ) -> Option<Self> {
        let (built_in, sizes, mut main) = object::draw(options.mechanisms, random)?;
        let mechanism_effects = object::mechanism_effects(&main);
        let undeclared: Option<Vec<_>> = names
            .iter()
            .map(|name| {
                let new = !mechanism_effects.contains(name);
                new.then(|| effect::draw(name, &main, random)).flatten()
            })
            .collect();
        main.undeclared = undeclared?;
        main.name = format!("sealed_{seed}_main");
        main.description = format!("Sealed draw {seed}, to be identified.");
        let mut confirm = main.clone();
        confirm.name = format!("sealed_{seed}_confirm");
        confirm.description = format!("Sealed draw {seed}, to confirm.");
        for scenario in [&mut main, &mut confirm] {
            object::vary_person(scenario, random);
            // What the files will say, to the last digit.
            *scenario = Scenario::from_toml(&scenario.to_toml().ok()?).ok()?;
        }
        let sound = |scenario: &Scenario| {
            let probed = Probed::of(scenario, TRIAL_SEED).ok();
            probed.filter(Probed::is_sound)
        };
        let (in_main, in_confirm) = (sound(&main)?, sound(&confirm)?);
        let together = Moved {
            main: in_main.moved,
            confirm: in_confirm.moved,
        };
        let effects: Option<Vec<_>> = main
            .undeclared
            .iter()
            .map(|spec| sealed_effect(spec, &main, &confirm, together))
            .collect();
        let truth = SealedTruth {
            schema: "ft-sim-hw/sealed/1",
            seed,
            object: built_in,
            sizes,
            mechanisms: options.mechanisms,
            mechanism_effects,
            effects: effects?,
            together,
        };
        Some(Self {
            main,
            confirm,
            truth,
        })
    }

    /// Writes `main.toml`, `confirm.toml` and `truth.json` into `folder`, which is made when it is not there.
    ///
    /// # Errors
    /// One of them exists already, or cannot be written.
    pub fn write(&self, folder: &Path) -> Result<(), SealedError> {
        let refused = |path: &Path, source| SealedError::Write {
            path: path.to_owned(),
            source,
        };
        std::fs::create_dir_all(folder).map_err(|source| refused(folder, source))?;
        let files = [
            ("main.toml", self.main.to_toml()?),
            ("confirm.toml", self.confirm.to_toml()?),
            ("truth.json", serde_json::to_string_pretty(&self.truth)?),
        ];
        for (name, text) in files {
            let path = folder.join(name);
            std::fs::File::create_new(&path)
                .and_then(|mut file| {
                    let written = std::io::Write::write_all(&mut file, text.as_bytes());
                    // A full disk leaves no half of one.
                    written.inspect_err(|_| {
                        let _ = std::fs::remove_file(&path);
                    })
                })
                .map_err(|source| refused(&path, source))?;
        }
        Ok(())
    }
}

fn sealed_effect(
    spec: &EffectSpec,
    main: &Scenario,
    confirm: &Scenario,
    together: Moved,
) -> Option<SealedEffect> {
    let alone = if main.undeclared.len() == 1 {
        together
    } else {
        let moved = |scenario: &Scenario| {
            let mut scenario = scenario.clone();
            scenario.undeclared = vec![spec.clone()];
            Probed::of(&scenario, TRIAL_SEED).map(|probed| probed.moved)
        };
        Moved {
            main: moved(main).ok()?,
            confirm: moved(confirm).ok()?,
        }
    };
    Some(SealedEffect {
        name: spec.name(),
        in_vocabulary: spec.is_in_vocabulary(),
        parameters: spec.clone(),
        alone,
    })
}
