//! Poses that have no wrench beside them.

use ft_recording::Stamped;

/// Shorter stretches are how one device begins or ends before the other, s.
const MIN_S: f64 = 2.0;

/// Stretches of poses, s after the first wrench, that stand in a hole of the wrench, before its begin or after its end; of 2 s
/// or more. Both by stamp.
pub(super) fn without_wrench<W, P>(wrench: &[Stamped<W>], poses: &[Stamped<P>]) -> Vec<[f64; 2]> {
    let (Some(start), Some(end)) = (wrench.first(), wrench.last()) else {
        return Vec::new();
    };
    let at = |stamp: ft_wire::HostTime| stamp.seconds_since(start.at);
    let (Some(first), Some(last)) = (poses.first(), poses.last()) else {
        return Vec::new();
    };
    let (first, last) = (at(first.at), at(last.at));
    let is_inside = |[from, to]: [f64; 2]| {
        let next = poses.partition_point(|pose| at(pose.at) <= from);
        poses.get(next).is_some_and(|pose| at(pose.at) < to)
    };
    let holes = wrench
        .windows(2)
        .map(|pair| [at(pair[0].at), at(pair[1].at)])
        .filter(|hole| is_inside(*hole))
        .map(|[from, to]| [from.max(first), to.min(last)]);
    let ends = [[first, last.min(0.0)], [first.max(at(end.at)), last]];
    let [before, after] = ends;
    let all = [before].into_iter().chain(holes).chain([after]);
    all.filter(|[from, to]| to - from >= MIN_S).collect()
}

/// What is said of them.
pub(super) fn told(stretches: &[[f64; 2]]) -> Option<String> {
    let texts: Vec<_> = stretches
        .iter()
        .map(|[from, to]| format!("{from:.1} to {to:.1} s"))
        .collect();
    (!texts.is_empty()).then(|| {
        format!(
            "NO WRENCH beside the poses from {} after the first wrench: is its file cut short?",
            texts.join(", ")
        )
    })
}

#[cfg(test)]
mod tests {
    use ft_wire::HostTime;

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
        let found = |wrench: &[(i64, i64)]| without_wrench(&stamps(wrench), &poses);
        assert!(found(&[(0, 60_000)]).is_empty());
        // A second at either end and in the middle is no loss.
        assert!(found(&[(1_000, 20_000), (21_000, 59_000)]).is_empty());
        let near = |found: &[[f64; 2]], expected: &[[f64; 2]]| {
            let pairs = found.as_flattened().iter().zip(expected.as_flattened());
            found.len() == expected.len() && pairs.into_iter().all(|(a, b)| (a - b).abs() < 0.02)
        };
        let all = found(&[(3_000, 20_000), (25_000, 40_000)]);
        assert!(
            near(&all, &[[-3.0, 0.0], [17.0, 22.0], [37.0, 57.0]]),
            "{all:?}"
        );
        // Where there are no poses either, nothing is missing beside them.
        let both = stamps(&[(0, 20_000), (25_000, 40_000)]);
        assert!(without_wrench(&both, &both).is_empty());
        assert!(without_wrench::<(), ()>(&[], &poses).is_empty());
        assert!(without_wrench::<(), ()>(&poses, &[]).is_empty());
    }
}
