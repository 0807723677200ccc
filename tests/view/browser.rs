//! The page in a real browser: headless Chromium, driven by its own debugging protocol over a websocket, which needs
//! neither a driver program nor another dependency.

use crate::socket::Server;
use base64::Engine;
use serde_json::{Value, json};
use std::io::{BufRead, BufReader};
use std::net::TcpStream;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};
use tempfile::TempDir;
use tungstenite::stream::MaybeTlsStream;
use tungstenite::{Message, WebSocket};
use volseggs_testing::{Need, skip};

/// Longest wait for anything on the page.
pub const PATIENCE: Duration = Duration::from_secs(60);
/// Width and height of the window.
const WINDOW: [u32; 2] = [1100, 760];

/// The middle of the picture, where an object is, in window coordinates.
pub const MIDDLE: &str = "(() => { const b = document.getElementById('picture').getBoundingClientRect(); \
                      return [b.left + b.width / 2, b.top + b.height / 2]; })()";

/// A running Chromium.
pub struct Browser {
    child: Child,
    socket: WebSocket<MaybeTlsStream<TcpStream>>,
    calls: u64,
    /// Errors and violations of the page's policy.
    pub wrong: Vec<String>,
    _profile: TempDir,
}

/// A tab of the browser.
#[derive(Clone)]
pub struct Tab(String);

impl Browser {
    /// Starts the browser; `None` if there is none, which has then been reported.
    pub fn start() -> Option<Self> {
        let profile = tempfile::tempdir().unwrap();
        let started = ["chromium", "chromium-browser", "google-chrome"].into_iter().find_map(|program| {
            let mut command = Command::new(program);
            command.args([
                "--headless=new",
                "--no-sandbox",
                "--disable-gpu",
                "--disable-quic",
                "--disable-sync",
                "--disable-dev-shm-usage",
                "--disable-background-networking",
                "--disable-component-update",
                "--no-first-run",
                "--remote-debugging-port=0",
            ]);
            command.arg(format!("--window-size={},{}", WINDOW[0], WINDOW[1]));
            command.arg(format!("--user-data-dir={}", profile.path().display())).arg("about:blank");
            command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::piped()).spawn().ok()
        });
        let Some(mut child) = started else {
            skip(Need::Browser, "there is no `chromium`");
            return None;
        };
        let mut lines = BufReader::new(child.stderr.take().unwrap()).lines();
        let found = lines
            .by_ref()
            .map_while(Result::ok)
            .find_map(|line| line.split_once("DevTools listening on ").map(|(_, url)| url.trim().to_owned()));
        let Some(url) = found else {
            drop(child.kill());
            drop(child.wait());
            skip(Need::Browser, "`chromium` does not start");
            return None;
        };
        // its further output does not matter, but must go somewhere
        std::thread::spawn(move || lines.for_each(drop));
        let (socket, _) = tungstenite::connect(&url).unwrap();
        Some(Self { child, socket, calls: 0, wrong: Vec::new(), _profile: profile })
    }

    /// Calls a method of the protocol.
    pub fn call(&mut self, tab: Option<&Tab>, method: &str, params: Value) -> Value {
        self.calls += 1;
        let mut message = json!({ "id": self.calls, "method": method, "params": params });
        if let Some(Tab(session)) = tab {
            message["sessionId"] = session.as_str().into();
        }
        self.socket.send(Message::text(message.to_string())).unwrap();
        loop {
            let Message::Text(text) = self.socket.read().unwrap() else { continue };
            let answer: Value = serde_json::from_str(text.as_str()).unwrap();
            if answer["id"] == self.calls {
                assert!(answer["error"].is_null(), "{method}: {answer}");
                return answer["result"].clone();
            }
            let of = &answer["params"];
            match answer["method"].as_str() {
                Some("Runtime.exceptionThrown") => self.wrong.push(of["exceptionDetails"].to_string()),
                Some("Log.entryAdded") if of["entry"]["level"] == "error" => self.wrong.push(of["entry"].to_string()),
                _ => {}
            }
        }
    }

    /// Opens a page in a new tab.
    pub fn open(&mut self, url: &str) -> Tab {
        let target = self.call(None, "Target.createTarget", json!({ "url": "about:blank" }));
        let attach = json!({ "targetId": target["targetId"], "flatten": true });
        let tab = Tab(self.call(None, "Target.attachToTarget", attach)["sessionId"].as_str().unwrap().to_owned());
        for domain in ["Page.enable", "Runtime.enable", "Log.enable"] {
            self.call(Some(&tab), domain, json!({}));
        }
        self.call(Some(&tab), "Page.navigate", json!({ "url": url }));
        tab
    }

    /// Opens the page of a viewer in a new tab, and waits for its picture.
    pub fn visit(&mut self, server: &Server) -> Tab {
        let tab = self.open(&server.url());
        self.rests(&tab);
        tab
    }

    /// Returns the value of an expression on the page.
    pub fn eval(&mut self, tab: &Tab, expression: &str) -> Value {
        let asked = json!({ "expression": expression, "awaitPromise": true, "returnByValue": true });
        let answer = self.call(Some(tab), "Runtime.evaluate", asked);
        assert!(answer["exceptionDetails"].is_null(), "{expression}: {answer}");
        answer["result"]["value"].clone()
    }

    /// Waits until an expression is true.
    pub fn wait(&mut self, tab: &Tab, expression: &str) {
        let until = Instant::now() + PATIENCE;
        // the page may not be loaded yet
        let guarded = format!("(() => {{ try {{ return Boolean({expression}); }} catch {{ return false; }} }})()");
        while self.eval(tab, &guarded) != true {
            if Instant::now() > until {
                let said = self.eval(tab, "document.body.innerText.slice(0, 600)");
                panic!("not reached within {PATIENCE:?}: {expression}; errors: {:?}; the page: {said}", self.wrong);
            }
            std::thread::sleep(Duration::from_millis(30));
        }
    }

    /// Waits until the picture shows everything that was requested, losslessly.
    pub fn rests(&mut self, tab: &Tab) {
        std::thread::sleep(Duration::from_millis(250));
        self.wait(tab, "document.getElementById('picture').dataset.lossless === 'true'");
    }

    /// Returns a hash of the picture.
    pub fn picture(&mut self, tab: &Tab) -> Value {
        let pixels = "(() => { const c = document.getElementById('picture'); \
                      const d = c.getContext('2d').getImageData(0, 0, c.width, c.height).data; \
                      let h = 0; for (let i = 0; i < d.length; i += 3) h = (h * 31 + d[i]) | 0; return h; })()";
        self.eval(tab, pixels)
    }

    pub fn mouse(&mut self, tab: &Tab, kind: &str, [x, y]: [f64; 2]) {
        let buttons = i32::from(kind != "mouseReleased");
        let event = json!({ "type": kind, "x": x, "y": y, "button": "left", "buttons": buttons, "clickCount": 1 });
        self.call(Some(tab), "Input.dispatchMouseEvent", event);
    }

    pub fn click(&mut self, tab: &Tab, at: [f64; 2]) {
        self.mouse(tab, "mousePressed", at);
        self.mouse(tab, "mouseReleased", at);
    }

    /// Presses and releases a key, with Ctrl (2) or Shift (8) held down.
    pub fn key(&mut self, tab: &Tab, key: &str, modifiers: u32) {
        for kind in ["keyDown", "keyUp"] {
            let mut event = json!({ "type": kind, "key": key, "modifiers": modifiers });
            if key.len() == 1 {
                event["windowsVirtualKeyCode"] = u32::from(key.to_ascii_uppercase().as_bytes()[0]).into();
            }
            if kind == "keyDown" && modifiers & 2 == 0 {
                // the text that makes a button or a form respond to it
                match key {
                    "Enter" => event["text"] = "\r".into(),
                    _ if key.len() == 1 => event["text"] = key.into(),
                    _ => {}
                }
            }
            // the browser's own response to a key depends on this number
            if let Some((_, code)) = [("Tab", 9), ("Enter", 13), ("Escape", 27)].iter().find(|(name, _)| *name == key) {
                event["windowsVirtualKeyCode"] = (*code).into();
            }
            self.call(Some(tab), "Input.dispatchKeyEvent", event);
        }
    }

    /// Sets an input as a user would.
    pub fn set(&mut self, tab: &Tab, id: &str, value: &str) {
        let set = format!(
            "(() => {{ const e = document.getElementById('{id}'); e.value = '{value}'; \
             for (const n of ['input', 'change']) e.dispatchEvent(new Event(n, {{ bubbles: true }})); }})()"
        );
        self.eval(tab, &set);
    }

    /// Saves a screenshot beside the build, for inspection.
    pub fn shoot(&mut self, tab: &Tab, name: &str) {
        let shot = self.call(Some(tab), "Page.captureScreenshot", json!({}));
        let png = base64::engine::general_purpose::STANDARD.decode(shot["data"].as_str().unwrap()).unwrap();
        let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("view-screens");
        std::fs::create_dir_all(&folder).unwrap();
        std::fs::write(folder.join(format!("{name}.png")), png).unwrap();
    }
}

impl Drop for Browser {
    fn drop(&mut self) {
        drop(self.child.kill());
        drop(self.child.wait());
    }
}
