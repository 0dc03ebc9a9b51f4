//! Devices that are polled: a link that answers, and spoils its answers.

use std::cell::Cell;
use std::collections::VecDeque;
use std::rc::Rc;
use std::time::Duration;

use ft_drivers::device::Counted;
use ft_drivers::link::faults::Spoil;
use ft_drivers::pump::Pump;
use ft_drivers::reading::Reading;
use ft_drivers::{
    Clock, Device, Link, LinkError, RxStamps, SteppedClock, amt21, ati_netcanoem, dynamixel,
};
use ft_wire::dynamixel2::{Packet, Params, PresentState, StatusError};
use ft_wire::{CanFrame, Chunk, HostTime};

use super::cases::{chunk, counts};
use super::run::{
    FAULTS, Fault, HITS, LONG_STALLS, Outcome, PULLS, Row, SAMPLES, START, Seeded, values,
};

/// What a request asks for.
enum Asked<F> {
    /// Something of the set-up, and its answer.
    SetUp(Vec<F>),
    /// A sample.
    Sample,
}

struct Case<D, F> {
    driver: &'static str,
    make: fn() -> D,
    asked: fn(&F) -> Asked<F>,
    sample: fn(usize, bool) -> Vec<F>,
    /// Whether a sample says that it is overloaded.
    overload: bool,
    /// Whether the bus excludes corruption and cutting.
    can: bool,
}

/// All cells of the polled drivers.
pub(crate) fn rows() -> Vec<Row> {
    vec![
        row(&Case {
            driver: "ati_netcanoem",
            make: || ati_netcanoem::AtiNetcanoem::new(ati_netcanoem::Config::default()),
            asked: ati_asked,
            sample: ati_sample,
            overload: true,
            can: true,
        }),
        row(&Case {
            driver: "dynamixel",
            make: || dynamixel::Dynamixel::new(dynamixel::Config::default()),
            asked: dynamixel_asked,
            sample: dynamixel_sample,
            overload: false,
            can: false,
        }),
        row(&Case {
            driver: "amt21",
            make: || amt21::Amt21::new(amt21::Config::default()),
            asked: |_| Asked::Sample,
            sample: |index, _| chunk(&ft_wire::amt21::encode_position(5_000 + index as u16)),
            overload: false,
            can: false,
        }),
    ]
}

fn ati_asked(request: &CanFrame) -> Asked<CanFrame> {
    let operation = (request.arbitration_id() & 0xF) as u16;
    let reply =
        |operation: u16, payload: &[u8]| CanFrame::standard(0x200 | operation, payload).unwrap();
    let axis = request.payload().first().copied().unwrap_or_default();
    Asked::SetUp(match operation {
        0x0 => return Asked::Sample,
        0x2 => (0..3)
            .map(|part| {
                let element = |gauge: u8| if gauge == axis { 10.0_f32 } else { 0.0 };
                let pair = [2 * part, 2 * part + 1].map(|gauge| element(gauge).to_be_bytes());
                reply(2 + u16::from(part), &pair.concat())
            })
            .collect(),
        0x5 => vec![reply(5, b"FT000001")],
        0x6 => vec![reply(6, &[0])],
        0x7 => vec![reply(7, &[0, 0, 0, 10, 0, 0, 0, 10])],
        0x8 => vec![reply(8, &[2, 3])],
        0xF => vec![reply(0xF, &[3, 8, 0, 1])],
        _ => Vec::new(),
    })
}

fn ati_sample(index: usize, overload: bool) -> Vec<CanFrame> {
    let [a, b, c, d, e, f] = counts(index).map(i16::to_be_bytes);
    let status = if overload { [0x80, 0x02] } else { [0, 0] };
    let even = [status, a, c, e].concat();
    vec![
        CanFrame::standard(0x200, &even).unwrap(),
        CanFrame::standard(0x201, &[b, d, f].concat()).unwrap(),
    ]
}

fn status(params: &[u8]) -> Chunk {
    let packet = Packet::Status {
        id: 1,
        error: StatusError(0),
        params: Params::new(params).unwrap(),
    };
    Chunk::new(ft_wire::dynamixel2::encode(&packet).as_slice()).unwrap()
}

fn dynamixel_asked(request: &Chunk) -> Asked<Chunk> {
    match request.as_slice()[7] {
        0x01 => Asked::SetUp(vec![status(&[0x06, 0x04, 0x26])]),
        0x03 => Asked::SetUp(vec![status(&[])]),
        _ => Asked::Sample,
    }
}

fn dynamixel_sample(index: usize, _overload: bool) -> Vec<Chunk> {
    let state = PresentState {
        current: 0,
        velocity: 0,
        position: 1_000 + index as i32,
    };
    vec![status(&state.encode())]
}

/// Answers requests after half a millisecond.
struct Answering<'a, D, F> {
    case: &'a Case<D, F>,
    clock: SteppedClock,
    fault: Option<Fault>,
    hits: Vec<usize>,
    random: Seeded,
    polls: Rc<Cell<usize>>,
    answers: VecDeque<(F, HostTime)>,
    /// Nothing comes before.
    stalled_until: HostTime,
    pulled: Rc<Cell<bool>>,
}

impl<D, F: Spoil> Answering<'_, D, F> {
    fn answer(&mut self, index: usize) -> (Vec<F>, Duration) {
        let delay = Duration::from_micros(500);
        let hit = self.hits.contains(&index);
        let Some(fault) = self.fault.filter(|_| hit) else {
            return ((self.case.sample)(index, false), delay);
        };
        let mut frames = (self.case.sample)(index, fault == Fault::Overload);
        let victim = self.random.below(frames.len());
        match fault {
            Fault::Lost => {
                frames.remove(victim);
            }
            Fault::Restarted | Fault::Burst => frames.clear(),
            Fault::Duplicated => frames.extend(frames.clone()),
            Fault::Corrupted => {
                let bit = self.random.below(frames[victim].bits());
                frames[victim] = frames[victim].with_flipped(bit);
            }
            Fault::Split => {
                let cut = 1 + self.random.below(frames[0].bits() / 8 - 1);
                let (first, second) = frames[0].split(cut).unwrap();
                frames = vec![first, second];
            }
            Fault::Stalled => return (frames, Duration::from_millis(8)),
            Fault::LongStall => {
                let of_this = LONG_STALLS.iter().find(|(begin, _)| *begin == index);
                let (_, stall_ms) = of_this.unwrap();
                self.stalled_until = self.clock.now() + Duration::from_millis(*stall_ms);
            }
            _ => {}
        }
        (frames, delay)
    }
}

impl<D, F: Spoil> Link for Answering<'_, D, F> {
    type Frame = F;

    fn recv(&mut self, deadline: HostTime) -> Result<Option<(F, RxStamps)>, LinkError> {
        if self.pulled.get() {
            let port = "a device".to_owned();
            return Err(LinkError::Gone { port });
        }
        match self.answers.front() {
            Some((_, arrival)) if *arrival <= deadline => {
                let arrival = *arrival;
                self.clock.advance_to(arrival);
                Ok(self
                    .answers
                    .pop_front()
                    .map(|(frame, _)| (frame, RxStamps { arrival })))
            }
            _ => {
                self.clock.advance_to(deadline);
                Ok(None)
            }
        }
    }

    fn send(&mut self, request: &F) -> Result<(), LinkError> {
        let (frames, delay) = match (self.case.asked)(request) {
            Asked::SetUp(frames) => (frames, Duration::from_micros(500)),
            Asked::Sample => {
                let index = self.polls.get();
                self.polls.set(index + 1);
                self.answer(index)
            }
        };
        let arrival = (self.clock.now() + delay).max(self.stalled_until);
        self.answers
            .extend(frames.into_iter().map(|frame| (frame, arrival)));
        Ok(())
    }
}

/// Polls from `first` to `last`, the answer to which does not count any more: then the plug is pulled.
fn poll<D, F>(
    case: &Case<D, F>,
    fault: Option<Fault>,
    seed: u64,
    polls: (usize, usize),
    out: &mut Outcome,
) where
    D: Device<Frame = F, Reading = Reading> + Counted,
    F: Spoil,
{
    let clock = SteppedClock::new(START);
    let counter = Rc::new(Cell::new(polls.0));
    let mut random = Seeded(seed);
    let hits = match fault {
        Some(Fault::Restarted) => (1_000..1_005).collect(),
        Some(Fault::Burst) => random.bursts(1).into_iter().flatten().collect(),
        Some(Fault::LongStall) => LONG_STALLS.map(|(begin, _)| begin).to_vec(),
        _ => random.hits(),
    };
    out.hits = hits.len() as u64;
    let pulled = Rc::new(Cell::new(false));
    let link = Answering {
        case,
        clock: clock.clone(),
        fault,
        hits,
        random,
        polls: Rc::clone(&counter),
        answers: VecDeque::new(),
        stalled_until: HostTime::EPOCH,
        pulled: Rc::clone(&pulled),
    };
    let mut pump = Pump::new((case.make)(), link);
    while counter.get() <= polls.1 {
        let deadline = clock.now() + Duration::from_millis(1);
        pump.turn(&clock, deadline, out).unwrap();
    }
    pulled.set(true);
    let ended = pump.turn(&clock, clock.now(), out);
    out.gone += usize::from(matches!(ended, Err(LinkError::Gone { .. })));
    out.counts = out.counts + pump.counts();
}

fn row<D, F>(case: &Case<D, F>) -> Row
where
    D: Device<Frame = F, Reading = Reading> + Counted,
    F: Spoil,
{
    let mut clean = Outcome::default();
    poll(case, None, 0, (0, SAMPLES), &mut clean);
    let sent: Vec<Vec<f64>> = clean
        .readings
        .iter()
        .filter_map(values)
        .map(|(sample, _)| sample)
        .collect();
    assert_eq!(
        sent.len(),
        SAMPLES,
        "{}: without faults every sample comes",
        case.driver
    );
    let cells = (0_u64..)
        .zip(FAULTS)
        .map(|(seed, fault)| cell(case, fault, &sent, seed))
        .collect();
    Row {
        driver: case.driver,
        cells,
    }
}

fn cell<D, F>(case: &Case<D, F>, fault: Fault, sent: &[Vec<f64>], seed: u64) -> String
where
    D: Device<Frame = F, Reading = Reading> + Counted,
    F: Spoil,
{
    let what = format!("{}, {}", case.driver, fault.name());
    match fault {
        Fault::ClockJump => return "-".to_owned(),
        Fault::Overload if !case.overload => return "-".to_owned(),
        // The next answer comes only when this one was read.
        Fault::Reordered | Fault::Merged => return "bus".to_owned(),
        Fault::Corrupted | Fault::Split if case.can => return "bus".to_owned(),
        _ => {}
    }
    let mut out = Outcome::default();
    if fault == Fault::Unplugged {
        // Pulled before an answer has come.
        let mut next = 0;
        for pull in 1..=PULLS {
            let last = pull * SAMPLES / (PULLS + 1);
            poll(case, None, seed, (next, last), &mut out);
            next = last + 1;
        }
        poll(case, None, seed, (next, SAMPLES), &mut out);
    } else {
        poll(case, Some(fault), seed, (0, SAMPLES), &mut out);
    }
    out.assert_good_is_true(sent, &[1e-9; 7], &what);
    let counts = out.counts;
    let (all, hits) = (SAMPLES as u64, HITS as u64);
    let delivered = out.samples().len() as u64;
    assert_eq!(delivered, counts.received, "{what}: {counts:?}");
    // The last link ends with the test.
    let pulled = out.gone - 1;
    let counted = |seen: u64, hits: u64| {
        assert_eq!(seen, hits, "{what}: {counts:?}");
        format!("{seen}/{hits}")
    };
    match fault {
        Fault::Lost | Fault::Corrupted => {
            assert_eq!(delivered + hits, all, "{what}: {counts:?}");
            counted(counts.gaps, hits)
        }
        Fault::Restarted => {
            assert_eq!(delivered + 5, all, "{what}: {counts:?}");
            counted(counts.gaps, 5)
        }
        Fault::Duplicated => {
            assert_eq!(delivered, all, "{what}: {counts:?}");
            let pieces = if case.driver == "amt21" { 2 } else { 1 };
            counted(counts.skipped / pieces, hits)
        }
        Fault::Unplugged => {
            let pulls = PULLS as u64;
            assert_eq!(
                (delivered, counts.gaps),
                (all - pulls, 0),
                "{what}: {counts:?}"
            );
            assert_eq!(pulled, PULLS, "{what}");
            "kept".to_owned()
        }
        Fault::Burst => {
            assert_eq!(delivered + out.hits, all, "{what}: {counts:?}");
            counted(counts.gaps, out.hits)
        }
        Fault::LongStall => {
            // Every poll that was left unanswered is a gap, and the device is set up anew; late answers are no samples.
            assert_eq!(delivered + counts.gaps, all, "{what}: {counts:?}");
            counted(out.losses() as u64, LONG_STALLS.len() as u64)
        }
        Fault::Overload => {
            assert_eq!(delivered, all, "{what}: {counts:?}");
            counted(
                out.samples().iter().filter(|(_, good)| !good).count() as u64,
                hits,
            )
        }
        _ => {
            assert_eq!(
                (delivered, counts.gaps, counts.refused, counts.skipped),
                (all, 0, 0, 0),
                "{what}"
            );
            "kept".to_owned()
        }
    }
}
