//! candleLight adapters (CANable and others) in user space, by libusb: no CAN is needed in the kernel, whatever the system.
//!
//! A link has the adapter for itself. The kernel's driver is detached while it is open, unless its interface is up: then
//! somebody uses that. Two channels of one adapter cannot be opened by two links.

mod address;
mod echoes;
mod stamps;
mod waiting;

use std::io;
use std::time::Duration;

use ft_wire::gs_usb::{
    self as wire, BitTiming, Content, FEATURE_TIME_STAMPS, HostFrame, Limits, Stamps, request,
};
use ft_wire::{CanFrame, HostTime};
use rusb::{Context, DeviceHandle, Direction, TransferType};

pub use self::address::{Address, PREFIX};
use self::echoes::Echoes;
use self::stamps::AdapterClock;
use self::waiting::Waiting;
use crate::clock::{Clock, MonotonicClock};
use crate::discover;
use crate::link::can_errors::{CanErrors, ErrorWatch};
use crate::link::{Link, LinkError, RxStamps};

/// Longest wait for an answer to a request, which Linux's driver waits too.
const ANSWER: Duration = Duration::from_secs(1);
/// Longest wait for room in the adapter in one call; what found none waits ([`Waiting`]) while frames are read. USB carries a frame
/// within a millisecond, and [`Echoes`] keeps fewer under way than the adapter has room for. Meanwhile nobody reads: the room for 64
/// frames that candleLight's smallest adapters have must last, at two frames a millisecond of a sensor at 1 kHz.
const ROOM: Duration = Duration::from_millis(5);
/// Longest wait in one call of libusb; 0 would mean for ever.
const WAIT: (Duration, Duration) = (Duration::from_millis(1), Duration::from_secs(1));
/// Silence after which the adapter holds nothing that is left over, and how many frames it may hold at most.
const SILENCE: Duration = Duration::from_millis(20);
const MOST_LEFT: usize = 256;
/// Transfers that are not wanted (echoes, errors, others' frames) which are read behind a deadline, at most: what waits behind them came
/// before it, but a busy bus must not keep the device's timers waiting.
const MOST_BEHIND: usize = 64;
/// A whole packet of a fast adapter, so that none is cut.
const TRANSFER: usize = 512;
/// The adapter's only interface.
const INTERFACE: u8 = 0;

/// An open channel of a candleLight adapter.
///
/// Arrivals are the adapter's own stamps put onto our clock where it gives stamps (never later than our read), else our
/// clock after the read. Error frames are counted; bus-off ends the link, and opening it again ends bus-off.
#[derive(Debug)]
pub struct GsUsbLink {
    handle: DeviceHandle<Context>,
    name: String,
    serial_number: String,
    channel: u8,
    /// Addresses of the bulk endpoints, from and to the adapter.
    endpoints: (u8, u8),
    stamps: Stamps,
    standard_ids: Box<[u16]>,
    clock: MonotonicClock,
    adapter_clock: AdapterClock,
    echoes: Echoes,
    waiting: Waiting,
    watch: ErrorWatch,
    dropped: Dropped,
    told: Dropped,
}

/// Frames that were lost on their way.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct Dropped {
    /// Times that the adapter had no room.
    overflows: u64,
    /// Transfers that were no frame.
    refused: u64,
}

impl GsUsbLink {
    /// Opens the adapter, starts its channel at the address's bit rate, or at `usual_bps` where it has none, and takes frames with
    /// these 11-bit ids only; with no ids, all frames.
    ///
    /// # Errors
    /// There is no such adapter or channel, it is busy or not permitted, its clock does not give the bit rate, or it does not
    /// answer.
    pub fn open(
        address: &Address,
        standard_ids: &[u16],
        usual_bps: u32,
        clock: MonotonicClock,
    ) -> Result<Self, LinkError> {
        let name = address.to_string();
        let failed = |call: &'static str| {
            let port = name.clone();
            move |error| usb_error(call, port, error)
        };
        let device = discover::adapter(&name, &address.serial_number)?;
        let handle = device.open().map_err(failed("open"))?;
        // Other systems have no driver to be detached.
        let _ = handle.set_auto_detach_kernel_driver(true);
        handle.claim_interface(INTERFACE).map_err(failed("claim"))?;
        let endpoints = endpoints(&device)
            .map_err(failed("read the descriptor"))?
            .ok_or_else(|| wrong_device(&name))?;
        let serial_number = device
            .device_descriptor()
            .and_then(|descriptor| handle.read_serial_number_string_ascii(&descriptor))
            .unwrap_or_default();
        let mut link = Self {
            handle,
            serial_number,
            channel: address.channel,
            endpoints,
            stamps: Stamps::Absent,
            standard_ids: standard_ids.into(),
            clock,
            adapter_clock: AdapterClock::new(),
            echoes: Echoes::default(),
            waiting: Waiting::new(),
            watch: ErrorWatch::new(),
            dropped: Dropped::default(),
            told: Dropped::default(),
            name,
        };
        link.start(address.bitrate_bps.unwrap_or(usual_bps))?;
        Ok(link)
    }

    /// The adapter's serial number, empty when it has none.
    #[must_use]
    pub fn serial_number(&self) -> &str {
        &self.serial_number
    }

    /// Error frames so far.
    #[must_use]
    pub const fn errors(&self) -> CanErrors {
        self.watch.errors
    }

    fn start(&mut self, bitrate_bps: u32) -> Result<(), LinkError> {
        let channel = u16::from(self.channel);
        // To every channel: the third field is no channel here but marks the request's version.
        self.write(
            "set the host format",
            request::HOST_FORMAT,
            1,
            &wire::HOST_FORMAT,
        )?;
        let mut device = [0; 12];
        self.read(
            "read the device's channels",
            request::DEVICE,
            0,
            &mut device,
        )?;
        if wire::channels(&device).map_or(0, u16::from) <= channel {
            return Err(LinkError::Channel {
                port: self.name.clone(),
                channel: self.channel,
            });
        }
        self.write("reset the channel", request::MODE, channel, &wire::reset())?;
        self.drain();
        let mut limits = [0; 40];
        self.read(
            "read the bit timing's limits",
            request::LIMITS,
            channel,
            &mut limits,
        )?;
        let limits = Limits::decode(&limits).map_err(|_| wrong_device(&self.name))?;
        let timing = self.timing(&limits, bitrate_bps)?;
        self.write(
            "set the bit timing",
            request::BIT_TIMING,
            channel,
            &timing.encode(),
        )?;
        let features = limits.features & FEATURE_TIME_STAMPS;
        if features != 0 {
            self.stamps = Stamps::Carried;
        }
        self.write(
            "start the channel",
            request::MODE,
            channel,
            &wire::start(features),
        )
    }

    /// Drops what an earlier program left in the adapter.
    fn drain(&self) {
        let mut transfer = [0; TRANSFER];
        for _ in 0..MOST_LEFT {
            let came = self
                .handle
                .read_bulk(self.endpoints.0, &mut transfer, SILENCE);
            if came.is_err() {
                return;
            }
        }
    }

    fn timing(&self, limits: &Limits, bitrate_bps: u32) -> Result<BitTiming, LinkError> {
        limits.timing(bitrate_bps).ok_or_else(|| {
            let clock = limits.clock_hz;
            let text = format!("its clock of {clock} Hz does not give {bitrate_bps} bit/s");
            LinkError::Io {
                call: "choose the bit timing",
                port: self.name.clone(),
                source: io::Error::new(io::ErrorKind::InvalidInput, text),
            }
        })
    }

    fn write(
        &self,
        call: &'static str,
        request: u8,
        value: u16,
        bytes: &[u8],
    ) -> Result<(), LinkError> {
        let index = u16::from(INTERFACE);
        self.handle
            .write_control(wire::REQUEST_OUT, request, value, index, bytes, ANSWER)
            .map(drop)
            .map_err(|error| usb_error(call, self.name.clone(), error))
    }

    /// Fills `answer`.
    fn read(
        &self,
        call: &'static str,
        request: u8,
        value: u16,
        answer: &mut [u8],
    ) -> Result<(), LinkError> {
        let index = u16::from(INTERFACE);
        let length = self
            .handle
            .read_control(wire::REQUEST_IN, request, value, index, answer, ANSWER)
            .map_err(|error| usb_error(call, self.name.clone(), error))?;
        if length == answer.len() {
            Ok(())
        } else {
            Err(wrong_device(&self.name))
        }
    }

    /// The data frame that is wanted, or `None` for what is only counted.
    fn sort(&mut self, transfer: &[u8]) -> Result<Option<(CanFrame, RxStamps)>, LinkError> {
        let now = self.clock.now();
        let Ok(frame) = HostFrame::decode(transfer, self.stamps) else {
            self.dropped.refused += 1;
            return Ok(None);
        };
        if frame.channel != self.channel {
            return Ok(None);
        }
        self.dropped.overflows += u64::from(frame.lost_before);
        match frame.content {
            Content::Data(data) => {
                let arrival = self.adapter_clock.arrival(frame.time_us, now);
                let wanted = self.is_wanted(&data);
                Ok(wanted.then_some((data, RxStamps { arrival })))
            }
            Content::Sent(echo_id) => {
                self.echoes.came_back(echo_id);
                Ok(None)
            }
            Content::Errors(classes) => self.watch.count(classes, &self.name).map(|()| None),
            Content::Remote => Ok(None),
        }
    }

    /// Sends what waits, as far as there is room.
    fn flush(&mut self) -> Result<(), LinkError> {
        let (handle, endpoint, name) = (&self.handle, self.endpoints.1, &self.name);
        let write = |bytes: &[u8]| match handle.write_bulk(endpoint, bytes, ROOM) {
            Ok(_) => Ok(true),
            Err(rusb::Error::Timeout | rusb::Error::Interrupted) => Ok(false),
            Err(error) => Err(transfer_error("write", name.clone(), error)),
        };
        if self.waiting.flush(self.clock.now(), write)? {
            return Ok(());
        }
        let port = self.name.clone();
        Err(LinkError::NoAcknowledge { port })
    }

    fn is_wanted(&self, frame: &CanFrame) -> bool {
        self.standard_ids.is_empty()
            || (!frame.is_extended()
                && self
                    .standard_ids
                    .iter()
                    .any(|id| u32::from(*id) == frame.arbitration_id()))
    }
}

impl Drop for GsUsbLink {
    /// Leaves the bus; an adapter that is gone has left it.
    fn drop(&mut self) {
        let channel = u16::from(self.channel);
        let _ = self.write("reset the channel", request::MODE, channel, &wire::reset());
    }
}

/// Addresses of the bulk endpoints, from and to the adapter.
fn endpoints(device: &rusb::Device<Context>) -> rusb::Result<Option<(u8, u8)>> {
    let config = device.active_config_descriptor()?;
    let of = |direction| {
        config
            .interfaces()
            .filter(|interface| interface.number() == INTERFACE)
            .flat_map(|interface| interface.descriptors())
            .flat_map(|setting| setting.endpoint_descriptors().collect::<Vec<_>>())
            .find(|endpoint| {
                endpoint.transfer_type() == TransferType::Bulk && endpoint.direction() == direction
            })
            .map(|endpoint| endpoint.address())
    };
    Ok(of(Direction::In).zip(of(Direction::Out)))
}

fn wrong_device(name: &str) -> LinkError {
    LinkError::Io {
        call: "identify the adapter",
        port: name.to_owned(),
        source: io::Error::new(
            io::ErrorKind::InvalidData,
            "it does not answer as a candleLight does",
        ),
    }
}

fn usb_error(call: &'static str, port: String, error: rusb::Error) -> LinkError {
    match error {
        rusb::Error::NoDevice | rusb::Error::NotFound => LinkError::Gone { port },
        rusb::Error::Busy => LinkError::Busy { port },
        rusb::Error::Access => LinkError::Denied { port },
        error => LinkError::Io {
            call,
            port,
            source: io::Error::other(error),
        },
    }
}

/// Of a bulk transfer: [`rusb::Error::Io`] and [`rusb::Error::Pipe`] are what the system makes of an endpoint that is no longer there.
fn transfer_error(call: &'static str, port: String, error: rusb::Error) -> LinkError {
    match error {
        rusb::Error::Io | rusb::Error::Pipe => LinkError::Gone { port },
        error => usb_error(call, port, error),
    }
}

impl Link for GsUsbLink {
    type Frame = CanFrame;

    fn recv(&mut self, deadline: HostTime) -> Result<Option<(CanFrame, RxStamps)>, LinkError> {
        self.flush()?;
        let mut transfer = [0; TRANSFER];
        let mut behind = 0;
        loop {
            let left = deadline.saturating_since(self.clock.now());
            let wait = Duration::from_micros(u64::try_from(left.as_micros()).unwrap_or(u64::MAX));
            let wait = (wait + Duration::from_micros(999)).clamp(WAIT.0, WAIT.1);
            match self.handle.read_bulk(self.endpoints.0, &mut transfer, wait) {
                Ok(length) => {
                    let came = self.sort(transfer.get(..length).unwrap_or_default())?;
                    if came.is_some() {
                        return Ok(came);
                    }
                    if self.clock.now() >= deadline {
                        behind += 1;
                        if behind == MOST_BEHIND {
                            return Ok(None);
                        }
                    }
                }
                Err(rusb::Error::Timeout | rusb::Error::Interrupted) => {
                    if self.clock.now() >= deadline {
                        return Ok(None);
                    }
                }
                Err(error) => return Err(transfer_error("read", self.name.clone(), error)),
            }
        }
    }

    fn send(&mut self, frame: &CanFrame) -> Result<(), LinkError> {
        let Some(echo_id) = self.echoes.take() else {
            let port = self.name.clone();
            return Err(LinkError::NoAcknowledge { port });
        };
        self.waiting
            .push(wire::encode(echo_id, self.channel, frame));
        self.flush()
    }

    fn overflows(&self) -> u64 {
        self.dropped.overflows + self.dropped.refused
    }

    fn take_notice(&mut self) -> Option<String> {
        if self.dropped != self.told {
            let Dropped { overflows, refused } = self.dropped;
            let first = self.told == Dropped::default();
            self.told = self.dropped;
            if first {
                return Some(format!(
                    "{}: frames are lost ({overflows} times the adapter had no room, {refused} transfers were no frame)",
                    self.name
                ));
            }
        }
        self.watch.notice(self.clock.now(), &self.name)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_error_of_the_usb_gets_its_advice() {
        let text = |error| usb_error("read", "gs_usb:A1".to_owned(), error).to_string();
        assert!(text(rusb::Error::NoDevice).contains("gone"));
        assert!(text(rusb::Error::Busy).contains("busy"));
        assert!(text(rusb::Error::Access).contains("udev"));
        assert_eq!(text(rusb::Error::Overflow), "read on gs_usb:A1 failed");
    }

    #[test]
    fn an_adapter_pulled_out_during_a_transfer_is_gone() {
        for call in ["read", "write"] {
            for error in [rusb::Error::Io, rusb::Error::Pipe, rusb::Error::NoDevice] {
                let ended = transfer_error(call, "gs_usb:A1".to_owned(), error);
                assert!(matches!(ended, LinkError::Gone { .. }), "{ended:?}");
            }
        }
        let ended = transfer_error("write", "gs_usb:A1".to_owned(), rusb::Error::Overflow);
        assert!(matches!(ended, LinkError::Io { .. }), "{ended:?}");
    }

    #[test]
    fn an_adapter_that_is_not_there_is_named() {
        let address = Address::parse("gs_usb:no-such-adapter").unwrap();
        let missing = GsUsbLink::open(&address, &[], 1_000_000, MonotonicClock::anchored_now());
        let Err(LinkError::NotFound { port }) = missing else {
            panic!("{missing:?}");
        };
        assert_eq!(port, "gs_usb:no-such-adapter");
    }
}
