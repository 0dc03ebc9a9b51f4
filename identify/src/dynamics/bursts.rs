//! Whether a residual comes in bursts, as what acts at a few places or now and then leaves it.

use std::collections::BTreeMap;

use crate::motion::Motion;
use crate::samples::extrema;

/// Where a residual is much larger than it is mostly.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct Bursts {
    /// Kurtosis of the residual, mean(r^4) / mean(r^2)^2: 3 for normal noise.
    pub kurtosis: f64,
    /// Smallest and largest coordinate of the tenth of the range with most of sum(r^4), rad or m.
    pub q: [f64; 2],
    /// Whether q grows there.
    pub forward: bool,
    /// Share of sum(r^4) there.
    pub share: f64,
    /// Share of the samples there.
    pub samples: f64,
    /// Whether most are there, in several strokes: a few outliers are somewhere, too.
    pub at_a_place: bool,
}

/// Kurtosis above that of normal noise from which on a residual bursts, however many samples there are. Noise that differs by place and
/// speed is a mixture, whose kurtosis is above 3, too: in simulated recordings without anything missing it is 2.7 to 3.6.
const LEAST: f64 = 1.0;
/// So many standard deviations of a kurtosis that is worked out from few samples.
const SURELY: f64 = 6.0;
/// Places over the range; two side by side are looked at together.
const PLACES: usize = 20;
/// Bursts are at a place with this share of them, when so many strokes have a part of that each.
const MOST_OF_THEM: f64 = 0.5;
const STROKES: usize = 3;
const PART: f64 = 0.1;

/// Sum of r^4 and number of samples.
type Sum = (f64, f64);

/// The bursts of `residual`, one number per kept sample; nothing where it is as noise is.
#[must_use]
pub fn bursts(motion: &Motion, residual: &[f64], effective_samples: f64) -> Option<Bursts> {
    let count = residual.len() as f64;
    let moment = |power: i32| residual.iter().map(|r| r.powi(power)).sum::<f64>() / count;
    let fourth = moment(4);
    let kurtosis = fourth / moment(2).powi(2);
    let spread = (24.0 / effective_samples.max(1.0)).sqrt();
    // No number where there is no residual.
    let bursts = kurtosis > 3.0 + LEAST.max(SURELY * spread);
    if !bursts {
        return None;
    }
    let (low, high) = extrema(&motion.at_kept(&motion.q));
    let width = (high - low) / PLACES as f64;
    // By direction and place, stroke by stroke.
    let mut places: [[BTreeMap<usize, Sum>; PLACES]; 2] = Default::default();
    for (&i, r) in motion.kept.iter().zip(residual) {
        let place = (((motion.q[i] - low) / width) as usize).min(PLACES - 1);
        let way = usize::from(motion.sign[i] > 0.0);
        let (sum, samples) = places[way][place].entry(motion.stroke[i]).or_default();
        *sum += r.powi(4);
        *samples += 1.0;
    }
    let windows = (0..2).flat_map(|way| (0..PLACES - 1).map(move |place| (way, place)));
    let sums = windows.map(|(way, place)| {
        let mut strokes = places[way][place].clone();
        for (stroke, (sum, samples)) in &places[way][place + 1] {
            let both = strokes.entry(*stroke).or_default();
            *both = (both.0 + sum, both.1 + samples);
        }
        let all = strokes
            .values()
            .fold((0.0, 0.0), |all, one| (all.0 + one.0, all.1 + one.1));
        (way, place, strokes, all)
    });
    let (way, place, strokes, (sum, samples)) =
        sums.max_by(|(.., a), (.., b)| a.0.total_cmp(&b.0))?;
    let share = sum / (count * fourth);
    let part = |stroke: &&Sum| stroke.0 > PART * sum;
    let from = low + place as f64 * width;
    Some(Bursts {
        kurtosis,
        q: [from, from + 2.0 * width],
        forward: way == 1,
        share,
        samples: samples / count,
        at_a_place: share > MOST_OF_THEM && strokes.values().filter(part).count() >= STROKES,
    })
}
