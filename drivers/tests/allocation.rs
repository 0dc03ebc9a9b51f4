//! A stream that runs allocates nothing: link, pump, driver and clock translation together, and every codec by itself.
#![allow(missing_docs, clippy::unwrap_used, reason = "a test")]

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;

use ft_drivers::bota_serial::{BotaSerial, Config};
use ft_drivers::link::replay::ReplayLink;
use ft_drivers::pump::{Outlet, Pump};
use ft_drivers::reading::Reading;
use ft_drivers::translate::{OneWay, OneWayConfig};
use ft_drivers::{Counted, Device, RxStamps, Startup, SteppedClock};
use ft_wire::bota_serial::{Sample, Status, encode};
use ft_wire::{
    CanFrame, Chunk, DecodeError, HostTime, Parsed, amt21, ati_netcanoem, dynamixel2, encoder_line,
    gs_usb, hid, kunwei_kwr75, leptrino, optoforce_hex, pose_stream, robotous_rft,
};

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

#[path = "fault_matrix/cases.rs"]
mod cases;

/// Counts samples, and allocations when the stream had settled.
#[derive(Default)]
struct Settle {
    samples: usize,
    settled_at: u64,
}

impl<F> Outlet<F> for Settle {
    fn frame(&mut self, _frame: &F, _stamps: RxStamps) {}

    fn reading(&mut self, reading: Reading) {
        if !matches!(reading, Reading::Event { .. }) {
            self.samples += 1;
            if self.samples == 100 {
                self.settled_at = ALLOCATIONS.with(Cell::get);
            }
        }
    }
}

/// Plays 2000 samples to a driver.
fn settles<D>(name: &str, device: D, sample: fn(usize, u64, bool) -> Vec<D::Frame>)
where
    D: Device<Reading = Reading> + Counted,
    D::Frame: Clone,
{
    let at = |ms: usize| HostTime::from_nanos(1_000_000_000_000 + ms as i64 * 1_000_000);
    let samples = (0..2_000).flat_map(|index| {
        let frames = sample(index, 20_000 + index as u64, false);
        frames.into_iter().map(move |frame| (frame, at(1 + index)))
    });
    let frames: Vec<_> = samples
        .map(|(frame, arrival)| (frame, RxStamps { arrival }))
        .collect();
    let clock = SteppedClock::new(at(0));
    let mut pump = Pump::new(device, ReplayLink::new(clock.clone(), frames));
    let mut outlet = Settle::default();
    while pump.link().next_arrival().is_some() {
        pump.turn(&clock, HostTime::FAR_FUTURE, &mut outlet)
            .unwrap();
    }
    let after = ALLOCATIONS.with(Cell::get);
    assert_eq!(outlet.samples, 2_000, "{name}");
    assert_eq!(after - outlet.settled_at, 0, "{name}");
}

#[test]
fn no_streaming_driver_allocates_while_its_stream_runs() {
    settles("bota_serial", cases::bota(), cases::bota_sample);
    settles("robotous_can", cases::rft_can(), cases::rft_can_sample);
    settles("robotous_uart", cases::rft_uart(), cases::rft_uart_sample);
    settles(
        "optoforce_serial",
        cases::hex_serial(),
        cases::hex_serial_sample,
    );
    settles("optoforce_can", cases::hex_can(), cases::hex_can_sample);
    settles("leptrino", cases::leptrino(), cases::leptrino_sample);
    settles("kunwei_kwr75", cases::kwr75(), cases::kwr75_sample);
    settles("encoder_line", cases::encoder(), cases::encoder_sample);
    settles("pose_stream", cases::pose(), cases::pose_sample);
    settles("hid_axis", cases::hid(), cases::hid_sample);
}

/// A frame of each codec, decoded and encoded many times.
#[test]
fn no_codec_allocates() {
    let can = CanFrame::standard(1, &[0x0B; 8]).unwrap();
    let sensor = bota();
    let record = robotous_rft::Response::Stream(robotous_rft::Record {
        force: [617, -250, -1001],
        torque: [500, -1000, 2000],
        overload: 0,
    });
    let ids = robotous_rft::CanIds::default();
    let hex = optoforce_hex::Packet::Sample(optoforce_hex::Sample {
        counter: 7,
        status: optoforce_hex::Status(0),
        force: [100, -200, 300],
        torque: Some([-50, 60, -70]),
    });
    let escaped = leptrino::Message::Sample(leptrino::Sample {
        streamed: true,
        raw: [16, -1000, 4112, 0, 5000, -10_000],
        status: leptrino::Status(0),
    });
    let unchecked = kunwei_kwr75::Sample {
        asked: false,
        force_kg: [-9.78, -7.41, 7.51],
        torque_kgm: [-0.17, 0.3, -0.005],
    };
    let even = CanFrame::standard(0x200, &[0, 0, 3, 0xE8, 0x0B, 0xB8, 0x13, 0x88]).unwrap();
    let state = dynamixel2::PresentState {
        current: -100,
        velocity: 5,
        position: 2048,
    };
    let status = dynamixel2::Packet::Status {
        id: 1,
        error: dynamixel2::StatusError(0),
        params: dynamixel2::Params::new(&state.encode()).unwrap(),
    };
    // Lines are only ever read here, and written by firmware.
    let line = encoder_line::encode(&encoder_line::Sample {
        time_us: 1_000_000,
        counts: 2048,
    });
    let pose = pose_stream::PoseSample {
        tracking_ns: 1_234_567_890_123,
        position: [1.0, -2.0, 0.5],
        quaternion: [0.5, -0.5, 0.5, 0.5],
        quality_score: 0.75,
    };
    let descriptor = [
        0x05, 0x01, 0x09, 0x04, 0xA1, 0x01, 0x09, 0x30, 0x15, 0x00, 0x27, 0xFF, 0xFF, 0x00, 0x00,
        0x75, 0x10, 0x95, 0x01, 0x81, 0x02, 0xC0,
    ];
    let axes = hid::axes(&descriptor).unwrap();
    let codecs: [(&str, &dyn Fn() -> bool); 13] = [
        ("bota_serial", &|| {
            whole(ft_wire::bota_serial::decode(&encode(&sensor)))
        }),
        ("robotous, serial", &|| {
            whole(robotous_rft::decode_response(
                &robotous_rft::encode_response(&record),
            ))
        }),
        ("robotous, CAN", &|| {
            let halves = robotous_rft::response_frames(ids, &record);
            halves
                .iter()
                .all(|half| robotous_rft::decode_half(ids, half).is_ok())
        }),
        ("optoforce_hex", &|| {
            whole(optoforce_hex::decode(
                optoforce_hex::encode(&hex).as_slice(),
            ))
        }),
        ("leptrino", &|| {
            whole(leptrino::decode(leptrino::encode(&escaped).as_slice()))
        }),
        ("kunwei_kwr75", &|| {
            whole(kunwei_kwr75::decode(&kunwei_kwr75::encode(&unchecked)))
        }),
        ("ati_netcanoem", &|| {
            ati_netcanoem::decode(ati_netcanoem::FACTORY_BASE, &even).is_ok()
        }),
        ("amt21", &|| amt21::decode_position([0xAB, 0x61]).is_ok()),
        ("dynamixel2", &|| {
            whole(dynamixel2::decode(dynamixel2::encode(&status).as_slice()))
        }),
        ("encoder_line", &|| {
            whole(encoder_line::decode(line.as_slice()))
        }),
        ("pose_stream", &|| {
            whole(pose_stream::decode(&pose_stream::encode(&pose)))
        }),
        ("hid", &|| {
            matches!(axes[0].read(&[0x34, 0x12]), Ok(Some(0x1234)))
        }),
        ("gs_usb", &|| {
            let transfer = gs_usb::encode(u32::MAX, 0, &can);
            gs_usb::HostFrame::decode(&transfer, gs_usb::Stamps::Absent).is_ok()
        }),
    ];
    for (name, codec) in codecs {
        let before = ALLOCATIONS.with(Cell::get);
        let good = (0..1_000).all(|_| codec());
        let after = ALLOCATIONS.with(Cell::get);
        assert!(good, "{name} does not decode its own frame");
        assert_eq!(after, before, "{name}");
    }
}

fn bota() -> Sample {
    Sample {
        status: Status(0),
        force: [1.0; 3],
        torque: [0.1; 3],
        timestamp_us: 1_250,
        temperature_celsius: 25.0,
    }
}

fn whole<T>(parsed: Result<Parsed<T>, DecodeError>) -> bool {
    matches!(parsed, Ok(Parsed::Complete { .. }))
}
