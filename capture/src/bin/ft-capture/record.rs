//! `ft-capture` without a subcommand: record.

use std::path::PathBuf;
use std::time::Duration;

use clap::CommandFactory;
use clap::error::ErrorKind;
use ft_capture::config::Config;
use ft_capture::network;
use ft_capture::open::Connection;
use ft_capture::session::{Plan, live};
use ft_capture::stop::stop_flag;
use ft_capture::summary::Summary;
use ft_drivers::{Clock, MonotonicClock};

use crate::terminal::{Operator, bar, say};
use crate::{Arguments, CommandResult, Outcome, RecordArguments, Speed, simulate};

/// Carries the command out.
pub(crate) fn record(arguments: &RecordArguments) -> CommandResult {
    let asks_for_network = arguments.router
        || arguments.view.is_some()
        || arguments.foxglove.is_some()
        || !(arguments.listen.is_empty() && arguments.connect.is_empty());
    if arguments.speed == Speed::Max && asks_for_network {
        Arguments::command()
            .error(
                ErrorKind::ArgumentConflict,
                "--speed max publishes nothing: leave out --listen, --connect, --router, --view and --foxglove, or use --speed 1",
            )
            .exit();
    }
    let read = || Config::load(&arguments.config);
    let config = arguments.sim.is_none().then(read).transpose()?;
    let configured = config.as_ref().and_then(|it| it.network.keys.as_ref());
    if configured.or(arguments.keys.as_ref()).is_some() {
        // SAFETY: the main thread has read its arguments and the configuration, and started nothing.
        unsafe { network::receive_and_send_in_one_thread() };
    }
    let summary = match (config, &arguments.sim) {
        (Some(config), _) => from_devices(arguments, config)?,
        (None, Some(scenario)) => simulate::run(arguments, scenario)?,
        (None, None) => unreachable!("without a scenario the configuration was read"),
    };
    if arguments.json {
        say(&serde_json::to_string_pretty(&summary)?)?;
    } else {
        say(&summary.to_string())?;
        let recorded = summary.files.first().filter(|_| !arguments.no_record);
        if let (Some(_), Some(file)) = (&arguments.sim, recorded) {
            let truth = simulate::truth_path(&file.path);
            say(&format!("what was simulated: {}", truth.display()))?;
        }
    }
    Ok(Outcome::of(summary.lost_data()))
}

fn from_devices(
    arguments: &RecordArguments,
    config: Config,
) -> Result<Summary, Box<dyn std::error::Error>> {
    let clock = MonotonicClock::anchored_now();
    let default_name = format!("ft-{}.mcap", clock.now().as_nanos() / 1_000_000_000);
    let plan = plan(arguments, config, &default_name);
    let connections = plan
        .config
        .devices
        .iter()
        .map(|_| Connection::Configured)
        .collect();
    let mut operator = Operator {
        stop: stop_flag()?,
        take_marks: Box::new(Vec::new),
        is_over: Box::new(|| false),
        bar: bar(arguments.duration),
        shown_at: Duration::ZERO,
    };
    let summary = live::run(&plan, clock, connections, &mut operator);
    operator.bar.finish_and_clear();
    Ok(summary?)
}

/// The plan of `config` as the command line amends it.
pub(crate) fn plan(arguments: &RecordArguments, mut config: Config, default_name: &str) -> Plan {
    config
        .network
        .listen
        .extend(arguments.listen.iter().cloned());
    config
        .network
        .connect
        .extend(arguments.connect.iter().cloned());
    if let Some(id) = &arguments.id {
        config.id.clone_from(id);
    }
    if let Some(namespace) = &arguments.namespace {
        config.network.namespace.clone_from(namespace);
    }
    config.network.router |= arguments.router;
    config.network.keys = arguments.keys.clone().or(config.network.keys);
    config.network.foxglove = arguments.foxglove.or(config.network.foxglove);
    config.network.view = arguments.view.or(config.network.view);
    let record = (!arguments.no_record).then(|| {
        arguments
            .output
            .clone()
            .unwrap_or_else(|| PathBuf::from(default_name))
    });
    Plan {
        config,
        record,
        overwrite: arguments.force,
        duration: arguments.duration,
        publish: true,
    }
}
