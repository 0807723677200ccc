//! The tree of segments: names, parts, colours and opacities, and what a double click finds.

use crate::browser::{Browser, MIDDLE};
use crate::common::{run_json, volseggs};
use crate::socket::{Server, Window};
use crate::{list, run, view};
use serde_json::{Value, json};
use std::path::Path;

fn names(root: &Path) -> Vec<String> {
    list(root).iter().map(|s| s["name"].as_str().unwrap().to_owned()).collect()
}

fn operations(root: &Path) -> Vec<Value> {
    run_json(root, &["edit", "list", "run"])["operations"].as_array().unwrap().clone()
}

#[test]
fn renaming_a_segment_updates_edits_and_masks() {
    let folder = run();
    let root = folder.path();
    let server = Server::start(root, &[]);
    let (mut window, welcome) = Window::open(&server);
    let old = names(root)[0].clone();
    let mut id = 0;
    let mut change = |window: &mut Window, what: Value| {
        id += 1;
        let base = window.document["revision"].clone();
        window.say(&json!({ "type": "change", "id": id, "base": base, "change": what }));
        window.wait_for(|m| m["id"] == id)
    };
    change(&mut window, json!({ "kind": "edit", "segments": [&old], "operation": { "opacity": { "factor": 0.5 } } }));
    window.say(&view(&welcome, 0.5, "colour", false));
    let picture = window.lossless().picture;
    let done = change(&mut window, json!({ "kind": "rename", "segment": &old, "name": "core" }));
    assert_eq!(done["type"], "done", "{done}");
    assert!(names(root).contains(&"core".to_owned()) && !names(root).contains(&old));
    assert_eq!(operations(root)[0]["segments"], json!(["core"]), "edits follow");
    let row = window.document["segments"].as_array().unwrap().iter().find(|s| s["name"] == "core").unwrap();
    assert_eq!((&row["opacity"], &row["hidden"]), (&json!(0.5), &json!(false)));
    assert!(window.lossless().picture == picture, "the picture is unchanged");
    let nobody = json!({ "kind": "rename", "segment": "nobody", "name": "x" });
    assert_eq!(change(&mut window, nobody)["type"], "error");
    // masks identify it by its Gaussians
    run_json(root, &["segment", "fine", "run", "--steps", "2", "--pixels", "64"]);
    let known = window.document["revision"].as_u64();
    window.wait_for(|m| m["type"] == "document" && m["revision"].as_u64() > known);
    // one step back restores the names in edits too; the edit is the step before
    change(&mut window, json!({ "kind": "last", "undo": true }));
    assert_eq!((names(root)[0].clone(), &operations(root)[0]["segments"]), (old.clone(), &json!([&old])));
    change(&mut window, json!({ "kind": "last", "undo": false }));
    assert_eq!(operations(root)[0]["segments"], json!(["core"]));
}

#[test]
fn a_pixel_maps_to_a_point_in_space() {
    let folder = run();
    let server = Server::start(folder.path(), &[]);
    let (mut window, welcome) = Window::open(&server);
    window.say(&json!({ "type": "point", "id": 1, "pixel": [16, 16] }));
    assert_eq!(window.wait_for(|m| m["id"] == 1)["type"], "error", "nothing is shown yet");
    window.say(&view(&welcome, 0.5, "colour", false));
    window.say(&json!({ "type": "point", "id": 2, "pixel": [16, 16] }));
    let answer = window.wait_for(|m| m["id"] == 2);
    let at = [0, 1, 2].map(|k| answer["at"][k].as_f64().unwrap_or_else(|| panic!("{answer}")));
    // on the ray through the middle of the picture, near the middle of the scene
    let (eye, centre) = ([3.0, -2.0, 1.5], [0, 1, 2].map(|k| welcome["centre"][k].as_f64().unwrap()));
    let sub = |a: [f64; 3], b: [f64; 3]| [0, 1, 2].map(|k| a[k] - b[k]);
    let dot = |a: [f64; 3], b: [f64; 3]| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
    let (ray, found) = (sub(centre, eye), sub(at, eye));
    let along = dot(ray, found) / dot(ray, ray);
    assert!(along > 0.5 && along < 1.5, "{at:?}");
    let off = dot(found, found) - along * along * dot(ray, ray);
    assert!(off.max(0.0).sqrt() < 0.1, "{at:?} is {off} away from the ray");
    window.say(&json!({ "type": "point", "id": 3, "pixel": [99, 0] }));
    assert!(window.wait_for(|m| m["id"] == 3)["message"].as_str().unwrap().contains("32x32"));
}

#[test]
fn a_user_works_in_the_tree() {
    let Some(mut browser) = Browser::start() else { return };
    let folder = run();
    let root = folder.path();
    let server = Server::start(root, &[]);
    let tab = browser.visit(&server);
    let plain = browser.picture(&tab);
    let old = names(root)[0].clone();
    let find = |key: &str| format!("document.querySelector('[data-key=\"{key}\"]')");
    let set = |key: &str, value: &str, events: &str| {
        format!(
            "(() => {{ const e = {}; e.value = '{value}'; for (const n of {events}) e.dispatchEvent(new Event(n, {{ bubbles: true }})); }})()",
            find(key)
        )
    };

    // opacity: shown at once, saved as one edit when it comes to rest
    let opacity = format!("opacity {old}");
    browser.eval(&tab, &set(&opacity, "0.6", "['input']"));
    browser.eval(&tab, &set(&opacity, "0.2", "['input']"));
    browser.rests(&tab);
    assert_ne!(browser.picture(&tab), plain);
    assert!(operations(root).is_empty(), "shown but not saved");
    browser.eval(&tab, &set(&opacity, "0.2", "['input', 'change']"));
    browser.wait(&tab, "document.querySelectorAll('#edits li').length === 1");
    assert!(operations(root)[0].to_string().contains("0.2"));
    browser.eval(&tab, &set(&format!("colour {old}"), "#ff8800", "['input', 'change']"));
    browser.wait(&tab, "document.querySelectorAll('#edits li').length === 2");
    assert!(operations(root)[1].to_string().contains("recolour"));
    // a hidden segment is shown again by the same edit that sets its opacity
    for (value, edits) in [("0", 3), ("0.5", 4)] {
        browser.eval(&tab, &set(&opacity, value, "['input', 'change']"));
        browser.wait(&tab, &format!("document.querySelectorAll('#edits li').length === {edits}"));
    }
    assert_eq!(operations(root)[3]["operation"]["opacity"]["show"], true);
    for left in [3, 2] {
        browser.eval(&tab, "document.getElementById('edits-undo').click()");
        browser.wait(&tab, &format!("document.querySelectorAll('#edits li').length === {left}"));
    }

    // another window has checked and hidden it too
    let other = browser.visit(&server);
    browser
        .eval(&other, &format!("{}.click(); {}.click()", find(&format!("check {old}")), find(&format!("eye {old}"))));
    browser.rests(&other);

    // another name; what is checked and hidden stays so
    browser.eval(&tab, &format!("{}.click(); {}.click()", find(&format!("check {old}")), find(&format!("eye {old}"))));
    browser.eval(&tab, &format!("{}.click()", find(&format!("more {old}"))));
    browser.rests(&tab);
    browser.shoot(&tab, "5-row");
    browser.eval(
        &tab,
        &format!(
            "(() => {{ const e = {}; e.value = 'core'; e.form.requestSubmit(); }})()",
            find(&format!("name {old}"))
        ),
    );
    browser.wait(&tab, "document.getElementById('tree').textContent.includes('core')");
    assert_eq!(operations(root)[1]["segments"], json!(["core"]));
    browser.rests(&tab);
    let kept = format!(
        "[{}.checked, {}.ariaPressed, {}.ariaExpanded, location.hash.includes('hidden=core')]",
        find("check core"),
        find("eye core"),
        find("more core")
    );
    browser.wait(&tab, &format!("{kept}.every((kept) => String(kept) === 'true')"));
    let there = format!("[{}.checked, {}.ariaPressed]", find("check core"), find("eye core"));
    browser.wait(&other, &format!("{there}.every((kept) => String(kept) === 'true')"));
    // and also when a command renames it again
    for (from, to) in [("core", "kernel"), ("kernel", "core")] {
        volseggs().current_dir(root).args(["segment", "rename", "run", from, to]).assert().success();
        browser.wait(&other, &format!("{}.checked", find(&format!("check {to}"))));
    }
    assert_eq!(browser.eval(&other, &there), json!([true, "true"]));
    browser.wait(&other, "document.getElementById('picture').dataset.lossless === 'true'");
    browser.call(Some(&other), "Page.close", json!({}));
    browser.eval(&tab, &format!("{}.click(); {}.click()", find("check core"), find("eye core")));
    browser.rests(&tab);

    // from the first to the last, with Shift
    for modifiers in [false, true] {
        let place = if modifiers { "last" } else { "first" };
        let click = format!(
            "document.querySelector('#tree li:{place}-child input[type=checkbox]')\
             .dispatchEvent(new MouseEvent('click', {{ bubbles: true, shiftKey: {modifiers} }}))"
        );
        browser.eval(&tab, &click);
    }
    browser.wait(&tab, "[...document.querySelectorAll('#tree input[type=checkbox]')].every((b) => b.checked)");

    // questions are asked on the page: a name is given, or not
    let names_now = |root: &Path| names(root).len();
    let before = names_now(root);
    for (given, key) in [("", "Escape"), ("whole", "Enter")] {
        // a question that was just closed does not answer the next one
        let ask = "document.getElementById('group').click()";
        browser.eval(&tab, &format!("{ask}; document.getElementById('question').close('no'); {ask}"));
        browser.wait(&tab, "document.getElementById('question').open");
        browser.shoot(&tab, "5-question");
        browser.set(&tab, "question-name", given);
        browser.eval(&tab, "document.getElementById('question-name').focus()");
        browser.key(&tab, key, 0);
        browser.wait(&tab, "!document.getElementById('question').open");
    }
    browser.wait(&tab, "document.getElementById('tree').textContent.includes('whole')");
    assert_eq!(names_now(root), before + 1);
    browser.eval(&tab, "document.getElementById('coarse').click()");
    browser.wait(&tab, "document.getElementById('question-text').textContent.includes('replace all')");
    browser.eval(&tab, "document.getElementById('question-no').click()");
    browser.wait(&tab, "!document.getElementById('question').open");
    browser.eval(&tab, "document.getElementById('segments-undo').click()");
    browser.wait(&tab, "!document.getElementById('tree').textContent.includes('whole')");
    assert_eq!(names_now(root), before, "and nothing was replaced");

    // a double click: the scene turns about the place there, and nothing is selected
    let tab = browser.visit(&server);
    let middle = browser.eval(&tab, MIDDLE);
    let [x, y] = [0, 1].map(|k| middle[k].as_f64().unwrap() + 12.0);
    let address = browser.eval(&tab, "location.hash");
    browser.click(&tab, [x, y]);
    for kind in ["mousePressed", "mouseReleased"] {
        let event = json!({ "type": kind, "x": x, "y": y, "button": "left", "buttons": 1, "clickCount": 2 });
        browser.call(Some(&tab), "Input.dispatchMouseEvent", event);
    }
    browser.wait(&tab, &format!("location.hash !== {address}"));
    browser.rests(&tab);
    assert_eq!(browser.eval(&tab, "document.getElementById('levels').children.length"), 0);
    assert!(browser.wrong.is_empty(), "{:?}", browser.wrong);
}
