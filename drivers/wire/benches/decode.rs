//! Nanoseconds per frame of each codec, and the proof that none allocates: `cargo bench -p ft-wire --profile dev`.
//!
//! divan prints the allocations of each benchmark below its line; no such lines means there were none.
#![allow(missing_docs, clippy::expect_used, reason = "benchmarks")]

use divan::{AllocProfiler, Bencher, black_box};
use ft_wire::dynamixel2::{self, Packet, Params, PresentState, StatusError};
use ft_wire::pose_stream::{self, PoseSample};
use ft_wire::robotous_rft::{self, CanIds, Half, Record, Response};
use ft_wire::{
    CanFrame, amt21, ati_netcanoem, bota_serial, encoder_line, gs_usb, hid, kunwei_kwr75, leptrino,
    optoforce_hex,
};

#[global_allocator]
static ALLOC: AllocProfiler = AllocProfiler::system();

fn main() {
    divan::main();
}

const BOTA: bota_serial::Sample = bota_serial::Sample {
    status: bota_serial::Status(0),
    force: [1.0, -2.0, 3.5],
    torque: [0.1, -0.2, 0.3],
    timestamp_us: 1_000_000,
    temperature_celsius: 25.0,
};

const ROBOTOUS: Response = Response::Stream(Record {
    force: [617, -250, -1001],
    torque: [500, -1000, 2000],
    overload: 0,
});

const POSE: PoseSample = PoseSample {
    tracking_ns: 1_234_567_890_123,
    position: [1.0, -2.0, 0.5],
    quaternion: [0.5, -0.5, 0.5, 0.5],
    quality_score: 0.75,
};

fn dynamixel_status() -> Packet {
    let state = PresentState {
        current: -100,
        velocity: 5,
        position: 2048,
    };
    let params = Params::new(&state.encode()).expect("ten bytes fit");
    Packet::Status {
        id: 1,
        error: StatusError(0),
        params,
    }
}

#[divan::bench]
fn bota_decode(bencher: Bencher<'_, '_>) {
    let frame = bota_serial::encode(&BOTA);
    bencher.bench(|| bota_serial::decode(black_box(&frame)));
}

#[divan::bench]
fn bota_encode(bencher: Bencher<'_, '_>) {
    bencher.bench(|| bota_serial::encode(black_box(&BOTA)));
}

#[divan::bench]
fn robotous_serial_decode(bencher: Bencher<'_, '_>) {
    let frame = robotous_rft::encode_response(&ROBOTOUS);
    bencher.bench(|| robotous_rft::decode_response(black_box(&frame)));
}

#[divan::bench]
fn robotous_can_decode_and_join(bencher: Bencher<'_, '_>) {
    let ids = CanIds::default();
    let halves: [CanFrame; 2] = robotous_rft::response_frames(ids, &ROBOTOUS);
    bencher.bench(|| {
        let [first, second] = black_box(&halves);
        match (
            robotous_rft::decode_half(ids, first),
            robotous_rft::decode_half(ids, second),
        ) {
            (Ok(Half::First(first)), Ok(Half::Second(second))) => {
                robotous_rft::join(first, second).ok()
            }
            _ => None,
        }
    });
}

#[divan::bench]
fn optoforce_decode(bencher: Bencher<'_, '_>) {
    let sample = optoforce_hex::Sample {
        counter: 7,
        status: optoforce_hex::Status(0),
        force: [100, -200, 300],
        torque: Some([-50, 60, -70]),
    };
    let frame = optoforce_hex::encode(&optoforce_hex::Packet::Sample(sample));
    bencher.bench(|| optoforce_hex::decode(black_box(frame.as_slice())));
}

#[divan::bench]
fn leptrino_decode(bencher: Bencher<'_, '_>) {
    let sample = leptrino::Sample {
        streamed: true,
        raw: [16, -1000, 4112, 0, 5000, -10_000],
        status: leptrino::Status(0),
    };
    let frame = leptrino::encode(&leptrino::Message::Sample(sample));
    bencher.bench(|| leptrino::decode(black_box(frame.as_slice())));
}

#[divan::bench]
fn kunwei_decode(bencher: Bencher<'_, '_>) {
    let frame = kunwei_kwr75::encode(&kunwei_kwr75::Sample {
        asked: false,
        force_kg: [-9.78, -7.41, 7.51],
        torque_kgm: [-0.17, 0.3, -0.005],
    });
    bencher.bench(|| kunwei_kwr75::decode(black_box(&frame)));
}

#[divan::bench]
fn ati_decode_both_halves(bencher: Bencher<'_, '_>) {
    let even = CanFrame::standard(0x200, &[0, 0, 3, 0xE8, 0x0B, 0xB8, 0x13, 0x88]);
    let odd = CanFrame::standard(0x201, &[0xF8, 0x30, 0xF0, 0x60, 0xE8, 0x90]);
    let halves = [even.expect("8 bytes"), odd.expect("6 bytes")];
    bencher.bench(|| {
        let [even, odd] = black_box(&halves);
        let base = ati_netcanoem::FACTORY_BASE;
        (
            ati_netcanoem::decode(base, even),
            ati_netcanoem::decode(base, odd),
        )
    });
}

#[divan::bench]
fn amt21_decode(bencher: Bencher<'_, '_>) {
    bencher.bench(|| amt21::decode_position(black_box([0xAB, 0x61])));
}

#[divan::bench]
fn encoder_line_decode(bencher: Bencher<'_, '_>) {
    let line = encoder_line::encode(&encoder_line::Sample {
        time_us: 1_000_000,
        counts: 2048,
    });
    bencher.bench(|| encoder_line::decode(black_box(line.as_slice())));
}

#[divan::bench]
fn hid_axis_read(bencher: Bencher<'_, '_>) {
    let axes = hid::axes(JOYSTICK).expect("a good descriptor");
    let report = [3, 0x34, 0x12, 0x78, 0x56];
    bencher.bench(|| axes.first().map(|axis| axis.read(black_box(&report))));
}

/// Report 3: X and Y, 16 bits each.
const JOYSTICK: &[u8] = &[
    0x05, 0x01, 0x09, 0x04, 0xA1, 0x01, 0x85, 0x03, 0x09, 0x30, 0x09, 0x31, 0x15, 0x00, 0x27, 0xFF,
    0xFF, 0x00, 0x00, 0x75, 0x10, 0x95, 0x02, 0x81, 0x02, 0xC0,
];

#[divan::bench]
fn dynamixel_decode(bencher: Bencher<'_, '_>) {
    let frame = dynamixel2::encode(&dynamixel_status());
    bencher.bench(|| dynamixel2::decode(black_box(frame.as_slice())));
}

#[divan::bench]
fn dynamixel_encode(bencher: Bencher<'_, '_>) {
    let packet = dynamixel_status();
    bencher.bench(|| dynamixel2::encode(black_box(&packet)));
}

#[divan::bench]
fn pose_stream_decode(bencher: Bencher<'_, '_>) {
    let frame = pose_stream::encode(&POSE);
    bencher.bench(|| pose_stream::decode(black_box(&frame)));
}

#[divan::bench]
fn pose_stream_encode(bencher: Bencher<'_, '_>) {
    bencher.bench(|| pose_stream::encode(black_box(&POSE)));
}

#[divan::bench]
fn gs_usb_decode(bencher: Bencher<'_, '_>) {
    let frame = CanFrame::standard(1, &[0x0B; 8]).expect("eight bytes fit");
    let transfer = gs_usb::encode(u32::MAX, 0, &frame);
    bencher.bench(|| gs_usb::HostFrame::decode(black_box(&transfer), gs_usb::Stamps::Absent));
}
