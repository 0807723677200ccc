//! The network: one page and a websocket, for admitted clients only.

use super::auth::{Guard, name_of};
use super::hub::{ClientEvent, ClientId, Hub, Outgoing};
use super::page::{FILES, MODULES, filled};
use super::protocol::{Answer, FrameInfo, LONGEST, Request};
use crate::words::plain;
use axum::Router;
use axum::body::{Body, Bytes};
use axum::extract::ws::rejection::WebSocketUpgradeRejection;
use axum::extract::ws::{Message, WebSocket, WebSocketUpgrade};
use axum::extract::{Request as HttpRequest, State};
use axum::http::header::{self, HeaderName};
use axum::http::{HeaderMap, HeaderValue, Response, StatusCode};
use axum::middleware::{Next, from_fn_with_state};
use axum::response::IntoResponse;
use axum::routing::get;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering};
use std::time::{Duration, Instant};
use tokio::sync::mpsc;
use tokio::task::spawn_blocking;
use tokio::time::{interval, timeout};

/// Maximum number of clients at once.
const MAX_CLIENTS: usize = 8;
/// Number of messages that may wait for a client; a client for which more wait is dropped.
const QUEUE: usize = 256;
/// Maximum time that a client may take for a message.
const PATIENCE: Duration = Duration::from_secs(30);
/// Time between two pings, which a browser answers by itself.
const BEAT: Duration = Duration::from_secs(20);
/// Time without any message or answer after which a client is taken for gone: its connection may be half open.
const SILENCE: Duration = Duration::from_secs(60);
/// What a page may load, and from where: only from this server.
const POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; img-src 'self' blob:; \
                      base-uri 'none'; form-action 'none'; frame-ancestors 'none'";
/// What all connections share.
#[derive(Clone)]
pub struct ServerState {
    guard: Arc<Guard>,
    hub: Arc<Hub>,
    next: Arc<AtomicU64>,
    here: Arc<AtomicUsize>,
    /// Whether the user has been told what a proxy in front of the viewer does wrong.
    told: Arc<AtomicBool>,
}

impl ServerState {
    /// Makes what connections share on a server with these rules, whose requests go to `hub`.
    pub fn new(guard: Guard, hub: Arc<Hub>) -> Self {
        let (next, here, told) = (Arc::new(AtomicU64::new(1)), Arc::default(), Arc::default());
        Self { guard: Arc::new(guard), hub, next, here, told }
    }

    /// Prints why a page of the owner does not work, once: browsers try again and again.
    fn tell(&self, why: &str) {
        if !self.told.swap(true, Ordering::SeqCst) {
            errln!("note: {why}");
        }
    }

    /// Whether a window is open.
    pub fn has_windows(&self) -> bool {
        self.here.load(Ordering::SeqCst) > 0
    }
}

/// Returns the routes.
pub fn router(shared: ServerState) -> Router {
    let mut router = Router::new().route("/ws", get(socket)).route("/host", get(host));
    for file in FILES.into_iter().chain(MODULES) {
        let bytes = Bytes::from(filled(&file).into_owned());
        let send = move || async move { ([(header::CONTENT_TYPE, file.media_type)], bytes) };
        router = router.route(file.path, get(send));
    }
    router.layer(from_fn_with_state(shared.clone(), admit)).with_state(shared)
}

fn text<'a>(headers: &'a HeaderMap, name: &HeaderName) -> Option<&'a str> {
    headers.get(name).and_then(|v| v.to_str().ok())
}

/// Admits requests that name this server and have the token as a cookie; a request with the token in the address gets
/// the cookie, and an address without the token.
async fn admit(State(shared): State<ServerState>, request: HttpRequest, next: Next) -> Response<Body> {
    let (guard, headers) = (&shared.guard, request.headers());
    let token = request.uri().query().and_then(|q| q.strip_prefix("token="));
    let mut response = if !guard.allows_host(text(headers, &header::HOST)) {
        let owner =
            token.is_some_and(|token| guard.allows_token(token)) || guard.allows_cookie(text(headers, &header::COOKIE));
        let why = not_allowed(text(headers, &header::HOST));
        if owner {
            shared.tell(&why);
        }
        (StatusCode::FORBIDDEN, why).into_response()
    } else if token.is_some_and(|token| guard.allows_token(token)) {
        // even if the client has the cookie: the secret must not stay in the address
        let cookie = guard.set_cookie();
        (StatusCode::SEE_OTHER, [(header::SET_COOKIE, cookie), (header::LOCATION, "/".to_owned())]).into_response()
    } else if guard.allows_cookie(text(headers, &header::COOKIE)) {
        next.run(request).await
    } else if token.is_some() {
        (StatusCode::FORBIDDEN, "the token does not belong to this server").into_response()
    } else {
        (StatusCode::FORBIDDEN, "open the whole address that `volseggs view` printed, with its token").into_response()
    };
    if response.status() == StatusCode::FORBIDDEN {
        // who is not admitted takes no place for longer
        response.headers_mut().insert(header::CONNECTION, HeaderValue::from_static("close"));
    }
    for (name, value) in [
        (header::CONTENT_SECURITY_POLICY, POLICY),
        (header::X_CONTENT_TYPE_OPTIONS, "nosniff"),
        (header::REFERRER_POLICY, "no-referrer"),
        (header::CACHE_CONTROL, "no-store"),
    ] {
        response.headers_mut().insert(name, HeaderValue::from_static(value));
    }
    response
}

/// A name or address as a header gives it, for messages; whatever could be anything else is not repeated.
fn shown(name: &str) -> Option<&str> {
    let plain = |b: u8| b.is_ascii_alphanumeric() || b"-._:[]".contains(&b);
    (!name.is_empty() && name.len() <= 255 && name.bytes().all(plain)).then_some(name)
}

/// What to do about a host name that is not allowed.
fn not_allowed(host: Option<&str>) -> String {
    let Some(host) = host.and_then(shown) else { return "this host name is not allowed; see --allow-host".to_owned() };
    let name = name_of(host).unwrap_or(host);
    format!("the name {name} is not allowed for this viewer; if it is yours, start the viewer with --allow-host {name}")
}

/// Why a proxy in front of the viewer keeps pages from connecting, if they come from `origin` but it says `host`.
fn misnamed(origin: &str, host: &str) -> Option<String> {
    let page = origin.strip_prefix("http://").or_else(|| origin.strip_prefix("https://")).and_then(shown)?;
    let (host, name) = (shown(host)?, name_of(page)?);
    Some(format!(
        "a page at {page} cannot connect: the proxy in front of the viewer calls it {host} (the header Host); let the \
         proxy pass the name on (nginx: proxy_set_header Host $http_host;), and start the viewer with --allow-host {name}"
    ))
}

/// The host name under which the request arrived: the page compares it with its own, as it is not told why a websocket
/// was refused.
async fn host(headers: HeaderMap) -> String {
    text(&headers, &header::HOST).unwrap_or_default().to_owned()
}

async fn socket(
    State(shared): State<ServerState>,
    headers: HeaderMap,
    upgrade: Result<WebSocketUpgrade, WebSocketUpgradeRejection>,
) -> Response<Body> {
    let (origin, host) = (text(&headers, &header::ORIGIN), text(&headers, &header::HOST));
    let allowed = shared.guard.allows_origin(origin, host);
    let upgrade = match upgrade {
        Ok(upgrade) => upgrade,
        Err(rejection) => {
            if allowed {
                shared.tell(
                    "a page cannot connect: a proxy in front of the viewer does not pass on websockets; let it (nginx: \
                     proxy_http_version 1.1; proxy_set_header Upgrade $http_upgrade; proxy_set_header Connection upgrade;)",
                );
            }
            return rejection.into_response();
        }
    };
    if !allowed {
        if let Some(why) = origin.zip(host).and_then(|(origin, host)| misnamed(origin, host)) {
            shared.tell(&why);
        }
        return (StatusCode::FORBIDDEN, "the request does not come from a page of this server").into_response();
    }
    if shared.here.fetch_add(1, Ordering::SeqCst) >= MAX_CLIENTS {
        shared.here.fetch_sub(1, Ordering::SeqCst);
        // a page sees the messages of a socket, but not why one was refused
        return upgrade.on_upgrade(refuse);
    }
    let here = Here(shared.here.clone());
    upgrade.max_message_size(LONGEST).max_frame_size(LONGEST).on_upgrade(move |socket| async move {
        talk(socket, &shared).await;
        drop(here);
    })
}

/// Ends the connection of one client too many.
async fn refuse(mut socket: WebSocket) {
    let why = "too many windows are open; close one, then reload this page".to_owned();
    let last = message(Outgoing::Text(Box::new(Answer::Ended { message: why }))).await;
    if matches!(timeout(PATIENCE, socket.send(last)).await, Ok(Ok(()))) {
        close(socket).await;
    }
}

/// Counts a client until it is dropped.
struct Here(Arc<AtomicUsize>);

impl Drop for Here {
    fn drop(&mut self) {
        self.0.fetch_sub(1, Ordering::SeqCst);
    }
}

/// Passes messages on until the client leaves.
async fn talk(mut socket: WebSocket, shared: &ServerState) {
    let id: ClientId = shared.next.fetch_add(1, Ordering::SeqCst);
    let (out, mut answers) = mpsc::channel(QUEUE);
    shared.hub.push(id, ClientEvent::Connected(out.clone()));
    let mut ended = false;
    let (mut beat, mut heard) = (interval(BEAT), Instant::now());
    loop {
        let go_on = tokio::select! {
            message = socket.recv() => {
                let go_on = match message {
                    Some(Ok(Message::Text(text))) => hear(shared, id, text.as_str(), &out).await,
                    Some(Ok(Message::Ping(_) | Message::Pong(_))) => true,
                    _ => false,
                };
                heard = Instant::now();
                go_on
            }
            _ = beat.tick() => {
                let ping = async { timeout(PATIENCE, socket.send(Message::Ping(Bytes::new()))).await };
                heard.elapsed() < SILENCE && matches!(ping.await, Ok(Ok(())))
            }
            answer = answers.recv() => match answer {
                Some(answer) => {
                    ended = answer.is_last();
                    let sent = timeout(PATIENCE, socket.send(message(answer).await)).await;
                    matches!(sent, Ok(Ok(()))) && !ended
                }
                None => false,
            },
        };
        if !go_on {
            break;
        }
    }
    shared.hub.push(id, ClientEvent::Disconnected);
    if ended {
        close(socket).await;
    }
}

/// Ends a connection after the last message. What arrived meanwhile is read, as dropping a connection with unread data
/// would discard what was sent.
async fn close(mut socket: WebSocket) {
    let closing = async {
        if socket.send(Message::Close(None)).await.is_ok() {
            while let Some(Ok(_)) = socket.recv().await {}
        }
    };
    // a client that does not answer is abandoned
    drop(timeout(Duration::from_secs(1), closing).await);
}

async fn hear(shared: &ServerState, id: ClientId, text: &str, out: &mpsc::Sender<Outgoing>) -> bool {
    match serde_json::from_str::<Request>(text) {
        Ok(request) => {
            while shared.hub.is_full() {
                tokio::time::sleep(Duration::from_millis(5)).await;
            }
            shared.hub.push(id, ClientEvent::Message(Box::new(request)));
        }
        Err(error) => {
            let message = format!("invalid request: {}", plain(&error.to_string()));
            // a client that waits for an answer gets the error
            let id = serde_json::from_str::<serde_json::Value>(text).ok().and_then(|request| request["id"].as_u64());
            let id = id.and_then(|id| u32::try_from(id).ok());
            return out.try_send(Outgoing::Text(Box::new(Answer::Error { id, message }))).is_ok();
        }
    }
    true
}

async fn message(answer: Outgoing) -> Message {
    let frame = |(info, bytes): (FrameInfo, Vec<u8>)| Message::Binary(info.with(&bytes).into());
    // these types have no maps with keys other than strings, so they always have a JSON form
    let text = |answer: &Answer| Message::Text(serde_json::to_string(answer).unwrap_or_default().into());
    match answer {
        Outgoing::Frame(info, bytes) => frame((info, bytes)),
        Outgoing::Picture(picture) => match spawn_blocking(move || picture.encode()).await {
            Ok(Ok(encoded)) => frame(encoded),
            Ok(Err(error)) => text(&Answer::Error { id: None, message: error.to_string() }),
            Err(_) => text(&Answer::Error { id: None, message: "this picture cannot be encoded".into() }),
        },
        Outgoing::Text(answer) => text(&answer),
    }
}
