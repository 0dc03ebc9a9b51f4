//! A controller with an identified twin opens what it could not open without; what is too heavy is known before. All figures
//! are simulated.
#![allow(clippy::unwrap_used, reason = "a test that cannot go on has failed")]

use ft_tests::control::{Robot, Task, attempts, attempts_by, robots, tasks};
use tempfile::tempdir;

fn task(object: &str) -> Task {
    tasks()
        .into_iter()
        .find(|task| task.scenario.name == object)
        .unwrap()
}

#[test]
fn a_strong_oven_opens_with_its_twin_and_stalls_without() {
    let folder = tempdir().unwrap();
    for attempt in attempts(&task("strong_oven"), 102, &folder.path().join("a.mcap")) {
        println!("{attempt:.3?}");
        assert_eq!(attempt.exceeds_at, None, "{}", attempt.robot);
        let [identified, prior, kinematics] = attempt.trials;
        assert!(identified.complete >= 0.98 && identified.track <= 0.15);
        assert!(prior.complete < 0.05 && kinematics.complete < 0.05);
    }
}

#[test]
fn an_arm_that_is_too_weak_is_known_before_it_stalls() {
    let folder = tempdir().unwrap();
    // The wood door asks for some 16 N at its handle when it is closed, and for 22 N at 1.2 rad.
    let weak = robots().map(|robot| Robot {
        force_n: 15.0,
        ..robot
    });
    let mut door = task("wood_door");
    door.goals = [1.2, 1.2];
    for attempt in attempts_by(&weak, &door, 102, &folder.path().join("a.mcap")) {
        println!("{attempt:.3?}");
        let foretold = attempt.exceeds_at.unwrap();
        let identified = attempt.trials[0];
        assert!(
            foretold < 0.1 && identified.furthest < foretold + 0.1,
            "{}: foretold {foretold:.3} rad, stalled at {:.3} rad",
            attempt.robot,
            identified.furthest
        );
    }
}
