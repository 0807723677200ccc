//! A click on a picture of a run becomes a segment: `cargo run --release --example segment_by_click -- RUN VIEW X Y NAME`.
//!
//! VIEW is a test view of the dataset, X and Y are a pixel of its picture. The run needs an affinity field: `volseggs segment
//! masks RUN`, then `volseggs segment fine RUN`.

use std::path::Path;
use volseggs::files::LockDuration;
use volseggs::name::Name;
use volseggs::prelude::*;
use volseggs::run::{affinity, pick, segments::RunSegments};
use volseggs::segment::pick::{Granularity, PickOptions};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [run, view, x, y, name] = &arguments[..] else {
        return Err("usage: segment_by_click RUN VIEW X Y NAME".into());
    };
    let device = DeviceName::all()[0].open()?;
    let run = OpenRun::open_to_write(Path::new(run), &device, "segment_by_click", LockDuration::Short)?;
    let mut segments = RunSegments::open(&run)?;
    let field = affinity::open(&run)?;
    let (camera, time) = run.test_view(view.parse()?, run.record.surroundings.lens)?;

    let clicking = pick::Clicking::new(&run, segments.now(), Some(&field), time);
    let hit = clicking.hit(&camera, [x.parse()?, y.parse()?], None)?;
    let picked = clicking.select(&hit, &PickOptions { meaning: Granularity::Likeliest, list: false })?;
    let made = pick::commit(&run, &mut segments, &Name::new(name)?, &hit, &picked, time)?;
    segments.save()?;
    println!("{name}: {} Gaussians", made.gaussians);
    Ok(())
}
