//! `ros2msg` definitions and RIHS01 type hashes of the recorded messages.
//!
//! A definition is the top-level message first and then every type it uses once, each after a line of 80 `=` and
//! `MSG: <package>/<Name>`, in the order of first use, as rosbags and rosbag2 write it.
//!
//! # Source
//! MCAP registry (`ros2msg`); common_interfaces and geometry2 of ROS 2 Humble to Kilted; REP-2016 for the hashes. The
//! unit tests compute every hash from the definition, so neither can be wrong alone.

macro_rules! dependency {
    ($name:literal, $body:expr) => {
        concat!(
            "================================================================================\n",
            "MSG: ",
            $name,
            "\n",
            $body
        )
    };
}
macro_rules! header {
    () => {
        concat!(
            dependency!(
                "std_msgs/Header",
                "builtin_interfaces/Time stamp\nstring frame_id\n"
            ),
            dependency!("builtin_interfaces/Time", "int32 sec\nuint32 nanosec\n"),
        )
    };
}
macro_rules! vector3 {
    () => {
        dependency!("geometry_msgs/Vector3", "float64 x\nfloat64 y\nfloat64 z\n")
    };
}
macro_rules! quaternion {
    () => {
        dependency!(
            "geometry_msgs/Quaternion",
            "float64 x\nfloat64 y\nfloat64 z\nfloat64 w\n"
        )
    };
}
macro_rules! point {
    () => {
        dependency!("geometry_msgs/Point", "float64 x\nfloat64 y\nfloat64 z\n")
    };
}
macro_rules! pose {
    () => {
        dependency!(
            "geometry_msgs/Pose",
            "geometry_msgs/Point position\ngeometry_msgs/Quaternion orientation\n"
        )
    };
}
macro_rules! transform_stamped {
    () => {
        "std_msgs/Header header\nstring child_frame_id\ngeometry_msgs/Transform transform\n"
    };
}
macro_rules! transform_stamped_dependencies {
    () => {
        concat!(
            header!(),
            dependency!(
                "geometry_msgs/Transform",
                "geometry_msgs/Vector3 translation\ngeometry_msgs/Quaternion rotation\n"
            ),
            vector3!(),
            quaternion!(),
        )
    };
}

/// `std_msgs/msg/String`.
pub const STRING: &str = "string data\n";
/// RIHS01 hash of [`STRING`].
pub const STRING_HASH: &str =
    "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18";

/// `geometry_msgs/msg/WrenchStamped`.
pub const WRENCH_STAMPED: &str = concat!(
    "std_msgs/Header header\ngeometry_msgs/Wrench wrench\n",
    header!(),
    dependency!(
        "geometry_msgs/Wrench",
        "geometry_msgs/Vector3 force\ngeometry_msgs/Vector3 torque\n"
    ),
    vector3!(),
);
/// RIHS01 hash of [`WRENCH_STAMPED`].
pub const WRENCH_STAMPED_HASH: &str =
    "RIHS01_8dc3deaf06b2ab281f9f9a742a8961c328ca7cec16e3fd6586d3a5c83fa78f77";

/// `sensor_msgs/msg/Temperature`.
pub const TEMPERATURE: &str = concat!(
    "std_msgs/Header header\nfloat64 temperature\nfloat64 variance\n",
    header!()
);
/// RIHS01 hash of [`TEMPERATURE`].
pub const TEMPERATURE_HASH: &str =
    "RIHS01_72514a14126ab9f8a9abec974c78e5610a367b59db5da355ff1fb982d5bad4b8";

/// `sensor_msgs/msg/Imu`.
pub const IMU: &str = concat!(
    "std_msgs/Header header\ngeometry_msgs/Quaternion orientation\nfloat64[9] orientation_covariance\n",
    "geometry_msgs/Vector3 angular_velocity\nfloat64[9] angular_velocity_covariance\n",
    "geometry_msgs/Vector3 linear_acceleration\nfloat64[9] linear_acceleration_covariance\n",
    header!(),
    quaternion!(),
    vector3!(),
);
/// RIHS01 hash of [`IMU`].
pub const IMU_HASH: &str =
    "RIHS01_7d9a00ff131080897a5ec7e26e315954b8eae3353c3f995c55faf71574000b5b";

/// `sensor_msgs/msg/JointState`.
pub const JOINT_STATE: &str = concat!(
    "std_msgs/Header header\nstring[] name\nfloat64[] position\nfloat64[] velocity\nfloat64[] effort\n",
    header!(),
);
/// RIHS01 hash of [`JOINT_STATE`].
pub const JOINT_STATE_HASH: &str =
    "RIHS01_a13ee3a330e346c9d87b5aa18d24e11690752bd33a0350f11c5882bc9179260e";

/// `geometry_msgs/msg/PoseStamped`.
pub const POSE_STAMPED: &str = concat!(
    "std_msgs/Header header\ngeometry_msgs/Pose pose\n",
    header!(),
    pose!(),
    point!(),
    quaternion!(),
);
/// RIHS01 hash of [`POSE_STAMPED`].
pub const POSE_STAMPED_HASH: &str =
    "RIHS01_10f3786d7d40fd2b54367835614bff85d4ad3b5dab62bf8bca0cc232d73b4cd8";

/// `geometry_msgs/msg/TransformStamped`.
pub const TRANSFORM_STAMPED: &str =
    concat!(transform_stamped!(), transform_stamped_dependencies!());
/// RIHS01 hash of [`TRANSFORM_STAMPED`].
pub const TRANSFORM_STAMPED_HASH: &str =
    "RIHS01_0a241f87d04668d94099cbb5ba11691d5ad32c2f29682e4eb5653424bd275206";

/// `tf2_msgs/msg/TFMessage`.
pub const TF_MESSAGE: &str = concat!(
    "geometry_msgs/TransformStamped[] transforms\n",
    dependency!("geometry_msgs/TransformStamped", transform_stamped!()),
    transform_stamped_dependencies!(),
);
/// RIHS01 hash of [`TF_MESSAGE`].
pub const TF_MESSAGE_HASH: &str =
    "RIHS01_e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087";

/// `diagnostic_msgs/msg/DiagnosticArray`.
pub const DIAGNOSTIC_ARRAY: &str = concat!(
    "std_msgs/Header header\ndiagnostic_msgs/DiagnosticStatus[] status\n",
    header!(),
    dependency!(
        "diagnostic_msgs/DiagnosticStatus",
        concat!(
            "byte OK=0\nbyte WARN=1\nbyte ERROR=2\nbyte STALE=3\nbyte level\nstring name\nstring message\n",
            "string hardware_id\ndiagnostic_msgs/KeyValue[] values\n"
        )
    ),
    dependency!("diagnostic_msgs/KeyValue", "string key\nstring value\n"),
);
/// RIHS01 hash of [`DIAGNOSTIC_ARRAY`].
pub const DIAGNOSTIC_ARRAY_HASH: &str =
    "RIHS01_5a8a36efb05fb25070fa0fb3810290c0e6cd4862b54a8fb975a1ee8dc55a333e";

/// `visualization_msgs/msg/Marker`, of Jazzy and later; published to viewers, not recorded.
pub const MARKER: &str = concat!(
    "std_msgs/Header header\nstring ns\nint32 id\nint32 type\nint32 action\ngeometry_msgs/Pose pose\n",
    "geometry_msgs/Vector3 scale\nstd_msgs/ColorRGBA color\nbuiltin_interfaces/Duration lifetime\nbool frame_locked\n",
    "geometry_msgs/Point[] points\nstd_msgs/ColorRGBA[] colors\nstring texture_resource\n",
    "sensor_msgs/CompressedImage texture\nvisualization_msgs/UVCoordinate[] uv_coordinates\nstring text\n",
    "string mesh_resource\nvisualization_msgs/MeshFile mesh_file\nbool mesh_use_embedded_materials\n",
    header!(),
    pose!(),
    point!(),
    quaternion!(),
    vector3!(),
    dependency!(
        "std_msgs/ColorRGBA",
        "float32 r\nfloat32 g\nfloat32 b\nfloat32 a\n"
    ),
    dependency!("builtin_interfaces/Duration", "int32 sec\nuint32 nanosec\n"),
    dependency!(
        "sensor_msgs/CompressedImage",
        "std_msgs/Header header\nstring format\nuint8[] data\n"
    ),
    dependency!("visualization_msgs/UVCoordinate", "float32 u\nfloat32 v\n"),
    dependency!(
        "visualization_msgs/MeshFile",
        "string filename\nuint8[] data\n"
    ),
);
/// RIHS01 hash of [`MARKER`].
pub const MARKER_HASH: &str =
    "RIHS01_45b13ccf791f225962bf74e746f9644518855d783a6f42ba0cc14fde2b4f3ce0";

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use sha2::{Digest, Sha256};

    use crate::message::{
        DiagnosticArray, Imu, JointState, Marker, Message, PoseStamped, TFMessage, Temperature,
        Text, TransformStamped, WrenchStamped,
    };

    /// (name, type) of every field of every type in a definition, by full type name.
    fn parse(top: &str, definition: &str) -> BTreeMap<String, Vec<(String, String)>> {
        let mut types = BTreeMap::new();
        let mut current = top.to_owned();
        types.insert(current.clone(), Vec::new());
        for line in definition.lines() {
            if line.starts_with('=') {
                assert_eq!(line, "=".repeat(80));
            } else if let Some(name) = line.strip_prefix("MSG: ") {
                current = full_name(name);
                assert!(
                    types.insert(current.clone(), Vec::new()).is_none(),
                    "{name} twice"
                );
            } else if !line.contains('=') {
                let (kind, name) = line.split_once(' ').unwrap();
                types
                    .get_mut(&current)
                    .unwrap()
                    .push((name.to_owned(), kind.to_owned()));
            }
        }
        types
    }

    fn full_name(name: &str) -> String {
        name.replacen('/', "/msg/", 1)
    }

    fn field_json(name: &str, kind: &str) -> String {
        // Arrays of a fixed length are 48 further than their elements, those of any length 144.
        let (element, array, capacity) = match kind.split_once('[') {
            Some((element, "]")) => (element, 144, "0"),
            Some((element, length)) => (element, 48, length.trim_end_matches(']')),
            None => (kind, 0, "0"),
        };
        let (id, nested) = match element {
            "uint8" => (3, String::new()),
            "int32" => (6, String::new()),
            "uint32" => (7, String::new()),
            "float32" => (10, String::new()),
            "float64" => (11, String::new()),
            "bool" => (15, String::new()),
            "byte" => (16, String::new()),
            "string" => (17, String::new()),
            nested => (1, full_name(nested)),
        };
        format!(
            "{{\"name\": \"{name}\", \"type\": {{\"type_id\": {}, \"capacity\": {capacity}, \"string_capacity\": 0, \
             \"nested_type_name\": \"{nested}\"}}}}",
            id + array
        )
    }

    fn type_json(name: &str, fields: &[(String, String)]) -> String {
        let fields: Vec<_> = fields
            .iter()
            .map(|(name, kind)| field_json(name, kind))
            .collect();
        format!(
            "{{\"type_name\": \"{name}\", \"fields\": [{}]}}",
            fields.join(", ")
        )
    }

    /// REP-2016: SHA-256 of the canonical JSON of the type and of all it refers to.
    fn rihs01(top: &str, definition: &str) -> String {
        let types = parse(top, definition);
        let referenced: Vec<_> = types
            .iter()
            .filter(|(name, _)| *name != top)
            .map(|(name, fields)| type_json(name, fields))
            .collect();
        let json = format!(
            "{{\"type_description\": {}, \"referenced_type_descriptions\": [{}]}}",
            type_json(top, &types[top]),
            referenced.join(", ")
        );
        let digest = Sha256::digest(json.as_bytes());
        let hex: String = digest.iter().map(|byte| format!("{byte:02x}")).collect();
        format!("RIHS01_{hex}")
    }

    #[test]
    fn every_type_hash_follows_from_its_definition() {
        fn check<M: Message>() {
            assert_eq!(
                rihs01(M::TYPE_NAME, M::DEFINITION),
                M::TYPE_HASH,
                "{}",
                M::TYPE_NAME
            );
        }
        check::<Text>();
        check::<WrenchStamped>();
        check::<Temperature>();
        check::<Imu>();
        check::<JointState>();
        check::<PoseStamped>();
        check::<TransformStamped>();
        check::<TFMessage>();
        check::<DiagnosticArray>();
        check::<Marker>();
    }

    #[test]
    fn every_type_a_definition_uses_is_defined_in_it() {
        for (top, definition) in [
            (TFMessage::TYPE_NAME, TFMessage::DEFINITION),
            (DiagnosticArray::TYPE_NAME, DiagnosticArray::DEFINITION),
            (Marker::TYPE_NAME, Marker::DEFINITION),
            (PoseStamped::TYPE_NAME, PoseStamped::DEFINITION),
            (WrenchStamped::TYPE_NAME, WrenchStamped::DEFINITION),
            (Imu::TYPE_NAME, Imu::DEFINITION),
        ] {
            let types = parse(top, definition);
            for (_, kind) in types
                .values()
                .flatten()
                .filter(|(_, kind)| kind.contains('/'))
            {
                assert!(
                    types.contains_key(&full_name(kind.trim_end_matches("[]"))),
                    "{kind} in {top}"
                );
            }
        }
    }
}
