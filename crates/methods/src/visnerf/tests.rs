use super::{VisNerf, VisNerfMethod, VisNerfSpec};
use crate::test_support::{ball, change, check_resume, check_threads, device, error_of, preset, psnr, with_section};
use crate::visnerf::VisNerfConfig;
use crate::{Method, Model};
use volseggs_core::config::types::Config;
use volseggs_core::model::ToKernel;
use volseggs_core::model::params::to_vec;
use volseggs_volume::data::Dataset;

fn config(steps: usize) -> Config {
    let settings = VisNerfConfig {
        voxels: 12 * 12 * 12,
        density_ranks: 4,
        appearance_ranks: 4,
        time_ranks: 2,
        features: 6,
        width: 16,
        steps,
        batch: 128,
        samples_first: 12,
        samples_last: 24,
        samples_until: steps,
        rate_network: 5e-3,
        occupancy: 8,
        occupancy_every: 2,
        ..VisNerfConfig::default()
    };
    with_section("visnerf", &settings)
}

#[test]
fn one_image_is_learnt_by_heart() {
    let (data, mut config) = (ball(1, 16), config(150));
    change(&mut config, |settings: &mut VisNerfConfig| settings.occupancy_every = 60);
    VisNerfMethod.check(&config).unwrap();
    let mut training = VisNerfMethod.start(&config, &data, &device()).unwrap();
    let before = psnr(training.model(), &data.train, 0);
    for _ in 0..training.total_steps() {
        training.step(&data.train).unwrap();
    }
    let after = psnr(training.model(), &data.train, 0);
    assert!(before < 15.0 && after > 25.0, "{before:.1} dB, then {after:.1} dB");
}

#[test]
fn a_resumed_training_has_the_bits_of_a_whole_one() {
    let mut config = config(5);
    // cells are marked at steps 2 and 4, Adam restarts at 4: on either side of the stop
    change(&mut config, |settings: &mut VisNerfConfig| settings.restarts = vec![4]);
    check_resume(&VisNerfMethod, &config, &ball(4, 16));
}

#[test]
fn bits_do_not_depend_on_the_number_of_threads() {
    check_threads(&VisNerfMethod, &config(3), &ball(4, 16));
}

/// A model of a ball's views with a density network that gives one density everywhere and a colour network that gives
/// grey.
fn constant(data: &Dataset, density: f64) -> VisNerf {
    let settings = config(1).section::<VisNerfConfig>().unwrap();
    let spec = VisNerfSpec::new(&settings, &data.train, [1.0; 3]).unwrap();
    let mut model = VisNerf::new(spec, 0, &device());
    // the output biases start at 0: softplus(out - shift) with output weights of 0
    model.network = model.network.with_outputs_of_zero();
    model.network.density_shift = -density.exp_m1().ln();
    model
}

#[test]
fn a_constant_medium_has_its_closed_form() {
    let data = ball(4, 16);
    let density = 0.03;
    let model = constant(&data, density);
    let frame = &data.train.frames[0];
    let camera = frame.camera.to_kernel();
    let picture = to_vec(model.image(camera, 0.0));
    let rays = super::rays::RayCamera::new(camera);
    let (step, _) = model.spec.render_step();
    let mut thickest = 0.0f64;
    for (at, pixel) in picture.chunks_exact(4).enumerate() {
        // as many samples as steps fit: a ray's result is off by the fraction of a step left at its end
        let chord = model.spec.bounds().chord(&rays.ray(at, 0.0)).map_or(0.0, |[enter, leave]| leave - enter);
        let alpha = |length: f64| 1.0 - (-25.0 * density * length).exp();
        let (least, most) = (alpha(f64::from(chord)), alpha(f64::from(chord + step)));
        let most = if chord > 0.0 { most } else { 0.0 };
        assert!(f64::from(pixel[3]) > least - 1e-4 && f64::from(pixel[3]) < most + 1e-4, "{at}: {} {least}", pixel[3]);
        let grey = 0.5 * pixel[3] + 1.0 - pixel[3];
        assert!(pixel[..3].iter().all(|v| (v - grey).abs() < 1e-3), "{at}: {pixel:?}");
        thickest = thickest.max(least);
    }
    assert!(thickest > 0.3 && thickest < 0.9, "{thickest}");
}

#[test]
fn empty_places_are_passed_over_and_change_no_picture() {
    let data = ball(4, 16);
    let mut config = config(150);
    change(&mut config, |c: &mut VisNerfConfig| {
        (c.occupancy, c.occupancy_every, c.occupancy_threshold) = (16, 50, 0.002);
    });
    let mut training = VisNerfMethod.start(&config, &data, &device()).unwrap();
    for _ in 0..150 {
        training.step(&data.train).unwrap();
    }
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("model.safetensors");
    training.model().save(&path).unwrap();
    let mut model = VisNerf::read(&path, &device()).unwrap();
    let filled = model.occupancy.filled();
    assert!(filled > 0.02 && filled < 0.98, "{filled}");
    let camera = data.train.frames[1].camera.to_kernel();
    let skipping = model.render(camera, 0.4);
    model.occupancy = super::occupancy::OccupancyGrid::unknown();
    let worst = skipping.iter().zip(model.render(camera, 0.4)).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
    assert!(worst < 0.04, "{worst}");
}

#[test]
fn the_box_is_cut_into_cubes() {
    let data = ball(4, 16);
    let spec = VisNerfSpec::new(&config(1).section::<VisNerfConfig>().unwrap(), &data.train, [1.0; 3]).unwrap();
    let sides: Vec<f32> = (0..3).map(|k| 2.0 * spec.half[k] / spec.resolution[k] as f32).collect();
    assert!(sides.iter().all(|s| (s / sides[0] - 1.0).abs() < 0.15), "{sides:?}");
    let voxels: usize = spec.resolution.iter().product();
    assert!(voxels <= 1728 && voxels > 1000, "{voxels}");
    assert_eq!((spec.ends, spec.knots, spec.part(0.25)), ([0.0, 1.0], 2, 0.25));
    let (step, most) = spec.render_step();
    assert!(step * most as f32 > 2.0 * spec.half[0] * 3f32.sqrt() * 0.8, "{step} {most}");
}

#[test]
fn invalid_settings_and_files_are_refused() {
    type Edit = fn(&mut VisNerfConfig);
    let cases: [(Edit, &str); 5] = [
        (|c| c.features = 0, "visnerf.features = 0: at least 1"),
        (|c| c.render_step = 0.0, "visnerf.render_step = 0.0: between 0.01 and 100"),
        (|c| c.tv = -1.0, "visnerf.tv = -1.0"),
        (|c| c.octaves = 99, "visnerf.octaves = 99"),
        (|c| c.occupancy = 5000, "visnerf.occupancy = 5000"),
    ];
    for (edit, words) in cases {
        let mut config = config(1);
        change(&mut config, edit);
        let error = VisNerfMethod.check(&config).unwrap_err();
        assert!(error.contains(words), "{error}");
    }
    let mut none = config(1);
    none.sections.remove("visnerf");
    assert!(VisNerfMethod.check(&none).unwrap_err().contains("[visnerf]"));
    let data = ball(2, 16);
    for edit in [|c: &mut VisNerfConfig| c.batch = usize::MAX, |c: &mut VisNerfConfig| c.voxels = usize::MAX] {
        let mut large = config(1);
        change(&mut large, edit);
        let error = VisNerfMethod.start(&large, &data, &device()).map(|_| ()).unwrap_err().to_string();
        assert!(error.contains("visnerf.batch") && error.contains("memory"), "{error}");
    }
    let error = error_of(&VisNerfMethod, |t| drop(t.pop_first()), &config(1), &data);
    assert!(error.contains("the file holds"), "{error}");
}

#[test]
fn presets_are_the_published_settings_and_smaller_ones() {
    let published = preset("visnerf");
    assert_eq!((published.method.as_str(), published.section()), ("visnerf", Ok(VisNerfConfig::default())));
    crate::check(&preset("visnerf-small")).unwrap();
}
