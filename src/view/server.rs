//! The network: one page and a websocket, for admitted clients only.

use super::auth::Guard;
use super::hub::{ClientId, Event, Hub, Outgoing};
use super::page::{FILES, MODULES, PageFile};
use super::protocol::{Answer, FrameInfo, LONGEST, Request};
use crate::words::plain;
use axum::Router;
use axum::body::{Body, Bytes};
use axum::extract::ws::{Message, WebSocket, WebSocketUpgrade};
use axum::extract::{Request as HttpRequest, State};
use axum::http::header::{self, HeaderName};
use axum::http::{HeaderMap, HeaderValue, Response, StatusCode};
use axum::middleware::{Next, from_fn_with_state};
use axum::response::IntoResponse;
use axum::routing::get;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
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
pub struct Shared {
    guard: Arc<Guard>,
    hub: Arc<Hub>,
    next: Arc<AtomicU64>,
    here: Arc<AtomicUsize>,
}

impl Shared {
    /// Makes what connections share on a server with these rules, whose requests go to `hub`.
    pub fn new(guard: Guard, hub: Arc<Hub>) -> Self {
        Self { guard: Arc::new(guard), hub, next: Arc::new(AtomicU64::new(1)), here: Arc::new(AtomicUsize::new(0)) }
    }

    /// Whether a window is open.
    #[must_use]
    pub fn has_windows(&self) -> bool {
        self.here.load(Ordering::SeqCst) > 0
    }
}

/// Returns the routes.
pub fn router(shared: Shared) -> Router {
    let mut router = Router::new().route("/ws", get(socket));
    for PageFile { path, kind, bytes } in FILES.into_iter().chain(MODULES) {
        let file = move || async move { ([(header::CONTENT_TYPE, kind)], bytes) };
        router = router.route(path, get(file));
    }
    router.layer(from_fn_with_state(shared.clone(), admit)).with_state(shared)
}

fn text<'a>(headers: &'a HeaderMap, name: &HeaderName) -> Option<&'a str> {
    headers.get(name).and_then(|v| v.to_str().ok())
}

/// Admits requests that name this server and have the token as a cookie; a request with the token in the address gets
/// the cookie, and an address without the token.
async fn admit(State(shared): State<Shared>, request: HttpRequest, next: Next) -> Response<Body> {
    let (guard, headers) = (&shared.guard, request.headers());
    let token = request.uri().query().and_then(|q| q.strip_prefix("token="));
    let mut response = if !guard.allows_host(text(headers, &header::HOST)) {
        (StatusCode::FORBIDDEN, "this host name is not allowed; see --allow-host").into_response()
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

async fn socket(State(shared): State<Shared>, headers: HeaderMap, upgrade: WebSocketUpgrade) -> Response<Body> {
    if !shared.guard.allows_origin(text(&headers, &header::ORIGIN), text(&headers, &header::HOST)) {
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
async fn talk(mut socket: WebSocket, shared: &Shared) {
    let id: ClientId = shared.next.fetch_add(1, Ordering::SeqCst);
    let (out, mut answers) = mpsc::channel(QUEUE);
    shared.hub.tell(id, Event::Came(out.clone()));
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
    shared.hub.tell(id, Event::Left);
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

async fn hear(shared: &Shared, id: ClientId, text: &str, out: &mpsc::Sender<Outgoing>) -> bool {
    match serde_json::from_str::<Request>(text) {
        Ok(request) => {
            while shared.hub.is_full() {
                tokio::time::sleep(Duration::from_millis(5)).await;
            }
            shared.hub.tell(id, Event::Said(Box::new(request)));
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
