//! `ft-capture --sim`: the devices are simulated, everything from the drivers on is what real devices meet.

use std::cell::RefCell;
use std::path::{Path, PathBuf};
use std::time::Duration;

use clap::CommandFactory as _;
use clap::error::ErrorKind;
use ft_capture::config::is_name;
use ft_capture::open::Connection;
use ft_capture::session::{Plan, live};
use ft_capture::simulated;
use ft_capture::stop::stop_flag;
use ft_capture::summary::Summary;
use ft_drivers::MonotonicClock;
use ft_sim_hw::{
    Port, Scenario, ScenarioError, ServeError, ServeOptions, ServedPort, Server, Simulation, Truth,
};

use crate::record::plan;
use crate::terminal::{Operator, bar};
use crate::{Arguments, RecordArguments, Speed};

/// Runs the scenario `name`.
pub(crate) fn run(
    arguments: &RecordArguments,
    name: &str,
) -> Result<Summary, Box<dyn std::error::Error>> {
    if arguments.speed == Speed::Max && arguments.vcan.is_some() {
        refuse_vcan("--speed max uses no CAN interface: leave out --vcan, or use --speed 1");
    }
    match arguments.speed {
        Speed::RealTime => simulated_live(arguments, name),
        Speed::Max => simulated_stepped(arguments, name),
    }
}

fn refuse_vcan(why: &str) -> ! {
    Arguments::command()
        .error(ErrorKind::ArgumentConflict, why)
        .exit()
}

/// Whether an error is one of the command line: a scenario that there is not, or too short a duration.
pub(crate) fn is_wrong_argument(error: &(dyn std::error::Error + 'static)) -> bool {
    let scenario = match error.downcast_ref() {
        Some(ServeError::Scenario(scenario)) => Some(scenario),
        _ => error.downcast_ref(),
    };
    matches!(
        scenario,
        Some(ScenarioError::UnknownName { .. } | ScenarioError::TooShort { .. })
    )
}

fn simulated_live(
    arguments: &RecordArguments,
    name: &str,
) -> Result<Summary, Box<dyn std::error::Error>> {
    let scenario = Scenario::load(name)?;
    let clock = MonotonicClock::anchored_now();
    let options = ServeOptions {
        vcan: arguments.vcan.clone(),
        ..ServeOptions::default()
    };
    let server = Server::start(
        &scenario,
        arguments.seed,
        arguments.duration,
        clock,
        options,
    )?;
    let ports = server.ports();
    let on_can = |served: &ServedPort| matches!(served.port, Port::SocketCan(_));
    if arguments.vcan.is_some() && !ports.iter().any(on_can) {
        refuse_vcan("no device of the scenario is on CAN: leave out --vcan");
    }
    let mut connections = Vec::new();
    for served in &ports {
        connections.push(match &served.port {
            Port::InProcess => match server.can_link(&served.fitted.name) {
                Some(link) => Connection::Simulated(link),
                None => {
                    return Err(
                        format!("{}: the simulation serves no link", served.fitted.name).into(),
                    );
                }
            },
            _ => Connection::Configured,
        });
    }
    let fitted: Vec<_> = ports.iter().map(|served| served.fitted.clone()).collect();
    let config = simulated::config(
        &scenario_id(name),
        &fitted,
        &server.known_setup(),
        |device| {
            ports
                .iter()
                .find(|served| served.fitted.name == device.name)
                .map_or_else(String::new, |served| match &served.port {
                    Port::Pty(path) => path.display().to_string(),
                    Port::SocketCan(interface) => interface.clone(),
                    _ => "in-process".to_owned(),
                })
        },
    )?;
    let plan = plan(arguments, config, &default_name(name, arguments.seed));
    check_truth(&plan)?;
    let server = RefCell::new(server);
    let mut operator = Operator {
        stop: stop_flag()?,
        take_marks: Box::new(|| server.borrow_mut().drain_marks()),
        is_over: Box::new(|| server.borrow().is_over()),
        bar: bar(arguments.duration),
        shown_at: Duration::ZERO,
    };
    let summary = live::run(&plan, clock, connections, &mut operator);
    operator.bar.finish_and_clear();
    drop(operator);
    let (summary, server) = (summary?, server.into_inner());
    write_truth(&plan, &server.truth())?;
    server.stop();
    Ok(summary)
}

fn simulated_stepped(
    arguments: &RecordArguments,
    name: &str,
) -> Result<Summary, Box<dyn std::error::Error>> {
    let scenario = Scenario::load(name)?;
    let mut simulation = Simulation::new(
        &scenario,
        arguments.seed,
        simulated::START,
        arguments.duration,
    )?;
    let config = simulated::config(
        &scenario_id(name),
        simulation.fitted(),
        &simulation.known_setup(),
        |_| "in-process".to_owned(),
    )?;
    let mut plan = plan(arguments, config, &default_name(name, arguments.seed));
    check_truth(&plan)?;
    plan.publish = false;
    let stop = stop_flag()?;
    let total = arguments
        .duration
        .unwrap_or_else(|| simulation.end().saturating_since(simulated::START));
    let bar = bar(Some(total));
    bar.set_message(format!("simulating {name}"));
    let summary = simulated::run(
        &plan,
        &mut simulation,
        |elapsed| bar.set_position(elapsed.as_millis().try_into().unwrap_or(u64::MAX)),
        || stop.load(std::sync::atomic::Ordering::Relaxed),
    );
    bar.finish_and_clear();
    let summary = summary?;
    write_truth(&plan, &simulation.truth())?;
    Ok(summary)
}

/// The scenario's name or its file's, as far as it can be part of a key.
fn scenario_id(name: &str) -> String {
    let stem = Path::new(name)
        .file_stem()
        .and_then(|stem| stem.to_str())
        .unwrap_or("sim");
    stem.chars()
        .map(|c| if is_name(&c.to_string()) { c } else { '_' })
        .collect()
}

fn default_name(scenario: &str, seed: u64) -> String {
    format!("{}-seed{seed}.mcap", scenario_id(scenario))
}

/// `door.mcap` -> `door.truth.json`, other names -> the name and `.truth.json`.
pub(crate) fn truth_path(recording: &Path) -> PathBuf {
    let mut name = recording.as_os_str().to_owned();
    if recording
        .extension()
        .is_some_and(|extension| extension == "mcap")
    {
        name = recording.with_extension("").into_os_string();
    }
    name.push(".truth.json");
    PathBuf::from(name)
}

/// Refuses before the run what would be refused after it.
fn check_truth(plan: &Plan) -> Result<(), String> {
    match plan.record.as_deref().map(truth_path) {
        Some(path) if path.exists() && !plan.overwrite => Err(format!(
            "{} exists: choose another recording with -o, or replace it with --force",
            path.display()
        )),
        _ => Ok(()),
    }
}

/// What was simulated goes to a file apart, for whoever wants to compare; nothing in the identification reads it.
fn write_truth(plan: &Plan, truth: &Truth) -> Result<(), Box<dyn std::error::Error>> {
    if let Some(record) = &plan.record {
        std::fs::write(truth_path(record), serde_json::to_string_pretty(truth)?)?;
    }
    Ok(())
}
