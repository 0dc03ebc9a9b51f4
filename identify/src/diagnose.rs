//! What the model lacks: finds the effect of the library that the residual asks for, adds it, and looks again.
//!
//! From the paper's model (I, mu, b) on: every effect of the library is tried beside the current model and scored by the
//! error on blocks of strokes that were held out. The best is taken when chance does not give as much (the search is
//! repeated on efforts simulated from the current model with the sensors' noise), when it moves the effort by more than the
//! noise floor allows to doubt, helps in most blocks and has a physical sign. Later effects may replace or remove earlier
//! ones. What fits nearly as well is named beside it, and what helped but was turned down is listed with the reason.

mod alike;
mod apart;
mod breakaway;
mod confirm;
mod dampers;
mod diagnosis;
mod doubt;
mod elsewhere;
mod evidence;
mod finish;
mod forms;
mod gates;
mod latch;
mod model;
mod null;
mod scan;
mod score;
mod search;
mod shapes;
mod slid;
mod spread;
mod start;
mod steps;
mod stiction;
mod tidy;
mod together;

pub(crate) use confirm::shown;
pub use confirm::{Confirmation, confirm};
pub use diagnosis::{Ambiguity, Diagnosis, NamedEffect, Refused};
pub(crate) use diagnosis::{LEAST_FLOOR, floor_of};
pub use evidence::{Evidence, evidence};
pub(crate) use forms::state_forms;
pub(crate) use gates::gives;
pub use model::Found;
pub(crate) use model::{beside_rigid, is_smooth_load, per_velocity};
pub(crate) use slid::{diagnose_rid_of_slips, others_rid_of_slips};
pub(crate) use spread::state_spread;
pub use start::{diagnose, diagnose_without};
pub(crate) use steps::Steps;
pub(crate) use stiction::{Stiction, add_stiction};
pub(crate) use together::take_from_both;
