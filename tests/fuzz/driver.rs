//! Runs the cases of a reader on a separate thread, watches it, and reports failures.

use crate::counting::{Slot, watch};
use crate::mutate::damaged;
use std::cell::RefCell;
use std::collections::BTreeMap;
use std::fmt::Display;
use std::ops::Range;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicI64, AtomicU64, Ordering::Relaxed};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::sync::{Mutex, Once, OnceLock, PoisonError};
use std::time::{Duration, Instant};
use tempfile::TempDir;
use volseggs::rng::{Purpose, Rng};

/// A case that works longer than this, three times in a row, is a failure.
const SLOW: Duration = Duration::from_secs(2);
/// A case that takes longer than this is abandoned.
const HUNG: Duration = Duration::from_secs(20);
/// A thread that would hold more bytes than this is stopped.
const CAP: i64 = 1 << 30;
/// A reader with this many different failures is abandoned.
const MAX_FAILURES: usize = 8;
/// A reader that has left this many threads behind is abandoned.
const MAX_LOST: usize = 8;
/// Stack size, that of the program's main thread.
const STACK: usize = 8 << 20;
const MIB: i64 = 1 << 20;

/// Reads a case; returns whether it was accepted.
type Read = Box<dyn FnMut(&[u8]) -> bool>;

/// A reader, and how to damage what it reads.
pub struct Target {
    corpus: Vec<Vec<u8>>,
    tokens: &'static [&'static str],
    assemble: fn(Vec<u8>) -> Vec<u8>,
    longest: usize,
    limit: i64,
    read: Read,
}

impl Target {
    /// Creates a target from a reader, which returns whether it accepted a file, after using it. Cases have at most 16
    /// KiB, and may take 64 MiB.
    pub fn new(corpus: Vec<Vec<u8>>, read: impl FnMut(&[u8]) -> bool + 'static) -> Self {
        let read = Box::new(read);
        Self { corpus, tokens: &[], assemble: |bytes| bytes, longest: 16 << 10, limit: 64 * MIB, read }
    }

    /// Sets pieces of text that have a meaning in the format.
    pub fn tokens(self, tokens: &'static [&'static str]) -> Self {
        Self { tokens, ..self }
    }

    /// Sets the function that makes a file of the damaged bytes, such as one that corrects a checksum.
    pub fn assemble(self, assemble: fn(Vec<u8>) -> Vec<u8>) -> Self {
        Self { assemble, ..self }
    }

    /// Sets the maximum number of bytes of a case, and the memory in MiB that it may take.
    pub fn sizes(self, longest: usize, limit: i64) -> Self {
        Self { longest, limit: limit * MIB, ..self }
    }
}

/// A folder for the files of a reader.
#[derive(Clone)]
pub struct Scratch(PathBuf);

impl Scratch {
    /// Returns the path of a file in it.
    pub fn path(&self, name: &str) -> PathBuf {
        self.0.join(name)
    }

    /// Writes a file, creating its folder.
    pub fn write(&self, name: &str, bytes: &[u8]) -> PathBuf {
        let path = self.path(name);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(&path, bytes).unwrap();
        path
    }

    /// Writes the file of a case.
    pub fn overwrite(&self, path: &Path, bytes: &[u8]) {
        std::fs::write(path, bytes).unwrap();
    }

    /// Returns the folder itself.
    pub fn root(&self) -> &Path {
        &self.0
    }
}

/// Returns what was read, if anything; otherwise formats the error message, which must not fail either.
pub fn accepted<T, E: Display>(result: Result<T, E>) -> Option<T> {
    result.map_err(|e| std::hint::black_box(e.to_string().len())).ok()
}

/// Number, duration and selection of the cases.
struct Settings {
    cases: u64,
    time: Duration,
    seed: u64,
    only: Option<u64>,
    reader: String,
}

/// Returns the settings from the environment.
fn settings() -> &'static Settings {
    static SETTINGS: OnceLock<Settings> = OnceLock::new();
    SETTINGS.get_or_init(from_environment)
}

fn from_environment() -> Settings {
    let variable = |name: &str| std::env::var(format!("VOLSEGGS_FUZZ_{name}")).ok();
    let number = |name: &str| variable(name).map(|v| v.parse::<f64>().unwrap());
    Settings {
        cases: number("CASES").unwrap_or(2000.0) as u64,
        time: Duration::from_secs_f64(number("SECONDS").unwrap_or(0.6)),
        seed: number("SEED").unwrap_or(0.0) as u64,
        only: number("CASE").map(|n| n as u64),
        reader: variable("READER").unwrap_or_default(),
    }
}

/// Whether the environment selects the reader of that name.
pub fn chosen(name: &str) -> bool {
    name.contains(&settings().reader)
}

/// State shared by the watcher and one working thread.
#[derive(Default)]
struct Shared {
    slot: Slot,
    /// The current case, and when it began: milliseconds since the start plus 1, or 0 between cases.
    case: AtomicU64,
    began: AtomicU64,
    bytes: Mutex<Vec<u8>>,
    stop: AtomicBool,
    cases: AtomicU64,
    opened: AtomicU64,
    seeds_opened: AtomicU64,
    peak: AtomicI64,
}

struct Failure {
    case: u64,
    /// Two failures of the same kind count as one.
    kind: String,
    what: String,
    bytes: Vec<u8>,
}

/// By kind: count, first case, and its description.
type Failures = BTreeMap<String, (u64, u64, String)>;

enum Event {
    Failed(Failure),
    Done,
}

thread_local! {
    /// Where the last panic of this thread came from; `None` on threads that are not watched.
    static PANIC: RefCell<Option<String>> = const { RefCell::new(None) };
}

/// Records panics of watched threads instead of printing them.
fn note_panics() {
    static ONCE: Once = Once::new();
    ONCE.call_once(|| {
        let before = std::panic::take_hook();
        let loud = settings().only.is_some();
        std::panic::set_hook(Box::new(move |info| {
            let watched = PANIC.with_borrow_mut(|last| {
                let Some(last) = last else { return false };
                let place = info.location().map(ToString::to_string).unwrap_or_default();
                *last = format!("{place}: {}", info.payload_as_str().unwrap_or("panic"));
                true
            });
            if loud || !watched {
                before(info);
            }
        }));
    });
}

/// Damages the files of a reader and reads them. `make` returns the reader, which keeps its files in the folder.
pub fn fuzz(name: &'static str, make: fn(&Scratch) -> Target) {
    let settings = settings();
    if !chosen(name) {
        return;
    }
    note_panics();
    let start = Instant::now();
    let mut failures = Failures::new();
    let (mut folders, mut threads, mut next) = (Vec::new(), Vec::new(), settings.only.unwrap_or(0));
    let until = settings.only.map_or(settings.cases, |n| n + 1);
    while next < until && threads.len() < MAX_LOST && failures.len() < MAX_FAILURES {
        let folder = folder();
        let scratch = Scratch(folder.path().to_owned());
        folders.push(folder);
        // never freed, as a thread that hangs keeps using it
        let shared: &'static Shared = Box::leak(Box::default());
        threads.push(shared);
        let (events, receive) = channel();
        let work = Work { name, cases: next..until, start, time: settings.time, seed: settings.seed, shared, events };
        let builder = std::thread::Builder::new().name(format!("fuzz {name}")).stack_size(STACK);
        let thread = builder.spawn(move || work.run(make(&scratch))).unwrap();
        let mut add = |Failure { case, kind, what, bytes }: Failure| {
            let first = || (0, case, format!("{what}\n    {}", keep(name, case, &bytes)));
            failures.entry(kind).or_insert_with(first).0 += 1;
            shared.stop.store(failures.len() >= MAX_FAILURES, Relaxed);
        };
        match attend(shared, &receive, start, &mut add) {
            Ended::Done => {
                thread.join().unwrap();
                break;
            }
            // the thread is left behind, asleep or working forever
            Ended::Lost(failure) => {
                next = failure.case + 1;
                add(failure);
                shared.stop.store(true, Relaxed);
            }
            Ended::Dead => panic!("{name}: the fuzzer itself failed: {:?}", thread.join().err().map(|e| text(&*e))),
        }
    }
    report(name, &threads, start.elapsed(), &failures);
}

fn folder() -> TempDir {
    let memory = Path::new("/dev/shm");
    let made = if memory.is_dir() { TempDir::with_prefix_in("volseggs-fuzz-", memory).ok() } else { None };
    made.unwrap_or_else(|| TempDir::with_prefix("volseggs-fuzz-").unwrap())
}

fn text(payload: &(dyn std::any::Any + Send)) -> String {
    let text = payload.downcast_ref::<String>().cloned();
    text.or_else(|| payload.downcast_ref::<&str>().map(|t| (*t).to_owned())).unwrap_or_default()
}

/// Writes a case to a file that is kept, and returns its size, its path and its first bytes.
fn keep(name: &str, case: u64, bytes: &[u8]) -> String {
    let path = std::env::temp_dir().join("volseggs-fuzz").join(format!("{name}-{case}.bin"));
    let _ = std::fs::create_dir_all(path.parent().unwrap());
    let written = std::fs::write(&path, bytes).map_or_else(|e| e.to_string(), |()| path.display().to_string());
    let hex: String = bytes.iter().take(64).map(|b| format!("{b:02x}")).collect();
    format!("{} bytes in {written}, {hex}{}", bytes.len(), if bytes.len() > 64 { "..." } else { "" })
}

enum Ended {
    Done,
    Lost(Failure),
    Dead,
}

/// Waits for the working thread, collects its failures, and detects when it hangs or sleeps over its memory cap.
fn attend(shared: &Shared, events: &Receiver<Event>, start: Instant, add: &mut impl FnMut(Failure)) -> Ended {
    loop {
        match events.recv_timeout(Duration::from_millis(50)) {
            Ok(Event::Failed(failure)) => add(failure),
            Ok(Event::Done) => return Ended::Done,
            Err(RecvTimeoutError::Disconnected) => return Ended::Dead,
            Err(RecvTimeoutError::Timeout) => {
                let (case, began) = (shared.case.load(Relaxed), shared.began.load(Relaxed));
                let lost = |kind: &str, what: String| {
                    let bytes = shared.bytes.lock().unwrap_or_else(PoisonError::into_inner).clone();
                    Ended::Lost(Failure { case, kind: kind.to_owned(), what, bytes })
                };
                let refused = shared.slot.refused();
                if refused > 0 {
                    return lost("memory", format!("asks for {refused} more bytes; the limit is {CAP} in all"));
                }
                let now = start.elapsed().as_millis() as u64;
                if began > 0 && now.saturating_sub(began) > HUNG.as_millis() as u64 {
                    return lost("hang", format!("does not end within {HUNG:?}"));
                }
            }
        }
    }
}

/// What a working thread needs.
struct Work {
    name: &'static str,
    cases: Range<u64>,
    start: Instant,
    time: Duration,
    seed: u64,
    shared: &'static Shared,
    events: Sender<Event>,
}

impl Work {
    /// Runs the cases in order until they or the time run out. The first ones are the valid files, unchanged.
    fn run(self, mut target: Target) {
        // rayon's tasks then run on this thread too, where they are counted
        let pool = rayon::ThreadPoolBuilder::new().num_threads(1).use_current_thread().build().unwrap();
        let shared = self.shared;
        let purpose = self
            .name
            .bytes()
            .fold(0xcbf2_9ce4_8422_2325, |h: u64, b| (h ^ u64::from(b)).wrapping_mul(0x0100_0000_01b3));
        PANIC.set(Some(String::new()));
        watch(&shared.slot, CAP);
        for case in self.cases.clone() {
            if shared.stop.load(Relaxed) || (self.start.elapsed() >= self.time && case >= target.corpus.len() as u64) {
                break;
            }
            let whole = target.corpus.get(case as usize).cloned();
            let damage = || {
                damaged(
                    &mut Rng::new(self.seed, case, Purpose::Custom(purpose)),
                    &target.corpus,
                    target.tokens,
                    target.longest,
                )
            };
            let bytes = (target.assemble)(whole.clone().unwrap_or_else(damage));
            shared.bytes.lock().unwrap_or_else(PoisonError::into_inner).clone_from(&bytes);
            shared.case.store(case, Relaxed);
            let failed = |kind: &str, what: String| {
                let failure = Failure { case, kind: kind.to_owned(), what, bytes: bytes.clone() };
                let _ = self.events.send(Event::Failed(failure));
            };
            let (mut took, mut outcome) = self.once(&mut target, &bytes);
            for _ in 0..2 {
                // work done for the first time takes longer
                if took > SLOW {
                    (took, outcome) = self.once(&mut target, &bytes);
                }
            }
            let peak = shared.slot.peak();
            shared.peak.fetch_max(peak, Relaxed);
            shared.cases.fetch_add(1, Relaxed);
            match outcome {
                Ok(opened) => {
                    shared.opened.fetch_add(u64::from(opened), Relaxed);
                    shared.seeds_opened.fetch_add(u64::from(opened && whole.is_some()), Relaxed);
                }
                Err(panic) => failed(&panic.chars().take(80).collect::<String>(), format!("panics at {panic}")),
            }
            if took > SLOW {
                failed("slow", format!("takes {:.1} s", took.as_secs_f64()));
            }
            if peak > target.limit {
                failed("peak", format!("holds {} MiB, at most {} are allowed", peak / MIB, target.limit / MIB));
            }
        }
        drop(pool);
        let _ = self.events.send(Event::Done);
    }

    /// Returns how long the case took, and whether it was opened or where it panicked.
    fn once(&self, target: &mut Target, bytes: &[u8]) -> (Duration, Result<bool, String>) {
        let shared = self.shared;
        shared.slot.reset();
        let start = worked();
        shared.began.store(self.start.elapsed().as_millis() as u64 + 1, Relaxed);
        let opened = catch_unwind(AssertUnwindSafe(|| (target.read)(bytes)));
        shared.began.store(0, Relaxed);
        let place = |_| PANIC.replace(Some(String::new())).unwrap_or_default();
        (worked().saturating_sub(start), opened.map_err(place))
    }
}

/// Returns the processor time of this thread, which a busy machine hardly affects. A sleeping thread is found by the
/// clock, see [`HUNG`].
#[cfg(any(target_os = "linux", target_os = "macos"))]
fn worked() -> Duration {
    let now = rustix::time::clock_gettime(rustix::time::ClockId::ThreadCPUTime);
    Duration::new(now.tv_sec as u64, now.tv_nsec as u32)
}

/// Returns the wall-clock time, where a thread's own time is not available.
#[cfg(not(any(target_os = "linux", target_os = "macos")))]
fn worked() -> Duration {
    static BEGAN: OnceLock<Instant> = OnceLock::new();
    BEGAN.get_or_init(Instant::now).elapsed()
}

/// Prints the reader's row of the table, and fails if a case failed or none of its valid files was opened.
fn report(name: &str, threads: &[&Shared], took: Duration, failures: &Failures) {
    static HEAD: Once = Once::new();
    HEAD.call_once(|| {
        let [a, b, c, d, e, f] = ["reader", "cases", "opened", "seconds", "peak bytes", "failures"];
        println!("{a:<20} {b:>9} {c:>9} {d:>8} {e:>12} {f:>8}");
    });
    let sum = |count: fn(&Shared) -> &AtomicU64| threads.iter().map(|t| count(t).load(Relaxed)).sum::<u64>();
    let (cases, opened) = (sum(|t| &t.cases), sum(|t| &t.opened));
    let peak = threads.iter().map(|t| t.peak.load(Relaxed)).max().unwrap_or(0);
    println!("{name:<20} {cases:>9} {opened:>9} {:>8.1} {peak:>12} {:>8}", took.as_secs_f64(), failures.len());
    let list: Vec<String> =
        failures.values().map(|(times, case, what)| format!("  case {case} ({times} times): {what}")).collect();
    let Settings { seed, only, .. } = settings();
    let again = format!("VOLSEGGS_FUZZ_READER={name} VOLSEGGS_FUZZ_SEED={seed} VOLSEGGS_FUZZ_CASE=N");
    assert!(list.is_empty(), "{name}: repeat one case with {again}\n{}", list.join("\n"));
    assert!(only.is_some() || sum(|t| &t.seeds_opened) > 0, "{name}: none of its valid files is opened");
}
