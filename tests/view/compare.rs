//! The comparison picture beside the main picture.

use crate::browser::{Browser, Tab};
use crate::common::{SIZE, copy, refused, run_json, volseggs};
use crate::socket::{Server, Window};
use crate::{list, run, view};
use serde_json::{Value, json};
use volseggs::device::DeviceName;
use volseggs::run::OpenRun;

#[test]
fn the_comparison_picture_shows_what_was_requested() {
    let folder = run();
    let root = folder.path();
    let name = list(root)[0]["name"].as_str().unwrap().to_owned();
    run_json(root, &["edit", "opacity", "run", "--segment", &name, "--factor", "0.2"]);
    let server = Server::start(root, &[]);
    let (mut window, welcome) = Window::open(&server);
    let mut alone = |time: f64, edits: bool| {
        let mut wanted = view(&welcome, time, "colour", false);
        wanted["edits"] = edits.into();
        window.say(&wanted);
        window.lossless().picture
    };
    let (now, later, plain) = (alone(0.3, true), alone(0.7, true), alone(0.3, false));
    assert!(now != later && now != plain);
    let mut wanted = view(&welcome, 0.3, "colour", false);
    for (compare, beside) in [(json!({ "with": "time", "time": 0.7 }), &later), (json!({ "with": "plain" }), &plain)] {
        wanted["compare"] = compare;
        window.say(&wanted);
        let other = window.frame(|f| f.kind == 1 && f.png);
        assert!(other.picture == *beside, "{}", wanted["compare"]);
        let picture = window.lossless();
        assert!(picture.number == other.number && picture.picture == now);
    }
    // two colourings of numbers share one scale
    wanted["look"] = "velocity speed".into();
    wanted["compare"] = json!({ "with": "time", "time": 0.3 });
    window.say(&wanted);
    let other = window.frame(|f| f.kind == 1 && f.png);
    assert!(window.lossless().picture == other.picture);

    window.say(&json!({ "type": "views", "id": 7 }));
    let answer = window.wait_for(|m| m["id"] == 7);
    let views = answer["views"].as_array().unwrap();
    let run = OpenRun::open(&root.join("run"), &DeviceName::all()[0].open().unwrap()).unwrap();
    assert_eq!(views.len(), run.test_views().unwrap().len());
    wanted["compare"] = json!({ "with": "image", "view": 1 });
    window.say(&wanted);
    let image = window.frame(|f| f.kind == 3);
    assert_eq!((image.number, image.width, image.height), (1, SIZE, SIZE));
    let image = image::load_from_memory(&image.picture).unwrap().to_rgb8();
    assert_eq!(image, run.test_image(1).unwrap());
    let json = volseggs::data::Transforms::read(&run.record.dataset.join("transforms_test.json")).unwrap();
    assert_eq!(views[1]["time"], json.frames[1].time);
    let file = image::open(json.frames[1].image_path(&run.record.dataset)).unwrap().to_rgba8();
    let white = image::Rgb([255; 3]);
    for (x, y, pixel) in file.enumerate_pixels().filter(|(_, _, p)| p[3] == 0 || p[3] > 200) {
        assert_eq!(*image.get_pixel(x, y) == white, pixel[3] == 0, "over the background at {x}, {y}");
    }
    // the view is where `render` puts it
    let mut there = view(&welcome, views[1]["time"].as_f64().unwrap(), "colour", false);
    ["eye", "target", "up", "fov"].into_iter().for_each(|k| there[k] = views[1][k].clone());
    window.say(&there);
    let drawn = image::load_from_memory(&window.lossless().picture).unwrap().to_rgb8();
    volseggs().current_dir(root).args(["render", "run", "--view", "1", "--out", "still"]).assert().success();
    let rendered = image::open(root.join("still/0000.png")).unwrap().to_rgb8();
    let apart = drawn.iter().zip(rendered.iter()).map(|(a, b)| a.abs_diff(*b)).max();
    assert!(apart <= Some(1), "{apart:?}");
    window.say(&wanted);
    // it is sent only once
    window.lossless();
    wanted["time"] = 0.4.into();
    window.say(&wanted);
    assert!(window.frames_within(1.5).iter().all(|f| f.kind == 0));
    wanted["compare"] = json!({ "with": "image", "view": 10_000 });
    window.say(&wanted);
    let message = window.wait_for(|m| m["type"] == "beside");
    assert!(message["fault"].as_str().unwrap().contains("has views 0 to"), "{message}");
    assert!(window.lossless().png, "the picture itself is there");
}

/// Makes a second run beside the run: the same, trained for some more steps, without its segments.
fn with_another() -> tempfile::TempDir {
    let folder = run();
    let root = folder.path();
    copy(&root.join("run"), &root.join("my other/run"));
    std::fs::remove_dir_all(root.join("my other/run/segments")).unwrap();
    let longer = ["train", "--resume", "my other/run", "--set", "stages.joint_steps=70"];
    volseggs().current_dir(root).args(longer).assert().success();
    folder
}

#[test]
fn another_run_is_drawn_as_render_draws_it() {
    let folder = with_another();
    let root = folder.path();
    let name = list(root)[0]["name"].as_str().unwrap().to_owned();
    run_json(root, &["edit", "opacity", "run", "--segment", &name, "--factor", "0.2"]);
    let server = Server::start(root, &["--with", "my other/run", "--with", "run/checkpoints/step-000070"]);
    let (mut window, welcome) = Window::open(&server);
    let others = welcome["others"].as_array().unwrap();
    assert_eq!((&others[0]["name"], &others[0]["step"], &others[0]["note"]), (&json!("run"), &json!(90), &Value::Null));
    assert_eq!((&others[1]["name"], &others[1]["step"]), (&json!("step-000070"), &json!(70)));
    let rendered = |which: &str, flags: &[&str]| {
        let camera = ["render", which, "--camera", "3,-2,1.5", "--time", "0.3", "--out", "still"];
        volseggs().current_dir(root).args(camera).args(flags).assert().success();
        std::fs::read(root.join("still/0000.png")).unwrap()
    };
    let mut beside = |run: usize, look: &str, alone: &[&str]| {
        let mut wanted = view(&welcome, 0.3, look, false);
        wanted["compare"] = json!({ "with": "run", "run": run });
        wanted["alone"] = json!(alone);
        window.say(&wanted);
        let other = window.frame(|f| f.kind == 1 && f.png);
        let picture = window.lossless();
        assert!(picture.number == other.number && picture.picture != other.picture);
        other.picture
    };
    assert!(beside(0, "colour", &[]) == rendered("my other/run", &[]), "different bytes from render's");
    // the checkpoint is of the same run: its segments and edits are those of the run, which do not fit it
    assert!(beside(1, "colour", &[]) == rendered("run/checkpoints/step-000070", &["--no-edits"]));
    // a segment that the other run lacks leaves only the background
    let empty = image::load_from_memory(&beside(0, "colour", &[&name])).unwrap().to_rgb8();
    let first = *empty.get_pixel(0, 0);
    assert!(empty.pixels().all(|p| *p == first));
    // meanwhile, a command segments the other run
    run_json(root, &["segment", "coarse", "my other/run", "--clusters", "2"]);
    let until = std::time::Instant::now() + std::time::Duration::from_secs(30);
    while beside(0, "segments", &[]) != rendered("my other/run", &["--show", "segments"]) {
        assert!(std::time::Instant::now() < until, "the other run's segments do not show");
    }
}

#[test]
fn what_another_run_lacks_is_reported_and_the_picture_is_still_drawn() {
    let folder = with_another();
    let root = folder.path();
    let server = Server::start(root, &["--with", "my other/run"]);
    let (mut window, welcome) = Window::open(&server);
    let mut wanted = view(&welcome, 0.3, "segments", false);
    wanted["compare"] = json!({ "with": "run", "run": 0 });
    window.say(&wanted);
    let message = window.wait_for(|m| m["type"] == "beside");
    assert!(message["fault"].as_str().unwrap().contains("segment coarse 'my other/run'"), "{message}");
    assert!(window.lossless().png);
    wanted["look"] = "colour".into();
    window.say(&wanted);
    assert!(window.frame(|f| f.kind == 1 && f.png).png);
    wanted["compare"]["run"] = 1.into();
    window.say(&wanted);
    let error = window.wait_for(|m| m["type"] == "error");
    assert!(error["message"].as_str().unwrap().contains("started with 1 other"), "{error}");
}

#[test]
fn an_invalid_comparison_run_is_refused_at_the_start() {
    let folder = run();
    let root = folder.path();
    let view = |with: &[&str]| {
        let mut command = volseggs();
        command.current_dir(root).args(["view", "run"]);
        command.args(with.iter().flat_map(|path| ["--with", path]));
        command
    };
    refused(&mut view(&["nowhere"]), &["nowhere", "no checkpoint here"]);
    refused(&mut view(&["run/segments"]), &["run/segments"]);
    refused(
        &mut view(&["run/checkpoints/step-000070", "run/../run/checkpoints/step-000070"]),
        &["--with", "given twice"],
    );
}

#[test]
fn a_user_compares_with_another_run() {
    let Some(mut browser) = Browser::start() else { return };
    let folder = with_another();
    let server = Server::start(folder.path(), &["--with", "my other/run"]);
    let tab = browser.visit(&server);
    assert_eq!(browser.eval(&tab, "document.querySelector('#compare-runs option').textContent"), "run");
    let apart = "(() => { const [a, b] = ['picture', 'other'].map((id) => { const c = document.getElementById(id); \
                 return c.getContext('2d').getImageData(0, 0, c.width, c.height).data; }); \
                 return a.length === b.length && a.some((v, i) => v !== b[i]); })()";
    browser.set(&tab, "compare", "run 0");
    browser.rests(&tab);
    browser.wait(
        &tab,
        "document.getElementById('other').dataset.frame === document.getElementById('picture').dataset.frame",
    );
    assert_eq!(browser.eval(&tab, "document.getElementById('compared').textContent"), "Right: run, step 90");
    assert_eq!(browser.eval(&tab, apart), true);
    browser.shoot(&tab, "10-other-run");
    // one camera and one time for both
    let linked = |browser: &mut Browser, tab: &Tab| {
        browser.eval(
            tab,
            "(() => { const c = document.getElementById('other'), d = c.getContext('2d').getImageData(0, 0, c.width, c.height).data; \
             let h = 0; for (let i = 0; i < d.length; i += 3) h = (h * 31 + d[i]) | 0; return h; })()",
        )
    };
    let mut before = linked(&mut browser, &tab);
    for change in
        ["document.querySelector('[data-axis=\"0,1,0\"]').click()", "document.getElementById('forth').click()"]
    {
        browser.eval(&tab, change);
        browser.rests(&tab);
        let after = linked(&mut browser, &tab);
        assert_ne!(after, before, "{change}");
        before = after;
    }
    for how in ["wipe", "flip"] {
        browser.set(&tab, "compare-how", how);
        browser.rests(&tab);
    }
    assert_eq!(browser.eval(&tab, "document.getElementById('other').hidden"), true);
    browser.eval(&tab, "document.getElementById('compare-flip').click()");
    assert_eq!(browser.eval(&tab, "document.getElementById('compared').textContent"), "Shown: run, step 90");
    // what it lacks is reported in its place
    browser.set(&tab, "look", "segments");
    browser.wait(&tab, "document.getElementById('compared').textContent.includes('has none yet')");
    browser.shoot(&tab, "11-other-run-lacks");
    browser.set(&tab, "look", "colour");
    browser.wait(&tab, "document.getElementById('compared').textContent === 'Shown: run, step 90'");
    assert!(browser.wrong.is_empty(), "{:?}", browser.wrong);
}
