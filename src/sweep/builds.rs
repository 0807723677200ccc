//! Runs that other builds of the program finished, and where they replace those of a plan.
//!
//! A build trains its own runs. Runs that another build finished are reported, shown if there is nothing else, and
//! taken over only on request. Runs that another build began or that failed there are left alone.

use super::key::{is_key, key, parts};
use super::plan::Plan;
use super::result::{RunCompletion, progress, progress_in, read};
use crate::files::RunPaths;
use crate::program::{build_label, short};
use crate::train::checkpoint;
use crate::train::run::RunRecord;
use std::collections::{BTreeMap, HashMap};
use std::path::Path;
use std::time::SystemTime;

/// Finished runs of other builds that could replace runs of a plan.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct OtherBuilds {
    /// Keys of runs of the same recipe, newest first, by the index of the run in the plan.
    keys: BTreeMap<usize, Vec<String>>,
}

impl OtherBuilds {
    /// Searches the folder of the runs of `plan` for them.
    pub fn find(plan: &Plan) -> Self {
        let places: HashMap<&str, usize> =
            plan.runs.iter().enumerate().map(|(i, run)| (parts(&run.key).0, i)).collect();
        let Ok(folders) = std::fs::read_dir(&plan.runs_folder) else { return Self::default() };
        let mut found: BTreeMap<usize, Vec<(SystemTime, String)>> = BTreeMap::new();
        for name in folders.flatten().filter_map(|f| f.file_name().into_string().ok()).filter(|n| is_key(n)) {
            if let Some(&place) = places.get(parts(&name).0)
                && plan.runs[place].key != name
                && let Some(when) = trained(&plan.runs_folder.join(&name))
            {
                found.entry(place).or_default().push((when, name));
            }
        }
        let newest_first = |(place, mut runs): (usize, Vec<(SystemTime, String)>)| {
            runs.sort_by(|a, b| b.cmp(a));
            (place, runs.into_iter().map(|(_, key)| key).collect())
        };
        Self { keys: found.into_iter().map(newest_first).collect() }
    }

    /// Returns the keys of the finished runs that could replace run `index`, newest first.
    pub fn of_run(&self, index: usize) -> &[String] {
        self.keys.get(&index).map_or(&[], Vec::as_slice)
    }

    /// Returns replacements for those of `runs` that the plan's build has not finished: the newest key, by run.
    pub fn replacements(&self, plan: &Plan, runs: &[usize]) -> BTreeMap<usize, String> {
        let open = |i: &&usize| progress(plan, **i) != RunCompletion::Done && trained(&plan.run_folder(**i)).is_none();
        runs.iter().filter(open).filter_map(|i| Some((*i, self.of_run(*i).first()?.clone()))).collect()
    }
}

/// When the run in `folder` was trained to its end; `None` if it was not.
fn trained(folder: &Path) -> Option<SystemTime> {
    let path = RunPaths(folder).record();
    let record: RunRecord = read(&path)?;
    let whole = record.status == "complete" && checkpoint::newest_scene(folder).is_some();
    whole.then(|| path.metadata().and_then(|m| m.modified()).unwrap_or(SystemTime::UNIX_EPOCH))
}

impl Plan {
    /// Assigns the runs of the plan's own build to `build`; runs that were taken over from other builds stay theirs. A
    /// worker does this if its program is not the one that planned, such as on a cluster where it has been rebuilt or
    /// is different. Returns whether anything changed.
    pub fn hand_over(&mut self, build: &str) -> bool {
        if self.build == build {
            return false;
        }
        for run in &mut self.runs {
            let (recipe, of) = parts(&run.key);
            if of == short(&self.build) {
                run.key = key(recipe, build);
            }
        }
        build.clone_into(&mut self.build);
        true
    }

    /// Replaces runs by those with these keys, by run.
    pub fn replace_runs(&mut self, keys: &BTreeMap<usize, String>) {
        for (run, key) in keys {
            self.runs[*run].key.clone_from(key);
        }
    }
}

/// A plan with the runs that a table shows, and notes on them.
#[derive(Clone, Debug, PartialEq)]
pub struct PlanView {
    /// The plan.
    pub plan: Plan,
    /// Notes on the choice of runs.
    pub notes: Vec<String>,
}

/// Returns what a table of `plan` shows: the runs of its own build or, if none of them has ended, those of the build
/// that finished the most; builds are mixed only if `any` is set.
pub fn view(plan: &Plan, any: bool) -> PlanView {
    let others = OtherBuilds::find(plan);
    // a failed run is shown as such, and not replaced
    let open: Vec<usize> = (0..plan.runs.len()).filter(|i| progress(plan, *i) == RunCompletion::Open).collect();
    let none = open.len() == plan.runs.len();
    let measured = |i: usize, key: &&String| progress_in(plan, i, &plan.runs_folder.join(key)) == RunCompletion::Done;
    let candidates: Vec<(usize, Vec<&String>)> =
        open.into_iter().map(|i| (i, others.of_run(i).iter().filter(|key| measured(i, key)).collect())).collect();
    let newest: BTreeMap<usize, String> =
        candidates.iter().filter_map(|(i, keys)| Some((*i, (*keys.first()?).clone()))).collect();
    let mut shown = plan.clone();
    let mut notes = Vec::new();
    if any {
        shown.replace_runs(&newest);
    } else if let (true, Some(build)) = (none, most_frequent_build(&candidates)) {
        let of_it = |keys: &[&String]| keys.iter().find(|key| parts(key).1 == build).map(|key| (*key).clone());
        let keys: BTreeMap<usize, String> =
            candidates.iter().filter_map(|(i, keys)| Some((*i, of_it(keys)?))).collect();
        notes.push(format!(
            "no run of {} has finished yet; showing those of other builds ({})",
            build_label(&plan.build),
            tally(keys.values())
        ));
        shown.replace_runs(&keys);
    } else if !newest.is_empty() {
        let (runs, are) = if newest.len() == 1 { ("run", "is") } else { ("runs", "are") };
        notes.push(format!(
            "{} {runs} finished by another build ({}) {are} not shown; pass --any-build to include other builds",
            newest.len(),
            tally(newest.values())
        ));
    }
    PlanView { plan: shown, notes }
}

/// The build that could replace the most runs.
fn most_frequent_build<'a>(candidates: &[(usize, Vec<&'a String>)]) -> Option<&'a str> {
    let mut counts: BTreeMap<&str, usize> = BTreeMap::new();
    for key in candidates.iter().flat_map(|(_, keys)| keys) {
        *counts.entry(parts(key).1).or_default() += 1;
    }
    counts.into_iter().max_by_key(|(_, n)| *n).map(|(build, _)| build)
}

/// Lists the builds of these keys with the number of runs of each.
pub fn tally<'a>(keys: impl Iterator<Item = &'a String>) -> String {
    let mut counts: BTreeMap<&str, usize> = BTreeMap::new();
    keys.for_each(|key| *counts.entry(parts(key).1).or_default() += 1);
    counts.iter().map(|(build, n)| format!("{}: {n}", build_label(build))).collect::<Vec<_>>().join(", ")
}

#[cfg(test)]
mod tests {
    use super::super::result::{Metrics, RunFailure, failure_path, metrics_in, write, write_measured};
    use super::super::{PlanOptions, halving};
    use super::*;
    use crate::sweep::collect::collect;
    use std::path::PathBuf;
    use std::time::Duration;

    const A: &str = "aaaaaaaaaaaaaaaa";
    const B: &str = "bbbbbbbbbbbbbbbb";

    /// A plan of two runs that build B is to train.
    fn plan(root: &Path) -> Plan {
        let path = root.join("s.toml");
        let text = "config = 'demo'\nmetrics = ['psnr']\n[[variant]]\nname = 'x'\n[[variant]]\nname = 'y'\n\
                    set = { 'loss.tv' = 0.5 }\n[data]\njets = { synthetic = 'jets', size = 40, times = 3, views = 4 }";
        std::fs::write(&path, text).unwrap();
        let mut plan = Plan::new(&path, &PlanOptions { out: root.to_owned(), ..PlanOptions::default() }).unwrap();
        assert_eq!(plan.build, crate::program::build().unwrap().digest);
        assert!(plan.hand_over(B) && !plan.hand_over(B));
        plan
    }

    /// A run that was trained to the end and not measured.
    fn train(plan: &Plan, key: &str) -> PathBuf {
        let folder = plan.runs_folder.join(key);
        let checkpoint = folder.join("checkpoints/step-000100");
        std::fs::create_dir_all(&checkpoint).unwrap();
        std::fs::write(checkpoint.join("state.json"), "{}").unwrap();
        write(&folder.join("run.json"), &RunRecord { status: "complete".into(), ..RunRecord::default() }).unwrap();
        folder
    }

    fn measure(plan: &Plan, key: &str, psnr: f64) {
        let folder = train(plan, key);
        write_measured(&metrics_in(plan, 0, &folder), Metrics::from([("psnr".to_owned(), psnr)])).unwrap();
    }

    fn age(plan: &Plan, key: &str, seconds: u64) {
        let file = std::fs::File::options().write(true).open(plan.runs_folder.join(key).join("run.json")).unwrap();
        file.set_modified(SystemTime::UNIX_EPOCH + Duration::from_secs(seconds)).unwrap();
    }

    fn of(plan: &Plan, run: usize, build: &str) -> String {
        key(parts(&plan.runs[run].key).0, build)
    }

    #[test]
    fn finished_runs_of_other_builds_are_found_newest_first() {
        let dir = tempfile::tempdir().unwrap();
        let mut plan = plan(dir.path());
        assert_eq!(OtherBuilds::find(&plan), OtherBuilds::default());
        let (old, before) = (of(&plan, 0, A), of(&plan, 0, "dddddddddddddddd"));
        for (key, seconds) in [(&before, 10), (&old, 20)] {
            train(&plan, key);
            age(&plan, key, seconds);
        }
        // an unfinished run, one of another recipe, and a folder that is no run
        let begun = plan.runs_folder.join(of(&plan, 1, A));
        std::fs::create_dir_all(&begun).unwrap();
        write(&begun.join("run.json"), &RunRecord { status: "running".into(), ..RunRecord::default() }).unwrap();
        train(&plan, "0011223344556677-aaaaaaaaaaaa");
        train(&plan, &format!("{before}-x"));
        let found = OtherBuilds::find(&plan);
        assert_eq!((found.of_run(0), found.of_run(1)), (&[old.clone(), before.clone()][..], &[][..]));
        assert_eq!(tally(found.of_run(0).iter()), "build aaaaaaaaaaaa: 1, build dddddddddddd: 1");
        let replacements = found.replacements(&plan, &[0, 1]);
        assert_eq!(replacements, BTreeMap::from([(0, old.clone())]));
        // a run that was taken over keeps its build when another build works on the plan; the plan's other run does not
        plan.replace_runs(&replacements);
        assert!(plan.hand_over("cccccccccccccccc"));
        assert_eq!((&plan.runs[0].key, parts(&plan.runs[1].key).1), (&old, "cccccccccccc"));
        // a run that the plan's own build has trained needs no replacement
        train(&plan, &plan.runs[0].key);
        assert!(OtherBuilds::find(&plan).replacements(&plan, &[0, 1]).is_empty());
    }

    #[test]
    fn a_table_shows_one_build_unless_any_is_requested() {
        let dir = tempfile::tempdir().unwrap();
        let plan = plan(dir.path());
        let shown = |any: bool| {
            let view = view(&plan, any);
            let set = collect(&view.plan, dir.path());
            let psnr: Vec<Option<f64>> = set.outcomes.iter().map(|o| o.metrics.get("psnr").copied()).collect();
            (psnr, view.notes.join("\n"), set.builds())
        };
        assert_eq!(shown(false), (vec![None, None], String::new(), String::new()));
        // no run of its own: the older build, all of it
        measure(&plan, &of(&plan, 0, A), 20.0);
        measure(&plan, &of(&plan, 1, A), 21.0);
        train(&plan, &of(&plan, 1, "dddddddddddddddd"));
        let (psnr, notes, builds) = shown(false);
        assert_eq!(psnr, [Some(20.0), Some(21.0)]);
        assert!(
            notes.contains("no run of build bbbbbbbbbbbb has finished") && notes.contains("aaaaaaaaaaaa: 2"),
            "{notes}"
        );
        assert!(builds.contains("aaaaaaaaaaaa"), "{builds}");
        // a run of its own: only that, with a note on the other build
        measure(&plan, &plan.runs[1].key, 30.0);
        let (psnr, notes, builds) = shown(false);
        assert_eq!(psnr, [None, Some(30.0)]);
        assert!(notes.contains("--any-build") && notes.contains("aaaaaaaaaaaa: 1"), "{notes}");
        assert!(builds.contains("bbbbbbbbbbbb") && !builds.contains("aaaaaaaaaaaa"), "{builds}");
        // both, on request
        let (psnr, notes, builds) = shown(true);
        assert_eq!((psnr, notes.as_str()), (vec![Some(20.0), Some(30.0)], ""));
        assert!(builds.contains("aaaaaaaaaaaa (1 run)") && builds.contains("bbbbbbbbbbbb (1 run)"), "{builds}");
    }

    #[test]
    fn a_failed_run_of_this_build_is_not_replaced_by_another_build() {
        let dir = tempfile::tempdir().unwrap();
        let plan = plan(dir.path());
        measure(&plan, &of(&plan, 0, A), 20.0);
        let failure = RunFailure { error: "no".into(), stage: "train".into() };
        for run in 0..2 {
            std::fs::create_dir_all(plan.run_folder(run)).unwrap();
            write(&failure_path(&plan.run_folder(run)), &failure).unwrap();
        }
        for any in [false, true] {
            assert_eq!(view(&plan, any).plan, plan);
        }
    }

    #[test]
    fn runs_that_another_build_stopped_by_halving_stay_recorded() {
        let dir = tempfile::tempdir().unwrap();
        let mut plan = plan(dir.path());
        let stop = |plan: &Plan, run: usize, step| {
            let all: Vec<usize> = (0..plan.runs.len()).collect();
            halving::save(dir.path(), plan, &all, &BTreeMap::from([(plan.runs[run].key.clone(), step)])).unwrap();
        };
        stop(&plan, 0, 40);
        let old = plan.runs[0].key.clone();
        plan.hand_over(A);
        stop(&plan, 1, 50);
        // the same plan decides again
        stop(&plan, 0, 60);
        assert_eq!(halving::stopped(dir.path()), BTreeMap::from([(old, 40), (plan.runs[0].key.clone(), 60)]));
    }
}
