//! The commands: ASCII without a terminator, so that a command is whole when its last field is.

#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Command {
    ConfigMode,
    RunMode,
    InitMode,
    Save,
    Load,
    Print,
    /// Temperature compensation, calibration, data format, baud code.
    Communication([u8; 4]),
    /// Sinc length; chop, fast, FIR disable.
    Filter(u16, [u8; 3]),
    Offset([f64; 6]),
    CalibrationRow(u8),
}

impl Command {
    pub(super) fn letter(&self) -> char {
        match self {
            Self::ConfigMode => 'C',
            Self::RunMode => 'R',
            Self::InitMode => 'I',
            Self::Save => 's',
            Self::Load => 'l',
            Self::Print => 'w',
            Self::Communication(_) => 'c',
            Self::Filter(..) => 'f',
            Self::Offset(_) => 'b',
            Self::CalibrationRow(_) => 'm',
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Scanned {
    /// It may still become a command.
    More,
    Whole(Command),
    /// It is none, whatever follows.
    Never,
}

const LONGEST: usize = 96;

/// Reads the command at the start of `bytes`, of which at most one is complete.
pub(super) fn scan(bytes: &[u8]) -> Scanned {
    let Some(text) = std::str::from_utf8(bytes)
        .ok()
        .filter(|text| text.len() <= LONGEST)
    else {
        return Scanned::Never;
    };
    let command = match text.as_bytes() {
        [] => return Scanned::More,
        [b'C'] => Command::ConfigMode,
        [b'R'] => Command::RunMode,
        [b'I'] => Command::InitMode,
        [b's'] => Command::Save,
        [b'l'] => Command::Load,
        [b'w'] => Command::Print,
        [b'c' | b'f' | b'b' | b'm', ..] => return with_fields(text),
        _ => return Scanned::Never,
    };
    Scanned::Whole(command)
}

fn with_fields(text: &str) -> Scanned {
    let mut fields = text.split(',');
    let head = fields.next().unwrap_or_default();
    let fields: Vec<&str> = fields.collect();
    let (letter, row) = head.split_at(1);
    let (wanted, decimals) = match letter {
        "b" => (6, Some(3)),
        "m" => (6, Some(6)),
        _ => (4, None),
    };
    if (letter != "m" && !row.is_empty()) || fields.len() > wanted {
        return Scanned::Never;
    }
    if fields.len() < wanted
        || !fields
            .last()
            .is_some_and(|last| is_complete(last, decimals))
    {
        return Scanned::More;
    }
    parse(letter, row, &fields).map_or(Scanned::Never, Scanned::Whole)
}

/// Whether the last field is at its end: one digit, or as many decimals as the maker's format prints.
fn is_complete(field: &str, decimals: Option<usize>) -> bool {
    match decimals {
        None => !field.is_empty(),
        Some(decimals) => field
            .split_once('.')
            .is_some_and(|(_, fraction)| fraction.len() >= decimals),
    }
}

fn parse(letter: &str, row: &str, fields: &[&str]) -> Option<Command> {
    match letter {
        "c" => {
            let values: Vec<u8> = numbers(fields)?;
            Some(Command::Communication(values.try_into().ok()?))
        }
        "f" => {
            let (sinc, flags) = fields.split_first()?;
            let flags: Vec<u8> = numbers(flags)?;
            Some(Command::Filter(
                sinc.trim().parse().ok()?,
                flags.try_into().ok()?,
            ))
        }
        "b" => {
            let values: Vec<f64> = numbers(fields)?;
            Some(Command::Offset(values.try_into().ok()?))
        }
        _ => {
            let _: Vec<f64> = numbers(fields)?;
            Some(Command::CalibrationRow(row.parse().ok()?))
        }
    }
}

fn numbers<T: std::str::FromStr>(fields: &[&str]) -> Option<Vec<T>> {
    fields
        .iter()
        .map(|field| field.trim().parse().ok())
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Feeds `text` byte by byte; what comes out, and after how many bytes.
    fn fed(text: &str) -> (Scanned, usize) {
        for end in 1..=text.len() {
            let scanned = scan(&text.as_bytes()[..end]);
            if scanned != Scanned::More {
                return (scanned, end);
            }
        }
        (Scanned::More, text.len())
    }

    #[test]
    fn a_command_is_whole_at_its_last_character_and_not_before() {
        for (text, command) in [
            ("C", Command::ConfigMode),
            ("c,0,1,0,4", Command::Communication([0, 1, 0, 4])),
            ("f,64,0,1,1", Command::Filter(64, [0, 1, 1])),
            ("f,4096,1,0,0", Command::Filter(4096, [1, 0, 0])),
            (
                "b, 1.500,-2.250, 0.000, 0.100,-0.200,12.345",
                Command::Offset([1.5, -2.25, 0.0, 0.1, -0.2, 12.345]),
            ),
            (
                "m3, 0.100000,0.200000,0.300000,0.400000,0.500000,-0.600000",
                Command::CalibrationRow(3),
            ),
        ] {
            assert_eq!(fed(text), (Scanned::Whole(command), text.len()), "{text}");
        }
    }

    #[test]
    fn nonsense_is_refused_as_soon_as_it_shows() {
        assert_eq!(fed("xyz"), (Scanned::Never, 1));
        assert_eq!(fed("cc,1"), (Scanned::Never, 2));
        assert_eq!(fed("c,0,1,0,x").0, Scanned::Never);
        assert_eq!(scan(&[0xFF]), Scanned::Never);
    }
}
