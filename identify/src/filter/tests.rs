use super::*;

/// `x` of the scipy runs below: `sin(0.11 i) + 0.3 cos(0.9 i) + 0.01 i`, i = 0..120.
fn reference_input() -> Vec<f64> {
    (0..120)
        .map(f64::from)
        .map(|i| (0.11 * i).sin() + 0.3 * (0.9 * i).cos() + 0.01 * i)
        .collect()
}

fn assert_matches(got: &[f64], expected: [f64; 6]) {
    for (index, expected) in [0, 1, 2, 60, 118, 119].into_iter().zip(expected) {
        assert!(
            (got[index] - expected).abs() < 1e-9,
            "sample {index}: {} and scipy {expected}",
            got[index]
        );
    }
}

#[test]
fn butterworth_agrees_with_scipy() {
    // scipy 1.17.1: sosfiltfilt(butter(4, 6, fs=100, output='sos'), x)[[0, 1, 2, 60, 118, 119]]
    let got = LowPass::butterworth(4, 6.0, 100.0)
        .unwrap()
        .zero_phase(&reference_input())
        .unwrap();
    assert_matches(
        &got,
        [
            0.2973952274656155,
            0.3368814906233477,
            0.380786239592436,
            0.9113329574459099,
            1.796329142064839,
            1.998421063059418,
        ],
    );
}

#[test]
fn an_odd_order_agrees_with_scipy() {
    // scipy 1.17.1: sosfiltfilt(butter(3, 10, fs=100, output='sos'), x)[[0, 1, 2, 60, 118, 119]]
    let got = LowPass::butterworth(3, 10.0, 100.0)
        .unwrap()
        .zero_phase(&reference_input())
        .unwrap();
    assert_matches(
        &got,
        [
            0.302607657721802,
            0.2597053467290417,
            0.2479817422111268,
            0.8904453867408195,
            1.711221347323472,
            1.971494190295855,
        ],
    );
}

#[test]
fn chebyshev_agrees_with_scipy() {
    // scipy 1.17.1: sosfiltfilt(cheby1(8, 0.05, 0.08, output='sos'), r_[x, x[::-1]])[[0, 1, 2, 60, 118, 119]]
    let mut input = reference_input();
    input.extend(reference_input().into_iter().rev());
    let got = LowPass::chebyshev1(8, 0.05, 0.08, 2.0)
        .unwrap()
        .zero_phase(&input)
        .unwrap();
    assert_matches(
        &got,
        [
            0.3057380571744253,
            0.3754889437538085,
            0.4437720721398463,
            0.8867821975413555,
            1.498770841328725,
            1.521828053222892,
        ],
    );
    // scipy 1.17.1: sosfiltfilt(cheby1(5, 0.5, 12, fs=100, output='sos'), x)[[0, 1, 2, 60, 118, 119]]
    let got = LowPass::chebyshev1(5, 0.5, 12.0, 100.0)
        .unwrap()
        .zero_phase(&reference_input())
        .unwrap();
    assert_matches(
        &got,
        [
            0.2938921457730893,
            0.1670206412507831,
            0.118935103087922,
            0.8826925432159975,
            1.648596096259832,
            1.96356817523912,
        ],
    );
}

#[test]
fn the_cut_off_passes_half_the_power() {
    for order in 1..=8 {
        let gain = LowPass::butterworth(order, 7.0, 250.0)
            .unwrap()
            .gain(7.0, 250.0);
        assert!(
            (gain - 0.5_f64.sqrt()).abs() < 1e-9,
            "order {order}: {gain}"
        );
    }
}

#[test]
fn a_settled_filter_keeps_a_straight_line_to_its_ends() {
    let line: Vec<f64> = (0..200).map(|i| 3.0 - 0.02 * f64::from(i)).collect();
    let got = LowPass::butterworth(4, 5.0, 200.0)
        .unwrap()
        .zero_phase_settled(&line)
        .unwrap();
    assert!((0..200).all(|i| (got[i] - line[i]).abs() < 1e-3));
}

#[test]
fn derivatives_are_of_the_stated_order() {
    let (period, w) = (0.004, 2.0 * PI * 6.0);
    let sine: Vec<f64> = (0..500)
        .map(|i| (w * period * f64::from(i)).sin())
        .collect();
    let (first, second) = (
        first_derivative(&sine, period),
        second_derivative(&sine, period),
    );
    let bound = (w * period).powi(4) / 30.0;
    for i in 2..498 {
        let phase = w * period * i as f64;
        assert!((first[i] / w - phase.cos()).abs() < 1.05 * bound);
        assert!((second[i] / (w * w) + phase.sin()).abs() < 1.05 * bound);
    }
    let coarse = central_difference(&sine, period);
    assert!(
        (coarse[100] / w - (w * period * 100.0).cos()).abs() < (w * period).powi(2) / 6.0 + 1e-12
    );
}

#[test]
fn impossible_filters_are_refused() {
    assert_eq!(
        LowPass::butterworth(4, 60.0, 100.0),
        Err(FilterError::Cutoff {
            cutoff_hz: 60.0,
            rate_hz: 100.0
        })
    );
    assert_eq!(
        LowPass::butterworth(0, 6.0, 100.0),
        Err(FilterError::Order { order: 0 })
    );
    let filter = LowPass::butterworth(4, 6.0, 100.0).unwrap();
    assert_eq!(
        filter.zero_phase(&[0.0; 15]),
        Err(FilterError::TooShort {
            got: 15,
            needed: 15
        })
    );
}

#[test]
fn series_side_by_side_are_filtered_as_each_alone() {
    let series: Vec<[f64; 3]> = (0..500)
        .map(f64::from)
        .map(|i| [(0.05 * i).sin(), 0.01 * i, (0.9 * i).cos() - 3.0])
        .collect();
    for order in [3, 4, 7] {
        let filter = LowPass::butterworth(order, 4.0, 100.0).unwrap();
        let together = filter.zero_phase_settled_each(&series).unwrap();
        for k in 0..3 {
            let alone: Vec<f64> = series.iter().map(|values| values[k]).collect();
            let alone = filter.zero_phase_settled(&alone).unwrap();
            assert!(together.iter().map(|values| values[k]).eq(alone));
        }
    }
}
