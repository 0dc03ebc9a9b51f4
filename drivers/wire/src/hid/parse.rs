//! Report descriptors: items to axes.

use super::{Axis, MAX_DESCRIPTOR, MAX_REPORT, Motion, Usage};
use crate::error::DecodeError;

const GENERIC_DESKTOP: u32 = 1;
/// Deepest stack of global items.
const MAX_PUSHES: usize = 16;
/// Most usages in front of one main item.
const MAX_USAGES: usize = 256;
/// Most different report ids that are told apart.
const MAX_IDS: usize = 32;

/// Items that stay until they are set again.
#[derive(Clone, Copy, Default)]
struct Globals {
    page: u32,
    logical: (i32, i32),
    physical: (i32, i32),
    exponent: i8,
    unit: u32,
    size: u32,
    count: u32,
    report_id: Option<u8>,
}

/// Items that hold for one main item.
#[derive(Default)]
struct Locals {
    /// Page and usage.
    usages: Vec<(u32, u32)>,
    minimum: Option<(u32, u32)>,
}

#[derive(Default)]
struct Parser {
    globals: Globals,
    pushed: Vec<Globals>,
    locals: Locals,
    /// Bits of the input report of each id so far.
    lengths: Vec<(Option<u8>, usize)>,
    axes: Vec<Axis>,
    collections: usize,
}

fn refuse<T>(name: &'static str, value: u32) -> Result<T, DecodeError> {
    Err(DecodeError::Field { name, value })
}

/// The axes of the Generic Desktop page that a report descriptor declares, in the order of the descriptor.
///
/// # Errors
/// The descriptor is cut off, unbalanced, or asks for more than any device needs: longer than [`MAX_DESCRIPTOR`], reports longer
/// than [`MAX_REPORT`], axes wider than 32 bits, a range that is empty.
pub fn axes(descriptor: &[u8]) -> Result<Vec<Axis>, DecodeError> {
    if descriptor.len() > MAX_DESCRIPTOR {
        return Err(DecodeError::Length {
            expected: MAX_DESCRIPTOR,
            got: descriptor.len(),
        });
    }
    let mut parser = Parser::default();
    let mut rest = descriptor;
    while let Some((head, behind)) = rest.split_first() {
        if *head == 0xFE {
            // A long item: its length, its tag, its data. None is defined.
            let len = behind.first().copied().map_or(usize::MAX, usize::from);
            rest = behind
                .get(2..)
                .and_then(|data| data.get(len..))
                .ok_or(CUT)?;
            continue;
        }
        let len = match head & 3 {
            3 => 4,
            few => usize::from(few),
        };
        let (data, behind) = behind.split_at_checked(len).ok_or(CUT)?;
        parser.item(head & 0xFC, data)?;
        rest = behind;
    }
    parser.finish()
}

const CUT: DecodeError = DecodeError::Field {
    name: "descriptor, which is cut off",
    value: 0,
};

/// Data of an item without a sign.
fn unsigned(data: &[u8]) -> u32 {
    data.iter()
        .rev()
        .fold(0, |value, byte| value << 8 | u32::from(*byte))
}

/// Data of an item with the sign of its size.
fn signed(data: &[u8]) -> i32 {
    match *data {
        [] => 0,
        [a] => i8::from_le_bytes([a]).into(),
        [a, b] => i16::from_le_bytes([a, b]).into(),
        [a, b, c, d, ..] => i32::from_le_bytes([a, b, c, d]),
        [a, b, c] => i32::from_le_bytes([a, b, c, 0]),
    }
}

impl Parser {
    fn item(&mut self, tag: u8, data: &[u8]) -> Result<(), DecodeError> {
        match tag {
            0x04 => self.globals.page = unsigned(data),
            0x14 => self.globals.logical.0 = signed(data),
            0x24 => self.globals.logical.1 = self.maximum(data, self.globals.logical.0),
            0x34 => self.globals.physical.0 = signed(data),
            0x44 => self.globals.physical.1 = self.maximum(data, self.globals.physical.0),
            0x54 => self.globals.exponent = exponent(unsigned(data)),
            0x64 => self.globals.unit = unsigned(data),
            0x74 => self.globals.size = unsigned(data),
            0x84 => {
                self.globals.report_id = match unsigned(data) {
                    id @ 1..=255 => u8::try_from(id).ok(),
                    other => return refuse("report id", other),
                }
            }
            0x94 => self.globals.count = unsigned(data),
            0xA4 => {
                if self.pushed.len() == MAX_PUSHES {
                    return refuse("push, too deep", 0);
                }
                self.pushed.push(self.globals);
            }
            0xB4 => match self.pushed.pop() {
                Some(globals) => self.globals = globals,
                None => return refuse("pop without push", 0),
            },
            0x08 => {
                let usage = self.usage(data);
                self.add_usage(usage)?;
            }
            0x18 => self.locals.minimum = Some(self.usage(data)),
            0x28 => self.usage_range(data)?,
            0x80 => self.input(unsigned(data))?,
            0x90 | 0xB0 => self.locals = Locals::default(),
            0xA0 => {
                self.collections += 1;
                self.locals = Locals::default();
            }
            0xC0 => {
                self.locals = Locals::default();
                let Some(open) = self.collections.checked_sub(1) else {
                    return refuse("end of a collection that never began", 0);
                };
                self.collections = open;
            }
            // Strings, designators, delimiters: nothing of an axis.
            _ => {}
        }
        Ok(())
    }

    /// A maximum: devices write 255 as one byte, which is -1 with a sign; behind a minimum that is not negative it has none.
    fn maximum(&self, data: &[u8], minimum: i32) -> i32 {
        let value = signed(data);
        if minimum >= 0 && value < 0 {
            return i32::try_from(unsigned(data)).unwrap_or(value);
        }
        value
    }

    /// A usage of four bytes carries its own page.
    fn usage(&self, data: &[u8]) -> (u32, u32) {
        match *data {
            [a, b, c, d] => (
                u16::from_le_bytes([c, d]).into(),
                u16::from_le_bytes([a, b]).into(),
            ),
            _ => (self.globals.page, unsigned(data)),
        }
    }

    fn add_usage(&mut self, usage: (u32, u32)) -> Result<(), DecodeError> {
        if self.locals.usages.len() == MAX_USAGES {
            return refuse("usages, too many", usage.1);
        }
        self.locals.usages.push(usage);
        Ok(())
    }

    fn usage_range(&mut self, data: &[u8]) -> Result<(), DecodeError> {
        let (_, last) = self.usage(data);
        let Some((page, first)) = self.locals.minimum.take() else {
            return refuse("usage maximum without minimum", last);
        };
        if page != GENERIC_DESKTOP {
            // Buttons and the like: as many as there are, and no axis among them.
            return Ok(());
        }
        if last < first {
            return refuse("usage maximum below minimum", last);
        }
        for usage in (first..=last).take(MAX_USAGES + 1) {
            self.add_usage((page, usage))?;
        }
        Ok(())
    }

    fn input(&mut self, flags: u32) -> Result<(), DecodeError> {
        const CONSTANT: u32 = 1;
        const VARIABLE: u32 = 1 << 1;
        const RELATIVE: u32 = 1 << 2;
        let Globals {
            size,
            count,
            report_id,
            ..
        } = self.globals;
        let usages = core::mem::take(&mut self.locals).usages;
        let most = MAX_REPORT * 8;
        let bits = usize::try_from(u64::from(size) * u64::from(count)).unwrap_or(usize::MAX);
        let first = self.length(report_id)?;
        let after = first.saturating_add(bits);
        if after > most {
            return refuse("report, too long", size);
        }
        self.set_length(report_id, after);
        if flags & CONSTANT != 0 || flags & VARIABLE == 0 {
            return Ok(());
        }
        let motion = if flags & RELATIVE == 0 {
            Motion::Absolute
        } else {
            Motion::Relative
        };
        // Fields of no bits may be as many as a device likes to say.
        for at in 0..usize::try_from(count).map_or(most, |count| count.min(most)) {
            // The last usage holds for all fields that are left.
            let Some((page, number)) = usages.get(at).or(usages.last()) else {
                return Ok(());
            };
            let known = |usage: &Usage| u32::from(*usage as u8) == *number;
            let Some(usage) = Usage::ALL.into_iter().find(known) else {
                continue;
            };
            if *page == GENERIC_DESKTOP {
                let size_bytes = usize::try_from(size).unwrap_or(usize::MAX);
                self.add_axis(usage, first + at * size_bytes, motion)?;
            }
        }
        Ok(())
    }

    fn add_axis(&mut self, usage: Usage, bit: usize, motion: Motion) -> Result<(), DecodeError> {
        let globals = self.globals;
        if !(1..=32).contains(&globals.size) {
            return refuse("report size of an axis", globals.size);
        }
        let (least, most) = globals.logical;
        if most <= least {
            return refuse(
                "logical maximum, not above the minimum",
                most.cast_unsigned(),
            );
        }
        let physical = match globals.physical {
            (0, 0) => globals.logical,
            given => given,
        };
        self.axes.push(Axis {
            usage,
            report_id: globals.report_id,
            report_len: 0,
            bit,
            bits: globals.size,
            logical: globals.logical,
            physical,
            exponent: globals.exponent,
            unit: globals.unit,
            motion,
        });
        Ok(())
    }

    fn length(&mut self, id: Option<u8>) -> Result<usize, DecodeError> {
        if let Some((_, bits)) = self.lengths.iter().find(|(known, _)| *known == id) {
            return Ok(*bits);
        }
        if self.lengths.len() == MAX_IDS {
            return refuse("report ids, too many", id.unwrap_or(0).into());
        }
        self.lengths.push((id, 0));
        Ok(0)
    }

    fn set_length(&mut self, id: Option<u8>, bits: usize) {
        for (known, length) in &mut self.lengths {
            if *known == id {
                *length = bits;
            }
        }
    }

    fn finish(mut self) -> Result<Vec<Axis>, DecodeError> {
        if self.collections != 0 {
            return refuse("collection without end", 0);
        }
        for axis in &mut self.axes {
            let bits = self
                .lengths
                .iter()
                .find(|(id, _)| *id == axis.report_id)
                .map_or(0, |(_, bits)| *bits);
            axis.report_len = bits.div_ceil(8) + usize::from(axis.report_id.is_some());
        }
        Ok(self.axes)
    }
}

/// A power of ten in four bits with a sign: 0xE is -2. Some devices write the whole byte.
fn exponent(raw: u32) -> i8 {
    let nibble = i8::try_from(raw & 0xF).unwrap_or(0);
    if nibble > 7 { nibble - 16 } else { nibble }
}
