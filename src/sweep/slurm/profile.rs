//! The Slurm profile: a small TOML file that specifies what one task of a sweep may use. All keys are optional.

use std::path::Path;

use serde::Deserialize;

use super::{SlurmError, io_at};
use crate::files::read_settings;

/// What a task may use, and how the program is called on the nodes.
#[derive(Debug, Clone, Default, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SlurmProfile {
    /// Partition (queue); the cluster's default if not given.
    pub partition: Option<String>,
    /// Account that is charged.
    pub account: Option<String>,
    /// Quality of service.
    pub qos: Option<String>,
    /// Time limit of a task, such as `02:00:00` or `1-00:00:00`. A task that reaches it is queued again and resumes.
    pub time: Option<String>,
    /// Memory of a task, such as `8G`.
    pub memory: Option<String>,
    /// Processors of a task; its worker uses the same number of threads.
    pub cpus: Option<u32>,
    /// GPUs of a task: a count, or `"TYPE:COUNT"`.
    pub gpus: Option<Gpus>,
    /// Features a node must have.
    pub constraint: Option<String>,
    /// Environment modules that are loaded first.
    pub modules: Vec<String>,
    /// Lines of shell that are run first, such as `source env.sh`. One that fails ends the task.
    pub setup: Vec<String>,
    /// Maximum number of tasks that run at once; as many as the cluster allows if not given.
    pub parallel: Option<u32>,
    /// Seconds of warning before the time limit, in which the worker saves its checkpoint; 120 if not given.
    pub grace: Option<u32>,
    /// How the program is called on the nodes, as shell text; the absolute path of the running program if not given.
    pub command: Option<String>,
    /// Further options of `sbatch`, such as `--exclusive`, written verbatim.
    pub extra: Vec<String>,
}

/// GPUs of a task.
#[derive(Debug, Clone, PartialEq, Eq, Deserialize)]
#[serde(untagged, expecting = "expected a count such as 1, or \"TYPE:COUNT\" such as \"a100:1\"")]
pub enum Gpus {
    /// A number of any type.
    Count(u32),
    /// `COUNT` or `TYPE:COUNT`.
    Typed(String),
}

impl SlurmProfile {
    /// Reads and checks a profile.
    ///
    /// # Errors
    /// [`SlurmError::Io`], [`SlurmError::Toml`] for unknown keys and wrong types, [`SlurmError::Key`] for a value that
    /// Slurm would not accept.
    pub fn read(path: &Path) -> Result<Self, SlurmError> {
        let text = read_settings(path).map_err(io_at(path))?;
        Self::parse(path, &text)
    }

    /// Like [`SlurmProfile::read`], with the text of the file; `path` is for messages.
    ///
    /// # Errors
    /// As [`SlurmProfile::read`].
    pub fn parse(path: &Path, text: &str) -> Result<Self, SlurmError> {
        let profile: Self = crate::nesting::check_toml(text)
            .map_err(serde::de::Error::custom)
            .and_then(|()| toml::from_str(text))
            .map_err(|source| SlurmError::Toml { path: path.to_path_buf(), source: Box::new(source) })?;
        profile.check().map_err(|(key, value, fix)| SlurmError::Key { path: path.to_path_buf(), key, value, fix })?;
        Ok(profile)
    }

    /// Seconds of warning before the time limit.
    pub(super) fn grace(&self) -> u32 {
        self.grace.unwrap_or(120)
    }

    /// The value of the option `--gres` for the GPUs.
    pub(super) fn gres(&self) -> Option<String> {
        match self.gpus.as_ref()? {
            Gpus::Count(0) => None,
            Gpus::Count(count) => Some(format!("gpu:{count}")),
            Gpus::Typed(text) => Some(format!("gpu:{text}")),
        }
    }

    fn check(&self) -> Result<(), (&'static str, String, &'static str)> {
        let ensure = |good: bool, key, value: &dyn std::fmt::Debug, fix| {
            if good { Ok(()) } else { Err((key, format!("{value:?}"), fix)) }
        };
        let names = [
            ("partition", &self.partition),
            ("account", &self.account),
            ("qos", &self.qos),
            ("constraint", &self.constraint),
        ];
        for (key, value) in names {
            let good = value.as_deref().is_none_or(|v| is_line(v) && !v.contains(char::is_whitespace));
            ensure(good, key, value, "use the name that `sinfo` or `sacctmgr` shows, without spaces")?;
        }
        let command = self.command.as_deref();
        ensure(command.is_none_or(is_line), "command", &self.command, "give one line of shell, such as \"volseggs\"")?;
        ensure(
            self.memory.as_deref().is_none_or(is_memory),
            "memory",
            &self.memory,
            "give a whole number and a unit (K, M, G or T), such as \"8G\"",
        )?;
        ensure(self.cpus != Some(0), "cpus", &self.cpus, "give 1 or more, or omit the key")?;
        ensure(self.parallel != Some(0), "parallel", &self.parallel, "give 1 or more, or omit the key")?;
        if let Some(Gpus::Typed(text)) = &self.gpus {
            ensure(is_gpus(text), "gpus", text, "give a count such as 1, or \"TYPE:COUNT\" such as \"a100:1\"")?;
        }
        let grace = self.grace();
        ensure((1..=65535).contains(&grace), "grace", &grace, "give 1 to 65535 seconds, such as 120")?;
        if let Some(time) = &self.time {
            let limit = seconds(time);
            ensure(
                limit.is_some_and(|s| s > 0),
                "time",
                time,
                "give \"HOURS:MINUTES:SECONDS\" or \"DAYS-HOURS:MINUTES:SECONDS\", such as \"02:00:00\"",
            )?;
            // otherwise every task would be stopped as soon as it starts, forever
            let longer = limit.is_some_and(|s| s > u64::from(grace));
            ensure(
                longer,
                "grace",
                &grace,
                "make it shorter than `time`, leaving a worker enough time to make progress",
            )?;
        }
        for name in &self.modules {
            let good = is_line(name) && !name.contains(char::is_whitespace);
            ensure(good, "modules", name, "give one module name per entry, such as \"cuda/12\"")?;
        }
        for line in &self.setup {
            ensure(!line.contains('\0'), "setup", line, "give lines of shell, such as \"source env.sh\"")?;
        }
        for option in &self.extra {
            let good = is_line(option) && option.starts_with('-');
            ensure(good, "extra", option, "give options of sbatch, each with its dashes, such as \"--exclusive\"")?;
        }
        Ok(())
    }
}

fn is_line(text: &str) -> bool {
    !text.trim().is_empty() && !text.contains(char::is_control)
}

fn is_memory(text: &str) -> bool {
    let digits = text.strip_suffix(['K', 'M', 'G', 'T', 'k', 'm', 'g', 't']).unwrap_or(text);
    is_number(digits)
}

fn is_gpus(text: &str) -> bool {
    let (kind, count) = text.rsplit_once(':').map_or((None, text), |(kind, count)| (Some(kind), count));
    let name = |c: char| c.is_ascii_alphanumeric() || "_.-".contains(c);
    is_number(count)
        && count.parse().is_ok_and(|n: u32| n > 0)
        && kind.is_none_or(|k| !k.is_empty() && k.chars().all(name))
}

fn is_number(text: &str) -> bool {
    !text.is_empty() && text.len() <= 9 && text.bytes().all(|b| b.is_ascii_digit())
}

/// Parses a time as Slurm writes it into seconds: `M`, `M:S`, `H:M:S`, `D-H`, `D-H:M` or `D-H:M:S`.
pub(super) fn seconds(text: &str) -> Option<u64> {
    let (days, rest) = text.split_once('-').map_or((None, text), |(days, rest)| (Some(days), rest));
    let parts: Vec<u64> =
        rest.split(':').map(|part| is_number(part).then(|| part.parse().ok())?).collect::<Option<_>>()?;
    let clock = match (days.is_some(), parts.as_slice()) {
        (false, [m]) => m * 60,
        (false, [m, s]) => m * 60 + s,
        (true, [h]) => h * 3600,
        (true, [h, m]) => h * 3600 + m * 60,
        (_, [h, m, s]) => h * 3600 + m * 60 + s,
        _ => return None,
    };
    match days {
        None => Some(clock),
        Some(days) => is_number(days).then(|| days.parse::<u64>().ok())?.map(|days| days * 86400 + clock),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn parse(text: &str) -> Result<SlurmProfile, SlurmError> {
        SlurmProfile::parse(Path::new("a/slurm.toml"), text)
    }

    #[test]
    fn all_keys_are_optional_and_read() {
        assert_eq!(parse("").unwrap(), SlurmProfile::default());
        let profile = parse(
            "partition='gpu'\naccount='a'\nqos='q'\ntime='1-00:00:00'\nmemory='8G'\ncpus=8\ngpus='a100:2'\n\
             constraint='[a|b]'\nmodules=['cuda/12']\nsetup=['source env.sh']\nparallel=50\ngrace=60\n\
             command='apptainer exec it.sif volseggs'\nextra=['--exclusive']\n",
        )
        .unwrap();
        assert_eq!(profile.gres().as_deref(), Some("gpu:a100:2"));
        assert_eq!((profile.cpus, profile.parallel, profile.grace()), (Some(8), Some(50), 60));
        assert_eq!(parse("gpus=2").unwrap().gres().as_deref(), Some("gpu:2"));
        assert_eq!(parse("gpus=0").unwrap().gres(), None);
    }

    #[test]
    fn errors_name_file_key_and_fix() {
        for (text, words) in [
            ("partitoin='gpu'", ["partitoin", "unknown field", "`partition`"]),
            ("cpus='many'", ["cpus", "line 1", "invalid type"]),
            ("cpus=-1", ["cpus", "line 1", "-1"]),
            ("gpus=1.5", ["gpus", "count", "TYPE:COUNT"]),
            ("gpus='a100:'", ["gpus", "a100:", "TYPE:COUNT"]),
            ("gpus='a 100:1'", ["gpus", "a 100", "TYPE:COUNT"]),
            ("time='2h'", ["time", "2h", "02:00:00"]),
            ("time='0'", ["time", "0", "02:00:00"]),
            ("time='2'", ["grace", "120", "shorter than `time`"]),
            ("grace=0", ["grace", "0", "120"]),
            ("memory='8 GB'", ["memory", "8 GB", "8G"]),
            ("memory=''", ["memory", "\"\"", "8G"]),
            ("cpus=0", ["cpus", "0", "1 or more"]),
            ("parallel=0", ["parallel", "0", "1 or more"]),
            ("partition='a b'", ["partition", "a b", "without spaces"]),
            ("account=\"a\\nb\"", ["account", "a\\nb", "without spaces"]),
            ("modules=['x; rm']", ["modules", "x; rm", "cuda/12"]),
            ("extra=['exclusive']", ["extra", "exclusive", "--exclusive"]),
            ("extra=[\"--x\\nrm\"]", ["extra", "--x", "--exclusive"]),
            ("command=''", ["command", "\"\"", "volseggs"]),
            ("time=", ["slurm.toml", "line 1", "time"]),
        ] {
            let said = parse(text).unwrap_err().to_string();
            assert!(said.starts_with("a/slurm.toml: "), "{said}");
            assert!(words.iter().all(|word| said.contains(word)), "{text}: {said}");
        }
    }

    #[test]
    fn a_missing_file_is_named() {
        let said = SlurmProfile::read(Path::new("/nowhere/p.toml")).unwrap_err().to_string();
        assert!(said.starts_with("/nowhere/p.toml: "), "{said}");
    }

    #[test]
    fn times_as_slurm_writes_them() {
        let known = [
            ("90", 5400),
            ("1:30", 90),
            ("02:00:00", 7200),
            ("1-0", 86400),
            ("1-02", 93600),
            ("1-02:03", 93780),
            ("2-00:00:01", 172_801),
        ];
        for (text, expected) in known {
            assert_eq!(seconds(text), Some(expected), "{text}");
        }
        for bad in
            ["", "-", "1-", "-1", "1:", ":1", "1:2:3:4", "1-2:3:4:5", "1d", "INVALID", "9999999999", "1 :2", "+1"]
        {
            assert_eq!(seconds(bad), None, "{bad}");
        }
    }

    proptest! {
        #[test]
        fn any_text_is_a_profile_or_an_error(text in "\\PC{0,40}", key in "time|memory|gpus|qos|extra|command") {
            let _ = parse(&text);
            let _ = parse(&format!("{key} = {text:?}"));
            let _ = seconds(&text);
        }
    }
}
