//! Plays a simulated device and listens to it with its driver, made as `ft-capture` makes it.

use std::path::Path;
use std::time::Duration;

use ft_capture::config::Device;
use ft_capture::settings::{DriverUser, with_driver};
use ft_capture::simulated;
use ft_drivers::device::Counted;
use ft_drivers::hid_axis::HidFrame;
use ft_drivers::link::can_port::CanName;
use ft_drivers::link::hidraw::HidrawLink;
use ft_drivers::link::serial::SerialLink;
use ft_drivers::options::Startup;
use ft_drivers::pump::{Outlet, Pump};
use ft_drivers::reading::{Counts, DeviceEvent, Reading, WrenchReading};
use ft_drivers::{Clock as _, Device as Protocol, Link, LinkError, MonotonicClock, RxStamps};
use ft_sim_hw::scenario::SensorSpec;
use ft_sim_hw::{Scenario, ServeOptions, Server};
use ft_wire::{CanFrame, Chunk};

const WEIGHT_N: f64 = 0.49 * 9.80665;
/// The guest is slow, and so are set-ups that write five milliseconds a character.
const LONGEST: Duration = Duration::from_secs(40);

/// A gripper that is turned in free air, its devices, and how they are configured.
pub(crate) struct Played {
    pub(crate) server: Server,
    devices: Vec<Device>,
}

impl Played {
    /// The wood door's gripper with this sensor at this rate; `port` names the host's side of each device.
    pub(crate) fn with_sensor(
        driver: &str,
        rate_hz: f64,
        options: ServeOptions,
        port: impl Fn(&str) -> String,
    ) -> Self {
        let mut scenario = Self::scenario(driver, rate_hz);
        // However late a slow guest comes to it, the tool is neither shaken nor in contact.
        scenario.person.free_air_s = 1200.0;
        Self::new(&scenario, options, port)
    }

    /// The wood door with this sensor at this rate.
    pub(crate) fn scenario(driver: &str, rate_hz: f64) -> Scenario {
        let mut scenario = Scenario::builtin("wood_door").unwrap();
        scenario.sensor = SensorSpec::of(driver).unwrap();
        scenario.sensor.rate_hz = rate_hz;
        scenario
    }

    pub(crate) fn new(
        scenario: &Scenario,
        options: ServeOptions,
        port: impl Fn(&str) -> String,
    ) -> Self {
        let clock = MonotonicClock::anchored_now();
        let server = Server::start(scenario, 5, None, clock, options).unwrap();
        let fitted: Vec<_> = server.ports().into_iter().map(|port| port.fitted).collect();
        let config = simulated::config("lab", &fitted, &server.known_setup(), |fitted| {
            port(&fitted.name)
        });
        let devices = config.unwrap().devices;
        Self { server, devices }
    }

    pub(crate) fn device(&self, name: &str) -> &Device {
        let mut named = self.devices.iter();
        named.find(|device| device.name == name).unwrap()
    }

    /// Listens to the sensor for `samples` and asserts that it weighs the tool.
    pub(crate) fn weighs_the_tool(&self, samples: usize) -> Heard {
        self.weighs_the_tool_by(self.device("ft_sensor"), samples)
    }

    /// The same where the sensor is at another port by now.
    pub(crate) fn weighs_the_tool_at(&self, port: &Path, samples: usize) -> Heard {
        let mut device = self.device("ft_sensor").clone();
        device.port = port.display().to_string();
        self.weighs_the_tool_by(&device, samples)
    }

    /// The same, and listens on until `enough`.
    pub(crate) fn weighs_the_tool_until(&self, samples: usize, enough: &dyn Fn() -> bool) -> Heard {
        let heard = hear_until(self.device("ft_sensor"), samples, enough).unwrap();
        self.is_the_tools_weight(heard.wrenches().map(|reading| reading.wrench.to_array()));
        heard
    }

    /// The same with the sensor configured so.
    pub(crate) fn weighs_the_tool_by(&self, sensor: &Device, samples: usize) -> Heard {
        let heard = hear(sensor, samples).unwrap();
        self.is_the_tools_weight(heard.wrenches().map(|reading| reading.wrench.to_array()));
        heard
    }

    /// Asserts that wrenches without the sensor's bias weigh what the tool does, whichever way it is turned.
    pub(crate) fn is_the_tools_weight(&self, wrenches: impl Iterator<Item = [f64; 6]>) {
        let bias = self.server.truth().sensor_errors.bias;
        let weight = |wrench: [f64; 6]| {
            let square = |axis: usize| (wrench[axis] - bias[axis]).powi(2);
            (0..3).map(square).sum::<f64>().sqrt()
        };
        let mut weights: Vec<_> = wrenches.map(weight).collect();
        weights.sort_by(f64::total_cmp);
        let weight = weights[weights.len() / 2];
        assert!(
            (weight - WEIGHT_N).abs() < 0.25,
            "the tool weighs {weight} N"
        );
    }
}

/// What a driver made of what came.
#[derive(Debug, Default)]
pub(crate) struct Heard {
    pub(crate) counts: Counts,
    pub(crate) readings: Vec<Reading>,
    samples: usize,
}

impl Heard {
    pub(crate) fn wrenches(&self) -> impl Iterator<Item = &WrenchReading> {
        self.readings.iter().filter_map(|reading| match reading {
            Reading::Wrench(wrench) => Some(wrench),
            _ => None,
        })
    }

    pub(crate) fn widths(&self) -> Vec<f64> {
        let widths = self.readings.iter().filter_map(|reading| match reading {
            Reading::Width(width) => Some(width.width_m),
            _ => None,
        });
        widths.collect()
    }

    pub(crate) fn events(&self) -> impl Iterator<Item = &DeviceEvent> {
        self.readings.iter().filter_map(|reading| match reading {
            Reading::Event { event, .. } => Some(event),
            _ => None,
        })
    }

    /// Asserts that nothing was lost, refused, doubled or skipped, and that the driver complained of nothing once samples
    /// flowed. A set-up may take two tries: a gadget's buffer that is full of what nobody read drops the first answer.
    pub(crate) fn is_whole(&self) {
        let counts = &self.counts;
        let bad = [counts.gaps, counts.refused, counts.duplicated];
        assert_eq!(bad, [0; 3], "gaps, refused, duplicated");
        assert_eq!(counts.overflows, 0);
        self.is_content();
    }

    /// The same where the slow guest may be late for a poll or for the second half of a sample: some may be lost, if told, but
    /// fewer than half as many as came.
    pub(crate) fn is_nearly_whole(&self) {
        let counts = &self.counts;
        assert!(
            2 * (counts.gaps + counts.refused) < counts.received,
            "{counts:?}"
        );
        assert_eq!(counts.duplicated, 0);
        self.is_content();
    }

    fn is_content(&self) {
        let mut events = self.events();
        assert!(events.any(|event| *event == DeviceEvent::Streaming));
        for event in events {
            let fine = match event {
                DeviceEvent::Lost { .. } => false,
                // The only loss that a link tells of, and only where it counts one.
                DeviceEvent::Warning { text } => {
                    self.counts.overflows > 0 && text.contains("frames are lost (")
                }
                _ => true,
            };
            assert!(fine, "{event:?}, {:?}", self.counts);
        }
    }
}

impl<F> Outlet<F> for Heard {
    fn frame(&mut self, _frame: &F, _stamps: RxStamps) {}
    fn reading(&mut self, reading: Reading) {
        let other = matches!(reading, Reading::Event { .. } | Reading::Missing { .. });
        self.samples += usize::from(!other);
        self.readings.push(reading);
    }
}

/// Opens the device's port and turns its driver until that many samples came.
pub(crate) fn hear(device: &Device, samples: usize) -> Result<Heard, LinkError> {
    hear_until(device, samples, &|| true)
}

/// The same, and then until it is `enough`.
fn hear_until(
    device: &Device,
    samples: usize,
    enough: &dyn Fn() -> bool,
) -> Result<Heard, LinkError> {
    let listener = Listener {
        device,
        samples,
        enough,
    };
    with_driver(device, Startup::Configure, listener).unwrap()
}

struct Listener<'a> {
    device: &'a Device,
    samples: usize,
    enough: &'a dyn Fn() -> bool,
}

impl Listener<'_> {
    fn listen<D, L>(&self, driver: D, link: L, clock: MonotonicClock) -> Result<Heard, LinkError>
    where
        D: Protocol<Reading = Reading> + Counted,
        L: Link<Frame = D::Frame>,
    {
        let mut pump = Pump::new(driver, link);
        let mut heard = Heard::default();
        let end = clock.now() + LONGEST;
        while heard.samples < self.samples || !(self.enough)() {
            let now = clock.now();
            assert!(
                now < end,
                "{} of {} samples in {LONGEST:?}; {:?}; {:?}",
                heard.samples,
                self.samples,
                pump.counts(),
                heard.events().collect::<Vec<_>>()
            );
            pump.turn(&clock, now + Duration::from_millis(20), &mut heard)?;
        }
        heard.counts = pump.counts();
        Ok(heard)
    }
}

impl DriverUser for Listener<'_> {
    type Output = Result<Heard, LinkError>;

    fn serial<D>(self, make: impl Fn() -> D + Send + 'static, baud_bps: u32) -> Self::Output
    where
        D: Protocol<Frame = Chunk, Reading = Reading> + Counted + Send + 'static,
    {
        let clock = MonotonicClock::anchored_now();
        let link = SerialLink::open(Path::new(&self.device.port), baud_bps, clock)?;
        self.listen(make(), link, clock)
    }

    fn can<D>(
        self,
        make: impl Fn() -> D + Send + 'static,
        ids: Vec<u16>,
        usual_bps: u32,
    ) -> Self::Output
    where
        D: Protocol<Frame = CanFrame, Reading = Reading> + Counted + Send + 'static,
    {
        let clock = MonotonicClock::anchored_now();
        let link = CanName::parse(&self.device.port)?.open(&ids, usual_bps, clock)?;
        self.listen(make(), link, clock)
    }

    fn hid<D>(self, make: impl Fn() -> D + Send + 'static) -> Self::Output
    where
        D: Protocol<Frame = HidFrame, Reading = Reading> + Counted + Send + 'static,
    {
        let clock = MonotonicClock::anchored_now();
        let link = HidrawLink::open(Path::new(&self.device.port), clock)?;
        self.listen(make(), link, clock)
    }
}
