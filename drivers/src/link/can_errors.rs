//! What a CAN controller says of errors on its bus, however it is reached.

use std::time::Duration;

use ft_wire::HostTime;

use crate::link::LinkError;

/// Classes of `linux/can/error.h`.
mod class {
    pub(super) const NO_ACKNOWLEDGE: u32 = 0x20;
    pub(super) const BUS_OFF: u32 = 0x40;
    pub(super) const RESTARTED: u32 = 0x100;
}

/// Least time between two notices of errors on the bus.
const TELL_EVERY: Duration = Duration::from_secs(5);

/// Error frames that came.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct CanErrors {
    /// All.
    pub frames: u64,
    /// A frame that we sent was not acknowledged.
    pub no_acknowledge: u64,
    /// The controller came back after bus-off.
    pub restarted: u64,
}

impl CanErrors {
    /// The errors since `told`, for people; `None` when there are none.
    fn since(self, told: Self, port: &str) -> Option<String> {
        let fresh = self.frames.saturating_sub(told.frames);
        let unacknowledged = self.no_acknowledge - told.no_acknowledge;
        let restarted = self.restarted - told.restarted;
        (fresh > 0).then(|| {
            format!(
                "{port}: {fresh} error frames ({unacknowledged} not acknowledged, {restarted} restarts after bus-off), {} in all: \
                 check bit rate, termination and wiring",
                self.frames
            )
        })
    }
}

/// Counts error frames and tells of them now and then.
#[derive(Debug)]
pub(super) struct ErrorWatch {
    pub(super) errors: CanErrors,
    told: CanErrors,
    tell_again_at: HostTime,
}

impl ErrorWatch {
    pub(super) fn new() -> Self {
        Self {
            errors: CanErrors::default(),
            told: CanErrors::default(),
            tell_again_at: HostTime::EPOCH,
        }
    }

    /// Counts an error frame of these classes; bus-off ends the link.
    pub(super) fn count(&mut self, classes: u32, port: &str) -> Result<(), LinkError> {
        self.errors.frames += 1;
        self.errors.no_acknowledge += u64::from(classes & class::NO_ACKNOWLEDGE != 0);
        self.errors.restarted += u64::from(classes & class::RESTARTED != 0);
        if classes & class::BUS_OFF != 0 {
            return Err(LinkError::BusOff {
                port: port.to_owned(),
            });
        }
        Ok(())
    }

    /// What is new, unless something was told a moment ago.
    pub(super) fn notice(&mut self, now: HostTime, port: &str) -> Option<String> {
        if self.errors == self.told || now < self.tell_again_at {
            return None;
        }
        self.tell_again_at = now + TELL_EVERY;
        let told = core::mem::replace(&mut self.told, self.errors);
        self.errors.since(told, port)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn error_frames_are_counted_by_class_and_bus_off_ends_the_link() {
        let mut watch = ErrorWatch::new();
        for classes in [0x20, 0x04, 0x100 | 0x20] {
            watch.count(classes, "can0").unwrap();
        }
        assert_eq!(
            watch.errors,
            CanErrors {
                frames: 3,
                no_acknowledge: 2,
                restarted: 1
            }
        );
        let off = watch.count(0x40, "can0");
        assert!(matches!(off, Err(LinkError::BusOff { .. })));
    }

    #[test]
    fn errors_on_the_bus_are_told_with_what_is_new_and_all_and_not_too_often() {
        let mut watch = ErrorWatch::new();
        let start = HostTime::EPOCH + Duration::from_secs(1_000);
        assert_eq!(watch.notice(start, "can0"), None);
        for classes in [0x20, 0x04] {
            watch.count(classes, "can0").unwrap();
        }
        assert!(watch.notice(start, "can0").is_some());
        watch.count(0x100, "can0").unwrap();
        assert_eq!(watch.notice(start, "can0"), None);
        assert_eq!(
            watch.notice(start + TELL_EVERY, "can0").as_deref(),
            Some(
                "can0: 1 error frames (0 not acknowledged, 1 restarts after bus-off), 3 in all: check bit rate, termination \
                 and wiring"
            )
        );
    }
}
