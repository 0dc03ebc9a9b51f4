//! The Foxglove WebSocket protocol, for Foxglove, Lichtblick and PlotJuggler: every topic as it is, and what
//! [`crate::live::derived`] adds.
//!
//! ```text
//! server, text    {"op":"serverInfo",...}  {"op":"advertise","channels":[{id,topic,encoding,schemaName,schema,...}]}
//! client, text    {"op":"subscribe","subscriptions":[{id,channelId}]}  {"op":"unsubscribe","subscriptionIds":[..]}
//! server, binary  01 | u32 subscription | u64 ns since the Unix epoch | CDR          all little endian
//! ```
//!
//! Written from the published protocol instead of with the `foxglove` crate: that would add protocol buffers and a
//! second WebSocket server, without the limits of ours.
//!
//! # Source
//! `foxglove/ws-protocol` `docs/spec.md`; names of the subprotocols from `foxglove` 0.30.3 and Lichtblick.

use std::collections::HashMap;
use std::net::{IpAddr, SocketAddr};
use std::sync::Arc;
use std::time::Duration;

use axum::Router;
use axum::body::Bytes;
use axum::extract::ws::{Message as Frame, WebSocket, WebSocketUpgrade};
use axum::extract::{ConnectInfo, State};
use axum::http::{HeaderMap, StatusCode, header};
use axum::response::{IntoResponse as _, Response};
use axum::routing::get;
use ft_drivers::{Clock as _, MonotonicClock};
use ft_recording::message::{
    DiagnosticArray, JointState, Marker, Message, PoseStamped, TFMessage, Temperature, Text,
    WrenchStamped,
};
use ft_recording::topic;
use serde::Deserialize;
use serde_json::{Value, json};
use tokio::sync::broadcast;

use crate::live::Hub;
use crate::live::derived::{FORCE_ARROW, TF, WRENCH_VIEW};
use crate::live::hub::Whole;
use crate::web::{Allowance, PATIENCE, Refusals, Server, Visitor, WebError, Why, start};

/// Where Foxglove looks when nothing else is said.
pub const DEFAULT_ADDRESS: &str = "127.0.0.1:8765";
/// Subprotocols: today's name and the one before.
const PROTOCOLS: [&str; 2] = ["foxglove.sdk.v1", "foxglove.websocket.v1"];
/// The longest message of a client, bytes.
const LONGEST_MESSAGE: usize = 64 * 1024;
/// Subscriptions of one client.
const MOST_SUBSCRIPTIONS: usize = 64;
/// Messages of one client a second, and how many at once.
const WORDS_PER_SECOND: f64 = 20.0;
const WORDS_AT_ONCE: f64 = 200.0;
/// Pages that may connect although they are not ours: the web applications. Programs have no origin.
const ORIGINS: [&str; 2] = ["https://app.foxglove.dev", "https://studio.foxglove.dev"];

/// Serves every topic of `hub` on `address`. It only shows: there is nothing to command.
///
/// # Errors
/// The port cannot be opened.
pub fn serve(hub: Arc<Hub>, address: SocketAddr) -> Result<Server, WebError> {
    serve_with(hub, address, PATIENCE)
}

fn serve_with(hub: Arc<Hub>, address: SocketAddr, patience: Duration) -> Result<Server, WebError> {
    let clock = MonotonicClock::anchored_now();
    let refusals = Arc::new(Refusals::new(clock));
    let desk = Desk {
        hub,
        refusals: Arc::clone(&refusals),
        channels: Arc::new(channels()),
        clock,
        patience,
    };
    let app = Router::new().route("/", get(connect)).with_state(desk);
    start(app, address, refusals, String::new())
}

#[derive(Clone)]
struct Desk {
    hub: Arc<Hub>,
    refusals: Arc<Refusals>,
    channels: Arc<Vec<Channel>>,
    clock: MonotonicClock,
    /// How long a client may take no bytes, or not answer a ping, before it is let go.
    patience: Duration,
}

/// One topic; its id is its place and 1.
struct Channel {
    topic: &'static str,
    type_name: &'static str,
    definition: &'static str,
}

fn channels() -> Vec<Channel> {
    fn of<M: Message>(topic: &'static str) -> Channel {
        Channel {
            topic,
            type_name: M::TYPE_NAME,
            definition: M::DEFINITION,
        }
    }
    vec![
        of::<WrenchStamped>(topic::WRENCH),
        of::<WrenchStamped>(WRENCH_VIEW),
        of::<Marker>(FORCE_ARROW),
        of::<Temperature>(topic::TEMPERATURE),
        of::<JointState>(topic::GRIPPER),
        of::<PoseStamped>(topic::ARIA_POSE),
        of::<PoseStamped>(topic::TCP_POSE),
        of::<TFMessage>(TF),
        of::<TFMessage>(topic::TF_STATIC),
        of::<Text>(topic::MARKS),
        of::<DiagnosticArray>(topic::DIAGNOSTICS),
    ]
}

async fn connect(
    State(desk): State<Desk>,
    ConnectInfo(visitor): ConnectInfo<Visitor>,
    headers: HeaderMap,
    upgrade: WebSocketUpgrade,
) -> Response {
    if !origin_may_look(&headers) {
        desk.refusals.add(Why::Origin, visitor.address.ip());
        return (
            StatusCode::FORBIDDEN,
            "pages of this origin may not connect\n",
        )
            .into_response();
    }
    let upgrade = upgrade
        .protocols(PROTOCOLS)
        .max_message_size(LONGEST_MESSAGE)
        .max_frame_size(LONGEST_MESSAGE)
        .write_buffer_size(0);
    if upgrade.selected_protocol().is_none() {
        let text = format!("offer one of the subprotocols {}\n", PROTOCOLS.join(", "));
        return (StatusCode::BAD_REQUEST, text).into_response();
    }
    visitor.stay();
    upgrade.on_upgrade(move |socket| async move {
        desk.hub.add_viewer();
        // A client that left or does not read is gone; there is nobody to tell.
        let _ = show(socket, &desk, visitor.address.ip()).await;
        desk.hub.remove_viewer();
    })
}

/// Programs, the known web applications, and pages that were served by this machine or by an application's own files.
fn origin_may_look(headers: &HeaderMap) -> bool {
    let Some(origin) = headers.get(header::ORIGIN) else {
        return true;
    };
    let Ok(origin) = origin.to_str() else {
        return false;
    };
    let host = origin.split_once("://").map_or("", |(_, host)| host);
    let host = host.rsplit_once(':').map_or(host, |(host, _port)| host);
    ORIGINS.contains(&origin)
        || origin.starts_with("file://")
        || ["localhost", "127.0.0.1", "[::1]"].contains(&host)
}

/// What a client may say.
#[derive(Deserialize)]
#[serde(tag = "op", rename_all = "camelCase")]
enum Request {
    Subscribe {
        subscriptions: Vec<Subscription>,
    },
    #[serde(rename_all = "camelCase")]
    Unsubscribe {
        subscription_ids: Vec<u32>,
    },
    #[serde(other)]
    Other,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct Subscription {
    id: u32,
    channel_id: usize,
}

/// Why a client is served no longer.
struct Gone;

async fn show(mut socket: WebSocket, desk: &Desk, from: IpAddr) -> Result<(), Gone> {
    let mut words = Allowance::new(WORDS_PER_SECOND, WORDS_AT_ONCE, desk.clock.now());
    let mut messages = desk.hub.watch_messages();
    let mut wanted: HashMap<&'static str, u32> = HashMap::new();
    // Who vanished without a word answers no ping, and would hold its place for good where it wants nothing that is sent.
    let mut ping = tokio::time::interval(desk.patience / 3);
    let mut heard = desk.clock.now();
    let patience = desk.patience;
    send(&mut socket, text(&server_info()), patience).await?;
    send(&mut socket, text(&advertise(&desk.channels)), patience).await?;
    loop {
        tokio::select! {
            _ = ping.tick() => {
                if desk.clock.now().saturating_since(heard) > patience {
                    return Err(Gone);
                }
                send(&mut socket, Frame::Ping(Bytes::new()), patience).await?;
            }
            message = messages.recv() => match message {
                Ok(message) => {
                    if let Some(id) = wanted.get(&*message.topic) {
                        send(&mut socket, data(*id, &message), patience).await?;
                    }
                }
                Err(broadcast::error::RecvError::Lagged(lost)) => desk.hub.add_viewer_drops(lost),
                Err(broadcast::error::RecvError::Closed) => return Ok(()),
            },
            said = socket.recv() => {
                heard = desk.clock.now();
                match said {
                Some(Ok(_)) if !words.spend(desk.clock.now()) => {
                    desk.refusals.add(Why::TooMuch, from);
                    return Err(Gone);
                }
                Some(Ok(Frame::Text(said))) => {
                    for latched in take_request(&said, desk, &mut wanted) {
                        send(&mut socket, latched, patience).await?;
                    }
                }
                Some(Ok(_)) => {}
                Some(Err(_)) | None => return Err(Gone),
                }
            },
        }
    }
}

async fn send(socket: &mut WebSocket, frame: Frame, patience: Duration) -> Result<(), Gone> {
    match tokio::time::timeout(patience, socket.send(frame)).await {
        Ok(Ok(())) => Ok(()),
        Ok(Err(_)) | Err(_) => Err(Gone),
    }
}

/// Changes what is wanted; what is to be sent at once, because it comes too rarely to wait for, or in answer.
fn take_request(said: &str, desk: &Desk, wanted: &mut HashMap<&'static str, u32>) -> Vec<Frame> {
    let mut out = Vec::new();
    match serde_json::from_str(said) {
        Ok(Request::Subscribe { subscriptions }) => {
            for subscription in subscriptions.into_iter().take(MOST_SUBSCRIPTIONS) {
                let channel = subscription
                    .channel_id
                    .checked_sub(1)
                    .and_then(|place| desk.channels.get(place));
                let Some(channel) = channel else {
                    out.push(status(&format!(
                        "there is no channel {}",
                        subscription.channel_id
                    )));
                    continue;
                };
                wanted.insert(channel.topic, subscription.id);
                if channel.topic == topic::TF_STATIC {
                    out.extend(
                        desk.hub
                            .static_transforms()
                            .map(|latched| data(subscription.id, &latched)),
                    );
                }
            }
        }
        Ok(Request::Unsubscribe { subscription_ids }) => {
            wanted.retain(|_, id| !subscription_ids.contains(id));
        }
        Ok(Request::Other) => out.push(status(
            "this server only shows: it takes subscribe and unsubscribe",
        )),
        Err(error) => out.push(status(&error.to_string())),
    }
    out
}

fn text(value: &Value) -> Frame {
    Frame::Text(value.to_string().into())
}

fn status(message: &str) -> Frame {
    text(&json!({"op": "status", "level": 1, "message": message}))
}

fn server_info() -> Value {
    json!({
        "op": "serverInfo",
        "name": concat!("ft-capture ", env!("CARGO_PKG_VERSION")),
        "capabilities": [],
        "supportedEncodings": [],
        "metadata": {},
        "sessionId": "",
    })
}

fn advertise(channels: &[Channel]) -> Value {
    let channels: Vec<_> = channels
        .iter()
        .enumerate()
        .map(|(place, channel)| {
            json!({
                "id": place + 1,
                "topic": channel.topic,
                "encoding": "cdr",
                "schemaName": channel.type_name,
                "schema": channel.definition,
                "schemaEncoding": "ros2msg",
            })
        })
        .collect();
    json!({"op": "advertise", "channels": channels})
}

fn data(subscription: u32, message: &Whole) -> Frame {
    let mut bytes = Vec::with_capacity(13 + message.payload.len());
    bytes.push(1);
    bytes.extend(subscription.to_le_bytes());
    bytes.extend(message.at.as_nanos().to_le_bytes());
    bytes.extend_from_slice(&message.payload);
    Frame::Binary(Bytes::from(bytes))
}

#[cfg(test)]
mod tests {
    use super::*;
    use ft_wire::HostTime;

    fn from(origin: &str) -> HeaderMap {
        HeaderMap::from_iter([(header::ORIGIN, origin.parse().unwrap())])
    }

    #[test]
    fn any_page_of_the_web_may_not_look() {
        for origin in [
            "https://app.foxglove.dev",
            "http://localhost:8081",
            "http://127.0.0.1",
            "file://",
        ] {
            assert!(origin_may_look(&from(origin)), "{origin}");
        }
        for origin in [
            "https://evil.example",
            "http://localhost.evil.example",
            "null",
            "https://app.foxglove.dev.evil.example",
        ] {
            assert!(!origin_may_look(&from(origin)), "{origin}");
        }
        assert!(origin_may_look(&HeaderMap::new()));
    }

    #[test]
    fn subscriptions_come_and_go() {
        let desk = Desk {
            hub: Arc::new(Hub::new("here")),
            refusals: Arc::new(Refusals::new(MonotonicClock::anchored_now())),
            channels: Arc::new(channels()),
            clock: MonotonicClock::anchored_now(),
            patience: PATIENCE,
        };
        let mut wanted = HashMap::new();
        let subscribe = r#"{"op":"subscribe","subscriptions":[{"id":7,"channelId":1},{"id":8,"channelId":99}]}"#;
        assert_eq!(
            take_request(subscribe, &desk, &mut wanted).len(),
            1,
            "99 is refused"
        );
        assert_eq!(wanted.get("/ft/wrench"), Some(&7));
        take_request(
            r#"{"op":"unsubscribe","subscriptionIds":[7]}"#,
            &desk,
            &mut wanted,
        );
        assert!(wanted.is_empty());
        for said in ["", "{}", r#"{"op":"advertise"}"#, "[1"] {
            assert_eq!(take_request(said, &desk, &mut wanted).len(), 1, "{said}");
        }
    }

    #[test]
    fn a_client_that_vanished_is_let_go() {
        use std::io::{Read as _, Write as _};
        let hub = Arc::new(Hub::new("here"));
        let patience = Duration::from_millis(300);
        let server = serve_with(hub, "127.0.0.1:0".parse().unwrap(), patience).unwrap();
        let mut client = std::net::TcpStream::connect(server.address).unwrap();
        client
            .set_read_timeout(Some(Duration::from_secs(20)))
            .unwrap();
        let request = "GET / HTTP/1.1\r\nHost: localhost\r\nConnection: Upgrade\r\nUpgrade: websocket\r\n\
            Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\
            Sec-WebSocket-Protocol: foxglove.sdk.v1\r\n\r\n";
        client.write_all(request.as_bytes()).unwrap();
        // It answers no ping; the connection is closed all the same.
        let mut said = Vec::new();
        client.read_to_end(&mut said).unwrap();
        assert!(said.starts_with(b"HTTP/1.1 101"));
        assert!(said.windows(2).any(|two| two == [0x89, 0]), "a ping");
    }

    #[test]
    fn a_message_is_laid_out_as_the_protocol_says() {
        let message = Whole {
            topic: "/t".into(),
            at: HostTime::from_nanos(0x0102_0304),
            payload: Bytes::from_static(&[9, 8]),
        };
        let Frame::Binary(bytes) = data(0x0a0b, &message) else {
            panic!("no binary frame")
        };
        assert_eq!(
            &bytes[..],
            [1, 0x0b, 0x0a, 0, 0, 4, 3, 2, 1, 0, 0, 0, 0, 9, 8]
        );
    }
}
