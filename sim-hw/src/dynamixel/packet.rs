//! Packets of protocol 2.0: header search, stuffing, CRC.

use super::Fault;
use crate::crc;

const HEADER: [u8; 3] = [0xFF, 0xFF, 0xFD];
/// The longest instruction that this device takes, from id to CRC.
const LONGEST: usize = 256;

#[derive(Clone, Debug, PartialEq)]
pub(super) struct Instruction {
    pub(super) id: u8,
    pub(super) code: u8,
    pub(super) parameters: Vec<u8>,
}

#[derive(Clone, Debug, PartialEq)]
pub(super) enum Scanned {
    More,
    Whole(Instruction),
    BadCrc { id: u8 },
}

/// Takes the next packet off `inbox`, and what stood before it.
pub(super) fn scan(inbox: &mut Vec<u8>) -> Scanned {
    loop {
        let start = inbox
            .windows(3)
            .position(|window| window == HEADER)
            .unwrap_or(inbox.len().saturating_sub(2));
        inbox.drain(..start);
        let [_, _, _, reserved, id, length_low, length_high, ..] = inbox[..] else {
            return Scanned::More;
        };
        let length = usize::from(u16::from_le_bytes([length_low, length_high]));
        if reserved == 0xFD || !(3..=LONGEST).contains(&length) {
            inbox.drain(..3);
            continue;
        }
        let whole = 7 + length;
        if inbox.len() < whole {
            return Scanned::More;
        }
        let packet: Vec<u8> = inbox.drain(..whole).collect();
        let (body, check) = packet.split_at(whole - 2);
        if crc::dynamixel(body).to_le_bytes() != check {
            return Scanned::BadCrc { id };
        }
        let mut content = unstuffed(&body[7..]);
        let code = content.remove(0);
        return Scanned::Whole(Instruction {
            id,
            code,
            parameters: content,
        });
    }
}

/// A status packet from `id`: the parameters read, or the fault.
pub(super) fn status(id: u8, result: Result<Vec<u8>, Fault>) -> Vec<u8> {
    let (error, parameters) = match result {
        Ok(parameters) => (0, parameters),
        Err(fault) => (fault as u8, Vec::new()),
    };
    let mut content = vec![0x55, error];
    content.extend(parameters);
    let content = stuffed(&content);
    let length = u16::try_from(content.len() + 2).unwrap_or(u16::MAX);
    let mut packet = vec![0xFF, 0xFF, 0xFD, 0x00, id];
    packet.extend(length.to_le_bytes());
    packet.extend(content);
    let check = crc::dynamixel(&packet);
    packet.extend(check.to_le_bytes());
    packet
}

fn stuffed(content: &[u8]) -> Vec<u8> {
    let mut out = Vec::with_capacity(content.len() + 4);
    for byte in content {
        out.push(*byte);
        if out.ends_with(&HEADER) {
            out.push(0xFD);
        }
    }
    out
}

fn unstuffed(content: &[u8]) -> Vec<u8> {
    let mut out: Vec<u8> = Vec::with_capacity(content.len());
    let mut skip = false;
    for byte in content {
        if skip && *byte == 0xFD {
            skip = false;
            continue;
        }
        out.push(*byte);
        skip = out.ends_with(&HEADER);
    }
    out
}
