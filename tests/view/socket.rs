//! A running viewer, and a window connected to it.

use crate::common::BINARY;
use serde_json::Value;
use sha2::{Digest, Sha256};
use std::io::{BufRead, BufReader, Read};
use std::net::TcpStream;
use std::path::Path;
use std::process::{Child, Command, ExitStatus, Stdio};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};
use tungstenite::client::IntoClientRequest;
use tungstenite::stream::MaybeTlsStream;
use tungstenite::{Message, WebSocket};

/// Longest wait for anything.
const PATIENCE: Duration = Duration::from_secs(60);

/// A running `volseggs view run`, or `volseggs train --view`.
pub struct Server {
    child: Child,
    pub port: u16,
    pub token: String,
}

impl Server {
    pub fn start(root: &Path, flags: &[&str]) -> Self {
        let mut command = Command::new(BINARY);
        command.current_dir(root).args(["view", "run"]).args(flags);
        Self::of(command)
    }

    /// Like [`Server::start`]; also returns a thread that ends with the viewer, with what it printed on standard error.
    pub fn start_heard(root: &Path, flags: &[&str]) -> (Self, JoinHandle<String>) {
        let mut command = Command::new(BINARY);
        command.current_dir(root).args(["view", "run"]).args(flags).stderr(Stdio::piped());
        let mut server = Self::with_errors(command);
        let mut errors = server.child.stderr.take().unwrap();
        let heard = std::thread::spawn(move || {
            let mut text = String::new();
            errors.read_to_string(&mut text).unwrap();
            text
        });
        (server, heard)
    }

    /// Starts the command and waits until it reports its address.
    pub fn of(mut command: Command) -> Self {
        command.stderr(Stdio::null());
        Self::with_errors(command)
    }

    fn with_errors(mut command: Command) -> Self {
        let mut child = command.stdout(Stdio::piped()).spawn().unwrap();
        let mut url = String::new();
        BufReader::new(child.stdout.take().unwrap()).read_line(&mut url).unwrap();
        let rest = url.trim().strip_prefix("http://localhost:").unwrap_or_else(|| panic!("{url}"));
        let (port, token) = rest.split_once("/?token=").unwrap();
        Self { child, port: port.parse().unwrap(), token: token.to_owned() }
    }

    /// Returns the bytes of memory that it holds now; `None` if the system does not report them.
    pub fn memory(&self) -> Option<u64> {
        let status = std::fs::read_to_string(format!("/proc/{}/status", self.child.id())).ok()?;
        let line = status.lines().find_map(|l| l.strip_prefix("VmRSS:"))?;
        Some(1024 * line.trim().trim_end_matches(" kB").parse::<u64>().unwrap())
    }

    /// Returns the address that it prints.
    pub fn url(&self) -> String {
        format!("http://localhost:{}/?token={}", self.port, self.token)
    }

    /// Sends it a signal, such as `TERM`.
    pub fn signal(&self, name: &str) {
        let pid = self.child.id().to_string();
        assert!(Command::new("kill").args([&format!("-{name}"), &pid]).status().unwrap().success());
    }

    /// Waits until it ends.
    pub fn wait(&mut self) -> ExitStatus {
        self.child.wait().unwrap()
    }

    pub fn cookie(&self) -> String {
        format!("{}={}", self.cookie_name(), self.token)
    }

    /// Returns the name of its cookie.
    pub fn cookie_name(&self) -> String {
        cookie_name(&self.token)
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        drop(self.child.kill());
        drop(self.child.wait());
    }
}

/// A frame.
pub struct Frame {
    /// 0 a picture, 1 what it is compared with, 2 a requested file, 3 an image of the dataset.
    pub kind: u8,
    pub png: bool,
    pub number: u32,
    pub width: u32,
    pub height: u32,
    pub time: f32,
    pub picture: Vec<u8>,
}

/// A connection to a viewer.
pub struct Window {
    socket: WebSocket<MaybeTlsStream<TcpStream>>,
    /// Whether frames are acknowledged.
    pub takes: bool,
    /// The newest document.
    pub document: Value,
    /// The newest picture.
    pub picture: Vec<u8>,
}

impl Window {
    /// Opens a window; also returns its welcome.
    pub fn open(server: &Server) -> (Self, Value) {
        let socket = connect(server, &[("Cookie", &server.cookie())]).unwrap();
        let mut window = Self { socket, takes: true, document: Value::Null, picture: Vec::new() };
        let welcome = window.wait_for(|m| m["type"] == "welcome");
        window.wait_for(|m| m["type"] == "document");
        (window, welcome)
    }

    pub fn say(&mut self, message: &Value) {
        self.say_text(&message.to_string());
    }

    pub fn say_text(&mut self, text: &str) {
        self.socket.send(Message::text(text)).unwrap();
    }

    /// Sends a text if the server still receives; its answer is not read.
    pub fn try_say_text(&mut self, text: &str) -> bool {
        let MaybeTlsStream::Plain(stream) = self.socket.get_mut() else { unreachable!() };
        stream.set_write_timeout(Some(Duration::from_secs(2))).unwrap();
        self.socket.send(Message::text(text)).is_ok()
    }

    pub fn say_bytes(&mut self, bytes: &'static [u8]) {
        self.socket.send(Message::binary(bytes)).unwrap();
    }

    /// Returns the next message, if one arrives before `until`.
    fn next(&mut self, until: Instant) -> Option<Message> {
        let left = until.saturating_duration_since(Instant::now());
        if left.is_zero() {
            return None;
        }
        let MaybeTlsStream::Plain(stream) = self.socket.get_mut() else { unreachable!() };
        stream.set_read_timeout(Some(left.max(Duration::from_millis(1)))).unwrap();
        match self.socket.read() {
            Ok(message) => Some(message),
            Err(tungstenite::Error::Io(_)) => None,
            Err(error) => panic!("{error}"),
        }
    }

    /// Returns the next text that fits, or the current document if it does; frames before it are consumed.
    pub fn wait_for(&mut self, fits: impl Fn(&Value) -> bool) -> Value {
        if fits(&self.document) {
            return self.document.clone();
        }
        let until = Instant::now() + PATIENCE;
        loop {
            match self.next(until) {
                Some(Message::Text(text)) => {
                    let message: Value = serde_json::from_str(text.as_str()).unwrap();
                    if message["type"] == "document" {
                        self.document = message.clone();
                    }
                    if fits(&message) {
                        return message;
                    }
                }
                Some(Message::Binary(bytes)) => drop(self.take(&bytes)),
                Some(_) => {}
                None => panic!("no matching message within {PATIENCE:?}"),
            }
        }
    }

    /// Returns the next lossless frame.
    pub fn lossless(&mut self) -> Frame {
        self.frame(|frame| frame.png && frame.kind == 0)
    }

    /// Returns the next frame that fits.
    pub fn frame(&mut self, fits: impl Fn(&Frame) -> bool) -> Frame {
        let until = Instant::now() + PATIENCE;
        loop {
            match self.next(until) {
                Some(Message::Binary(bytes)) => {
                    let frame = self.take(&bytes);
                    if fits(&frame) {
                        return frame;
                    }
                }
                Some(Message::Text(text)) if text.as_str().contains("\"error\"") => panic!("{text}"),
                Some(_) => {}
                None => panic!("no matching frame within {PATIENCE:?}"),
            }
        }
    }

    /// Returns the next lossless frame, whatever errors are reported before it.
    pub fn any_lossless(&mut self) -> Frame {
        let until = Instant::now() + PATIENCE;
        loop {
            match self.next(until) {
                Some(Message::Binary(bytes)) => {
                    let frame = self.take(&bytes);
                    if frame.png {
                        return frame;
                    }
                }
                Some(_) => {}
                None => panic!("no lossless frame within {PATIENCE:?}"),
            }
        }
    }

    /// Returns all frames that arrive within some seconds.
    pub fn frames_within(&mut self, seconds: f64) -> Vec<Frame> {
        let until = Instant::now() + Duration::from_secs_f64(seconds);
        let mut frames = Vec::new();
        while let Some(message) = self.next(until) {
            if let Message::Binary(bytes) = message {
                frames.push(self.take(&bytes));
            }
        }
        frames
    }

    fn take(&mut self, bytes: &[u8]) -> Frame {
        let number = |at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap());
        let side = |at: usize| u32::from(u16::from_le_bytes(bytes[at..at + 2].try_into().unwrap()));
        let frame = Frame {
            kind: bytes[2],
            png: bytes[1] == 1,
            number: number(4),
            width: side(16),
            height: side(18),
            time: f32::from_bits(number(20)),
            picture: bytes[volseggs::view::protocol::HEADER..].to_vec(),
        };
        if frame.kind == 0 {
            self.picture.clone_from(&frame.picture);
        }
        if self.takes && frame.kind == 0 {
            self.say_text(&format!("{{\"type\":\"ack\",\"frame\":{}}}", frame.number));
        }
        frame
    }

    /// Whether the server closes the connection.
    pub fn is_closed(&mut self) -> bool {
        let until = Instant::now() + PATIENCE;
        while Instant::now() < until {
            match self.socket.read() {
                Ok(Message::Close(_)) | Err(_) => return true,
                Ok(_) => {}
            }
        }
        false
    }
}

/// Opens a websocket to the server as its own page would, with `headers` replacing the usual ones; an empty one is
/// omitted.
/// Returns the name of the cookie of a server with this token.
pub fn cookie_name(token: &str) -> String {
    let digest = Sha256::digest(token);
    format!("volseggs-{:02x}{:02x}{:02x}{:02x}", digest[0], digest[1], digest[2], digest[3])
}

pub fn connect(server: &Server, headers: &[(&str, &str)]) -> tungstenite::Result<WebSocket<MaybeTlsStream<TcpStream>>> {
    let url = format!("ws://localhost:{}/ws", server.port);
    let mut request = url.into_client_request()?;
    let origin = format!("http://localhost:{}", server.port);
    request.headers_mut().insert("Origin", origin.parse().unwrap());
    for (name, value) in headers {
        let name: tungstenite::http::HeaderName = name.parse().unwrap();
        if value.is_empty() {
            request.headers_mut().remove(&name);
        } else {
            request.headers_mut().insert(name, value.parse().unwrap());
        }
    }
    let stream = TcpStream::connect(("127.0.0.1", server.port)).unwrap();
    let stream = MaybeTlsStream::Plain(stream);
    match tungstenite::client(request, stream) {
        Ok((socket, _)) => Ok(socket),
        Err(tungstenite::HandshakeError::Failure(error)) => Err(error),
        Err(tungstenite::HandshakeError::Interrupted(_)) => panic!("interrupted"),
    }
}
