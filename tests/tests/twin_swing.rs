//! Identified twins swing as the simulated doors do. All figures are simulated.
#![allow(clippy::unwrap_used, reason = "a test that cannot go on has failed")]

use ft_tests::swing::{DOORS, closings};
use tempfile::tempdir;

#[test]
fn doors_and_their_twins_swing_in_the_same_time() {
    let folder = tempdir().unwrap();
    let file = folder.path().join("a.mcap");
    let (mut errors, mut guesses) = (Vec::new(), Vec::new());
    for (door, angles) in DOORS {
        for closing in closings(door, 101, &angles, &file) {
            errors.push(closing.error(closing.twin).unwrap());
            guesses.push(closing.error(closing.prior).unwrap());
            println!("{closing:.3?}");
        }
    }
    let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len() as f64;
    assert!(mean(&errors) < 0.05, "macro error {:.3}", mean(&errors));
    assert!(
        mean(&guesses) > 0.2,
        "a guess without oil is no match: {:.3}",
        mean(&guesses)
    );
}
