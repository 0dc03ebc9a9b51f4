//! The streams: what each device sends as its sample number `index`, when its clock shows `ticks` periods.

use std::f64::consts::TAU;

use ft_drivers::hid_axis::{self, HidFrame};
use ft_drivers::options::Startup;
use ft_drivers::{
    Device as _, RxStamps, bota_serial, encoder_line, kunwei_kwr75, leptrino, optoforce,
    optoforce_can, optoforce_serial, pose_stream, robotous, robotous_can, robotous_uart,
};
use ft_wire::hid::{Report, Usage};
use ft_wire::robotous_rft::{CanIds, Record, Response, encode_response, response_frames};
use ft_wire::{CanFrame, Chunk, HostTime, optoforce_hex};

/// Counts that tell samples apart: slow enough for a sensor without check sum.
pub(crate) fn counts(index: usize) -> [i16; 6] {
    let t = index as f64 / 2_000.0;
    [0, 1, 2, 3, 4, 5].map(|axis| (9_000.0 * (TAU * t + f64::from(axis)).sin()) as i16)
}

pub(crate) fn chunk(bytes: &[u8]) -> Vec<Chunk> {
    vec![Chunk::new(bytes).unwrap()]
}

pub(crate) fn bota() -> bota_serial::BotaSerial {
    bota_serial::BotaSerial::new(bota_serial::Config {
        startup: Startup::Listen,
        ..bota_serial::Config::default()
    })
}

pub(crate) fn bota_sample(index: usize, ticks: u64, overload: bool) -> Vec<Chunk> {
    let [fx, fy, fz, tx, ty, tz] = counts(index).map(|count| f32::from(count) / 100.0);
    chunk(&ft_wire::bota_serial::encode(
        &ft_wire::bota_serial::Sample {
            status: ft_wire::bota_serial::Status(if overload { 2 } else { 0 }),
            force: [fx, fy, fz],
            torque: [tx, ty, tz],
            timestamp_us: (ticks * 1_000) as u32,
            temperature_celsius: 25.0,
        },
    ))
}

fn record(index: usize, overload: bool) -> Response {
    let [fx, fy, fz, tx, ty, tz] = counts(index);
    Response::Stream(Record {
        force: [fx, fy, fz],
        torque: [tx, ty, tz],
        overload: if overload { 0x20 } else { 0 },
    })
}

fn rft_config() -> robotous::Config {
    robotous::Config {
        startup: Startup::Listen,
        ..robotous::Config::default()
    }
}

pub(crate) fn rft_uart() -> robotous_uart::RobotousUart {
    robotous_uart::RobotousUart::new(robotous_uart::Config {
        sensor: rft_config(),
        ..robotous_uart::Config::default()
    })
}

pub(crate) fn rft_uart_sample(index: usize, _ticks: u64, overload: bool) -> Vec<Chunk> {
    chunk(&encode_response(&record(index, overload)))
}

pub(crate) fn rft_can() -> robotous_can::RobotousCan {
    robotous_can::RobotousCan::new(robotous_can::Config {
        // A sample every millisecond, as the matrix has them.
        sensor: robotous::Config {
            rate_hz: 1000,
            ..rft_config()
        },
        ..robotous_can::Config::default()
    })
}

pub(crate) fn rft_can_sample(index: usize, _ticks: u64, overload: bool) -> Vec<CanFrame> {
    response_frames(CanIds::default(), &record(index, overload)).to_vec()
}

fn hex_config() -> optoforce::Config {
    let scale = optoforce::Scale {
        counts_per_newton: [50.0; 3],
        counts_per_newton_metre: [2_000.0; 3],
    };
    optoforce::Config {
        rate_hz: 1000,
        startup: Startup::Listen,
        ..optoforce::Config::new(scale)
    }
}

fn hex_packet(index: usize, ticks: u64, overload: bool) -> Chunk {
    let [fx, fy, fz, tx, ty, tz] = counts(index);
    optoforce_hex::encode(&optoforce_hex::Packet::Sample(optoforce_hex::Sample {
        counter: ticks as u16,
        status: optoforce_hex::Status(if overload { 0x200 } else { 0 }),
        force: [fx, fy, fz],
        torque: Some([tx, ty, tz]),
    }))
}

pub(crate) fn hex_serial() -> optoforce_serial::OptoforceSerial {
    optoforce_serial::OptoforceSerial::new(hex_config())
}

pub(crate) fn hex_serial_sample(index: usize, ticks: u64, overload: bool) -> Vec<Chunk> {
    vec![hex_packet(index, ticks, overload)]
}

pub(crate) fn hex_can() -> optoforce_can::OptoforceCan {
    optoforce_can::OptoforceCan::new(optoforce_can::Config::new(hex_config()))
}

pub(crate) fn hex_can_sample(index: usize, ticks: u64, overload: bool) -> Vec<CanFrame> {
    hex_packet(index, ticks, overload)
        .as_slice()
        .chunks(8)
        .map(|payload| CanFrame::standard(0x100, payload).unwrap())
        .collect()
}

pub(crate) fn kwr75() -> kunwei_kwr75::KunweiKwr75 {
    kunwei_kwr75::KunweiKwr75::new(kunwei_kwr75::Config {
        startup: Startup::Listen,
        ..kunwei_kwr75::Config::default()
    })
}

pub(crate) fn kwr75_sample(index: usize, _ticks: u64, _overload: bool) -> Vec<Chunk> {
    let [fx, fy, fz, tx, ty, tz] = counts(index).map(|count| f32::from(count) / 1_000.0);
    let sample = ft_wire::kunwei_kwr75::Sample {
        asked: false,
        force_kg: [fx, fy, fz],
        torque_kgm: [tx / 100.0, ty / 100.0, tz / 100.0],
    };
    chunk(&ft_wire::kunwei_kwr75::encode(&sample))
}

pub(crate) fn leptrino() -> leptrino::Leptrino {
    leptrino::Leptrino::new(leptrino::Config {
        limits: Some([500.0, 500.0, 1000.0, 10.0, 10.0, 10.0]),
        startup: Startup::Listen,
        ..leptrino::Config::default()
    })
}

pub(crate) fn leptrino_sample(index: usize, _ticks: u64, overload: bool) -> Vec<Chunk> {
    let sample = ft_wire::leptrino::Sample {
        streamed: true,
        raw: counts(index),
        status: ft_wire::leptrino::Status(if overload { 4 } else { 0 }),
    };
    vec![ft_wire::leptrino::encode(
        &ft_wire::leptrino::Message::Sample(sample),
    )]
}

pub(crate) fn encoder() -> encoder_line::EncoderLine {
    encoder_line::EncoderLine::new(encoder_line::Config::new(65_536.0))
}

pub(crate) fn encoder_sample(index: usize, ticks: u64, _overload: bool) -> Vec<Chunk> {
    vec![ft_wire::encoder_line::encode(
        &ft_wire::encoder_line::Sample {
            time_us: (ticks * 1_000) as u32,
            counts: 20_000 + index as i32,
        },
    )]
}

pub(crate) fn pose() -> pose_stream::PoseStream {
    pose_stream::PoseStream::new(pose_stream::Config::default())
}

pub(crate) fn pose_sample(index: usize, ticks: u64, _overload: bool) -> Vec<Chunk> {
    chunk(&ft_wire::pose_stream::encode(
        &ft_wire::pose_stream::PoseSample {
            tracking_ns: ticks as i64 * 1_000_000,
            position: [index as f64 * 1e-3, 0.0, 1.0],
            quaternion: [0.0, 0.0, 0.0, 1.0],
            quality_score: 1.0,
        },
    ))
}

/// A slider of 16 bits in report 3.
const SLIDER: &[u8] = &[
    0x05, 0x01, 0x09, 0x04, 0xA1, 0x01, 0x85, 0x03, 0x09, 0x36, 0x15, 0x00, 0x27, 0xFF, 0xFF, 0x00,
    0x00, 0x75, 0x10, 0x95, 0x01, 0x81, 0x02, 0xC0,
];

/// A driver that has read the slider's descriptor.
pub(crate) fn hid() -> hid_axis::HidAxis {
    let mut driver = hid_axis::HidAxis::new(hid_axis::Config {
        usage: Usage::Slider,
        counts_per_turn: Some(65_536.0),
        ..hid_axis::Config::default()
    });
    driver.handle_timeout(HostTime::EPOCH);
    let stamps = RxStamps {
        arrival: HostTime::EPOCH,
    };
    driver
        .handle_frame(&HidFrame::Descriptor(SLIDER.into()), stamps)
        .unwrap();
    driver
}

pub(crate) fn hid_sample(index: usize, _ticks: u64, _overload: bool) -> Vec<HidFrame> {
    let [low, high] = (20_000 + index as u16).to_le_bytes();
    vec![HidFrame::Report(Report::new(&[3, low, high]).unwrap())]
}
