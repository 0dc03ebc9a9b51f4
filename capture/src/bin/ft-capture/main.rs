//! `ft-capture`: records what a force-sensing gripper measures.

mod calibrate;
mod files;
mod import;
mod keys;
mod record;
#[cfg(feature = "sim")]
mod simulate;
#[cfg(not(feature = "sim"))]
#[path = "simulate_absent.rs"]
mod simulate;
mod terminal;

use std::net::SocketAddr;
use std::path::PathBuf;
use std::process::ExitCode;
use std::time::Duration;

use clap::{Args, Parser, Subcommand};
use ft_capture::config::is_name;
use ft_capture::{foxglove, logging};
use ft_recording::ReadError;

/// Exit codes: 0 fine, 1 failed, 2 wrong arguments, 3 finished but data was lost.
const LOST: u8 = 3;
const WRONG_ARGUMENTS: u8 = 2;

const EXAMPLES: &str = "Examples:
  ft-capture --sim                                   simulated gripper on a wood door, in real time
  ft-capture --sim --speed max -o door.mcap          the same, as fast as it goes
  ft-capture --sim drawer_loaded --seed 7 --json     another object, another person
  ft-capture --config capture.toml -o door.mcap      real devices, until Ctrl-C
  ft-capture --listen tcp/0.0.0.0:7447               let other machines watch (ft-view --connect ...)
  ft-capture --view 0.0.0.0:8080                     a page for the browsers and phones of this network
  ft-capture keys -o keys --host 192.168.0.7         keys for an encrypted network, with roles
  ft-capture devices                                 what is plugged in
  ft-capture init                                    a first capture.toml from it
  ft-capture check door.mcap                         is the recording whole?
  ft-capture check door.mcap --retime better.mcap    device clocks smoothed over the whole recording, into a new one
  ft-capture check bag.mcap --map /wrench=/ft/wrench  a recording with other topic names
  ft-capture recover door.mcap.partial -o door.mcap  after a crash
  ft-capture calibrate shake.mcap --toml calibration.toml --plot shake.html   the tool's own weight, and the bias
  ft-capture import-aria rec.mcap --mps mps/ -o door.mcap   poses that Project Aria's services computed
  ft-capture import-hoi extracted/kitchen/gripper -o recordings/   the public Hoi! dataset
  ft-capture import-csv --wrench ft.csv --pose pose.csv --rate 120 -o a.mcap   two plain tables
  ft-capture import-bag kitchen_1-3.bag -o wrench.mcap   the wrench of a ROS 1 bag; then import-aria adds the poses

Exit codes: 0 fine, 1 failed, 2 wrong arguments, 3 finished but data was lost.";

/// Records force, torque, pose and gripper width, synchronised, into an MCAP file, and publishes them live.
#[derive(Debug, Parser)]
#[command(version, after_help = EXAMPLES, args_conflicts_with_subcommands = true)]
struct Arguments {
    #[command(subcommand)]
    command: Option<Command>,
    #[command(flatten)]
    record: RecordArguments,
}

/// What a recording needs to know.
#[derive(Debug, Args)]
struct RecordArguments {
    /// Simulated hardware instead of real: a built-in scenario or a TOML file [default scenario: wood_door]
    #[arg(long, value_name = "SCENARIO", num_args = 0..=1, default_missing_value = "wood_door")]
    sim: Option<String>,
    /// Configuration of the real devices
    #[arg(
        long,
        value_name = "FILE",
        default_value = "capture.toml",
        conflicts_with = "sim"
    )]
    config: PathBuf,
    /// The recording [default: named after the scenario, or after the time]
    #[arg(short, long, value_name = "FILE.mcap")]
    output: Option<PathBuf>,
    /// Replace an existing recording
    #[arg(long)]
    force: bool,
    /// Stop after this time, such as 60s or 5min
    #[arg(long, value_parser = ft_capture::stop::duration)]
    duration: Option<Duration>,
    /// Simulation only: 1 in real time through pseudo-terminals, max on the simulated clock
    #[arg(long, value_name = "1|max", default_value = "1", requires = "sim")]
    speed: Speed,
    /// Simulation only: every random thing follows from it
    #[arg(long, default_value_t = 1, requires = "sim")]
    seed: u64,
    /// Simulation only: an existing virtual CAN interface for devices on CAN, such as vcan0
    #[arg(long, value_name = "INTERFACE", requires = "sim")]
    vcan: Option<String>,
    /// Zenoh endpoint to listen on, such as tcp/0.0.0.0:7447 [default: this host only]
    #[arg(long, value_name = "ENDPOINT")]
    listen: Vec<String>,
    /// Zenoh endpoint to connect to
    #[arg(long, value_name = "ENDPOINT")]
    connect: Vec<String>,
    /// Be a Zenoh router on port 7447 of every interface: ROS 2 nodes (rmw_zenoh) need nothing else
    #[arg(long)]
    router: bool,
    /// Names this gripper on the network [default: as in the configuration, or the scenario]
    #[arg(long, value_parser = name)]
    id: Option<String>,
    /// Namespace of its topics, so that several grippers share a network: blue makes /blue/ft/wrench
    #[arg(long, value_name = "NAME", value_parser = name)]
    namespace: Option<String>,
    /// Encrypt the network, with the keys in this folder (ft-capture keys makes them)
    #[arg(long, value_name = "DIR")]
    keys: Option<PathBuf>,
    /// Serve a live page for browsers [without an address: 127.0.0.1:8080, this host only]
    #[arg(long, value_name = "ADDRESS", num_args = 0..=1, default_missing_value = "127.0.0.1:8080")]
    view: Option<SocketAddr>,
    /// Serve Foxglove, Lichtblick and PlotJuggler [without an address: 127.0.0.1:8765, this host only]
    #[arg(long, value_name = "ADDRESS", num_args = 0..=1, default_missing_value = foxglove::DEFAULT_ADDRESS)]
    foxglove: Option<SocketAddr>,
    /// Publish only, write no file until the command `start`
    #[arg(long, conflicts_with_all = ["output", "force"])]
    no_record: bool,
    /// Print the summary as JSON
    #[arg(long)]
    json: bool,
}

/// What can be part of a key.
fn name(text: &str) -> Result<String, String> {
    if is_name(text) {
        Ok(text.to_owned())
    } else {
        Err("letters, digits, - and _".to_owned())
    }
}

/// How fast a simulation goes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Speed {
    RealTime,
    Max,
}

impl std::str::FromStr for Speed {
    type Err = String;
    fn from_str(text: &str) -> Result<Self, String> {
        match text {
            "1" => Ok(Self::RealTime),
            "max" => Ok(Self::Max),
            _ => Err("1 (real time) or max".to_owned()),
        }
    }
}

#[derive(Debug, Subcommand)]
enum Command {
    /// List serial ports, CAN interfaces and HID axes, and which driver may take them
    #[command(after_help = files::DEVICES_EXAMPLES)]
    Devices,
    /// Write a first configuration from what is plugged in
    #[command(after_help = files::INIT_EXAMPLES)]
    Init {
        /// The configuration
        #[arg(short, long, value_name = "FILE", default_value = "capture.toml")]
        output: PathBuf,
        /// Replace an existing file
        #[arg(long)]
        force: bool,
    },
    /// Tell whether a recording is whole: rates, gaps, losses, one verdict
    #[command(after_help = files::CHECK_EXAMPLES)]
    Check {
        /// The recording
        file: PathBuf,
        /// Read a topic of another name: /their/topic=/ft/wrench
        #[arg(long, value_name = "THEIRS=OURS")]
        map: Vec<String>,
        /// Write a new recording whose device clocks are smoothed over the whole recording, and check that
        #[arg(long, value_name = "NEW.mcap")]
        retime: Option<PathBuf>,
        /// Replace an existing NEW.mcap
        #[arg(long, requires = "retime")]
        force: bool,
        /// Print the report as JSON
        #[arg(long)]
        json: bool,
    },
    /// Make a complete recording of what a crash left
    #[command(after_help = files::RECOVER_EXAMPLES)]
    Recover {
        /// The partial or damaged recording; it is not changed
        file: PathBuf,
        /// The new recording [default: the name without .partial]
        #[arg(short, long, value_name = "FILE.mcap")]
        output: Option<PathBuf>,
        /// Replace an existing recording
        #[arg(long)]
        force: bool,
        /// Print what was given back as JSON
        #[arg(long)]
        json: bool,
    },
    /// Send a recording's raw frames through the drivers again, into a new recording
    #[command(after_help = files::REPLAY_EXAMPLES)]
    Replay {
        /// The recording
        file: PathBuf,
        /// The new recording
        #[arg(short, long, value_name = "FILE.mcap")]
        output: PathBuf,
        /// Replace an existing recording
        #[arg(long)]
        force: bool,
        /// Print the summary as JSON
        #[arg(long)]
        json: bool,
    },
    /// Make keys for an encrypted network, with roles
    Keys(keys::KeysArguments),
    /// Find the tool's mass, centre and inertia, the sensor's bias, and the time between pose and wrench
    Calibrate(calibrate::CalibrateArguments),
    /// Add the poses of Project Aria glasses (MPS results) to a recording of the wrench
    ImportAria(import::AriaArguments),
    /// Make recordings of the public Hoi! dataset (its extracted layout)
    ImportHoi(import::HoiArguments),
    /// Make a recording of a wrench and poses that lie in two CSV tables
    ImportCsv(import::CsvArguments),
    /// Make a recording of the wrench of a ROS 1 bag, such as the Hoi! dataset's raw ones
    ImportBag(import::BagArguments),
}

fn main() -> ExitCode {
    logging::to_stderr(tracing::Level::WARN);
    let arguments = Arguments::parse();
    let result = match arguments.command {
        None => record::record(&arguments.record),
        Some(Command::Devices) => files::devices(),
        Some(Command::Init { output, force }) => files::init(&output, force),
        Some(Command::Check {
            file,
            map,
            retime,
            force,
            json,
        }) => files::check(&file, &map, retime.as_deref(), force, json),
        Some(Command::Recover {
            file,
            output,
            force,
            json,
        }) => files::recover(&file, output, force, json),
        Some(Command::Replay {
            file,
            output,
            force,
            json,
        }) => files::replay(&file, &output, force, json),
        Some(Command::Keys(arguments)) => keys::run(&arguments),
        Some(Command::Calibrate(arguments)) => calibrate::run(&arguments),
        Some(Command::ImportAria(arguments)) => import::aria(&arguments),
        Some(Command::ImportHoi(arguments)) => import::hoi(&arguments),
        Some(Command::ImportCsv(arguments)) => import::csv(&arguments),
        Some(Command::ImportBag(arguments)) => import::bag(&arguments),
    };
    match result {
        Ok(Outcome::Fine) => ExitCode::SUCCESS,
        Ok(Outcome::DataLost) => ExitCode::from(LOST),
        Err(error) => {
            terminal::print_error(error.as_ref());
            let is_wrong_map = matches!(error.downcast_ref(), Some(ReadError::Map { .. }));
            if is_wrong_map || simulate::is_wrong_argument(error.as_ref()) {
                return ExitCode::from(WRONG_ARGUMENTS);
            }
            ExitCode::FAILURE
        }
    }
}

/// How a command that did its work ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Outcome {
    Fine,
    DataLost,
}

impl Outcome {
    const fn of(lost: bool) -> Self {
        if lost { Self::DataLost } else { Self::Fine }
    }
}

/// A program's errors go to one place: its last lines.
type CommandResult = Result<Outcome, Box<dyn std::error::Error>>;
