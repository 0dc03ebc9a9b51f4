//! The ROS 2 messages of a recording, field for field as common_interfaces defines them.

use ft_wire::HostTime;

use crate::cdr::{CdrError, Decoder, Encoder};
use crate::schema;

/// A message that a recording carries on a topic.
pub trait Message: Sized {
    /// ROS 2 name, `geometry_msgs/msg/WrenchStamped`.
    const TYPE_NAME: &'static str;
    /// RIHS01 type hash, `RIHS01_` and 64 hex digits.
    const TYPE_HASH: &'static str;
    /// `ros2msg` definition with every type it uses.
    const DEFINITION: &'static str;

    /// Replaces the content of `out` by this message as little-endian CDR with its 4-byte header. Allocates nothing once
    /// `out` has grown.
    fn encode(&self, out: &mut Vec<u8>);

    /// Reads CDR of either byte order.
    ///
    /// # Errors
    /// When the bytes are not plain CDR, end early, hold text that is not UTF-8, or go on after the last field.
    fn decode(bytes: &[u8]) -> Result<Self, CdrError>;
}

/// One field's or struct's place in a CDR body.
trait Field: Sized {
    fn write(&self, encoder: &mut Encoder<'_>);
    fn read(decoder: &mut Decoder<'_>) -> Result<Self, CdrError>;
}

macro_rules! primitive {
    ($($type:ty, $method:ident;)*) => {$(
        impl Field for $type {
            fn write(&self, encoder: &mut Encoder<'_>) {
                encoder.$method(*self);
            }
            fn read(decoder: &mut Decoder<'_>) -> Result<Self, CdrError> {
                decoder.$method()
            }
        }
    )*};
}
primitive! { u8, u8; i32, i32; u32, u32; f32, f32; f64, f64; bool, bool; }

impl Field for String {
    fn write(&self, encoder: &mut Encoder<'_>) {
        encoder.text(self);
    }
    fn read(decoder: &mut Decoder<'_>) -> Result<Self, CdrError> {
        decoder.text()
    }
}

impl<const N: usize> Field for [f64; N] {
    fn write(&self, encoder: &mut Encoder<'_>) {
        for element in self {
            encoder.f64(*element);
        }
    }
    fn read(decoder: &mut Decoder<'_>) -> Result<Self, CdrError> {
        let mut elements = [0.0; N];
        for element in &mut elements {
            *element = decoder.f64()?;
        }
        Ok(elements)
    }
}

impl<T: Field> Field for Vec<T> {
    fn write(&self, encoder: &mut Encoder<'_>) {
        encoder.count(self.len());
        for element in self {
            element.write(encoder);
        }
    }
    fn read(decoder: &mut Decoder<'_>) -> Result<Self, CdrError> {
        decoder.sequence(T::read)
    }
}

macro_rules! structs {
    ($($(#[$doc:meta])* $name:ident { $($(#[$field_doc:meta])* $field:ident: $type:ty,)* })*) => {$(
        $(#[$doc])*
        pub struct $name {
            $($(#[$field_doc])* pub $field: $type,)*
        }
        impl Field for $name {
            fn write(&self, encoder: &mut Encoder<'_>) {
                $(self.$field.write(encoder);)*
            }
            fn read(decoder: &mut Decoder<'_>) -> Result<Self, CdrError> {
                Ok(Self { $($field: <$type>::read(decoder)?,)* })
            }
        }
    )*};
}

macro_rules! messages {
    ($($name:ident, $type_name:literal, $definition:ident, $hash:ident;)*) => {$(
        impl Message for $name {
            const TYPE_NAME: &'static str = $type_name;
            const TYPE_HASH: &'static str = schema::$hash;
            const DEFINITION: &'static str = schema::$definition;

            fn encode(&self, out: &mut Vec<u8>) {
                self.write(&mut Encoder::new(out));
            }

            fn decode(bytes: &[u8]) -> Result<Self, CdrError> {
                let mut decoder = Decoder::new(bytes)?;
                let message = Self::read(&mut decoder)?;
                decoder.finish()?;
                Ok(message)
            }
        }
    )*};
}

structs! {
    /// `builtin_interfaces/msg/Time`, since the Unix epoch.
    #[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
    Time {
        /// Seconds; negative before 1970.
        sec: i32,
        /// Nanoseconds after `sec`, below 1e9.
        nanosec: u32,
    }

    /// `std_msgs/msg/Header`.
    #[derive(Clone, Debug, Default, PartialEq, Eq)]
    Header {
        /// When the content was true, host clock.
        stamp: Time,
        /// Frame of the content.
        frame_id: String,
    }

    /// `geometry_msgs/msg/Vector3`.
    #[derive(Clone, Copy, Debug, Default, PartialEq)]
    Vector3 {
        /// Along x.
        x: f64,
        /// Along y.
        y: f64,
        /// Along z.
        z: f64,
    }

    /// `geometry_msgs/msg/Point`, m.
    #[derive(Clone, Copy, Debug, Default, PartialEq)]
    Point {
        /// Along x.
        x: f64,
        /// Along y.
        y: f64,
        /// Along z.
        z: f64,
    }

    /// `geometry_msgs/msg/Quaternion`; the default is all zeros, as in ROS 1, not the identity.
    #[derive(Clone, Copy, Debug, Default, PartialEq)]
    Quaternion {
        /// Vector part, x.
        x: f64,
        /// Vector part, y.
        y: f64,
        /// Vector part, z.
        z: f64,
        /// Scalar part.
        w: f64,
    }

    /// `geometry_msgs/msg/Wrench`.
    #[derive(Clone, Copy, Debug, Default, PartialEq)]
    Wrench {
        /// N.
        force: Vector3,
        /// N m.
        torque: Vector3,
    }

    /// `geometry_msgs/msg/WrenchStamped`.
    #[derive(Clone, Debug, Default, PartialEq)]
    WrenchStamped {
        /// Sample time and frame.
        header: Header,
        /// Environment on tool, at the origin and in the axes of the header's frame.
        wrench: Wrench,
    }

    /// `sensor_msgs/msg/Temperature`.
    #[derive(Clone, Debug, Default, PartialEq)]
    Temperature {
        /// Sample time and frame.
        header: Header,
        /// Degrees Celsius.
        temperature: f64,
        /// (degrees Celsius)^2; 0 when unknown.
        variance: f64,
    }

    /// `sensor_msgs/msg/Imu`. A covariance is row by row about x, y, z, all zeros when unknown; one that begins with -1 says that its
    /// quantity is not measured.
    #[derive(Clone, Debug, Default, PartialEq)]
    Imu {
        /// Sample time and frame.
        header: Header,
        /// Unit quaternion.
        orientation: Quaternion,
        /// rad^2.
        orientation_covariance: [f64; 9],
        /// rad/s, in the header's frame.
        angular_velocity: Vector3,
        /// (rad/s)^2.
        angular_velocity_covariance: [f64; 9],
        /// m/s^2, in the header's frame; a still one reads +9.8 upwards.
        linear_acceleration: Vector3,
        /// (m/s^2)^2.
        linear_acceleration_covariance: [f64; 9],
    }

    /// `sensor_msgs/msg/JointState`. An array is empty or as long as `name`.
    #[derive(Clone, Debug, Default, PartialEq)]
    JointState {
        /// Sample time and frame.
        header: Header,
        /// Joints.
        name: Vec<String>,
        /// m or rad.
        position: Vec<f64>,
        /// m/s or rad/s.
        velocity: Vec<f64>,
        /// N or N m.
        effort: Vec<f64>,
    }

    /// `geometry_msgs/msg/Pose`.
    #[derive(Clone, Copy, Debug, Default, PartialEq)]
    Pose {
        /// m.
        position: Point,
        /// Unit quaternion.
        orientation: Quaternion,
    }

    /// `geometry_msgs/msg/PoseStamped`.
    #[derive(Clone, Debug, Default, PartialEq)]
    PoseStamped {
        /// Sample time and the frame in which the pose stands.
        header: Header,
        /// The pose.
        pose: Pose,
    }

    /// `geometry_msgs/msg/Transform`.
    #[derive(Clone, Copy, Debug, Default, PartialEq)]
    Transform {
        /// m.
        translation: Vector3,
        /// Unit quaternion.
        rotation: Quaternion,
    }

    /// `geometry_msgs/msg/TransformStamped`: takes coordinates in the child frame to the header's frame.
    #[derive(Clone, Debug, Default, PartialEq)]
    TransformStamped {
        /// Sample time and parent frame.
        header: Header,
        /// Child frame.
        child_frame_id: String,
        /// `parent_from_child`.
        transform: Transform,
    }

    /// `tf2_msgs/msg/TFMessage`.
    #[derive(Clone, Debug, Default, PartialEq)]
    TFMessage {
        /// In no order.
        transforms: Vec<TransformStamped>,
    }

    /// `std_msgs/msg/String`. A NUL ends the text.
    #[derive(Clone, Debug, Default, PartialEq, Eq)]
    Text {
        /// The text.
        data: String,
    }

    /// `diagnostic_msgs/msg/KeyValue`.
    #[derive(Clone, Debug, Default, PartialEq, Eq)]
    KeyValue {
        /// Label.
        key: String,
        /// Value as text.
        value: String,
    }

    /// `diagnostic_msgs/msg/DiagnosticStatus`.
    #[derive(Clone, Debug, Default, PartialEq, Eq)]
    DiagnosticStatus {
        /// [`Self::OK`], [`Self::WARN`], [`Self::ERROR`] or [`Self::STALE`].
        level: u8,
        /// Component.
        name: String,
        /// What is the matter.
        message: String,
        /// Serial number or other identity of the hardware.
        hardware_id: String,
        /// Figures.
        values: Vec<KeyValue>,
    }

    /// `diagnostic_msgs/msg/DiagnosticArray`.
    #[derive(Clone, Debug, Default, PartialEq, Eq)]
    DiagnosticArray {
        /// When the figures were taken.
        header: Header,
        /// One per component.
        status: Vec<DiagnosticStatus>,
    }

    /// `std_msgs/msg/ColorRGBA`, 0 to 1.
    #[derive(Clone, Copy, Debug, Default, PartialEq)]
    ColorRgba {
        /// Red.
        r: f32,
        /// Green.
        g: f32,
        /// Blue.
        b: f32,
        /// Opacity.
        a: f32,
    }

    /// `builtin_interfaces/msg/Duration`.
    #[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
    RosDuration {
        /// Seconds.
        sec: i32,
        /// Nanoseconds after `sec`, below 1e9.
        nanosec: u32,
    }

    /// `sensor_msgs/msg/CompressedImage`.
    #[derive(Clone, Debug, Default, PartialEq, Eq)]
    CompressedImage {
        /// When it was taken.
        header: Header,
        /// `jpeg`, `png`.
        format: String,
        /// The file.
        data: Vec<u8>,
    }

    /// `visualization_msgs/msg/UVCoordinate`.
    #[derive(Clone, Copy, Debug, Default, PartialEq)]
    UvCoordinate {
        /// Along the texture's width.
        u: f32,
        /// Along its height.
        v: f32,
    }

    /// `visualization_msgs/msg/MeshFile`.
    #[derive(Clone, Debug, Default, PartialEq, Eq)]
    MeshFile {
        /// Its name.
        filename: String,
        /// Its content.
        data: Vec<u8>,
    }

    /// `visualization_msgs/msg/Marker`, as Jazzy and later have it.
    #[derive(Clone, Debug, Default, PartialEq)]
    Marker {
        /// When and in which frame it stands.
        header: Header,
        /// With `id` names the marker.
        ns: String,
        /// With `ns` names the marker.
        id: i32,
        /// 0 is an arrow.
        kind: i32,
        /// 0 adds or changes it.
        action: i32,
        /// Where it stands; `points` are in it.
        pose: Pose,
        /// Of an arrow between two points: shaft diameter, head diameter, head length, m.
        scale: Vector3,
        /// Colour.
        color: ColorRgba,
        /// How long it stays; 0 is for ever.
        lifetime: RosDuration,
        /// Whether it moves with its frame.
        frame_locked: bool,
        /// Of an arrow: tail and tip, m.
        points: Vec<Point>,
        /// One for each point, or none.
        colors: Vec<ColorRgba>,
        /// Name of a texture.
        texture_resource: String,
        /// Texture.
        texture: CompressedImage,
        /// Where the texture lies.
        uv_coordinates: Vec<UvCoordinate>,
        /// Of a text.
        text: String,
        /// Name of a mesh.
        mesh_resource: String,
        /// Mesh.
        mesh_file: MeshFile,
        /// Whether the mesh has its own materials.
        mesh_use_embedded_materials: bool,
    }
}

messages! {
    WrenchStamped, "geometry_msgs/msg/WrenchStamped", WRENCH_STAMPED, WRENCH_STAMPED_HASH;
    Temperature, "sensor_msgs/msg/Temperature", TEMPERATURE, TEMPERATURE_HASH;
    Imu, "sensor_msgs/msg/Imu", IMU, IMU_HASH;
    JointState, "sensor_msgs/msg/JointState", JOINT_STATE, JOINT_STATE_HASH;
    PoseStamped, "geometry_msgs/msg/PoseStamped", POSE_STAMPED, POSE_STAMPED_HASH;
    TransformStamped, "geometry_msgs/msg/TransformStamped", TRANSFORM_STAMPED, TRANSFORM_STAMPED_HASH;
    TFMessage, "tf2_msgs/msg/TFMessage", TF_MESSAGE, TF_MESSAGE_HASH;
    Text, "std_msgs/msg/String", STRING, STRING_HASH;
    DiagnosticArray, "diagnostic_msgs/msg/DiagnosticArray", DIAGNOSTIC_ARRAY, DIAGNOSTIC_ARRAY_HASH;
    Marker, "visualization_msgs/msg/Marker", MARKER, MARKER_HASH;
}

impl Imu {
    /// A gyroscope alone, rad/s in the axes of the header's frame.
    #[must_use]
    pub fn of_rate(header: Header, rate: [f64; 3]) -> Self {
        let mut not_measured = [0.0; 9];
        not_measured[0] = -1.0;
        Self {
            header,
            orientation_covariance: not_measured,
            angular_velocity: rate.into(),
            linear_acceleration_covariance: not_measured,
            ..Self::default()
        }
    }

    /// rad/s in the axes of the header's frame; `None` when it says that it does not measure them.
    #[must_use]
    pub fn rate(&self) -> Option<[f64; 3]> {
        (self.angular_velocity_covariance[0] >= 0.0).then(|| self.angular_velocity.into())
    }
}

impl DiagnosticStatus {
    /// All is well.
    pub const OK: u8 = 0;
    /// Something needs a look.
    pub const WARN: u8 = 1;
    /// Something is broken.
    pub const ERROR: u8 = 2;
    /// Nothing was heard for too long.
    pub const STALE: u8 = 3;
}

impl Header {
    /// A header of `at` in the frame `frame_id`.
    #[must_use]
    pub fn new(at: HostTime, frame_id: &str) -> Self {
        Self {
            stamp: at.into(),
            frame_id: frame_id.to_owned(),
        }
    }
}

const NANOS_PER_SECOND: i64 = 1_000_000_000;

impl From<HostTime> for Time {
    /// Saturates outside 1901 to 2038, which is all `sec` can say.
    fn from(at: HostTime) -> Self {
        let nanos = at.as_nanos();
        match i32::try_from(nanos.div_euclid(NANOS_PER_SECOND)) {
            Ok(sec) => Self {
                sec,
                nanosec: u32::try_from(nanos.rem_euclid(NANOS_PER_SECOND)).unwrap_or(0),
            },
            Err(_) if nanos < 0 => Self {
                sec: i32::MIN,
                nanosec: 0,
            },
            Err(_) => Self {
                sec: i32::MAX,
                nanosec: 999_999_999,
            },
        }
    }
}

impl From<Time> for HostTime {
    fn from(time: Time) -> Self {
        Self::from_nanos(i64::from(time.sec) * NANOS_PER_SECOND + i64::from(time.nanosec))
    }
}

macro_rules! triple {
    ($($type:ident)*) => {$(
        impl From<[f64; 3]> for $type {
            fn from([x, y, z]: [f64; 3]) -> Self {
                Self { x, y, z }
            }
        }
        impl From<$type> for [f64; 3] {
            fn from($type { x, y, z }: $type) -> Self {
                [x, y, z]
            }
        }
    )*};
}
triple! { Vector3 Point }

impl From<[f64; 4]> for Quaternion {
    /// From x y z w.
    fn from([x, y, z, w]: [f64; 4]) -> Self {
        Self { x, y, z, w }
    }
}

impl From<Quaternion> for [f64; 4] {
    /// To x y z w.
    fn from(Quaternion { x, y, z, w }: Quaternion) -> Self {
        [x, y, z, w]
    }
}

impl From<[f64; 6]> for Wrench {
    /// From force then torque.
    fn from([fx, fy, fz, tx, ty, tz]: [f64; 6]) -> Self {
        Self {
            force: [fx, fy, fz].into(),
            torque: [tx, ty, tz].into(),
        }
    }
}

impl From<Wrench> for [f64; 6] {
    /// To force then torque.
    fn from(Wrench { force, torque }: Wrench) -> Self {
        [force.x, force.y, force.z, torque.x, torque.y, torque.z]
    }
}
