//! The live view in a terminal; it works over ssh.

use std::collections::VecDeque;

use ft_wire::HostTime;
use ratatui::Frame;
use ratatui::buffer::Buffer;
use ratatui::layout::{Constraint, Layout, Rect};
use ratatui::style::{Color, Modifier, Style, Stylize};
use ratatui::symbols::Marker;
use ratatui::text::{Line, Span};
use ratatui::widgets::{
    Axis, Block, Cell, Chart, Dataset, GraphType, Paragraph, Row, Table, Widget,
};
use serde_json::Value;

use crate::live::picture::Picture;
use crate::live::strip::Bin;

/// Seconds of the strips.
const SECONDS: f64 = 10.0;
/// x, y, z.
const COLOURS: [Color; 3] = [Color::Red, Color::Green, Color::Blue];

/// What the operator is doing.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Desk {
    /// The mark that is being written, if one is.
    pub writing: Option<String>,
    /// What the last command was answered.
    pub answer: String,
    /// Whether the next press of the same key stops the recording.
    pub stopping: bool,
}

/// Draws everything.
pub fn draw(frame: &mut Frame<'_>, picture: &Picture, desk: &Desk, now: HostTime) {
    render(frame.buffer_mut(), picture, desk, now);
}

/// One screen as plain text, without colours and without trailing spaces.
#[must_use]
pub fn plain(picture: &Picture, now: HostTime) -> String {
    let mut buffer = Buffer::empty(Rect::new(0, 0, 78, 40));
    render(&mut buffer, picture, &Desk::default(), now);
    let mut text = String::new();
    for y in 0..buffer.area.height {
        let line: String = (0..buffer.area.width)
            .filter_map(|x| buffer.cell((x, y)).map(|cell| cell.symbol().to_owned()))
            .collect();
        text.push_str(line.trim_end());
        text.push('\n');
    }
    format!("{}\n", text.trim_end())
}

fn render(buffer: &mut Buffer, picture: &Picture, desk: &Desk, now: HostTime) {
    let streams = streams(picture);
    let tables = 3 + streams.len().max(1) + picture.topics.len().max(1);
    let [title, strips, numbers, table, marks, foot] = Layout::vertical([
        Constraint::Length(2),
        Constraint::Min(6),
        Constraint::Length(3),
        Constraint::Length(u16::try_from(tables).unwrap_or(u16::MAX)),
        Constraint::Length(u16::try_from(picture.marks.len().min(3)).unwrap_or(0)),
        Constraint::Length(2),
    ])
    .areas(buffer.area);
    title_lines(picture, now).render(title, buffer);
    let [force, torque] =
        Layout::horizontal([Constraint::Percentage(50), Constraint::Percentage(50)]).areas(strips);
    let wrench = picture.wrench.map(|(wrench, _)| wrench);
    strip(buffer, force, "force / N", &picture.history, 0, 1.0);
    strip(buffer, torque, "torque / N m", &picture.history, 3, 0.1);
    number_lines(picture, wrench).render(numbers, buffer);
    let [devices, topics] = Layout::vertical([
        Constraint::Length(u16::try_from(1 + streams.len().max(1)).unwrap_or(u16::MAX)),
        Constraint::Min(1),
    ])
    .areas(table);
    device_table(&streams).render(devices, buffer);
    topic_table(picture, now).render(topics, buffer);
    mark_lines(picture).render(marks, buffer);
    foot_lines(desk).render(foot, buffer);
}

fn streams(picture: &Picture) -> Vec<&Value> {
    let status = picture
        .status
        .as_ref()
        .map(|(status, _)| &status["streams"]);
    status
        .and_then(Value::as_array)
        .map_or_else(Vec::new, |streams| streams.iter().collect())
}

fn title_lines(picture: &Picture, now: HostTime) -> Paragraph<'static> {
    let Some((status, at)) = &picture.status else {
        return Paragraph::new(vec![
            Line::from(vec![
                Span::raw("ForceTwin").bold(),
                Span::raw(format!("  {}", picture.source)),
            ]),
            Line::from("no word from the capture yet".yellow()),
        ]);
    };
    let recording = match status["recording"].as_str() {
        Some(file) => Span::raw(format!(
            "● {file}  {:.1} MB  {:.0} s",
            status["bytes"].as_f64().unwrap_or(0.0) * 1e-6,
            status["recording_s"].as_f64().unwrap_or(0.0)
        ))
        .red(),
        None => Span::raw("not recording"),
    };
    let age = now.seconds_since(*at);
    let link = if age > 3.0 {
        Span::raw(format!("no word for {age:.0} s")).yellow()
    } else {
        Span::raw("live").green()
    };
    let id = status["id"].as_str().unwrap_or("?").to_owned();
    Paragraph::new(vec![
        Line::from(vec![
            Span::raw(id).bold(),
            Span::raw(format!("  {}  ", picture.source)),
            link,
        ]),
        Line::from(recording),
    ])
}

fn strip(
    buffer: &mut Buffer,
    area: Rect,
    title: &str,
    history: &VecDeque<Bin>,
    offset: usize,
    least: f64,
) {
    let newest = history.back().map_or(0, |bin| bin.begin_ns);
    let mut points: [Vec<(f64, f64)>; 3] = Default::default();
    let mut bound = least;
    for bin in history {
        let age = (bin.begin_ns - newest) as f64 * 1e-9;
        if age < -SECONDS {
            continue;
        }
        for (axis, points) in points.iter_mut().enumerate() {
            for value in [bin.least[offset + axis], bin.greatest[offset + axis]] {
                let value = f64::from(value);
                bound = bound.max(value.abs());
                points.push((age, value));
            }
        }
    }
    let sets = ["x", "y", "z"]
        .into_iter()
        .zip(&points)
        .zip(COLOURS)
        .map(|((name, points), colour)| {
            Dataset::default()
                .name(name)
                .marker(Marker::Braille)
                .graph_type(GraphType::Line)
                .style(Style::new().fg(colour))
                .data(points)
        })
        .collect();
    Chart::new(sets)
        .block(Block::bordered().title(title.to_owned()))
        .legend_position(None)
        .x_axis(Axis::default().bounds([-SECONDS, 0.0]))
        .y_axis(Axis::default().bounds([-bound, bound]).labels([
            format!("{:.1}", -bound),
            "0".to_owned(),
            format!("{bound:.1}"),
        ]))
        .render(area, buffer);
}

fn number_lines(picture: &Picture, wrench: Option<[f64; 6]>) -> Paragraph<'static> {
    let wrench = wrench.map_or_else(
        || Line::from("no wrench yet"),
        |[fx, fy, fz, tx, ty, tz]| {
            Line::from(vec![
                Span::raw("force "),
                Span::raw(format!("{fx:8.2} ")).fg(COLOURS[0]),
                Span::raw(format!("{fy:8.2} ")).fg(COLOURS[1]),
                Span::raw(format!("{fz:8.2} N")).fg(COLOURS[2]),
                Span::raw("  torque "),
                Span::raw(format!("{tx:7.3} ")).fg(COLOURS[0]),
                Span::raw(format!("{ty:7.3} ")).fg(COLOURS[1]),
                Span::raw(format!("{tz:7.3} N m")).fg(COLOURS[2]),
            ])
        },
    );
    let pose = picture.world_from_tcp().map_or_else(
        || "no pose".to_owned(),
        |pose| {
            let at = pose.translation.vector;
            format!("tool at {:8.3} {:8.3} {:8.3} m", at.x, at.y, at.z)
        },
    );
    let width = picture.width_m.map_or_else(
        || "no width".to_owned(),
        |width| format!("width {:.1} mm", width * 1e3),
    );
    let mut third = String::new();
    if picture.undecodable > 0 {
        third = format!("{} messages could not be decoded", picture.undecodable);
    }
    Paragraph::new(vec![
        wrench,
        Line::from(format!("{pose}   {width}")),
        Line::from(third),
    ])
}

fn device_table(streams: &[&Value]) -> Table<'static> {
    let number = |value: &Value| value.as_u64().unwrap_or(0);
    let rows: Vec<Row<'static>> = streams
        .iter()
        .map(|stream| {
            let state = stream["state"].as_str().unwrap_or("?").to_owned();
            let lost =
                number(&stream["gaps"]) + number(&stream["drops"]) + number(&stream["refused"]);
            let style = match (state.as_str(), lost) {
                ("streaming", 0) => Style::new(),
                ("streaming", _) => Style::new().fg(Color::Yellow),
                _ => Style::new().fg(Color::Red),
            };
            let spread = stream["clock"]["spread_us"].as_f64();
            Row::new([
                stream["name"].as_str().unwrap_or("?").to_owned(),
                state,
                format!("{:.1}", stream["rate_hz"].as_f64().unwrap_or(0.0)),
                number(&stream["gaps"]).to_string(),
                number(&stream["drops"]).to_string(),
                number(&stream["refused"]).to_string(),
                spread.map_or_else(|| "-".to_owned(), |spread| format!("{spread:.0}")),
            ])
            .style(style)
        })
        .collect();
    let widths = [16, 10, 9, 8, 8, 8, 9].map(Constraint::Length);
    Table::new(rows, widths).header(head(&[
        "device",
        "state",
        "rate/Hz",
        "gaps",
        "drops",
        "refused",
        "spread/us",
    ]))
}

fn topic_table(picture: &Picture, now: HostTime) -> Table<'static> {
    let rows: Vec<Row<'static>> = picture
        .topics
        .iter()
        .map(|(name, topic)| {
            let age = now.seconds_since(HostTime::from_nanos(topic.last_ns)) * 1e3;
            let style = if topic.missed > 0 {
                Style::new().fg(Color::Yellow)
            } else {
                Style::new()
            };
            Row::new([
                name.clone(),
                format!("{:.1}", topic.rate_hz),
                topic.received.to_string(),
                topic.missed.to_string(),
                format!("{age:.1}"),
            ])
            .style(style)
        })
        .collect();
    let widths = [27, 9, 10, 8, 11].map(Constraint::Length);
    Table::new(rows, widths).header(head(&["topic", "rate/Hz", "received", "missed", "age/ms"]))
}

fn head(names: &[&'static str]) -> Row<'static> {
    Row::new(
        names
            .iter()
            .map(|name| Cell::from(*name))
            .collect::<Vec<_>>(),
    )
    .style(Style::new().add_modifier(Modifier::BOLD))
}

fn mark_lines(picture: &Picture) -> Paragraph<'static> {
    let lines: Vec<_> = picture
        .marks
        .iter()
        .rev()
        .take(3)
        .map(|mark| Line::from(format!("mark   {}", printable(&mark.text))))
        .collect();
    Paragraph::new(lines)
}

fn foot_lines(desk: &Desk) -> Paragraph<'static> {
    let keys = match &desk.writing {
        Some(text) => format!(
            "mark: {}_   (Enter sends it, Esc does not)",
            printable(text)
        ),
        None => "q quit   t tare   m mark   s start   x x stop".to_owned(),
    };
    Paragraph::new(vec![
        Line::from(printable(&desk.answer)),
        Line::from(keys).dim(),
    ])
}

/// A mark comes from anybody: nothing in it steers the terminal.
fn printable(text: &str) -> String {
    text.chars()
        .map(|c| if c.is_control() { '\u{fffd}' } else { c })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::live::{Hub, Sample};
    use ft_recording::message::{Message, Text, WrenchStamped};
    use ft_recording::topic;
    use ratatui::Terminal;
    use ratatui::backend::TestBackend;
    use serde_json::json;

    fn hub() -> Hub {
        let hub = Hub::new("tcp/10.0.0.7:7447");
        let mut payload = Vec::new();
        for index in 0..2000_i64 {
            let mut message = WrenchStamped::default();
            message.wrench.force.x = -25.0;
            message.wrench.torque.z = 0.125;
            message.encode(&mut payload);
            let at = HostTime::from_nanos(index * 1_000_000);
            // One in a thousand is lost.
            if index != 1000 {
                hub.take(&Sample {
                    topic: topic::WRENCH,
                    type_name: WrenchStamped::TYPE_NAME,
                    payload: &payload,
                    at,
                    numbered: Some(([7; 16], index + 1)),
                });
            }
            hub.tick(at);
        }
        Text {
            data: "grasp\u{1b}[2J".to_owned(),
        }
        .encode(&mut payload);
        hub.take(&Sample {
            topic: topic::MARKS,
            type_name: Text::TYPE_NAME,
            payload: &payload,
            at: HostTime::EPOCH,
            numbered: None,
        });
        let status = json!({"ok": true, "id": "blue", "recording": "door.mcap", "bytes": 2_500_000, "recording_s": 31.0,
            "streams": [{"name": "ft_sensor", "state": "streaming", "rate_hz": 999.6, "gaps": 3, "drops": 0, "refused": 0,
                "clock": {"spread_us": 41.7}}]});
        hub.set_status(status, HostTime::from_nanos(2_000_000_000));
        hub
    }

    fn screen(width: u16, height: u16, desk: &Desk) -> String {
        let mut terminal = Terminal::new(TestBackend::new(width, height)).unwrap();
        let now = HostTime::from_nanos(2_004_000_000);
        hub().look(|picture| {
            terminal
                .draw(|frame| draw(frame, picture, desk, now))
                .unwrap();
        });
        terminal.backend().to_string()
    }

    #[test]
    fn everything_that_matters_is_on_the_screen() {
        let screen = screen(80, 30, &Desk::default());
        for wanted in [
            "blue  tcp/10.0.0.7:7447  live",
            "● door.mcap  2.5 MB  31 s",
            "force   -25.00",
            "0.125 N m",
            "ft_sensor        streaming  999.6     3        0        0        42",
            "no pose   no width",
            "q quit   t tare   m mark   s start   x x stop",
        ] {
            assert!(screen.contains(wanted), "no {wanted:?} in\n{screen}");
        }
        let topic = screen
            .lines()
            .find(|line| line.contains("/ft/wrench"))
            .unwrap();
        let fields: Vec<_> = topic.trim_matches('"').split_whitespace().collect();
        assert_eq!(&fields[2..], ["1999", "1", "5.0"], "{topic}");
        let force: String = screen
            .chars()
            .filter(|c| ('\u{2801}'..='\u{28ff}').contains(c))
            .collect();
        assert!(
            force.chars().count() > 20,
            "the strips are drawn:\n{screen}"
        );
    }

    #[test]
    fn a_mark_of_a_stranger_does_not_steer_the_terminal() {
        let desk = Desk {
            writing: Some("hin".to_owned()),
            answer: "marked \u{1b}]0;x".to_owned(),
            stopping: false,
        };
        let screen = screen(80, 30, &desk);
        assert!(!screen.contains('\u{1b}'), "{screen}");
        assert!(
            screen.contains("mark   grasp\u{fffd}[2J") && screen.contains("mark: hin_"),
            "{screen}"
        );
    }

    #[test]
    fn a_small_terminal_is_no_reason_to_panic() {
        for (width, height) in [(1, 1), (20, 5), (40, 12), (200, 60)] {
            let _ = screen(width, height, &Desk::default());
        }
    }

    #[test]
    fn a_script_gets_the_same_as_text() {
        let text = hub().look(|picture| plain(picture, HostTime::from_nanos(2_004_000_000)));
        assert!(
            text.contains("ft_sensor        streaming")
                && text.lines().all(|line| line == line.trim_end())
        );
    }
}
