//! The live page and its server: one thread, no build step, nothing from elsewhere.
//!
//! ```text
//! GET  /                  the page (page.html, page.css, page.js, all in the program)
//! GET  /live              WebSocket: strips as binary frames ([`Hub`]), state as JSON text
//! POST /command/<name>    status tare mark start stop; the argument is the body; Authorization: Bearer <token>
//! ```

use std::net::{IpAddr, SocketAddr};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;

use axum::body::Bytes;
use axum::extract::ws::{Message, WebSocket, WebSocketUpgrade};
use axum::extract::{ConnectInfo, DefaultBodyLimit, Path, Request, State};
use axum::http::{HeaderMap, HeaderName, HeaderValue, StatusCode, header};
use axum::middleware::{self, Next};
use axum::response::{IntoResponse, Response};
use axum::routing::{get, post};
use axum::{Router, serve};
use ft_drivers::{Clock, MonotonicClock};
use serde_json::Value;
use tokio::sync::{broadcast, oneshot};

use crate::live::{Frame, Hub};
use crate::session::control::{Command, Commands, refusal};

mod access;
mod allowance;
mod door;
mod refusals;

use access::Access;
pub(crate) use access::new_token;
pub(crate) use allowance::Allowance;
use door::Door;
pub(crate) use door::Visitor;
pub(crate) use refusals::{Refusals, Why};

/// The longest message that a viewer may send, bytes; it has nothing to say.
const LONGEST_MESSAGE: usize = 1024;
/// The longest body of a command, bytes.
const LONGEST_BODY: usize = 2048;
/// How long a viewer may take no bytes before it is let go; a page reconnects by itself.
pub(crate) const PATIENCE: Duration = Duration::from_secs(15);
/// Commands a second, and how many at once.
const COMMANDS_PER_SECOND: f64 = 10.0;
const COMMANDS_AT_ONCE: f64 = 20.0;
/// Messages of a viewer a second, and how many at once: it has nothing to say.
const WORDS_PER_SECOND: f64 = 2.0;
const WORDS_AT_ONCE: f64 = 20.0;

/// Carries out what a page asks.
pub trait Operator: Send + Sync + 'static {
    /// Answers with an object that has `ok`; may wait two seconds.
    fn ask(&self, command: Command) -> Value;
}

impl Operator for Commands {
    fn ask(&self, command: Command) -> Value {
        Self::ask(self, command)
    }
}

/// Why there is no page.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum WebError {
    /// The port cannot be opened.
    #[error(
        "nothing can be served on {address}: {source}; give another address, such as 127.0.0.1:8081"
    )]
    Address {
        /// Where.
        address: SocketAddr,
        /// What the system said.
        source: std::io::Error,
    },
    /// The system has no randomness for a token.
    #[error("no token could be made: {0}")]
    Token(getrandom::Error),
    /// The server's thread cannot be started.
    #[error("the page's server cannot be started: {0}")]
    Start(std::io::Error),
}

/// A running server; it ends when this is dropped.
#[derive(Debug)]
pub struct Server {
    /// Where it listens.
    pub address: SocketAddr,
    /// What commands must carry.
    pub token: String,
    end: Option<oneshot::Sender<()>>,
    thread: Option<JoinHandle<()>>,
    /// Keeps what the handlers hold until the thread has ended: a Zenoh session must not close inside its runtime.
    _app: Router,
}

impl Server {
    /// The address for a browser on this machine; the part behind `#` lets its buttons work and is never sent.
    #[must_use]
    pub fn url(&self) -> String {
        let mut address = self.address;
        if address.ip().is_unspecified() {
            address.set_ip(std::net::Ipv4Addr::LOCALHOST.into());
        }
        format!("http://{address}/#token={}", self.token)
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        drop(self.end.take());
        if let Some(thread) = self.thread.take() {
            // It only serves: nothing is lost with it.
            let _ = thread.join();
        }
    }
}

/// Serves the page on `address`; `token` as in the configuration, or a new one.
///
/// # Errors
/// The port cannot be opened.
pub fn serve_page(
    hub: Arc<Hub>,
    operator: Arc<dyn Operator>,
    address: SocketAddr,
    token: Option<String>,
) -> Result<Server, WebError> {
    let token = match token {
        Some(token) => token,
        None => new_token().map_err(WebError::Token)?,
    };
    let clock = MonotonicClock::anchored_now();
    let refusals = Arc::new(Refusals::new(clock));
    let desk = Desk(Arc::new(DeskInner {
        hub,
        operator,
        access: Access::new(token.clone()),
        refusals: Arc::clone(&refusals),
        clock,
        allowance: Mutex::new(Allowance::new(
            COMMANDS_PER_SECOND,
            COMMANDS_AT_ONCE,
            clock.now(),
        )),
    }));
    let app = Router::new()
        .route(
            "/",
            get(|| file("text/html; charset=utf-8", include_str!("web/page.html"))),
        )
        .route(
            "/page.js",
            get(|| {
                file(
                    "text/javascript; charset=utf-8",
                    include_str!("web/page.js"),
                )
            }),
        )
        .route(
            "/page.css",
            get(|| file("text/css; charset=utf-8", include_str!("web/page.css"))),
        )
        .route("/live", get(live))
        .route("/command/{name}", post(command))
        .layer(DefaultBodyLimit::max(LONGEST_BODY))
        .layer(middleware::from_fn_with_state(desk.clone(), check))
        .with_state(desk);
    start(app, address, refusals, token)
}

/// Starts the thread that serves `app`.
pub(crate) fn start(
    app: Router,
    address: SocketAddr,
    refusals: Arc<Refusals>,
    token: String,
) -> Result<Server, WebError> {
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_io()
        .enable_time()
        .max_blocking_threads(4)
        .build()
        .map_err(WebError::Start)?;
    let door = {
        let _inside = runtime.enter();
        Door::open(address, refusals).map_err(|source| WebError::Address { address, source })?
    };
    let address = serve::Listener::local_addr(&door)
        .map_err(|source| WebError::Address { address, source })?;
    let (end, ended) = oneshot::channel::<()>();
    let kept = app.clone();
    let thread = std::thread::Builder::new()
        .name("ft-web".to_owned())
        .spawn(move || {
            let service = app.into_make_service_with_connect_info::<Visitor>();
            runtime.block_on(async {
                tokio::select! {
                    _ = async { serve(door, service).await } => {}
                    _ = ended => {}
                }
            });
            runtime.shutdown_timeout(Duration::from_millis(100));
        })
        .map_err(WebError::Start)?;
    Ok(Server {
        address,
        token,
        end: Some(end),
        thread: Some(thread),
        _app: kept,
    })
}

async fn file(kind: &'static str, text: &'static str) -> impl IntoResponse {
    ([(header::CONTENT_TYPE, kind)], text)
}

/// What the handlers share.
#[derive(Clone)]
struct Desk(Arc<DeskInner>);

struct DeskInner {
    hub: Arc<Hub>,
    operator: Arc<dyn Operator>,
    access: Access,
    refusals: Arc<Refusals>,
    clock: MonotonicClock,
    allowance: Mutex<Allowance>,
}

impl DeskInner {
    /// Whether one more command may be carried out now.
    fn spend(&self) -> bool {
        let mut allowance = self
            .allowance
            .lock()
            .unwrap_or_else(PoisonError::into_inner);
        allowance.spend(self.clock.now())
    }
}

/// The checks that everything has to pass, and what every answer says to the browser.
async fn check(
    State(desk): State<Desk>,
    ConnectInfo(visitor): ConnectInfo<Visitor>,
    request: Request,
    next: Next,
) -> Response {
    let desk = &desk.0;
    let refused = if !desk.access.host_is_ours(request.headers()) {
        Some((
            Why::Host,
            "this address is not known by that name: use its IP address\n",
        ))
    } else if !desk.access.origin_is_ours(request.headers()) {
        Some((Why::Origin, "pages of another origin may not connect\n"))
    } else {
        None
    };
    let mut response = match refused {
        Some((why, text)) => {
            desk.refusals.add(why, visitor.address.ip());
            (StatusCode::FORBIDDEN, text).into_response()
        }
        None => next.run(request).await,
    };
    for (name, value) in [
        (
            header::CONTENT_SECURITY_POLICY,
            "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self' ws: wss:; img-src data:; \
             base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
        ),
        (header::X_CONTENT_TYPE_OPTIONS, "nosniff"),
        (header::REFERRER_POLICY, "no-referrer"),
        (header::CACHE_CONTROL, "no-store"),
        (
            HeaderName::from_static("cross-origin-resource-policy"),
            "same-origin",
        ),
    ] {
        response
            .headers_mut()
            .insert(name, HeaderValue::from_static(value));
    }
    response
}

async fn command(
    State(desk): State<Desk>,
    ConnectInfo(visitor): ConnectInfo<Visitor>,
    Path(name): Path<String>,
    headers: HeaderMap,
    body: Bytes,
) -> Response {
    let inner = Arc::clone(&desk.0);
    let from = visitor.address.ip();
    if !inner.access.may_command(&headers) {
        inner.refusals.add(Why::Token, from);
        let text = "commands need the token of the address that the capture printed";
        return answer(StatusCode::UNAUTHORIZED, &refusal(text));
    }
    if !inner.spend() {
        inner.refusals.add(Why::TooFast, from);
        return answer(
            StatusCode::TOO_MANY_REQUESTS,
            &refusal("too many commands: wait"),
        );
    }
    let parsed = std::str::from_utf8(&body)
        .map_err(|_| "the argument is no UTF-8 text".to_owned())
        .and_then(|text| Command::parse(&name, Some(text)));
    match parsed {
        Err(error) => answer(StatusCode::BAD_REQUEST, &refusal(&error)),
        Ok(command) => {
            let asked = tokio::task::spawn_blocking(move || inner.operator.ask(command)).await;
            match asked {
                Ok(said) => answer(StatusCode::OK, &said),
                Err(_) => answer(StatusCode::INTERNAL_SERVER_ERROR, &refusal("ending")),
            }
        }
    }
}

fn answer(code: StatusCode, said: &Value) -> Response {
    let kind = [(header::CONTENT_TYPE, "application/json")];
    (code, kind, said.to_string()).into_response()
}

async fn live(
    State(desk): State<Desk>,
    ConnectInfo(visitor): ConnectInfo<Visitor>,
    upgrade: WebSocketUpgrade,
) -> Response {
    visitor.stay();
    let from = visitor.address.ip();
    upgrade
        .max_message_size(LONGEST_MESSAGE)
        .max_frame_size(LONGEST_MESSAGE)
        .write_buffer_size(0)
        .on_upgrade(move |socket| async move {
            desk.0.hub.add_viewer();
            show(socket, &desk.0, from).await;
            desk.0.hub.remove_viewer();
        })
}

/// One viewer, until it leaves, reads nothing for [`PATIENCE`], or talks too much.
async fn show(mut socket: WebSocket, desk: &DeskInner, from: IpAddr) {
    let hub = &desk.hub;
    let mut frames = hub.watch_frames();
    let mut words = Allowance::new(WORDS_PER_SECOND, WORDS_AT_ONCE, desk.clock.now());
    loop {
        let message = tokio::select! {
            frame = frames.recv() => match frame {
                Ok(Frame::Strip(bytes)) => Message::Binary(bytes),
                Ok(Frame::State(text)) => Message::Text(text),
                Err(broadcast::error::RecvError::Lagged(lost)) => {
                    hub.add_viewer_drops(lost);
                    continue;
                }
                Err(broadcast::error::RecvError::Closed) => break,
            },
            said = socket.recv() => match said {
                Some(Ok(_)) if words.spend(desk.clock.now()) => continue,
                Some(Ok(_)) => {
                    desk.refusals.add(Why::TooMuch, from);
                    break;
                }
                Some(Err(_)) | None => break,
            },
        };
        match tokio::time::timeout(PATIENCE, socket.send(message)).await {
            Ok(Ok(())) => {}
            Ok(Err(_)) | Err(_) => break,
        }
    }
}
