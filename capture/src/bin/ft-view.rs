//! `ft-view`: watch a capture from another terminal or another machine.

use std::io::{IsTerminal, Write};
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use clap::Parser;
use ft_capture::network::{self, DEFAULT_ENDPOINT};
use ft_capture::view::View;
use ft_drivers::{Clock, MonotonicClock};
use zenoh::Wait;

const EXAMPLES: &str = "Examples:
  ft-view                                      what is captured on this host
  ft-view --connect tcp/192.168.0.7:7447       another machine, where `ft-capture --listen tcp/0.0.0.0:7447` runs
  ft-view --duration 10s --plain               ten seconds, one screen at the end, for scripts";

/// Shows live wrench, pose, rates and losses of a running ft-capture.
#[derive(Debug, Parser)]
#[command(version, after_help = EXAMPLES)]
struct Arguments {
    /// Zenoh endpoint of the capture service or of a router
    #[arg(long, default_value = DEFAULT_ENDPOINT)]
    connect: String,
    /// ROS domain id
    #[arg(long, default_value_t = 0)]
    domain: u32,
    /// Stop after this time, such as 10s
    #[arg(long, value_parser = humantime::parse_duration)]
    duration: Option<Duration>,
    /// Do not redraw: print one screen at the end
    #[arg(long)]
    plain: bool,
}

fn main() -> ExitCode {
    let arguments = Arguments::parse();
    match watch(&arguments) {
        Ok(0) => {
            eprintln!(
                "ft-view: nothing was published at {} in domain {}",
                arguments.connect, arguments.domain
            );
            ExitCode::FAILURE
        }
        Ok(_) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!(
                "ft-view: {error}\nIs ft-capture running there, and does it listen (--listen) on that address?"
            );
            ExitCode::FAILURE
        }
    }
}

/// Runs until interrupted; how many wrenches came.
fn watch(arguments: &Arguments) -> Result<u64, Box<dyn std::error::Error>> {
    let stop = Arc::new(AtomicBool::new(false));
    for signal in [signal_hook::consts::SIGINT, signal_hook::consts::SIGTERM] {
        signal_hook::flag::register(signal, Arc::clone(&stop))?;
    }
    let clock = MonotonicClock::anchored_now();
    let session = network::connect(std::slice::from_ref(&arguments.connect))?;
    let (sender, samples) = crossbeam_channel::bounded(8192);
    let _subscriber = session
        .declare_subscriber(format!("{}/**", arguments.domain))
        .callback(move |sample| {
            // A full queue shows as missed sequence numbers.
            let _ = sender.try_send(sample);
        })
        .wait()
        .map_err(|error| error.to_string())?;

    let mut view = View::default();
    let start = clock.now();
    let mut draw_at = start;
    let mut rates_at = start;
    let redraw = !arguments.plain && std::io::stdout().is_terminal();
    while !stop.load(Ordering::Relaxed) {
        let now = clock.now();
        if arguments
            .duration
            .is_some_and(|duration| now.saturating_since(start) >= duration)
        {
            break;
        }
        while let Ok(sample) = samples.recv_timeout(Duration::from_millis(20)) {
            let attachment = sample
                .attachment()
                .map(|bytes| bytes.to_bytes().into_owned());
            view.take(
                sample.key_expr().as_str(),
                &sample.payload().to_bytes(),
                attachment.as_deref(),
            );
            if samples.is_empty() {
                break;
            }
        }
        if now >= rates_at {
            view.measure_rates(now);
            rates_at = now + Duration::from_secs(1);
        }
        if redraw && now >= draw_at {
            let screen = view.render(now).replace('\n', "\x1b[K\n");
            write!(std::io::stdout(), "\x1b[H{screen}\x1b[J")?;
            std::io::stdout().flush()?;
            draw_at = now + Duration::from_millis(100);
        }
    }
    if !redraw {
        view.measure_rates(clock.now());
        print!("{}", view.render(clock.now()));
    }
    Ok(view.received("/ft/wrench"))
}
