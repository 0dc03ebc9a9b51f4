use std::sync::Mutex;

use ft_drivers::RxStamps;
use ft_drivers::bota_serial::{BotaSerial, Config};
use ft_wire::{Chunk, HostTime};

use super::*;
use crate::item::{Body, Item};

/// A link that opens and is gone at the first read.
struct Dead;

fn gone() -> LinkError {
    LinkError::Gone {
        port: "ttyACM0".to_owned(),
    }
}

impl Link for Dead {
    type Frame = Chunk;

    fn recv(&mut self, _: HostTime) -> Result<Option<(Chunk, RxStamps)>, LinkError> {
        Err(gone())
    }

    fn send(&mut self, _: &Chunk) -> Result<(), LinkError> {
        Ok(())
    }
}

/// Reasons that were told: of the losses as they are, of closed ports with a word before.
#[derive(Clone, Default)]
struct Told(Arc<Mutex<Vec<String>>>);

impl Intake for Told {
    fn put(&mut self, item: Item, _: &StreamCounters) {
        match item.body {
            Body::Event(DeviceEvent::Lost { reason }) => self.0.lock().unwrap().push(reason),
            Body::Event(DeviceEvent::Closed { reason }) => {
                self.0.lock().unwrap().push(format!("closed: {reason}"));
            }
            _ => {}
        }
    }
}

fn pump() -> Pump<BotaSerial, Dead> {
    Pump::new(BotaSerial::new(Config::default()), Dead)
}

/// Runs a thread that begins with a dead link; `opened` is asked for each try, from 0 on, and ends the thread by `None`. Reasons
/// told, and how long it took.
fn run(opened: impl Fn(usize) -> Option<Result<(), LinkError>>) -> (Vec<String>, Duration) {
    run_from(Ok(()), opened)
}

/// The same with this link, dead or not there yet, at the beginning.
fn run_from(
    first: Result<(), LinkError>,
    opened: impl Fn(usize) -> Option<Result<(), LinkError>>,
) -> (Vec<String>, Duration) {
    let clock = MonotonicClock::anchored_now();
    let (told, stop) = (Told::default(), Arc::new(AtomicBool::new(false)));
    let counters = Arc::new(StreamCounters::default());
    let thread = LinkThread {
        processor: None,
        clock,
        channel: Channel::new(0, told.clone(), Arc::clone(&counters), Duration::ZERO),
        counters,
        stop: Arc::clone(&stop),
    };
    let (begun, mut tries) = (clock.now(), 0);
    thread.run(first.map(|()| pump()), move || {
        tries += 1;
        let Some(opened) = opened(tries - 1) else {
            stop.store(true, Ordering::Relaxed);
            return Err(gone());
        };
        opened.map(|()| pump())
    });
    let reasons = told.0.lock().unwrap().clone();
    (reasons, clock.now().saturating_since(begun))
}

#[test]
fn why_a_port_does_not_open_again_is_told_once() {
    let port = || "ttyACM0".to_owned();
    let (told, _) = run(|attempt| match attempt {
        0 => Some(Err(LinkError::NotFound { port: port() })),
        1 | 2 => Some(Err(LinkError::Denied { port: port() })),
        _ => None,
    });
    let denied = LinkError::Denied { port: port() };
    assert_eq!(told, [gone().to_string(), denied.to_string()]);
}

#[test]
fn a_device_that_is_not_there_yet_is_closed_and_tried_on() {
    let port = || "ttyACM0".to_owned();
    let missing = || LinkError::NotFound { port: port() };
    let busy = || LinkError::Busy { port: port() };
    let (told, _) = run_from(Err(missing()), |attempt| match attempt {
        0 => Some(Err(missing())),
        1 => Some(Err(busy())),
        2 => Some(Ok(())),
        _ => None,
    });
    let expected = [
        format!("closed: {}", missing()),
        format!("closed: {}", busy()),
        gone().to_string(),
    ];
    assert_eq!(told, expected);
}

#[test]
fn a_link_that_opens_and_fails_at_once_is_tried_ever_more_seldom() {
    let (told, took) = run(|attempt| (attempt < 3).then_some(Ok(())));
    assert_eq!(told.len(), 4);
    // 0.2, 0.4, 0.8 and 1.6 s.
    assert!(took >= Duration::from_millis(3_000), "{took:?}");
}
