//! The physical world, the person and the devices as bytes.
//!
//! [`Simulation`] integrates a 1-DoF object that a person probes with a force-sensing gripper, and plays the gripper's devices
//! byte for byte. Stepped, it runs as fast as it is asked to and is deterministic for a seed; [`Server`] plays it in real time
//! on pseudo-terminals and CAN.
//!
//! Nothing here uses a codec of `ft-wire` or a model of `ft-identify`: bytes are written from the makers' documents and the
//! physics is integrated on its own, so that one mistake cannot hide on both sides.
//!
//! # Differences from the real devices
//!
//! | device | real | here |
//! |---|---|---|
//! | all | seen on real hardware | none: from documents only |
//! | all serial | bytes at another line rate are garbage | a pty whose speed is set wrong carries garbage both ways; stepped links have no line rate |
//! | all serial | adapter latency timer, bursts | only with `[sensor.link]`, `[tracker.link]`: at multiples of `burst_ms` of the host's time; else line time, 0.1 ms mean jitter, one frame in twenty in two pieces |
//! | Bota | filters delay and band-limit the gauges | the sample is the instant's value plus white noise; only the rate depends on `f` |
//! | Bota | CSV data format | refused with return code 1 |
//! | Bota | first line after `#` at 230400 bit/s | all boot text at the line's rate |
//! | Bota | streams after power-up (unconfirmed) | streams after power-up |
//! | Bota | ack `r,<digit>,<command>,<code>`: digit and line end unconfirmed | digit 0, CR LF |
//! | Bota | calibration rows change the decoupling | accepted and ignored |
//! | Robotous | Ethernet, EtherCAT, RS-485 | CAN and UART |
//! | Robotous | reboot applies new ids and baud | they are stored and read back; there is no reboot |
//! | Robotous | padding of ASCII fields unknown | NUL |
//! | Robotous | filter in the sensor's own fast loop | first-order filter at the output rate |
//! | OptoForce | three axes, several sensors at a converter | one sensor of six axes |
//! | OptoForce | filter in the sensor's own fast loop | first-order filter at the output rate |
//! | Leptrino | FIR filter settings (A6, B6) | answered as unknown |
//! | ATI | sixteen calibrations, ids and bit rate that can be set, diagnostics | one matrix under every number; not answered |
//! | Dynamixel | moves when its torque is on | only senses; registers can be written |
//! | Dynamixel | bulk read, fast sync read, reboot, factory reset | instruction error |
//! | Dynamixel | half duplex with echo on some adapters | no echo |
//! | AMT21 | turns counter, reset, zero | not answered |
//! | tracker | glasses over their own software | our own stream, `pose_stream` |
//! | CAN | arbitration, error frames, bus-off | none; frames keep their order |
//! | gripper | pads and wrist give way | rigid grasp, unless a scenario's `[[undeclared]]` says otherwise |
#![forbid(unsafe_code)]

mod amt21;
mod ati_netcanoem;
mod bota_serial;
pub mod bus;
mod clock;
mod crc;
mod device;
mod dynamixel;
mod encoder_line;
mod hold;
mod jaw;
mod kunwei_kwr75;
mod leptrino;
mod measurement;
mod motion;
mod optoforce;
mod person;
mod pose_stream;
mod pose_tracker;
mod random;
mod robotous;
pub mod scenario;
mod scene;
pub mod sealed;
pub mod server;
mod setting;
mod simulation;
mod tool;
mod truth;
pub mod world;
mod wrench_sensor;

pub use bus::{Bus, SimCanLink, SimSerialLink};
pub use scenario::{Scenario, ScenarioError};
pub use sealed::{SealedDraw, SealedError, SealedOptions};
pub use server::{Port, ServeError, ServeOptions, ServedPort, Server};
pub use simulation::{Fitted, KnownSetup, PayloadEstimate, SettingValue, Simulation};
pub use truth::Truth;
