use super::*;
use crate::clock::SteppedClock;
use crate::link::Link;
use crate::link::faults::{FaultRates, FaultyLink};
use crate::link::replay::ReplayLink;
use crate::options::Sign;
use crate::pump::{Outlet, Pump};
use crate::reading::Identity;
use crate::test_support::Bench;

const PERIOD_US: u32 = 1_250;

fn sample(index: u32) -> Sample {
    Sample {
        status: Status(0),
        force: [1.0, -2.0, 3.5],
        torque: [0.5, -0.25, 0.125],
        timestamp_us: index.wrapping_mul(PERIOD_US),
        temperature_celsius: 25.0,
    }
}

fn frame(index: u32) -> [u8; wire::FRAME_LEN] {
    wire::encode(&sample(index))
}

fn bench() -> Bench<BotaSerial> {
    Bench::new(BotaSerial::new(Config::default()))
}

#[test]
fn a_rate_that_the_line_cannot_carry_is_warned_of() {
    // 37 bytes of ten bits a sample.
    for (baud, sinc_length, carried) in [
        (wire::BaudRate::Bps9600, 51, false),
        (wire::BaudRate::Bps230400, 64, false),
        (wire::BaudRate::Bps230400, 128, true),
        (wire::BaudRate::Bps460800, 51, true),
    ] {
        let mut config = Config {
            baud,
            ..Config::default()
        };
        config.filter.sinc_length = sinc_length;
        let mut bench = Bench::new(BotaSerial::new(config));
        bench.advance_ms(1);
        let told = bench.complaints();
        assert_eq!(told.is_empty(), carried, "{baud:?}: {told:?}");
        assert!(carried || told[0].contains(&format!("a line of {} bit/s", baud.bps())));
    }
}

fn listening() -> Bench<BotaSerial> {
    Bench::new(BotaSerial::new(Config {
        startup: Startup::Listen,
        ..Config::default()
    }))
}

/// Waits for a command and acknowledges it.
fn acknowledge(bench: &mut Bench<BotaSerial>, expected: &str) {
    let mut text = Vec::new();
    for _ in 0..1_000 {
        bench.advance_ms(1);
        text.extend(bench.take_sent());
        if text == expected.as_bytes() {
            let letter = char::from(text[0]);
            bench
                .bytes(format!("r,0,{letter},0\r\n").as_bytes())
                .unwrap();
            return;
        }
    }
    panic!(
        "{expected} was awaited, got {}",
        String::from_utf8_lossy(&text)
    );
}

/// Takes a driver to streaming by the book.
fn streaming() -> Bench<BotaSerial> {
    let mut bench = bench();
    for command in ["C", "c,0,1,0,4", "f,64,0,0,1", "R"] {
        acknowledge(&mut bench, command);
    }
    bench.bytes(&frame(0)).unwrap();
    assert_eq!(
        bench.events(),
        [DeviceEvent::Starting, DeviceEvent::Streaming]
    );
    bench
}

/// Frames `indices` arrive one by one, each at its sensor time.
fn feed(bench: &mut Bench<BotaSerial>, indices: impl IntoIterator<Item = u32>) {
    for index in indices {
        bench.advance(Duration::from_micros(PERIOD_US.into()));
        let _ = bench.bytes(&frame(index));
    }
}

/// What a sensor leaves that `C` stopped, or that was opened, in the middle of a frame.
#[test]
fn an_acknowledgement_after_a_piece_of_a_frame_is_read() {
    let mut tail = frame(1)[20..].to_vec();
    tail[5] = wire::HEADER;
    for piece in [&tail[..], &frame(1)[..20], &frame(1)[..1]] {
        let mut bench = bench();
        bench.advance_ms(1);
        assert_eq!(bench.take_sent(), b"C");
        let _ = bench.bytes(piece);
        let _ = bench.bytes(b"r,0,");
        let _ = bench.bytes(b"C,0\r\n");
        bench.advance_ms(100);
        assert_eq!(bench.take_sent(), b"c,0,1,0,4", "{piece:?}");
        assert_eq!(bench.device.counts(), Counts::default());
    }
    // Somebody else sets the sensor up meanwhile: for its acknowledgements a listener waits longer than for samples.
    let mut bench = listening();
    feed(&mut bench, 0..50);
    bench.bytes(&frame(50)[..20]).unwrap();
    let _ = bench.bytes(b"r,0,C,0\r\n");
    bench.advance_ms(1_500);
    assert_eq!(bench.complaints(), Vec::<String>::new());
}

#[test]
fn set_up_by_the_book_ends_in_samples() {
    let bench = streaming();
    let [reading] = bench.wrenches()[..] else {
        panic!()
    };
    assert_eq!(
        reading.wrench.to_array(),
        [1.0, -2.0, 3.5, 0.5, -0.25, 0.125]
    );
    assert_eq!(reading.temperature_celsius, Some(25.0));
    assert_eq!(
        reading.at,
        SampleInstant {
            arrival: bench.now,
            device_ns: Some(0)
        }
    );
    assert_eq!(reading.quality, Quality::Good);
    assert_eq!(
        bench.device.counts(),
        Counts {
            received: 1,
            ..Counts::default()
        }
    );
}

#[test]
fn a_slow_filter_is_not_called_silent_between_its_samples() {
    let slow = |sinc_length, chop| {
        let config = Config {
            filter: Filter {
                sinc_length,
                chop,
                fast: false,
                fir_disable: true,
            },
            ..Config::default()
        };
        BotaSerial::new(config).config.silence_timeout
    };
    assert_eq!(slow(64, false), Duration::from_millis(500));
    assert_eq!(slow(64, true), Duration::from_millis(500));
    assert_eq!(slow(4096, false), Duration::from_micros(508_875));
    assert_eq!(slow(4096, true), Duration::from_micros(2_035_500));
}

#[test]
fn characters_leave_5_ms_apart() {
    let mut bench = bench();
    acknowledge(&mut bench, "C");
    bench.advance_until(|bench| bench.sent.len() == 9);
    let steps: Vec<_> = bench
        .sent
        .windows(2)
        .map(|pair| pair[1].0.saturating_since(pair[0].0).as_millis())
        .collect();
    assert_eq!(steps, [5; 8]);
    assert_eq!(bench.take_sent(), b"c,0,1,0,4");
}

#[test]
fn a_stream_still_running_is_stopped_and_drained_and_not_delivered() {
    let mut bench = bench();
    bench.advance_ms(1);
    assert_eq!(bench.take_sent(), b"C");
    for index in 0..20 {
        bench.advance_ms(1);
        bench.bytes(&frame(index)).unwrap();
    }
    bench.bytes(b"r,0,C,0\r\n").unwrap();
    // What was still under way, half a frame included.
    for index in 20..25 {
        bench.advance_ms(10);
        bench.bytes(&frame(index)[..20]).unwrap();
    }
    assert_eq!(bench.take_sent(), b"");
    for command in ["c,0,1,0,4", "f,64,0,0,1", "R"] {
        acknowledge(&mut bench, command);
    }
    feed(&mut bench, 100..103);
    assert_eq!(bench.wrenches().len(), 3);
    assert_eq!(
        bench.device.counts(),
        Counts {
            received: 3,
            ..Counts::default()
        }
    );
}

#[test]
fn silence_during_set_up_is_lost_after_2_s_and_tried_again_after_1_s() {
    let mut bench = bench();
    let lost = bench.advance_until(|bench| bench.events().len() == 2);
    assert_eq!(lost, Duration::from_secs(2));
    assert!(bench.complaints()[0].contains("no bytes at all: check power, cable and port"));
    assert_eq!(bench.take_sent(), b"C");
    let again = bench.advance_until(|bench| bench.events().len() == 3);
    assert_eq!(again, Duration::from_secs(1));
    assert_eq!(bench.take_sent(), b"C");
}

#[test]
fn bytes_that_mean_nothing_point_at_the_bit_rate() {
    let mut bench = bench();
    bench.advance_ms(1);
    for _ in 0..50 {
        bench.advance_ms(10);
        bench.bytes(&[0xE0, 0x1C, 0x80]).unwrap();
    }
    bench.advance_ms(2_000);
    let complaint = &bench.complaints()[0];
    assert!(
        complaint.contains("150 bytes that mean nothing: check the bit rate"),
        "{complaint}"
    );
}

#[test]
fn each_step_has_its_timeout() {
    let all = ["C", "c,0,1,0,4", "f,64,0,0,1", "R"];
    for unanswered in 0..all.len() {
        let mut bench = bench();
        for command in &all[..unanswered] {
            acknowledge(&mut bench, command);
        }
        bench.advance_ms(3_000);
        let complaint = bench.complaints().remove(0);
        let awaited = match all[unanswered] {
            "R" => "no sample".to_owned(),
            command => format!("no answer to `{command}`"),
        };
        assert!(complaint.starts_with(&awaited), "{complaint}");
    }
}

#[test]
fn an_acknowledged_run_without_samples_is_lost() {
    let mut bench = bench();
    for command in ["C", "c,0,1,0,4", "f,64,0,0,1", "R"] {
        acknowledge(&mut bench, command);
    }
    bench.advance_ms(2_000);
    assert!(
        bench.complaints()[0].starts_with("no sample within 2s"),
        "{:?}",
        bench.complaints()
    );
}

#[test]
fn a_refused_setting_is_named_with_its_code() {
    let mut bench = bench();
    acknowledge(&mut bench, "C");
    acknowledge(&mut bench, "c,0,1,0,4");
    bench.advance_ms(100);
    bench.bytes(b"r,0,f,3\r\n").unwrap();
    assert_eq!(
        bench.complaints(),
        ["the sensor refused `f,64,0,0,1` with code 3"]
    );
}

#[test]
fn a_sensor_that_acknowledges_but_does_not_stop_is_lost() {
    let mut bench = bench();
    acknowledge(&mut bench, "C");
    feed(&mut bench, 0..900);
    assert!(
        bench.complaints()[0].contains("streams on"),
        "{:?}",
        bench.complaints()
    );
}

#[test]
fn a_stream_that_falls_silent_is_lost_and_set_up_again() {
    let mut bench = streaming();
    feed(&mut bench, 1..100);
    let silent = bench.advance_until(|bench| !bench.complaints().is_empty());
    assert_eq!(silent, Duration::from_millis(500));
    assert!(bench.complaints()[0].starts_with("no sample for 500ms"));
    for command in ["C", "c,0,1,0,4", "f,64,0,0,1", "R"] {
        acknowledge(&mut bench, command);
    }
    feed(&mut bench, 5_000..5_100);
    assert_eq!(bench.wrenches().len(), 200);
    // The pause is a loss of the stream, told as such, and no gap in it.
    assert_eq!(
        bench.device.counts(),
        Counts {
            received: 200,
            ..Counts::default()
        }
    );
}

#[test]
fn chunks_cut_anywhere_give_the_same_samples() {
    let mut stream = Vec::new();
    (0..40).for_each(|index| stream.extend(frame(index)));
    for size in [1, 7, 36, 37, 38, 64, 256] {
        let mut bench = listening();
        bench.advance_ms(1);
        for chunk in stream.chunks(size) {
            bench.bytes(chunk).unwrap();
        }
        let stamps: Vec<_> = bench
            .wrenches()
            .iter()
            .filter_map(|reading| reading.at.device_ns)
            .collect();
        assert_eq!(
            stamps,
            (0..40).map(|index| index * 1_250_000).collect::<Vec<i64>>(),
            "chunks of {size}"
        );
        assert_eq!(
            bench.device.counts(),
            Counts {
                received: 40,
                ..Counts::default()
            }
        );
    }
}

#[test]
fn one_flipped_bit_costs_one_frame() {
    let mut bench = streaming();
    feed(&mut bench, 1..50);
    let mut broken = frame(50);
    broken[10] ^= 0x40;
    assert!(matches!(
        bench.bytes(&broken),
        Err(DecodeError::Checksum { .. })
    ));
    bench.advance(Duration::from_micros(u64::from(PERIOD_US)));
    feed(&mut bench, 51..60);
    let counts = bench.device.counts();
    assert_eq!(
        (counts.received, counts.refused, counts.gaps, counts.skipped),
        (59, 1, 1, 37)
    );
}

#[test]
fn a_lock_needs_a_whole_frame_with_a_right_check_sum() {
    let mut bench = listening();
    bench.advance_ms(1);
    // The end of a frame, with a false header in it, then whole ones.
    let mut tail = frame(0)[15..].to_vec();
    tail[3] = wire::HEADER;
    bench.bytes(&tail).unwrap();
    assert_eq!(bench.wrenches(), []);
    bench.bytes(&[frame(1), frame(2)].concat()).unwrap();
    assert_eq!(bench.wrenches().len(), 2);
    assert_eq!(bench.device.counts().refused, 0);
}

#[test]
fn the_sensors_clock_unwraps() {
    let mut bench = listening();
    bench.advance_ms(1);
    let last = u32::MAX - 500;
    for timestamp_us in [last - PERIOD_US, last, last.wrapping_add(PERIOD_US)] {
        bench.advance(Duration::from_micros(PERIOD_US.into()));
        bench
            .bytes(&wire::encode(&Sample {
                timestamp_us,
                ..sample(0)
            }))
            .unwrap();
    }
    let stamps: Vec<_> = bench
        .wrenches()
        .iter()
        .filter_map(|reading| reading.at.device_ns)
        .collect();
    assert_eq!(
        stamps
            .windows(2)
            .map(|pair| pair[1] - pair[0])
            .collect::<Vec<_>>(),
        [1_250_000; 2]
    );
    assert_eq!(bench.complaints(), Vec::<String>::new());
}

#[test]
fn a_clock_that_begins_anew_is_told_and_followed() {
    let mut bench = streaming();
    feed(&mut bench, 1..5_000);
    bench.advance_ms(400);
    feed(&mut bench, 40..100);
    assert!(
        bench.complaints()[0].contains("it restarted"),
        "{:?}",
        bench.complaints()
    );
    assert_eq!(
        bench.wrenches().last().unwrap().at.device_ns,
        Some(99 * 1_250_000)
    );
    assert_eq!(bench.device.counts().gaps, 0);
}

#[test]
fn boot_text_tells_who_is_there_and_that_it_restarted() {
    let mut bench = streaming();
    let text = b"App Init\r\nname: BFT-SENS-SER-M8\r\nS/N: 000123\r\nFW version: 1.2.3\r\n";
    let _ = bench.bytes(text);
    let identity = Identity {
        model: "BFT-SENS-SER-M8".to_owned(),
        serial_number: "000123".to_owned(),
        firmware: "1.2.3".to_owned(),
    };
    assert!(
        bench.events().contains(&DeviceEvent::Identified(identity)),
        "{:?}",
        bench.events()
    );
    assert!(bench.complaints()[0].contains("the sensor restarted"));
    bench.advance_ms(1_000);
    assert_eq!(bench.take_sent(), b"C");
}

#[test]
fn status_bits_set_the_quality_and_warn_once_each() {
    let mut bench = streaming();
    for (index, bits) in [(1, 0), (2, 2), (3, 2), (4, 4), (5, 9)] {
        bench.advance(Duration::from_micros(PERIOD_US.into()));
        bench
            .bytes(&wire::encode(&Sample {
                status: Status(bits),
                ..sample(index)
            }))
            .unwrap();
    }
    use Quality::{Good, Invalid, Overrange};
    let qualities: Vec<_> = bench
        .wrenches()
        .iter()
        .map(|reading| reading.quality)
        .collect();
    assert_eq!(
        qualities,
        [Good, Good, Overrange, Overrange, Invalid, Invalid]
    );
    assert_eq!(bench.wrenches()[5].status_bits, 9);
    let complaints = bench.complaints();
    assert_eq!(complaints.len(), 4, "{complaints:?}");
    assert!(complaints[0].starts_with("status 0x0002") && complaints[1].contains("may be damaged"));
}

#[test]
fn the_sign_turns_on_request() {
    let config = Config {
        sign: Sign::ToolOnEnvironment,
        startup: Startup::Listen,
        ..Config::default()
    };
    let mut bench = Bench::new(BotaSerial::new(config));
    bench.advance_ms(1);
    bench.bytes(&frame(0)).unwrap();
    assert_eq!(
        bench.wrenches()[0].wrench.to_array(),
        [-1.0, 2.0, -3.5, -0.5, 0.25, -0.125]
    );
}

#[test]
fn a_listener_sends_nothing_and_tells_silence_once() {
    let mut bench = listening();
    bench.advance_ms(10_000);
    assert_eq!(bench.take_sent(), b"");
    assert_eq!(bench.complaints().len(), 1);
    bench.bytes(&frame(0)).unwrap();
    assert_eq!(bench.wrenches().len(), 1);
}

#[test]
fn a_listener_takes_a_set_up_by_others_for_a_pause_and_no_gap() {
    let mut bench = listening();
    bench.advance_ms(1);
    feed(&mut bench, 0..50);
    bench.bytes(b"r,0,C,0\r\n").unwrap();
    bench.advance_ms(125);
    bench.bytes(b"r,0,R,0\r\n").unwrap();
    feed(&mut bench, 150..200);
    let counts = bench.device.counts();
    assert_eq!(
        (counts.received, counts.gaps, bench.complaints().len()),
        (100, 0, 0)
    );
}

struct Ignore(Vec<Reading>);

impl Outlet<Chunk> for Ignore {
    fn frame(&mut self, _frame: &Chunk, _stamps: RxStamps) {}
    fn reading(&mut self, reading: Reading) {
        self.0.push(reading);
    }
}

/// Runs `frames` of a stream through a faulty link, one chunk each, and returns the counts and the faults.
fn through_faults(
    rates: FaultRates,
    seed: u64,
    frames: u32,
) -> (Counts, crate::link::faults::Injected) {
    let stamped = |index: u32| {
        let arrival =
            HostTime::from_nanos(i64::from(index) * i64::from(PERIOD_US) * 1_000 + 1_000_000_000);
        (Chunk::new(&frame(index)).unwrap(), RxStamps { arrival })
    };
    let clock = SteppedClock::new(HostTime::EPOCH);
    let replay = ReplayLink::new(clock.clone(), (0..frames).map(stamped));
    let device = BotaSerial::new(Config {
        startup: Startup::Listen,
        ..Config::default()
    });
    let mut pump = Pump::new(device, FaultyLink::new(replay, rates, seed));
    let mut outlet = Ignore(Vec::new());
    while pump.turn(&clock, HostTime::FAR_FUTURE, &mut outlet).is_ok() {}
    (pump.counts(), pump.link().injected())
}

#[test]
fn counted_loss_equals_injected_loss() {
    for seed in 1..=5 {
        let (counts, injected) = through_faults(
            FaultRates {
                loss: 0.02,
                ..FaultRates::default()
            },
            seed,
            20_000,
        );
        assert!(injected.lost > 300, "{injected:?}");
        assert_eq!(counts.gaps, injected.lost, "seed {seed}");
        assert_eq!(counts.received + injected.lost, 20_000);
        assert_eq!((counts.refused, counts.duplicated), (0, 0));
    }
}

#[test]
fn every_flipped_bit_is_one_refused_frame_and_one_gap() {
    let rates = FaultRates {
        bit_flip: 0.01,
        ..FaultRates::default()
    };
    let (counts, injected) = through_faults(rates, 6, 20_000);
    assert!(injected.flipped > 100, "{injected:?}");
    assert_eq!(counts.received + injected.flipped, 20_000);
    assert_eq!(counts.gaps, injected.flipped);
    // Two broken frames in a row are one search.
    assert!(
        counts.refused <= injected.flipped && counts.refused * 10 >= injected.flipped * 9,
        "{counts:?}"
    );
}

#[test]
fn duplicates_reordering_cuts_joins_and_stalls_lose_nothing() {
    let rates = FaultRates {
        duplication: 0.02,
        reordering: 0.02,
        stall: 0.001,
        stall_for: Duration::from_millis(40),
        ..FaultRates::default()
    };
    let (counts, injected) = through_faults(rates, 7, 20_000);
    assert!(
        injected.duplicated > 100 && injected.reordered > 100 && injected.stalls > 5,
        "{injected:?}"
    );
    assert_eq!(counts.received, 20_000);
    assert_eq!((counts.duplicated, counts.gaps), (injected.duplicated, 0));
    let rates = FaultRates {
        split: 0.3,
        merge: 0.3,
        ..FaultRates::default()
    };
    let (counts, injected) = through_faults(rates, 8, 20_000);
    assert!(
        injected.split > 1_000 && injected.merged > 1_000,
        "{injected:?}"
    );
    assert_eq!(
        counts,
        Counts {
            received: 20_000,
            ..Counts::default()
        }
    );
}

#[test]
fn a_faulty_link_sends_untouched() {
    let replay = ReplayLink::new(
        SteppedClock::new(HostTime::EPOCH),
        Vec::<(Chunk, RxStamps)>::new(),
    );
    let mut link = FaultyLink::new(
        replay,
        FaultRates {
            loss: 1.0,
            ..FaultRates::default()
        },
        1,
    );
    link.send(&Chunk::new(b"C").unwrap()).unwrap();
    assert_eq!(link.inner().sent(), 1);
}
