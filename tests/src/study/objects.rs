//! Objects of 0.5 to 40 kg and 0.02 to 20 kg m^2 with every mechanism that the simulator has.

use ft_sim_hw::Scenario;
use ft_sim_hw::scenario::{MechanismSpec, StrutSpec, SwingDirection, ZoneSpec};

/// The study's scenarios of these names, all for none.
///
/// # Errors
/// A name that is not among them, with those that are.
///
/// # Panics
/// A built-in scenario is missing.
pub fn picked(names: &[String]) -> Result<Vec<Scenario>, String> {
    let mut all = objects();
    if let Some(unknown) = names.iter().find(|n| all.iter().all(|o| o.name != **n)) {
        let known: Vec<&str> = all.iter().map(|object| object.name.as_str()).collect();
        return Err(format!("no object {unknown:?} among {}", known.join(", ")));
    }
    all.retain(|object| names.is_empty() || names.contains(&object.name));
    Ok(all)
}

/// The study's scenarios, slides first, the light ones first.
///
/// # Panics
/// A built-in scenario is missing.
#[must_use]
pub fn objects() -> Vec<Scenario> {
    vec![
        slide(
            "tray",
            "drawer_light",
            [0.5, 0.8, 0.8],
            vec![catch(1.5, 0.02)],
        ),
        builtin("drawer_light"),
        slide(
            "drawer_soft",
            "drawer_light",
            [6.0, 4.0, 5.0],
            vec![soft_close()],
        ),
        builtin("drawer_loaded"),
        builtin("sliding_door"),
        slide("gate", "sliding_door", [40.0, 15.0, 20.0], Vec::new()),
        hinge("lid", 0.2, [0.02, 0.12, 0.02], vec![spring(0.3, 0.2)]),
        hinge(
            "cabinet_door",
            0.4,
            [0.3, 0.25, 0.12],
            vec![spring(0.6, 0.5), catch(1.5, 0.04)],
        ),
        builtin("oven_door"),
        hinge(
            "hatch",
            0.6,
            [2.5, 1.2, 0.8],
            vec![gas_spring(), spring(10.0, 1.0)],
        ),
        builtin("wood_door"),
        builtin("metal_door"),
        hinge("swing_gate", 0.9, [20.0, 3.0, 2.0], Vec::new()),
    ]
}

fn builtin(name: &str) -> Scenario {
    Scenario::builtin(name).unwrap_or_else(|error| panic!("{name}: {error}"))
}

/// A built-in scenario with another inertia, Coulomb and viscous friction, and mechanisms.
fn like(name: &str, base: &str, object: [f64; 3], mechanisms: Vec<MechanismSpec>) -> Scenario {
    let mut scenario = builtin(base);
    scenario.name = name.to_owned();
    scenario.description = format!("{name} of the study");
    let [inertia, coulomb, viscous] = object;
    let scale = inertia / scenario.object.inertia;
    scenario.object.inertia = inertia;
    scenario.object.coulomb = coulomb;
    scenario.object.breakaway = Some(1.1 * coulomb);
    scenario.object.viscous = viscous;
    scenario.object.stop_stiffness *= scale;
    scenario.object.stop_damping *= scale;
    scenario.mechanisms = mechanisms;
    scenario
}

fn slide(name: &str, base: &str, object: [f64; 3], mechanisms: Vec<MechanismSpec>) -> Scenario {
    like(name, base, object, mechanisms)
}

/// A door on the wood door's hinge, held `radius_m` from it.
fn hinge(name: &str, radius_m: f64, object: [f64; 3], mechanisms: Vec<MechanismSpec>) -> Scenario {
    let mut scenario = like(name, "wood_door", object, mechanisms);
    scenario.grasp.tcp_point[1] = scenario.joint.point[1] + radius_m;
    scenario.object.panel_mass_kg = 0.0;
    scenario
}

fn catch(pull: f64, reach: f64) -> MechanismSpec {
    MechanismSpec::Catch { pull, reach }
}

fn spring(preload: f64, rate: f64) -> MechanismSpec {
    MechanismSpec::SpringHinge { preload, rate }
}

/// A damper that slows the last 60 mm of closing.
fn soft_close() -> MechanismSpec {
    MechanismSpec::Closer {
        preload: 3.0,
        rate: 5.0,
        blend: 0.01,
        relief: None,
        zones: vec![ZoneSpec {
            from: -1.0,
            to: 0.06,
            direction: SwingDirection::Closing,
            damping: 60.0,
        }],
    }
}

fn gas_spring() -> MechanismSpec {
    MechanismSpec::GasSpring {
        force_n: 60.0,
        rate_n_per_m: 120.0,
        // What a strut damps at least over the whole range is viscous friction by definition, and would count as an error of b.
        damping: 0.0,
        strut: StrutSpec {
            frame_radius_m: 0.3,
            part_radius_m: 0.15,
            angle_rad: 0.4,
        },
    }
}
