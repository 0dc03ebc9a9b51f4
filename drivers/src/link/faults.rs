//! A link that spoils what another one delivers: seeded, and counting what it did.

use std::collections::VecDeque;
use std::time::Duration;

use ft_wire::hid::{MAX_REPORT, Report};
use ft_wire::{CanFrame, Chunk, HostTime};

use crate::hid_axis::HidFrame;
use crate::link::{Link, LinkError, RxStamps};

/// A frame that can be spoiled.
pub trait Spoil: Clone {
    /// Bits that may be flipped.
    fn bits(&self) -> usize;
    /// The frame with one bit flipped.
    fn with_flipped(&self, bit: usize) -> Self;
    /// The frame in two pieces, the first of `len` bytes; `None` when a frame cannot be cut.
    fn split(&self, len: usize) -> Option<(Self, Self)>;
    /// Both frames in one; `None` when they do not fit or a frame cannot be joined.
    fn merge(&self, next: &Self) -> Option<Self>;
}

fn flipped<const N: usize>(from: &[u8], bit: usize) -> ([u8; N], usize) {
    let mut bytes = [0; N];
    let mut len = 0;
    for (slot, byte) in bytes.iter_mut().zip(from) {
        *slot = if len == bit / 8 {
            byte ^ (1 << (bit % 8))
        } else {
            *byte
        };
        len += 1;
    }
    (bytes, len)
}

impl Spoil for Chunk {
    fn bits(&self) -> usize {
        self.as_slice().len() * 8
    }

    fn with_flipped(&self, bit: usize) -> Self {
        let (bytes, len) = flipped::<{ Self::CAPACITY }>(self.as_slice(), bit);
        Self::take_from(bytes.get(..len).unwrap_or_default()).0
    }

    fn split(&self, len: usize) -> Option<(Self, Self)> {
        let (first, second) = self.as_slice().split_at_checked(len)?;
        let in_two = !first.is_empty() && !second.is_empty();
        in_two.then(|| (Self::take_from(first).0, Self::take_from(second).0))
    }

    fn merge(&self, next: &Self) -> Option<Self> {
        let (first, second) = (self.as_slice(), next.as_slice());
        let mut bytes = [0; Self::CAPACITY];
        let room = bytes.get_mut(..first.len() + second.len())?;
        room.iter_mut()
            .zip(first.iter().chain(second))
            .for_each(|(slot, byte)| *slot = *byte);
        Some(Self::take_from(room).0)
    }
}

/// On a real bus the controller's CRC catches flipped bits; here they stand for a broken adapter.
impl Spoil for CanFrame {
    fn bits(&self) -> usize {
        self.payload().len() * 8
    }

    fn with_flipped(&self, bit: usize) -> Self {
        let (bytes, len) = flipped::<8>(self.payload(), bit);
        let payload = bytes.get(..len).unwrap_or_default();
        let id = self.arbitration_id();
        let spoiled = match u16::try_from(id) {
            Ok(id) if !self.is_extended() => Self::standard(id, payload),
            _ => Self::extended(id, payload),
        };
        spoiled.unwrap_or(*self)
    }

    fn split(&self, _len: usize) -> Option<(Self, Self)> {
        None
    }

    fn merge(&self, _next: &Self) -> Option<Self> {
        None
    }
}

/// USB has a check of its own and keeps reports whole; flipped bits stand for a broken device. The descriptor stays as it is.
impl Spoil for HidFrame {
    fn bits(&self) -> usize {
        match self {
            Self::Descriptor(_) => 0,
            Self::Report(report) => report.as_slice().len() * 8,
        }
    }

    fn with_flipped(&self, bit: usize) -> Self {
        let Self::Report(report) = self else {
            return self.clone();
        };
        let (bytes, len) = flipped::<{ MAX_REPORT }>(report.as_slice(), bit);
        let spoiled = Report::new(bytes.get(..len).unwrap_or_default());
        Self::Report(spoiled.unwrap_or(*report))
    }

    fn split(&self, _len: usize) -> Option<(Self, Self)> {
        None
    }

    fn merge(&self, _next: &Self) -> Option<Self> {
        None
    }
}

/// How often which fault befalls a frame, 0 to 1 each. Default never.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct FaultRates {
    /// The frame is gone.
    pub loss: f64,
    /// The frame comes twice.
    pub duplication: f64,
    /// The frame comes after the one behind it.
    pub reordering: f64,
    /// One bit of the frame is flipped.
    pub bit_flip: f64,
    /// A chunk comes in two pieces.
    pub split: f64,
    /// A chunk comes joined to the one behind it.
    pub merge: f64,
    /// Nothing comes for `stall_for`, then all at once.
    pub stall: f64,
    /// Length of a stall.
    pub stall_for: Duration,
}

/// Faults done so far.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Injected {
    /// Frames taken away.
    pub lost: u64,
    /// Frames delivered twice.
    pub duplicated: u64,
    /// Frames delivered after the one behind them.
    pub reordered: u64,
    /// Bits flipped.
    pub flipped: u64,
    /// Chunks cut in two.
    pub split: u64,
    /// Chunks joined to the next.
    pub merged: u64,
    /// Stalls begun.
    pub stalls: u64,
}

#[derive(Debug)]
enum Held<F> {
    ToReorder(F),
    ToMerge(F),
}

/// A link with faults in what it receives. What is sent goes through untouched.
#[derive(Debug)]
pub struct FaultyLink<L: Link> {
    link: L,
    rates: FaultRates,
    random: SplitMix,
    ready: VecDeque<(L::Frame, RxStamps)>,
    held: Option<(Held<L::Frame>, RxStamps)>,
    latest: HostTime,
    stalled_until: HostTime,
    injected: Injected,
}

impl<L: Link<Frame: Spoil>> FaultyLink<L> {
    /// Spoils what `link` delivers; the same seed does the same faults.
    pub fn new(link: L, rates: FaultRates, seed: u64) -> Self {
        Self {
            link,
            rates,
            random: SplitMix(seed),
            ready: VecDeque::new(),
            held: None,
            latest: HostTime::EPOCH,
            stalled_until: HostTime::EPOCH,
            injected: Injected::default(),
        }
    }

    /// Faults done so far.
    pub const fn injected(&self) -> Injected {
        self.injected
    }

    /// The link inside.
    pub const fn inner(&self) -> &L {
        &self.link
    }

    fn spoil(&mut self, mut frame: L::Frame, stamps: RxStamps) {
        self.latest = self.latest.max(stamps.arrival);
        if self.random.chance(self.rates.stall) {
            self.injected.stalls += 1;
            self.stalled_until = stamps.arrival + self.rates.stall_for;
        }
        let stamps = RxStamps {
            arrival: stamps.arrival.max(self.stalled_until),
        };
        if self.random.chance(self.rates.loss) {
            self.injected.lost += 1;
            return;
        }
        if frame.bits() > 0 && self.random.chance(self.rates.bit_flip) {
            self.injected.flipped += 1;
            frame = frame.with_flipped(self.random.below(frame.bits()));
        }
        self.deliver(frame, stamps);
    }

    fn deliver(&mut self, frame: L::Frame, stamps: RxStamps) {
        match self.held.take() {
            None if self.random.chance(self.rates.reordering) => {
                self.held = Some((Held::ToReorder(frame), stamps));
            }
            None if self.random.chance(self.rates.merge) => {
                self.held = Some((Held::ToMerge(frame), stamps))
            }
            None => self.push(frame, stamps),
            Some((Held::ToReorder(earlier), _)) => {
                self.injected.reordered += 1;
                self.push(frame, stamps);
                self.push(earlier, stamps);
            }
            Some((Held::ToMerge(earlier), earlier_stamps)) => match earlier.merge(&frame) {
                Some(both) => {
                    self.injected.merged += 1;
                    self.push(both, stamps);
                }
                None => {
                    self.push(earlier, earlier_stamps);
                    self.push(frame, stamps);
                }
            },
        }
    }

    fn push(&mut self, frame: L::Frame, stamps: RxStamps) {
        if self.random.chance(self.rates.duplication) {
            self.injected.duplicated += 1;
            self.ready.push_back((frame.clone(), stamps));
        }
        if self.random.chance(self.rates.split) {
            let len = self.random.below((frame.bits() / 8).max(1));
            if let Some((first, second)) = frame.split(len) {
                self.injected.split += 1;
                self.ready.push_back((first, stamps));
                self.ready.push_back((second, stamps));
                return;
            }
        }
        self.ready.push_back((frame, stamps));
    }

    /// Nothing follows what is held back: it goes on as it is.
    fn release_held(&mut self) {
        if let Some((Held::ToReorder(frame) | Held::ToMerge(frame), stamps)) = self.held.take() {
            self.ready.push_back((frame, stamps));
        }
    }

    fn due(&self, by: HostTime) -> bool {
        self.ready
            .front()
            .is_some_and(|(_, stamps)| stamps.arrival <= by)
    }
}

impl<L: Link<Frame: Spoil>> Link for FaultyLink<L> {
    type Frame = L::Frame;

    fn recv(&mut self, deadline: HostTime) -> Result<Option<(L::Frame, RxStamps)>, LinkError> {
        loop {
            if self.due(self.latest) {
                return Ok(self.ready.pop_front());
            }
            let until = self
                .ready
                .front()
                .map_or(deadline, |(_, stamps)| stamps.arrival.min(deadline));
            match self.link.recv(until) {
                Ok(Some((frame, stamps))) => self.spoil(frame, stamps),
                Ok(None) => {
                    self.release_held();
                    return Ok(if self.due(deadline) {
                        self.ready.pop_front()
                    } else {
                        None
                    });
                }
                Err(error) => {
                    self.release_held();
                    return self.ready.pop_front().map(Some).ok_or(error);
                }
            }
        }
    }

    fn send(&mut self, frame: &L::Frame) -> Result<(), LinkError> {
        self.link.send(frame)
    }

    fn overflows(&self) -> u64 {
        self.link.overflows()
    }

    fn take_notice(&mut self) -> Option<String> {
        self.link.take_notice()
    }
}

/// The splitmix64 generator: faults need no better one, and the same seed does the same everywhere.
#[derive(Debug)]
struct SplitMix(u64);

impl SplitMix {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut mixed = self.0;
        mixed = (mixed ^ (mixed >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        mixed ^ (mixed >> 31)
    }

    fn chance(&mut self, probability: f64) -> bool {
        let uniform = (self.next() >> 11) as f64 / (1_u64 << 53) as f64;
        uniform < probability
    }

    fn below(&mut self, bound: usize) -> usize {
        let bound = u64::try_from(bound).unwrap_or(u64::MAX).max(1);
        usize::try_from(self.next() % bound).unwrap_or(0)
    }
}

#[cfg(test)]
mod tests;
