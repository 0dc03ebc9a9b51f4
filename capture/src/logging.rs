//! What the programs say on standard error: warnings, and each of Zenoh's at most once a minute, so that who knocks a
//! thousand times does not fill a disk.

use std::collections::HashMap;
use std::io::IsTerminal as _;
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

use ft_drivers::{Clock, MonotonicClock};
use ft_wire::HostTime;
use tracing::callsite::Identifier;
use tracing::{Event, Level, Metadata};
use tracing_subscriber::Layer as _;
use tracing_subscriber::layer::{Context, Filter, SubscriberExt as _};
use tracing_subscriber::util::SubscriberInitExt as _;

/// How long a line of Zenoh's stays said.
const QUIET: Duration = Duration::from_secs(60);

/// Tells as errors of data that still come for what was just undeclared, as at every end. What fails there is also returned to us.
const SESSION: &str = "zenoh::api::session";

/// Sends what is at least as bad as `level` to standard error.
pub fn to_stderr(level: Level) {
    let once = OncePerMinute {
        level,
        clock: MonotonicClock::anchored_now(),
        said: Mutex::default(),
    };
    let lines = tracing_subscriber::fmt::layer()
        .with_writer(std::io::stderr)
        // It would be said on a terminal that was closed, and panic, while the file is still to be finished.
        .log_internal_errors(false)
        .with_ansi(std::io::stderr().is_terminal());
    tracing_subscriber::registry()
        .with(lines.with_filter(once))
        .init();
}

/// Lets each place in Zenoh's code speak once a minute. There are as many entries as places.
struct OncePerMinute {
    level: Level,
    clock: MonotonicClock,
    said: Mutex<HashMap<Identifier, HostTime>>,
}

impl<S> Filter<S> for OncePerMinute {
    fn enabled(&self, metadata: &Metadata<'_>, _: &Context<'_, S>) -> bool {
        *metadata.level() <= self.level && metadata.target() != SESSION
    }

    fn event_enabled(&self, event: &Event<'_>, _: &Context<'_, S>) -> bool {
        let metadata = event.metadata();
        if !metadata.target().starts_with("zenoh") {
            return true;
        }
        let now = self.clock.now();
        let mut said = self.said.lock().unwrap_or_else(PoisonError::into_inner);
        let last = said.get(&metadata.callsite());
        if last.is_some_and(|then| now.saturating_since(*then) < QUIET) {
            return false;
        }
        said.insert(metadata.callsite(), now);
        true
    }

    fn max_level_hint(&self) -> Option<tracing::level_filters::LevelFilter> {
        Some(self.level.into())
    }
}
