//! `[[undeclared]]`: effects that are there and that no model was told of, each from its table.

use serde::{Deserialize, Serialize};

use super::SwingDirection;

/// One `[[undeclared]]`, told apart by `effect`. Efforts are on the object: closing is negative.
///
/// The names are the report's, but for the last three, which no library of effects is supposed to hold.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "effect", rename_all = "snake_case", deny_unknown_fields)]
pub enum EffectSpec {
    /// A spring.
    Spring {
        /// N m/rad or N/m.
        rate: f64,
        /// Where it is slack, rad or m.
        #[serde(default)]
        rest: f64,
    },
    /// The same push everywhere.
    ConstantLoad {
        /// N m or N, positive opens.
        effort: f64,
    },
    /// A sprung ball over a notch: it is drawn into the notch from both sides.
    Detent {
        /// Middle of the notch, rad or m.
        at: f64,
        /// From the middle to either rim, rad or m.
        reach: f64,
        /// Greatest effort, half-way up the flank, N m or N.
        hold: f64,
    },
    /// A magnet: `pull / (1 + distance / reach)^2`.
    Catch {
        /// Closing effort at `at`, N m or N.
        pull: f64,
        /// Distance over which it falls to a quarter, rad or m.
        reach: f64,
        /// Where it touches, rad or m.
        #[serde(default)]
        at: f64,
    },
    /// A damper that reaches over a part of the range and acts one way.
    DampingZone {
        /// Where it begins, rad or m.
        from: f64,
        /// Where it ends, rad or m.
        to: f64,
        /// The direction that it damps.
        direction: SwingDirection,
        /// N m s/rad or N s/m.
        damping: f64,
        /// Width over which it fades in and out, rad or m.
        blend: f64,
    },
    /// A damper that acts one way.
    AsymmetricViscous {
        /// The direction that it damps.
        direction: SwingDirection,
        /// N m s/rad or N s/m.
        damping: f64,
    },
    /// Dry friction that acts one way.
    AsymmetricCoulomb {
        /// The direction that it resists.
        direction: SwingDirection,
        /// N m or N.
        coulomb: f64,
    },
    /// Drag of air or of a turbulent orifice.
    QuadraticDrag {
        /// N m s^2/rad^2 or N s^2/m^2.
        drag: f64,
    },
    /// More dry friction near rest, which lubrication takes away: `extra / (1 + (dq / rate)^2)`.
    Stribeck {
        /// At rest, N m or N.
        extra: f64,
        /// Where half of it is left, rad/s or m/s.
        rate: f64,
    },
    /// More dry friction at rest only.
    Stiction {
        /// Breakaway above sliding friction, N m or N.
        extra: f64,
    },
    /// The object's dry friction acts through bristles that bend before they slide; a twentieth of it stays stiff.
    Presliding {
        /// Deflection at which the last bristle slides, rad or m.
        length: f64,
    },
    /// Play between pads and handle.
    Backlash {
        /// Way from one contact to the other, m.
        gap_m: f64,
        /// Of the pads in contact, N/m.
        #[serde(default = "stiff_pads")]
        stiffness_n_per_m: f64,
    },
    /// Dry friction that grows on the way: `growth (q / open stop)^power`.
    PositionDependentFriction {
        /// At the open stop, N m or N.
        growth: f64,
        /// 1 is straight.
        #[serde(default = "one")]
        power: f64,
    },
    /// Rollers or gears: an effort that comes and goes along the way.
    Ripple {
        /// N m or N.
        amplitude: f64,
        /// rad or m.
        period: f64,
        /// At q = 0, rad.
        #[serde(default)]
        phase_rad: f64,
    },
    /// The axis leans, and the panel's weight acts (revolute joints with `object.panel_mass_kg`).
    Gravity {
        /// Lean of the axis, deg.
        tilt_deg: f64,
        /// Where its upper end leans to, from the building's x towards y, deg.
        azimuth_deg: f64,
    },
    /// What a device sends is older than its stamp says.
    TimeLag {
        /// Age of the wrench, s; negative: of the pose.
        lag_s: f64,
    },
    /// A mass that is put on the gripper at the grasp, after the free-air part.
    ToolMass {
        /// kg.
        mass_kg: f64,
        /// Where it sits, m, axes and origin of `ft_sensor`.
        at_m: [f64; 3],
    },
    /// A load is put in: at the first rest at or after `after_s`.
    PayloadSwitch {
        /// kg m^2 or kg.
        inertia: f64,
        /// Seconds from the grasp.
        after_s: f64,
    },
    /// A cold hinge: dry friction that goes as it warms up.
    FrictionDrift {
        /// While cold, N m or N.
        extra: f64,
        /// Time since the first motion after which 1/e is left, s.
        seconds: Option<f64>,
        /// Way gone after which 1/e is left, rad or m.
        travel: Option<f64>,
    },
    /// The sensor's bias goes away, on top of `sensor.force_drift_n_per_min`.
    SensorDrift {
        /// In the first minute, axes of `ft_sensor`.
        force_n_per_min: [f64; 3],
        /// In the first minute.
        #[serde(default)]
        torque_nm_per_min: [f64; 3],
        /// It levels off with this time constant, s; steady when not given.
        warm_up_s: Option<f64>,
    },
    /// Pads and fingers give: hand and handle part by force over stiffness.
    GraspCompliance {
        /// Along the motion, N/m.
        stiffness_n_per_m: f64,
        /// Of the gripper on its pads.
        #[serde(default = "little_damping")]
        damping_ratio: f64,
    },
    /// A hinge that sags, or a rail that is bent: the axis moves aside as the object opens.
    AxisOffset {
        /// Where it has moved at the open stop, m, in the building; it starts and ends flat.
        shift_m: [f64; 3],
    },
    /// The pads slide on the handle, at instants.
    Slip {
        /// Each time, m, in the building at q = 0.
        step_m: [f64; 3],
        /// Seconds from the grasp.
        after_s: Vec<f64>,
        /// How long one takes, s.
        #[serde(default = "slip_time")]
        lasts_s: f64,
    },
    /// A compressed spring that goes over its dead centre and snaps away from it on both sides.
    ToggleLinkage {
        /// Dead centre, rad or m.
        at: f64,
        /// Way of the spring's end per q, m/rad (revolute) or 1 (prismatic).
        arm: f64,
        /// Length at the dead centre, m.
        height_m: f64,
        /// Length at which it is slack, m.
        free_length_m: f64,
        /// N/m.
        stiffness_n_per_m: f64,
    },
    /// A seal that sticks the more the longer it rested, and peels off.
    HealingSeal {
        /// After a long rest, N m or N.
        bond: f64,
        /// Time constant of sticking, s.
        heal_s: f64,
        /// Way over which 1/e of the bond is left, rad or m.
        peel: f64,
    },
    /// Another leaf that is picked up on the way, dragged along, and left behind until the way back takes it again.
    SecondLeaf {
        /// Play between the leaves, rad or m: opening picks it up there first.
        from: f64,
        /// kg m^2 or kg.
        inertia: f64,
        /// Its own dry friction, N m or N.
        coulomb: f64,
        /// Of the bumper between them, N m/rad or N/m.
        stiffness: f64,
    },
}

fn stiff_pads() -> f64 {
    1.2e5
}
fn one() -> f64 {
    1.0
}
fn little_damping() -> f64 {
    0.25
}
fn slip_time() -> f64 {
    0.06
}

impl EffectSpec {
    /// Its name, as `effect` has it.
    #[must_use]
    pub fn name(&self) -> &'static str {
        match self {
            Self::Spring { .. } => "spring",
            Self::ConstantLoad { .. } => "constant_load",
            Self::Detent { .. } => "detent",
            Self::Catch { .. } => "catch",
            Self::DampingZone { .. } => "damping_zone",
            Self::AsymmetricViscous { .. } => "asymmetric_viscous",
            Self::AsymmetricCoulomb { .. } => "asymmetric_coulomb",
            Self::QuadraticDrag { .. } => "quadratic_drag",
            Self::Stribeck { .. } => "stribeck",
            Self::Stiction { .. } => "stiction",
            Self::Presliding { .. } => "presliding",
            Self::Backlash { .. } => "backlash",
            Self::PositionDependentFriction { .. } => "position_dependent_friction",
            Self::Ripple { .. } => "ripple",
            Self::Gravity { .. } => "gravity",
            Self::TimeLag { .. } => "time_lag",
            Self::ToolMass { .. } => "tool_mass",
            Self::PayloadSwitch { .. } => "payload_switch",
            Self::FrictionDrift { .. } => "friction_drift",
            Self::SensorDrift { .. } => "sensor_drift",
            Self::GraspCompliance { .. } => "grasp_compliance",
            Self::AxisOffset { .. } => "axis_offset",
            Self::Slip { .. } => "slip",
            Self::ToggleLinkage { .. } => "toggle_linkage",
            Self::HealingSeal { .. } => "healing_seal",
            Self::SecondLeaf { .. } => "second_leaf",
        }
    }

    /// Whether the report's vocabulary has a name for it.
    #[must_use]
    pub fn is_in_vocabulary(&self) -> bool {
        !matches!(
            self,
            Self::ToggleLinkage { .. } | Self::HealingSeal { .. } | Self::SecondLeaf { .. }
        )
    }

    /// Whether a second one of its kind would have no meaning of its own.
    pub(super) fn is_single(&self) -> bool {
        matches!(
            self,
            Self::Presliding { .. }
                | Self::Backlash { .. }
                | Self::Gravity { .. }
                | Self::TimeLag { .. }
                | Self::ToolMass { .. }
                | Self::SensorDrift { .. }
                | Self::GraspCompliance { .. }
                | Self::AxisOffset { .. }
                | Self::Slip { .. }
        )
    }
}
