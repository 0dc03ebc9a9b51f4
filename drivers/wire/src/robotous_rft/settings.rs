//! Codes of filter and rate, and the scale of each model: tables of the maker's manual 1.82.

/// Type and code of the filter as the sensor holds them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct FilterSetting {
    /// 0 none, 1 first-order low pass.
    pub kind: u8,
    /// Cut-off code, see [`FilterSetting::cut_off_hz`].
    pub code: u8,
}

impl FilterSetting {
    const CUT_OFF_HZ: [u16; 14] = [500, 300, 200, 150, 100, 50, 40, 30, 20, 10, 5, 3, 2, 1];

    /// No filter.
    pub const NONE: Self = Self { kind: 0, code: 0 };

    /// The low pass with exactly this cut-off, Hz, or `None` when the sensor has none.
    #[must_use]
    pub fn low_pass(cut_off_hz: u16) -> Option<Self> {
        let at = Self::CUT_OFF_HZ.iter().position(|hz| *hz == cut_off_hz)?;
        Some(Self {
            kind: 1,
            code: u8::try_from(at + 1).ok()?,
        })
    }

    /// Cut-off, Hz, by manual 1.82; `None` without filter. An older header of the maker numbers them the other way.
    #[must_use]
    pub fn cut_off_hz(self) -> Option<u16> {
        let at = usize::from(self.code).checked_sub(1)?;
        if self.kind == 1 {
            Self::CUT_OFF_HZ.get(at).copied()
        } else {
            None
        }
    }
}

const RATES_HZ: [u16; 9] = [200, 10, 20, 50, 100, 200, 333, 500, 1000];

/// Output rate of a code, Hz; code 0 is the default, 200 Hz.
#[must_use]
pub fn rate_hz(code: u8) -> Option<u16> {
    RATES_HZ.get(usize::from(code)).copied()
}

/// The code for an output rate, Hz (1 to 8), or `None` when the sensor has no such rate.
#[must_use]
pub fn rate_code(rate_hz: u16) -> Option<u8> {
    let at = RATES_HZ.iter().skip(1).position(|hz| *hz == rate_hz)?;
    u8::try_from(at + 1).ok()
}

/// The fastest output rate, Hz, that the manual allows at a serial bit rate; `None` for a bit rate it does not list.
#[must_use]
pub const fn max_rate_hz_at(baud_bps: u32) -> Option<u16> {
    match baud_bps {
        57_600 => Some(200),
        115_200 => Some(333),
        230_400 | 460_800 => Some(500),
        921_600 => Some(1000),
        _ => None,
    }
}

/// A model's scale, manual 3.6.11.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Model {
    /// As the sensor names itself.
    pub name: &'static str,
    /// Raw counts per N.
    pub df: f64,
    /// Raw counts per N m.
    pub dt: f64,
    /// Fastest output, Hz.
    pub max_rate_hz: u16,
}

/// The models of the manual.
pub const MODELS: [Model; 8] = [
    Model {
        name: "RFT40-SA01",
        df: 50.0,
        dt: 2000.0,
        max_rate_hz: 200,
    },
    Model {
        name: "RFT44-SB01",
        df: 50.0,
        dt: 2000.0,
        max_rate_hz: 200,
    },
    Model {
        name: "RFT60-HA01",
        df: 50.0,
        dt: 2000.0,
        max_rate_hz: 1000,
    },
    Model {
        name: "RFT64-SB01",
        df: 50.0,
        dt: 2000.0,
        max_rate_hz: 1000,
    },
    Model {
        name: "RFT64-6A01",
        df: 50.0,
        dt: 1000.0,
        max_rate_hz: 1000,
    },
    Model {
        name: "RFT80-6A01",
        df: 50.0,
        dt: 1000.0,
        max_rate_hz: 1000,
    },
    Model {
        name: "RFT80-6A02",
        df: 50.0,
        dt: 1000.0,
        max_rate_hz: 1000,
    },
    Model {
        name: "RFT80-6A03",
        df: 25.0,
        dt: 500.0,
        max_rate_hz: 1000,
    },
];

/// The manual's entry for the name that a sensor gives.
#[must_use]
pub fn model_named(name: &str) -> Option<Model> {
    MODELS
        .into_iter()
        .find(|model| name.starts_with(model.name))
}
