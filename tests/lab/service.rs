//! The service itself, `ft-capture`, while its devices leave and come back.

use std::fs;
use std::path::PathBuf;
use std::process::{Child, Command, Stdio};
use std::time::Duration;

use ft_capture::config::{Config, Device};
use serde_json::Value;

use crate::Case;
use crate::can;
use crate::machine::{run, wait_for};
use crate::serial::Plugged;

pub(crate) const CASES: &[Case] = &[
    (
        "service_finds_a_replugged_sensor_under_another_name",
        replugged,
    ),
    ("service_comes_back_after_bus_off_and_a_downed_bus", bus_off),
];

/// For a program that starts in a slow guest, and for its back-off.
const PATIENCE: Duration = Duration::from_secs(60);

/// `ft-capture` with some devices.
struct Service {
    child: Child,
    folder: PathBuf,
}

impl Service {
    fn start(name: &str, devices: Vec<Device>) -> Self {
        let folder = PathBuf::from("/run").join(name);
        fs::create_dir_all(&folder).unwrap();
        let config = Config {
            devices,
            ..toml::from_str::<Config>("").unwrap()
        };
        fs::write(
            folder.join("capture.toml"),
            toml::to_string(&config).unwrap(),
        )
        .unwrap();
        let program = PathBuf::from(std::env::var("FT_LAB_BIN").unwrap()).join("ft-capture");
        let file = |name: &str| fs::File::create(folder.join(name)).unwrap();
        let child = Command::new(program)
            .args(["-o", "a.mcap", "--json", "--listen", "tcp/127.0.0.1:17447"])
            .current_dir(&folder)
            .stdin(Stdio::null())
            .stdout(file("summary.json"))
            .stderr(file("log.txt"))
            .spawn()
            .unwrap();
        Self { child, folder }
    }

    fn log(&self) -> String {
        fs::read_to_string(self.folder.join("log.txt")).unwrap()
    }

    /// Waits until the log has said `what` that many times.
    fn says(&self, what: &str, times: usize) {
        let mut log = String::new();
        let patience = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| {
            wait_for(what, PATIENCE, || {
                log = self.log();
                log.matches(what).count() >= times
            });
        }));
        assert!(patience.is_ok(), "no {what:?}, {times} times, in: {log}");
    }

    fn end(mut self) -> Value {
        run(&format!("kill -INT {}", self.child.id()));
        self.child.wait().unwrap();
        let summary = fs::read_to_string(self.folder.join("summary.json")).unwrap();
        serde_json::from_str(&summary)
            .unwrap_or_else(|error| panic!("{error}: {summary}; {}", self.log()))
    }
}

impl Drop for Service {
    fn drop(&mut self) {
        let _ = self.child.kill();
    }
}

/// Unplugged under load; a twin takes its name; it comes back under another name and is found by its serial number.
fn replugged() {
    let mine = Plugged::sensor("bota_serial", 400.0, 0, "LABMINE");
    let port = mine.gadget.port().path;
    let service = Service::start("replug", vec![mine.played.device("ft_sensor").clone()]);
    service.says("ft_sensor: streaming", 1);
    mine.gadget.unplug();
    service.says("ft_sensor: lost", 1);
    let other = Plugged::sensor("kunwei_kwr75", 1000.0, 1, "LABOTHER");
    assert_eq!(other.gadget.port().path, port, "the other takes its name");
    mine.gadget.plug_in();
    let elsewhere = mine.gadget.port().path;
    assert_ne!(elsewhere, port);
    service.says("ft_sensor: streaming", 2);
    let summary = service.end();
    let stream = &summary["streams"][0];
    assert_eq!(stream["state"], "streaming", "{summary}");
    assert_eq!(stream["interruptions"], 1, "{summary}");
    // The frame that was cut by the unplugging, at most.
    assert!(stream["refused"].as_u64().unwrap() <= 1, "{summary}");
}

fn bus_off() {
    let played = can::played("robotous_can", 200.0);
    let service = Service::start("busoff", vec![played.device("ft_sensor").clone()]);
    service.says("ft_sensor: streaming", 1);
    can::complain(0x40);
    service.says("went bus-off", 1);
    service.says("ft_sensor: streaming", 2);
    run("ip link set vcan0 down");
    service.says("is down", 1);
    run("ip link set vcan0 up");
    service.says("ft_sensor: streaming", 3);
    let summary = service.end();
    let stream = &summary["streams"][0];
    assert_eq!(stream["state"], "streaming", "{summary}");
    assert_eq!(stream["interruptions"], 2, "{summary}");
}
