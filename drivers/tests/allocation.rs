//! A stream that runs allocates nothing: link, pump, driver and clock translation together.
#![allow(missing_docs, reason = "a test")]

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;

use ft_drivers::bota_serial::{BotaSerial, Config};
use ft_drivers::link::replay::ReplayLink;
use ft_drivers::pump::{Outlet, Pump};
use ft_drivers::reading::Reading;
use ft_drivers::translate::{OneWay, OneWayConfig};
use ft_drivers::{RxStamps, Startup, SteppedClock};
use ft_wire::bota_serial::{Sample, Status, encode};
use ft_wire::{Chunk, HostTime};

thread_local! {
    static ALLOCATIONS: Cell<u64> = const { Cell::new(0) };
}

struct Counting;

// SAFETY: hands everything to the system's allocator; the counter is a plain cell of the thread.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        ALLOCATIONS.with(|count| count.set(count.get() + 1));
        // SAFETY: the caller's promise is passed on.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        // SAFETY: the caller's promise is passed on.
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static COUNTING: Counting = Counting;

struct Translate {
    translator: OneWay,
    samples: u32,
    /// Allocations when the stream had settled.
    settled_at: u64,
}

impl Outlet<Chunk> for Translate {
    fn frame(&mut self, _frame: &Chunk, _stamps: RxStamps) {}

    fn reading(&mut self, reading: Reading) {
        if let Reading::Wrench(reading) = reading {
            self.samples += 1;
            self.translator
                .observe(reading.at.device_ns.unwrap_or_default(), reading.at.arrival);
            if self.samples == 100 {
                self.settled_at = ALLOCATIONS.with(Cell::get);
            }
        }
    }
}

#[test]
fn a_stream_that_runs_allocates_nothing() {
    let frame = |index: u32| {
        let sample = Sample {
            status: Status(0),
            force: [1.0; 3],
            torque: [0.1; 3],
            timestamp_us: index * 1_250,
            temperature_celsius: 25.0,
        };
        let jitter = i64::from(index * 7_919 % 300) * 1_000;
        let arrival = HostTime::from_nanos(1_000_000_000 + i64::from(index) * 1_250_000 + jitter);
        (Chunk::take_from(&encode(&sample)).0, RxStamps { arrival })
    };
    let clock = SteppedClock::new(HostTime::EPOCH);
    let link = ReplayLink::new(clock.clone(), (0..100_000).map(frame));
    let device = BotaSerial::new(Config {
        startup: Startup::Listen,
        ..Config::default()
    });
    let mut pump = Pump::new(device, link);
    let mut outlet = Translate {
        translator: OneWay::new(OneWayConfig::default()),
        samples: 0,
        settled_at: 0,
    };
    while pump.link().next_arrival().is_some() {
        pump.turn(&clock, HostTime::FAR_FUTURE, &mut outlet)
            .unwrap();
    }
    let after = ALLOCATIONS.with(Cell::get);
    assert_eq!(outlet.samples, 100_000);
    assert!(
        outlet.settled_at > 0,
        "the counter counts: building the driver allocated"
    );
    assert_eq!(after - outlet.settled_at, 0);
}
