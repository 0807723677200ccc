use super::atomic::*;
use super::replace::FolderKind;
use std::fs;
use std::io::{self, Write};
use std::path::Path;

const KIND: FolderKind = FolderKind { what: "a test", markers: &["sub/x", "x"], entries: &[] };

fn names(dir: &Path) -> Vec<String> {
    let mut names: Vec<_> = fs::read_dir(dir).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    names
}

#[test]
fn a_file_is_replaced_whole_and_leaves_no_temporary() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.bin");
    write_atomic(&path, b"old").unwrap();
    write_atomic(&path, b"new content").unwrap();
    assert_eq!(fs::read(&path).unwrap(), b"new content");
    assert_eq!(names(dir.path()), ["a.bin"]);
}

#[test]
fn an_uncommitted_writer_changes_nothing() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.bin");
    write_atomic(&path, b"old").unwrap();
    let mut file = AtomicFile::create(&path).unwrap();
    file.write_all(&[7; 1 << 18]).unwrap();
    assert_eq!(names(dir.path()).len(), 2);
    drop(file);
    assert_eq!(fs::read(&path).unwrap(), b"old");
    assert_eq!(names(dir.path()), ["a.bin"]);
}

#[test]
fn a_path_without_a_name_or_folder_is_an_error() {
    let dir = tempfile::tempdir().unwrap();
    assert!(write_atomic(Path::new("/"), b"").is_err());
    assert!(write_atomic(&dir.path().join("none/a"), b"").is_err());
    assert!(names(dir.path()).is_empty());
}

#[test]
fn a_folder_appears_complete_and_is_not_overwritten_unasked() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("step-10");
    let build = |text: &str| {
        let folder = AtomicDir::create(&path).unwrap();
        fs::create_dir(folder.dir().join("sub")).unwrap();
        fs::write(folder.dir().join("sub/x"), text).unwrap();
        folder
    };
    let first = build("one");
    assert!(!path.exists());
    first.commit().unwrap();
    let error = build("two").commit().unwrap_err();
    assert_eq!(error.kind(), io::ErrorKind::AlreadyExists);
    assert_eq!(fs::read_to_string(path.join("sub/x")).unwrap(), "one");
    build("three").commit_replacing(&KIND, &[]).unwrap();
    assert_eq!(fs::read_to_string(path.join("sub/x")).unwrap(), "three");
    drop(build("four"));
    fs::write(path.join("thesis"), "mine").unwrap();
    assert!(build("five").commit_replacing(&KIND, &[]).is_err(), "a foreign file was lost");
    assert_eq!(fs::read_to_string(path.join("sub/x")).unwrap(), "three");
    assert_eq!(names(dir.path()), ["step-10"]);
}

#[test]
#[cfg(any(target_os = "linux", target_os = "macos"))]
fn a_folder_exists_at_every_moment_of_its_replacement() {
    use std::sync::atomic::{AtomicBool, Ordering};
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("track");
    let write = |k: usize| {
        let folder = AtomicDir::create(&path).unwrap();
        fs::write(folder.dir().join("x"), k.to_string()).unwrap();
        folder.commit_replacing(&KIND, &[]).unwrap();
    };
    write(0);
    let done = AtomicBool::new(false);
    std::thread::scope(|scope| {
        let watcher = scope.spawn(|| {
            let mut missing = 0;
            while !done.load(Ordering::Relaxed) {
                missing += usize::from(path.symlink_metadata().is_err());
            }
            missing
        });
        (1..40).for_each(write);
        done.store(true, Ordering::Relaxed);
        assert_eq!(watcher.join().unwrap(), 0);
    });
    assert_eq!(fs::read_to_string(path.join("x")).unwrap(), "39");
    assert_eq!(names(dir.path()), ["track"]);
}

#[test]
fn only_stale_temporaries_are_cleaned() {
    let dir = tempfile::tempdir().unwrap();
    let open = AtomicFile::create(&dir.path().join("a")).unwrap();
    let (own, here, there) = (std::process::id(), host(), host() ^ 1);
    // no process has the largest id; a temporary with our own id that no writer holds is from an earlier run
    let stale = [format!(".tmp-x-{}@{here:08x}-0", u32::MAX), format!(".tmp-y-{own}@{here:08x}-999999")];
    fs::create_dir(dir.path().join(&stale[0])).unwrap();
    fs::write(dir.path().join(&stale[0]).join("f"), "f").unwrap();
    fs::write(dir.path().join(&stale[1]), "").unwrap();
    let elsewhere = format!(".tmp-x-{}@{there:08x}-0", u32::MAX);
    for kept in [".tmp-other", ".tmp-1-2", "x", &elsewhere] {
        fs::write(dir.path().join(kept), "").unwrap();
    }
    let removed = clean_stale(dir.path()).unwrap();
    assert_eq!(removed.len(), 2, "{removed:?}");
    assert_eq!(names(dir.path()).len(), 5);
    drop(open);
    assert_eq!(names(dir.path()).len(), 4);
}
