//! The lower convex hull of points that come in order.

use std::collections::VecDeque;

/// Most vertices that are kept. Random delays leave about ten; only a clock that drifts in a smooth curve fills it,
/// and then the oldest is forgotten.
const MAX_VERTICES: usize = 256;

/// A device instant and the host clock minus the device clock at its arrival, ns.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Vertex {
    x: i64,
    offset: i64,
}

/// A line: host = x + offset + slope (x - support), ns.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Line {
    support: Vertex,
    pub(super) slope: f64,
}

impl Line {
    /// The host instant of the device instant `x`, ns, rounded down.
    pub(super) fn at(&self, x: i64) -> i64 {
        let drift = (self.slope * x.saturating_sub(self.support.x) as f64).floor();
        // A float to integer `as` saturates.
        #[allow(clippy::cast_possible_truncation)]
        let drift = drift as i64;
        x.saturating_add(self.support.offset).saturating_add(drift)
    }
}

/// The hull of the points since a start.
#[derive(Debug)]
pub(super) struct Hull {
    vertices: VecDeque<Vertex>,
    start: Option<i64>,
    observations: u64,
}

impl Hull {
    pub(super) fn new() -> Self {
        Self {
            vertices: VecDeque::with_capacity(MAX_VERTICES + 1),
            start: None,
            observations: 0,
        }
    }

    pub(super) fn clear(&mut self) {
        self.vertices.clear();
        (self.start, self.observations) = (None, 0);
    }

    pub(super) const fn observations(&self) -> u64 {
        self.observations
    }

    /// Device time from the first point to `x`, ns.
    pub(super) fn span_to(&self, x: i64) -> i64 {
        self.start.map_or(0, |start| x.saturating_sub(start))
    }

    /// Device time from the first point to the newest, s.
    pub(super) fn span_s(&self) -> f64 {
        self.vertices
            .back()
            .map_or(0.0, |newest| self.span_to(newest.x) as f64 * 1e-9)
    }

    /// Host time from the first vertex to the newest, ns.
    pub(super) fn arrivals_span(&self) -> i64 {
        let host = |vertex: &Vertex| vertex.x.saturating_add(vertex.offset);
        self.vertices
            .front()
            .zip(self.vertices.back())
            .map_or(0, |(first, last)| host(last).saturating_sub(host(first)))
    }

    /// Adds a point with a larger `x` than all before.
    pub(super) fn add(&mut self, x: i64, y: i64) {
        let point = Vertex {
            x,
            offset: y.saturating_sub(x),
        };
        self.start.get_or_insert(x);
        self.observations += 1;
        while let Some((before, last)) = self.last_two()
            && !turns_up(before, last, point)
        {
            self.vertices.pop_back();
        }
        self.vertices.push_back(point);
        if self.vertices.len() > MAX_VERTICES {
            self.vertices.pop_front();
        }
    }

    /// Slope of the edge over the middle of the hull; 0 when there is no edge.
    pub(super) fn middle_slope(&self) -> f64 {
        let (Some(first), Some(last)) = (self.vertices.front(), self.vertices.back()) else {
            return 0.0;
        };
        let middle = first.x.midpoint(last.x);
        let right = self.vertices.partition_point(|vertex| vertex.x <= middle);
        right
            .checked_sub(1)
            .map_or(0.0, |left| self.edge_slope(left))
    }

    /// The line of this slope that touches the hull from below.
    pub(super) fn support(&self, slope: f64) -> Line {
        // Slopes of edges grow from left to right: the vertex wanted is where they pass `slope`.
        let (mut low, mut high) = (0, self.vertices.len().saturating_sub(1));
        while low < high {
            let middle = low.midpoint(high);
            if self.edge_slope(middle) < slope {
                low = middle + 1;
            } else {
                high = middle;
            }
        }
        let support = self
            .vertices
            .get(low)
            .copied()
            .unwrap_or(Vertex { x: 0, offset: 0 });
        Line { support, slope }
    }

    /// Slope of the edge that begins at vertex `left`; 0 when there is none.
    fn edge_slope(&self, left: usize) -> f64 {
        let (Some(a), Some(b)) = (self.vertices.get(left), self.vertices.get(left + 1)) else {
            return 0.0;
        };
        b.offset.saturating_sub(a.offset) as f64 / b.x.saturating_sub(a.x).max(1) as f64
    }

    fn last_two(&self) -> Option<(Vertex, Vertex)> {
        let before = self.vertices.len().checked_sub(2)?;
        Some((*self.vertices.get(before)?, *self.vertices.back()?))
    }
}

/// Whether a-b-c turns upwards, so that b is below the line a-c.
fn turns_up(a: Vertex, b: Vertex, c: Vertex) -> bool {
    let difference = |to: i64, from: i64| i128::from(to) - i128::from(from);
    difference(b.offset, a.offset) * difference(c.x, a.x)
        < difference(c.offset, a.offset) * difference(b.x, a.x)
}
