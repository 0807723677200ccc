//! What a user does on the page, in a real browser.

use crate::browser::{Browser, MIDDLE, PATIENCE};
use crate::common::{run_json, volseggs};
use crate::run;
use crate::socket::Server;
use base64::Engine;
use serde_json::json;
use std::path::Path;
use std::time::{Duration, Instant};

#[test]
fn a_picture_is_saved_dropped_back_in_and_shared_as_a_link_and_a_command() {
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
    let bar = "document.querySelectorAll('#legend-numbers span').length";
    assert_eq!(browser.eval(&tab, bar), 3, "the legend comes back with the colours");
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
    browser.wait(&tab, "document.getElementById('message').textContent === 'View restored from volseggs.png.'");
    browser.rests(&tab);
    assert_eq!(browser.picture(&tab), before, "the picture restores its view");
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
    assert_eq!(browser.picture(&tab), before, "a keyframe shows the view that it was made from");
    browser.eval(&tab, "document.getElementById('path-play').click()");
    browser.wait(&tab, "document.getElementById('path-play').textContent === 'stop'");
    browser.wait(&tab, "document.getElementById('path-play').textContent === 'play path'");
    browser.rests(&tab);
    assert_eq!(browser.picture(&tab), end, "the path ends at the last keyframe");
    browser.shoot(&tab, "5-path");
    browser.eval(&tab, "document.getElementById('path-save').click()");
    let path = downloads.path().join("path.json");
    while !path.exists() {
        assert!(Instant::now() < until + PATIENCE, "no download");
        std::thread::sleep(Duration::from_millis(50));
    }
    let render = ["render", "run", "--path", path.to_str().unwrap(), "--frames", "3", "--out", "flight"];
    volseggs().current_dir(root).args(render).assert().success();
    assert!(pixels(&root.join("flight/0000.png")) == pixels(&file), "the path begins with the saved picture");
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
fn a_user_compares_with_the_image_another_time_and_no_edits() {
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
    // the difference between the two pictures
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

#[test]
fn a_user_turns_scrubs_clicks_commits_edits_and_undoes() {
    let Some(mut browser) = Browser::start() else { return };
    let folder = run();
    let root = folder.path();
    let server = Server::start(root, &[]);
    let tab = browser.visit(&server);
    assert!(
        !browser.eval(&tab, "location.href").as_str().unwrap().contains(&server.token),
        "the secret is removed from the address"
    );
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
    assert_eq!(browser.picture(&tab), before, "a button resets the view");

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
    assert_ne!(browser.picture(&tab), before, "the clicked object is highlighted");
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
    assert_eq!(browser.picture(&other), browser.picture(&tab), "the address records the view");

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
