//! One device's channel: stamps what the driver delivers on the host clock and hands it on.
//!
//! This runs in the acquisition thread: it neither allocates nor waits per frame. Two exceptions allocate, both rare: device
//! events (text), and the first frame (buffers grow).

use std::sync::Arc;
use std::time::Duration;

use ft_drivers::link::RxStamps;
use ft_drivers::link::record::RawFrame;
use ft_drivers::pump::Outlet;
use ft_drivers::reading::{DeviceEvent, Quality, Reading, SampleInstant};
use ft_drivers::translate::{ClockStatus, Counted, OneWay, OneWayConfig};
use ft_wire::HostTime;

use crate::item::{Body, Item, RawBytes};
use crate::ledger::StreamCounters;

/// Takes what channels deliver. Live: queues that never wait. Simulated at full speed: a buffer.
pub trait Intake {
    /// Takes one item; `counters` are those of its device, to count what had to be dropped.
    fn put(&mut self, item: Item, counters: &StreamCounters);
}

/// How often the state of a device's clock is reported.
const CLOCK_REPORT_PERIOD: Duration = Duration::from_secs(1);

/// The outlet of one device's pump.
#[derive(Debug)]
pub struct Channel<I> {
    device: usize,
    intake: I,
    counters: Arc<StreamCounters>,
    translator: OneWay,
    /// For a device without a clock that samples evenly.
    counted: Option<Counted>,
    link_delay: Duration,
    raw: Vec<u8>,
    clock_report_due: HostTime,
    delivers: bool,
}

fn config(link_delay: Duration) -> OneWayConfig {
    OneWayConfig {
        link_delay,
        ..OneWayConfig::default()
    }
}

impl<I: Intake> Channel<I> {
    /// The channel of the device at position `device`; `link_delay` is the constant part of sample to arrival.
    #[must_use]
    pub fn new(
        device: usize,
        intake: I,
        counters: Arc<StreamCounters>,
        link_delay: Duration,
    ) -> Self {
        Self {
            device,
            intake,
            counters,
            translator: OneWay::new(config(link_delay)),
            counted: None,
            link_delay,
            raw: Vec::with_capacity(RawBytes::CAPACITY),
            clock_report_due: HostTime::EPOCH,
            delivers: false,
        }
    }

    /// The device samples evenly, so that the number of its samples is a clock where it has none.
    #[must_use]
    pub fn sampling_evenly(mut self, evenly: bool) -> Self {
        self.counted = evenly.then(|| Counted::new(config(self.link_delay)));
        self
    }

    /// The device or its link was restarted: its clock begins anew.
    pub fn restart_clock(&mut self) {
        self.translator.reset();
        if let Some(counted) = &mut self.counted {
            counted.reset();
        }
    }

    fn put(&mut self, arrival: HostTime, sample_time: HostTime, body: Body) {
        let item = Item {
            device: Some(self.device),
            arrival,
            sample_time,
            body,
        };
        self.intake.put(item, &self.counters);
    }

    /// When a sample was true: by the device's clock where it has one, by the number of samples where these are even, else its
    /// arrival less the constant delay. A count is the sample's instant on a device clock from here on.
    fn sample_time(&mut self, at: &mut SampleInstant) -> HostTime {
        if let Some(device_ns) = at.device_ns {
            let translated = self.translator.observe(device_ns, at.arrival);
            self.report_clock(at.arrival, self.translator.status());
            return translated.at;
        }
        let counted = self.counted.as_mut();
        let Some((instant, status)) = counted
            .and_then(|counted| Some((counted.observe(at.arrival)?, counted.clock().status())))
        else {
            return at.arrival - self.link_delay;
        };
        self.report_clock(at.arrival, status);
        at.device_ns = Some(instant.device_ns);
        instant.translated.at
    }

    /// Says once a second where the clock stands.
    fn report_clock(&mut self, now: HostTime, status: Option<ClockStatus>) {
        if now < self.clock_report_due {
            return;
        }
        if let Some(status) = status {
            self.clock_report_due = now + CLOCK_REPORT_PERIOD;
            self.put(now, now, Body::Clock(status));
        }
    }

    /// A loss counts once, and only when samples flowed.
    fn take_state(&mut self, event: &DeviceEvent) {
        match event {
            DeviceEvent::Streaming => {
                self.delivers = true;
                // Its clock may have stood still, or begun anew.
                self.restart_clock();
            }
            DeviceEvent::Lost { .. } if std::mem::take(&mut self.delivers) => {
                self.counters.add_interruption()
            }
            _ => {}
        }
    }

    fn count_quality(&self, quality: Quality) {
        match quality {
            Quality::Good => {}
            Quality::Overrange => self.counters.add_overrange(),
            Quality::Invalid => self.counters.add_invalid(),
        }
    }
}

impl<I: Intake, F: RawFrame> Outlet<F> for Channel<I> {
    fn frame(&mut self, frame: &F, stamps: RxStamps) {
        self.raw.clear();
        frame.write_raw(&mut self.raw);
        if let Some(bytes) = RawBytes::new(&self.raw) {
            self.put(stamps.arrival, stamps.arrival, Body::Raw(bytes));
        }
    }

    fn reading(&mut self, reading: Reading) {
        match reading {
            Reading::Wrench(mut reading) => {
                self.count_quality(reading.quality);
                let at = self.sample_time(&mut reading.at);
                self.put(reading.at.arrival, at, Body::Wrench(reading));
            }
            Reading::Width(mut reading) => {
                let at = self.sample_time(&mut reading.at);
                self.put(reading.at.arrival, at, Body::Width(reading));
            }
            Reading::Pose(mut reading) => {
                let at = self.sample_time(&mut reading.at);
                self.put(reading.at.arrival, at, Body::Pose(reading));
            }
            Reading::Event { at, event } => {
                self.take_state(&event);
                self.put(at, at, Body::Event(event));
            }
            _ => {}
        }
    }
}
