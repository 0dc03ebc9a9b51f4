//! The Zenoh session: loopback only unless asked, no multicast, and encrypted with roles when it has keys.

use std::path::Path;

use serde_json::{Value, json};

use crate::config::Network;
use crate::keys::{self, Proof, Roles};
use crate::sink::SinkError;

/// Where the session listens when nothing was asked: where ROS 2 nodes on this host look for a router.
pub const DEFAULT_ENDPOINT: &str = "tcp/127.0.0.1:7447";

/// Where a router listens: every interface, because it was asked for.
pub const ROUTER_ENDPOINT: &str = "tcp/[::]:7447";

/// The longest message that is put together from fragments, bytes; ours have some hundreds.
const LONGEST_MESSAGE: u32 = 1 << 20;
/// Viewers, recorders and ROS 2 nodes at one time.
const MOST_SESSIONS: u32 = 200;

/// How Zenoh's threads are set, and where: one thread receives and sends.
const RUNTIME: (&str, &str) = (
    "ZENOH_RUNTIME",
    "(tx: (handover: rx), rx: (worker_threads: 1))",
);

/// Lets one thread of Zenoh's receive and send, as links with keys need it.
///
/// Zenoh's TLS link shares one unguarded stream between its reader and its writer (eclipse-zenoh/zenoh#2557): read and written by two threads at
/// a time, which is undefined behaviour, the link of a viewer that asked while samples came broke about once a second. In the clear nothing is
/// shared, and two threads stay: what waits for a slow receiver would hold up the one. A `ZENOH_RUNTIME` that is set stands.
///
/// # Safety
/// No other thread runs: the environment is written.
pub unsafe fn receive_and_send_in_one_thread() {
    let (name, value) = RUNTIME;
    match std::env::var(name) {
        Ok(set) if set == value => {}
        Ok(_) => tracing::warn!(
            "{name} is set: unless Zenoh then receives and sends in one thread, links with keys may break (zenoh#2557)"
        ),
        // SAFETY: the caller's, that no other thread reads the environment meanwhile.
        Err(_) => unsafe { std::env::set_var(name, value) },
    }
}

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
/// With neither `listen` nor `connect`, it listens on [`DEFAULT_ENDPOINT`]. It never joins what it was not told to join. Before it has keys,
/// [`receive_and_send_in_one_thread`].
///
/// # Errors
/// An endpoint is malformed, its port cannot be opened or reached, or the keys cannot be used.
pub fn open(network: &Network) -> Result<Opened, SinkError> {
    let mut settings = Settings::new(if network.router { "router" } else { "peer" });
    let (default, kind) = match (network.router, network.asks_for_nothing()) {
        (true, _) => (Some(ROUTER_ENDPOINT), " router"),
        (false, true) => (Some(DEFAULT_ENDPOINT), ""),
        (false, false) => (None, ""),
    };
    let mut listen = network.listen.clone();
    if let (true, Some(default)) = (listen.is_empty(), default) {
        listen.push(default.to_owned());
    }
    listen.iter_mut().for_each(complete);
    let mut connect = network.connect.clone();
    connect.iter_mut().for_each(complete);
    if let Some(folder) = &network.keys {
        listen.iter_mut().chain(&mut connect).for_each(encrypt);
        settings.secure_service(folder)?;
    }
    let opened = settings.open(&listen, &connect);
    let session = match (opened, network.asks_for_nothing()) {
        (Err(error), true) => {
            return Err(SinkError::Zenoh {
                what: "listening on this host",
                why: format!(
                    "{error}; when something else holds the port, --connect {DEFAULT_ENDPOINT} joins it and --listen \
                     tcp/127.0.0.1:7448 takes another"
                ),
            });
        }
        (opened, _) => opened?,
    };
    let mut how = Vec::new();
    if !listen.is_empty() {
        how.push(format!("listening on {}", listen.join(", ")));
    }
    if !connect.is_empty() {
        how.push(format!("connected to {}", connect.join(", ")));
    }
    let only = if network.asks_for_nothing() {
        " (this host only)"
    } else {
        ""
    };
    Ok(Opened {
        session,
        how: format!("zenoh{kind} {}{only}", how.join(", ")),
    })
}

/// Opens a viewer's session: it only connects, with the keys in `keys` where the capture asks for them; before it has some,
/// [`receive_and_send_in_one_thread`].
///
/// # Errors
/// Nothing answers at the endpoint, or it does not let this viewer in.
pub fn connect(endpoints: &[String], keys: Option<&Path>) -> Result<zenoh::Session, SinkError> {
    let mut settings = Settings::new("client");
    let mut endpoints = endpoints.to_vec();
    endpoints.iter_mut().for_each(complete);
    if let Some(folder) = keys {
        endpoints.iter_mut().for_each(encrypt);
        settings.secure_viewer(folder)?;
    }
    settings.open(&[], &endpoints)
}

/// An address without a protocol was meant as `tcp/...`.
fn complete(endpoint: &mut String) {
    let address = endpoint.split(['?', '#']).next();
    if !address.is_some_and(|address| address.contains('/')) {
        endpoint.insert_str(0, "tcp/");
    }
}

/// `tcp/...` was meant as `tls/...` by who gave keys.
fn encrypt(endpoint: &mut String) {
    if let Some(rest) = endpoint.strip_prefix("tcp/") {
        *endpoint = format!("tls/{rest}");
    }
}

/// Zenoh's settings as keys and values.
struct Settings(Vec<(&'static str, Value)>);

impl Settings {
    fn new(mode: &str) -> Self {
        Self(vec![
            ("mode", json!(mode)),
            ("scouting/multicast/enabled", json!(false)),
            ("connect/timeout_ms", json!(3000)),
            ("connect/exit_on_failure", json!(true)),
            // A recorder that asks for what it missed and then does not take it is let go, and comes again.
            (
                "transport/link/tx/queue/congestion_control/block/wait_before_close",
                json!(1_000_000),
            ),
            // A message is sent at once; what comes while a viewer stalls shares batches of 64 kB, and 16 of them, a second of 4 kHz,
            // may wait. An express message would take a batch of its own: none is left after 16 messages.
            ("transport/link/tx/queue/batching/time_limit", json!(0)),
            ("transport/link/tx/queue/size/data", json!(16)),
            ("transport/link/rx/max_message_size", json!(LONGEST_MESSAGE)),
            ("transport/unicast/max_sessions", json!(MOST_SESSIONS)),
        ])
    }

    /// Certificates both ways or passwords, and what each role may do.
    fn secure_service(&mut self, folder: &Path) -> Result<(), SinkError> {
        let roles = keys::read_roles(folder)?;
        let file = |name: &str| json!(folder.join(name));
        self.0.extend([
            ("transport/link/tls/root_ca_certificate", file("ca.pem")),
            (
                "transport/link/tls/listen_certificate",
                file("certificate.pem"),
            ),
            ("transport/link/tls/listen_private_key", file("key.pem")),
            (
                "transport/link/tls/connect_certificate",
                file("certificate.pem"),
            ),
            ("transport/link/tls/connect_private_key", file("key.pem")),
            (
                "transport/link/tls/enable_mtls",
                json!(roles.proof == Proof::Certificate),
            ),
            ("transport/link/protocols", json!(["tls"])),
            ("access_control", access_control(&roles)),
        ]);
        if roles.proof == Proof::Password {
            self.0
                .push(("transport/auth/usrpwd/dictionary_file", file("users.txt")));
        }
        Ok(())
    }

    fn secure_viewer(&mut self, folder: &Path) -> Result<(), SinkError> {
        keys::check_of_viewer(folder)?;
        let file = |name: &str| json!(folder.join(name));
        self.0.extend([
            ("transport/link/tls/root_ca_certificate", file("ca.pem")),
            ("transport/link/protocols", json!(["tls"])),
        ]);
        match keys::read_login(folder)? {
            Some(login) => self.0.extend([
                ("transport/auth/usrpwd/user", json!(login.user)),
                ("transport/auth/usrpwd/password", json!(login.password)),
            ]),
            None => self.0.extend([
                ("transport/link/tls/enable_mtls", json!(true)),
                (
                    "transport/link/tls/connect_certificate",
                    file("certificate.pem"),
                ),
                ("transport/link/tls/connect_private_key", file("key.pem")),
            ]),
        }
        Ok(())
    }

    fn open(mut self, listen: &[String], connect: &[String]) -> Result<zenoh::Session, SinkError> {
        use zenoh::Wait;
        self.0.push(("listen/endpoints", json!(listen)));
        self.0.push(("connect/endpoints", json!(connect)));
        let mut config = zenoh::Config::default();
        for (key, value) in self.0 {
            config
                .insert_json5(key, &value.to_string())
                .map_err(|error| SinkError::Zenoh {
                    what: "setting of the session",
                    // Not the value: it may be a password.
                    why: format!("{key}: {}", plainly(&error.to_string())),
                })?;
        }
        zenoh::open(config)
            .wait()
            .map_err(|error| SinkError::Zenoh {
                what: "opening the session",
                why: explain(&error, listen, connect),
            })
    }
}

/// Viewers take samples and ask how it stands; operators also command; nobody publishes, answers or deletes.
fn access_control(roles: &Roles) -> Value {
    let data = json!(["**", "@ros2_lv/**", "**/@adv/**"]);
    let asked = json!(["ft_capture/*/status", "**/@adv/**"]);
    let commands = json!([
        "ft_capture/*/tare",
        "ft_capture/*/mark",
        "ft_capture/*/start",
        "ft_capture/*/stop"
    ]);
    let rule = |id: &str, messages: Value, flow: &str, keys: &Value| json!({"id": id, "messages": messages, "flows": [flow], "permission": "allow", "key_exprs": keys});
    let subject = |id: &str, names: &[String]| match roles.proof {
        Proof::Certificate => json!({"id": id, "cert_common_names": names}),
        Proof::Password => json!({"id": id, "usernames": names}),
    };
    let looks = ["sends", "subscribes", "asks", "answers"];
    let (mut subjects, mut policies) = (Vec::new(), Vec::new());
    if !roles.viewers.is_empty() {
        subjects.push(subject("viewers", &roles.viewers));
        policies.push(json!({"rules": looks, "subjects": ["viewers"]}));
    }
    if !roles.operators.is_empty() {
        subjects.push(subject("operators", &roles.operators));
        let rules = [&looks[..], &["commands", "obeys"]].concat();
        policies.push(json!({"rules": rules, "subjects": ["operators"]}));
    }
    json!({
        "enabled": true,
        "default_permission": "deny",
        "rules": [
            rule("sends", json!(["put", "declare_queryable", "liveliness_token"]), "egress", &data),
            rule("subscribes", json!(["declare_subscriber", "liveliness_query", "declare_liveliness_subscriber"]), "ingress", &data),
            rule("asks", json!(["query"]), "ingress", &asked),
            rule("answers", json!(["reply"]), "egress", &data),
            rule("commands", json!(["query"]), "ingress", &commands),
            rule("obeys", json!(["reply"]), "egress", &commands),
        ],
        "subjects": subjects,
        "policies": policies,
    })
}

fn explain(error: &zenoh::Error, listen: &[String], connect: &[String]) -> String {
    let wanted: Vec<_> = listen.iter().chain(connect).map(String::as_str).collect();
    format!(
        "{} (endpoints look like tcp/192.168.0.7:7447): {}",
        wanted.join(", "),
        plainly(&error.to_string())
    )
}

/// What Zenoh says, without the places in its source: ` at /.../orchestrator.rs:388.`
pub(crate) fn plainly(said: &str) -> String {
    let mut parts = said.split(" at /");
    let mut out = parts.next().unwrap_or_default().to_owned();
    for part in parts {
        match part.split_once(".rs:") {
            Some((path, rest)) if !path.contains(' ') => {
                out.push_str(rest.trim_start_matches(|c: char| c.is_ascii_digit() || c == '.'));
            }
            _ => {
                out.push_str(" at /");
                out.push_str(part);
            }
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_address_alone_is_for_tcp() {
        for (given, meant) in [
            ("192.168.0.7:7447", "tcp/192.168.0.7:7447"),
            ("[::1]:7447", "tcp/[::1]:7447"),
            ("gripper:7447#iface=a/b", "tcp/gripper:7447#iface=a/b"),
            ("tcp/gripper:7447", "tcp/gripper:7447"),
            ("tls/gripper:7447", "tls/gripper:7447"),
        ] {
            let mut endpoint = given.to_owned();
            complete(&mut endpoint);
            assert_eq!(endpoint, meant);
        }
    }

    #[test]
    fn what_zenoh_says_comes_without_places_in_its_source() {
        for (said, plain) in [
            ("Timeout! at /a/b-1.0/orchestrator.rs:388.", "Timeout!"),
            (
                "wrong: 192.168.0.7:7447 at /a/endpoint.rs:615.\", location: None at /a/config.rs:86.",
                "wrong: 192.168.0.7:7447\", location: None",
            ),
            (
                "nothing at /dev/ttyUSB0 is open",
                "nothing at /dev/ttyUSB0 is open",
            ),
            ("", ""),
        ] {
            assert_eq!(plainly(said), plain);
        }
    }
}
