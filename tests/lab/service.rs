//! The service itself, `ft-capture`, while its devices leave and come back.

use std::collections::BTreeMap;
use std::fs;
use std::path::PathBuf;
use std::process::{Child, Command, Stdio};
use std::time::Duration;

use ft_capture::config::{Config, Device};
use ft_drivers::{Clock as _, MonotonicClock};
use ft_recording::message::{DiagnosticArray, Message as _};
use ft_recording::reader::{Record, RecordReader};
use ft_recording::topic;
use serde_json::Value;

use crate::Case;
use crate::can;
use crate::candle;
use crate::machine::{run, wait_for};
use crate::serial::Plugged;

pub(crate) const CASES: &[Case] = &[
    (
        "service_finds_a_replugged_sensor_under_another_name",
        replugged,
    ),
    ("service_comes_back_after_bus_off_and_a_downed_bus", bus_off),
    (
        "service_records_on_after_a_candlelight_was_replugged",
        candle_replugged,
    ),
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
        assert!(
            patience.is_ok(),
            "no {what:?}, {times} times, in: {log}; meanwhile here: {}",
            where_threads_are()
        );
    }

    /// Ends it; its recording is read by [`Recorded::by`].
    fn end(&mut self) -> Value {
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
    let mut service = Service::start("replug", vec![mine.played.device("ft_sensor").clone()]);
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
    let mut service = Service::start("busoff", vec![played.device("ft_sensor").clone()]);
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

/// A candleLight is pulled out and put back while its sensor is recorded.
fn candle_replugged() {
    let plugged = candle::Plugged::new(0, "LABCANDLE");
    let mut service = Service::start("candle", vec![plugged.sensor()]);
    service.says("ft_sensor: streaming", 1);
    listen();
    plugged.gadget.unplug();
    service.says("ft_sensor: lost", 1);
    plugged.plug_in();
    service.says("ft_sensor: streaming", 2);
    listen();
    let summary = service.end();
    let stream = &summary["streams"][0];
    assert_eq!(stream["state"], "streaming", "{summary}");
    assert_eq!(stream["interruptions"], 1, "{summary}");
    let recorded = Recorded::by(&service);
    assert_eq!(stream["received"], recorded.wrenches.len(), "{summary}");
    let told = recorded.told.iter();
    let [lost, again] = &told
        .filter(|(_, text)| text.starts_with("lost") || text.starts_with("streaming"))
        .skip_while(|(_, text)| !text.starts_with("lost"))
        .take(2)
        .collect::<Vec<_>>()[..]
    else {
        panic!("{:?}", recorded.told);
    };
    assert!(lost.1.contains("gs_usb:LABCANDLE is gone"), "{lost:?}");
    assert!(again.1.starts_with("streaming"), "{again:?}");
    let samples = |from: u64, to: u64| {
        let within = recorded
            .wrenches
            .iter()
            .filter(|at| (from..to).contains(at));
        within.count()
    };
    assert!(samples(0, lost.0) > 50, "{summary}");
    assert!(samples(again.0, u64::MAX) > 50, "{summary}");
    assert_eq!(recorded.interruptions.as_deref(), Some("1"));
}

/// Some more samples, even in a slow guest.
fn listen() {
    let clock = MonotonicClock::anchored_now();
    clock.wait_until(clock.now() + Duration::from_secs(2));
}

/// Where each thread of this program, the simulated devices among them, is in the kernel.
fn where_threads_are() -> String {
    let tasks = fs::read_dir("/proc/self/task").unwrap().flatten();
    let each = tasks.map(|task| {
        let read = |name: &str| fs::read_to_string(task.path().join(name)).unwrap_or_default();
        let frames = read("stack");
        let frames = frames.lines().filter_map(|line| line.split(' ').nth(1));
        let frames: Vec<_> = frames.take(6).collect();
        format!("{} in {}", read("comm").trim(), frames.join(" < "))
    });
    each.collect::<Vec<_>>().join("; ")
}

/// What the service wrote of its only device, in the order of the file; times are `log_time`, ns.
#[derive(Default)]
struct Recorded {
    wrenches: Vec<u64>,
    /// Messages of its `/diagnostics`, each change once.
    told: Vec<(u64, String)>,
    /// What `/diagnostics` last said of them.
    interruptions: Option<String>,
}

impl Recorded {
    fn by(service: &Service) -> Self {
        let mut reader = RecordReader::open(&service.folder.join("a.mcap")).unwrap();
        let (mut recorded, mut topics) = (Self::default(), BTreeMap::new());
        while let Some(record) = reader.next_record().unwrap() {
            match record {
                Record::Channel(channel) => {
                    topics.insert(channel.id, channel.topic);
                }
                Record::Message(message) => {
                    match topics.get(&message.channel_id).map(String::as_str) {
                        Some(topic::WRENCH) => recorded.wrenches.push(message.log_time),
                        Some(topic::DIAGNOSTICS) => recorded.tell(message.log_time, message.data),
                        _ => {}
                    }
                }
                _ => {}
            }
        }
        recorded
    }

    fn tell(&mut self, at: u64, data: &[u8]) {
        let status = DiagnosticArray::decode(data).unwrap().status.remove(0);
        let mut values = status.values.into_iter();
        self.interruptions = values
            .find(|pair| pair.key == "interruptions")
            .map(|pair| pair.value);
        if self
            .told
            .last()
            .is_none_or(|(_, text)| *text != status.message)
        {
            self.told.push((at, status.message));
        }
    }
}
