//! Which held-out samples say something about a model: those whose state others have probed.
//!
//! A model holds where it was probed. The one stroke that was faster or went further than all others cannot be foretold from them,
//! and its error would say that, not how good the model is.

use super::Motion;
use crate::samples::extrema;

/// Bins over the coordinate, and how many to either side still count as near: within 5 % of the range.
const BINS: usize = 40;
const NEAR: usize = 2;
/// With fewer samples than that there is nothing to choose from.
const LEAST: usize = 30;

/// True for each kept sample when other folds went by near it in the same direction and at least as fast, not all of them short of it
/// and not all of them beyond: what begins a little further than they came, as a damper does, they do not foretell.
pub(super) fn covered(motion: &Motion, folds: &[usize], count: usize) -> Vec<bool> {
    let q = motion.at_kept(&motion.q);
    let dq = motion.at_kept(&motion.dq);
    let (low, high) = extrema(&q);
    let bin = |q: f64| {
        let share = (q - low) / (high - low).max(f64::MIN_POSITIVE);
        ((share * BINS as f64) as usize).min(BINS - 1)
    };
    let mut fastest = vec![[[0.0_f64; BINS]; 2]; count];
    for ((q, dq), fold) in q.iter().zip(&dq).zip(folds) {
        let speed = &mut fastest[*fold][usize::from(*dq < 0.0)][bin(*q)];
        *speed = speed.max(dq.abs());
    }
    let out: Vec<bool> = q
        .iter()
        .zip(&dq)
        .zip(folds)
        .map(|((q, dq), fold)| {
            let at = bin(*q);
            let sides = [
                at.saturating_sub(NEAR)..at + 1,
                at..(at + NEAR + 1).min(BINS),
            ];
            sides.into_iter().all(|side| {
                fastest.iter().enumerate().any(|(other, speeds)| {
                    let speeds = &speeds[usize::from(*dq < 0.0)][side.clone()];
                    other != *fold && speeds.iter().any(|speed| *speed >= dq.abs())
                })
            })
        })
        .collect();
    if out.iter().filter(|covered| **covered).count() < LEAST {
        return vec![true; out.len()];
    }
    out
}
