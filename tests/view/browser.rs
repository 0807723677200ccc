//! The page in a real browser: Chromium without a window, driven by its own debugging protocol over a websocket, which
//! needs neither a driver program nor another dependency.

use crate::common::{run_json, volseggs};
use crate::run;
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
const PATIENCE: Duration = Duration::from_secs(60);
/// Width and height of the window.
const WINDOW: [u32; 2] = [1100, 760];

/// Chromium.
pub struct Browser {
    child: Child,
    socket: WebSocket<MaybeTlsStream<TcpStream>>,
    calls: u64,
    /// Errors and violations of the page's policy.
    pub wrong: Vec<String>,
    _profile: TempDir,
}

/// A tab of it.
#[derive(Clone)]
pub struct Tab(String);

impl Browser {
    /// Starts it; `None` where there is none, which has been said.
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
        // what it goes on to say is of no matter, but must go somewhere
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

    /// Opens a page in a tab of its own.
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

    /// Opens the page of a viewer in a tab of its own, and waits for its picture.
    pub fn visit(&mut self, server: &Server) -> Tab {
        let tab = self.open(&server.url());
        self.rests(&tab);
        tab
    }

    /// The value of an expression on the page.
    pub fn eval(&mut self, tab: &Tab, expression: &str) -> Value {
        let asked = json!({ "expression": expression, "awaitPromise": true, "returnByValue": true });
        let answer = self.call(Some(tab), "Runtime.evaluate", asked);
        assert!(answer["exceptionDetails"].is_null(), "{expression}: {answer}");
        answer["result"]["value"].clone()
    }

    /// Waits until an expression is true.
    pub fn wait(&mut self, tab: &Tab, expression: &str) {
        let until = Instant::now() + PATIENCE;
        // the page may not be there yet
        let guarded = format!("(() => {{ try {{ return Boolean({expression}); }} catch {{ return false; }} }})()");
        while self.eval(tab, &guarded) != true {
            if Instant::now() > until {
                let said = self.eval(tab, "document.body.innerText.slice(0, 600)");
                panic!("not in {PATIENCE:?}: {expression}; wrong: {:?}; the page: {said}", self.wrong);
            }
            std::thread::sleep(Duration::from_millis(30));
        }
    }

    /// Waits until the picture shows all that was asked for, without loss.
    pub fn rests(&mut self, tab: &Tab) {
        std::thread::sleep(Duration::from_millis(250));
        self.wait(tab, "document.getElementById('picture').dataset.lossless === 'true'");
    }

    /// A number that tells the picture from others.
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
                // what makes a button or a form act on it
                match key {
                    "Enter" => event["text"] = "\r".into(),
                    _ if key.len() == 1 => event["text"] = key.into(),
                    _ => {}
                }
            }
            // what the browser itself does with a key goes by this number
            if let Some((_, code)) = [("Tab", 9), ("Enter", 13), ("Escape", 27)].iter().find(|(name, _)| *name == key) {
                event["windowsVirtualKeyCode"] = (*code).into();
            }
            self.call(Some(tab), "Input.dispatchKeyEvent", event);
        }
    }

    /// Sets an input as a person would.
    pub fn set(&mut self, tab: &Tab, id: &str, value: &str) {
        let set = format!(
            "(() => {{ const e = document.getElementById('{id}'); e.value = '{value}'; \
             for (const n of ['input', 'change']) e.dispatchEvent(new Event(n, {{ bubbles: true }})); }})()"
        );
        self.eval(tab, &set);
    }

    /// Writes what is seen beside the build, to look at.
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

#[test]
fn a_picture_is_saved_dropped_in_again_and_shared_as_a_link_and_a_command() {
    let Some(mut browser) = Browser::start() else { return };
    let folder = run();
    let root = folder.path();
    let server = Server::start(root, &[]);
    let downloads = tempfile::tempdir().unwrap();
    let into = json!({ "behavior": "allow", "downloadPath": downloads.path().display().to_string() });
    browser.call(None, "Browser.setDownloadBehavior", into);
    let tab = browser.visit(&server);
    browser.set(&tab, "when", "0.8");
    browser.set(&tab, "look", "velocity x");
    browser.eval(&tab, "document.querySelector('[data-axis=\"0,1,0\"]').click()");
    browser.eval(&tab, "document.querySelector('#tree button').click()");
    browser.rests(&tab);
    // the legend is a bar with numbers, which can be held while the time changes
    assert_eq!(browser.eval(&tab, "document.querySelectorAll('#legend-numbers span').length"), 3);
    assert_eq!(browser.eval(&tab, "document.getElementById('palette').value"), "cool-warm");
    browser.eval(&tab, "document.getElementById('hold').click()");
    browser.rests(&tab);
    let numbers = "document.getElementById('legend-numbers').textContent + location.hash.split('range=')[1]";
    browser.wait(&tab, "location.hash.includes('range=')");
    let held = browser.eval(&tab, numbers);
    browser.set(&tab, "palette", "red-green");
    browser.rests(&tab);
    browser.shoot(&tab, "8-legend");
    assert!(browser.eval(&tab, numbers).as_str().unwrap()[..6] == held.as_str().unwrap()[..6]);
    browser.set(&tab, "look", "affinity");
    browser.rests(&tab);
    assert_eq!(browser.eval(&tab, "document.getElementById('legend-bar').hidden"), true);
    browser.shoot(&tab, "9-affinity");
    browser.set(&tab, "look", "velocity x");
    browser.rests(&tab);
    let before = browser.picture(&tab);
    browser.eval(&tab, "document.getElementById('save').click()");
    let file = downloads.path().join("volseggs.png");
    let until = Instant::now() + PATIENCE;
    while !file.exists() {
        assert!(Instant::now() < until, "no download");
        std::thread::sleep(Duration::from_millis(50));
    }
    volseggs()
        .current_dir(root)
        .args(["render", "run", "--view", file.to_str().unwrap(), "--out", "still"])
        .assert()
        .success();
    let pixels = |path: &Path| image::open(path).unwrap().to_rgb8();
    assert!(pixels(&file) == pixels(&root.join("still/0000.png")));

    // something else, then the picture again
    let drop_in = |browser: &mut Browser, bytes: &[u8], name: &str| {
        let text = base64::engine::general_purpose::STANDARD.encode(bytes);
        let dropped = format!(
            "(() => {{ const d = new DataTransfer(); \
             d.items.add(new File([Uint8Array.from(atob('{text}'), (c) => c.charCodeAt(0))], '{name}')); \
             document.getElementById('stage').dispatchEvent(new DragEvent('drop', {{ dataTransfer: d, bubbles: true, cancelable: true }})); }})()"
        );
        browser.eval(&tab, &dropped);
    };
    browser.eval(&tab, "document.getElementById('reset').click()");
    browser.set(&tab, "when", "0.1");
    browser.set(&tab, "look", "colour");
    browser.eval(&tab, "document.querySelector('#tree button').click()");
    browser.rests(&tab);
    assert_ne!(browser.picture(&tab), before);
    drop_in(&mut browser, &std::fs::read(&file).unwrap(), "volseggs.png");
    browser.wait(&tab, "document.getElementById('message').textContent === 'As in volseggs.png.'");
    browser.rests(&tab);
    assert_eq!(browser.picture(&tab), before, "the picture brings its view back");
    browser.shoot(&tab, "4-dropped");
    drop_in(&mut browser, b"{\"view\":{\"eye\":[\"<b>\"]}}", "x.json");
    browser.wait(&tab, "document.getElementById('message').textContent.includes('there is no view in it')");

    // a path: two keyframes, played, saved, rendered, and dropped in again
    browser.set(&tab, "key-gap", "1");
    browser.eval(&tab, "document.getElementById('key-add').click()");
    browser.eval(&tab, "document.querySelector('[data-axis=\"1,0,0\"]').click()");
    browser.set(&tab, "when", "0.3");
    browser.eval(&tab, "document.getElementById('key-add').click()");
    browser.rests(&tab);
    let end = browser.picture(&tab);
    browser.eval(&tab, "document.querySelector('#keys button').click()");
    browser.rests(&tab);
    assert_eq!(browser.picture(&tab), before, "a keyframe is the view that it was made of");
    browser.eval(&tab, "document.getElementById('path-play').click()");
    browser.wait(&tab, "document.getElementById('path-play').textContent === 'stop'");
    browser.wait(&tab, "document.getElementById('path-play').textContent === 'play path'");
    browser.rests(&tab);
    assert_eq!(browser.picture(&tab), end, "it ends at the last one");
    browser.shoot(&tab, "5-path");
    browser.eval(&tab, "document.getElementById('path-save').click()");
    let path = downloads.path().join("path.json");
    while !path.exists() {
        assert!(Instant::now() < until + PATIENCE, "no download");
        std::thread::sleep(Duration::from_millis(50));
    }
    let render = ["render", "run", "--path", path.to_str().unwrap(), "--frames", "3", "--out", "flight"];
    volseggs().current_dir(root).args(render).assert().success();
    assert!(pixels(&root.join("flight/0000.png")) == pixels(&file), "it begins with the picture that was saved");
    browser.eval(&tab, "document.querySelectorAll('#keys [aria-label]').forEach((b) => b.click())");
    browser.eval(&tab, "document.querySelectorAll('#keys [aria-label]').forEach((b) => b.click())");
    browser.wait(&tab, "document.querySelectorAll('#keys li').length === 0");
    drop_in(&mut browser, &std::fs::read(&path).unwrap(), "path.json");
    browser.wait(&tab, "document.querySelectorAll('#keys li').length === 2");
    browser.rests(&tab);
    assert_eq!(browser.picture(&tab), before);

    browser.eval(&tab, "document.getElementById('copy-command').click()");
    browser.wait(&tab, "document.getElementById('copied').value.startsWith('volseggs render run --view ')");
    browser.eval(&tab, "document.getElementById('copy-link').click()");
    browser.wait(&tab, "document.getElementById('copied').value.startsWith('http')");
    let link = browser.eval(&tab, "document.getElementById('copied').value");
    let link = link.as_str().unwrap();
    assert!(link.contains("#eye=") && !link.contains(&server.token), "{link}");
    let other = browser.open(link);
    browser.rests(&other);
    assert_eq!(browser.picture(&other), before);
    assert!(browser.wrong.is_empty(), "{:?}", browser.wrong);
}

#[test]
fn a_person_compares_with_the_image_another_time_and_no_edits() {
    let Some(mut browser) = Browser::start() else { return };
    let folder = run();
    let server = Server::start(folder.path(), &[]);
    let tab = browser.visit(&server);
    browser.wait(&tab, "document.querySelectorAll('#test-view option').length > 1");
    let columns = |browser: &mut Browser| {
        let widths = "['picture', 'other'].map((id) => document.getElementById(id)).map((c) => [c.hidden, c.width])";
        browser.eval(&tab, widths)
    };
    browser.set(&tab, "test-view", "1");
    browser.set(&tab, "compare", "image");
    browser.wait(&tab, "document.getElementById('other').dataset.image === '1'");
    browser.rests(&tab);
    let now = columns(&mut browser);
    assert!(now[0][0] == false && now[1][0] == false && now[0][1] == now[1][1], "{now}");
    browser.shoot(&tab, "6-image");
    // how far apart the two pictures are
    let apart = "(() => { const [a, b] = ['picture', 'other'].map((id) => { const c = document.getElementById(id); \
                 return c.getContext('2d').getImageData(c.width / 4, c.height / 4, c.width / 2, c.height / 2).data; }); \
                 let sum = 0; for (let i = 0; i < a.length; i++) if (i % 4 < 3 && b[i - i % 4 + 3]) sum += Math.abs(a[i] - b[i]); \
                 return sum / a.length; })()";
    browser.set(&tab, "compare", "time");
    browser.set(&tab, "other-time", "0.9");
    browser.rests(&tab);
    assert!(browser.eval(&tab, apart).as_f64().unwrap() > 0.0);
    browser.set(&tab, "compare-how", "wipe");
    browser.rests(&tab);
    browser.eval(&tab, "document.getElementById('divider').focus()");
    for kind in ["keyDown", "keyUp"] {
        browser.call(Some(&tab), "Input.dispatchKeyEvent", json!({ "type": kind, "key": "ArrowRight" }));
    }
    browser.wait(&tab, "document.getElementById('divider').getAttribute('aria-valuenow') === '52'");
    browser.shoot(&tab, "7-divider");
    let wide = columns(&mut browser);
    assert!(wide[0][1].as_f64() > now[0][1].as_f64(), "{wide}");
    browser.set(&tab, "compare-how", "flip");
    browser.rests(&tab);
    assert_eq!(columns(&mut browser)[1][0], true);
    browser.eval(&tab, "document.getElementById('compare-flip').click()");
    assert_eq!(columns(&mut browser)[1][0], false);
    browser.set(&tab, "compare", "plain");
    browser.rests(&tab);
    assert_eq!(browser.eval(&tab, apart), 0.0, "there are no edits");
    browser.set(&tab, "compare", "");
    browser.rests(&tab);
    assert_eq!(columns(&mut browser)[1][0], true);
    assert!(browser.wrong.is_empty(), "{:?}", browser.wrong);
}

/// The middle of the picture, where something is, in the window.
pub const MIDDLE: &str = "(() => { const b = document.getElementById('picture').getBoundingClientRect(); \
                      return [b.left + b.width / 2, b.top + b.height / 2]; })()";

#[test]
fn a_person_turns_scrubs_clicks_commits_edits_and_undoes() {
    let Some(mut browser) = Browser::start() else { return };
    let folder = run();
    let root = folder.path();
    let server = Server::start(root, &[]);
    let tab = browser.visit(&server);
    assert!(!browser.eval(&tab, "location.href").as_str().unwrap().contains(&server.token), "the secret is gone");
    browser.shoot(&tab, "1-start");

    // turn
    let before = browser.picture(&tab);
    let middle = browser.eval(&tab, MIDDLE);
    let [x, y] = [0, 1].map(|k| middle[k].as_f64().unwrap());
    browser.mouse(&tab, "mousePressed", [x, y]);
    for k in 1..=10 {
        browser.mouse(&tab, "mouseMoved", [x + 9.0 * f64::from(k), y + 3.0 * f64::from(k)]);
    }
    browser.mouse(&tab, "mouseReleased", [x + 90.0, y + 30.0]);
    browser.rests(&tab);
    assert_ne!(browser.picture(&tab), before, "a drag turns the scene");
    browser.eval(&tab, "document.getElementById('reset').click()");
    browser.rests(&tab);
    assert_eq!(browser.picture(&tab), before, "and a button turns it back");

    // time
    browser.set(&tab, "when", "0.9");
    browser.wait(&tab, "document.getElementById('picture').dataset.time === '0.9000'");
    browser.rests(&tab);
    assert_ne!(browser.picture(&tab), before);
    browser.set(&tab, "when", "0.5");
    browser.rests(&tab);
    browser.eval(&tab, "document.getElementById('play').click()");
    browser.wait(&tab, "Number(document.getElementById('picture').dataset.time) > 0.55");
    browser.eval(&tab, "document.getElementById('play').click()");
    browser.set(&tab, "when", "0.5");
    browser.rests(&tab);

    // a click, a level or slider, a segment
    browser.click(&tab, [x, y]);
    browser.wait(&tab, "/Gaussians/.test(document.getElementById('selected').textContent)");
    browser.rests(&tab);
    assert_ne!(browser.picture(&tab), before, "what was clicked stands out");
    browser.shoot(&tab, "2-clicked");
    let likeliest = browser.eval(&tab, "document.getElementById('selected').textContent");
    browser.set(&tab, "cosine", "0.99");
    browser.wait(&tab, &format!("document.getElementById('selected').textContent !== {likeliest}"));
    browser.set(&tab, "name", "mine");
    browser.eval(&tab, "document.getElementById('commit').requestSubmit()");
    browser.wait(&tab, "document.getElementById('tree').textContent.includes('mine')");
    let listed = run_json(root, &["segment", "list", "run"]);
    let mine = listed["segments"].as_array().unwrap().iter().find(|s| s["name"] == "mine").unwrap().clone();
    assert!(mine["origin"]["threshold"].as_f64().unwrap() > 0.98, "{mine}");

    // another window sees it too, and the same picture at the same address
    browser.rests(&tab);
    std::thread::sleep(Duration::from_millis(500));
    let here = browser.eval(&tab, "location.href");
    let other = browser.open(here.as_str().unwrap());
    browser.wait(&other, "document.getElementById('tree').textContent.includes('mine')");
    browser.rests(&other);
    assert_eq!(browser.picture(&other), browser.picture(&tab), "the address holds the view");

    // an edit, seen by the command, then undone
    let plain = browser.picture(&tab);
    browser.eval(&tab, "document.querySelector('#tree input[type=checkbox]').click()");
    browser.set(&tab, "factor", "0.2");
    browser.eval(&tab, "document.getElementById('opacity').click()");
    browser.wait(&tab, "document.querySelectorAll('#edits li').length === 1");
    browser.rests(&tab);
    assert_ne!(browser.picture(&tab), plain);
    browser.shoot(&tab, "3-edited");
    let edits = |root: &Path| run_json(root, &["edit", "list", "run"])["operations"].as_array().unwrap().len();
    assert_eq!(edits(root), 1);
    browser.eval(&tab, "document.getElementById('edits-undo').click()");
    browser.wait(&tab, "document.querySelectorAll('#edits li').length === 0");
    browser.rests(&tab);
    assert_eq!((edits(root), browser.picture(&tab)), (0, plain));

    // a command beside the viewer
    volseggs().current_dir(root).args(["segment", "remove", "run", "mine"]).assert().success();
    browser.wait(&other, "!document.getElementById('tree').textContent.includes('mine')");
    assert!(browser.wrong.is_empty(), "{:?}", browser.wrong);
    drop(server);
    browser.wait(&tab, "document.getElementById('message').textContent.includes('does not answer')");
}
