//! Configuration: files, `--set`, and the Slurm profile.

use crate::driver::{Target, accepted, fuzz};
use std::path::Path;
use volseggs::config::layers::Layers;
use volseggs::config::types::Config;
use volseggs::sweep::slurm::SlurmProfile;
use volseggs::train::{check_config, evaluation_background};

const KEYS: &[&str] = &[
    "extends = \"quick\"\n",
    "extends = \"a.toml\"\n",
    "[model]\n",
    "[loss.extra]\n",
    "seed = ",
    "model.resolution = ",
    "[[a]]\n",
    "data.background = \"#12345g\"\n",
    "optim.betas = [0.9, nan]\n",
    "inf",
    "nan",
    "\"\"\"",
    "'''",
    "1979-05-27",
    "a.b.c.d.e.f = 1\n",
];

/// Resolves layers and does what training does before it starts.
fn resolve(layers: &Layers<'_>) -> bool {
    let Some(resolved) = accepted(layers.resolve::<Config>()) else { return false };
    let text = resolved.to_toml().unwrap();
    let again: Config = toml::from_str(&text).unwrap();
    let same = |config: &Config| toml::to_string(config).unwrap();
    assert_eq!(same(&again), same(&resolved.value), "unchanged by writing and reading");
    let _ = resolved.show();
    accepted(check_config(&resolved.value));
    accepted(evaluation_background(&resolved.value.data.background));
    accepted(volseggs::train::resume::changes(&text, &same(&Config::default()), 5));
    true
}

#[test]
fn file() {
    fuzz("config-file", |scratch| {
        let (path, scratch) = (scratch.path("a.toml"), scratch.clone());
        let read = move |bytes: &[u8]| {
            scratch.overwrite(&path, bytes);
            resolve(&volseggs::method::layers().source(path.to_string_lossy()))
        };
        let mut seeds: Vec<Vec<u8>> =
            volseggs::method::presets().iter().map(|(_, text)| text.as_bytes().to_vec()).collect();
        seeds.push(toml::to_string(&Config::default()).unwrap().into_bytes());
        seeds.push(b"extends = \"quick\"\nseed = 3\nmodel.width = 16\n[loss.extra]\nmine = 0.5\n".to_vec());
        Target::new(seeds, read).tokens(KEYS)
    });
}

#[test]
fn sets() {
    fuzz("config-sets", |_| {
        let read = |bytes: &[u8]| {
            let text = String::from_utf8_lossy(bytes);
            let variables = text.lines().filter_map(|l| l.strip_prefix("env ")?.split_once('='));
            let variables = variables.map(|(k, v)| (format!("VOLSEGGS_{k}").into(), v.into()));
            let sets = text.lines().filter(|l| !l.starts_with("env "));
            let layers = volseggs::method::layers().source("quick").sets(sets);
            accepted(layers.env(variables, &[])).is_some_and(|layers| resolve(&layers))
        };
        let seeds: [&[u8]; 3] = [
            b"seed=7\nmodel.resolution=8\nloss.kind=l1\nloss.extra.mine=0.5\noptim.betas=[0.9, 0.99]",
            b"data.background=#102030\nmodel={width=16, levels=1}\nmodel.time_range=half\nenv MODEL__WIDTH=8",
            b"model.encoder=implicit\ninit.placement=\"box\"\nenv SEED=3\nenv LOSS__DSSIM=1e-3",
        ];
        Target::new(seeds.map(<[u8]>::to_vec).to_vec(), read).tokens(&[
            "model.",
            "env ",
            "=",
            "[",
            "{",
            "}",
            "loss.extra.",
            "seed=",
            "model.encoder=x",
            "optim.schedule=cosine",
            "\"",
            "\n",
        ])
    });
}

#[test]
fn slurm_profile() {
    fuzz("slurm-profile", |_| {
        let read = |bytes: &[u8]| {
            accepted(SlurmProfile::parse(Path::new("p.toml"), &String::from_utf8_lossy(bytes))).is_some()
        };
        let seeds = [
            "partition='gpu'\naccount='a'\nqos='q'\ntime='1-00:00:00'\nmemory='8G'\ncpus=8\ngpus='a100:2'\nconstraint='[a|b]'\n\
             modules=['cuda/12']\nsetup=['source env.sh']\nparallel=50\ngrace=60\ncommand='volseggs'\nextra=['--exclusive']\n",
            include_str!("../../configs/slurm.toml"),
        ];
        Target::new(seeds.map(|s| s.as_bytes().to_vec()).to_vec(), read).tokens(&[
            "time='999999999-999999999:999999999:999999999'\n",
            "gpus=1\n",
            "gpus=''\n",
            "grace=0\n",
            "::",
            "-",
            "\\n",
        ])
    });
}
