use super::*;
use crate::clock::SteppedClock;
use crate::link::replay::ReplayLink;

/// Delivers 1000 one-byte-pair chunks, one per ms, through the faults, and returns what came.
fn run(rates: FaultRates, seed: u64) -> (Vec<(Chunk, HostTime)>, Injected) {
    let frames = (0..1_000_u16).map(|index| {
        let arrival = HostTime::from_nanos((i64::from(index) + 1) * 1_000_000);
        (
            Chunk::new(&index.to_be_bytes()).unwrap(),
            RxStamps { arrival },
        )
    });
    let mut link = FaultyLink::new(
        ReplayLink::new(SteppedClock::new(HostTime::EPOCH), frames),
        rates,
        seed,
    );
    let mut came = Vec::new();
    while let Ok(Some((chunk, stamps))) = link.recv(HostTime::FAR_FUTURE) {
        came.push((chunk, stamps.arrival));
    }
    (came, link.injected())
}

fn bytes(came: &[(Chunk, HostTime)]) -> Vec<u8> {
    came.iter()
        .flat_map(|(chunk, _)| chunk.as_slice().to_vec())
        .collect()
}

fn untouched() -> Vec<u8> {
    (0..1_000_u16).flat_map(u16::to_be_bytes).collect()
}

const NONE: FaultRates = FaultRates {
    loss: 0.0,
    duplication: 0.0,
    reordering: 0.0,
    bit_flip: 0.0,
    split: 0.0,
    merge: 0.0,
    stall: 0.0,
    stall_for: Duration::ZERO,
};

#[test]
fn no_faults_change_nothing() {
    let (came, injected) = run(NONE, 1);
    assert_eq!((bytes(&came), injected), (untouched(), Injected::default()));
}

#[test]
fn each_fault_is_counted_and_does_what_it_says() {
    let (came, injected) = run(FaultRates { loss: 0.1, ..NONE }, 1);
    assert_eq!(came.len() as u64 + injected.lost, 1_000);
    let (came, injected) = run(
        FaultRates {
            duplication: 0.1,
            ..NONE
        },
        2,
    );
    assert_eq!(came.len() as u64, 1_000 + injected.duplicated);
    let (came, injected) = run(
        FaultRates {
            bit_flip: 0.1,
            ..NONE
        },
        3,
    );
    let flipped: u32 = bytes(&came)
        .iter()
        .zip(untouched())
        .map(|(a, b)| (a ^ b).count_ones())
        .sum();
    assert_eq!(u64::from(flipped), injected.flipped);
    let (came, injected) = run(
        FaultRates {
            reordering: 0.1,
            ..NONE
        },
        4,
    );
    let backwards = came
        .windows(2)
        .filter(|pair| pair[1].0.as_slice() < pair[0].0.as_slice())
        .count();
    assert_eq!(backwards as u64, injected.reordered);
    let (came, injected) = run(
        FaultRates {
            split: 0.5,
            merge: 0.5,
            ..NONE
        },
        5,
    );
    assert_eq!(bytes(&came), untouched());
    assert_eq!(came.len() as u64, 1_000 + injected.split - injected.merged);
    let all = [injected.split, injected.merged];
    assert!(all.into_iter().all(|count| count > 50), "{injected:?}");
}

#[test]
fn a_stall_delays_and_then_delivers_all_in_order() {
    let (came, injected) = run(
        FaultRates {
            stall: 0.01,
            stall_for: Duration::from_millis(20),
            ..NONE
        },
        6,
    );
    assert_eq!(bytes(&came), untouched());
    assert!(injected.stalls > 3, "{injected:?}");
    let late = came
        .iter()
        .zip(1_i64..)
        .map(|((_, at), due)| at.as_nanos() - due * 1_000_000);
    assert_eq!(late.max(), Some(20_000_000));
    assert!(came.windows(2).all(|pair| pair[0].1 <= pair[1].1));
}

#[test]
fn a_stalled_frame_does_not_come_before_its_time() {
    let frame = (
        Chunk::new(&[1]).unwrap(),
        RxStamps {
            arrival: HostTime::from_nanos(10),
        },
    );
    let replay = ReplayLink::new(
        SteppedClock::new(HostTime::EPOCH),
        [
            frame,
            (
                frame.0,
                RxStamps {
                    arrival: HostTime::from_nanos(900),
                },
            ),
        ],
    );
    let rates = FaultRates {
        stall: 1.0,
        stall_for: Duration::from_nanos(100),
        ..NONE
    };
    let mut link = FaultyLink::new(replay, rates, 1);
    assert_eq!(link.recv(HostTime::from_nanos(50)).unwrap(), None);
    let (_, stamps) = link.recv(HostTime::from_nanos(500)).unwrap().unwrap();
    assert_eq!(stamps.arrival, HostTime::from_nanos(110));
}

#[test]
fn the_same_seed_does_the_same() {
    let rates = FaultRates {
        loss: 0.1,
        bit_flip: 0.1,
        split: 0.1,
        merge: 0.1,
        ..NONE
    };
    assert_eq!(run(rates, 9), run(rates, 9));
    assert_ne!(run(rates, 9).1, run(rates, 10).1);
}

#[test]
fn a_can_frame_is_flipped_but_neither_cut_nor_joined() {
    let frame = CanFrame::extended(0x1234, &[0, 0]).unwrap();
    assert_eq!(
        frame.with_flipped(9),
        CanFrame::extended(0x1234, &[0, 2]).unwrap()
    );
    assert_eq!(
        (frame.bits(), frame.split(1), frame.merge(&frame)),
        (16, None, None)
    );
}
