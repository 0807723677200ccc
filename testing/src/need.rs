//! What a machine may lack, and what a test does then.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::Command;

/// Something that some tests need and that a machine may lack.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Need {
    /// An adapter that wgpu finds, software ones included.
    Gpu,
    /// An NVIDIA GPU with its driver.
    Cuda,
    /// The programs of Slurm and munge.
    Slurm,
    /// Chromium.
    Browser,
    /// The script of axe-core, named by `VOLSEGGS_AXE`.
    Axe,
    /// Node.js.
    Node,
    /// TypeScript's compiler, named by `VOLSEGGS_VIEW_TSC`.
    Tsc,
    /// `timeout` of GNU coreutils.
    Coreutils,
    /// The Python package `vtk`.
    Vtk,
    /// The Python package `vtk`, with a library of OpenGL that draws without a display.
    VtkRendering,
    /// The Python package `nibabel`.
    Nibabel,
    /// The Python package `pynrrd`.
    Pynrrd,
    /// The Python package `tensorboard`.
    Tensorboard,
    /// The published dataset, in `VOLSEGGS_TEST_DATA`.
    Data,
    /// Weights and check images of LPIPS, in `VOLSEGGS_TEST_DATA`.
    Weights,
    /// Weights of MobileSAM's full size with what they give, named by `VOLSEGGS_TEST_SAM`.
    Sam,
}

impl Need {
    /// Every need.
    pub const ALL: [Self; 16] = [
        Self::Gpu,
        Self::Cuda,
        Self::Slurm,
        Self::Browser,
        Self::Axe,
        Self::Node,
        Self::Tsc,
        Self::Coreutils,
        Self::Vtk,
        Self::VtkRendering,
        Self::Nibabel,
        Self::Pynrrd,
        Self::Tensorboard,
        Self::Data,
        Self::Weights,
        Self::Sam,
    ];

    /// The variable that turns skipping into failure where it is set to anything but nothing.
    #[must_use]
    pub fn variable(self) -> &'static str {
        match self {
            Self::Gpu => "VOLSEGGS_REQUIRE_GPU",
            Self::Cuda => "VOLSEGGS_REQUIRE_CUDA",
            Self::Slurm => "VOLSEGGS_REQUIRE_SLURM",
            Self::Browser => "VOLSEGGS_REQUIRE_BROWSER",
            Self::Axe => "VOLSEGGS_REQUIRE_AXE",
            Self::Node => "VOLSEGGS_REQUIRE_NODE",
            Self::Tsc => "VOLSEGGS_REQUIRE_TSC",
            Self::Coreutils => "VOLSEGGS_REQUIRE_COREUTILS",
            Self::Vtk => "VOLSEGGS_REQUIRE_VTK",
            Self::VtkRendering => "VOLSEGGS_REQUIRE_VTK_RENDERING",
            Self::Nibabel => "VOLSEGGS_REQUIRE_NIBABEL",
            Self::Pynrrd => "VOLSEGGS_REQUIRE_PYNRRD",
            Self::Tensorboard => "VOLSEGGS_REQUIRE_TENSORBOARD",
            Self::Data => "VOLSEGGS_REQUIRE_DATA",
            Self::Weights => "VOLSEGGS_REQUIRE_WEIGHTS",
            Self::Sam => "VOLSEGGS_REQUIRE_SAM",
        }
    }
}

/// Says that the running test, or the rest of it, is skipped because `missing` (such as "there is no `sbatch`"); the
/// caller then returns.
///
/// # Panics
/// If the need's variable is set.
pub fn skip(need: Need, missing: &str) {
    let required = std::env::var_os(need.variable()).is_some_and(|v| !v.is_empty());
    let thread = std::thread::current();
    match verdict(need, missing, thread.name().unwrap_or("a test"), required) {
        // past the capture of tests, so that it is seen; nobody reading is no reason to fail
        Ok(line) => drop(writeln!(std::io::stderr(), "{line}")),
        Err(message) => panic!("{message}"),
    }
}

/// The line of a skipped test, or the message of a failed one.
fn verdict(need: Need, missing: &str, test: &str, required: bool) -> Result<String, String> {
    let (missing, variable) = (missing.trim(), need.variable());
    if required {
        Err(format!("{missing}, and {variable} is set"))
    } else {
        Ok(format!("skipped: {test}: {missing} ({variable}=1 makes this a failure)"))
    }
}

/// The Python interpreter, `PYTHON` or else `python3`, if it can import `package`; otherwise the test skips.
///
/// # Panics
/// As [`skip`].
#[must_use]
pub fn python_with(package: &str, need: Need) -> Option<String> {
    let python = std::env::var("PYTHON").unwrap_or_else(|_| "python3".into());
    let found = Command::new(&python).args(["-c", &format!("import {package}")]).output();
    if found.is_ok_and(|o| o.status.success()) {
        return Some(python);
    }
    skip(need, &format!("{python} has no package `{package}`; PYTHON names another interpreter"));
    None
}

/// `below` in the folder that `VOLSEGGS_TEST_DATA` names, if it is there; otherwise the test skips.
///
/// # Panics
/// As [`skip`], and if the variable names no folder: that is a slip of the pen.
#[must_use]
pub fn test_data(below: &str, need: Need) -> Option<PathBuf> {
    let Some(root) = std::env::var_os("VOLSEGGS_TEST_DATA") else {
        skip(need, &format!("VOLSEGGS_TEST_DATA, a folder with {below}, is not set"));
        return None;
    };
    let root = Path::new(&root);
    assert!(root.is_dir(), "VOLSEGGS_TEST_DATA: there is no folder {}", root.display());
    let path = root.join(below);
    if path.exists() {
        return Some(path);
    }
    skip(need, &format!("VOLSEGGS_TEST_DATA has no {below}: {} does not exist", path.display()));
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_skipped_test_reports_its_name_the_reason_and_the_variable() {
        let line = verdict(Need::Slurm, "there is no sbatch\n", "sweeps::local", false).unwrap();
        assert_eq!(line, "skipped: sweeps::local: there is no sbatch (VOLSEGGS_REQUIRE_SLURM=1 makes this a failure)");
        let message = verdict(Need::Slurm, "there is no sbatch", "sweeps::local", true).unwrap_err();
        assert!(message.contains("no sbatch") && message.contains("VOLSEGGS_REQUIRE_SLURM"), "{message}");
    }

    fn words_of(text: &str) -> impl Iterator<Item = &str> {
        text.split(|c: char| !c.is_ascii_alphanumeric() && c != '_')
    }

    /// The table of CONTRIBUTING.md and `.ci/run` against the code: a variable of a wrong name, or one that `.ci/run` no
    /// longer sets, would require nothing.
    #[test]
    fn every_variable_is_in_the_table_and_set_by_ci() {
        let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
        let table = std::fs::read_to_string(root.join("CONTRIBUTING.md")).unwrap();
        for need in Need::ALL {
            assert!(words_of(&table).any(|w| w == need.variable()), "{} is not in CONTRIBUTING.md", need.variable());
        }
        let script = std::fs::read_to_string(root.join(".ci/run")).unwrap();
        // comments may name a variable without setting it
        let set = |need: Need| {
            let line = format!("export {}=1", need.variable());
            script.lines().any(|l| l.trim() == line)
        };
        for need in Need::ALL.into_iter().filter(|need| *need != Need::Cuda) {
            assert!(set(need), ".ci/run does not set {}", need.variable());
        }
        let known = Need::ALL.map(Need::variable);
        for text in [&table, &script] {
            for word in words_of(text).filter(|w| w.starts_with("VOLSEGGS_REQUIRE_") && *w != "VOLSEGGS_REQUIRE_") {
                assert!(known.contains(&word), "no test uses {word}");
            }
        }
    }

    /// A test's program is started anew with the variables that decide, as they are read once for all tests.
    fn rerun(variables: &[(&str, &str)]) -> std::process::Output {
        let mut program = Command::new(std::env::current_exe().unwrap());
        program.args(["--exact", "need::tests::child", "--ignored"]);
        for name in Need::ALL.map(Need::variable).into_iter().chain(["VOLSEGGS_TEST_DATA"]) {
            program.env_remove(name);
        }
        program.envs(variables.iter().copied()).output().unwrap()
    }

    /// What [`rerun`] runs.
    #[test]
    #[ignore = "skips itself; another test runs it and reads its output"]
    fn child() {
        assert_eq!(python_with("there_is_no_such_package", Need::Vtk), None);
        assert_eq!(test_data("no/such/data", Need::Data), None);
    }

    #[test]
    fn skipping_is_reported_despite_the_capture_and_fails_where_required() {
        let nowhere = std::env::temp_dir();
        let nowhere = nowhere.to_str().unwrap();
        for data in [None, Some(("VOLSEGGS_TEST_DATA", nowhere))] {
            let data = Vec::from_iter(data);
            let output = rerun(&data);
            let said = String::from_utf8_lossy(&output.stderr).into_owned();
            assert!(output.status.success(), "{output:?}");
            assert!(
                said.contains("skipped: need::tests::child") && said.contains("there_is_no_such_package"),
                "{said}"
            );
            assert!(said.contains("VOLSEGGS_TEST_DATA") && said.contains("no/such/data"), "{said}");
            for need in [Need::Vtk, Need::Data] {
                let output = rerun(&[&data[..], &[(need.variable(), "1")]].concat());
                assert!(!output.status.success(), "{output:?}");
                assert!(
                    rerun(&[&data[..], &[(need.variable(), "")]].concat()).status.success(),
                    "an empty variable counts as unset"
                );
            }
        }
        let output = rerun(&[("VOLSEGGS_TEST_DATA", "/no/such/folder")]);
        assert!(!output.status.success() && String::from_utf8_lossy(&output.stdout).contains("there is no folder"));
    }
}
