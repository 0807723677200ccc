//! From a synthetic volume to a picture of trained Gaussians: `cargo run --release --example train_and_render -- OUT`.

use std::{path::Path, sync::atomic::AtomicBool};
use volseggs::prelude::*;
use volseggs::{export::images::to_rgb8, prepare::views::TrainingTimes};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let out = std::env::args().nth(1).ok_or("usage: train_and_render OUT [STEPS]")?;
    let steps: usize = std::env::args().nth(2).map_or(Ok(500), |text| text.parse())?;
    let (data, scene) = (Path::new(&out).join("data"), Synthetic::Jets);
    let volume = PrepareSource::Synthetic { scene, dims: [48; 3], steps: 10 };
    let mut options = PrepareOptions { segments: SegmentOptions::NONE, ..PrepareOptions::default() };
    (options.views.size, options.views.times) = ([128, 128], TrainingTimes::Count(10));
    (options.views.views_per_time, options.views.test_views) = (8, 20);
    prepare(&volume, &scene.transfer_function()?, &options, &data, &|_| (), &AtomicBool::new(false))?;

    let dataset = Dataset::open(&data, &OpenOptions::default())?;
    let mut config = preset("quick")?;
    (config.init.points, config.densify.budget) = (4000, 4000);
    let mut trainer = Trainer::new(config, &dataset, &DeviceName::all()[0].open()?)?;
    for _ in 0..steps {
        trainer.step(&dataset.train)?;
    }
    let image = trainer.scene().render(dataset.train.frames[0].camera.to_kernel(), 0.5);
    to_rgb8(&image, 128, 128).save(Path::new(&out).join("jets.png"))?;
    Ok(())
}
