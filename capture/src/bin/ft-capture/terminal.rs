//! What the operator sees while a session runs.

use std::io::{IsTerminal, Write};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use ft_capture::health::Health;
use ft_capture::session::live::Surroundings;
use ft_wire::HostTime;
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};

/// Prints an error and what caused it, on one line each. A terminal that was closed takes none.
pub(crate) fn print_error(error: &dyn std::error::Error) {
    let mut said = error.to_string();
    let mut out = std::io::stderr();
    let _ = writeln!(out, "ft-capture: {said}");
    let mut cause = error.source();
    while let Some(inner) = cause {
        let text = inner.to_string();
        if !said.contains(&text) {
            let _ = writeln!(out, "  because: {text}");
            said = text;
        }
        cause = inner.source();
    }
}

/// Prints a result. A reader that has gone (`| head`) is no error.
pub(crate) fn say(text: &str) -> std::io::Result<()> {
    let written = writeln!(std::io::stdout().lock(), "{text}");
    match written {
        Err(error) if error.kind() == std::io::ErrorKind::BrokenPipe => Ok(()),
        other => other,
    }
}

/// A bar over `total`, or a spinner when the end is not known; hidden when nobody looks.
pub(crate) fn bar(total: Option<Duration>) -> ProgressBar {
    let bar = ProgressBar::with_draw_target(
        total.map(|total| total.as_millis().try_into().unwrap_or(u64::MAX)),
        if std::io::stderr().is_terminal() {
            ProgressDrawTarget::stderr()
        } else {
            ProgressDrawTarget::hidden()
        },
    );
    let template = if total.is_some() {
        "{bar:30} {percent:>3}% {msg}"
    } else {
        "{spinner} {msg}"
    };
    if let Ok(style) = ProgressStyle::with_template(template) {
        bar.set_style(style);
    }
    bar
}

/// Takes the operator's marks of a simulation.
type TakeMarks<'a> = Box<dyn FnMut() -> Vec<(HostTime, String)> + 'a>;

/// A session at a terminal.
pub(crate) struct Operator<'a> {
    pub(crate) stop: Arc<AtomicBool>,
    pub(crate) take_marks: TakeMarks<'a>,
    pub(crate) is_over: Box<dyn Fn() -> bool + 'a>,
    pub(crate) bar: ProgressBar,
    pub(crate) shown_at: Duration,
}

impl Surroundings for Operator<'_> {
    fn wants_end(&mut self) -> bool {
        self.stop.load(Ordering::Relaxed) || (self.is_over)()
    }

    fn marks(&mut self) -> Vec<(HostTime, String)> {
        (self.take_marks)()
    }

    fn log(&mut self, line: &str) {
        // A terminal that was closed takes no line, and the file is still to be finished.
        self.bar
            .suspend(|| drop(writeln!(std::io::stderr(), "{line}")));
    }

    fn progress(&mut self, elapsed: Duration, health: &Health, bytes: u64) {
        if elapsed < self.shown_at {
            return;
        }
        self.shown_at = elapsed + Duration::from_millis(200);
        self.bar
            .set_position(elapsed.as_millis().try_into().unwrap_or(u64::MAX));
        let mut message = format!(
            "{:.0} s  {:.1} MB",
            elapsed.as_secs_f64(),
            bytes as f64 * 1e-6
        );
        for stream in health.summary() {
            let ledger = stream.ledger;
            let lost = ledger.gaps + ledger.drops + ledger.refused;
            message += &format!("  {} {:.0} Hz", stream.name, stream.rate_hz);
            if lost > 0 {
                message += &format!(" ({lost} lost)");
            }
        }
        self.bar.set_message(message);
    }
}
