//! The tables of a scenario file.

use serde::{Deserialize, Serialize};

/// How the object moves.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum JointKind {
    /// Turns about an axis; q in rad, effort in N m.
    Revolute,
    /// Slides along an axis; q in m, effort in N.
    Prismatic,
}

/// `[joint]`: kinematics.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct JointSpec {
    /// Revolute or prismatic.
    pub kind: JointKind,
    /// Direction of the axis; right-handed opening for a revolute joint, direction of opening for a prismatic one.
    pub axis: [f64; 3],
    /// A point on the axis, m; of no meaning for a prismatic joint.
    #[serde(default)]
    pub point: [f64; 3],
    /// Closed stop and open stop, rad or m.
    pub range: [f64; 2],
}

/// `[object]`: parameters of the joint's dynamics.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ObjectSpec {
    /// kg m^2 about the axis, or kg.
    pub inertia: f64,
    /// Kinetic dry friction, N m or N.
    pub coulomb: f64,
    /// Dry friction that must be exceeded at rest, N m or N; `coulomb` when not given.
    pub breakaway: Option<f64>,
    /// N m s/rad or N s/m.
    pub viscous: f64,
    /// Stiffness of both end stops, N m/rad or N/m.
    pub stop_stiffness: f64,
    /// Damping of both end stops, N m s/rad or N s/m.
    pub stop_damping: f64,
    /// Mass that gravity pulls at, kg; 0 leaves gravity out.
    #[serde(default)]
    pub panel_mass_kg: f64,
    /// Centre of that mass at q = 0, m from `joint.point`.
    #[serde(default)]
    pub panel_com_m: [f64; 3],
}

/// `[grasp]`: where the tool centre point is when the object is at q = 0.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GraspSpec {
    /// Tool centre point at q = 0, m.
    pub tcp_point: [f64; 3],
    /// Direction in which the tool comes (its z axis).
    pub approach: [f64; 3],
    /// Turn of the tool about its z axis, deg.
    #[serde(default)]
    pub roll_deg: f64,
    /// Jaw opening on the handle, m.
    #[serde(default = "handle_width")]
    pub handle_width_m: f64,
}

fn handle_width() -> f64 {
    0.022
}

/// In which direction of motion a zone damps.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SwingDirection {
    /// dq > 0.
    Opening,
    /// dq < 0.
    Closing,
}

impl SwingDirection {
    /// Of dq.
    pub(crate) fn sign(self) -> f64 {
        match self {
            Self::Opening => 1.0,
            Self::Closing => -1.0,
        }
    }
}

/// A hydraulic zone of a closer.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ZoneSpec {
    /// Where it begins, rad or m.
    pub from: f64,
    /// Where it ends, rad or m.
    pub to: f64,
    /// The direction that it damps.
    pub direction: SwingDirection,
    /// N m s/rad or N s/m.
    pub damping: f64,
}

/// Two pivots of a strut on a revolute joint: one on the frame, one on the part that turns.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StrutSpec {
    /// From the axis to the pivot on the frame, m.
    pub frame_radius_m: f64,
    /// From the axis to the pivot on the moving part, m.
    pub part_radius_m: f64,
    /// Angle from the frame's pivot to the part's at q = 0, rad.
    pub angle_rad: f64,
}

/// One `[[mechanism]]`. Efforts are on the object: closing is negative.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case", deny_unknown_fields)]
pub enum MechanismSpec {
    /// Door closer: a wound spring that closes, and oil that resists by zone and direction.
    Closer {
        /// Closing effort at q = 0, N m or N.
        preload: f64,
        /// Growth of it with q, N m/rad or N/m.
        rate: f64,
        /// Width over which a zone fades in and out, rad or m.
        blend: f64,
        /// Above this damping effort a relief valve opens, N m or N.
        relief: Option<f64>,
        /// The zones; they add where they overlap.
        #[serde(default)]
        zones: Vec<ZoneSpec>,
    },
    /// Spring hinge: a wound spring that closes.
    SpringHinge {
        /// Closing effort at q = 0, N m or N.
        preload: f64,
        /// Growth of it with q, N m/rad or N/m.
        rate: f64,
    },
    /// Magnet or catch that holds the object closed: `pull / (1 + q / reach)^2`.
    Catch {
        /// Closing effort at q = 0, N m or N.
        pull: f64,
        /// Distance over which it falls to a quarter, rad or m.
        reach: f64,
    },
    /// Gas spring that pushes its two pivots apart.
    GasSpring {
        /// Force at the length of q = 0, N.
        force_n: f64,
        /// Growth of the force with shortening, N/m.
        rate_n_per_m: f64,
        /// Damping along the strut, N s/m.
        damping: f64,
        /// Where it is mounted.
        strut: StrutSpec,
    },
    /// Counterbalance: a wound-up extension spring that pulls its two pivots together.
    Counterbalance {
        /// N/m.
        stiffness_n_per_m: f64,
        /// Length at which it is slack, m.
        free_length_m: f64,
        /// Where it is mounted.
        strut: StrutSpec,
    },
}

/// `[world]`: the tracker's world in the building.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct WorldSpec {
    /// Yaw of the building in the tracker's world, deg; drawn from the seed when not given.
    pub yaw_deg: Option<f64>,
    /// The building's origin in the tracker's world, m; drawn from the seed when not given.
    pub origin_m: Option<[f64; 3]>,
}

/// `[person]`: the hand and its habits.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PersonSpec {
    /// Stiffness of the hand along the motion, N/m.
    pub stiffness_n_per_m: f64,
    /// Damping ratio of hand and object.
    pub damping_ratio: f64,
    /// What hand and rear of the gripper weigh, moving along, kg.
    pub moving_mass_kg: f64,
    /// The most that the hand pushes or pulls along the motion, N.
    pub max_force_n: f64,
    /// Fastest stroke at the handle, m/s.
    pub top_speed_m_s: f64,
    /// Peak acceleration of a shake at the handle, m/s^2.
    pub shake_m_s2: f64,
    /// How long the tool is held, turned and shaken in free air before the grasp, s.
    pub free_air_s: f64,
    /// Tremor along the motion, 8-12 Hz, N rms.
    pub tremor_n: f64,
    /// Forces across the motion, N rms.
    pub off_axis_force_n: f64,
    /// Torques that do no work, N m rms.
    pub off_axis_torque_nm: f64,
    /// Torque about a revolute axis, N m rms; its work is made up for by the force.
    pub about_axis_torque_nm: f64,
}

impl Default for PersonSpec {
    fn default() -> Self {
        Self {
            stiffness_n_per_m: 1200.0,
            damping_ratio: 0.4,
            moving_mass_kg: 1.6,
            max_force_n: 110.0,
            top_speed_m_s: 1.2,
            shake_m_s2: 9.0,
            free_air_s: 8.0,
            tremor_n: 0.5,
            off_axis_force_n: 8.0,
            off_axis_torque_nm: 0.8,
            about_axis_torque_nm: 0.25,
        }
    }
}

/// `[tool]`: the part of the gripper in front of the sensor, in the axes of `ft_sensor`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ToolSpec {
    /// kg.
    pub mass_kg: f64,
    /// Centre of mass from the sensor's origin, m.
    pub com_m: [f64; 3],
    /// Inertia about the centre of mass, kg m^2: xx xy yy xz yz zz.
    pub inertia_kgm2: [f64; 6],
}

impl Default for ToolSpec {
    /// The gripper of the Hoi! data set: mass and centre of mass as published, inertia of a body of that size.
    fn default() -> Self {
        Self {
            mass_kg: 0.49,
            com_m: [0.021, 0.020, 0.059],
            inertia_kgm2: [9.6e-4, -0.7e-4, 8.8e-4, 0.9e-4, 0.6e-4, 5.1e-4],
        }
    }
}

/// The force-torque sensors that can be played.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SensorDriver {
    /// Bota Systems, serial, 37-byte frames.
    BotaSerial,
    /// Robotous RFT on CAN.
    RobotousCan,
    /// Robotous RFT on UART.
    RobotousUart,
    /// OptoForce or OnRobot HEX, six axes, on USB or UART.
    OptoforceSerial,
    /// OptoForce or OnRobot HEX, six axes, on CAN.
    OptoforceCan,
    /// Kunwei KWR75, serial.
    KunweiKwr75,
    /// Leptrino CFS or PFS on USB.
    Leptrino,
    /// ATI NETCANOEM on CAN.
    AtiNetcanoem,
}

impl SensorDriver {
    /// All, with the name in files, and a model and a rate that the sensor has.
    const ALL: [(Self, &str, &str, f64); 8] = [
        (Self::BotaSerial, "bota_serial", "BFT-SENS-SER-M8", 800.0),
        (Self::RobotousCan, "robotous_can", "RFT64-SB01", 1000.0),
        (Self::RobotousUart, "robotous_uart", "RFT64-SB01", 1000.0),
        (Self::OptoforceSerial, "optoforce_serial", "HEX-E", 1000.0),
        (Self::OptoforceCan, "optoforce_can", "HEX-E", 1000.0),
        (Self::KunweiKwr75, "kunwei_kwr75", "KWR75", 1000.0),
        (Self::Leptrino, "leptrino", "PFS055YA251U6", 1200.0),
        (Self::AtiNetcanoem, "ati_netcanoem", "NETCANOEM", 250.0),
    ];

    /// As in files, and as the driver that takes it is named.
    #[must_use]
    pub fn name(self) -> &'static str {
        let mut all = Self::ALL.into_iter();
        all.find(|(driver, ..)| *driver == self)
            .map_or("bota_serial", |(_, name, ..)| name)
    }

    /// The names of all.
    #[must_use]
    pub fn names() -> Vec<&'static str> {
        Self::ALL.into_iter().map(|(_, name, ..)| name).collect()
    }
}

/// `[sensor]`: the wrist force-torque sensor.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SensorSpec {
    /// Which device.
    pub driver: SensorDriver,
    /// Model name; a Robotous model decides scale, rated load and fastest rate.
    pub model: String,
    /// Samples per second that the operator wants.
    pub rate_hz: f64,
    /// White noise of each force sample, N.
    #[serde(default = "force_noise")]
    pub force_noise_n: f64,
    /// White noise of each torque sample, N m.
    #[serde(default = "torque_noise")]
    pub torque_noise_nm: f64,
    /// Size of the force bias, N; each axis is drawn within it.
    #[serde(default = "force_bias")]
    pub force_bias_n: f64,
    /// Size of the torque bias, N m.
    #[serde(default = "torque_bias")]
    pub torque_bias_nm: f64,
    /// Drift of the force bias over a minute, N.
    #[serde(default = "force_drift")]
    pub force_drift_n_per_min: f64,
    /// The device was left streaming by a program that crashed.
    #[serde(default)]
    pub already_streaming: bool,
    /// Its clock.
    #[serde(default)]
    pub clock: ClockSpec,
    /// What its line and its adapter add.
    #[serde(default)]
    pub link: LinkSpec,
}

impl SensorSpec {
    /// The sensor named `driver`, at a rate and of a model that it has, with the usual noise; `None` when there is none.
    #[must_use]
    pub fn of(driver: &str) -> Option<Self> {
        let mut all = SensorDriver::ALL.into_iter();
        let (driver, _, model, rate_hz) = all.find(|(_, name, ..)| *name == driver)?;
        Some(Self {
            driver,
            model: model.to_owned(),
            rate_hz,
            force_noise_n: force_noise(),
            torque_noise_nm: torque_noise(),
            force_bias_n: force_bias(),
            torque_bias_nm: torque_bias(),
            force_drift_n_per_min: force_drift(),
            already_streaming: false,
            clock: ClockSpec::default(),
            link: LinkSpec::default(),
        })
    }
}

fn force_noise() -> f64 {
    0.08
}
fn torque_noise() -> f64 {
    0.003
}
fn force_bias() -> f64 {
    1.5
}
fn torque_bias() -> f64 {
    0.08
}
fn force_drift() -> f64 {
    0.06
}

/// A device's clock against the host's.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ClockSpec {
    /// What it shows when the simulation starts, s; drawn from the seed when not given.
    pub reads_s: Option<f64>,
    /// How much faster than the host's it goes, parts per million.
    pub skew_ppm: f64,
}

impl Default for ClockSpec {
    fn default() -> Self {
        Self {
            reads_s: None,
            skew_ppm: 23.0,
        }
    }
}

/// `[sensor.link]`, `[tracker.link]`: what comes between a sample and the host beside the line itself.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct LinkSpec {
    /// Bytes leave the adapter only at multiples of this, ms, of the host's time: 16 for an FTDI adapter as it comes, 1 for a polled
    /// USB port, 0 for none.
    pub burst_ms: f64,
    /// Constant delay before the line, ms, such as a filter's: no operator knows of it.
    pub delay_ms: f64,
}

/// `[tracker]`: the pose tracker.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct TrackerSpec {
    /// Samples per second.
    pub rate_hz: f64,
    /// White noise of a position component, m.
    pub white_m: f64,
    /// White noise of a rotation component, deg.
    pub white_deg: f64,
    /// Wander of a position component, m rms.
    pub wander_m: f64,
    /// Wander of a rotation component, deg rms.
    pub wander_deg: f64,
    /// Time over which the wander forgets, s.
    pub wander_s: f64,
    /// Its clock.
    pub clock: ClockSpec,
    /// What its line and its adapter add.
    pub link: LinkSpec,
}

impl Default for TrackerSpec {
    fn default() -> Self {
        Self {
            rate_hz: 1000.0,
            white_m: 24e-6,
            white_deg: 0.005,
            wander_m: 1.5e-3,
            wander_deg: 0.1,
            wander_s: 10.0,
            clock: ClockSpec {
                reads_s: None,
                skew_ppm: -11.0,
            },
            link: LinkSpec::default(),
        }
    }
}

/// The gripper encoders that can be played.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum GripperDriver {
    /// Dynamixel, protocol 2.0, polled.
    #[default]
    Dynamixel,
    /// CUI AMT21, polled.
    Amt21,
    /// A microcontroller that prints lines.
    EncoderLine,
}

impl GripperDriver {
    const ALL: [(Self, &str); 3] = [
        (Self::Dynamixel, "dynamixel"),
        (Self::Amt21, "amt21"),
        (Self::EncoderLine, "encoder_line"),
    ];

    /// The driver named so.
    #[must_use]
    pub fn named(name: &str) -> Option<Self> {
        let mut all = Self::ALL.into_iter();
        all.find(|(_, known)| *known == name)
            .map(|(driver, _)| driver)
    }

    /// The names of all.
    #[must_use]
    pub fn names() -> Vec<&'static str> {
        Self::ALL.into_iter().map(|(_, name)| name).collect()
    }
}

/// `[gripper]`: the encoder of the jaws.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct GripperSpec {
    /// Which device.
    #[serde(skip_serializing_if = "is_default")]
    pub driver: GripperDriver,
    /// Dynamixel only: id.
    pub id: u8,
    /// Dynamixel only: line rate.
    pub baud_bps: u32,
    /// Polls or lines per second that the operator wants.
    pub rate_hz: f64,
    /// Jitter of the jaw opening, m rms.
    pub jitter_m: f64,
}

#[allow(clippy::trivially_copy_pass_by_ref)] // serde hands a reference
fn is_default(driver: &GripperDriver) -> bool {
    *driver == GripperDriver::default()
}

impl Default for GripperSpec {
    fn default() -> Self {
        Self {
            driver: GripperDriver::default(),
            id: 1,
            baud_bps: 57_600,
            rate_hz: 50.0,
            jitter_m: 3e-5,
        }
    }
}
