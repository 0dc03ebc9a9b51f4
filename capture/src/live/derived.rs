//! What is made for viewers that draw what they are told: transforms, a force arrow, a wrench that is easy to plot.
//!
//! | topic | type | what |
//! |---|---|---|
//! | `/tf` | tf2_msgs/msg/TFMessage | `world -> aria_device`, 50 Hz |
//! | `/ft/wrench_view` | geometry_msgs/msg/WrenchStamped | every 10 ms two: the least of each component, then the greatest |
//! | `/ft/force_arrow` | visualization_msgs/msg/Marker | the force on the tool, in `ft_sensor`, 4 mm for each N |

use ft_recording::message::{
    ColorRgba, Header, Marker, Point, Pose, TFMessage, Transform, TransformStamped, WrenchStamped,
};
use ft_wire::HostTime;
use ft_wire::frames::{AriaDevice, Frame, FtSensor, World};

use super::hub::Whole;
use super::picture::Picture;
use super::strip::{BIN, Bin};

/// `/tf`
pub const TF: &str = "/tf";
/// `/ft/wrench_view`
pub const WRENCH_VIEW: &str = "/ft/wrench_view";
/// `/ft/force_arrow`
pub const FORCE_ARROW: &str = "/ft/force_arrow";

/// m per N.
const ARROW_SCALE: f64 = 0.004;

/// The messages for `bins` and the latest of `picture`.
pub(super) fn messages(picture: &Picture, bins: &[Bin]) -> Vec<Whole> {
    let mut out = Vec::new();
    for bin in bins {
        let begin = HostTime::from_nanos(bin.begin_ns);
        for (at, values) in [(begin, bin.least), (begin + BIN / 2, bin.greatest)] {
            let message = WrenchStamped {
                header: Header::new(at, FtSensor::NAME),
                wrench: values.map(f64::from).into(),
            };
            out.push(Whole::new(WRENCH_VIEW, at, &message));
        }
    }
    let Some(([x, y, z, ..], at)) = picture.wrench else {
        return out;
    };
    out.push(Whole::new(FORCE_ARROW, at, &arrow([x, y, z], at)));
    if let Some(pose) = picture.world_from_device() {
        let turn = pose.rotation.coords;
        let message = TFMessage {
            transforms: vec![TransformStamped {
                header: Header::new(at, World::NAME),
                child_frame_id: AriaDevice::NAME.to_owned(),
                transform: Transform {
                    translation: <[f64; 3]>::from(pose.translation.vector).into(),
                    rotation: [turn.x, turn.y, turn.z, turn.w].into(),
                },
            }],
        };
        out.push(Whole::new(TF, at, &message));
    }
    out
}

fn arrow(force: [f64; 3], at: HostTime) -> Marker {
    Marker {
        header: Header::new(at, FtSensor::NAME),
        ns: "force".to_owned(),
        pose: Pose {
            position: Point::default(),
            orientation: [0.0, 0.0, 0.0, 1.0].into(),
        },
        scale: [0.008, 0.016, 0.02].into(),
        color: ColorRgba {
            r: 1.0,
            g: 0.55,
            b: 0.0,
            a: 1.0,
        },
        frame_locked: true,
        points: vec![
            Point::default(),
            force.map(|part| part * ARROW_SCALE).into(),
        ],
        ..Marker::default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ft_recording::message::Message as _;

    #[test]
    fn the_arrow_points_where_the_force_does() {
        let marker = arrow([0.0, -25.0, 5.0], HostTime::EPOCH);
        let tip: [f64; 3] = marker.points[1].into();
        assert_eq!(tip, [0.0, -0.1, 0.02]);
        let mut bytes = Vec::new();
        marker.encode(&mut bytes);
        assert_eq!(Marker::decode(&bytes).unwrap(), marker);
    }

    #[test]
    fn a_peak_is_in_the_wrench_to_plot() {
        let bin = Bin {
            begin_ns: 20_000_000,
            least: [-40.0, 0.0, 0.0, 0.0, 0.0, 0.0],
            greatest: [1.0, 0.0, 0.0, 0.0, 0.0, 2.0],
        };
        let messages = messages(&Picture::new("here"), &[bin]);
        let wrenches: Vec<[f64; 6]> = messages
            .iter()
            .map(|message| {
                WrenchStamped::decode(&message.payload)
                    .unwrap()
                    .wrench
                    .into()
            })
            .collect();
        assert_eq!(wrenches.len(), 2);
        assert_eq!((wrenches[0][0], wrenches[1][5]), (-40.0, 2.0));
        assert!(messages[0].at < messages[1].at);
    }
}
