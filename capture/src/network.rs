//! The Zenoh session: loopback only unless asked, no multicast.

use crate::config::Network;
use crate::sink::SinkError;

/// Where the session listens when nothing was asked: where ROS 2 nodes on this host look for a router.
pub const DEFAULT_ENDPOINT: &str = "tcp/127.0.0.1:7447";

/// Where a router listens: every interface, because it was asked for.
pub const ROUTER_ENDPOINT: &str = "tcp/[::]:7447";

/// A session, and how it came about.
#[derive(Debug)]
pub struct Opened {
    /// The session.
    pub session: zenoh::Session,
    /// One line for the operator: where it listens or what it joined.
    pub how: String,
}

/// Opens the capture service's session.
///
/// With neither `listen` nor `connect`, it listens on [`DEFAULT_ENDPOINT`]. It never joins what it was not told to join.
///
/// # Errors
/// An endpoint is malformed, or its port cannot be opened or reached.
pub fn open(network: &Network) -> Result<Opened, SinkError> {
    if network.router {
        let listen = if network.listen.is_empty() {
            vec![ROUTER_ENDPOINT.to_owned()]
        } else {
            network.listen.clone()
        };
        let session = start("router", &listen, &network.connect)?;
        return Ok(Opened {
            session,
            how: format!("zenoh router on {}", listen.join(", ")),
        });
    }
    if !network.listen.is_empty() || !network.connect.is_empty() {
        let session = start("peer", &network.listen, &network.connect)?;
        let mut how = Vec::new();
        if !network.listen.is_empty() {
            how.push(format!("listening on {}", network.listen.join(", ")));
        }
        if !network.connect.is_empty() {
            how.push(format!("connected to {}", network.connect.join(", ")));
        }
        return Ok(Opened {
            session,
            how: format!("zenoh {}", how.join(", ")),
        });
    }
    let session = start("peer", &[DEFAULT_ENDPOINT.to_owned()], &[]).map_err(|error| SinkError::Zenoh {
        what: "listening on this host",
        why: format!(
            "{error}; when something else holds the port, --connect {DEFAULT_ENDPOINT} joins it and --listen \
             tcp/127.0.0.1:7448 takes another"
        ),
    })?;
    Ok(Opened {
        session,
        how: format!("zenoh on {DEFAULT_ENDPOINT} (this host only)"),
    })
}

/// Opens a viewer's session: it only connects.
///
/// # Errors
/// Nothing answers at the endpoint.
pub fn connect(endpoints: &[String]) -> Result<zenoh::Session, SinkError> {
    start("client", &[], endpoints)
}

fn start(mode: &str, listen: &[String], connect: &[String]) -> Result<zenoh::Session, SinkError> {
    use zenoh::Wait;
    let mut config = zenoh::Config::default();
    let json = |endpoints: &[String]| serde_json::Value::from(endpoints.to_vec()).to_string();
    for (key, value) in [
        ("mode", format!("\"{mode}\"")),
        ("listen/endpoints", json(listen)),
        ("connect/endpoints", json(connect)),
        ("scouting/multicast/enabled", "false".to_owned()),
        ("connect/timeout_ms", "3000".to_owned()),
        ("connect/exit_on_failure", "true".to_owned()),
    ] {
        config
            .insert_json5(key, &value)
            .map_err(|error| SinkError::Zenoh {
                what: "setting of the session",
                why: format!("{key} = {value}: {error}"),
            })?;
    }
    zenoh::open(config)
        .wait()
        .map_err(|error| SinkError::Zenoh {
            what: "opening the session",
            why: explain(&error, listen, connect),
        })
}

fn explain(error: &zenoh::Error, listen: &[String], connect: &[String]) -> String {
    let wanted: Vec<_> = listen.iter().chain(connect).map(String::as_str).collect();
    format!(
        "{} (endpoints look like tcp/192.168.0.7:7447): {error}",
        wanted.join(", ")
    )
}
