//! Poses that have no wrench beside them, and wrenches without poses.

use std::fmt;

use ft_recording::Stamped;
use ft_wire::HostTime;

/// Shorter stretches are how one device begins or ends before the other, s.
const MIN_S: f64 = 2.0;

/// Stretches of 2 s or more, s after the first wrench, in which one stream is there and the other is not.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize)]
pub struct Uncovered {
    /// Poses in a hole of the wrench or after its end.
    pub without_wrench_s: Vec<[f64; 2]>,
    /// Wrenches in a hole of the poses or after their end.
    pub without_pose_s: Vec<[f64; 2]>,
    /// By how much the poses began after the first wrench, s, when by 2 s or more; before it below 0. Who starts late loses nothing.
    pub poses_begin_s: Option<f64>,
}

impl Uncovered {
    /// Both streams stand by stamp.
    pub(super) fn of<W, P>(wrench: &[Stamped<W>], poses: &[Stamped<P>]) -> Self {
        let (Some(start), Some(pose)) = (wrench.first(), poses.first()) else {
            return Self::default();
        };
        let begin_s = pose.at.seconds_since(start.at);
        Self {
            without_wrench_s: without(wrench, poses, start.at),
            without_pose_s: without(poses, wrench, start.at),
            poses_begin_s: (begin_s.abs() >= MIN_S).then_some(begin_s),
        }
    }

    pub(super) const fn lost_data(&self) -> bool {
        !self.without_wrench_s.is_empty() || !self.without_pose_s.is_empty()
    }
}

/// Stretches of `there`, s after `zero`, that stand in a hole of `missing` or after its end. Where both pause nothing is missing.
fn without<M, T>(missing: &[Stamped<M>], there: &[Stamped<T>], zero: HostTime) -> Vec<[f64; 2]> {
    let gone = pauses(missing, zero);
    let mut out = Vec::new();
    for stretch in there.chunk_by(|a, b| b.at.seconds_since(a.at) < MIN_S) {
        let (Some(first), Some(last)) = (stretch.first(), stretch.last()) else {
            continue;
        };
        let [first, last] = [first, last].map(|sample| sample.at.seconds_since(zero));
        let both = gone
            .iter()
            .map(|[from, to]| [from.max(first), to.min(last)]);
        out.extend(both.filter(|[from, to]| to - from >= MIN_S));
    }
    out
}

/// Where a stream is not, s after `zero`: its holes, and after its end.
fn pauses<M>(samples: &[Stamped<M>], zero: HostTime) -> Vec<[f64; 2]> {
    let at = |sample: &Stamped<M>| sample.at.seconds_since(zero);
    let steps = samples.windows(2).filter_map(|pair| match pair {
        [a, b] => Some([at(a), at(b)]),
        _ => None,
    });
    let holes = steps.filter(|[from, to]| to - from >= MIN_S);
    let end = samples.last().map(|last| [at(last), f64::INFINITY]);
    holes.chain(end).collect()
}

impl fmt::Display for Uncovered {
    /// A line for each that there is, each begun by a line break.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let both = [
            (&self.without_wrench_s, "WRENCH", "poses"),
            (&self.without_pose_s, "POSES", "wrenches"),
        ];
        for (stretches, missing, there) in both {
            if stretches.is_empty() {
                continue;
            }
            let texts = stretches
                .iter()
                .map(|[from, to]| format!("{from:.1} to {to:.1} s"));
            let texts = texts.collect::<Vec<_>>().join(", ");
            write!(
                f,
                "\n  NO {missing} beside the {there} from {texts} after the first wrench: is its file cut short?"
            )?;
        }
        match self.poses_begin_s {
            Some(begin_s) if begin_s < 0.0 => {
                write!(f, "\n  the wrench begins {:.1} s after the poses", -begin_s)
            }
            Some(begin_s) => write!(f, "\n  the poses begin {begin_s:.1} s after the wrench"),
            None => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn stamps(parts: &[(i64, i64)]) -> Vec<Stamped<()>> {
        let at = |ms: i64| HostTime::from_nanos((1_000_000 + ms) * 1_000_000);
        let parts = parts.iter().flat_map(|(from, to)| (*from..*to).step_by(10));
        parts
            .map(|ms| Stamped {
                at: at(ms),
                value: (),
            })
            .collect()
    }

    #[test]
    fn ends_and_holes_of_seconds_are_found_where_there_are_poses() {
        let poses = stamps(&[(0, 60_000)]);
        let found = |wrench: &[(i64, i64)]| Uncovered::of(&stamps(wrench), &poses);
        assert_eq!(found(&[(0, 60_000)]), Uncovered::default());
        // A second at either end and in the middle is no loss.
        let little = found(&[(1_000, 20_000), (21_000, 59_000)]);
        assert_eq!(little, Uncovered::default());
        let near = |found: &[[f64; 2]], expected: &[[f64; 2]]| {
            let pairs = found.as_flattened().iter().zip(expected.as_flattened());
            found.len() == expected.len() && pairs.into_iter().all(|(a, b)| (a - b).abs() < 0.02)
        };
        let all = found(&[(3_000, 20_000), (25_000, 40_000)]);
        let expected = [[17.0, 22.0], [37.0, 57.0]];
        assert!(near(&all.without_wrench_s, &expected), "{all:?}");
        assert_eq!(all.poses_begin_s, Some(-3.0));
        assert!(all.without_pose_s.is_empty() && all.lost_data());
        // The other way round; a late start alone loses nothing.
        let short = Uncovered::of(&poses, &stamps(&[(5_000, 30_000), (34_000, 50_000)]));
        let expected = [[30.0, 34.0], [50.0, 60.0]];
        assert!(near(&short.without_pose_s, &expected), "{short:?}");
        assert_eq!(short.poses_begin_s, Some(5.0));
        assert!(
            short.to_string().contains("NO POSES") && short.to_string().contains("begin 5.0 s")
        );
        let late = Uncovered::of(&poses, &stamps(&[(5_000, 60_000)]));
        assert!(!late.lost_data(), "{late:?}");
        // Where there are no poses either, nothing is missing beside them.
        let both = stamps(&[(0, 20_000), (25_000, 40_000)]);
        assert_eq!(Uncovered::of(&both, &both), Uncovered::default());
        let apart = stamps(&[(10, 20_013), (24_992, 40_007)]);
        assert_eq!(Uncovered::of(&both, &apart), Uncovered::default());
        assert_eq!(Uncovered::of(&apart, &both), Uncovered::default());
        let none: &[Stamped<()>] = &[];
        assert_eq!(Uncovered::of(none, &poses), Uncovered::default());
        assert_eq!(Uncovered::of(&poses, none), Uncovered::default());
    }
}
