//! Charts of segments through time.

use crate::browser::Browser;
use crate::common::run_json;
use crate::run;
use crate::socket::{Server, Window};
use serde_json::{Value, json};

#[test]
fn a_chart_shows_what_track_measures_even_when_read_only() {
    let folder = run();
    let root = folder.path();
    let server = Server::start(root, &["--read-only"]);
    let (mut window, _) = Window::open(&server);
    let names: Vec<String> =
        (0..2).map(|k| window.document["segments"][k]["name"].as_str().unwrap().to_owned()).collect();
    let ask = |id: u32, segments: &[String], times: usize| json!({ "type": "track", "id": id, "segments": segments, "times": times });
    window.say(&ask(1, &names[..1], 9));
    let one = window.wait_for(|m| m["id"] == 1);
    assert!(!root.join("run/track").exists(), "nothing is written");
    let typed = run_json(root, &["track", "run", "--segment", &names[0], "--frames", "9"]);
    for (k, row) in typed[0]["statistics"].as_array().unwrap().iter().enumerate() {
        for (of, column) in [("times", "time"), ("volume", "volume"), ("centroid", "centroid")] {
            assert_eq!(one[of][k], row[column], "{of} {k}");
        }
        let speed =
            row["velocity"].as_array().map(|v| v.iter().map(|x| x.as_f64().unwrap().powi(2)).sum::<f64>().sqrt());
        assert_eq!(one["speed"][k].as_f64(), speed);
    }
    let happened = |e: &&Value| e["kind"] != "continue";
    let events = typed[0]["events"].as_array().unwrap().iter().filter(happened).count();
    assert_eq!(one["events"].as_array().unwrap().len(), events);

    // several segments are one; of many requests the newest is answered, and none is waited for forever
    for id in 2..=9 {
        window.say(&ask(id, &names, 9));
    }
    let both = window.wait_for(|m| m["id"] == 9);
    assert_eq!((&both["type"], &both["segments"]), (&json!("track"), &json!(names)));
    assert!(both["volume"][4].as_f64() > one["volume"][4].as_f64());
    for (id, bad) in [(20, ask(20, &[], 9)), (21, ask(21, &names, 1)), (22, ask(22, &["nobody".into()], 9))] {
        window.say(&bad);
        assert_eq!(window.wait_for(|m| m["id"] == id)["type"], "error");
    }
}

#[test]
fn a_click_or_a_key_on_a_chart_goes_to_that_time() {
    let Some(mut browser) = Browser::start() else { return };
    let folder = run();
    let server = Server::start(folder.path(), &[]);
    let tab = browser.visit(&server);
    browser.eval(&tab, "document.querySelector('#tree input[type=checkbox]').click()");
    browser.eval(&tab, "document.getElementById('chart-start').click()");
    browser.wait(&tab, "document.querySelectorAll('#chart-volume .line').length === 1");
    assert_eq!(browser.eval(&tab, "document.querySelectorAll('#chart-centroid .line').length"), 3);
    browser.eval(&tab, "document.getElementById('chart').scrollIntoView({ block: 'center' })");
    let right = browser.eval(
        &tab,
        "(() => { const b = document.getElementById('chart-volume').getBoundingClientRect(); \
         return [b.left + 0.8 * b.width, b.top + b.height / 2]; })()",
    );
    browser.click(&tab, [0, 1].map(|k| right[k].as_f64().unwrap()));
    browser.wait(&tab, "Math.abs(Number(document.getElementById('picture').dataset.time) - 0.805) < 0.01");
    let time = browser.eval(&tab, "Number(document.getElementById('when').value)").as_f64().unwrap();
    browser.eval(&tab, "document.getElementById('chart-time').focus()");
    for kind in ["keyDown", "keyUp"] {
        let key = json!({ "type": kind, "key": "ArrowLeft", "code": "ArrowLeft", "windowsVirtualKeyCode": 37 });
        browser.call(Some(&tab), "Input.dispatchKeyEvent", key);
    }
    browser.rests(&tab);
    let now = browser.eval(&tab, "Number(document.getElementById('chart-time').getAttribute('aria-valuenow'))");
    assert!((now.as_f64().unwrap() - (time - 0.01)).abs() < 2e-3, "{now} after {time}");
    // each letter is explained, beside the charts and on hover
    let letters = "[...document.querySelectorAll('#chart-volume .letter')].map((t) => t.textContent).join('')";
    let explained = "[...document.querySelectorAll('#chart-key b')].map((b) => b.textContent)";
    let said = "[...document.querySelectorAll('#chart-volume g')].every((g) => /^\\d.*(part|whole)/.test(g.querySelector('title').textContent))";
    let [letters, explained, said] = [letters, explained, said].map(|what| browser.eval(&tab, what));
    let explained: Vec<char> = explained.as_array().unwrap().iter().flat_map(|b| b.as_str().unwrap().chars()).collect();
    assert!(
        letters.as_str().unwrap().chars().all(|l| explained.contains(&l)) && said == true,
        "{letters} {explained:?}"
    );
    browser.shoot(&tab, "5-chart");
    assert!(browser.wrong.is_empty(), "{:?}", browser.wrong);
}
