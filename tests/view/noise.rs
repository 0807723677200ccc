//! Malformed messages, and windows that behave badly: the viewer answers, and continues for the others.

use crate::socket::{Server, Window};
use crate::{run, setting, view};
use serde_json::{Map, Value, json};

/// Random numbers (splitmix64).
struct Dice(u64);

impl Dice {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    fn below(&mut self, n: usize) -> usize {
        (self.next() % n as u64) as usize
    }

    fn of<'a, T>(&mut self, list: &'a [T]) -> &'a T {
        &list[self.below(list.len())]
    }
}

/// Returns messages as a page sends them.
fn sound(welcome: &Value, name: &str) -> Vec<Value> {
    let change = |what: Value| json!({ "type": "change", "id": 7, "base": 1, "change": what });
    let edit = |operation: Value| change(json!({ "kind": "edit", "segments": [name], "operation": operation }));
    let mut shown = view(welcome, 0.5, "colour", true);
    shown["preview"] = json!({ "base": 1, "edits": [{ "segments": [name], "operation": "hide" }] });
    vec![
        view(welcome, 0.5, "segments", false),
        shown,
        json!({ "type": "ack", "frame": 1 }),
        json!({ "type": "pick", "id": 1, "pixel": [16, 16], "within": null, "meaning": { "level": 1 }, "combine": "add" }),
        json!({ "type": "adjust", "id": 2, "meaning": { "by": { "scale": 0.5, "threshold": 0.8 } } }),
        json!({ "type": "clear" }),
        json!({ "type": "point", "id": 3, "pixel": [16, 16] }),
        json!({ "type": "centre", "id": 4, "segments": [name], "time": 0.5 }),
        json!({ "type": "commit", "id": 5, "base": 1, "name": "x" }),
        change(json!({ "kind": "group", "name": "both", "segments": [name] })),
        change(json!({ "kind": "rename", "segment": name, "name": "other" })),
        json!({ "type": "job", "id": 6, "base": 1, "task": { "kind": "split", "segment": name, "scale": 0.5, "clusters": null, "replace": false } }),
        json!({ "type": "cancel", "id": 8, "job": 1 }),
        change(json!({ "kind": "remove", "segments": [name] })),
        change(json!({ "kind": "last", "undo": true })),
        edit(json!({ "translate": { "by": [0.1, 0.0, 0.0] } })),
        edit(json!({ "rotate": { "axis": [0, 0, 1], "degrees": 30, "about": null } })),
        edit(json!({ "recolour": { "rgb": [1, 0, 0], "keep_shading": true } })),
    ]
}

/// Returns an odd value to replace another.
fn odd(dice: &mut Dice) -> Value {
    match dice.below(12) {
        0 => Value::Null,
        1 => json!(-1),
        2 => json!(1e308),
        3 => json!(u64::MAX),
        4 => json!(0.0),
        5 => json!(""),
        6 => json!("../../etc/passwd"),
        7 => json!("\u{0}<script>\u{202e}"),
        8 => json!([]),
        9 => json!({}),
        10 => json!([[[[]]]]),
        _ => json!("x".repeat(dice.below(5000))),
    }
}

/// Changes a value at some depth.
fn spoil(dice: &mut Dice, value: &mut Value) {
    match value {
        Value::Object(map) if !map.is_empty() => {
            let keys: Vec<String> = map.keys().cloned().collect();
            let key = dice.of(&keys).clone();
            match dice.below(6) {
                0 => drop(map.remove(&key)),
                1 => drop(map.insert(format!("{key}x"), odd(dice))),
                2 => drop(map.insert(key, odd(dice))),
                _ => spoil(dice, map.get_mut(&key).unwrap()),
            }
        }
        Value::Array(list) if !list.is_empty() => {
            let at = dice.below(list.len());
            match dice.below(5) {
                0 => drop(list.remove(at)),
                1 => list.push(odd(dice)),
                2 => list[at] = odd(dice),
                _ => spoil(dice, &mut list[at]),
            }
        }
        other => *other = odd(dice),
    }
}

/// Returns a text that is almost a message.
fn nearly(dice: &mut Dice, messages: &[Value]) -> String {
    let mut message = dice.of(messages).clone();
    for _ in 0..=dice.below(3) {
        spoil(dice, &mut message);
    }
    let text = message.to_string();
    match dice.below(8) {
        0 => text.chars().take(dice.below(text.len().max(1))).collect(),
        1 => text.replacen(':', "::", 1),
        2 => format!("{text}{text}"),
        3 => "[".repeat(dice.below(20_000)),
        // a duplicate key, which maps of the library cannot hold
        4 => text.replacen('{', "{\"type\":\"clear\",", 1),
        _ => text,
    }
}

#[test]
fn malformed_messages_are_answered_and_change_nothing_else() {
    let folder = run();
    let server = Server::start(folder.path(), &[]);
    let (mut window, welcome) = Window::open(&server);
    let name = window.document["segments"][0]["name"].as_str().unwrap().to_owned();
    let messages = sound(&welcome, &name);
    let mut dice = Dice(setting("VOLSEGGS_VIEW_SEED", 1));
    let count = setting("VOLSEGGS_VIEW_MESSAGES", 2000);
    for k in 0..count {
        let text = nearly(&mut dice, &messages);
        window.say_text(&text);
        if k % 40 == 39 {
            // everything so far was received: this message is answered in its own words
            window.say(&json!({ "type": format!("said-{k}") }));
            window.wait_for(|m| m["message"].as_str().is_some_and(|t| t.contains(&format!("said-{k}`"))));
        }
    }
    // it still draws, for this window and for a new one
    for mut window in [window, Window::open(&server).0] {
        window.say(&view(&welcome, 0.3, "colour", false));
        window.wait_for(|m| m["type"] == "error" || m["type"] == "document");
        window.say(&view(&welcome, 0.31, "colour", false));
        while (window.any_lossless().time - 0.31).abs() > 1e-6 {}
    }
    let (mut window, _) = Window::open(&server);
    window.say_bytes(b"{\"type\":\"clear\"}");
    assert!(window.is_closed(), "binary messages are refused");
}

#[test]
fn a_window_that_reads_nothing_does_not_block_others() {
    let folder = run();
    let server = Server::start(folder.path(), &[]);
    let (mut deaf, welcome) = Window::open(&server);
    let (mut other, _) = Window::open(&server);
    // answers pile up for a window that reads none of them: it is dropped
    let mut said = Map::new();
    said.insert("type".into(), "x".repeat(4000).into());
    let text = Value::Object(said).to_string();
    for k in 0..400 {
        if !deaf.try_say_text(&text) {
            break;
        }
        if k % 40 == 0 {
            other.say(&view(&welcome, f64::from(k) / 400.0, "colour", false));
            other.lossless();
        }
    }
    other.say(&view(&welcome, 0.9, "colour", false));
    while (other.lossless().time - 0.9).abs() > 1e-6 {}
}

#[test]
fn numbers_that_the_commands_refuse_are_refused() {
    let folder = run();
    let server = Server::start(folder.path(), &[]);
    let (mut window, welcome) = Window::open(&server);
    window.say(&view(&welcome, 0.5, "colour", false));
    window.lossless();
    let name = window.document["segments"][0]["name"].as_str().unwrap().to_owned();
    let base = window.document["revision"].clone();
    let edits = [
        (json!({ "translate": { "by": [3e38, 3e38, 3e38] } }), "is too far; give three numbers between -1e15 and 1e15"),
        (json!({ "scale": { "factor": 1e30 } }), "is not a scale; give a number from 1e-6 to 1e6"),
        (json!({ "rotate": { "axis": [0, 0, 1], "degrees": 5, "about": [0, 2e15, 0] } }), "is too far"),
    ];
    for (id, (operation, words)) in (1..).zip(edits) {
        let change = json!({ "kind": "edit", "segments": [name], "operation": operation });
        window.say(&json!({ "type": "change", "id": id, "base": base, "change": change }));
        let answer = window.wait_for(|m| m["id"] == id);
        assert!(answer["type"] == "error" && answer["message"].as_str().unwrap().contains(words), "{answer}");
    }
    for (id, (meaning, words)) in (10..).zip([
        (json!({ "by": { "scale": 1e38, "threshold": 0.5 } }), "scale: "),
        (json!({ "by": { "scale": 0.5, "threshold": -1e38 } }), "threshold: "),
        (json!({ "level": 1_000_000_000_000_000_000_u64 }), "levels at this click"),
        (json!({ "level": 0 }), "a whole number, 1 or above"),
    ]) {
        window.say(&json!({ "type": "pick", "id": id, "pixel": [16, 16], "within": null, "meaning": meaning }));
        let answer = window.wait_for(|m| m["id"] == id);
        assert!(answer["type"] == "error" && answer["message"].as_str().unwrap().contains(words), "{answer}");
    }
    let answers = crate::common::volseggs()
        .current_dir(folder.path())
        .args(["edit", "scale", "run", "--segment", &name, "--factor", "1e30"])
        .assert()
        .code(2)
        .get_output()
        .clone();
    let said = String::from_utf8(answers.stderr).unwrap();
    assert!(said.contains("give a number from 1e-6 to 1e6"), "{said}");
}
