//! The models of the RFT series: scale, rated load, fastest rate (manual 3.6.11).

use super::RATES_HZ;

#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Model {
    pub(crate) name: &'static str,
    pub(crate) counts_per_newton: f64,
    pub(crate) counts_per_newton_metre: f64,
    rated_lateral_n: f64,
    rated_axial_n: f64,
    rated_nm: f64,
    pub(crate) max_rate_hz: f64,
}

const fn model(name: &'static str, scale: [f64; 2], rated: [f64; 3], max_rate_hz: f64) -> Model {
    let [counts_per_newton, counts_per_newton_metre] = scale;
    let [rated_lateral_n, rated_axial_n, rated_nm] = rated;
    Model {
        name,
        counts_per_newton,
        counts_per_newton_metre,
        rated_lateral_n,
        rated_axial_n,
        rated_nm,
        max_rate_hz,
    }
}

const MODELS: [Model; 8] = [
    model("RFT40-SA01", [50.0, 2000.0], [100.0, 150.0, 2.5], 200.0),
    model("RFT44-SB01", [50.0, 2000.0], [100.0, 150.0, 2.5], 200.0),
    model("RFT60-HA01", [50.0, 2000.0], [150.0, 200.0, 4.0], 1000.0),
    model("RFT64-SB01", [50.0, 2000.0], [150.0, 200.0, 4.0], 1000.0),
    model("RFT64-6A01", [50.0, 1000.0], [200.0, 200.0, 10.0], 1000.0),
    model("RFT80-6A01", [50.0, 1000.0], [400.0, 400.0, 20.0], 1000.0),
    model("RFT80-6A02", [50.0, 1000.0], [400.0, 400.0, 20.0], 1000.0),
    model("RFT80-6A03", [25.0, 500.0], [1000.0, 1000.0, 50.0], 1000.0),
];

impl Model {
    pub(crate) fn named(name: &str) -> Option<Self> {
        MODELS.into_iter().find(|model| model.name == name)
    }

    pub(crate) fn names() -> Vec<&'static str> {
        MODELS.iter().map(|model| model.name).collect()
    }

    /// The code of an output rate that the model reaches.
    pub(crate) fn rate_code(&self, rate_hz: f64) -> Option<u8> {
        let code = (1..RATES_HZ.len()).find(|code| RATES_HZ[*code] == rate_hz)?;
        (rate_hz <= self.max_rate_hz).then_some(code as u8)
    }

    /// The rates that the model reaches, for people.
    pub(crate) fn rates_text(&self) -> String {
        let reached = RATES_HZ[1..]
            .iter()
            .filter(|rate| **rate <= self.max_rate_hz);
        reached
            .map(ToString::to_string)
            .collect::<Vec<_>>()
            .join(", ")
    }

    pub(crate) fn counts_per_unit(&self, axis: usize) -> f64 {
        if axis < 3 {
            self.counts_per_newton
        } else {
            self.counts_per_newton_metre
        }
    }

    pub(crate) fn rated(&self, axis: usize) -> f64 {
        match axis {
            0 | 1 => self.rated_lateral_n,
            2 => self.rated_axial_n,
            _ => self.rated_nm,
        }
    }
}
