//! A client window of the viewer that acknowledges each frame at once.
#![allow(dead_code)] // each benchmark uses only part of it

use serde_json::{Value, json};
use std::net::TcpStream;
use std::time::{Duration, Instant};
use tungstenite::client::IntoClientRequest;
use tungstenite::stream::MaybeTlsStream;
use tungstenite::{Message, WebSocket};

/// Header fields of a frame.
pub struct Frame {
    pub number: u32,
    pub png: bool,
    pub width: u16,
    pub time: f32,
    pub render_ms: f32,
    pub encode_ms: f32,
}

/// A connected window.
pub struct Window {
    socket: WebSocket<MaybeTlsStream<TcpStream>>,
    pub welcome: Value,
    pub size: u32,
}

impl Window {
    /// Connects to the server at `url`, through the port `via` if given.
    pub fn open(url: &str, size: u32, via: Option<u16>) -> Self {
        let (port, token) = parts(url);
        let via = via.unwrap_or(port);
        let mut request = format!("ws://localhost:{via}/ws").into_client_request().unwrap();
        request.headers_mut().insert("Origin", format!("http://localhost:{via}").parse().unwrap());
        request.headers_mut().insert("Cookie", format!("volseggs-{port}={token}").parse().unwrap());
        let stream = MaybeTlsStream::Plain(TcpStream::connect(("127.0.0.1", via)).unwrap());
        let (socket, _) = tungstenite::client(request, stream).unwrap();
        let mut window = Self { socket, welcome: Value::Null, size };
        window.welcome = window.answer("welcome");
        window
    }

    pub fn say(&mut self, message: &Value) {
        assert!(self.try_say(message), "the viewer has ended");
    }

    /// Sends a message; returns false if the viewer has ended.
    pub fn try_say(&mut self, message: &Value) -> bool {
        self.socket.send(Message::text(message.to_string())).is_ok()
    }

    /// Returns a view message from `turn` (1 is a full revolution), at a time.
    pub fn view(&self, turn: f64, time: f64, moving: bool) -> Value {
        let (centre, radius) = (self.welcome["centre"].clone(), self.welcome["radius"].as_f64().unwrap());
        let at = |k: usize| centre[k].as_f64().unwrap();
        let angle = std::f64::consts::TAU * turn;
        let eye = [at(0) + radius * angle.cos(), at(1) + radius * angle.sin(), at(2) + 0.35 * radius];
        json!({
            "type": "view", "eye": eye, "target": centre, "up": [0, 0, 1], "fov": self.welcome["fov"],
            "size": [self.size, self.size], "time": time, "look": "colour", "edits": true, "moving": moving,
        })
    }

    /// Waits for the next frame and acknowledges it; text messages are skipped.
    pub fn frame(&mut self) -> Frame {
        loop {
            if let Some(frame) = self.frame_within(Duration::from_secs(600)) {
                return frame;
            }
        }
    }

    /// Waits up to `wait` for the next frame; returns `None` on timeout or if the viewer ends.
    pub fn frame_within(&mut self, wait: Duration) -> Option<Frame> {
        let until = Instant::now() + wait;
        loop {
            let left = until.saturating_duration_since(Instant::now()).max(Duration::from_millis(1));
            let MaybeTlsStream::Plain(stream) = self.socket.get_mut() else { unreachable!() };
            stream.set_read_timeout(Some(left)).unwrap();
            let message = match self.socket.read() {
                Err(tungstenite::Error::Io(_)) => return None,
                message => message.unwrap(),
            };
            if matches!(&message, Message::Text(text) if text.as_str().contains("\"ended\"")) {
                return None;
            }
            if let Message::Binary(bytes) = message {
                let word = |at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap());
                let frame = Frame {
                    number: word(4),
                    png: bytes[1] == 1,
                    width: u16::from_le_bytes([bytes[16], bytes[17]]),
                    time: f32::from_bits(word(20)),
                    render_ms: f32::from_bits(word(24)),
                    encode_ms: f32::from_bits(word(28)),
                };
                self.try_say(&json!({ "type": "ack", "frame": frame.number }));
                return Some(frame);
            }
            if Instant::now() >= until {
                return None;
            }
        }
    }

    /// Waits for the next text message of a kind; frames before it are acknowledged.
    pub fn answer(&mut self, kind: &str) -> Value {
        loop {
            match self.socket.read().unwrap() {
                Message::Text(text) => {
                    let value: Value = serde_json::from_str(text.as_str()).unwrap();
                    assert!(value["type"] != "error", "{value}");
                    if value["type"] == kind {
                        return value;
                    }
                }
                Message::Binary(bytes) => {
                    let number = u32::from_le_bytes(bytes[4..8].try_into().unwrap());
                    self.say(&json!({ "type": "ack", "frame": number }));
                }
                _ => {}
            }
        }
    }

    /// Waits for the lossless picture.
    pub fn rest(&mut self) {
        while !self.frame().png {}
    }
}

/// Splits a server's address into port and token.
pub fn parts(url: &str) -> (u16, &str) {
    let (host, token) = url.split_once("/?token=").unwrap();
    (host.rsplit(':').next().unwrap().parse().unwrap(), token)
}
