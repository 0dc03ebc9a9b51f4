//! Nanoseconds per frame of each codec, and the proof that none allocates: `cargo bench -p ft-wire --profile dev`.
//!
//! divan prints the allocations of each benchmark below its line; no such lines means there were none.
#![allow(missing_docs, clippy::expect_used, reason = "benchmarks")]

use divan::{AllocProfiler, Bencher, black_box};
use ft_wire::dynamixel2::{self, Packet, Params, PresentState, StatusError};
use ft_wire::pose_stream::{self, PoseSample};
use ft_wire::robotous_rft::{self, CanIds, Half, Record, Response};
use ft_wire::{CanFrame, bota_serial};

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
