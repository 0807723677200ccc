//! Sweeps: their files, plans, claims and lists of jobs. Nothing is run.

use crate::driver::{Scratch, Target, accepted, fuzz};
use volseggs::config::flatten;
use volseggs::sweep::axes::variants;
use volseggs::sweep::file::{SweepFile, name_of};
use volseggs::sweep::result::progress;
use volseggs::sweep::slurm::submissions;
use volseggs::sweep::{Plan, PlanOptions, claim, collect, halving};

const FILE: &str = "title = \"T\"\nnote = \"n\"\nconfig = \"quick\"\nseeds = [0, 1]\nmetrics = [\"psnr\", \"ssim\"]\nbaseline = \"a\"\n\
    [set]\nmodel.width = 8\n[data]\njets = { synthetic = \"jets\", size = 32, times = 2, views = 2, test_views = 3, segments = true }\n\
    [eval]\nviews = 3\n[[variant]]\nname = \"a\"\n[[variant]]\nname = \"b\"\nset = { loss.kind = \"l1\" }\n";
const RANDOM: &str = "[data]\nx = { synthetic = \"shells\" }\n[grid]\nloss.dssim = [0.1, 0.2]\n\"model.levels\" = [1, 2]\n\
    [random]\nmethod = \"sobol\"\ncount = 4\nseed = 3\n[random.keys.\"loss.alpha\"]\nlow = 1e-4\nhigh = 1.0\nlog = true\n\
    [random.keys.\"model.width\"]\nlow = 4\nhigh = 64\ninteger = true\n[random.keys.\"loss.kind\"]\nchoices = [\"l1\", \"l2\"]\n";
const SEGMENTS: &str = "[data]\nx = { synthetic = \"vortices\", segments = true }\n[segments]\nmethod = \"fine\"\nclusters = 3\ntime = 0.5\n\
    [[variant]]\nname = \"v\"\nset = { segments.margin = -1.0 }\n[halving]\nrungs = [1000, 2000]\nkeep = 0.5\n\
    [paper]\nsource = \"table 1\"\nrows = { v = { psnr = 30.0 } }\n";

fn options(scratch: &Scratch) -> PlanOptions {
    PlanOptions { out: scratch.path("out"), elsewhere: true, ..PlanOptions::default() }
}

/// Uses a plan as before and after its runs.
fn used(plan: &Plan, scratch: &Scratch) {
    let _ = (plan.hash(), collect::collect(plan, &scratch.path("out/s")).outcomes.len());
    let runs: Vec<usize> = (0..plan.runs.len()).collect();
    for run in &runs {
        let _ = progress(plan, *run);
    }
    let _ = halving::survivors(plan, &runs, 5, 0.5);
}

#[test]
fn file() {
    fuzz("sweep", |scratch| {
        let (path, scratch) = (scratch.path("s.toml"), scratch.clone());
        let read = move |bytes: &[u8]| {
            scratch.overwrite(&path, bytes);
            let Some(file) = accepted(SweepFile::read(&path)) else { return false };
            let _ = (name_of(&path), flatten(&file.grid).len());
            accepted(file.datasets());
            accepted(variants(&file));
            if let Some(plan) = accepted(Plan::new(&path, &options(&scratch))) {
                used(&plan, &scratch);
            }
            true
        };
        // a plan has at most 100,000 runs, each with its resolved configuration
        Target::new([FILE, RANDOM, SEGMENTS].map(|s| s.as_bytes().to_vec()).to_vec(), read).sizes(16 << 10, 512).tokens(
            &[
                "[random]\n",
                "count = 1000000000\n",
                "method = \"latin-hypercube\"\n",
                "method = \"uniform\"\n",
                "[grid]\n",
                "choices = []\n",
                "seeds = []\n",
                "low = -1e300\n",
                "high = 1e300\n",
                "devices = [\"ndarray\"]\n",
                "[[variant]]\nname = \"c\"\n",
                "tag = \"x\"\n",
                "times = 10000000000\n",
                "views = 10000000000\n",
                "size = 0\n",
                "voxels = 1\n",
                "segment_views = 0\n",
                "shading = { power = 0 }\n",
                "x = \"nowhere\"\n",
                "name = \"../x\"\n",
            ],
        )
    });
}

#[test]
fn plan() {
    fuzz("sweep-plan", |scratch| {
        let seeds = [FILE, SEGMENTS].map(|text| {
            let file = scratch.write("s.toml", text.as_bytes());
            let dir = scratch.path("out/s");
            Plan::new(&file, &options(scratch)).unwrap().save(&dir).unwrap();
            std::fs::read(dir.join("plan.json")).unwrap()
        });
        let (path, scratch) = (scratch.path("out/s/plan.json"), scratch.clone());
        let read = move |bytes: &[u8]| {
            scratch.overwrite(&path, bytes);
            let Some(plan) = accepted(Plan::load(&scratch.path("out/s"), None)) else { return false };
            used(&plan, &scratch);
            true
        };
        Target::new(seeds.to_vec(), read).sizes(64 << 10, 64).tokens(&[
            "\"run\": 9",
            "\"segments\": 9",
            "\"runs\": []",
            "\"key\": \"../..\"",
        ])
    });
}

#[test]
fn claims() {
    fuzz("sweep-claim", |scratch| {
        let seed = r#"{"host": "h", "place": "p", "pid": 1, "born": 5, "task": "1_2", "starts": 0, "beat": 3, "released": false}"#;
        let (path, scratch) = (scratch.write("run/claim-0003", b""), scratch.clone());
        let read = move |bytes: &[u8]| {
            scratch.overwrite(&path, bytes);
            claim::holder(&scratch.path("run")).is_some_and(|h| !h.to_string().is_empty())
        };
        Target::new(vec![seed.as_bytes().to_vec()], read)
    });
}

#[test]
fn jobs() {
    fuzz("slurm-jobs", |scratch| {
        let path = scratch.write("slurm/jobs.jsonl", b"");
        let scratch = scratch.clone();
        let read = move |bytes: &[u8]| {
            scratch.overwrite(&path, bytes);
            accepted(submissions(scratch.root())).is_some()
        };
        let seed = "{\"format\":1,\"job\":12,\"cluster\":null,\"offset\":0,\"tasks\":[0,1],\"plan\":\"01234567\",\"time\":5}\n{\"job\":13";
        Target::new(vec![seed.as_bytes().to_vec(), b"\n".to_vec(), Vec::new()], read)
    });
}
