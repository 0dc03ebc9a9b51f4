//! A first `capture.toml`, written from what is plugged in.

use std::fmt::Write as _;

use ft_drivers::discover::{CanInterface, FoundAdapter, FoundHid, FoundPort};

use crate::config::Driver;

/// What is plugged in.
#[derive(Clone, Debug, Default)]
pub struct Found {
    /// Serial ports on USB.
    pub ports: Vec<FoundPort>,
    /// CAN interfaces.
    pub interfaces: Vec<CanInterface>,
    /// candleLight adapters.
    pub adapters: Vec<FoundAdapter>,
    /// HID devices with an axis.
    pub hids: Vec<FoundHid>,
}

impl Found {
    /// What is plugged in now.
    #[must_use]
    pub fn now() -> Self {
        Self {
            ports: ft_drivers::discover::serial_ports(),
            interfaces: ft_drivers::discover::can_interfaces(),
            adapters: ft_drivers::discover::can_adapters(),
            hids: ft_drivers::discover::hid_devices(),
        }
    }

    /// Whether nothing is there.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.ports.is_empty()
            && self.interfaces.is_empty()
            && self.adapters.is_empty()
            && self.hids.is_empty()
    }
}

const HEAD: &str = "\
# What `ft-capture init` found. A converter does not say what hangs behind it: where several drivers may take a device, its block is
# commented out. Choose the driver, take the # away, and give each topic one device only. README.md shows frames and calibration.
id = \"gripper\"
";

/// The text of the configuration. A device that only one driver takes stands ready, unless its topic is taken already.
#[must_use]
pub fn capture_toml(found: &Found) -> String {
    let (mut text, mut filled) = (HEAD.to_owned(), Vec::new());
    for (number, port) in (1..).zip(&found.ports) {
        let path = port.by_id.as_ref().unwrap_or(&port.path);
        let takers = port.identity().map_or(&[][..], |identity| identity.takers);
        let about = [port.manufacturer.as_str(), port.product_name.as_str()].join(" ");
        let name = format!("serial_{number}");
        block(
            &mut text,
            &mut filled,
            &name,
            &path.display().to_string(),
            takers,
            &about,
        );
    }
    let on_can = ["robotous_can", "optoforce_can", "ati_netcanoem"];
    for interface in &found.interfaces {
        let name = &interface.name;
        block(
            &mut text,
            &mut filled,
            name,
            name,
            &on_can,
            &interface.driver,
        );
    }
    // Where the kernel made no interface of it.
    let alone = found
        .adapters
        .iter()
        .filter(|adapter| adapter.interface.is_none());
    for (number, adapter) in (1..).zip(alone) {
        let name = format!("gs_usb_{number}");
        block(
            &mut text,
            &mut filled,
            &name,
            &adapter.port(),
            &on_can,
            "candleLight in user space",
        );
    }
    for (number, hid) in (1..).zip(&found.hids) {
        let about = format!("{}, axes {}", hid.name, hid.axes.join(", "));
        let name = format!("hid_{number}");
        // A joystick on the desk is not the gripper's.
        let takers = ["hid_axis", "(not the gripper's)"];
        block(
            &mut text,
            &mut filled,
            &name,
            &hid.path.display().to_string(),
            &takers,
            &about,
        );
    }
    text
}

/// `filled` are the topics of the devices that stand ready.
fn block(
    text: &mut String,
    filled: &mut Vec<&'static str>,
    name: &str,
    port: &str,
    takers: &[&str],
    about: &str,
) {
    let driver = takers.first().copied().unwrap_or("?");
    let topic = Driver::by_name(driver).map(Driver::topic);
    let mark = match topic.filter(|topic| takers.len() == 1 && !filled.contains(topic)) {
        Some(topic) => {
            filled.push(topic);
            ""
        }
        None => "# ",
    };
    let choices = if takers.is_empty() {
        "no driver knows this identity".to_owned()
    } else {
        takers.join(", ")
    };
    // Writing to a string cannot fail.
    let _ = write!(
        text,
        "\n# {}: {choices}\n{mark}[[device]]\n{mark}name = {name:?}\n{mark}driver = {driver:?}\n{mark}port = {port:?}\n",
        printable(about.trim())
    );
    for taker in takers {
        if let Some((about, settings)) = needed(taker) {
            let of_another = if *taker == driver { "" } else { taker };
            // Writing to a string cannot fail.
            let _ = match of_another {
                "" => write!(text, "# {about}\n{mark}settings = {settings}\n"),
                _ => write!(text, "# {of_another}: {about}\n# settings = {settings}\n"),
            };
        }
    }
}

/// What a driver must be told of the very device, as one value of TOML, and what it stands for. The numbers are refused: one that
/// was left as it is must not pass raw counts off as newtons or angles.
fn needed(driver: &str) -> Option<(&'static str, &'static str)> {
    match driver {
        "optoforce_serial" | "optoforce_can" => Some((
            "put in the numbers of this sensor's sensitivity report; 0.0 is refused",
            "{ force_counts_per_newton = [0.0, 0.0, 0.0], torque_counts_per_newton_metre = [0.0, 0.0, 0.0] }",
        )),
        "encoder_line" => Some((
            "put in the counts of a whole turn of this encoder, negative when it counts down; 0.0 is refused",
            "{ counts_per_turn = 0.0 }",
        )),
        _ => None,
    }
}

/// A device's own words, on one line.
fn printable(text: &str) -> String {
    text.chars().filter(|c| !c.is_control()).collect()
}

#[cfg(test)]
mod tests {
    use std::path::{Path, PathBuf};

    use super::*;
    use crate::config::Config;

    fn port(path: &str, vendor: u16, product: u16) -> FoundPort {
        FoundPort {
            path: PathBuf::from(path),
            by_id: None,
            vendor,
            product,
            manufacturer: "FTDI\n[[device]]".to_owned(),
            product_name: "Serial".to_owned(),
            serial_number: "A1".to_owned(),
            interface: Some(0),
            driver: String::new(),
            latency_timer_ms: None,
            permitted: true,
        }
    }

    #[test]
    fn a_device_that_one_driver_takes_stands_ready_and_the_others_are_offered() {
        let found = Found {
            ports: vec![
                port("/dev/ttyACM0", 0x04D8, 0x000A),
                port("/dev/ttyUSB0", 0x0403, 0x6014),
            ],
            interfaces: vec![CanInterface {
                name: "can0".to_owned(),
                driver: "gs_usb".to_owned(),
                up: true,
            }],
            adapters: vec![FoundAdapter {
                vendor: 0x1D50,
                product: 0x606F,
                serial_number: "0039001B".to_owned(),
                interface: None,
                permitted: true,
            }],
            hids: Vec::new(),
        };
        let text = capture_toml(&found);
        let config = Config::from_toml(&text, Path::new("capture.toml")).unwrap();
        assert_eq!(config.devices.len(), 1);
        assert_eq!(config.devices[0].driver, Driver::OptoforceSerial);
        let untouched = crate::settings::tests::is_accepted(&config.devices[0]).unwrap_err();
        let untouched = untouched.to_string();
        assert!(
            untouched.contains("force_counts_per_newton = [0.0"),
            "{untouched}"
        );
        for offered in [
            "# driver = \"bota_serial\"",
            "# port = \"can0\"",
            "# port = \"gs_usb:0039001B\"",
            "dynamixel, amt21",
        ] {
            assert!(text.contains(offered), "{offered}: {text}");
        }
    }

    #[test]
    fn of_two_devices_for_one_topic_the_first_stands_ready() {
        let found = Found {
            ports: ["/dev/ttyACM0", "/dev/ttyACM1"]
                .map(|path| port(path, 0x04D8, 0x000A))
                .to_vec(),
            ..Found::default()
        };
        let text = capture_toml(&found);
        let config = Config::from_toml(&text, Path::new("capture.toml")).unwrap();
        assert_eq!(config.devices.len(), 1);
        assert_eq!(config.devices[0].port, "/dev/ttyACM0");
        assert!(text.contains("# port = \"/dev/ttyACM1\""), "{text}");
    }

    #[test]
    fn a_block_whose_marks_are_taken_away_is_a_good_configuration() {
        let found = Found {
            ports: vec![port("/dev/ttyUSB0", 0x0403, 0x6014)],
            ..Found::default()
        };
        let text: String = capture_toml(&found)
            .lines()
            .map(|line| match line.strip_prefix("# ") {
                Some(rest) if rest.starts_with("[[") || rest.contains(" = \"") => {
                    format!("{rest}\n")
                }
                _ => format!("{line}\n"),
            })
            .collect();
        let config = Config::from_toml(&text, Path::new("capture.toml")).unwrap();
        assert_eq!(config.devices[0].driver, Driver::BotaSerial);
    }

    /// Every block with its marks taken away, for each of the drivers that it offers, makes a driver.
    #[test]
    fn every_block_makes_a_driver_whichever_of_those_it_offers_is_chosen() {
        let identities = ft_drivers::discover::IDENTITIES;
        let ports = identities
            .iter()
            .map(|identity| port("/dev/ttyUSB0", identity.vendor, identity.product));
        let mut all: Vec<_> = ports
            .map(|port| Found {
                ports: vec![port],
                ..Found::default()
            })
            .collect();
        all.push(Found {
            interfaces: vec![CanInterface {
                name: "can0".to_owned(),
                driver: "gs_usb".to_owned(),
                up: true,
            }],
            ..Found::default()
        });
        all.push(Found {
            hids: vec![FoundHid {
                path: PathBuf::from("/dev/hidraw0"),
                vendor: 0x2341,
                product: 0x8036,
                name: "Leonardo".to_owned(),
                serial_number: String::new(),
                interface: None,
                axes: vec!["x"],
                permitted: true,
            }],
            ..Found::default()
        });
        let mut chosen = std::collections::BTreeSet::new();
        for text in all.iter().map(capture_toml) {
            let (_, block) = text.split_once("\n\n# ").unwrap();
            let (choices, block) = block.split_once('\n').unwrap();
            let (_, choices) = choices.rsplit_once(": ").unwrap();
            for driver in choices.split(", ").filter_map(Driver::by_name) {
                let config = Config::from_toml(&choose(block, driver.name()), Path::new("a.toml"));
                let config = config.unwrap_or_else(|error| panic!("{driver:?}: {error}: {block}"));
                assert_eq!(config.devices[0].driver, driver);
                crate::settings::tests::is_accepted(&config.devices[0]).unwrap();
                chosen.insert(driver.name());
            }
        }
        assert_eq!(chosen.len(), 13, "{chosen:?}");
    }

    /// What a person makes of a block: takes the marks away, writes this driver, and puts numbers into its settings.
    fn choose(block: &str, driver: &str) -> String {
        let (mut text, mut kept) = (String::new(), true);
        for line in block.lines() {
            let bare = line.strip_prefix("# ").unwrap_or(line);
            if bare.starts_with("driver = ") {
                kept = bare == format!("driver = {driver:?}");
                text.push_str(&format!("driver = {driver:?}\n"));
            } else if let Some(rest) = bare.strip_prefix("settings = ") {
                if kept {
                    text.push_str(&format!("settings = {}\n", rest.replace("0.0", "20.0")));
                }
            } else if bare.starts_with("[[") || bare.contains(" = \"") {
                text.push_str(&format!("{bare}\n"));
            } else if let Some((name, _)) = bare.split_once(": ")
                && Driver::by_name(name).is_some()
            {
                // Settings of another driver follow.
                kept = name == driver;
            }
        }
        text
    }

    #[test]
    fn every_taker_of_an_identity_is_a_driver() {
        for identity in ft_drivers::discover::IDENTITIES {
            for taker in identity.takers {
                assert!(Driver::by_name(taker).is_some(), "{taker}");
            }
        }
    }
}
