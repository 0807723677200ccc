//! Commands whose standard output or standard error has no reader or goes to a full disk: the work is done and saved,
//! nothing panics, and a full standard output is an error, as the user asked for what it should hold.

use crate::check::newest;
use crate::common::json;
use crate::files::remove;
use crate::program::{Ended, Stream, start_with, words};
use crate::whole::whole_dataset;
use crate::world::{PREPARE, World, world};
use std::path::Path;
use volseggs::edit::{EditStack, Operation};
use volseggs::files::RunPaths;
use volseggs::segment::segmentation::Segmentation;

/// Standard output and standard error.
const FORMS: [[Stream; 2]; 6] = [
    [Stream::Gone, Stream::Kept],
    [Stream::Full, Stream::Kept],
    [Stream::Kept, Stream::Gone],
    [Stream::Kept, Stream::Full],
    [Stream::Gone, Stream::Gone],
    [Stream::Full, Stream::Full],
];

/// The expected exit code of a command.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Code {
    /// 0, or 1 if standard output is full.
    Work,
    /// 0 or 1: the command-line library prints the text.
    Text,
    /// 2: the command is invalid.
    Refused,
}

/// A command; `N` in its arguments becomes the number of the form, so that each form has its own outputs.
struct Case {
    line: String,
    code: Code,
    /// Whether the work of a form was saved.
    saved: fn(&Path, usize) -> bool,
}

fn nothing(_: &Path, _: usize) -> bool {
    true
}

fn cases(world: &World) -> Vec<Case> {
    let (a, b) = (&world.segments[0], &world.segments[1]);
    let look = |line: &str| Case { line: line.into(), code: Code::Work, saved: nothing };
    let work = |line: String, saved: fn(&Path, usize) -> bool| Case { line, code: Code::Work, saved };
    let with = |line: &str, code: Code| Case { line: line.into(), code, saved: nothing };
    let short = ["stages.warmup_steps=5", "stages.joint_steps=10", "output.eval_every=5", "output.log_every=5"];
    let train = world.training("trainN", &short).join(" ");
    vec![
        look("inspect run"),
        look("inspect run --json"),
        look("config show"),
        look("config show --json"),
        look("config schema"),
        look("config presets"),
        look("doctor"),
        look("edit list run"),
        look("segment list run --json"),
        look("compare run"),
        work("compare run --out comparisonN".into(), |f, n| f.join(format!("comparison{n}/report.html")).is_file()),
        work("eval run --split train --views 2 --json".into(), |f, _| f.join("run/eval/train/mean.json").is_file()),
        work(format!("edit recolour run --segment {a} --colour #00000N"), recoloured),
        work(format!("segment group run groupN {a} {b}"), grouped),
        work(format!("{train} --json"), trained),
        work(format!("{PREPARE} --out preparedN --json"), |f, n| {
            whole_dataset(&f.join(format!("prepared{n}"))).is_ok()
        }),
        work("render run --camera 0,-4,0 --size 8 --out stillN --json".into(), |f, n| {
            f.join(format!("still{n}/0000.png")).is_file()
        }),
        work("export run --out sceneN.ply --json".into(), |f, n| f.join(format!("scene{n}.ply")).is_file()),
        with("--help", Code::Text),
        with("train --help", Code::Text),
        with("--version", Code::Text),
        with("train --nonsense", Code::Refused),
        with("inspect not-there", Code::Refused),
    ]
}

/// Whether the colour of form `n` is among the edits.
fn recoloured(folder: &Path, n: usize) -> bool {
    let edits = EditStack::load(&folder.join("run/edits.json")).unwrap();
    let blue = |o: &Operation| matches!(o, Operation::Recolour { rgb, .. } if rgb[..2] == [0.0; 2] && rgb[2] == n as f32 / 255.0);
    edits.operations.iter().any(|e| blue(&e.operation))
}

/// Whether the group of form `n` is among the segments.
fn grouped(folder: &Path, n: usize) -> bool {
    Segmentation::load(&RunPaths(&folder.join("run")).segments()).unwrap().get(&format!("group{n}")).is_ok()
}

/// Whether the training of form `n` ran to its end.
fn trained(folder: &Path, n: usize) -> bool {
    let run = folder.join(format!("train{n}"));
    newest(&run) == Some(15) && json(&run.join("run.json"))["status"] == "complete"
}

pub fn all_forms() {
    let world = world();
    let folder = world.fresh("streams");
    let full = Path::new("/dev/full").exists();
    let mut faults = Vec::new();
    let mut count = 0;
    for case in cases(world) {
        for (n, form) in FORMS.into_iter().enumerate().filter(|(_, form)| full || !form.contains(&Stream::Full)) {
            let n = n + 1;
            let arguments: Vec<String> = words(&case.line).into_iter().map(|w| numbered(&w, n)).collect();
            let ended = start_with(&folder, &arguments, form).end();
            count += 1;
            let wrong = wrong(&case, form, n, &folder, &ended);
            faults.extend(
                wrong.into_iter().map(|w| format!("stdout {:?}, stderr {:?}: {w}\n  {ended}", form[0], form[1])),
            );
        }
    }
    println!("{count} commands with streams gone or full, {} faults", faults.len());
    assert!(faults.is_empty(), "{} faults:\n\n{}", faults.len(), faults.join("\n\n"));
    remove(&folder);
}

/// Puts the number of the form in place of an `N` at the end of a word or before `.ply`.
fn numbered(word: &str, n: usize) -> String {
    match word.strip_suffix('N') {
        Some(stem) => format!("{stem}{n}"),
        None => word.replace("N.ply", &format!("{n}.ply")),
    }
}

/// Returns what is wrong with how a command ended.
fn wrong(case: &Case, [out, err]: [Stream; 2], n: usize, folder: &Path, ended: &Ended) -> Vec<String> {
    let mut wrong: Vec<String> = ended.fault().into_iter().collect();
    let allowed: &[i32] = match (case.code, out) {
        (Code::Refused, _) => &[2],
        (Code::Text, _) => &[0, 1],
        (Code::Work, Stream::Full) => &[1],
        (Code::Work, _) => &[0],
    };
    if !ended.code().is_some_and(|c| allowed.contains(&c)) {
        wrong.push(format!("the exit code should be one of {allowed:?}"));
    }
    let reports = case.code == Code::Work && out == Stream::Full && err == Stream::Kept;
    if reports && !(ended.err.contains("error:") && ended.err.contains("standard output")) {
        wrong.push("nothing says that standard output could not be written".into());
    }
    if !(case.saved)(folder, n) {
        wrong.push("the work was not saved".into());
    }
    wrong
}
