//! Dynamixel XM430 with protocol 2.0, played as the gripper's encoder: ping, read, write, sync read.
//!
//! Instruction: `FF FF FD 00` id length(2) instruction parameters crc(2); length = parameters + 3. Status: the same with 0x55, an
//! error byte and length = parameters + 4. After `FF FF FD` inside, an extra `FD` is stuffed. CRC-16, polynomial 0x8005.
//!
//! # Source
//! emanual.robotis.com, protocol 2.0 and XM430-W350; `ROBOTIS-GIT/DynamixelSDK`. Baud codes are not confirmed from a source.

mod packet;
mod registers;

use ft_wire::Chunk;

use self::packet::{Instruction, Scanned};
use self::registers::Registers;
use crate::clock::SimNanos;
use crate::device::{Outbox, Played, push_bytes, seconds};
use crate::jaw;
use crate::random::Random;
use crate::scenario::GripperSpec;
use crate::scene::Scene;

const PING: u8 = 0x01;
const READ: u8 = 0x02;
const WRITE: u8 = 0x03;
const SYNC_READ: u8 = 0x82;
const BROADCAST: u8 = 0xFE;

const BAUDS: [u32; 7] = [
    9600, 57_600, 115_200, 1_000_000, 2_000_000, 3_000_000, 4_000_000,
];
/// The rates of [`BAUDS`], for people.
pub(crate) const BAUDS_TEXT: &str =
    "one of 9600, 57600, 115200, 1000000, 2000000, 3000000, 4000000";

/// The code of a line rate.
pub(crate) fn baud_code(baud_bps: u32) -> Option<u8> {
    BAUDS
        .iter()
        .position(|baud| *baud == baud_bps)
        .map(|code| code as u8)
}

/// Error numbers of a status packet.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub(crate) enum Fault {
    Instruction = 2,
    Crc = 3,
    DataRange = 4,
    DataLength = 5,
    Access = 7,
}

#[derive(Debug)]
pub(crate) struct Dynamixel {
    registers: Registers,
    jitter_m: f64,
    random: Random,
    inbox: Vec<u8>,
}

impl Dynamixel {
    pub(crate) fn new(spec: &GripperSpec, random: Random) -> Self {
        let registers = Registers::new(spec.id, baud_code(spec.baud_bps).unwrap_or(1));
        Self {
            registers,
            jitter_m: spec.jitter_m,
            random,
            inbox: Vec::new(),
        }
    }

    /// Puts what the shaft does at `at` into the registers.
    fn sense(&mut self, at: SimNanos, scene: &Scene) {
        let t = seconds(at);
        let (width, rate) = scene.jaw(t);
        let seen = width + self.jitter_m * self.random.normal();
        let position = jaw::shaft_degrees(seen) * 4096.0 / 360.0;
        let rpm = jaw::shaft_degrees_per_second(width, rate) / 6.0;
        let current = if scene.holds(t) { 74.0 } else { 0.0 } + 2.0 * self.random.normal();
        self.registers.present(
            position.round() as i32,
            (rpm / 0.229).round() as i32,
            current.round() as i16,
        );
    }

    fn answer(&mut self, instruction: &Instruction) -> Option<Vec<u8>> {
        let id = self.registers.id();
        let parameters = instruction.parameters.as_slice();
        let result = match instruction.code {
            PING => Ok(self.registers.identity().to_vec()),
            SYNC_READ => {
                let [address_low, address_high, length_low, length_high, ids @ ..] = parameters
                else {
                    return None;
                };
                if !ids.contains(&id) {
                    return None;
                }
                self.read(&[*address_low, *address_high, *length_low, *length_high])
            }
            _ if instruction.id == BROADCAST => {
                if instruction.code == WRITE {
                    let _ = self.write(parameters);
                }
                return None;
            }
            READ => self.read(parameters),
            WRITE => self.write(parameters).map(|()| Vec::new()),
            _ => Err(Fault::Instruction),
        };
        Some(packet::status(id, result))
    }

    fn read(&self, parameters: &[u8]) -> Result<Vec<u8>, Fault> {
        let &[address_low, address_high, length_low, length_high] = parameters else {
            return Err(Fault::DataLength);
        };
        let address = u16::from_le_bytes([address_low, address_high]);
        self.registers
            .read(address, u16::from_le_bytes([length_low, length_high]))
    }

    fn write(&mut self, parameters: &[u8]) -> Result<(), Fault> {
        let [address_low, address_high, data @ ..] = parameters else {
            return Err(Fault::DataLength);
        };
        self.registers
            .write(u16::from_le_bytes([*address_low, *address_high]), data)
    }
}

impl Played<Chunk> for Dynamixel {
    fn next_event(&self) -> Option<SimNanos> {
        None
    }

    fn run(&mut self, _at: SimNanos, _scene: &Scene, _out: &mut Outbox<Chunk>) {}

    fn receive(&mut self, at: SimNanos, frame: &Chunk, scene: &Scene, out: &mut Outbox<Chunk>) {
        self.inbox.extend(frame.as_slice());
        loop {
            let instruction = match packet::scan(&mut self.inbox) {
                Scanned::More => return,
                Scanned::Whole(instruction) => instruction,
                Scanned::BadCrc { id } => {
                    if id == self.registers.id() {
                        push_bytes(out, at, &packet::status(id, Err(Fault::Crc)));
                    }
                    continue;
                }
            };
            if instruction.id != self.registers.id() && instruction.id != BROADCAST {
                continue;
            }
            self.sense(at, scene);
            let delay = self.registers.return_delay_ns();
            if let Some(status) = self.answer(&instruction) {
                push_bytes(out, at + delay, &status);
            }
        }
    }

    fn line_rate(&self) -> Option<u32> {
        Some(BAUDS[usize::from(self.registers.baud_code()).min(6)])
    }
}

#[cfg(test)]
mod tests;
