//! `ft-sim-hw`: the simulated devices alone, for any program to open.

use std::io::IsTerminal;
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use clap::{Parser, Subcommand};
use ft_drivers::{Clock, MonotonicClock};
use ft_sim_hw::scenario::{GripperDriver, SensorDriver, SensorSpec};
use ft_sim_hw::sealed::Mechanisms;
use ft_sim_hw::{
    Bus, Port, Scenario, ScenarioError, SealedDraw, SealedError, SealedOptions, ServeError,
    ServeOptions, Server,
};

const EXAMPLES: &str = "\
Examples:
  ft-sim-hw scenarios
  ft-sim-hw serve wood_door
  ft-sim-hw serve oven_door --vcan vcan0 --seed 7
  ft-sim-hw serve wood_door --sensor optoforce_serial --gripper amt21
  ft-sim-hw serve wood_door --gadget ft_sensor=/dev/ttyGS0
  ft-sim-hw serve my_door.toml --duration 30 --truth truth.json
  ft-sim-hw sealed --seed 1000 --count 20 -o draws
  ft-capture --sim draws/0001/main.toml --speed max -o main.mcap

Exit codes: 0 fine, 1 failed, 2 wrong arguments, 3 finished but data was lost.";

/// Simulated force-sensing gripper, object and person: devices that any program can open.
#[derive(Parser)]
#[command(name = "ft-sim-hw", version, after_help = EXAMPLES)]
struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Plays a scenario in real time on pseudo-terminals and CAN until Ctrl-C.
    Serve {
        /// A built-in scenario, or the path of a TOML file.
        scenario: String,
        /// Draws everything that is random.
        #[arg(long, default_value_t = 1)]
        seed: u64,
        /// Another force-torque sensor than the scenario's.
        #[arg(long, value_name = "DRIVER", value_parser = SensorDriver::names())]
        sensor: Option<String>,
        /// Another encoder of the jaws than the scenario's.
        #[arg(long, value_name = "DRIVER", value_parser = GripperDriver::names())]
        gripper: Option<String>,
        /// Seconds that the person takes in all; by default as long as a minute of probing takes.
        #[arg(long, value_name = "SECONDS", value_parser = seconds)]
        duration: Option<Duration>,
        /// An existing CAN interface for devices on CAN.
        #[arg(long, value_name = "INTERFACE")]
        vcan: Option<String>,
        /// The device's side of a USB gadget for a serial device, such as ft_sensor=/dev/ttyGS0; may be given several times.
        #[arg(long, value_name = "DEVICE=TTY", value_parser = gadget)]
        gadget: Vec<(String, PathBuf)>,
        /// A mounted FunctionFS for a device on CAN, such as ft_sensor=/run/candle: a candleLight adapter; may be given several times.
        #[arg(long, value_name = "DEVICE=FOLDER", value_parser = gadget)]
        candlelight: Vec<(String, PathBuf)>,
        /// Writes what is really so into this file (JSON); an existing one is refused.
        #[arg(long, value_name = "FILE")]
        truth: Option<PathBuf>,
    },
    /// Lists the built-in scenarios.
    Scenarios,
    /// Draws an object with undeclared effects: main.toml, confirm.toml, and truth.json for the judge.
    Sealed(Sealed),
}

#[derive(clap::Args)]
struct Sealed {
    /// Draws everything; with --count the first of that many seeds.
    #[arg(long)]
    seed: u64,
    /// Folder for the files; files that exist are refused.
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
    /// Draws of this and the next seeds, in folders 0001, 0002, ...
    #[arg(long, value_name = "K", value_parser = clap::value_parser!(u64).range(1..))]
    count: Option<u64>,
    /// Takes the objects' closers, catches and counterbalances away.
    #[arg(long)]
    bare: bool,
    /// Draws this effect only; may be given several times to draw one of them.
    #[arg(long, value_name = "NAME")]
    effect: Vec<String>,
    /// Probability that nothing is undeclared.
    #[arg(long, value_name = "P", default_value_t = SealedOptions::default().none, value_parser = probability)]
    none: f64,
    /// Probability of two effects.
    #[arg(long, value_name = "P", default_value_t = SealedOptions::default().two, value_parser = probability)]
    two: f64,
    /// Probability of an effect that the report has no name for.
    #[arg(long, value_name = "P", default_value_t = SealedOptions::default().outside, value_parser = probability)]
    outside: f64,
}

fn probability(text: &str) -> Result<f64, String> {
    text.parse()
        .ok()
        .filter(|value| (0.0..=1.0).contains(value))
        .ok_or_else(|| format!("{text:?} is not a number from 0 to 1"))
}

/// `ft_sensor=/dev/ttyGS0`, `ft_sensor=/run/candle`.
fn gadget(text: &str) -> Result<(String, PathBuf), String> {
    let (device, tty) = text
        .split_once('=')
        .ok_or_else(|| format!("{text:?} is not DEVICE=PATH"))?;
    Ok((device.to_owned(), PathBuf::from(tty)))
}

/// `30`, `30s` or `1.5`.
fn seconds(text: &str) -> Result<Duration, String> {
    let number: f64 = text
        .trim_end_matches('s')
        .parse()
        .map_err(|_| format!("{text:?} is not a number of seconds"))?;
    Duration::try_from_secs_f64(number).map_err(|error| error.to_string())
}

fn main() -> ExitCode {
    // `ft-sim-hw scenarios | head` ends quietly.
    sigpipe::reset();
    let result = match Arguments::parse().command {
        Command::Scenarios => scenarios(),
        Command::Sealed(arguments) => sealed(&arguments),
        Command::Serve {
            scenario,
            seed,
            sensor,
            gripper,
            duration,
            vcan,
            gadget,
            candlelight,
            truth,
        } => Scenario::load(&scenario)
            .map(|scenario| with_devices(scenario, sensor.as_deref(), gripper.as_deref()))
            .map_err(|error| match error {
                ScenarioError::UnknownName { .. } => (2, error.to_string()),
                _ => failed(&error),
            })
            .and_then(|scenario| {
                let options = ServeOptions {
                    vcan,
                    gadgets: gadget.into_iter().collect(),
                    candlelights: candlelight.into_iter().collect(),
                };
                serve(&scenario, seed, duration, options, truth)
            }),
    };
    match result {
        Ok(code) => code,
        Err((code, text)) => {
            eprintln!("ft-sim-hw: {text}");
            ExitCode::from(code)
        }
    }
}

type Outcome = Result<ExitCode, (u8, String)>;

fn failed(error: &dyn std::error::Error) -> (u8, String) {
    let mut text = error.to_string();
    let mut source = error.source();
    while let Some(cause) = source {
        let cause_text = cause.to_string();
        if !text.contains(&cause_text) {
            text = format!("{text}: {cause_text}");
        }
        source = cause.source();
    }
    (1, text)
}

fn scenarios() -> Outcome {
    for name in Scenario::builtin_names() {
        let scenario = Scenario::builtin(name).map_err(|error| failed(&error))?;
        let sensor = scenario.sensor.driver.name();
        println!("{name:14} {} Sensor: {sensor}.", scenario.description);
    }
    Ok(ExitCode::SUCCESS)
}

fn sealed(arguments: &Sealed) -> Outcome {
    let Sealed {
        none, two, outside, ..
    } = arguments;
    if none + two + outside > 1.0 {
        return Err((
            2,
            format!(
                "--none {none}, --two {two} and --outside {outside} add up to more than 1 (those that are not given have these values)"
            ),
        ));
    }
    let options = SealedOptions {
        none: arguments.none,
        two: arguments.two,
        outside: arguments.outside,
        mechanisms: if arguments.bare {
            Mechanisms::Dropped
        } else {
            Mechanisms::Kept
        },
        only: arguments.effect.clone(),
    };
    let shows_progress = std::io::stderr().is_terminal();
    let count = arguments.count.unwrap_or(1);
    for index in 0..count {
        let folder = match arguments.count {
            Some(_) => arguments.output.join(format!("{:04}", index + 1)),
            None => arguments.output.clone(),
        };
        let draw =
            SealedDraw::draw(arguments.seed.wrapping_add(index), &options).map_err(|error| {
                match error {
                    SealedError::UnknownEffect { .. } => (2, error.to_string()),
                    _ => failed(&error),
                }
            })?;
        draw.write(&folder).map_err(|error| failed(&error))?;
        if shows_progress {
            eprint!("\r{} of {count} draws", index + 1);
        }
    }
    if shows_progress {
        eprintln!();
    }
    let folder = arguments.output.display();
    let each = match arguments.count {
        Some(1) => format!("one folder below {folder}, in it"),
        Some(count) => format!("{count} folders below {folder}, in each"),
        None => format!("{folder}:"),
    };
    println!(
        "wrote {each} main.toml and confirm.toml, for ft-capture --sim, and truth.json, for nobody who is to find it out"
    );
    Ok(ExitCode::SUCCESS)
}

fn with_devices(mut scenario: Scenario, sensor: Option<&str>, gripper: Option<&str>) -> Scenario {
    if let Some(sensor) = sensor.and_then(SensorSpec::of) {
        scenario.sensor = sensor;
    }
    if let Some(driver) = gripper.and_then(GripperDriver::named) {
        scenario.gripper.driver = driver;
    }
    scenario
}

fn serve(
    scenario: &Scenario,
    seed: u64,
    duration: Option<Duration>,
    options: ServeOptions,
    truth: Option<PathBuf>,
) -> Outcome {
    let interrupted = Arc::new(AtomicBool::new(false));
    for signal in [signal_hook::consts::SIGINT, signal_hook::consts::SIGTERM] {
        signal_hook::flag::register(signal, interrupted.clone()).map_err(|error| failed(&error))?;
    }
    let clock = MonotonicClock::anchored_now();
    let mut server =
        Server::start(scenario, seed, duration, clock, options).map_err(|error| match error {
            ServeError::Scenario(ScenarioError::TooShort { .. }) | ServeError::Misplaced { .. } => {
                (2, error.to_string())
            }
            _ => failed(&error),
        })?;
    if let Some(path) = &truth {
        write_truth(path, &server)?;
    }
    print_ports(scenario, &server);
    let mut over = false;
    while !interrupted.load(Ordering::Relaxed) {
        for (at, mark) in server.drain_marks() {
            println!("{at}  {mark}");
        }
        if server.is_over() && !over {
            over = true;
            println!("{}  the person is done; the devices go on", clock.now());
        }
        clock.wait_until(clock.now() + Duration::from_millis(50));
    }
    let lost = server.stop();
    if lost > 0 {
        return Err((
            3,
            format!(
                "{lost} bytes or frames were not taken in time by the program that had the port open"
            ),
        ));
    }
    Ok(ExitCode::SUCCESS)
}

fn write_truth(path: &std::path::Path, server: &Server) -> Result<(), (u8, String)> {
    let text = serde_json::to_string_pretty(&server.truth()).map_err(|error| failed(&error))?;
    let refused = |error: std::io::Error| (1, format!("cannot write {}: {error}", path.display()));
    let mut file = std::fs::File::create_new(path).map_err(refused)?;
    std::io::Write::write_all(&mut file, text.as_bytes()).map_err(|error| {
        let _ = std::fs::remove_file(path);
        refused(error)
    })
}

fn print_ports(scenario: &Scenario, server: &Server) {
    println!("{}: {}", scenario.name, scenario.description);
    for served in server.ports() {
        let port = match &served.port {
            Port::Pty(path) => path.display().to_string(),
            Port::Gadget(path) => format!("the host's side of {}", path.display()),
            Port::SocketCan(interface) => interface.clone(),
            Port::CandleLight(path) => format!("the candleLight of {}", path.display()),
            _ => "not reachable: give --vcan INTERFACE".to_owned(),
        };
        let bus = match served.fitted.bus {
            Bus::Serial { baud_bps } => format!("{baud_bps} baud, 8N1"),
            Bus::Can { bitrate_bps } => format!("CAN at {bitrate_bps} bit/s"),
        };
        println!(
            "  {:10} {:14} {port}  ({bus})",
            served.fitted.name, served.fitted.driver
        );
    }
    println!("The person is done at {}; stop with Ctrl-C.", server.end());
}
