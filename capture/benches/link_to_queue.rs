//! What a frame costs between a link and the writer's queue, against the bare codec in the same run; allocations shown.

use std::sync::Arc;
use std::time::Duration;

use divan::{AllocProfiler, Bencher, black_box};
use ft_capture::channel::Channel;
use ft_capture::ledger::StreamCounters;
use ft_capture::queues::queues;
use ft_drivers::options::Startup;
use ft_drivers::pump::Pump;
use ft_drivers::{Link, LinkError, RxStamps, SteppedClock, bota_serial};
use ft_wire::bota_serial::{Sample, Status, decode, encode};
use ft_wire::{Chunk, HostTime};

#[global_allocator]
static ALLOCATIONS: AllocProfiler = AllocProfiler::system();

/// Frames in one round; fewer than the queue holds.
const FRAMES: usize = 4000;

const SAMPLE: Sample = Sample {
    status: Status(0),
    force: [1.0, -2.0, 3.5],
    torque: [0.1, -0.2, 0.3],
    timestamp_us: 0,
    temperature_celsius: 25.0,
};

fn main() {
    divan::main();
}

/// A Bota stream at 800 Hz from memory.
struct Memory {
    frames: Vec<Chunk>,
    next: usize,
}

impl Link for Memory {
    type Frame = Chunk;
    fn recv(&mut self, _deadline: HostTime) -> Result<Option<(Chunk, RxStamps)>, LinkError> {
        let arrival = HostTime::from_nanos(1_250_000 * i64::try_from(self.next).unwrap_or(0));
        let frame = self.frames.get(self.next).copied();
        self.next += 1;
        Ok(frame.map(|frame| (frame, RxStamps { arrival })))
    }
    fn send(&mut self, _frame: &Chunk) -> Result<(), LinkError> {
        Ok(())
    }
}

fn frames() -> Vec<Chunk> {
    (0..FRAMES)
        .map(|index| {
            let sample = Sample {
                timestamp_us: u32::try_from(index * 1250).unwrap_or(0),
                ..SAMPLE
            };
            Chunk::new(&encode(&sample)).unwrap_or_default()
        })
        .collect()
}

#[divan::bench]
fn bare_codec(bencher: Bencher<'_, '_>) {
    let frames = frames();
    bencher.counter(FRAMES).bench(|| {
        for frame in &frames {
            let _ = black_box(decode(black_box(frame.as_slice())));
        }
    });
}

#[divan::bench]
fn link_to_queue(bencher: Bencher<'_, '_>) {
    let frames = frames();
    let clock = SteppedClock::new(HostTime::EPOCH);
    bencher
        .counter(FRAMES)
        .with_inputs(|| {
            let (queues, ends) = queues(false);
            queues.set_recording(true);
            let config = bota_serial::Config {
                startup: Startup::Listen,
                ..bota_serial::Config::default()
            };
            let pump = Pump::new(
                bota_serial::BotaSerial::new(config),
                Memory {
                    frames: frames.clone(),
                    next: 0,
                },
            );
            let counters = Arc::new(StreamCounters::default());
            (
                pump,
                Channel::new(0, queues, counters, Duration::ZERO),
                ends,
            )
        })
        .bench_values(|(mut pump, mut channel, ends)| {
            for index in 0..FRAMES {
                clock.advance_to(HostTime::from_nanos(
                    1_250_000 * i64::try_from(index).unwrap_or(0),
                ));
                let _ = black_box(pump.turn(&clock, HostTime::FAR_FUTURE, &mut channel));
            }
            (pump, channel, ends)
        });
}
