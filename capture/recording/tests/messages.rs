//! Messages as bytes: golden ones from rosbags, round trips, and bytes that are no messages.
#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

use ft_recording::message::{
    DiagnosticArray, DiagnosticStatus, Header, Imu, JointState, KeyValue, Message, Pose,
    PoseStamped, TFMessage, Temperature, Text, Time, Transform, TransformStamped, WrenchStamped,
};
use ft_recording::{CdrError, message};
use ft_wire::HostTime;
use proptest::collection::vec;
use proptest::prelude::*;

fn unhex(text: &str) -> Vec<u8> {
    let digits: Vec<u32> = text
        .chars()
        .filter_map(|digit| digit.to_digit(16))
        .collect();
    digits
        .chunks(2)
        .map(|pair| (pair[0] * 16 + pair[1]) as u8)
        .collect()
}

fn header(frame_id: &str) -> Header {
    Header {
        stamp: Time { sec: 1, nanosec: 2 },
        frame_id: frame_id.to_owned(),
    }
}

/// Both byte orders are read to `message`, and `message` is written as `little`.
fn assert_golden<M: Message + PartialEq + std::fmt::Debug>(message: &M, little: &str, big: &str) {
    let mut bytes = Vec::new();
    message.encode(&mut bytes);
    assert_eq!(bytes, unhex(little));
    assert_eq!(&M::decode(&unhex(little)).unwrap(), message);
    assert_eq!(&M::decode(&unhex(big)).unwrap(), message);
}

// All golden bytes: rosbags 0.11.9, `serialize_cdr` of its Jazzy type store, both byte orders.

#[test]
fn a_wrench_is_written_as_rosbags_writes_it() {
    let wrench = [1.0, 2.0, 3.0, 0.1, 0.2, 0.3].into();
    assert_golden(
        &WrenchStamped { header: header("ft_sensor"), wrench },
        "00010000 01000000 02000000 0a000000 66745f73656e736f7200 0000 000000000000f03f 0000000000000040
         0000000000000840 9a9999999999b93f 9a9999999999c93f 333333333333d33f",
        "00000000 00000001 00000002 0000000a 66745f73656e736f7200 0000 3ff0000000000000 4000000000000000
         4008000000000000 3fb999999999999a 3fc999999999999a 3fd3333333333333",
    );
}

#[test]
fn a_temperature_is_written_as_rosbags_writes_it() {
    assert_golden(
        &Temperature {
            header: header("ft_sensor"),
            temperature: 31.5,
            variance: 0.25,
        },
        "00010000 01000000 02000000 0a000000 66745f73656e736f7200 0000 0000000000803f40 000000000000d03f",
        "00000000 00000001 00000002 0000000a 66745f73656e736f7200 0000 403f800000000000 3fd0000000000000",
    );
}

#[test]
fn an_imu_is_written_as_rosbags_writes_it() {
    let corners = |first: f64, last: f64| [first, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, last];
    let imu = Imu {
        header: header("ft_sensor"),
        orientation: [0.0, 0.0, 0.6, 0.8].into(),
        orientation_covariance: corners(-1.0, 0.0),
        angular_velocity: [1.0, 2.0, 3.0].into(),
        angular_velocity_covariance: corners(0.25, 0.5),
        linear_acceleration: [4.0, 5.0, 6.0].into(),
        linear_acceleration_covariance: [0.0; 9],
    };
    assert_eq!(imu.rate(), Some([1.0, 2.0, 3.0]));
    let not_measured = Imu {
        angular_velocity_covariance: corners(-1.0, 0.0),
        ..imu.clone()
    };
    assert_eq!(not_measured.rate(), None);
    assert_golden(
        &imu,
        "0001000001000000020000000a00000066745f73656e736f720000000000000000000000000000000000000033333333
         3333e33f9a9999999999e93f000000000000f0bf00000000000000000000000000000000000000000000000000000000
         000000000000000000000000000000000000000000000000000000000000000000000000000000000000f03f00000000
         000000400000000000000840000000000000d03f00000000000000000000000000000000000000000000000000000000
         00000000000000000000000000000000000000000000000000000000000000000000e03f000000000000104000000000
         000014400000000000001840000000000000000000000000000000000000000000000000000000000000000000000000
         000000000000000000000000000000000000000000000000000000000000000000000000",
        "0000000000000001000000020000000a66745f73656e736f72000000000000000000000000000000000000003fe33333
         333333333fe999999999999abff000000000000000000000000000000000000000000000000000000000000000000000
         0000000000000000000000000000000000000000000000000000000000000000000000003ff000000000000040000000
         0000000040080000000000003fd000000000000000000000000000000000000000000000000000000000000000000000
         000000000000000000000000000000000000000000000000000000003fe0000000000000401000000000000040140000
         000000004018000000000000000000000000000000000000000000000000000000000000000000000000000000000000
         000000000000000000000000000000000000000000000000000000000000000000000000",
    );
}

#[test]
fn a_joint_state_is_written_as_rosbags_writes_it() {
    let joints = JointState {
        header: header(""),
        name: vec!["gripper".to_owned()],
        position: vec![0.04],
        velocity: vec![0.0],
        effort: Vec::new(),
    };
    assert_golden(
        &joints,
        "00010000 01000000 02000000 01000000 00 000000 01000000 08000000 6772697070657200 01000000 00000000
         7b14ae47e17aa43f 01000000 00000000 0000000000000000 00000000",
        "00000000 00000001 00000002 00000001 00 000000 00000001 00000008 6772697070657200 00000001 00000000
         3fa47ae147ae147b 00000001 00000000 0000000000000000 00000000",
    );
}

#[test]
fn a_pose_is_written_as_rosbags_writes_it() {
    let pose = Pose {
        position: [1.0, 2.0, 3.0].into(),
        orientation: [0.0, 0.0, 0.6, 0.8].into(),
    };
    assert_golden(
        &PoseStamped { header: header("world"), pose },
        "00010000 01000000 02000000 06000000 776f726c6400 0000 00000000 000000000000f03f 0000000000000040
         0000000000000840 0000000000000000 0000000000000000 333333333333e33f 9a9999999999e93f",
        "00000000 00000001 00000002 00000006 776f726c6400 0000 00000000 3ff0000000000000 4000000000000000
         4008000000000000 0000000000000000 0000000000000000 3fe3333333333333 3fe999999999999a",
    );
}

#[test]
fn transforms_are_written_as_rosbags_writes_them() {
    let transform =
        |parent: &str, child: &str, translation: [f64; 3], rotation: [f64; 4]| TransformStamped {
            header: header(parent),
            child_frame_id: child.to_owned(),
            transform: Transform {
                translation: translation.into(),
                rotation: rotation.into(),
            },
        };
    let transforms = vec![
        transform("tcp", "ft_sensor", [1.0, 2.0, 3.0], [0.0, 0.0, 0.6, 0.8]),
        transform("a", "b", [0.0; 3], [0.0, 0.0, 0.0, 1.0]),
    ];
    assert_golden(
        &TFMessage { transforms },
        "0001000002000000010000000200000004000000746370000a00000066745f73656e736f720000000000000000000000
         0000f03f0000000000000040000000000000084000000000000000000000000000000000333333333333e33f9a999999
         9999e93f0100000002000000020000006100000002000000620000000000000000000000000000000000000000000000
         00000000000000000000000000000000000000000000000000000000000000000000f03f",
        "0000000000000002000000010000000200000004746370000000000a66745f73656e736f72000000000000003ff00000
         0000000040000000000000004008000000000000000000000000000000000000000000003fe33333333333333fe99999
         9999999a0000000100000002000000026100000000000002620000000000000000000000000000000000000000000000
         000000000000000000000000000000000000000000000000000000003ff0000000000000",
    );
}

#[test]
fn a_text_is_written_as_rosbags_writes_it() {
    assert_golden(
        &Text {
            data: "tare".to_owned(),
        },
        "00010000 05000000 7461726500",
        "00000000 00000005 7461726500",
    );
}

#[test]
fn diagnostics_are_written_as_rosbags_writes_them() {
    let value = |key: &str, value: &str| KeyValue {
        key: key.to_owned(),
        value: value.to_owned(),
    };
    let late = DiagnosticStatus {
        level: DiagnosticStatus::WARN,
        name: "ft_sensor".to_owned(),
        message: "late".to_owned(),
        hardware_id: "0001".to_owned(),
        values: vec![value("gaps", "3"), value("", "")],
    };
    let fine = DiagnosticStatus {
        name: "b".to_owned(),
        ..DiagnosticStatus::default()
    };
    assert_golden(
        &DiagnosticArray { header: header(""), status: vec![late, fine] },
        "000100000100000002000000010000000000000002000000010000000a00000066745f73656e736f7200000005000000
         6c6174650000000005000000303030310000000002000000050000006761707300000000020000003300000001000000
         00000000010000000000000002000000620000000100000000000000010000000000000000000000",
        "000000000000000100000002000000010000000000000002010000000000000a66745f73656e736f7200000000000005
         6c6174650000000000000005303030310000000000000002000000056761707300000000000000023300000000000001
         00000000000000010000000000000002620000000000000100000000000000010000000000000000",
    );
}

#[test]
fn stamps_and_host_instants_are_the_same() {
    for nanos in [0, 1, -1, 1_700_000_000_123_456_789, -1_500_000_000] {
        let at = HostTime::from_nanos(nanos);
        let stamp = Time::from(at);
        assert!(stamp.nanosec < 1_000_000_000);
        assert_eq!(HostTime::from(stamp), at);
    }
    assert_eq!(
        Time::from(HostTime::FAR_FUTURE),
        Time {
            sec: i32::MAX,
            nanosec: 999_999_999
        }
    );
    assert_eq!(
        Time::from(HostTime::from_nanos(i64::MIN)),
        Time {
            sec: i32::MIN,
            nanosec: 0
        }
    );
}

#[test]
fn a_grown_buffer_is_reused() {
    let mut buffer = Vec::new();
    let message = WrenchStamped {
        header: header("ft_sensor"),
        ..WrenchStamped::default()
    };
    message.encode(&mut buffer);
    let (address, capacity) = (buffer.as_ptr(), buffer.capacity());
    message.encode(&mut buffer);
    assert_eq!(
        (buffer.as_ptr(), buffer.capacity(), buffer.len()),
        (address, capacity, 76)
    );
}

#[test]
fn another_type_is_not_taken_for_a_wrench() {
    let mut bytes = Vec::new();
    PoseStamped {
        header: header("world"),
        ..PoseStamped::default()
    }
    .encode(&mut bytes);
    assert_eq!(
        WrenchStamped::decode(&bytes),
        Err(CdrError::Trailing {
            offset: 76,
            extra: 8
        })
    );
}

fn text() -> impl Strategy<Value = String> {
    "[^\0]{0,12}"
}

fn any_header() -> impl Strategy<Value = Header> {
    (any::<i32>(), 0..1_000_000_000_u32, text()).prop_map(|(sec, nanosec, frame_id)| Header {
        stamp: Time { sec, nanosec },
        frame_id,
    })
}

fn floats() -> impl Strategy<Value = Vec<f64>> {
    vec(-1e9..1e9_f64, 0..5)
}

prop_compose! {
    fn joints()(header in any_header(), name in vec(text(), 0..5), position in floats(), velocity in floats(),
                effort in floats()) -> JointState {
        JointState { header, name, position, velocity, effort }
    }
}

prop_compose! {
    fn transform()(header in any_header(), child_frame_id in text(), translation in any::<[f64; 3]>(),
                   rotation in any::<[f64; 4]>()) -> TransformStamped {
        let transform = Transform { translation: translation.into(), rotation: rotation.into() };
        TransformStamped { header, child_frame_id, transform }
    }
}

prop_compose! {
    fn status()(level in 0..4_u8, name in text(), message in text(), hardware_id in text(),
                values in vec((text(), text()), 0..4)) -> DiagnosticStatus {
        let values = values.into_iter().map(|(key, value)| KeyValue { key, value }).collect();
        DiagnosticStatus { level, name, message, hardware_id, values }
    }
}

/// Comes back the same, and every shorter prefix is refused.
fn assert_round_trip<M: Message + PartialEq + std::fmt::Debug>(message: &M) {
    let mut bytes = Vec::new();
    message.encode(&mut bytes);
    assert_eq!(&M::decode(&bytes).unwrap(), message);
    for end in 0..bytes.len() {
        assert!(
            M::decode(&bytes[..end]).is_err(),
            "the first {end} of {} bytes",
            bytes.len()
        );
    }
}

fn decode_all(bytes: &[u8]) {
    let _ = WrenchStamped::decode(bytes);
    let _ = Temperature::decode(bytes);
    let _ = JointState::decode(bytes);
    let _ = PoseStamped::decode(bytes);
    let _ = TransformStamped::decode(bytes);
    let _ = TFMessage::decode(bytes);
    let _ = Text::decode(bytes);
    let _ = DiagnosticArray::decode(bytes);
}

proptest! {
    #[test]
    fn every_message_comes_back_as_it_was(
        header in any_header(), six in any::<[f64; 6]>(), joints in joints(), data in text(),
        transforms in vec(transform(), 0..3), status in vec(status(), 0..3),
    ) {
        let wrench: message::Wrench = six.into();
        prop_assert_eq!(<[f64; 6]>::from(wrench), six);
        let [x, y, z, temperature, variance, w] = six;
        let pose = Pose { position: [x, y, z].into(), orientation: [x, y, z, w].into() };
        assert_round_trip(&WrenchStamped { header: header.clone(), wrench });
        assert_round_trip(&Temperature { header: header.clone(), temperature, variance });
        assert_round_trip(&PoseStamped { header: header.clone(), pose });
        assert_round_trip(&joints);
        assert_round_trip(&Text { data });
        for transform in &transforms {
            assert_round_trip(transform);
        }
        assert_round_trip(&TFMessage { transforms });
        assert_round_trip(&DiagnosticArray { header, status });
    }

    #[test]
    fn arbitrary_bytes_never_panic(mut bytes in vec(any::<u8>(), 0..200), plain in any::<bool>()) {
        if plain && bytes.len() > 4 {
            bytes[..4].copy_from_slice(&[0, 1, 0, 0]);
        }
        decode_all(&bytes);
    }

    #[test]
    fn flipped_bits_never_panic(joints in joints(), status in vec(status(), 0..3), bit in any::<prop::sample::Index>()) {
        let mut bytes = Vec::new();
        joints.encode(&mut bytes);
        let flipped = bit.index(bytes.len() * 8);
        bytes[flipped / 8] ^= 1 << (flipped % 8);
        decode_all(&bytes);
        DiagnosticArray { status, ..DiagnosticArray::default() }.encode(&mut bytes);
        let flipped = bit.index(bytes.len() * 8);
        bytes[flipped / 8] ^= 1 << (flipped % 8);
        decode_all(&bytes);
    }
}
