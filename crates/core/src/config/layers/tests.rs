use std::fs;

use proptest::prelude::*;
use serde::Deserialize;

use super::*;

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
struct Config {
    name: String,
    train: Train,
    free: BTreeMap<String, f64>,
    mode: Mode,
    extra: Option<Extra>,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
struct Train {
    seed: u64,
    learning_rate: f32,
    scales: Vec<f32>,
    steps: u32,
    stop_after: Option<u32>,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
struct Extra {
    left: i32,
    right: i32,
}

#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
enum Mode {
    #[default]
    FullRun,
    Short,
}

impl Default for Config {
    fn default() -> Self {
        Self {
            name: "run \"a\"\n# b".to_owned(),
            train: Train::default(),
            free: BTreeMap::new(),
            mode: Mode::FullRun,
            extra: None,
        }
    }
}

impl Default for Train {
    fn default() -> Self {
        Self { seed: 42, learning_rate: 0.1, scales: vec![0.3, 1.0], steps: 30_000, stop_after: None }
    }
}

fn var(name: &str, value: &str) -> (OsString, OsString) {
    (name.into(), value.into())
}

fn set_error(set: &str) -> String {
    let layers = Layers::new(&[]).sets([set]);
    layers.resolve::<Config>().unwrap_err().to_string()
}

#[test]
fn later_layers_win_and_each_leaf_knows_its_origin() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("mine.toml");
    fs::write(&file, "extends = \"best\"\n\n[train]\nsteps = 7\nlearning_rate = 1\n").unwrap();
    let presets = [
        ("best.toml", "extends = \"base.toml\"\n[train]\nsteps = 5\nseed = 1\n"),
        ("base", "mode = \"short\"\ntrain.seed = 9\ntrain.stop_after = 3\n"),
    ];
    let resolved = Layers::new(&presets)
        .source(file.to_str().unwrap())
        .env(
            [
                var("VOLSEGGS_TRAIN__SEED", "11"),
                var("VOLSEGGS_NAME", "2024"),
                var("VOLSEGGS_LOG", "debug"),
                var("OTHER", "1"),
            ],
            &["VOLSEGGS_LOG"],
        )
        .unwrap()
        .sets(["train.steps = 8", "free.any=2.5", "train.scales=[0.2]"])
        .resolve::<Config>()
        .unwrap();
    let config = &resolved.value;
    assert_eq!((config.train.steps, config.train.seed), (8, 11));
    assert_eq!(config.train.learning_rate, 1.0);
    assert_eq!(config.train.stop_after, Some(3));
    assert_eq!((config.name.as_str(), &config.mode), ("2024", &Mode::Short));
    assert_eq!(config.free["any"], 2.5);
    let origin = |key: &str| resolved.origins[key].to_string();
    assert_eq!(origin("train.steps"), "--set");
    assert_eq!(origin("train.seed"), "env VOLSEGGS_TRAIN__SEED");
    assert_eq!(origin("train.learning_rate"), format!("file {}:5", file.display()));
    assert_eq!(origin("train.stop_after"), "preset base:3");
    assert_eq!(origin("mode"), "preset base:1");
    let plain = Layers::new(&[]).resolve::<Config>().unwrap();
    assert_eq!(plain.value, Config::default());
    assert!(plain.origins.values().all(|o| *o == KeyOrigin::Default));
}

#[test]
fn the_shown_text_and_the_toml_read_back_as_the_same() {
    let resolved =
        Layers::new(&[]).sets(["extra.left=1", "extra.right=2", "free={\"a b\" = 1.0}"]).resolve::<Config>().unwrap();
    let shown = resolved.show();
    assert!(shown.contains("train.learning_rate = 0.1  # default\n"), "{shown}");
    assert!(shown.contains("train.scales = [0.3, 1.0]  # default\n"));
    assert!(shown.contains("free.\"a b\" = 1.0  # --set\n"));
    assert_eq!(shown.lines().count(), resolved.origins.len());
    assert_eq!(shown.parse::<Table>().unwrap(), resolved.table);
    let written = resolved.to_toml().unwrap();
    assert_eq!(written.parse::<Table>().unwrap(), resolved.table);
    let presets = [("again", written.as_str())];
    let again = Layers::new(&presets).source("again").resolve::<Config>();
    assert_eq!(again.unwrap().value, resolved.value);
}

#[test]
fn an_unknown_key_names_its_origin_and_the_closest_key() {
    let error = set_error("train.sede=1");
    assert_eq!(error, "--set: unknown key `train.sede`; did you mean `train.seed`?");
    assert!(set_error("seed=1").contains("did you mean `train.seed`?"));
    assert!(set_error("extends=best").contains("unknown key"));
    assert!(set_error("train.seed.x=1").contains("unknown key `train.seed.x`"));
    let far = set_error("zzzzzzzz=1");
    assert!(!far.contains("did you mean"), "{far}");
    let presets = [("p", "\n[train]\nstep = 1\n")];
    let error = Layers::new(&presets).source("p").resolve::<Config>();
    assert_eq!(error.unwrap_err().to_string(), "preset p:3: unknown key `train.step`; did you mean `train.steps`?");
    let env = [var("VOLSEGGS_TRAIN__SEEED", "1")];
    let layers = Layers::new(&[]).env(env, &[]).unwrap();
    let error = layers.resolve::<Config>().unwrap_err().to_string();
    assert!(error.starts_with("env VOLSEGGS_TRAIN__SEEED: unknown key"));
}

#[test]
fn a_wrong_type_names_key_origin_expected_and_got() {
    let error = set_error("train.steps=many");
    for part in ["--set", "`train.steps`", "expected a whole number", "\"many\"", "`30000`"] {
        assert!(error.contains(part), "{part} not in {error}");
    }
    assert!(set_error("train.steps=-1").contains("`train.steps`"));
    assert!(set_error("train=3").contains("`train`"));
    assert!(set_error("mode=sideways").contains("sideways"));
    assert!(set_error("train.scales=[\"x\"]").contains("`train.scales`"));
    assert!(set_error("extra.left=1").contains("not consistent"));
    for malformed in ["train.seed", "=1", ".a=1", "a..b=1", ""] {
        assert!(set_error(malformed).contains("expected KEY=VALUE"));
    }
}

#[test]
fn sources_that_are_missing_circular_or_broken_are_named() {
    let dir = tempfile::tempdir().unwrap();
    let resolve = |name: &str, text: &str| {
        let file = dir.path().join(name);
        fs::write(&file, text).unwrap();
        let presets = [("loop", "extends = \"loop\"")];
        let layers = Layers::new(&presets).source(file.to_str().unwrap());
        layers.resolve::<Config>().unwrap_err().to_string()
    };
    let missing = resolve("a.toml", "extends = \"nowhere\"");
    assert!(missing.contains("nowhere") && missing.contains("presets: loop"));
    assert!(resolve("b.toml", "extends = \"b.toml\"").contains("circular"));
    assert!(resolve("c.toml", "extends = \"loop\"").contains("circular"));
    assert!(resolve("d.toml", "extends = 3").contains("must be a string"));
    assert!(resolve("e.toml", "\n[train\n").contains("e.toml is not valid TOML"));
}

#[test]
fn hostile_files_are_refused_in_time() {
    let dir = tempfile::tempdir().unwrap();
    let error = |text: &str| {
        let file = dir.path().join("a.toml");
        fs::write(&file, text).unwrap();
        Layers::new(&[]).source(file.to_str().unwrap()).resolve::<Config>().unwrap_err().to_string()
    };
    let key = ["a"; 79].join(".");
    let nested = error(&format!("seed = 1\n{}b = 1{}", format!("{key} = {{").repeat(79), "}".repeat(79)));
    assert!(nested.contains("a.toml") && nested.contains("line 2: more than 64"), "{nested}");
    // no closest known key is sought for it
    let long = "x".repeat(900_000);
    let unknown = error(&format!("{long} = 1"));
    assert!(unknown.contains(&format!("unknown key `{long}`")) && !unknown.contains("did you mean"));
    // each line is found without scanning the preceding ones
    let lines: String = (0..50_000).map(|k| format!("k{k} = 1\n")).collect();
    assert!(error(&format!("[free]\n{lines}[train]\nsede = 1")).contains("a.toml:50003"));
}

#[test]
fn an_empty_section_keeps_earlier_values() {
    let layers = Layers::new(&[]).sets(["train.seed=5", "train={}"]);
    let resolved = layers.resolve::<Config>().unwrap();
    assert_eq!(resolved.value.train.seed, 5);
    assert_eq!(resolved.origins["train.seed"], KeyOrigin::Set);
    assert_eq!(resolved.origins["train.steps"], KeyOrigin::Default);
}

#[test]
fn the_schema_lists_the_sections() {
    let schema = schema::<Config>();
    assert!(schema["properties"]["train"].is_object());
}

proptest! {
    #[test]
    fn arbitrary_overrides_never_panic(text in ".*") {
        let _ = Layers::new(&[]).sets([text]).resolve::<Config>();
    }

    #[test]
    fn arbitrary_values_never_panic_and_text_is_kept(value in ".*") {
        let set = format!("train.steps={value}");
        let _ = Layers::new(&[]).sets([set]).resolve::<Config>();
        let layers = Layers::new(&[]).sets([format!("name={value}")]);
        let resolved = layers.resolve::<Config>().unwrap();
        prop_assert_eq!(resolved.show().parse::<Table>().unwrap(), resolved.table);
    }
}
