//! What a terminal viewer shows: the latest of each topic, rates, and what was missed on the way.

use std::collections::BTreeMap;
use std::fmt::Write as _;

use ft_recording::cdr::CdrError;
use ft_recording::message::{
    DiagnosticArray, JointState, Message, PoseStamped, Text, WrenchStamped,
};
use ft_wire::HostTime;

use crate::rmw;

/// The latest of everything.
#[derive(Debug, Default)]
pub struct View {
    topics: BTreeMap<String, TopicView>,
    wrench: Option<WrenchStamped>,
    pose: Option<PoseStamped>,
    width_m: Option<f64>,
    mark: Option<String>,
    diagnostics: Option<DiagnosticArray>,
    undecodable: u64,
}

/// One topic's account at this viewer.
#[derive(Debug, Default)]
struct TopicView {
    received: u64,
    missed: u64,
    last_sequence: Option<i64>,
    last_source_ns: i64,
    window: Option<(HostTime, u64)>,
    rate_hz: f64,
}

impl View {
    /// Takes one sample of `key` (`<domain>/<topic>/<type>/<hash>`).
    pub fn take(&mut self, key: &str, payload: &[u8], attachment: Option<&[u8]>) {
        let Some((topic, type_name)) = split_key(key) else {
            return;
        };
        let account = self.topics.entry(topic.clone()).or_default();
        account.received += 1;
        if let Some((sequence, source_ns)) = attachment.and_then(rmw::read_attachment) {
            account.count_missed(sequence);
            account.last_source_ns = source_ns;
        }
        if self.decode(&topic, &type_name, payload).is_err() {
            self.undecodable += 1;
        }
    }

    /// Takes the rates anew; to be called about once a second.
    pub fn measure_rates(&mut self, now: HostTime) {
        for account in self.topics.values_mut() {
            if let Some((then, before)) = account.window {
                let seconds = now.seconds_since(then);
                if seconds > 0.0 {
                    account.rate_hz = (account.received - before) as f64 / seconds;
                }
            }
            account.window = Some((now, account.received));
        }
    }

    /// Messages received on `topic`.
    #[must_use]
    pub fn received(&self, topic: &str) -> u64 {
        self.topics.get(topic).map_or(0, |account| account.received)
    }

    fn decode(&mut self, topic: &str, type_name: &str, payload: &[u8]) -> Result<(), CdrError> {
        match (topic, type_name) {
            (_, "WrenchStamped") => self.wrench = Some(WrenchStamped::decode(payload)?),
            (_, "PoseStamped") => self.pose = Some(PoseStamped::decode(payload)?),
            (_, "JointState") => {
                self.width_m = JointState::decode(payload)?.position.first().copied()
            }
            ("/marks", _) => self.mark = Some(Text::decode(payload)?.data),
            (_, "DiagnosticArray") => self.diagnostics = Some(DiagnosticArray::decode(payload)?),
            _ => {}
        }
        Ok(())
    }

    /// The screen: plain text, lines of at most 78 columns.
    #[must_use]
    pub fn render(&self, now: HostTime) -> String {
        let mut screen = String::new();
        self.render_wrench(&mut screen);
        if let Some(pose) = &self.pose {
            let at = &pose.pose.position;
            let _ = writeln!(
                screen,
                "pose   x {:8.3}  y {:8.3}  z {:8.3} m   ({})",
                at.x, at.y, at.z, pose.header.frame_id
            );
        }
        if let Some(width) = self.width_m {
            let _ = writeln!(screen, "width  {:8.1} mm", width * 1e3);
        }
        if let Some(mark) = &self.mark {
            let _ = writeln!(screen, "mark   {mark}");
        }
        let _ = writeln!(
            screen,
            "\n{:<24}{:>9}{:>10}{:>8}{:>11}",
            "topic", "rate/Hz", "received", "missed", "age/ms"
        );
        for (topic, account) in &self.topics {
            let age = now.seconds_since(HostTime::from_nanos(account.last_source_ns)) * 1e3;
            let _ = writeln!(
                screen,
                "{topic:<24}{:>9.1}{:>10}{:>8}{age:>11.1}",
                account.rate_hz, account.received, account.missed
            );
        }
        if self.undecodable > 0 {
            let _ = writeln!(screen, "{} messages could not be decoded", self.undecodable);
        }
        for status in self.diagnostics.iter().flat_map(|array| &array.status) {
            let level = ["ok", "WARN", "ERROR", "STALE"]
                .get(usize::from(status.level))
                .unwrap_or(&"?");
            let _ = writeln!(screen, "{level:<6}{}: {}", status.name, status.message);
        }
        screen
    }

    fn render_wrench(&self, screen: &mut String) {
        let Some(message) = &self.wrench else {
            let _ = writeln!(screen, "no wrench yet");
            return;
        };
        let (force, torque) = (&message.wrench.force, &message.wrench.torque);
        for (name, value, full, unit) in [
            ("fx", force.x, 50.0, "N"),
            ("fy", force.y, 50.0, "N"),
            ("fz", force.z, 50.0, "N"),
            ("tx", torque.x, 5.0, "N m"),
            ("ty", torque.y, 5.0, "N m"),
            ("tz", torque.z, 5.0, "N m"),
        ] {
            let _ = writeln!(screen, "{name} {value:9.3} {unit:<4}{}", bar(value / full));
        }
    }
}

impl TopicView {
    /// Sequence numbers count from 1 at the publisher; a restart begins anew.
    fn count_missed(&mut self, sequence: i64) {
        if let Some(last) = self.last_sequence
            && sequence > last
        {
            self.missed += u64::try_from(sequence - last - 1).unwrap_or(0);
        }
        self.last_sequence = Some(sequence);
    }
}

/// Topic (with its slash) and message name of a key expression.
fn split_key(key: &str) -> Option<(String, String)> {
    let (rest, _hash) = key.rsplit_once('/')?;
    let (rest, dds_type) = rest.rsplit_once('/')?;
    let (_domain, topic) = rest.split_once('/')?;
    let message = dds_type.rsplit("::").next()?.trim_end_matches('_');
    Some((format!("/{topic}"), message.to_owned()))
}

/// A bar of 41 columns around its middle; full at ±1.
fn bar(fraction: f64) -> String {
    const HALF: usize = 20;
    let length = ((fraction.abs() * HALF as f64).round() as usize).min(HALF);
    let (empty, full) = (" ".repeat(HALF - length), "#".repeat(length));
    let rest = " ".repeat(HALF);
    if fraction < 0.0 {
        format!("{empty}{full}|{rest}")
    } else {
        format!("{rest}|{full}{empty}")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const KEY: &str = "0/ft/wrench/geometry_msgs::msg::dds_::WrenchStamped_/RIHS01_8d";

    fn wrench() -> Vec<u8> {
        let mut message = WrenchStamped::default();
        message.wrench.force.x = -25.0;
        let mut bytes = Vec::new();
        message.encode(&mut bytes);
        bytes
    }

    #[test]
    fn a_sample_is_shown_and_counted() {
        let mut view = View::default();
        view.take(KEY, &wrench(), Some(&rmw::attachment(1, 5, [0; 16])));
        view.take(KEY, &wrench(), Some(&rmw::attachment(4, 6, [0; 16])));
        assert_eq!(view.received("/ft/wrench"), 2);
        let screen = view.render(HostTime::from_nanos(6));
        assert!(
            screen.contains("fx   -25.000 N             ##########|"),
            "{screen}"
        );
        let line = screen
            .lines()
            .find(|line| line.starts_with("/ft/wrench"))
            .unwrap();
        assert_eq!(
            line.split_whitespace().collect::<Vec<_>>()[2..4],
            ["2", "2"],
            "{line}"
        );
    }

    #[test]
    fn what_is_no_message_is_counted() {
        let mut view = View::default();
        view.take(KEY, &wrench()[..20], None);
        assert!(
            view.render(HostTime::EPOCH)
                .contains("1 messages could not be decoded")
        );
    }
}
