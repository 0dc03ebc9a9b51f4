//! A device, its line and the host's end of it.

use std::sync::Arc;

use ft_wire::{CanFrame, Chunk, HostTime};

use super::Fitted;
use crate::bus::{Carried, Line, Port};
use crate::clock::SimNanos;
use crate::device::{Outbox, Played};
use crate::scenario::LinkSpec;
use crate::scene::Scene;

#[derive(Debug)]
pub(crate) struct Wired<F> {
    pub(crate) device: Box<dyn Played<F>>,
    pub(crate) port: Arc<Port<F>>,
    pub(crate) line: Line,
}

#[derive(Debug)]
pub(crate) enum SlotKind {
    Serial(Wired<Chunk>),
    Can(Wired<CanFrame>),
}

#[derive(Debug)]
pub(crate) struct Slot {
    pub(crate) fitted: Fitted,
    pub(crate) kind: SlotKind,
}

impl Slot {
    /// The same with a delay before its line and an adapter behind it.
    pub(crate) fn behind(mut self, link: &LinkSpec) -> Self {
        match &mut self.kind {
            SlotKind::Serial(wired) => wired.line.set_link(link),
            SlotKind::Can(wired) => wired.line.set_link(link),
        }
        self
    }

    /// When something happens here next.
    pub(crate) fn due(&self, start: HostTime) -> Option<SimNanos> {
        match &self.kind {
            SlotKind::Serial(wired) => wired.due(start),
            SlotKind::Can(wired) => wired.due(start),
        }
    }

    /// Plays what is due at `at`.
    pub(crate) fn play(&mut self, at: SimNanos, start: HostTime, scene: &Scene) {
        match &mut self.kind {
            SlotKind::Serial(wired) => {
                for (ready, chunk) in wired.play(at, start, scene) {
                    wired.carry_cut(ready, chunk, start);
                }
                if let Some(rate) = wired
                    .device
                    .line_rate()
                    .filter(|rate| *rate != wired.port.line_rate())
                {
                    wired.line.set_rate(rate);
                    wired.port.set_line_rate(rate);
                }
            }
            SlotKind::Can(wired) => {
                for (ready, frame) in wired.play(at, start, scene) {
                    wired.carry(ready, frame, start);
                }
            }
        }
    }
}

impl<F: Carried> Wired<F> {
    fn due(&self, start: HostTime) -> Option<SimNanos> {
        let heard = self
            .port
            .next_to_device()
            .map(|at| at.as_nanos() - start.as_nanos());
        match (self.device.next_event(), heard) {
            (Some(event), Some(heard)) => Some(event.min(heard)),
            (event, heard) => event.or(heard),
        }
    }

    fn play(&mut self, at: SimNanos, start: HostTime, scene: &Scene) -> Outbox<F> {
        let mut out = Outbox::new();
        let heard = self
            .port
            .next_to_device()
            .map(|heard| heard.as_nanos() - start.as_nanos());
        let event = self.device.next_event().filter(|event| *event <= at);
        match (event, heard.filter(|heard| *heard <= at)) {
            (Some(event), heard) if heard.is_none_or(|heard| event <= heard) => {
                self.device.run(at, scene, &mut out)
            }
            (_, Some(_)) => {
                if let Some((_, frame)) = self.port.take_to_device() {
                    self.device.receive(at, &frame, scene, &mut out);
                }
            }
            _ => {}
        }
        out
    }

    fn carry(&mut self, ready: SimNanos, frame: F, start: HostTime) {
        let arrival = self.line.carry(ready, frame.bits());
        self.port
            .deliver(HostTime::from_nanos(start.as_nanos() + arrival), frame);
    }
}

impl Wired<Chunk> {
    /// Serial adapters hand bytes over in pieces of their own choosing: now and then a frame comes in two.
    fn carry_cut(&mut self, ready: SimNanos, chunk: Chunk, start: HostTime) {
        let bytes = chunk.as_slice();
        let cut = self.line.cut(bytes.len()).unwrap_or(bytes.len());
        let (first, second) = bytes.split_at(cut);
        for piece in [first, second] {
            if let Some(piece) = Chunk::new(piece).filter(|piece| !piece.as_slice().is_empty()) {
                self.carry(ready, piece, start);
            }
        }
    }
}
