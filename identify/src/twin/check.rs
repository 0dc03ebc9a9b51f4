//! What evaluation and export rely on in a twin that comes from a file.

use serde_json::Value;

use super::pieces::{LOAD, OVER_Q, OVER_SPEED};
use super::{Spline, SurfaceSpline, Twin, TwinError};
use crate::effect::library::{Search, form, kind};

/// No number of a twin, in SI units, is beyond this.
const LARGEST: f64 = 1e9;
/// No spline has more pieces.
const MOST_PIECES: usize = 10_000;

/// Refuses numbers that no door has, before anything is computed with them.
pub(super) fn size(value: &Value) -> Result<(), TwinError> {
    match value {
        Value::Number(number) if number.as_f64().is_none_or(|v| v.abs() > LARGEST) => {
            Err(TwinError::Large {
                number: number.to_string(),
            })
        }
        Value::Array(values) => values.iter().try_for_each(size),
        Value::Object(fields) => fields.values().try_for_each(size),
        _ => Ok(()),
    }
}

/// Refuses what does not fit together, and effects that this program does not know.
pub(super) fn content(twin: &Twin) -> Result<(), TwinError> {
    let wrong = |what: &'static str| Err(TwinError::Content { what });
    if twin.beta.names.len() != twin.beta.values.len() {
        return wrong("beta has not one value per name");
    }
    let joint = twin.joint.kind;
    for (name, unit) in [
        ("inertia", joint.inertia_unit()),
        ("coulomb", joint.effort_unit()),
        ("viscous", joint.viscous_unit()),
    ] {
        let mut named = twin.beta.names.iter().zip(&twin.beta.units);
        if named.any(|(own, stated)| own == name && stated != unit) {
            return wrong("beta is in other units than the SI units of its kind of joint");
        }
    }
    let mut values = twin.beta.names.iter().zip(&twin.beta.values);
    if values.any(|(name, value)| name == "inertia" && value.is_some_and(|v| v < 0.0)) {
        return wrong("its inertia is below 0");
    }
    if !(proper(twin.domain.q) && proper(twin.domain.dq) && proper(twin.joint.q_range)) {
        return wrong("domain or q_range is no interval");
    }
    if twin.joint.coordinate.sign.abs() != 1.0 {
        return wrong("the sign of the coordinate is not 1 or -1");
    }
    let direction = twin.joint.axis_direction.unwrap_or([0.0, 0.0, 1.0]);
    if (direction.iter().map(|v| v * v).sum::<f64>() - 1.0).abs() > 1e-3 {
        return wrong("axis_direction is no unit vector");
    }
    for effect in &twin.effects {
        let Some(kind) = kind(&effect.name) else {
            return Err(TwinError::Effect {
                name: effect.name.clone(),
            });
        };
        // What is no function of the state is not evaluated, whatever its shape was when the file was written.
        if kind.at.is_some() && form(&effect.name, effect.shape.len()).is_none() {
            return wrong("an effect has not as many shape parameters as its kind");
        }
        let relieved = form(&effect.name, effect.shape.len()).is_some_and(|kind| {
            let mut shapes = kind.shape.iter().zip(&effect.shape);
            shapes.any(|(of, number)| of.2 == Search::Below && number.value <= 0.0)
        });
        if relieved {
            return wrong("the speed at which a damper's valve opens is not above 0");
        }
    }
    let Some(mechanism) = &twin.mechanism else {
        return Ok(());
    };
    if !curve(&mechanism.load) {
        return wrong(
            "the mechanism's load has not pieces + degree coefficients over an interval, or a degree above 3",
        );
    }
    if !mechanism.damping.iter().all(surface) {
        return wrong(
            "the mechanism's damping has not (pieces + degree) coefficients over each of two intervals, or degrees above 2 and 1",
        );
    }
    let [forward, backward] = &mechanism.damping;
    if forward.interval_q != backward.interval_q
        || forward.interval_sqrt_speed != backward.interval_sqrt_speed
        || forward.pieces != backward.pieces
    {
        return wrong("the mechanism's damping is cut into other pieces forward than backward");
    }
    let ascending = |surface: &SurfaceSpline| {
        let bends = &surface.valve.bends;
        bends.windows(2).all(|pair| pair[0].at < pair[1].at)
            && bends.iter().all(|bend| bend.at >= 0.0 && bend.slope >= 0.0)
    };
    if !mechanism.damping.iter().all(ascending) {
        return wrong("the bends of a valve do not ascend, or one has a slope below 0");
    }
    Ok(())
}

fn proper([low, high]: [f64; 2]) -> bool {
    low < high
}

/// `coefficients` of a piece's polynomial are one more than its highest degree.
fn sized(pieces: usize, degree: usize, coefficients: usize) -> bool {
    (1..=MOST_PIECES).contains(&pieces) && degree < coefficients
}

fn curve(spline: &Spline) -> bool {
    proper(spline.interval)
        && sized(spline.pieces, spline.degree, LOAD)
        && spline.coefficients.len() == spline.pieces + spline.degree
}

fn surface(surface: &SurfaceSpline) -> bool {
    let most = [OVER_Q, OVER_SPEED];
    let fits = |i: usize| sized(surface.pieces[i], surface.degree[i], most[i]);
    let functions = |i: usize| surface.pieces[i] + surface.degree[i];
    proper(surface.interval_q)
        && proper(surface.interval_sqrt_speed)
        && fits(0)
        && fits(1)
        && surface.coefficients.len() == functions(0) * functions(1)
}
