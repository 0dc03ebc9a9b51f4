//! The effort without inertia as an ONNX graph: `effort = f(q, dq)`, float32, any number of states at once.
//!
//! Bilinear interpolation of a [`Table`]: floor, gather the four corners, mix; straight on beyond the last speed. The messages are written field by
//! field (onnx.proto, IR version 8, opset 13), which needs only protobuf's varint and length-delimited fields.

use super::table::Table;
use crate::twin::Twin;

const FLOAT: u64 = 1;
const INT64: u64 = 7;

/// A protobuf message under construction.
#[derive(Default)]
struct Message(Vec<u8>);

impl Message {
    fn varint(&mut self, mut value: u64) {
        while value >= 0x80 {
            self.0.push(value as u8 | 0x80);
            value >>= 7;
        }
        self.0.push(value as u8);
    }

    fn number(mut self, field: u64, value: u64) -> Self {
        self.varint(field << 3);
        self.varint(value);
        self
    }

    fn bytes(mut self, field: u64, bytes: &[u8]) -> Self {
        self.varint(field << 3 | 2);
        self.varint(bytes.len() as u64);
        self.0.extend_from_slice(bytes);
        self
    }

    fn text(self, field: u64, text: &str) -> Self {
        self.bytes(field, text.as_bytes())
    }

    fn message(self, field: u64, inner: Self) -> Self {
        self.bytes(field, &inner.0)
    }
}

/// A graph under construction.
#[derive(Default)]
struct Graph {
    message: Message,
    count: usize,
}

impl Graph {
    /// Adds a node; gives its output's name.
    fn node(&mut self, operation: &str, inputs: &[&str], attributes: Vec<Message>) -> String {
        self.count += 1;
        let output = format!("{}_{}", operation.to_lowercase(), self.count);
        self.named(operation, inputs, &output, attributes);
        output
    }

    fn named(&mut self, operation: &str, inputs: &[&str], output: &str, attributes: Vec<Message>) {
        let mut node = inputs
            .iter()
            .fold(Message::default(), |node, input| node.text(1, input))
            .text(2, output)
            .text(4, operation);
        for attribute in attributes {
            node = node.message(5, attribute);
        }
        self.add(1, node);
    }

    fn add(&mut self, field: u64, inner: Message) {
        self.message = core::mem::take(&mut self.message).message(field, inner);
    }

    fn floats(&mut self, name: &str, dims: &[u64], values: &[f32]) {
        let raw: Vec<u8> = values.iter().flat_map(|v| v.to_le_bytes()).collect();
        self.tensor(name, dims, FLOAT, &raw);
    }

    fn integer(&mut self, name: &str, value: i64) {
        self.tensor(name, &[], INT64, &value.to_le_bytes());
    }

    fn tensor(&mut self, name: &str, dims: &[u64], kind: u64, raw: &[u8]) {
        let tensor = dims
            .iter()
            .fold(Message::default(), |tensor, dim| tensor.number(1, *dim))
            .number(2, kind)
            .text(8, name)
            .bytes(9, raw);
        self.add(5, tensor);
    }

    fn scalar(&mut self, name: &str, value: f64) {
        self.floats(name, &[], &[value as f32]);
    }

    /// Input (field 11) or output (field 12): a float vector of any length.
    fn port(&mut self, field: u64, name: &str) {
        let any = Message::default().text(2, "states");
        let shape = Message::default().message(1, any);
        let tensor = Message::default().number(1, FLOAT).message(2, shape);
        let kind = Message::default().message(1, tensor);
        self.add(field, Message::default().text(1, name).message(2, kind));
    }

    fn cast_to_integer(&mut self, input: &str) -> String {
        let to = Message::default()
            .text(1, "to")
            .number(3, INT64)
            .number(20, 2);
        self.node("Cast", &[input], vec![to])
    }
}

/// The model's bytes.
pub(super) fn model(table: &Table, twin: &Twin) -> Vec<u8> {
    let [along, speeds] = table.nodes;
    let mut graph = Graph::default();
    let values: Vec<f32> = table.efforts.iter().map(|v| *v as f32).collect();
    graph.floats("efforts", &[values.len() as u64], &values);
    graph.scalar("low", table.q[0]);
    graph.scalar("per_q", (along - 1) as f64 / (table.q[1] - table.q[0]));
    graph.scalar("per_speed", ((speeds - 1) as f64).powi(2) / table.speed);
    graph.scalar("zero", 0.0);
    graph.scalar("one", 1.0);
    graph.scalar("two", 2.0);
    graph.scalar("half", 0.5);
    graph.scalar("last_q", (along - 1) as f64);
    graph.scalar("last_cell_q", (along - 2) as f64);
    graph.scalar("last_cell_speed", (speeds - 2) as f64);
    graph.integer("row", speeds as i64);
    graph.integer("next", 1);
    graph.integer("backward", (along * speeds) as i64);
    let from_low = graph.node("Sub", &["q", "low"], vec![]);
    let scaled = graph.node("Mul", &[&from_low, "per_q"], vec![]);
    let at_q = graph.node("Clip", &[&scaled, "zero", "last_q"], vec![]);
    let speed = graph.node("Abs", &["dq"], vec![]);
    // Nodes of the speed lie at the squares of whole numbers.
    let at_speed = graph.node("Mul", &[&speed, "per_speed"], vec![]);
    let root = graph.node("Sqrt", &[&at_speed], vec![]);
    let cell = |graph: &mut Graph, at: &str, last: &str| {
        let floor = graph.node("Floor", &[at], vec![]);
        graph.node("Min", &[&floor, last], vec![])
    };
    let first_q = cell(&mut graph, &at_q, "last_cell_q");
    let u = graph.node("Sub", &[&at_q, &first_q], vec![]);
    let first_speed = cell(&mut graph, &root, "last_cell_speed");
    let square = graph.node("Mul", &[&first_speed, &first_speed], vec![]);
    let part = graph.node("Sub", &[&at_speed, &square], vec![]);
    let twice = graph.node("Mul", &[&first_speed, "two"], vec![]);
    let width = graph.node("Add", &[&twice, "one"], vec![]);
    let v = graph.node("Div", &[&part, &width], vec![]);
    let (i, j) = (
        graph.cast_to_integer(&first_q),
        graph.cast_to_integer(&first_speed),
    );
    let rows = graph.node("Mul", &[&i, "row"], vec![]);
    let corner = graph.node("Add", &[&rows, &j], vec![]);
    let mut ways = Vec::new();
    for way in 0..2 {
        let first = if way == 0 {
            corner.clone()
        } else {
            graph.node("Add", &[&corner, "backward"], vec![])
        };
        let beside = graph.node("Add", &[&first, "next"], vec![]);
        let above = graph.node("Add", &[&first, "row"], vec![]);
        let across = graph.node("Add", &[&above, "next"], vec![]);
        let [e00, e01, e10, e11] = [&first, &beside, &above, &across]
            .map(|at| graph.node("Gather", &["efforts", at], vec![]));
        let low = mix(&mut graph, &e00, &e01, &v);
        let high = mix(&mut graph, &e10, &e11, &v);
        ways.push(mix(&mut graph, &low, &high, &u));
    }
    // At rest the middle of both directions.
    let sum = graph.node("Add", &[&ways[0], &ways[1]], vec![]);
    let rest = graph.node("Mul", &[&sum, "half"], vec![]);
    let backward = graph.node("Less", &["dq", "zero"], vec![]);
    let forward = graph.node("Greater", &["dq", "zero"], vec![]);
    let not_forward = graph.node("Where", &[&backward, &ways[1], &rest], vec![]);
    graph.named(
        "Where",
        &[&forward, &ways[0], &not_forward],
        "effort",
        vec![],
    );
    graph.port(11, "q");
    graph.port(11, "dq");
    graph.port(12, "effort");
    graph.message = graph.message.text(2, "passive_effort").text(
        10,
        "effort (N m or N) that must be applied at q (rad or m) and dq (per second), without inertia * ddq",
    );
    Message::default()
        .number(1, 8)
        .text(2, "ft-identify")
        .text(3, &twin.provenance.version)
        .message(7, graph.message)
        .message(8, Message::default().text(1, "").number(2, 13))
        .0
}

/// `a + t (b - a)`.
fn mix(graph: &mut Graph, a: &str, b: &str, t: &str) -> String {
    let difference = graph.node("Sub", &[b, a], vec![]);
    let part = graph.node("Mul", &[&difference, t], vec![]);
    graph.node("Add", &[a, &part], vec![])
}
