//! Configurations that somebody mistyped: each is refused with a reason, or makes drivers that run. Nothing falls over.
//!
//! Texts of every driver with all of its settings are changed by a seeded generator: characters, numbers, words, lines.
//! `FT_CONFIGURATIONS=10000000` tries that many.
#![allow(clippy::unwrap_used, reason = "a test that cannot go on has failed")]

use std::path::Path;

use ft_capture::config::Config;
use ft_capture::session::Plan;
use ft_capture::settings::{DriverUser, with_defaults, with_driver};
use ft_drivers::device::Counted;
use ft_drivers::hid_axis::HidFrame;
use ft_drivers::options::Startup;
use ft_drivers::reading::Reading;
use ft_drivers::{Device as Protocol, RxStamps};
use ft_wire::{CanFrame, Chunk, HostTime};

/// Of each driver, all of its settings.
const DRIVERS: [(&str, &str); 13] = [
    (
        "bota_serial",
        "baud_bps = 460800\nrate_hz = 800\nchop = false\nfast = false\nfir_disable = true\n\
         temperature_compensation = false\nsign = \"tool_on_environment\"",
    ),
    ("robotous_can", ROBOTOUS),
    ("robotous_uart", ROBOTOUS),
    ("optoforce_serial", OPTOFORCE),
    ("optoforce_can", OPTOFORCE),
    (
        "kunwei_kwr75",
        "baud_bps = 460800\nmax_step_n = 20\nmax_step_nm = 2.0\nsign = \"environment_on_tool\"",
    ),
    (
        "leptrino",
        "baud_bps = 460800\nsign = \"environment_on_tool\"",
    ),
    (
        "ati_netcanoem",
        "base_id = 32\ncalibration = 0\nrate_hz = 250\nsign = \"environment_on_tool\"",
    ),
    (
        "dynamixel",
        "id = 1\nbaud_bps = 57600\nrate_hz = 50\nlinkage = { kind = \"hoi\" }",
    ),
    (
        "amt21",
        "address = 84\nbaud_bps = 2000000\nrate_hz = 100\nzero_counts = 12\necho = false\n\
         linkage = { kind = \"crank_and_rod\", zero_angle_deg = 64, crank_m = 0.038, rod_m = 0.0444 }",
    ),
    (
        "encoder_line",
        "counts_per_turn = 4096\nzero_counts = -7\nbaud_bps = 115200\n\
         linkage = { kind = \"linear\", zero_angle_deg = 0, width_at_zero_m = 0.01, width_per_turn_m = 0.1 }",
    ),
    (
        "hid_axis",
        "axis = \"slider\"\ncounts_per_turn = 4096\nzero_counts = 5\nlinkage = { kind = \"hoi\" }",
    ),
    ("pose_stream", "baud_bps = 2000000"),
];
const ROBOTOUS: &str = "rate_hz = 1000\nlow_pass_hz = 100\nforce_counts_per_newton = 50\n\
     torque_counts_per_newton_metre = 2000\nsign = \"environment_on_tool\"\nbaud_bps = 921600\ncommand_id = 100\nfirst_id = 1\n\
     second_id = 2";
const OPTOFORCE: &str = "force_counts_per_newton = [18.28, 18.41, 2.12]\n\
     torque_counts_per_newton_metre = [278.72, 259.55, 448.47]\nrate_hz = 333\nlow_pass_hz = 15\nbaud_bps = 1000000\n\
     sign = \"environment_on_tool\"\ndata_id = 256\ncommand_id = 257";
const REST: &str = "[frames.tcp_from_ft_sensor]\nposition_m = [0.0, 0.0, -0.18]\nquaternion_xyzw = [0.0, 0.0, 0.0, 1.0]\n\
     [recording]\nflush_period_ms = 100\nsync_period_ms = 1000\n[network]\nview = \"127.0.0.1:8080\"\nnamespace = \"blue\"\n\
     cache_samples = 65536\nprofile = \"humble\"\n[calibration]\npayload_mass_kg = { value = 0.49, std = 0.005 }\n\
     payload_com_m = { value = [0.021, 0.020, 0.059], std = [0.001, 0.001, 0.001] }\n\
     payload_inertia_kgm2 = { value = [0.001, 0.0, 0.001, 0.0, 0.0, 0.0005], std = [0.0002, 0.0, 0.0002, 0.0, 0.0, 0.0002] }\n";

/// What people and programs write where another number was wanted.
const NUMBERS: [&str; 14] = [
    "0",
    "-1",
    "-0.0",
    "0.5",
    "1e308",
    "-1e308",
    "1e-320",
    "nan",
    "inf",
    "-inf",
    "255",
    "65536",
    "4294967296",
    "9223372036854775807",
];

fn texts() -> Vec<String> {
    let of = |(driver, settings): (&str, &str)| {
        format!(
            "id = \"blue\"\n[[device]]\nname = \"a\"\ndriver = \"{driver}\"\nport = \"can0\"\nlatency_us = 250\n\
             [device.settings]\n{settings}\n{REST}"
        )
    };
    DRIVERS.map(of).to_vec()
}

/// The splitmix64 generator.
struct Random(u64);

impl Random {
    fn below(&mut self, bound: usize) -> usize {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut mixed = self.0;
        mixed = (mixed ^ (mixed >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        ((mixed ^ (mixed >> 31)) % bound.max(1) as u64) as usize
    }

    fn changed(&mut self, text: &str, other: &str) -> String {
        let lines: Vec<_> = text.lines().collect();
        let at = self.below(lines.len());
        let line = match self.below(6) {
            0 => self.with_a_character(lines[at]),
            1 | 2 => self.with_a_number(lines[at]),
            3 => String::new(),
            4 => format!("{0}\n{0}", lines[at]),
            _ => {
                let others: Vec<_> = other.lines().collect();
                others[self.below(others.len())].to_owned()
            }
        };
        let mut changed: Vec<_> = lines.iter().map(|line| (*line).to_owned()).collect();
        changed[at] = line;
        changed.join("\n")
    }

    fn with_a_character(&mut self, line: &str) -> String {
        let mut characters: Vec<_> = line.chars().collect();
        let at = self.below(characters.len());
        let signs = [
            '"', '=', '[', ']', '{', '}', ',', '.', '-', 'e', '0', '9', ' ', '\u{e9}',
        ];
        let sign = signs[self.below(signs.len())];
        match self.below(3) {
            0 if at < characters.len() => characters[at] = sign,
            1 if at < characters.len() => drop(characters.remove(at)),
            _ => characters.insert(at, sign),
        }
        characters.into_iter().collect()
    }

    /// One of the line's numbers replaced.
    fn with_a_number(&mut self, line: &str) -> String {
        let is_part = |c: char| c.is_ascii_digit() || c == '.' || c == '-';
        let starts: Vec<_> = line
            .char_indices()
            .filter(|(at, c)| {
                is_part(*c) && !line[..*at].ends_with(|c: char| is_part(c) || c == '_')
            })
            .map(|(at, _)| at)
            .collect();
        if starts.is_empty() {
            return line.to_owned();
        }
        let start = starts[self.below(starts.len())];
        let rest = line[start..].trim_start_matches(is_part);
        format!(
            "{}{}{rest}",
            &line[..start],
            NUMBERS[self.below(NUMBERS.len())]
        )
    }
}

/// Starts a driver and lets it run for some seconds with a frame that is not its own.
struct Run;

impl Run {
    fn run<D>(mut driver: D, frame: &D::Frame)
    where
        D: Protocol<Reading = Reading> + Counted,
    {
        let start = HostTime::from_nanos(1_700_000_000_000_000_000);
        for step in 0..20 {
            let now = start + std::time::Duration::from_millis(250) * step;
            if driver.poll_timeout().is_some_and(|timeout| timeout <= now) {
                driver.handle_timeout(now);
            }
            for _ in 0..64 {
                if driver.poll_transmit(now).is_none() {
                    break;
                }
            }
            let _ = driver.handle_frame(frame, RxStamps { arrival: now });
            while let Some(reading) = driver.poll_reading() {
                if let Reading::Width(width) = reading {
                    assert!(width.width_m.is_finite() && width.width_rate_m_s.is_finite());
                }
            }
        }
    }
}

impl DriverUser for Run {
    type Output = ();

    fn serial<D>(self, make: impl Fn() -> D + Send + 'static, _baud_bps: u32)
    where
        D: Protocol<Frame = Chunk, Reading = Reading> + Counted + Send + 'static,
    {
        let line = Chunk::new(b"$ENC,1000000,2048*77\r\n").unwrap();
        Self::run(make(), &line);
    }

    fn can<D>(self, make: impl Fn() -> D + Send + 'static, _ids: Vec<u16>, _usual_bps: u32)
    where
        D: Protocol<Frame = CanFrame, Reading = Reading> + Counted + Send + 'static,
    {
        Self::run(make(), &CanFrame::standard(1, &[0x0B; 8]).unwrap());
    }

    fn hid<D>(self, make: impl Fn() -> D + Send + 'static)
    where
        D: Protocol<Frame = HidFrame, Reading = Reading> + Counted + Send + 'static,
    {
        Self::run(make(), &HidFrame::Descriptor(Box::new([0x05, 0x01, 0xC0])));
    }
}

/// Whether the configuration was accepted, with all its settings.
fn tried(text: &str) -> bool {
    let Ok(config) = Config::from_toml(text, Path::new("capture.toml")) else {
        return false;
    };
    let made = |device| with_driver(device, Startup::Configure, Run).is_ok();
    config.devices.iter().all(made)
}

/// The text in a recording, linkages and all.
#[test]
fn what_a_recording_says_of_its_configuration_reads_back_as_the_same() {
    let at = HostTime::from_nanos(1_700_000_000_000_000_000);
    for text in texts() {
        let plan = Plan {
            config: Config::from_toml(&text, Path::new("capture.toml")).unwrap(),
            record: None,
            overwrite: false,
            duration: None,
            publish: false,
        };
        let session = plan.preamble(at, at, "test").unwrap().session;
        let again = Config::from_toml(&session["config"], Path::new("capture.toml")).unwrap();
        let written = with_defaults(&plan.config).unwrap();
        assert_eq!(format!("{again:?}"), format!("{written:?}"));
    }
}

#[test]
fn a_mistyped_configuration_is_refused_or_runs() {
    let texts = texts();
    for text in &texts {
        assert!(tried(text), "refused as it is: {text}");
    }
    let tries = std::env::var("FT_CONFIGURATIONS").map_or(20_000, |text| text.parse().unwrap());
    let (mut random, mut accepted) = (Random(11), 0);
    for _ in 0..tries {
        let mut text = texts[random.below(texts.len())].clone();
        for _ in 0..=random.below(3) {
            let other = &texts[random.below(texts.len())];
            text = random.changed(&text, other);
        }
        let outcome = std::panic::catch_unwind(|| tried(&text));
        accepted += u64::from(outcome.unwrap_or_else(|_| panic!("falls over:\n{text}")));
    }
    // Both happen, or the changes say nothing.
    assert!(
        accepted > tries / 50 && accepted < tries - tries / 50,
        "{accepted} of {tries}"
    );
}
