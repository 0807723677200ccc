//! A child process of the tests: started without settings from the environment, with chosen streams, and never waited
//! for indefinitely.

use crate::common::BINARY;
use std::fmt;
use std::io::Read;
use std::os::unix::process::ExitStatusExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// No command of these tests takes this long, however busy the machine is: one that does hangs.
const LONGEST: Duration = Duration::from_secs(180);
const PAUSE: Duration = Duration::from_millis(1);
/// Number of bytes from the end of a stream that a message shows.
const SHOWN: usize = 1500;

/// The other end of a standard stream.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stream {
    /// This test, which reads it.
    Kept,
    /// A pipe that has no reader.
    Gone,
    /// `/dev/full`.
    Full,
}

impl Stream {
    fn stdio(self) -> Stdio {
        match self {
            Self::Kept => Stdio::piped(),
            Self::Gone => {
                let (reader, writer) = std::io::pipe().unwrap();
                drop(reader);
                writer.into()
            }
            Self::Full => std::fs::OpenOptions::new().write(true).open("/dev/full").unwrap().into(),
        }
    }
}

/// Splits a command line without quotes into words.
pub fn words(line: &str) -> Vec<String> {
    line.split_whitespace().map(str::to_owned).collect()
}

/// A child that may still be running; killed when dropped.
pub struct Running {
    line: String,
    folder: PathBuf,
    child: Child,
    started: Instant,
    /// Readers of standard output and standard error, if they are kept.
    readers: [Option<JoinHandle<String>>; 2],
}

/// Starts the program in `folder`.
pub fn start(folder: &Path, arguments: &[String]) -> Running {
    start_with(folder, arguments, [Stream::Kept; 2])
}

/// Starts the program with chosen standard output and standard error.
pub fn start_with(folder: &Path, arguments: &[String], streams: [Stream; 2]) -> Running {
    let mut command = Command::new(BINARY);
    command.args(arguments);
    start_command(folder, command, streams)
}

/// Starts another program that calls this one, with chosen streams.
pub fn start_command(folder: &Path, mut command: Command, [out, err]: [Stream; 2]) -> Running {
    for (name, _) in std::env::vars_os() {
        // these set keys of the program's configuration
        if name.to_string_lossy().starts_with("VOLSEGGS_") {
            command.env_remove(name);
        }
    }
    command.current_dir(folder).stdin(Stdio::null()).stdout(out.stdio()).stderr(err.stdio());
    let shown = command.get_args().map(|a| a.to_string_lossy().into_owned()).collect::<Vec<_>>().join(" ");
    let own = Path::new(command.get_program()) == Path::new(BINARY);
    let name = if own { "volseggs".into() } else { command.get_program().to_string_lossy() };
    let line = format!("{name} {shown}");
    let started = Instant::now();
    let mut child = command.spawn().unwrap_or_else(|e| panic!("{line}: {e}"));
    let readers = [reader(child.stdout.take()), reader(child.stderr.take())];
    Running { line, folder: folder.into(), child, started, readers }
}

fn reader(stream: Option<impl Read + Send + 'static>) -> Option<JoinHandle<String>> {
    stream.map(|mut stream| {
        std::thread::spawn(move || {
            let mut bytes = Vec::new();
            let _ = stream.read_to_end(&mut bytes);
            String::from_utf8_lossy(&bytes).into_owned()
        })
    })
}

/// Runs the program to its end.
pub fn run(folder: &Path, arguments: &[String]) -> Ended {
    start(folder, arguments).end()
}

/// Runs a command that must succeed.
pub fn must(folder: &Path, arguments: &[String]) -> Ended {
    let ended = run(folder, arguments);
    assert_eq!(ended.code(), Some(0), "{ended}");
    ended
}

impl Running {
    /// Whether it has ended by itself.
    pub fn has_ended(&mut self) -> bool {
        self.child.try_wait().unwrap().is_some()
    }

    /// Waits for its end; kills one that hangs.
    pub fn end(mut self) -> Ended {
        loop {
            if let Some(status) = self.child.try_wait().unwrap() {
                return self.ended(status, false);
            }
            if self.started.elapsed() > LONGEST {
                let _ = self.child.kill();
                let status = self.child.wait().unwrap();
                return self.ended(status, true);
            }
            std::thread::sleep(PAUSE);
        }
    }

    /// Sends `kill -9`, if it is still running.
    pub fn kill(mut self) -> Ended {
        let _ = self.child.kill();
        let status = self.child.wait().unwrap();
        self.ended(status, false)
    }

    /// Sends a signal by name.
    pub fn signal(&self, name: &str) {
        let sent = Command::new("kill").args(["-s", name, &self.child.id().to_string()]).status().unwrap();
        assert!(sent.success(), "kill -s {name}: {}", self.line);
    }

    /// Waits until `there` holds, as long as the child is running.
    pub fn wait_until(&mut self, what: &str, mut there: impl FnMut() -> bool) {
        let started = Instant::now();
        while !there() {
            let slow = started.elapsed() > Duration::from_secs(90);
            if slow || self.has_ended() {
                let why = if slow { "not reached after 90 s" } else { "the command ended first" };
                let _ = self.child.kill();
                let err = self.readers[1].take().map(|r| r.join().unwrap()).unwrap_or_default();
                panic!("{what}: {why}: `{}` in {}\nstderr: {}", self.line, self.folder.display(), last(&err));
            }
            std::thread::sleep(Duration::from_millis(5));
        }
    }

    /// Returns the time since its start.
    pub fn age(&self) -> Duration {
        self.started.elapsed()
    }

    fn ended(&mut self, status: ExitStatus, hung: bool) -> Ended {
        let seconds = self.started.elapsed().as_secs_f64();
        let [out, err] = [0, 1].map(|i| self.readers[i].take().map(|r| r.join().unwrap()).unwrap_or_default());
        Ended { line: self.line.clone(), folder: self.folder.clone(), status, hung, seconds, out, err }
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// A child that has ended.
pub struct Ended {
    line: String,
    folder: PathBuf,
    status: ExitStatus,
    /// Whether it had to be killed because it took too long.
    hung: bool,
    pub seconds: f64,
    /// Standard output, if it was kept.
    pub out: String,
    /// Standard error, if it was kept.
    pub err: String,
}

impl Ended {
    /// Returns its exit code; `None` if it died of a signal or hung.
    pub fn code(&self) -> Option<i32> {
        self.status.code().filter(|_| !self.hung)
    }

    /// Whether `kill -9` hit it while it was running.
    pub fn was_killed(&self) -> bool {
        !self.hung && self.status.signal() == Some(9)
    }

    /// Returns a fault that no command may have under any circumstances.
    pub fn fault(&self) -> Option<String> {
        let output = format!("{}{}", self.out, self.err);
        if self.hung {
            Some("hangs".into())
        } else if self.code() == Some(101) || output.contains("panicked") {
            Some("panics".into())
        } else {
            self.status.signal().map(|s| format!("died of signal {s}"))
        }
    }
}

impl fmt::Display for Ended {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let hung = if self.hung { ", killed because it hung" } else { "" };
        write!(f, "`{}` in {}: {}{hung} after {:.3} s", self.line, self.folder.display(), self.status, self.seconds)?;
        for (name, text) in [("stdout", &self.out), ("stderr", &self.err)] {
            if !text.trim().is_empty() {
                write!(f, "\n  {name}: {}", last(text))?;
            }
        }
        Ok(())
    }
}

/// Returns the end of a long text.
fn last(text: &str) -> &str {
    let text = text.trim();
    let from = text.len().saturating_sub(SHOWN);
    let from = (from..=text.len()).find(|i| text.is_char_boundary(*i)).unwrap_or(text.len());
    &text[from..]
}
