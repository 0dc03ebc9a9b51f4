//! The hub: see [`crate::live`].

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use axum::body::Bytes;
use axum::extract::ws::Utf8Bytes;
use ft_recording::message::Message;
use ft_recording::topic;
use ft_wire::HostTime;
use nalgebra::Isometry3;
use serde_json::{Value, json};
use tokio::sync::broadcast;

use super::derived;
use super::picture::Picture;
use super::strip::{Bin, Decimator};

/// How often a strip goes out, at most.
const STRIP_PERIOD: Duration = Duration::from_millis(20);
/// How often the state goes out.
const STATE_PERIOD: Duration = Duration::from_millis(250);
/// How often rates are taken.
const RATE_PERIOD: Duration = Duration::from_secs(1);
/// Frames that one page may be behind: about a second.
const FRAMES_BEHIND: usize = 64;
/// Messages that one Foxglove client may be behind: over a second at 1 kHz for every stream.
const MESSAGES_BEHIND: usize = 4096;

/// One message as the hub takes it.
#[derive(Clone, Copy, Debug)]
pub struct Sample<'a> {
    /// Topic without the namespace, `/ft/wrench`.
    pub topic: &'a str,
    /// ROS 2 type, `geometry_msgs/msg/WrenchStamped`.
    pub type_name: &'a str,
    /// CDR.
    pub payload: &'a [u8],
    /// When it was true, at the source.
    pub at: HostTime,
    /// The publisher's id and its number of this message; `None` where nothing lies between.
    pub numbered: Option<([u8; 16], i64)>,
}

/// What goes to a page.
#[derive(Clone, Debug)]
pub enum Frame {
    /// Bins, tool and width: the layout of [`Hub::strip`].
    Strip(Bytes),
    /// Everything that changes slowly, as JSON.
    State(Utf8Bytes),
}

/// A message for those who want every one.
#[derive(Clone, Debug)]
pub struct Whole {
    /// Topic.
    pub topic: Arc<str>,
    /// When it was true.
    pub at: HostTime,
    /// CDR.
    pub payload: Bytes,
}

impl Whole {
    pub(super) fn new(topic: &str, at: HostTime, message: &impl Message) -> Self {
        let mut payload = Vec::new();
        message.encode(&mut payload);
        Self {
            topic: topic.into(),
            at,
            payload: payload.into(),
        }
    }
}

/// See [`crate::live`].
#[derive(Debug)]
pub struct Hub {
    inner: Mutex<Inner>,
    frames: broadcast::Sender<Frame>,
    messages: broadcast::Sender<Whole>,
    viewers: AtomicU64,
    viewer_drops: AtomicU64,
}

#[derive(Debug)]
struct Inner {
    picture: Picture,
    strip: Decimator,
    frame_number: u32,
    strip_due: HostTime,
    state_due: HostTime,
    rates_due: HostTime,
}

impl Hub {
    /// A hub of what `source` publishes.
    #[must_use]
    pub fn new(source: &str) -> Self {
        Self {
            inner: Mutex::new(Inner {
                picture: Picture::new(source),
                strip: Decimator::default(),
                frame_number: 0,
                strip_due: HostTime::EPOCH,
                state_due: HostTime::EPOCH,
                rates_due: HostTime::EPOCH,
            }),
            frames: broadcast::Sender::new(FRAMES_BEHIND),
            messages: broadcast::Sender::new(MESSAGES_BEHIND),
            viewers: AtomicU64::new(0),
            viewer_drops: AtomicU64::new(0),
        }
    }

    /// Takes one message. Waits for no viewer.
    pub fn take(&self, sample: &Sample<'_>) {
        let mut inner = self.lock();
        inner.picture.take(sample);
        if let (topic::WRENCH, Some((wrench, at))) = (sample.topic, inner.picture.wrench) {
            inner.strip.take(at.as_nanos(), wrench);
        }
        drop(inner);
        if self.messages.receiver_count() > 0 {
            // Nobody may have stayed.
            let _ = self.messages.send(Whole {
                topic: sample.topic.into(),
                at: sample.at,
                payload: Bytes::copy_from_slice(sample.payload),
            });
        }
    }

    /// Time went by: sends what is due. To be called at least every 20 ms.
    pub fn tick(&self, now: HostTime) {
        let mut inner = self.lock();
        if now >= inner.rates_due {
            inner.rates_due = now + RATE_PERIOD;
            inner.picture.measure_rates(now);
        }
        let mut derived = Vec::new();
        let strip = (now >= inner.strip_due).then(|| {
            inner.strip_due = next(inner.strip_due, STRIP_PERIOD, now);
            let bins: Vec<Bin> = inner.strip.drain().collect();
            bins.iter().for_each(|bin| inner.picture.remember(*bin));
            if self.messages.receiver_count() > 0 {
                derived = derived::messages(&inner.picture, &bins);
            }
            inner.strip(&bins)
        });
        let state = (now >= inner.state_due).then(|| {
            inner.state_due = next(inner.state_due, STATE_PERIOD, now);
            self.state(&inner.picture, now)
        });
        drop(inner);
        for message in derived {
            let _ = self.messages.send(message);
        }
        if self.frames.receiver_count() == 0 {
            return;
        }
        for frame in strip
            .map(|bytes| Frame::Strip(bytes.into()))
            .into_iter()
            .chain(state.map(|state| Frame::State(state.to_string().into())))
        {
            let _ = self.frames.send(frame);
        }
    }

    /// The capture service said how it stands.
    pub fn set_status(&self, status: Value, now: HostTime) {
        self.lock().picture.status = Some((status, now));
    }

    /// Looks at the latest of everything.
    pub fn look<T>(&self, at: impl FnOnce(&Picture) -> T) -> T {
        at(&self.lock().picture)
    }

    /// A page's place: it gets every frame that it is not more than a second behind.
    #[must_use]
    pub fn watch_frames(&self) -> broadcast::Receiver<Frame> {
        self.frames.subscribe()
    }

    /// A place for who wants every message.
    #[must_use]
    pub fn watch_messages(&self) -> broadcast::Receiver<Whole> {
        self.messages.subscribe()
    }

    /// The latest `/tf_static`, which comes too rarely to wait for.
    #[must_use]
    pub fn static_transforms(&self) -> Option<Whole> {
        let inner = self.lock();
        let (payload, at) = inner.picture.static_transforms.as_ref()?;
        Some(Whole {
            topic: topic::TF_STATIC.into(),
            at: *at,
            payload: Bytes::copy_from_slice(payload),
        })
    }

    /// A viewer came.
    pub fn add_viewer(&self) {
        self.viewers.fetch_add(1, Ordering::Relaxed);
    }

    /// A viewer left.
    pub fn remove_viewer(&self) {
        self.viewers.fetch_sub(1, Ordering::Relaxed);
    }

    /// A viewer was so far behind that `count` frames or messages were dropped for it.
    pub fn add_viewer_drops(&self, count: u64) {
        self.viewer_drops.fetch_add(count, Ordering::Relaxed);
    }

    /// Viewers now, and what all viewers together have lost by being slow.
    #[must_use]
    pub fn viewers(&self) -> (u64, u64) {
        (
            self.viewers.load(Ordering::Relaxed),
            self.viewer_drops.load(Ordering::Relaxed),
        )
    }

    fn state(&self, picture: &Picture, now: HostTime) -> Value {
        let (viewers, drops) = self.viewers();
        json!({
            "now_s": now.as_nanos() as f64 * 1e-9,
            "source": picture.source,
            "status": picture.status.as_ref().map(|(status, _)| status),
            "status_age_s": picture.status.as_ref().map(|(_, at)| now.seconds_since(*at)),
            "topics": picture.topics,
            "marks": picture.marks,
            "undecodable": picture.undecodable,
            "viewers": viewers,
            "viewer_drops": drops,
        })
    }

    /// A thread that panicked while it held the picture left one that is still worth showing.
    fn lock(&self) -> MutexGuard<'_, Inner> {
        self.inner.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Inner {
    /// One strip, little endian; what is not known is NaN:
    ///
    /// ```text
    /// 0   u32    number of the frame: a hole shows what this viewer lost
    /// 4   u32    bins
    /// 8   f64    time, s since the Unix epoch: of the latest wrench
    /// 16  f32    gripper width, m
    /// 20  f32[6] latest force N, torque N m, in `ft_sensor`
    /// 44  f32[7] world_from_tcp: m, quaternion x y z w
    /// 72  f32[7] tcp_from_ft_sensor
    /// 100 bins x { f32 begin, s after the time; f32[6] least; f32[6] greatest }
    /// ```
    fn strip(&mut self, bins: &[Bin]) -> Vec<u8> {
        let picture = &self.picture;
        let (wrench, at_ns) = picture
            .wrench
            .map_or(([f64::NAN; 6], 0), |(wrench, at)| (wrench, at.as_nanos()));
        let mut out = Vec::with_capacity(100 + 52 * bins.len());
        self.frame_number = self.frame_number.wrapping_add(1);
        out.extend(self.frame_number.to_le_bytes());
        out.extend(u32::try_from(bins.len()).unwrap_or(0).to_le_bytes());
        out.extend((at_ns as f64 * 1e-9).to_le_bytes());
        put(&mut out, &[picture.width_m.unwrap_or(f64::NAN)]);
        put(&mut out, &wrench);
        let unknown = [f64::NAN; 7];
        put(&mut out, &picture.world_from_tcp().map_or(unknown, parts));
        put(&mut out, &parts(picture.tcp_from_sensor()));
        for bin in bins {
            put(&mut out, &[(bin.begin_ns - at_ns) as f64 * 1e-9]);
            for value in bin.least.into_iter().chain(bin.greatest) {
                out.extend(value.to_le_bytes());
            }
        }
        out
    }
}

/// When it is due again: a period after it was due, so that the mean rate holds although nobody is punctual.
fn next(due: HostTime, period: Duration, now: HostTime) -> HostTime {
    let next = due + period;
    if next <= now { now + period } else { next }
}

fn parts(pose: Isometry3<f64>) -> [f64; 7] {
    let (at, turn) = (pose.translation.vector, pose.rotation.coords);
    [at.x, at.y, at.z, turn.x, turn.y, turn.z, turn.w]
}

#[allow(clippy::cast_possible_truncation, reason = "for drawing")]
fn put(out: &mut Vec<u8>, values: &[f64]) {
    for value in values {
        out.extend((*value as f32).to_le_bytes());
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ft_recording::message::WrenchStamped;

    fn at(milliseconds: i64) -> HostTime {
        HostTime::from_nanos(milliseconds * 1_000_000)
    }

    fn feed(hub: &Hub, milliseconds: std::ops::Range<i64>) {
        let mut payload = Vec::new();
        let mut message = WrenchStamped::default();
        message.wrench.force.z = -3.0;
        message.encode(&mut payload);
        for now in milliseconds {
            hub.take(&Sample {
                topic: topic::WRENCH,
                type_name: WrenchStamped::TYPE_NAME,
                payload: &payload,
                at: at(now),
                numbered: None,
            });
            hub.tick(at(now));
        }
    }

    #[test]
    fn a_second_of_samples_is_fifty_strips_and_four_states() {
        let hub = Hub::new("here");
        let mut frames = hub.watch_frames();
        feed(&hub, 1000..2000);
        let (mut strips, mut states, mut bins) = (0, 0, 0);
        while let Ok(frame) = frames.try_recv() {
            match frame {
                Frame::Strip(bytes) => {
                    strips += 1;
                    let count = u32::from_le_bytes(bytes[4..8].try_into().unwrap()) as usize;
                    assert_eq!(bytes.len(), 100 + 52 * count);
                    assert_eq!(&bytes[28..32], (-3.0_f32).to_le_bytes(), "the latest fz");
                    bins += count;
                }
                Frame::State(text) => {
                    states += 1;
                    let state: Value = serde_json::from_str(&text).unwrap();
                    assert!(
                        state["topics"]["/ft/wrench"]["received"].is_u64(),
                        "{state}"
                    );
                }
            }
        }
        assert_eq!((strips, states), (50, 4));
        assert!((98..=99).contains(&bins), "{bins} bins of 10 ms");
    }

    #[test]
    fn a_viewer_that_sleeps_loses_the_oldest_and_holds_nobody_up() {
        let hub = Hub::new("here");
        let (mut sleeper, mut awake) = (hub.watch_frames(), hub.watch_frames());
        let mut got = 0;
        for begin in (0..60_000).step_by(20) {
            feed(&hub, begin..begin + 20);
            while awake.try_recv().is_ok() {
                got += 1;
            }
        }
        let lost = match sleeper.try_recv() {
            Err(broadcast::error::TryRecvError::Lagged(lost)) => lost,
            other => panic!("{other:?}"),
        };
        let mut kept = 0;
        while sleeper.try_recv().is_ok() {
            kept += 1;
        }
        assert_eq!((kept, lost + kept), (FRAMES_BEHIND as u64, got));
    }

    #[test]
    fn who_wants_every_message_gets_every_one() {
        let hub = Hub::new("here");
        feed(&hub, 0..10);
        let mut messages = hub.watch_messages();
        feed(&hub, 10..30);
        let mut times = Vec::new();
        while let Ok(message) = messages.try_recv() {
            if &*message.topic != topic::WRENCH {
                continue;
            }
            times.push(message.at.as_nanos() / 1_000_000);
        }
        assert_eq!(times, (10..30).collect::<Vec<_>>());
    }
}
