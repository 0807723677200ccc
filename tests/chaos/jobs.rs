//! Every command that writes, what it may touch, and how it is completed after a kill.

use crate::program::words;
use crate::world::{CAMERA, PREPARE, World, knows, knows_replace};

/// How a command is completed after a kill.
pub enum Again {
    /// Run again unchanged.
    Same,
    /// A training into this folder: run with `--resume` once there is a checkpoint, otherwise unchanged; the result is
    /// that of a training that was never killed.
    Train(&'static str),
    /// Run again, unless this segment exists.
    Segment(&'static str),
    /// Run again, unless this segment is gone.
    NoSegment(&'static str),
    /// Run again, unless this folder exists, which the command refuses to replace.
    Folder(&'static str),
}

/// A command under attack.
pub struct Job {
    pub name: &'static str,
    pub arguments: Vec<String>,
    /// Paths that it may create and change; `*` matches across folders too.
    pub writable: Vec<String>,
    /// Exceptions to these paths.
    pub except: Vec<String>,
    /// Paths that it may remove.
    pub removable: Vec<String>,
    /// Folders that must be entirely in their old state or entirely in their new one.
    pub atomic: Vec<String>,
    pub again: Again,
}

impl Job {
    fn new(name: &'static str, line: &str, writable: &[&str]) -> Self {
        let writable = owned(writable);
        let arguments = words(line);
        Self { name, arguments, writable, except: vec![], removable: vec![], atomic: vec![], again: Again::Same }
    }

    fn except(mut self, patterns: &[&str]) -> Self {
        self.except = owned(patterns);
        self
    }

    fn removable(mut self, patterns: &[&str]) -> Self {
        self.removable = owned(patterns);
        self
    }

    fn atomic(mut self, folders: &[&str]) -> Self {
        self.atomic = owned(folders);
        self
    }

    fn again(mut self, again: Again) -> Self {
        self.again = again;
        self
    }
}

fn owned(list: &[&str]) -> Vec<String> {
    list.iter().map(ToString::to_string).collect()
}

/// Whether a file holds a time or a duration, and so is never the same twice.
pub fn depends_on_the_clock(path: &str) -> bool {
    const CLOCKS: [&str; 6] =
        ["*/run.json", "*/metrics.jsonl", "*/state.json", "*/tensorboard/*", "*/mean.json", "*/prepare.json"];
    crate::files::fits(&owned(&CLOCKS), path)
}

/// Returns all commands, for copies of the world.
pub fn jobs(world: &World) -> Vec<Job> {
    let (a, b, pixel) = (&world.segments[0], &world.segments[1], &world.pixel);
    let tracks = [a, b].map(|name| format!("run/track/{name}"));
    let tracks = tracks.each_ref().map(String::as_str);
    let segments = ["run/segments/*"];
    let made_from_masks = ["run/segments/masks*", "run/segments/affinity*"];
    let prepare_new = Again::Folder("fresh");
    let mut train = Job::new("train", "", &["new/*"]).removable(&["new/checkpoints/*"]).again(Again::Train("new"));
    train.arguments = world.training("new", &[]);
    let mut layout = Job::new("inspect --picture", "inspect DATA --picture layout.png", &["layout.png"]);
    layout.arguments[1] = world.data();
    let base = world.root.join("base");
    let mut all = vec![
        train,
        Job::new("train --resume", "train --resume half", &["half/*"])
            .removable(&["half/checkpoints/*"])
            .again(Again::Train("half")),
        Job::new("segment coarse", "segment coarse run --clusters 2 --keep-outliers --replace", &segments)
            .except(&made_from_masks)
            .removable(&["run/segments/*.png"]),
        Job::new("segment masks", "segment masks run --views 3 --size 24", &["run/segments/masks*"]),
        Job::new("segment masks --pictures", "segment masks run --pictures --views 3", &["run/segments/pictures*"])
            .atomic(&["run/segments/pictures"])
            .again(Again::Folder("run/segments/pictures")),
        Job::new("segment fine", "segment fine run --steps 10 --pixels 64 --seed 1", &["run/segments/affinity*"]),
        Job::new("segment split", &format!("segment split run {a} --clusters 2"), &segments).except(&made_from_masks),
        Job::new("segment pick", &format!("segment pick run {CAMERA} --pixel {pixel} --name picked"), &segments)
            .except(&made_from_masks)
            .again(Again::Segment("picked")),
        Job::new("segment group", &format!("segment group run both {a} {b}"), &segments)
            .except(&made_from_masks)
            .again(Again::Segment("both")),
        Job::new("segment remove", "segment remove run extra", &segments)
            .except(&made_from_masks)
            .again(Again::NoSegment("extra")),
        Job::new("edit recolour", &format!("edit recolour run --segment {a} --colour #ff8800"), &["run/edits*"]),
        Job::new("edit undo", "edit undo run", &["run/edits*"]),
        Job::new("edit redo", "edit redo run", &["run/edits*"]),
        Job::new("edit clear", "edit clear run", &["run/edits*"]),
        Job::new(
            "track",
            &format!("track run --segment {a} --segment {b} --frames 3 --renders --size 16"),
            &["run/track/*"],
        )
        .removable(&["run/track/*"])
        .atomic(&tracks),
        Job::new("eval", "eval run --views 4", &["run/eval/*"]).removable(&["run/eval/*"]),
        Job::new("render", "render run --path orbit --frames 3 --size 16 --out frames", &["frames/*"])
            .removable(&["frames/*"])
            .atomic(&["frames"]),
        Job::new("export ply", "export run --time 0.5 --out scene.ply", &["scene.ply"]),
        Job::new("export --frames", "export run --frames 3 --out plys", &["plys/*"])
            .removable(&["plys/*"])
            .atomic(&["plys"]),
        Job::new(
            "export nrrd",
            "export run --format nrrd --dims 6,7,8 --time 0.5 --out labels.seg.nrrd",
            &["labels.seg.nrrd"],
        ),
        Job::new("export vti", "export run --format vti --dims 6,7,8 --time 0.5 --out labels.vti", &["labels.vti"]),
        Job::new("prepare", &format!("{PREPARE} --out fresh"), &["fresh/*"]).atomic(&["fresh"]).again(prepare_new),
        Job::new(
            "prepare --replace",
            &format!("{PREPARE} --radius 4.5 --seed 1 --out prepared --replace"),
            &["prepared/*"],
        )
        .removable(&["prepared/*"])
        .atomic(&["prepared"]),
        Job::new("compare", "compare run --out comparison", &["comparison/*"]).removable(&["comparison/*"]),
        layout,
    ];
    if knows(&base, "segment undo") {
        all.push(Job::new("segment undo", "segment undo run", &segments).except(&made_from_masks));
    }
    // commands that replace existing output only if asked to
    for job in &mut all {
        let asks = ["segment masks", "segment fine", "segment split", "track", "eval", "render", "compare"];
        let exports = job.name.starts_with("export") || job.name.starts_with("inspect");
        if exports || asks.contains(&job.name) {
            let words = if job.name.starts_with("segment") { 2 } else { 1 };
            let command: Vec<&str> = job.arguments[..words].iter().map(String::as_str).collect();
            if knows_replace(&base, &command) {
                job.arguments.push("--replace".into());
            }
        }
    }
    all
}
