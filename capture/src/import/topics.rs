//! Topics of recordings that imports write. What was recorded by others arrives when it is true.

use std::collections::BTreeMap;

use ft_recording::message::{Header, Imu, PoseStamped, Temperature, WrenchStamped};
use ft_recording::qos::Qos;
use ft_recording::rewrite::Rewrite;
use ft_recording::{Message, MessageStamps, Pose7, Stamped, topic};
use ft_wire::HostTime;
use ft_wire::frames::{Frame, FtSensor, World};
use serde::Serialize;

/// The metadata `ft.import`.
pub(super) fn import_entries(kind: &str, report: &impl Serialize) -> BTreeMap<String, String> {
    let json = serde_json::to_string(report).unwrap_or_default();
    BTreeMap::from([
        ("kind".to_owned(), kind.to_owned()),
        ("json".to_owned(), json),
    ])
}

/// Stamps of what arrives when it is true.
pub(super) const fn true_at(at: HostTime) -> MessageStamps {
    MessageStamps {
        log_time: at,
        publish_time: at,
    }
}

/// Adds a topic with a message for each sample; none when there are none.
fn add<T, M: Message>(
    rewrite: &mut Rewrite<'_>,
    topic: &str,
    samples: &[Stamped<T>],
    message: impl Fn(&Stamped<T>) -> M,
) {
    if !samples.is_empty() {
        let messages = samples
            .iter()
            .map(|sample| (true_at(sample.at), message(sample)));
        rewrite.add(topic, Qos::SENSOR, messages);
    }
}

/// Adds `/ft/wrench`, N and N m in `ft_sensor`.
pub(super) fn add_wrench(rewrite: &mut Rewrite<'_>, samples: &[Stamped<[f64; 6]>]) {
    add(rewrite, topic::WRENCH, samples, |sample| WrenchStamped {
        header: Header::new(sample.at, FtSensor::NAME),
        wrench: sample.value.into(),
    });
}

/// Adds `/ft/temperature`, degrees Celsius.
pub(super) fn add_temperature(rewrite: &mut Rewrite<'_>, samples: &[Stamped<f64>]) {
    add(rewrite, topic::TEMPERATURE, samples, |sample| Temperature {
        header: Header::new(sample.at, FtSensor::NAME),
        temperature: sample.value,
        variance: 0.0,
    });
}

/// Adds `/ft/imu` of a gyroscope alone, rad/s in axes of its own.
pub(super) fn add_rates(rewrite: &mut Rewrite<'_>, samples: &[Stamped<[f64; 3]>]) {
    add(rewrite, topic::IMU, samples, |sample| {
        Imu::of_rate(Header::new(sample.at, "ft_imu"), sample.value)
    });
}

/// Adds `world_from_<frame>` as a topic.
pub(super) fn add_poses(rewrite: &mut Rewrite<'_>, name: &str, samples: &[Stamped<Pose7>]) {
    add(rewrite, name, samples, |sample| {
        let mut message = PoseStamped {
            header: Header::new(sample.at, World::NAME),
            ..PoseStamped::default()
        };
        message.pose.position = sample.value.position.into();
        message.pose.orientation = sample.value.quaternion.into();
        message
    });
}
