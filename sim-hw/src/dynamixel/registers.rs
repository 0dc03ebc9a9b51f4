//! The control table of an XM430, as far as an encoder needs it.

use super::Fault;

const SIZE: usize = 147;
const MODEL: u16 = 1020;
const FIRMWARE: u8 = 0x2D;

const BAUD: usize = 8;
const RETURN_DELAY: usize = 9;
const ID: usize = 7;
const TORQUE_ENABLE: usize = 64;
const PRESENT_CURRENT: usize = 126;
const PRESENT_VELOCITY: usize = 128;
const PRESENT_POSITION: usize = 132;

/// Where writing is allowed: address and size. Below 64 only with the torque off.
const WRITABLE: [(usize, usize); 19] = [
    (ID, 1),
    (BAUD, 1),
    (RETURN_DELAY, 1),
    (10, 1),
    (11, 1),
    (20, 4),
    (24, 4),
    (31, 1),
    (36, 2),
    (38, 2),
    (48, 4),
    (52, 4),
    (TORQUE_ENABLE, 1),
    (65, 1),
    (68, 1),
    (102, 2),
    (108, 4),
    (112, 4),
    (116, 4),
];

#[derive(Clone, Debug)]
pub(super) struct Registers {
    table: [u8; SIZE],
}

impl Registers {
    pub(super) fn new(id: u8, baud_code: u8) -> Self {
        let mut registers = Self { table: [0; SIZE] };
        registers.put(0, &MODEL.to_le_bytes());
        registers.put(6, &[FIRMWARE, id, baud_code, 250]);
        registers.put(11, &[3]);
        registers.put(31, &[80]);
        registers.put(36, &885_u16.to_le_bytes());
        registers.put(38, &1193_u16.to_le_bytes());
        registers.put(48, &4095_u32.to_le_bytes());
        registers.put(68, &[2]);
        registers.put(144, &120_u16.to_le_bytes());
        registers.put(146, &[34]);
        registers
    }

    fn put(&mut self, address: usize, bytes: &[u8]) {
        self.table[address..address + bytes.len()].copy_from_slice(bytes);
    }

    pub(super) fn present(&mut self, position: i32, velocity: i32, current: i16) {
        self.put(PRESENT_CURRENT, &current.to_le_bytes());
        self.put(PRESENT_VELOCITY, &velocity.to_le_bytes());
        self.put(PRESENT_POSITION, &position.to_le_bytes());
    }

    pub(super) fn id(&self) -> u8 {
        self.table[ID]
    }

    pub(super) fn baud_code(&self) -> u8 {
        self.table[BAUD]
    }

    pub(super) fn return_delay_ns(&self) -> i64 {
        2000 * i64::from(self.table[RETURN_DELAY])
    }

    /// Model number and firmware, as a ping answers.
    pub(super) fn identity(&self) -> [u8; 3] {
        let [low, high] = MODEL.to_le_bytes();
        [low, high, FIRMWARE]
    }

    pub(super) fn read(&self, address: u16, length: u16) -> Result<Vec<u8>, Fault> {
        let start = usize::from(address);
        let bytes = self
            .table
            .get(start..start + usize::from(length))
            .filter(|bytes| !bytes.is_empty());
        bytes.map(<[u8]>::to_vec).ok_or(Fault::DataRange)
    }

    pub(super) fn write(&mut self, address: u16, data: &[u8]) -> Result<(), Fault> {
        let start = usize::from(address);
        let Some((_, size)) = WRITABLE.iter().find(|(writable, _)| *writable == start) else {
            return Err(Fault::Access);
        };
        if data.len() != *size {
            return Err(Fault::DataLength);
        }
        if start < TORQUE_ENABLE && self.table[TORQUE_ENABLE] != 0 {
            return Err(Fault::Access);
        }
        let in_range = match (start, data) {
            (ID, [id]) => (0..=252).contains(id),
            (BAUD, [code]) => *code <= 6,
            (RETURN_DELAY, [delay]) => *delay <= 254,
            (TORQUE_ENABLE, [enable]) => *enable <= 1,
            _ => true,
        };
        if !in_range {
            return Err(Fault::DataRange);
        }
        self.put(start, data);
        Ok(())
    }
}
