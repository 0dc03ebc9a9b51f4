use std::collections::VecDeque;
use std::time::Duration;

use ft_wire::DecodeError;

use super::*;
use crate::clock::SteppedClock;
use crate::reading::DeviceEvent;

const MS: Duration = Duration::from_millis(1);

/// Wants to send one frame at every timeout, every 10 ms.
struct Ticker {
    next: HostTime,
    waiting: Option<u8>,
    events: VecDeque<Reading>,
}

impl Device for Ticker {
    type Frame = u8;
    type Reading = Reading;

    fn handle_frame(&mut self, frame: &u8, stamps: RxStamps) -> Result<(), DecodeError> {
        let event = DeviceEvent::Warning {
            text: frame.to_string(),
        };
        self.events.push_back(Reading::Event {
            at: stamps.arrival,
            event,
        });
        Err(DecodeError::Length {
            expected: 1,
            got: 2,
        })
    }
    fn handle_timeout(&mut self, now: HostTime) {
        self.next = now + 10 * MS;
        self.waiting = Some(1);
    }
    fn poll_timeout(&self) -> Option<HostTime> {
        Some(self.next)
    }
    fn poll_transmit(&mut self, _now: HostTime) -> Option<u8> {
        self.waiting.take()
    }
    fn poll_reading(&mut self) -> Option<Reading> {
        self.events.pop_front()
    }
}

/// Delivers a frame every millisecond, and moves the clock on as a wait would.
struct BusyLink {
    clock: SteppedClock,
    asked_until: Vec<HostTime>,
    sent_at: Vec<HostTime>,
    silent: bool,
    late_frame: Option<HostTime>,
    notice: Option<String>,
}

impl Link for BusyLink {
    type Frame = u8;

    fn recv(&mut self, deadline: HostTime) -> Result<Option<(u8, RxStamps)>, LinkError> {
        self.asked_until.push(deadline);
        if let Some(arrival) = self.late_frame.take() {
            return Ok(Some((7, RxStamps { arrival })));
        }
        if self.silent {
            self.clock.advance_to(deadline);
            return Ok(None);
        }
        let arrival = self.clock.now() + MS;
        self.clock.advance_to(arrival);
        Ok(Some((7, RxStamps { arrival })))
    }
    fn send(&mut self, _frame: &u8) -> Result<(), LinkError> {
        self.sent_at.push(self.clock.now());
        Ok(())
    }
    fn take_notice(&mut self) -> Option<String> {
        self.notice.take()
    }
}

#[derive(Default)]
struct Log(Vec<&'static str>);

impl Outlet<u8> for Log {
    fn frame(&mut self, _frame: &u8, _stamps: RxStamps) {
        self.0.push("frame");
    }
    fn reading(&mut self, _reading: Reading) {
        self.0.push("reading");
    }
}

fn pump(silent: bool) -> (Pump<Ticker, BusyLink>, SteppedClock) {
    let clock = SteppedClock::new(HostTime::from_nanos(1_000_000_000));
    let device = Ticker {
        next: HostTime::EPOCH,
        waiting: None,
        events: VecDeque::new(),
    };
    let link = BusyLink {
        clock: clock.clone(),
        asked_until: Vec::new(),
        sent_at: Vec::new(),
        silent,
        late_frame: None,
        notice: None,
    };
    (Pump::new(device, link), clock)
}

#[test]
fn a_busy_bus_does_not_starve_the_timers() {
    let (mut pump, clock) = pump(false);
    let mut log = Log::default();
    for _ in 0..100 {
        pump.turn(&clock, clock.now() + 100 * MS, &mut log).unwrap();
    }
    // 100 ms went by with a frame in each: the timer fired with the first frame and every 10 ms from there.
    assert_eq!(pump.link().sent_at.len(), 10);
}

#[test]
fn a_frame_comes_out_before_its_readings_even_when_it_is_malformed() {
    let (mut pump, clock) = pump(false);
    let mut log = Log::default();
    assert_eq!(
        pump.turn(&clock, clock.now() + MS, &mut log).unwrap(),
        Turn::Frame
    );
    assert_eq!(log.0, ["frame", "reading"]);
}

#[test]
fn what_a_link_has_to_tell_becomes_a_warning_once() {
    struct Events(Vec<Reading>);
    impl Outlet<u8> for Events {
        fn frame(&mut self, _frame: &u8, _stamps: RxStamps) {}
        fn reading(&mut self, reading: Reading) {
            self.0.push(reading);
        }
    }
    let (mut pump, clock) = pump(true);
    pump.link.notice = Some("latency timer 16 ms".to_owned());
    let mut events = Events(Vec::new());
    for _ in 0..3 {
        pump.turn(&clock, clock.now() + MS, &mut events).unwrap();
    }
    let event = DeviceEvent::Warning {
        text: "latency timer 16 ms".to_owned(),
    };
    let at = HostTime::from_nanos(1_000_000_000);
    assert_eq!(events.0, [Reading::Event { at, event }]);
}

#[test]
fn a_wait_ends_at_the_earlier_of_deadline_and_timeout() {
    let (mut pump, clock) = pump(true);
    let start = clock.now();
    let mut log = Log::default();
    for wait in [4, 4, 100] {
        assert_eq!(
            pump.turn(&clock, start + wait * MS, &mut log).unwrap(),
            Turn::Idle
        );
    }
    // The first turn begins the device.
    assert_eq!(
        pump.link().asked_until,
        [HostTime::EPOCH, start + 4 * MS, start + 10 * MS]
    );
    // The timeout was served in the same turn.
    assert_eq!(pump.link().sent_at, [start, start + 10 * MS]);
}

#[test]
fn a_thread_that_was_held_up_reads_what_waits_before_it_serves_timeouts() {
    let (mut pump, clock) = pump(false);
    let mut log = Log::default();
    pump.turn(&clock, clock.now() + MS, &mut log).unwrap();
    assert_eq!(pump.link().sent_at.len(), 1);
    // The clock runs on by a second, but the link delivers what came in time.
    let early = clock.now() + 2 * MS;
    pump.link.late_frame = Some(early);
    clock.advance_to(clock.now() + 1_000 * MS);
    assert_eq!(
        pump.turn(&clock, clock.now() + MS, &mut log).unwrap(),
        Turn::Frame
    );
    assert_eq!(pump.link().sent_at.len(), 1);
    assert_eq!(
        pump.turn(&clock, clock.now() + MS, &mut log).unwrap(),
        Turn::Frame
    );
    assert_eq!(pump.link().sent_at.len(), 2);
}
