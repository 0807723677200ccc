use super::CoordNet;
use super::method::pixel_inputs;
use crate::Method;
use crate::coordnet::CoordNetConfig;
use crate::network::Network;
use crate::test_support::{ball, change, check_resume, check_threads, device, error_of, preset, psnr, with_section};
use volseggs_core::config::types::Config;

fn config(steps: usize) -> Config {
    let settings = CoordNetConfig {
        widths: vec![16, 32],
        blocks: 1,
        steps,
        pixels_per_view: 256,
        batch: 256,
        rate: 1e-3,
        ..CoordNetConfig::default()
    };
    with_section("coordnet", &settings)
}

#[test]
fn one_image_is_learnt_by_heart() {
    let (data, config) = (ball(1, 16), config(200));
    CoordNet.check(&config).unwrap();
    let mut training = CoordNet.start(&config, &data, &device()).unwrap();
    let before = psnr(training.model(), &data.train, 0);
    for _ in 0..training.total_steps() {
        training.step(&data.train).unwrap();
    }
    let after = psnr(training.model(), &data.train, 0);
    assert!(before < 15.0 && after > 30.0, "{before:.1} dB, then {after:.1} dB");
}

#[test]
fn a_resumed_training_has_the_bits_of_a_whole_one() {
    check_resume(&CoordNet, &config(5), &ball(2, 16));
}

#[test]
fn bits_do_not_depend_on_the_number_of_threads() {
    let mut config = config(3);
    // large enough for the matrix products to be split among threads
    change(&mut config, |settings: &mut CoordNetConfig| settings.widths = vec![64, 128]);
    check_threads(&CoordNet, &config, &ball(2, 32));
}

#[test]
fn pixels_reach_from_edge_to_edge() {
    let at = |at| pixel_inputs(at, [5, 3], [0.1, 0.2, 0.3]);
    assert_eq!(at(0), [-1.0, -1.0, 0.1, 0.2, 0.3]);
    assert_eq!(at(14), [1.0, 1.0, 0.1, 0.2, 0.3]);
    assert_eq!(at(6), [-0.5, 0.0, 0.1, 0.2, 0.3]);
    assert_eq!(pixel_inputs(0, [1, 1], [0.0; 3])[..2], [-1.0, -1.0], "a single pixel divides by zero");
}

#[test]
fn decay_alone_is_the_published_one() {
    // where the image's own gradient is negligible, Adam's first step moves every weight towards 0 by the rate
    let mut config = config(1);
    change(&mut config, |c: &mut CoordNetConfig| (c.weight_decay, c.rate) = (1e6, 1e-4));
    let data = ball(1, 16);
    let mut training = CoordNet.start(&config, &data, &device()).unwrap();
    let before = training.model().parameters();
    training.step(&data.train).unwrap();
    for (name, tensor) in training.model().parameters() {
        let moved = tensor.values.iter().zip(&before[&name].values).filter(|(_, b)| b.abs() > 1e-3);
        assert!(moved.clone().count() > 0);
        assert!(moved.into_iter().all(|(a, b)| ((b - a) - 1e-4 * b.signum()).abs() < 1e-6), "{name}");
    }
}

#[test]
fn invalid_settings_and_files_are_refused() {
    type Edit = fn(&mut CoordNetConfig);
    let cases: [(Edit, &str); 6] = [
        (|c| c.widths.clear(), "coordnet.widths = []"),
        (|c| c.widths[1] = 0, "coordnet.widths = [16, 0]"),
        (|c| c.batch = 0, "coordnet.batch = 0: at least 1"),
        (|c| c.blocks = usize::MAX, "at most 1000"),
        (|c| c.rate = 0.0, "coordnet.rate = 0.0: above 0"),
        (|c| c.weight_decay = -1.0, "coordnet.weight_decay = -1.0"),
    ];
    for (edit, words) in cases {
        let mut config = config(1);
        change(&mut config, edit);
        let error = CoordNet.check(&config).unwrap_err();
        assert!(error.contains(words), "{error}");
    }
    let mut none = config(1);
    none.sections.remove("coordnet");
    assert!(CoordNet.check(&none).unwrap_err().contains("[coordnet]"));
    let mut large = config(1);
    change(&mut large, |settings: &mut CoordNetConfig| settings.batch = usize::MAX);
    let data = ball(1, 16);
    let error = CoordNet.check(&large).unwrap_err();
    assert!(error.contains("coordnet.batch = 18446744073709551615"), "{error}");

    let error = error_of(&CoordNet, |t| drop(t.pop_first()), &config(1), &data);
    assert!(error.contains("the file holds"), "{error}");
    let poison = |tensors: &mut std::collections::BTreeMap<String, volseggs_core::model::params::HostTensor>| {
        tensors.values_mut().next().unwrap().values[0] = f32::NAN;
    };
    let error = error_of(&CoordNet, poison, &config(1), &data);
    assert!(error.contains("is not finite"), "{error}");
}

#[test]
fn presets_are_the_published_settings_and_smaller_ones() {
    let published = preset("coordnet");
    assert_eq!((published.method.as_str(), published.section()), ("coordnet", Ok(CoordNetConfig::default())));
    let small = preset("coordnet-small");
    crate::check(&small).unwrap();
    let spec = CoordNet.spec(&small, &ball(2, 16));
    assert!((40_000..50_000).contains(&CoordNet.parameters(&spec).unwrap()));
}
