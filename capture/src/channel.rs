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
use ft_drivers::translate::{ClockStatus, Counted, Handover, OneWay, OneWayConfig};
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

/// Said when the number of samples turned out to be no clock yet.
const NO_CLOCK: &str = "samples were lost without a trace, or came unevenly, and their period was learned wrong: the stamps of the seconds before \
                        this are as late as the arrivals, or early by up to some tens of ms; from here on they are by the number of samples again";

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
    /// How often the clock was restarted, ...
    restarts: u32,
    /// ... and [`Item::clock_epoch`] of what comes next.
    clock_epoch: u32,
    /// How often the operator was told that the samples were no clock.
    told: u32,
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
            restarts: 0,
            clock_epoch: 0,
            told: 0,
        }
    }

    /// The device samples evenly, so that the number of its samples is a clock where it has none.
    #[must_use]
    pub fn sampling_evenly(mut self, evenly: Option<Handover>) -> Self {
        self.counted = evenly.map(|handover| Counted::new(config(self.link_delay), handover));
        self
    }

    /// The device or its link was restarted: its clock begins anew.
    pub fn restart_clock(&mut self) {
        self.translator.reset();
        self.restarts = self.restarts.wrapping_add(1);
        if let Some(counted) = &mut self.counted {
            counted.reset();
        }
    }

    fn put(&mut self, arrival: HostTime, sample_time: HostTime, body: Body) {
        let item = Item {
            device: Some(self.device),
            arrival,
            clock_epoch: self.clock_epoch,
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
            self.clock_epoch = self.restarts;
            self.report_clock(at.arrival, self.translator.status());
            return translated.at;
        }
        let counted = self.counted.as_mut();
        let Some((instant, status, mended)) = counted.and_then(|counted| {
            let instant = counted.observe(at.arrival)?;
            Some((instant, counted.status(), counted.mended()))
        }) else {
            return at.arrival - self.link_delay;
        };
        self.clock_epoch = self.restarts.wrapping_add(instant.periods);
        self.report_clock(at.arrival, status);
        if mended > self.told {
            self.told = mended;
            self.put(
                at.arrival,
                at.arrival,
                Body::Event(DeviceEvent::Warning {
                    text: NO_CLOCK.to_owned(),
                }),
            );
        }
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
            Reading::Missing { samples } => {
                if let Some(counted) = &mut self.counted {
                    counted.pass(samples);
                }
            }
            Reading::Event { at, event } => {
                self.take_state(&event);
                self.put(at, at, Body::Event(event));
            }
            _ => {}
        }
    }
}

#[cfg(test)]
mod tests {
    use ft_drivers::reading::WrenchReading;
    use ft_wire::frames::Wrench;

    use super::*;

    #[derive(Default)]
    struct Taken(Vec<Item>);

    impl Intake for &mut Taken {
        fn put(&mut self, item: Item, _: &StreamCounters) {
            self.0.push(item);
        }
    }

    /// 20 s at 100 Hz behind an adapter that hands over every 16 ms, without the samples in `lost`: sample times minus the truth from
    /// 12 s on, the largest in us, and what was warned of. The driver `knows` of the losses or not.
    fn seen(lost: core::ops::Range<i64>, knows: bool) -> (f64, Vec<String>) {
        let mut taken = Taken::default();
        let mut channel = Channel::new(0, &mut taken, Arc::default(), Duration::ZERO)
            .sampling_evenly(Some(Handover::Polled));
        for k in 0..2_000_i64 {
            if lost.contains(&k) {
                if knows {
                    let missing = Reading::Missing { samples: 1 };
                    Outlet::<ft_wire::can::CanFrame>::reading(&mut channel, missing);
                }
                continue;
            }
            let true_ns = 1_700_000_000_000_000_000 + k * 10_000_000;
            let arrival = HostTime::from_nanos((true_ns / 16_000_000 + 1) * 16_000_000);
            let reading = Reading::Wrench(WrenchReading {
                at: SampleInstant {
                    arrival,
                    device_ns: None,
                },
                wrench: Wrench::from_array([0.0; 6]),
                temperature_celsius: None,
                quality: Quality::Good,
                status_bits: k as u32,
            });
            Outlet::<ft_wire::can::CanFrame>::reading(&mut channel, reading);
        }
        let (mut worst, mut warned) = (0.0_f64, Vec::new());
        for item in &taken.0 {
            match &item.body {
                Body::Wrench(reading) if reading.status_bits >= 1_200 => {
                    let true_ns =
                        1_700_000_000_000_000_000 + i64::from(reading.status_bits) * 10_000_000;
                    let error = item.sample_time.as_nanos() - true_ns;
                    worst = worst.max(1e-3 * error.abs() as f64);
                }
                Body::Event(DeviceEvent::Warning { text }) => warned.push(text.clone()),
                _ => {}
            }
        }
        (worst, warned)
    }

    #[test]
    fn losses_while_the_period_is_learned_are_made_good_and_told() {
        let (whole, silent) = seen(0..0, false);
        assert!(silent.is_empty(), "{silent:?}");
        let (worst, warned) = seen(40..43, false);
        // Arrivals are up to 16 ms late.
        assert!(whole < 2_500.0 && worst < 2_500.0, "{whole} {worst}");
        assert_eq!(warned.len(), 1);
        assert!(
            warned[0].contains("samples were lost")
                && warned[0].contains("as late as the arrivals, or early"),
            "{warned:?}"
        );
        // Those that the driver knows of are no loss of time.
        let (worst, warned) = seen(40..43, true);
        assert!(worst < 2_500.0, "{worst}");
        assert!(warned.is_empty(), "{warned:?}");
    }
}
