//! Tests of variants.

use super::*;
use proptest::prelude::*;

fn file(text: &str) -> SweepFile {
    toml::from_str(text).unwrap()
}

fn names(text: &str) -> Vec<String> {
    variants(&file(text)).unwrap().into_iter().map(|v| v.name).collect()
}

fn error(text: &str) -> String {
    variants(&file(text)).unwrap_err().to_string()
}

#[test]
fn named_variants_and_grids_combine() {
    let text = "[[variant]]\nname = 'L1'\nset = { 'loss.kind' = 'l1' }\n[[variant]]\nname = 'L2'\n[grid]\n\
                'loss.tv' = [0.0, 1e-4]\nmodel = { levels = [1, 2] }";
    let found = variants(&file(text)).unwrap();
    assert_eq!(found.len(), 8);
    assert_eq!(found[1].name, "L1, tv=0.0, levels=2");
    assert_eq!(found[1].settings["loss.kind"], Value::String("l1".into()));
    assert_eq!(found[1].settings["model.levels"], Value::Integer(2));
    assert_eq!(names(""), ["base"]);
    let alike = variants(&file("[grid]\n'init.opacity' = [0.1]\n'optim.opacity' = [0.05]")).unwrap();
    assert_eq!(alike[0].name, "init.opacity=0.1, optim.opacity=0.05");
}

#[test]
fn invalid_axes_are_named() {
    assert!(error("[grid]\n'a.b' = []").contains("grid.a.b"));
    assert!(error("[grid]\n'a.b' = 3").contains("not a list"));
    assert!(error("[[variant]]\nname='x'\n[[variant]]\nname='x'").contains("two variants are named \"x\""));
    assert!(error("[random]\ncount=3\n[random.keys]\n'a.b' = {low=0, high=1, log=true}").contains("above 0"));
    assert!(error("[random]\ncount=3\n[random.keys]\n'a.b' = {low=2, high=1}").contains("not below"));
    assert!(error("[random]\ncount=3\n[random.keys]\n'a.b' = {low=2}").contains("low and high"));
    let many = |count: &str| format!("[random]\ncount={count}\n[random.keys]\n'a.b' = {{low=0, high=1}}");
    assert!(error(&many("65537")).contains("Sobol sampling supports at most 65536 points"));
    assert!(error(&many("9223372036854775807")).contains("a sweep has at most 100000"));
    let ends = |low: &str, high: &str| {
        format!("[random]\ncount=3\n[random.keys]\n'a.b' = {{low={low}, high={high}, integer=true}}")
    };
    assert!(error(&ends("0", "1e300")).contains("a.b: integer requires low and high from"));
    assert!(error(&ends("-1e19", "0")).contains("a.b: integer requires low and high from"));
    assert!(!names(&ends("-9007199254740992", "9007199254740992")).is_empty());
}

proptest! {
    #[test]
    fn samples_lie_in_their_ranges_and_repeat(
        count in 1usize..40,
        seed in any::<u32>(),
        method in prop_oneof!["sobol", "latin-hypercube", "uniform"],
    ) {
        let text = format!(
            "[random]\nmethod = '{method}'\ncount = {count}\nseed = {seed}\n[random.keys]\n\
             'a' = {{ low = 1e-4, high = 1e-1, log = true }}\n'b' = {{ low = 3, high = 5, integer = true }}\n\
             'c' = {{ choices = ['x', 'y'] }}"
        );
        let found = variants(&file(&text)).unwrap();
        // points that coincide after rounding are used once
        prop_assert!(!found.is_empty() && found.len() <= count);
        for v in &found {
            let a = v.settings["a"].as_float().unwrap();
            prop_assert!((1e-4 * 0.999..=1e-1).contains(&a), "{}", a);
            prop_assert!((3..=5).contains(&v.settings["b"].as_integer().unwrap()));
        }
        prop_assert_eq!(variants(&file(&text)).unwrap(), found);
    }
}

#[test]
fn a_latin_hypercube_uses_each_part_once() {
    let text = "[random]\nmethod = 'latin-hypercube'\ncount = 16\n[random.keys]\n'a' = { low = 0, high = 16 }\n\
                'b' = { low = 0, high = 16 }";
    let found = variants(&file(text)).unwrap();
    for key in ["a", "b"] {
        let mut parts: Vec<usize> = found.iter().map(|v| v.settings[key].as_float().unwrap() as usize).collect();
        parts.sort_unstable();
        assert_eq!(parts, (0..16).collect::<Vec<_>>());
    }
}

#[test]
fn too_many_runs_are_refused_before_any_is_made() {
    let check = |text: &str, seeds, budget| match check_count(&file(text), seeds, 2, MemoryBudget::from_bytes(budget)) {
        Err(SweepError::Key { key, problem, .. }) => Err((key, problem)),
        other => other.map_err(|e| panic!("{e}")),
    };
    let random = "[random]\ncount = 100000000000\n[random.keys]\n'a' = { low = 0, high = 1 }";
    let (key, problem) = check(random, 1, u64::MAX).unwrap_err();
    assert!(key == "random.count" && problem.contains("100000000000 values"), "{key}: {problem}");
    let axes: String = (0..20).map(|k| format!("'k{k}' = [1, 2, 3]\n")).collect();
    let (key, problem) = check(&format!("[grid]\n{axes}"), 1, u64::MAX).unwrap_err();
    assert!(key.starts_with("grid.k") && problem.contains("6973568802 runs"), "{key}: {problem}");
    assert_eq!(check("", usize::MAX, u64::MAX).unwrap_err().0, "seeds");
    let (key, problem) = check("", 50, 1_000_000).unwrap_err();
    assert!(key == "seeds" && problem.contains("--memory"), "{key}: {problem}");
    check("[grid]\n'a' = [1, 2]", 50, 8_000_000_000).unwrap();
    // also when only variants are requested, not a plan
    let many = "[grid]\n'a' = [1, 2]\n'b' = [1, 2]\n[random]\nmethod = 'sobol'\ncount = 65536\n[random.keys]\n'c' = { low = 0, high = 1 }";
    let error = variants(&file(many)).unwrap_err().to_string();
    assert!(error.contains("262144 runs in all"), "{error}");
}
