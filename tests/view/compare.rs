//! The picture beside the picture.

use crate::common::{SIZE, run_json, volseggs};
use crate::socket::{Server, Window};
use crate::{list, run, view};
use serde_json::json;
use volseggs::device::DeviceName;
use volseggs::run::OpenRun;

#[test]
fn beside_a_picture_is_the_one_that_it_is_compared_with() {
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
    // two colours that stand for numbers have one scale
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
    // where the view is said to be is where `render` puts it
    let mut there = view(&welcome, views[1]["time"].as_f64().unwrap(), "colour", false);
    ["eye", "target", "up", "fov"].into_iter().for_each(|k| there[k] = views[1][k].clone());
    window.say(&there);
    let drawn = image::load_from_memory(&window.lossless().picture).unwrap().to_rgb8();
    volseggs().current_dir(root).args(["render", "run", "--view", "1", "--out", "still"]).assert().success();
    let rendered = image::open(root.join("still/0000.png")).unwrap().to_rgb8();
    let apart = drawn.iter().zip(rendered.iter()).map(|(a, b)| a.abs_diff(*b)).max();
    assert!(apart <= Some(1), "{apart:?}");
    window.say(&wanted);
    // it comes once
    window.lossless();
    wanted["time"] = 0.4.into();
    window.say(&wanted);
    assert!(window.frames_within(1.5).iter().all(|f| f.kind == 0));
    wanted["compare"] = json!({ "with": "image", "view": 10_000 });
    window.say(&wanted);
    let error = window.wait_for(|m| m["type"] == "error");
    assert!(error["message"].as_str().unwrap().contains("has views 0 to"), "{error}");
}
