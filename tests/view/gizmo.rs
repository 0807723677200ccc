//! Handles on the picture: what is shown while one is dragged, what is saved when it is released, and one undo for all.

use crate::browser::{Browser, Tab};
use crate::common::run_json;
use crate::socket::{Server, Window};
use crate::{list, run, view};
use serde_json::{Value, json};
use std::path::Path;

fn operations(root: &Path) -> Vec<Value> {
    run_json(root, &["edit", "list", "run"])["operations"].as_array().unwrap().clone()
}

fn change(window: &mut Window, id: u32, what: &Value) -> Value {
    let base = window.document["revision"].clone();
    window.say(&json!({ "type": "change", "id": id, "base": base, "change": what }));
    window.wait_for(|m| m["id"] == id)
}

#[test]
fn a_preview_shows_the_result_of_an_edit_and_saves_nothing() {
    let folder = run();
    let root = folder.path();
    let server = Server::start(root, &[]);
    let (mut window, welcome) = Window::open(&server);
    let name = list(root)[0]["name"].as_str().unwrap().to_owned();
    let centre = |window: &mut Window, id: u32| {
        window.say(&json!({ "type": "centre", "id": id, "segments": [&name], "time": 0.4 }));
        let answer = window.wait_for(|m| m["id"] == id);
        [0, 1, 2].map(|k| answer["at"][k].as_f64().unwrap_or_else(|| panic!("{answer}")))
    };
    let before = centre(&mut window, 1);
    window.say(&view(&welcome, 0.4, "colour", false));
    let plain = window.lossless().picture;

    let operation = json!({ "translate": { "by": [0.25, -0.125, 0.5] } });
    let edit = json!({ "segments": [&name], "operation": operation });
    let mut shown = view(&welcome, 0.4, "colour", false);
    shown["preview"] = json!({ "base": window.document["revision"], "edits": [edit] });
    window.say(&shown);
    let preview = window.lossless().picture;
    assert!(preview != plain && operations(root).is_empty());
    let mut old = shown.clone();
    old["preview"]["base"] = 0.into();
    window.say(&old);
    assert!(window.lossless().picture == plain, "previews for another document are not shown");

    // saved: the same picture, even while the window still requests the preview, and at other times too
    window.say(&shown);
    window.lossless();
    let done = change(&mut window, 2, &json!({ "kind": "edit", "segments": [&name], "operation": operation }));
    assert_eq!(done["type"], "done", "{done}");
    assert_eq!(operations(root).len(), 1);
    assert!(window.lossless().picture == preview, "not applied twice");
    window.say(&view(&welcome, 0.4, "colour", false));
    assert!(window.lossless().picture == preview);
    let after = centre(&mut window, 3);
    for (k, by) in [0.25, -0.125, 0.5].into_iter().enumerate() {
        assert!((after[k] - before[k] - by).abs() < 1e-4, "{before:?} {after:?}");
    }

    for bad in [
        json!({ "base": 1, "edits": [{ "segments": ["nobody"], "operation": "hide" }] }),
        json!({ "base": 1, "edits": [{ "segments": [&name], "operation": { "scale": { "factor": -1.0 } } }] }),
        json!({ "base": 1, "edits": vec![json!({ "segments": [&name], "operation": "hide" }); 9] }),
    ] {
        let mut wrong = view(&welcome, 0.4, "colour", false);
        wrong["preview"] = bad;
        wrong["preview"]["base"] = window.document["revision"].clone();
        window.say(&wrong);
        window.wait_for(|m| m["type"] == "error");
    }
    for segments in [json!([]), json!(["nobody"])] {
        window.say(&json!({ "type": "centre", "id": 9, "segments": segments, "time": 0.4 }));
        assert_eq!(window.wait_for(|m| m["id"] == 9)["type"], "error");
    }
}

#[test]
fn one_undo_reverts_the_last_change_of_segments_or_edits() {
    let folder = run();
    let root = folder.path();
    let server = Server::start(root, &[]);
    let (mut window, _) = Window::open(&server);
    let name = list(root)[0]["name"].as_str().unwrap().to_owned();
    let names = |root: &Path| list(root).iter().map(|s| s["name"].as_str().unwrap().to_owned()).collect::<Vec<_>>();
    let first = names(root);
    let hide = json!({ "kind": "edit", "segments": [&name], "operation": "hide" });
    change(&mut window, 1, &hide);
    change(&mut window, 2, &json!({ "kind": "group", "name": "all", "segments": [&name] }));
    // a change by a command takes its turn too
    run_json(root, &["edit", "opacity", "run", "--segment", &name, "--factor", "0.5"]);
    window.wait_for(|m| m["type"] == "document" && m["edits"].as_array().is_some_and(|e| e.len() == 2));
    let state = |root: &Path| (operations(root).len(), names(root).len().saturating_sub(first.len()));
    assert_eq!(state(root), (2, 1));
    let mut id = 2;
    let mut last = |window: &mut Window, undo: bool| {
        id += 1;
        let answer = change(window, id, &json!({ "kind": "last", "undo": undo }));
        (answer["type"] == "done").then(|| state(root))
    };
    assert_eq!(last(&mut window, true), Some((1, 1)), "the command's edit");
    assert_eq!(last(&mut window, true), Some((1, 0)), "the group");
    assert_eq!(last(&mut window, false), Some((1, 1)));
    assert_eq!(last(&mut window, false), Some((2, 1)));
    assert_eq!(last(&mut window, false), None, "nothing left to redo");
    for wanted in [(1, 1), (1, 0), (0, 0)] {
        assert_eq!(last(&mut window, true), Some(wanted));
    }
    // undo reaches what existed before the viewer: the segments by colour
    last(&mut window, true).unwrap();
    assert!(list(root).is_empty());
    assert_eq!(last(&mut window, true), None, "nothing left to undo");
}

/// Returns a point at which a handle can be grabbed, in window coordinates: at 0.7 of its line, or its centre.
fn grip(browser: &mut Browser, tab: &Tab, label: &str) -> [f64; 2] {
    let at = browser.eval(
        tab,
        &format!(
            "(() => {{ const g = document.querySelector('#gizmo [aria-label=\"{label}\"] .grip'); \
             const box = document.getElementById('stage').getBoundingClientRect(); \
             if (!g.getTotalLength || g.tagName === 'rect') {{ const r = g.getBoundingClientRect(); \
             return [r.left + r.width / 2, r.top + r.height / 2]; }} \
             const p = g.getPointAtLength(0.7 * g.getTotalLength()); return [box.left + p.x, box.top + p.y]; }})()"
        ),
    );
    [0, 1].map(|k| at[k].as_f64().unwrap())
}

#[test]
fn a_user_drags_handles_and_undoes_it() {
    let Some(mut browser) = Browser::start() else { return };
    let folder = run();
    let root = folder.path();
    let server = Server::start(root, &[]);
    let tab = browser.visit(&server);
    let hidden = "document.getElementById('gizmo').hasAttribute('hidden')";
    assert_eq!(browser.eval(&tab, hidden), true, "nothing is checked");
    browser.eval(&tab, "document.querySelector('#tree input[type=checkbox]').click()");
    browser.wait(&tab, &format!("!{hidden}"));
    let plain = browser.picture(&tab);
    let edits = "document.querySelectorAll('#edits li').length";

    let pull = |browser: &mut Browser, label: &str, by: [f64; 2]| {
        let from = grip(browser, &tab, label);
        browser.mouse(&tab, "mousePressed", from);
        for k in 1..=8 {
            let part = f64::from(k) / 8.0;
            browser.mouse(&tab, "mouseMoved", [from[0] + part * by[0], from[1] + part * by[1]]);
        }
        [from[0] + by[0], from[1] + by[1]]
    };
    // Esc during a drag leaves everything as it was
    let at = pull(&mut browser, "Move along z", [0.0, -60.0]);
    browser.rests(&tab);
    assert_ne!(browser.picture(&tab), plain, "the picture follows");
    browser.shoot(&tab, "4-dragged");
    browser.key(&tab, "Escape", 0);
    browser.rests(&tab);
    browser.mouse(&tab, "mouseReleased", at);
    assert_eq!((browser.picture(&tab), operations(root).len()), (plain.clone(), 0));

    for (n, (label, by, kind)) in [
        ("Move along z", [0.0, -60.0], "translate"),
        ("Turn about z", [50.0, 0.0], "rotate"),
        ("Scale", [60.0, 0.0], "scale"),
    ]
    .into_iter()
    .enumerate()
    {
        let before = browser.picture(&tab);
        let at = pull(&mut browser, label, by);
        browser.rests(&tab);
        let preview = browser.picture(&tab);
        assert_eq!(operations(root).len(), n, "nothing is saved yet");
        browser.mouse(&tab, "mouseReleased", at);
        browser.wait(&tab, &format!("{edits} === {}", n + 1));
        browser.rests(&tab);
        assert!(browser.picture(&tab) == preview && preview != before, "{label}: the saved edit matches the preview");
        let made = operations(root);
        assert_eq!(made.len(), n + 1, "one drag is one edit");
        assert!(made[n].to_string().contains(kind), "{made:?}");
    }
    let by = &operations(root)[0]["operation"]["translate"]["by"];
    assert!(by[0] == 0.0 && by[1] == 0.0 && by[2].as_f64().unwrap() > 0.0, "{by}");

    // with a second picture beside the first, the handles stay on the first
    browser.set(&tab, "compare", "plain");
    browser.rests(&tab);
    let within = "(() => { const [g, c] = ['gizmo', 'picture'].map((id) => document.getElementById(id).getBoundingClientRect()); \
                  return Math.abs(g.left - c.left) + Math.abs(g.right - c.right) < 2; })()";
    browser.wait(&tab, within);
    browser.set(&tab, "compare", "");
    browser.rests(&tab);
    browser.wait(&tab, within);

    // by keys, then everything is undone, and one step redone
    browser.eval(&tab, "document.querySelector('#gizmo [aria-label=\"Move along x\"]').focus()");
    browser.key(&tab, "ArrowRight", 0);
    browser.key(&tab, "ArrowRight", 0);
    browser.key(&tab, "Enter", 0);
    browser.wait(&tab, &format!("{edits} === 4"));
    for left in (0..4).rev() {
        browser.key(&tab, "z", 2);
        browser.wait(&tab, &format!("{edits} === {left}"));
    }
    browser.rests(&tab);
    assert_eq!((browser.picture(&tab), operations(root).len()), (plain, 0));
    browser.key(&tab, "z", 2 | 8);
    browser.wait(&tab, &format!("{edits} === 1"));
    assert!(browser.wrong.is_empty(), "{:?}", browser.wrong);
}
