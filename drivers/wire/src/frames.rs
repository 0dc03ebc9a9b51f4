//! Frames as types, and the quantities that live in them.
//!
//! `a_from_b` takes b-coordinates to a. Wrenches are environment on tool, force then torque, SI. Quaternions are x y z w.

use core::fmt;
use core::marker::PhantomData;

/// Names one frame at compile time.
pub trait Frame {
    /// The frame's name as recordings write it (`header.frame_id`).
    const NAME: &'static str;
}

macro_rules! frames {
    ($($(#[$doc:meta])* $name:ident = $text:literal;)*) => {$(
        $(#[$doc])*
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        pub enum $name {}
        impl Frame for $name { const NAME: &'static str = $text; }
    )*};
}

frames! {
    /// The pose tracker's world; z points up.
    World = "world";
    /// The Aria glasses' device frame.
    AriaDevice = "aria_device";
    /// Origin and axes of the wrist force-torque sensor.
    FtSensor = "ft_sensor";
    /// Between the pads, where the object is held.
    Tcp = "tcp";
}

/// A wrench in the axes of `F`, moments about the origin of `F`; environment on tool.
pub struct Wrench<F> {
    /// Force x y z, N.
    pub force: [f64; 3],
    /// Torque x y z, N m.
    pub torque: [f64; 3],
    frame: PhantomData<F>,
}

impl<F> Wrench<F> {
    /// A wrench from force (N) and torque (N m).
    #[must_use]
    pub const fn new(force: [f64; 3], torque: [f64; 3]) -> Self {
        Self {
            force,
            torque,
            frame: PhantomData,
        }
    }

    /// Force then torque.
    #[must_use]
    pub const fn to_array(self) -> [f64; 6] {
        let ([fx, fy, fz], [tx, ty, tz]) = (self.force, self.torque);
        [fx, fy, fz, tx, ty, tz]
    }

    /// From force then torque.
    #[must_use]
    pub const fn from_array([fx, fy, fz, tx, ty, tz]: [f64; 6]) -> Self {
        Self::new([fx, fy, fz], [tx, ty, tz])
    }

    /// The same wrench as the tool puts on the environment. For sensors that report that sign.
    #[must_use]
    pub fn flipped(self) -> Self {
        Self::from_array(self.to_array().map(|component| -component))
    }
}

impl<F> Clone for Wrench<F> {
    fn clone(&self) -> Self {
        *self
    }
}
impl<F> Copy for Wrench<F> {}
impl<F> PartialEq for Wrench<F> {
    fn eq(&self, other: &Self) -> bool {
        self.force == other.force && self.torque == other.torque
    }
}
impl<F: Frame> fmt::Debug for Wrench<F> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Wrench")
            .field("frame", &F::NAME)
            .field("force", &self.force)
            .field("torque", &self.torque)
            .finish()
    }
}

/// `a_from_b`: takes coordinates in `B` to `A`.
pub struct Pose<A, B> {
    /// Origin of `B` in `A`, m.
    pub position: [f64; 3],
    /// Rotation, unit quaternion x y z w.
    pub quaternion: [f64; 4],
    frames: PhantomData<(A, B)>,
}

impl<A, B> Pose<A, B> {
    /// A pose from a position (m) and a unit quaternion x y z w.
    #[must_use]
    pub const fn new(position: [f64; 3], quaternion: [f64; 4]) -> Self {
        Self {
            position,
            quaternion,
            frames: PhantomData,
        }
    }
}

impl<A, B> Clone for Pose<A, B> {
    fn clone(&self) -> Self {
        *self
    }
}
impl<A, B> Copy for Pose<A, B> {}
impl<A, B> PartialEq for Pose<A, B> {
    fn eq(&self, other: &Self) -> bool {
        self.position == other.position && self.quaternion == other.quaternion
    }
}
impl<A: Frame, B: Frame> fmt::Debug for Pose<A, B> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Pose")
            .field("from", &B::NAME)
            .field("to", &A::NAME)
            .field("position", &self.position)
            .field("quaternion", &self.quaternion)
            .finish()
    }
}
