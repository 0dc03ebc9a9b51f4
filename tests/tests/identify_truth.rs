//! The built-in scenarios, recorded through the drivers and identified, against what was simulated.
//! `cargo run -p ft-tests --bin truth-table` prints the same for ten seeds.

use ft_tests::truth::{Comparison, study};

/// From these on inertia is held to 15 %: kg m^2, kg.
const HEAVY: [f64; 2] = [1.0, 3.0];

fn is_heavy(one: &Comparison) -> bool {
    let slides = one.scenario.starts_with("drawer") || one.scenario == "sliding_door";
    one.inertia >= if slides { HEAVY[1] } else { HEAVY[0] }
}

#[test]
fn joints_and_inertia_of_the_built_in_scenarios_are_found() {
    let scenarios = [
        "wood_door",
        "metal_door",
        "drawer_light",
        "drawer_loaded",
        "sliding_door",
        "oven_door",
    ];
    // Other seeds than those that development looks at first.
    let results = study(&scenarios, 101..104, |_| {});
    assert_eq!(results.len(), 18);
    for one in &results {
        assert!(one.kind_is_right, "{one:?}");
        assert!(one.axis_deg <= 0.5, "{one:?}");
        assert!(one.axis_mm.is_nan() || one.axis_mm <= 5.0, "{one:?}");
        if is_heavy(one) {
            assert!(
                one.relative[0].is_some_and(|error| error.abs() <= 0.15),
                "{one:?}"
            );
        }
        // The full model must earn its keep, and cannot be better than what the truth leaves by much.
        assert!(one.held_out <= one.base_held_out * 1.05, "{one:?}");
        assert!(one.held_out >= 0.7 * one.floor_true, "{one:?}");
    }
}
