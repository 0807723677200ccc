//! A Slurm of one node, started by `support/slurm-cluster`.

use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::{Duration, Instant};

use tempfile::TempDir;
use volseggs::sweep::slurm::SlurmTools;

const SCRIPT: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/support/slurm-cluster");

/// A running Slurm, which ends when this is dropped.
pub struct Cluster {
    base: TempDir,
}

impl Cluster {
    /// Starts Slurm; `None` if it is not installed, and the test is then skipped.
    pub fn start() -> Option<Self> {
        let cluster = Self { base: tempfile::tempdir().unwrap() };
        let output = Command::new(SCRIPT).arg("start").arg(cluster.dir()).output().unwrap();
        if output.status.code() == Some(77) {
            volseggs_testing::skip(volseggs_testing::Need::Slurm, &String::from_utf8_lossy(&output.stderr));
            return None;
        }
        assert!(output.status.success(), "{output:?}");
        Some(cluster)
    }

    /// Returns a folder that is removed with the cluster.
    pub fn base(&self) -> &Path {
        self.base.path()
    }

    /// Returns the value of `SLURM_CONF`.
    pub fn conf(&self) -> PathBuf {
        self.dir().join("slurm.conf")
    }

    fn dir(&self) -> PathBuf {
        self.base.path().join("cluster")
    }

    /// Returns Slurm's programs, bound to this cluster.
    pub fn tools(&self) -> SlurmTools {
        let bin = self.base.path().join("bin");
        let path = std::env::var_os("PATH").unwrap();
        for name in ["sbatch", "squeue", "scontrol", "scancel"] {
            let real = std::env::split_paths(&path).map(|folder| folder.join(name)).find(|file| file.is_file());
            let conf = self.conf();
            let real = real.unwrap();
            let text = format!("SLURM_CONF={} exec {} \"$@\"", conf.display(), real.display());
            executable(&bin.join(name), &text);
        }
        let both = std::iter::once(bin).chain(std::env::split_paths(&path));
        SlurmTools::new(&std::env::join_paths(both).unwrap())
    }

    /// Runs a program of Slurm to its end; returns what it prints.
    pub fn call(&self, name: &str, arguments: &[&str]) -> String {
        let output = Command::new(name).args(arguments).env("SLURM_CONF", self.conf()).output().unwrap();
        assert!(output.status.success(), "{output:?}");
        String::from_utf8(output.stdout).unwrap()
    }

    /// Waits until nothing is running or queued, except tasks of the job `stays`.
    pub fn wait_until_empty(&self, stays: Option<u64>) {
        let begun = Instant::now();
        let stays = stays.map(|job| job.to_string());
        let jobs = || self.call("squeue", &["--noheader", "--format=%F"]);
        while jobs().split_whitespace().any(|job| Some(job) != stays.as_deref()) {
            assert!(begun.elapsed() < Duration::from_secs(120), "{}", self.call("squeue", &[]));
            std::thread::sleep(Duration::from_millis(200));
        }
    }
}

impl Drop for Cluster {
    fn drop(&mut self) {
        let _ = Command::new(SCRIPT).arg("stop").arg(self.dir()).status();
    }
}

/// Writes an executable shell script.
pub fn executable(file: &Path, body: &str) {
    fs::create_dir_all(file.parent().unwrap()).unwrap();
    fs::write(file, format!("#!/bin/bash\n{body}\n")).unwrap();
    fs::set_permissions(file, fs::Permissions::from_mode(0o755)).unwrap();
}
