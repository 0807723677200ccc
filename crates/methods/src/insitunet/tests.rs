use super::InSituNetMethod;
use crate::Method;
use crate::insitunet::{AdversarialLoss, InSituNetConfig};
use crate::test_support::{ball, change, check_resume, check_threads, device, error_of, preset, psnr, with_section};
use volseggs_core::config::types::Config;

/// Images of 8x8, pixels compared, no discriminator.
fn config(steps: usize) -> Config {
    let settings = InSituNetConfig {
        channels: vec![12, 8],
        critic_channels: vec![6],
        encoder: 12,
        steps,
        batch: 2,
        rate: 5e-3,
        perceptual: 0.0,
        pixel: 1.0,
        adversarial: 0.0,
        ..InSituNetConfig::default()
    };
    with_section("insitunet", &settings)
}

/// As [`config`], with a discriminator.
fn adversarial(steps: usize) -> Config {
    let mut config = config(steps);
    change(&mut config, |settings: &mut InSituNetConfig| settings.adversarial = 1e-2);
    config
}

#[test]
fn two_images_are_learnt_by_heart() {
    for config in [config(100), adversarial(100)] {
        let data = ball(2, 8);
        InSituNetMethod.check(&config).unwrap();
        let mut training = InSituNetMethod.start(&config, &data, &device()).unwrap();
        let before = psnr(training.model(), &data.train, 0);
        for _ in 0..training.total_steps() {
            training.step(&data.train).unwrap();
        }
        let after = [0, 1].map(|view| psnr(training.model(), &data.train, view));
        assert!(before < 15.0 && after.iter().all(|p| *p > 22.0), "{before:.1} dB, then {after:.1?} dB");
    }
}

#[test]
fn a_resumed_training_has_the_bits_of_a_whole_one() {
    check_resume(&InSituNetMethod, &config(5), &ball(3, 9));
    check_resume(&InSituNetMethod, &adversarial(5), &ball(3, 9));
}

#[test]
fn bits_do_not_depend_on_the_number_of_threads() {
    check_threads(&InSituNetMethod, &adversarial(3), &ball(3, 9));
}

#[test]
fn without_weights_of_vgg_pixels_are_compared() {
    let losses = |perceptual: f64, pixel: f64| {
        let mut config = config(3);
        change(&mut config, |c: &mut InSituNetConfig| (c.perceptual, c.pixel) = (perceptual, pixel));
        let data = ball(2, 8);
        InSituNetMethod.check(&config).unwrap();
        let mut training = InSituNetMethod.start(&config, &data, &device()).unwrap();
        (0..3).map(|_| training.step(&data.train).unwrap().loss).collect::<Vec<f64>>()
    };
    assert_eq!(losses(2.0, 0.0), losses(0.0, 2.0));
    assert_eq!(losses(2.0, 0.5), losses(0.0, 0.5), "the given weight of pixels is kept");
}

#[test]
fn training_on_vgg_features_approaches_the_images() {
    let Some(folder) = volseggs_testing::test_data("weights", volseggs_testing::Need::Weights) else { return };
    let mut config = config(60);
    change(&mut config, |c: &mut InSituNetConfig| {
        (c.perceptual, c.pixel) = (1.0, 0.0);
        c.vgg = folder.join("lpips_vgg16_v0.1_f16.safetensors").display().to_string();
    });
    let data = ball(2, 8);
    let mut training = InSituNetMethod.start(&config, &data, &device()).unwrap();
    let before = psnr(training.model(), &data.train, 0);
    for _ in 0..training.total_steps() {
        training.step(&data.train).unwrap();
    }
    let after = psnr(training.model(), &data.train, 0);
    assert!(after > before + 3.0, "{before:.1} dB, then {after:.1} dB");
}

#[test]
fn the_discriminator_learns_to_distinguish() {
    for loss in [AdversarialLoss::Vanilla, AdversarialLoss::Hinge] {
        let mut config = adversarial(3);
        // the generator stands still, so that only the discriminator can change its own loss
        change(&mut config, |c: &mut InSituNetConfig| (c.adversarial_loss, c.rate, c.adversarial) = (loss, 1e-12, 1.0));
        let data = ball(2, 8);
        let mut training = InSituNetMethod.start(&config, &data, &device()).unwrap();
        let losses: Vec<f64> = (0..20).map(|_| training.step(&data.train).unwrap().loss).collect();
        // the generator's loss rises as its images are recognised
        assert!(losses[19] > losses[0], "{loss:?}: {} then {}", losses[0], losses[19]);
    }
}

#[test]
fn invalid_settings_and_files_are_refused() {
    type Edit = fn(&mut InSituNetConfig);
    let cases: [(Edit, &str); 6] = [
        (|c| c.channels[1] = 0, "insitunet.channels = [12, 0]"),
        (|c| c.channels = vec![4; 40], "insitunet.channels: 40 values"),
        (|c| c.critic_channels.clear(), "insitunet.critic_channels: 0 values"),
        (|c| c.batch = 0, "insitunet.batch = 0: at least 1"),
        (|c| c.beta1 = 1.0, "insitunet.beta1 = 1.0"),
        (|c| c.pixel = 0.0, "both 0"),
    ];
    for (edit, words) in cases {
        let mut config = config(1);
        change(&mut config, edit);
        let error = InSituNetMethod.check(&config).unwrap_err();
        assert!(error.contains(words), "{error}");
    }
    let data = ball(2, 8);
    let refused =
        |config: &Config| InSituNetMethod.start(config, &data, &device()).map(|_| ()).unwrap_err().to_string();
    let mut large = config(1);
    change(&mut large, |settings: &mut InSituNetConfig| settings.batch = usize::MAX);
    assert!(refused(&large).contains("insitunet.batch"));
    let mut missing = config(1);
    change(&mut missing, |c: &mut InSituNetConfig| (c.perceptual, c.vgg) = (1.0, "nowhere.safetensors".into()));
    let error = refused(&missing);
    assert!(error.contains("insitunet.vgg") && error.contains("nowhere.safetensors"), "{error}");
    let error = error_of(&InSituNetMethod, |t| drop(t.pop_first()), &config(1), &data);
    assert!(error.contains("the file holds"), "{error}");
}

#[test]
fn presets_are_the_published_settings_and_smaller_ones() {
    let published = preset("insitunet");
    assert_eq!((published.method.as_str(), published.section()), ("insitunet", Ok(InSituNetConfig::default())));
    assert_eq!(published.section::<InSituNetConfig>().unwrap().side(), 1024);
    let small = preset("insitunet-small");
    crate::check(&small).unwrap();
    assert_eq!(small.section::<InSituNetConfig>().unwrap().side(), 64);
}
