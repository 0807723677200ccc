//! The page's modules without a browser: tests of those that are pure functions, and types of all.

use std::path::{Path, PathBuf};
use std::process::Command;
use volseggs_testing::{Need, skip};

fn folder(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(name)
}

/// Returns a command that runs Node.js, if this machine has it.
fn node(need: Need) -> Option<Command> {
    if Command::new("node").arg("--version").output().is_ok_and(|o| o.status.success()) {
        return Some(Command::new("node"));
    }
    skip(need, "there is no `node`");
    None
}

fn assert_passes(mut command: Command) {
    let output = command.output().unwrap();
    let [out, err] = [&output.stdout, &output.stderr].map(|text| String::from_utf8_lossy(text));
    assert!(output.status.success(), "{out}{err}");
}

#[test]
fn modules_that_need_no_browser_pass_their_tests() {
    let Some(mut node) = node(Need::Node) else { return };
    let entries = std::fs::read_dir(folder("tests/view/page")).unwrap().map(|entry| entry.unwrap().path());
    let tests: Vec<PathBuf> = entries.filter(|path| path.to_string_lossy().ends_with(".test.mjs")).collect();
    assert!(tests.len() >= 10, "{tests:?}");
    node.arg("--test").args(tests);
    assert_passes(node);
}

#[test]
fn modules_have_the_types_of_the_messages() {
    let Some(tsc) = std::env::var_os("VOLSEGGS_VIEW_TSC") else {
        return skip(
            Need::Tsc,
            "VOLSEGGS_VIEW_TSC, the path of TypeScript's lib/tsc.js, is not set, so types are not checked",
        );
    };
    assert!(Path::new(&tsc).is_file(), "VOLSEGGS_VIEW_TSC={}: there is no such file", tsc.display());
    let Some(mut node) = node(Need::Tsc) else { return };
    node.arg(tsc).arg("--project").arg(folder("src/view/page"));
    assert_passes(node);
}
