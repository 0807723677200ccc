//! Memory over many frames.

use crate::socket::{Server, Window};
use crate::{run, setting, view};

/// Maximum growth of the memory in bytes: what allocators retain; a leak of a single picture's pixels per frame would
/// be more.
const BOUND: u64 = 8 << 20;
/// Times of the playback, all of which are soon cached.
const TIMES: u64 = 20;

#[test]
fn memory_stays_flat() {
    let folder = run();
    let server = Server::start(folder.path(), &["--cache", "4M"]);
    let Some(start) = server.memory() else { return };
    let (mut window, welcome) = Window::open(&server);
    let mut frames = |count: u64| {
        for k in 0..count {
            let mut wanted = view(&welcome, (k % TIMES) as f64 / TIMES as f64, "colour", true);
            wanted["eye"][0] = (3.0 + (k % 97) as f64 / 97.0).into();
            wanted["size"] = serde_json::json!([64, 64]);
            window.say(&wanted);
            window.frame(|_| true);
        }
    };
    frames(200);
    let before = server.memory().unwrap();
    let count = setting("VOLSEGGS_VIEW_FRAMES", 400);
    frames(count);
    let after = server.memory().unwrap();
    println!("at the start {start} bytes, after 200 frames {before}, after {count} more {after}");
    assert!(after < before + BOUND, "after {count} frames {after} bytes, before {before}");
}
