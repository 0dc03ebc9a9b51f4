//! Devices that stream: the frames are made, spoilt and played to a listening driver.

use std::time::Duration;

use ft_drivers::Device;
use ft_drivers::device::Counted;
use ft_drivers::link::faults::Spoil;
use ft_drivers::reading::Reading;
use ft_wire::HostTime;

use super::cases;
use super::run::{
    BURSTS, FAULTS, Fault, HITS, LONG_STALLS, Outcome, PULLS, Row, SAMPLES, START, Seeded, values,
};

/// Ticks of a device clock before its first sample, so that a restart is seen.
const FIRST_TICK: u64 = 20_000;

#[derive(Clone, Copy, PartialEq)]
enum Clocked {
    Yes,
    No,
}

#[derive(Clone, Copy, PartialEq)]
enum Check {
    /// The frames carry one.
    Sum,
    /// The bus has one, and keeps frames whole.
    Bus,
    /// None: steps are watched.
    Steps,
}

struct Case<D, F> {
    driver: &'static str,
    make: fn() -> D,
    sample: fn(usize, u64, bool) -> Vec<F>,
    clocked: Clocked,
    check: Check,
    overload: bool,
}

/// All cells of the streaming drivers.
pub(crate) fn rows() -> Vec<Row> {
    use Check::{Bus, Steps, Sum};
    use Clocked::{No, Yes};
    vec![
        row(&Case {
            driver: "bota_serial",
            make: cases::bota,
            sample: cases::bota_sample,
            clocked: Yes,
            check: Sum,
            overload: true,
        }),
        row(&Case {
            driver: "robotous_can",
            make: cases::rft_can,
            sample: cases::rft_can_sample,
            clocked: No,
            check: Bus,
            overload: true,
        }),
        row(&Case {
            driver: "robotous_uart",
            make: cases::rft_uart,
            sample: cases::rft_uart_sample,
            clocked: No,
            check: Sum,
            overload: true,
        }),
        row(&Case {
            driver: "optoforce_serial",
            make: cases::hex_serial,
            sample: cases::hex_serial_sample,
            clocked: Yes,
            check: Sum,
            overload: true,
        }),
        row(&Case {
            driver: "optoforce_can",
            make: cases::hex_can,
            sample: cases::hex_can_sample,
            clocked: Yes,
            check: Sum,
            overload: true,
        }),
        row(&Case {
            driver: "leptrino",
            make: cases::leptrino,
            sample: cases::leptrino_sample,
            clocked: No,
            check: Sum,
            overload: true,
        }),
        row(&Case {
            driver: "kunwei_kwr75",
            make: cases::kwr75,
            sample: cases::kwr75_sample,
            clocked: No,
            check: Steps,
            overload: false,
        }),
        row(&Case {
            driver: "encoder_line",
            make: cases::encoder,
            sample: cases::encoder_sample,
            clocked: Yes,
            check: Sum,
            overload: false,
        }),
        row(&Case {
            driver: "pose_stream",
            make: cases::pose,
            sample: cases::pose_sample,
            clocked: Yes,
            check: Sum,
            overload: false,
        }),
        row(&Case {
            driver: "hid_axis",
            make: cases::hid,
            sample: cases::hid_sample,
            clocked: No,
            check: Bus,
            overload: false,
        }),
    ]
}

fn row<D, F>(case: &Case<D, F>) -> Row
where
    D: Device<Frame = F, Reading = Reading> + Counted,
    F: Spoil,
{
    let mut clean = Outcome::default();
    clean.play(
        (case.make)(),
        stream(case, 0..SAMPLES, |index| FIRST_TICK + index as u64),
    );
    let sent: Vec<Vec<f64>> = clean
        .readings
        .iter()
        .filter_map(values)
        .map(|(sample, _)| sample)
        .collect();
    assert_eq!(
        sent.len(),
        SAMPLES,
        "{}: without faults every sample comes",
        case.driver
    );
    assert!(clean.samples().iter().all(|(_, good)| *good));
    let cells = (0_u64..)
        .zip(FAULTS)
        .map(|(seed, fault)| cell(case, fault, &sent, seed))
        .collect();
    Row {
        driver: case.driver,
        cells,
    }
}

fn stream<D, F>(
    case: &Case<D, F>,
    samples: impl Iterator<Item = usize>,
    ticks: impl Fn(usize) -> u64,
) -> Vec<(F, HostTime)> {
    samples
        .flat_map(|index| stamped((case.sample)(index, ticks(index), false), index))
        .collect()
}

/// The frames of a sample with their arrivals: a sample every millisecond, its frames 0.1 ms apart.
fn stamped<F>(frames: Vec<F>, index: usize) -> Vec<(F, HostTime)> {
    let at = START + Duration::from_millis(10 + index as u64);
    (0_u32..)
        .zip(frames)
        .map(|(frame, content)| (content, at + Duration::from_micros(100) * frame))
        .collect()
}

fn cell<D, F>(case: &Case<D, F>, fault: Fault, sent: &[Vec<f64>], seed: u64) -> String
where
    D: Device<Frame = F, Reading = Reading> + Counted,
    F: Spoil,
{
    let what = format!("{}, {}", case.driver, fault.name());
    let many = (case.sample)(0, 0, false).len() > 1;
    let mut random = Seeded(seed);
    let hits = random.hits();
    let mut out = Outcome::default();
    match fault {
        Fault::Overload if !case.overload => return "-".to_owned(),
        Fault::ClockJump if case.clocked == Clocked::No => return "-".to_owned(),
        Fault::Corrupted if case.check == Check::Bus => return "bus".to_owned(),
        Fault::Merged | Fault::Split if many || case.check == Check::Bus => {
            return "bus".to_owned();
        }
        Fault::Unplugged => {
            // Pulled in the middle of a frame, and back 50 samples later.
            let mut back = 0;
            for pull in 1..=PULLS {
                let pulled = pull * SAMPLES / (PULLS + 1);
                let mut before = stream(case, back..pulled, |index| FIRST_TICK + index as u64);
                if let Some((half, at)) = before.pop() {
                    before.extend(half.split(half.bits() / 16).map(|(first, _)| (first, at)));
                }
                out.play((case.make)(), before);
                back = pulled + 50;
            }
            out.play(
                (case.make)(),
                stream(case, back..SAMPLES, |index| FIRST_TICK + index as u64),
            );
        }
        Fault::Burst => {
            let frames = stream(case, 0..SAMPLES, |index| FIRST_TICK + index as u64);
            let per_sample = frames.len() / SAMPLES;
            let bursts = random.bursts(per_sample);
            let taken = |frame: usize| bursts.iter().any(|burst| burst.contains(&frame));
            let left = frames.into_iter().enumerate();
            let left = left.filter(|(frame, _)| !taken(*frame));
            out.play((case.make)(), left.map(|(_, frame)| frame).collect());
            out.assert_good_is_true(sent, &[1e-9; 7], &what);
            return judge_bursts(case, &bursts, per_sample, &out, &what);
        }
        Fault::LongStall => {
            let mut frames = stream(case, 0..SAMPLES, |index| FIRST_TICK + index as u64);
            for (index, stall_ms) in LONG_STALLS {
                let begin = START + Duration::from_millis(10 + index as u64);
                let end = begin + Duration::from_millis(stall_ms);
                let late = frames.iter_mut().filter(|(_, at)| *at >= begin);
                late.for_each(|(_, at)| *at = (*at).max(end));
            }
            out.play((case.make)(), frames);
        }
        Fault::Restarted => {
            // Silent for 300 ms, then from the beginning of its clock.
            let frames = stream(case, (0..1_000).chain(1_300..SAMPLES), |index| {
                if index < 1_000 {
                    FIRST_TICK + index as u64
                } else {
                    index as u64 - 1_300
                }
            });
            out.play((case.make)(), frames);
        }
        Fault::ClockJump => {
            let frames = stream(case, 0..SAMPLES, |index| {
                FIRST_TICK + index as u64 + if index < 1_000 { 0 } else { 10_000 }
            });
            out.play((case.make)(), frames);
        }
        _ => {
            let frames = spoilt(case, fault, &hits, &mut random);
            out.play((case.make)(), frames);
        }
    }
    let tolerance = if fault == Fault::Corrupted && case.check == Check::Steps {
        // What the limits of a step let through, by the motion of one sample more.
        vec![20.5, 20.5, 20.5, 2.05, 2.05, 2.05]
    } else {
        vec![1e-9; 7]
    };
    out.assert_good_is_true(sent, &tolerance, &what);
    judge(case, fault, &out, many, &what)
}

/// The frames with `fault` at each of `hits`.
fn spoilt<D, F: Spoil>(
    case: &Case<D, F>,
    fault: Fault,
    hits: &[usize],
    random: &mut Seeded,
) -> Vec<(F, HostTime)> {
    let mut all = Vec::new();
    let mut held: Vec<(F, HostTime)> = Vec::new();
    let mut stalled_until = START;
    for index in 0..SAMPLES {
        let hit = hits.contains(&index);
        let overload = hit && fault == Fault::Overload;
        let mut frames = stamped(
            (case.sample)(index, FIRST_TICK + index as u64, overload),
            index,
        );
        let victim = random.below(frames.len());
        match fault {
            Fault::Lost if hit => {
                frames.remove(victim);
            }
            Fault::Duplicated if hit => {
                let twice = frames[victim].clone();
                frames.insert(victim, twice);
            }
            Fault::Corrupted if hit => {
                let bit = random.below(frames[victim].0.bits());
                frames[victim].0 = frames[victim].0.with_flipped(bit);
            }
            Fault::Split if hit => {
                let (frame, at) = frames.remove(0);
                let bytes = frame.bits() / 8;
                let (first, second) = frame.split(1 + random.below(bytes - 1)).unwrap();
                frames = vec![(first, at), (second, at)];
            }
            Fault::Merged if hit => held.append(&mut frames),
            Fault::Merged if !held.is_empty() => {
                let (first, _) = held.remove(0);
                let (second, at) = frames.remove(0);
                frames = vec![(first.merge(&second).unwrap(), at)];
            }
            Fault::Reordered if hit => held.extend(frames.pop()),
            Fault::Reordered if !held.is_empty() => {
                // The first frame of this sample overtakes the last one of the sample before.
                let at = frames[0].1;
                frames.splice(1..1, held.drain(..).map(|(frame, _)| (frame, at)));
            }
            Fault::Stalled if hit => stalled_until = frames[0].1 + Duration::from_millis(8),
            _ => {}
        }
        for (_, at) in &mut frames {
            *at = (*at).max(stalled_until);
        }
        all.append(&mut frames);
    }
    all
}

/// What the counters show, as a cell.
fn judge<D, F>(case: &Case<D, F>, fault: Fault, out: &Outcome, many: bool, what: &str) -> String {
    let counts = out.counts;
    let (all, hits) = (SAMPLES as u64, HITS as u64);
    let delivered = out.samples().len() as u64;
    assert_eq!(delivered, counts.received, "{what}: {counts:?}");
    let counted = |seen: u64| {
        assert_eq!(seen, hits, "{what}: {counts:?}");
        format!("{seen}/{hits}")
    };
    let kept = || {
        let lost = (
            counts.gaps,
            counts.refused,
            counts.duplicated,
            counts.skipped,
        );
        assert_eq!((delivered, lost), (all, (0, 0, 0, 0)), "{what}");
        "kept".to_owned()
    };
    match fault {
        Fault::Lost if case.clocked == Clocked::Yes => {
            assert_eq!(delivered + counts.gaps, all, "{what}: {counts:?}");
            counted(counts.gaps)
        }
        // A lost second half costs the sample behind it too: nobody can tell whose the next half is.
        Fault::Lost if many => {
            let orphans = counts.skipped - counts.refused / 2;
            assert_eq!(
                delivered + counts.refused + orphans,
                all,
                "{what}: {counts:?}"
            );
            counted(counts.refused / 2 + orphans)
        }
        Fault::Lost => {
            assert_eq!(delivered + hits, all, "{what}: {counts:?}");
            "blind".to_owned()
        }
        Fault::Duplicated if many && case.clocked == Clocked::Yes => {
            // The first payload twice is refused once, the last one skipped; the one between breaks its packet, which is
            // refused, a gap, and one payload skipped.
            assert_eq!(delivered + counts.gaps, all, "{what}: {counts:?}");
            counted(counts.refused + counts.skipped - counts.gaps)
        }
        Fault::Duplicated if many => {
            assert_eq!(delivered, all, "{what}: {counts:?}");
            counted(counts.skipped)
        }
        Fault::Duplicated if case.clocked == Clocked::Yes => {
            assert_eq!(delivered, all, "{what}: {counts:?}");
            counted(counts.duplicated)
        }
        Fault::Duplicated => {
            assert_eq!(delivered, all + hits, "{what}: {counts:?}");
            "blind".to_owned()
        }
        Fault::Reordered if many => {
            // Both samples that met are lost, and counted.
            assert_eq!(delivered + 2 * hits, all, "{what}: {counts:?}");
            assert!(counts.refused >= 2 * hits, "{what}: {counts:?}");
            counted((all - delivered) / 2)
        }
        Fault::Reordered => kept(),
        Fault::Corrupted if case.check == Check::Steps => {
            let marked = out.samples().iter().filter(|(_, good)| !good).count() as u64;
            assert_eq!(delivered + counts.refused, all, "{what}: {counts:?}");
            format!("{}/{hits}", marked + counts.refused)
        }
        Fault::Corrupted => {
            assert_eq!(delivered + hits, all, "{what}: {counts:?}");
            if case.clocked == Clocked::Yes {
                assert_eq!(counts.gaps, hits, "{what}: {counts:?}");
            }
            // A spoilt header begins no packet: its three payloads are skipped.
            counted(counts.refused + if many { counts.skipped / 3 } else { 0 })
        }
        Fault::Merged | Fault::Split | Fault::Stalled => kept(),
        Fault::ClockJump => {
            assert_eq!((delivered, counts.gaps), (all, 0), "{what}: {counts:?}");
            told(out, what)
        }
        Fault::Unplugged => {
            // The samples in the middle of which the plug was pulled, and the 50 until it was back.
            assert_eq!(
                (delivered, counts.gaps),
                (all - 51 * PULLS as u64, 0),
                "{what}: {counts:?}"
            );
            // The last link ends with the stream.
            let pulled = out.gone - 1;
            assert_eq!(pulled, PULLS, "{what}");
            "kept".to_owned()
        }
        Fault::LongStall => {
            let cell = kept();
            // A device that only tells changes may be silent.
            if out.losses() == 0 {
                return cell;
            }
            let (losses, stalls) = (out.losses(), LONG_STALLS.len());
            assert_eq!((losses, warnings(out)), (stalls, 0), "{what}");
            format!("{losses}/{stalls}")
        }
        Fault::Restarted => {
            assert_eq!(
                (delivered, counts.gaps),
                (all - 300, 0),
                "{what}: {counts:?}"
            );
            if case.clocked == Clocked::No {
                return "blind".to_owned();
            }
            told(out, what)
        }
        Fault::Overload => {
            assert_eq!(delivered, all, "{what}: {counts:?}");
            counted(out.samples().iter().filter(|(_, good)| !good).count() as u64)
        }
        Fault::Burst => unreachable!("judged by its frames"),
    }
}

/// One warning, of the one thing that happened.
fn told(out: &Outcome, what: &str) -> String {
    let warnings = warnings(out);
    assert_eq!(warnings, 1, "{what}");
    format!("{warnings}/1")
}

/// What the counters show of bursts, as a cell: samples, or for a sensor without a clock the bursts that left a trace.
fn judge_bursts<D, F>(
    case: &Case<D, F>,
    bursts: &[core::ops::Range<usize>],
    per_sample: usize,
    out: &Outcome,
    what: &str,
) -> String {
    let (counts, all) = (out.counts, SAMPLES as u64);
    let samples = |burst: &core::ops::Range<usize>| {
        (burst.end - 1) / per_sample - burst.start / per_sample + 1
    };
    let hit: u64 = bursts.iter().map(|burst| samples(burst) as u64).sum();
    let delivered = out.samples().len() as u64;
    assert_eq!(delivered, counts.received, "{what}: {counts:?}");
    if case.clocked == Clocked::Yes {
        assert_eq!(
            (counts.gaps, delivered),
            (hit, all - hit),
            "{what}: {counts:?}"
        );
        return format!("{}/{hit}", counts.gaps);
    }
    if per_sample == 1 {
        assert_eq!(delivered, all - hit, "{what}: {counts:?}");
        return "blind".to_owned();
    }
    // Pairs: what is left of the sample that a burst begins or ends in is found out and counted, once as lost or as skipped.
    let (mut refused, mut skipped, mut more, mut traced) = (0, 0, 0, 0);
    for burst in bursts {
        let apart = (burst.end / 2 - burst.start / 2) as u64;
        traced += usize::from(burst.start % 2 == 1 || burst.end % 2 == 1);
        match (burst.start % 2, burst.end % 2) {
            // Both halves that are left might be of one sample, or are too far apart for that.
            (1, 1) if apart < 5 => refused += 2,
            (1, 1) => (refused, skipped) = (refused + 1, skipped + 1),
            // A first half behind a first half: nobody can tell whose the next second half is.
            (1, 0) if apart <= 5 => (refused, skipped, more) = (refused + 2, skipped + 1, more + 1),
            (1, 0) => refused += 1,
            (0, 1) => skipped += 1,
            _ => {}
        }
    }
    assert_eq!(
        (delivered, counts.refused, counts.skipped),
        (all - hit - more, refused, skipped),
        "{what}"
    );
    format!("{traced}/{BURSTS}")
}

fn warnings(out: &Outcome) -> usize {
    use ft_drivers::reading::DeviceEvent;
    let warned = |reading: &&Reading| {
        matches!(
            reading,
            Reading::Event {
                event: DeviceEvent::Warning { .. },
                ..
            }
        )
    };
    out.readings.iter().filter(warned).count()
}
