//! What all cells share: faults, seeded choice of the samples they hit, and the check of what came out.

use ft_drivers::device::Counted;
use ft_drivers::link::replay::ReplayLink;
use ft_drivers::pump::{Outlet, Pump};
use ft_drivers::reading::{Counts, DeviceEvent, Quality, Reading};
use ft_drivers::{Device, LinkError, RxStamps, SteppedClock};
use ft_wire::HostTime;

/// Samples of a cell.
pub(crate) const SAMPLES: usize = 2_000;
/// Samples that are hit.
pub(crate) const HITS: usize = 100;
/// Times that the plug is pulled.
pub(crate) const PULLS: usize = 5;
/// Bursts, each of which takes neighbouring frames.
pub(crate) const BURSTS: usize = 20;
/// Most frames, or polls, that a burst takes.
pub(crate) const LONGEST_BURST: usize = 9;
/// Where the long stalls begin, and how long they are, ms: longer than a driver waits for a sample, and than a clock may jump.
pub(crate) const LONG_STALLS: [(usize, u64); 2] = [(100, 1_100), (1_250, 1_200)];
pub(crate) const START: HostTime = HostTime::from_nanos(1_000_000_000_000);

#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Fault {
    Lost,
    Duplicated,
    Reordered,
    Corrupted,
    Merged,
    Split,
    Stalled,
    ClockJump,
    Unplugged,
    Restarted,
    Overload,
    Burst,
    LongStall,
}

pub(crate) const FAULTS: [Fault; 13] = [
    Fault::Lost,
    Fault::Duplicated,
    Fault::Reordered,
    Fault::Corrupted,
    Fault::Merged,
    Fault::Split,
    Fault::Stalled,
    Fault::ClockJump,
    Fault::Unplugged,
    Fault::Restarted,
    Fault::Overload,
    Fault::Burst,
    Fault::LongStall,
];

impl Fault {
    pub(crate) const fn name(self) -> &'static str {
        match self {
            Self::Lost => "lost",
            Self::Duplicated => "duplicated",
            Self::Reordered => "reordered",
            Self::Corrupted => "corrupted",
            Self::Merged => "merged",
            Self::Split => "split",
            Self::Stalled => "stalled",
            Self::ClockJump => "clock jumps",
            Self::Unplugged => "unplugged",
            Self::Restarted => "restarted",
            Self::Overload => "overload",
            Self::Burst => "bursts lost",
            Self::LongStall => "long stalls",
        }
    }
}

pub(crate) struct Row {
    pub(crate) driver: &'static str,
    pub(crate) cells: Vec<String>,
}

/// The splitmix64 generator.
pub(crate) struct Seeded(pub(crate) u64);

impl Seeded {
    pub(crate) fn below(&mut self, bound: usize) -> usize {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut mixed = self.0;
        mixed = (mixed ^ (mixed >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        ((mixed ^ (mixed >> 31)) % bound as u64) as usize
    }

    /// First and last but one of each burst, in a stretch of `per_sample` frames a sample.
    pub(crate) fn bursts(&mut self, per_sample: usize) -> Vec<core::ops::Range<usize>> {
        let burst = |burst: usize| {
            let first = per_sample * (60 + burst * 95) + self.below(20 * per_sample);
            first..first + 2 + self.below(LONGEST_BURST - 1)
        };
        (0..BURSTS).map(burst).collect()
    }

    /// Indices of the samples that are hit: one in each stretch of 19, at least ten apart, none at either end.
    pub(crate) fn hits(&mut self) -> Vec<usize> {
        (0..HITS).map(|hit| 60 + hit * 19 + self.below(9)).collect()
    }
}

/// What came out.
#[derive(Default)]
pub(crate) struct Outcome {
    pub(crate) readings: Vec<Reading>,
    pub(crate) counts: Counts,
    /// Links that ended.
    pub(crate) gone: usize,
    /// Polls that were hit.
    pub(crate) hits: u64,
}

impl<F> Outlet<F> for Outcome {
    fn frame(&mut self, _frame: &F, _stamps: RxStamps) {}
    fn reading(&mut self, reading: Reading) {
        self.readings.push(reading);
    }
}

/// A sample's numbers, and whether it is delivered as good.
pub(crate) fn values(reading: &Reading) -> Option<(Vec<f64>, bool)> {
    match reading {
        Reading::Wrench(wrench) => Some((
            wrench.wrench.to_array().to_vec(),
            wrench.quality == Quality::Good,
        )),
        Reading::Width(width) => Some((vec![width.width_m], true)),
        Reading::Pose(pose) => Some((
            [&pose.pose.position[..], &pose.pose.quaternion].concat(),
            true,
        )),
        _ => None,
    }
}

impl Outcome {
    pub(crate) fn samples(&self) -> Vec<(Vec<f64>, bool)> {
        self.readings.iter().filter_map(values).collect()
    }

    /// Plays `frames` to a listening driver.
    pub(crate) fn play<D>(&mut self, device: D, frames: Vec<(D::Frame, HostTime)>)
    where
        D: Device<Reading = Reading> + Counted,
        D::Frame: Clone,
    {
        let clock = SteppedClock::new(START);
        let stamped = frames
            .into_iter()
            .map(|(frame, arrival)| (frame, RxStamps { arrival }));
        let mut pump = Pump::new(device, ReplayLink::new(clock.clone(), stamped));
        loop {
            match pump.turn(&clock, HostTime::FAR_FUTURE, self) {
                Ok(_) => {}
                Err(LinkError::Gone { .. }) => break,
                Err(error) => panic!("{error}"),
            }
        }
        self.gone += 1;
        self.counts = self.counts + pump.counts();
    }

    /// Times that the driver called its device lost.
    pub(crate) fn losses(&self) -> usize {
        let lost = |reading: &&Reading| {
            matches!(
                reading,
                Reading::Event {
                    event: DeviceEvent::Lost { .. },
                    ..
                }
            )
        };
        self.readings.iter().filter(lost).count()
    }

    /// Fails unless every sample delivered as good is one of `sent`, within `tolerance` of each number.
    pub(crate) fn assert_good_is_true(&self, sent: &[Vec<f64>], tolerance: &[f64], what: &str) {
        for (sample, good) in self.samples() {
            let near = |true_one: &Vec<f64>| {
                let mut pairs = sample.iter().zip(true_one).zip(tolerance);
                pairs.all(|((got, sent), tolerance)| (got - sent).abs() <= *tolerance)
            };
            assert!(
                !good || sent.iter().any(near),
                "{what}: {sample:?} was never sent"
            );
        }
    }
}
