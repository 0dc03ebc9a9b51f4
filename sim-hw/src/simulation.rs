//! World, person and devices on one time line, moved on by the caller.

mod fitted;
mod sensor;
pub(crate) mod slot;

use std::time::Duration;

use ft_drivers::{MonotonicClock, SteppedClock};
use ft_wire::{CanFrame, Chunk, HostTime};

pub use fitted::{Fitted, KnownSetup, PayloadEstimate, SettingValue};

use self::slot::{Slot, SlotKind};
use crate::bus::{SimCanLink, SimLink, SimSerialLink, TimeSource};
use crate::clock::SimNanos;
use crate::scenario::{Scenario, ScenarioError};
use crate::scene::Scene;
use crate::truth::Truth;
use crate::world::Moment;

/// A scenario made particular by a seed, with its devices, at an instant.
///
/// Stepped: nothing happens but by [`Simulation::advance_to`], and the same seed and the same calls give the same bytes with
/// the same stamps.
#[derive(Debug)]
pub struct Simulation {
    scene: Scene,
    slots: Vec<Slot>,
    fitted: Vec<Fitted>,
    known: KnownSetup,
    truth: Truth,
    start: HostTime,
    now: HostTime,
    stepped: Option<SteppedClock>,
    marks: Vec<(HostTime, String)>,
    marks_given: usize,
}

impl Simulation {
    /// The scenario with everything that `seed` draws, beginning at `start` and lasting `duration` (by default as long as a
    /// minute of probing takes).
    ///
    /// # Errors
    /// The duration is too short, or the object does not rest by itself.
    pub fn new(
        scenario: &Scenario,
        seed: u64,
        start: HostTime,
        duration: Option<Duration>,
    ) -> Result<Self, ScenarioError> {
        let clock = SteppedClock::new(start);
        let mut simulation = Self::build(
            scenario,
            seed,
            start,
            duration,
            &TimeSource::Stepped(clock.clone()),
        )?;
        simulation.stepped = Some(clock);
        Ok(simulation)
    }

    /// The same in real time, beginning now: links wait, and what the host sends carries the clock's time.
    pub(crate) fn live(
        scenario: &Scenario,
        seed: u64,
        duration: Option<Duration>,
        clock: MonotonicClock,
    ) -> Result<Self, ScenarioError> {
        let time = TimeSource::Live(clock);
        Self::build(scenario, seed, time.now(), duration, &time)
    }

    fn build(
        scenario: &Scenario,
        seed: u64,
        start: HostTime,
        duration: Option<Duration>,
        time: &TimeSource,
    ) -> Result<Self, ScenarioError> {
        let scene = Scene::new(
            scenario,
            seed,
            duration.map(|duration| duration.as_secs_f64()),
        )?;
        let (slots, clocks) = fitted::build(scenario, scenario.salted(seed), &scene.tool, time);
        let timeline = scene.timeline;
        let mark = |t: f64, text: &str| (start.offset_by_seconds(t), text.to_owned());
        let marks = vec![
            mark(timeline.free_air_begin, "free_air_begin"),
            mark(timeline.grasp, "grasp"),
            mark(timeline.release, "release"),
        ];
        Ok(Self {
            fitted: slots.iter().map(|slot| slot.fitted.clone()).collect(),
            known: KnownSetup::draw(scenario, scenario.salted(seed), &scene.tool),
            truth: Truth::of(scenario, seed, &scene, start, clocks),
            scene,
            slots,
            start,
            now: start,
            stepped: None,
            marks,
            marks_given: 0,
        })
    }

    /// The devices and what an operator would write into the config about them.
    #[must_use]
    pub fn fitted(&self) -> &[Fitted] {
        &self.fitted
    }

    /// What an operator's calibration says: mounting as it is, payload a little off.
    #[must_use]
    pub fn known_setup(&self) -> KnownSetup {
        self.known.clone()
    }

    /// The host's end of the serial line of device `name`; `None` when there is none of that name on a serial line.
    #[must_use]
    pub fn serial_link(&self, name: &str) -> Option<SimSerialLink> {
        self.slots
            .iter()
            .find(|slot| slot.fitted.name == name)
            .and_then(|slot| match &slot.kind {
                SlotKind::Serial(wired) => Some(SimLink::<Chunk>::new(wired.port.clone())),
                SlotKind::Can(_) => None,
            })
    }

    /// The host's end of the CAN bus of device `name`; `None` when there is none of that name on CAN.
    #[must_use]
    pub fn can_link(&self, name: &str) -> Option<SimCanLink> {
        self.slots
            .iter()
            .find(|slot| slot.fitted.name == name)
            .and_then(|slot| match &slot.kind {
                SlotKind::Can(wired) => Some(SimLink::<CanFrame>::new(wired.port.clone())),
                SlotKind::Serial(_) => None,
            })
    }

    /// Plays everything up to `t`; an earlier `t` is ignored.
    pub fn advance_to(&mut self, t: HostTime) {
        let target = self.nanos(t);
        while let Some((index, due)) = self.next_due().filter(|(_, due)| *due <= target) {
            self.scene.advance_to(due as f64 * 1e-9);
            self.slots[index].play(due, self.start, &self.scene);
        }
        self.scene.advance_to(target as f64 * 1e-9);
        self.now = self.now.max(t);
        if let Some(clock) = &self.stepped {
            clock.advance_to(t);
        }
    }

    fn next_due(&self) -> Option<(usize, SimNanos)> {
        let dues = self
            .slots
            .iter()
            .enumerate()
            .filter_map(|(index, slot)| Some((index, slot.due(self.start)?)));
        // What came late (a command sent since) is played now; the scene does not go back.
        let now = self.nanos(self.now);
        dues.map(|(index, due)| (index, due.max(now)))
            .min_by_key(|(_, due)| *due)
    }

    fn nanos(&self, t: HostTime) -> SimNanos {
        t.as_nanos() - self.start.as_nanos()
    }

    /// When the recording is over.
    #[must_use]
    pub fn end(&self) -> HostTime {
        self.start.offset_by_seconds(self.scene.timeline.end)
    }

    /// Whether [`Simulation::end`] has been reached.
    #[must_use]
    pub fn is_over(&self) -> bool {
        self.now >= self.end()
    }

    /// The operator's marks since the last call, in order.
    pub fn drain_marks(&mut self) -> Vec<(HostTime, String)> {
        let given = self.marks_given;
        self.marks_given += self.marks[given..]
            .iter()
            .take_while(|(at, _)| *at <= self.now)
            .count();
        self.marks[given..self.marks_given].to_vec()
    }

    /// The joint's true motion and the tool's effort on it at the present instant; for tests.
    #[must_use]
    pub fn moment(&self) -> Moment {
        self.scene.sight(self.nanos(self.now) as f64 * 1e-9).moment
    }

    /// All that is so and that nobody measuring may see.
    #[must_use]
    pub fn truth(&self) -> Truth {
        self.truth.clone()
    }

    pub(crate) fn slots(&self) -> &[Slot] {
        &self.slots
    }
}
