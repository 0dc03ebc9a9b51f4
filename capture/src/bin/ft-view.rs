//! `ft-view`: watch a capture from another terminal or another machine.

use std::io::IsTerminal;
use std::net::SocketAddr;
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use clap::Parser;
use ft_capture::live::Hub;
use ft_capture::live::picture::Picture;
use ft_capture::network::{self, DEFAULT_ENDPOINT};
use ft_capture::remote::recorder::Recorder;
use ft_capture::remote::{Remote, Which};
use ft_capture::session::control::Command;
use ft_capture::sink::SinkError;
use ft_capture::stop::stop_flag;
use ft_capture::terminal::{self, Desk};
use ft_capture::web::{self, Operator};
use ft_capture::{foxglove, logging};
use ft_drivers::{Clock, MonotonicClock};
use ft_recording::topic;
use ft_wire::HostTime;
use ratatui::crossterm::event::{self, Event, KeyCode, KeyEventKind, KeyModifiers};

const EXAMPLES: &str = "Examples:
  ft-view                                      what is captured on this host
  ft-view --connect tcp/192.168.0.7:7447       another machine, where `ft-capture --listen tcp/0.0.0.0:7447` runs
  ft-view --connect tcp/192.168.0.7:7447 --web a live page for the browser on this machine
  ft-view --namespace blue                     of several grippers the one with `[network] namespace = \"blue\"`
  ft-view --connect tcp/192.168.0.7:7447 --record door.mcap    a recording on this machine, until Ctrl-C
  ft-view --duration 10s --plain               ten seconds, one screen at the end, for scripts

Keys: q quit, t tare, m mark, s start a recording, x twice stop it.
Exit codes: 0 fine, 1 failed or nothing came, 2 wrong arguments, 3 finished but data was lost.";

/// Shows live wrench, pose, rates and losses of a running ft-capture, and sends it commands.
#[derive(Debug, Parser)]
#[command(version, after_help = EXAMPLES)]
struct Arguments {
    /// Zenoh endpoint of the capture service or of a router
    #[arg(long, default_value = DEFAULT_ENDPOINT)]
    connect: String,
    /// This viewer's keys, when the capture has some (ft-capture keys makes them)
    #[arg(long, value_name = "DIR")]
    keys: Option<PathBuf>,
    /// ROS domain id
    #[arg(long, default_value_t = 0)]
    domain: u32,
    /// Namespace of the gripper's topics
    #[arg(long, default_value = "")]
    namespace: String,
    /// Id of the gripper [default: the first that answers]
    #[arg(long)]
    id: Option<String>,
    /// Serve a live page for browsers [without an address: 127.0.0.1:8080, this host only]
    #[arg(long, value_name = "ADDRESS", num_args = 0..=1, default_missing_value = "127.0.0.1:8080")]
    web: Option<SocketAddr>,
    /// Serve Foxglove, Lichtblick and PlotJuggler [without an address: 127.0.0.1:8765, this host only]
    #[arg(long, value_name = "ADDRESS", num_args = 0..=1, default_missing_value = foxglove::DEFAULT_ADDRESS)]
    foxglove: Option<SocketAddr>,
    /// Record what is published, without loss: what the network lost is asked for again
    #[arg(long, value_name = "FILE.mcap")]
    record: Option<PathBuf>,
    /// Replace an existing recording
    #[arg(long, requires = "record")]
    force: bool,
    /// Print the recording's account as JSON
    #[arg(long, requires = "record")]
    json: bool,
    /// Stop after this time, such as 10s
    #[arg(long, value_parser = ft_capture::stop::duration)]
    duration: Option<Duration>,
    /// Do not draw: print one screen at the end
    #[arg(long)]
    plain: bool,
}

/// Exit code: finished, but data was lost.
const LOST: u8 = 3;

type Failure = Box<dyn std::error::Error>;

fn main() -> ExitCode {
    logging::to_stderr(tracing::Level::ERROR);
    let arguments = Arguments::parse();
    match watch(&arguments) {
        Ok(Outcome::Nothing) => {
            eprintln!(
                "ft-view: no wrench was published at {} in domain {}{}",
                arguments.connect,
                arguments.domain,
                match arguments.namespace.as_str() {
                    "" => String::new(),
                    namespace => format!(" and namespace {namespace}"),
                }
            );
            ExitCode::FAILURE
        }
        Ok(Outcome::Fine) => ExitCode::SUCCESS,
        Ok(Outcome::DataLost) => ExitCode::from(LOST),
        Err(error) => {
            eprintln!("ft-view: {error}");
            if let Some(SinkError::Zenoh { .. }) = error.downcast_ref() {
                eprintln!(
                    "Is ft-capture running there, and does it listen (--listen) on that address?"
                );
            }
            ExitCode::FAILURE
        }
    }
}

/// How it ended.
enum Outcome {
    Nothing,
    Fine,
    DataLost,
}

/// Runs until interrupted.
fn watch(arguments: &Arguments) -> Result<Outcome, Failure> {
    if arguments.keys.is_some() {
        // SAFETY: the main thread has read its arguments and started nothing.
        unsafe { network::receive_and_send_in_one_thread() };
    }
    let stop = stop_flag()?;
    let clock = MonotonicClock::anchored_now();
    let session = network::connect(
        std::slice::from_ref(&arguments.connect),
        arguments.keys.as_deref(),
    )?;
    let hub = Arc::new(Hub::new(&arguments.connect));
    let which = Which {
        domain_id: arguments.domain,
        namespace: arguments.namespace.clone(),
        id: arguments.id.clone(),
    };
    let remote = Arc::new(Remote::watch(session, which, Arc::clone(&hub), clock)?);
    let recorder = arguments
        .record
        .as_ref()
        .map(|path| Recorder::begin(&remote, path, arguments.force, clock))
        .transpose()?;
    let _page = arguments
        .web
        .map(|address| {
            let operator = Arc::clone(&remote);
            let page = web::serve_page(Arc::clone(&hub), operator, address, None)?;
            eprintln!("live page: {}", page.url());
            Ok::<_, Failure>(page)
        })
        .transpose()?;
    let _foxglove = arguments
        .foxglove
        .map(|address| {
            let server = foxglove::serve(Arc::clone(&hub), address)?;
            eprintln!("foxglove: ws://{}", server.address);
            Ok::<_, Failure>(server)
        })
        .transpose()?;
    if let Some(path) = &arguments.record {
        eprintln!("recording {}: Ctrl-C finishes it", path.display());
    }
    let serves = recorder.is_some() || arguments.web.is_some() || arguments.foxglove.is_some();
    let watching = Watching {
        clock,
        until: arguments.duration.map(|duration| clock.now() + duration),
        stop,
        hub: Arc::clone(&hub),
        remote,
        recorder: recorder.as_ref(),
    };
    let draws = !arguments.plain && !serves && std::io::stdout().is_terminal();
    if draws {
        watching.draw()?;
    } else {
        watching.wait();
        if !serves {
            print!(
                "{}",
                hub.look(|picture| terminal::plain(picture, clock.now()))
            );
        }
    }
    if let Some(recorder) = recorder {
        let summary = recorder.finish()?;
        if arguments.json {
            println!("{}", serde_json::to_string_pretty(&summary)?);
        } else {
            println!("{summary}");
        }
        return Ok(if summary.lost_data() {
            Outcome::DataLost
        } else if summary.is_empty() {
            Outcome::Nothing
        } else {
            Outcome::Fine
        });
    }
    match hub.look(|picture| picture.received(topic::WRENCH)) {
        0 => {
            if let Some(others) = hub.look(others) {
                eprintln!("{others}");
            }
            Ok(Outcome::Nothing)
        }
        _ => Ok(Outcome::Fine),
    }
}

/// What is said before a recording is stopped: the capture may end with it.
fn asks_to_stop(picture: &Picture) -> &'static str {
    let status = picture.status.as_ref();
    let ends = status.and_then(|(status, _)| status["stop_ends_session"].as_bool());
    if ends == Some(true) {
        "x again finishes the recording and ends the capture"
    } else {
        "x again finishes the recording"
    }
}

/// The topics that are published beside those of the gripper that was asked for, where there are some.
fn others(picture: &Picture) -> Option<String> {
    let names: Vec<&str> = picture.topics.keys().map(AsRef::as_ref).collect();
    (!names.is_empty()).then(|| {
        format!(
            "There are {}: `/blue/ft/wrench` is of the gripper that --namespace blue shows",
            names.join(", ")
        )
    })
}

/// What runs until it is ended.
struct Watching<'a> {
    clock: MonotonicClock,
    until: Option<HostTime>,
    stop: Arc<AtomicBool>,
    hub: Arc<Hub>,
    remote: Arc<Remote>,
    recorder: Option<&'a Recorder>,
}

impl Watching<'_> {
    /// Feeds the page's time and asks for the status; false when it is over.
    fn turn(&self, status_due: &mut HostTime) -> bool {
        let now = self.clock.now();
        if now >= *status_due {
            *status_due = now + Duration::from_millis(500);
            self.remote.ask_status();
        }
        self.hub.tick(now);
        let failed = self.recorder.is_some_and(Recorder::has_failed);
        !failed && !self.stop.load(Ordering::Relaxed) && self.until.is_none_or(|until| now < until)
    }

    fn wait(&self) {
        let mut status_due = self.clock.now();
        while self.turn(&mut status_due) {
            self.clock
                .wait_until(self.clock.now() + Duration::from_millis(10));
        }
    }

    fn draw(&self) -> Result<(), Failure> {
        let mut terminal = ratatui::try_init()?;
        let drawn = self.draw_until_over(&mut terminal);
        ratatui::restore();
        drawn
    }

    fn draw_until_over(&self, terminal: &mut ratatui::DefaultTerminal) -> Result<(), Failure> {
        let (mut desk, mut status_due) = (Desk::default(), self.clock.now());
        let (mut draw_due, mut over) = (status_due, false);
        while self.turn(&mut status_due) && !over {
            let now = self.clock.now();
            if now >= draw_due {
                draw_due = now + Duration::from_millis(100);
                self.hub.look(|picture| {
                    terminal
                        .draw(|frame| terminal::draw(frame, picture, &desk, now))
                        .map(|_| ())
                })?;
            }
            if event::poll(Duration::from_millis(10))?
                && let Event::Key(key) = event::read()?
                && key.kind == KeyEventKind::Press
            {
                over = key.code == KeyCode::Char('c') && key.modifiers == KeyModifiers::CONTROL
                    || self.press(key.code, &mut desk);
            }
        }
        Ok(())
    }

    /// True for the key that ends it.
    fn press(&self, key: KeyCode, desk: &mut Desk) -> bool {
        if let Some(text) = &mut desk.writing {
            match key {
                KeyCode::Char(c) if text.len() < 200 => text.push(c),
                KeyCode::Backspace => drop(text.pop()),
                KeyCode::Esc => desk.writing = None,
                KeyCode::Enter => {
                    let text = std::mem::take(text);
                    desk.writing = None;
                    if !text.is_empty() {
                        desk.answer = self.command(Command::Mark(text));
                    }
                }
                _ => {}
            }
            return false;
        }
        let asked = std::mem::take(&mut desk.stopping);
        match key {
            KeyCode::Char('q') => return true,
            KeyCode::Char('m') => desk.writing = Some(String::new()),
            KeyCode::Char('t') => desk.answer = self.command(Command::Tare),
            KeyCode::Char('s') => desk.answer = self.command(Command::Start(None)),
            KeyCode::Char('x') if asked => desk.answer = self.command(Command::Stop),
            KeyCode::Char('x') => {
                desk.stopping = true;
                desk.answer = self.hub.look(|picture| asks_to_stop(picture).to_owned());
            }
            _ => {}
        }
        false
    }

    fn command(&self, command: Command) -> String {
        let (name, _) = command.name_and_argument();
        let said = self.remote.ask(command);
        match (said["error"].as_str(), said["file"].as_str()) {
            (Some(error), _) => format!("{name}: {error}"),
            (None, Some(file)) => format!("{name}: {file}"),
            (None, None) => format!("{name}: done"),
        }
    }
}
