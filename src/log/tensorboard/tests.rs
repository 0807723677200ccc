use std::path::PathBuf;
use std::process::Command;

use super::*;

/// The payloads of a file, after checking both checksums of each record.
fn records(path: &Path) -> Vec<Vec<u8>> {
    let data = fs::read(path).unwrap();
    let (mut rest, mut out) = (data.as_slice(), Vec::new());
    let crc = |bytes: &[u8]| u32::from_le_bytes(bytes.try_into().unwrap());
    while !rest.is_empty() {
        let length = u64::from_le_bytes(rest[..8].try_into().unwrap()) as usize;
        assert_eq!(crc(&rest[8..12]), crc::masked(&rest[..8]));
        let payload = &rest[12..12 + length];
        assert_eq!(crc(&rest[12 + length..16 + length]), crc::masked(payload));
        out.push(payload.to_vec());
        rest = &rest[16 + length..];
    }
    out
}

fn varint(data: &mut &[u8]) -> u64 {
    let (mut value, mut shift) = (0, 0);
    loop {
        let byte = data[0];
        *data = &data[1..];
        value |= u64::from(byte & 0x7f) << shift;
        shift += 7;
        if byte < 0x80 {
            return value;
        }
    }
}

/// (field, value bytes) of a message; a varint is given as 8 little-endian bytes.
fn fields(mut data: &[u8]) -> Vec<(u32, Vec<u8>)> {
    let mut out = Vec::new();
    while !data.is_empty() {
        let key = varint(&mut data);
        let length = match key & 7 {
            0 => {
                let value = varint(&mut data).to_le_bytes().to_vec();
                out.push(((key >> 3) as u32, value));
                continue;
            }
            1 => 8,
            2 => varint(&mut data) as usize,
            5 => 4,
            wire => panic!("wire type {wire}"),
        };
        out.push(((key >> 3) as u32, data[..length].to_vec()));
        data = &data[length..];
    }
    out
}

fn get(message: &[u8], field: u32) -> Vec<u8> {
    let found = fields(message).into_iter().find(|(f, _)| *f == field);
    found.expect("field").1
}

fn only_file(dir: &Path) -> PathBuf {
    let mut entries = fs::read_dir(dir).unwrap();
    let path = entries.next().unwrap().unwrap().path();
    assert!(entries.next().is_none());
    path
}

const RGB: [u8; 18] = [255, 0, 0, 0, 255, 0, 0, 0, 255, 9, 8, 7, 6, 5, 4, 3, 2, 1];

#[test]
fn the_records_decode_to_what_was_written() {
    let dir = tempfile::tempdir().unwrap();
    let mut writer = EventWriter::create(&dir.path().join("run")).unwrap();
    writer.scalar(300, "loss/total", 0.25).unwrap();
    writer.image(1 << 40, "view", 3, 2, &RGB).unwrap();
    assert!(writer.image(1, "short", 3, 3, &RGB).is_err());
    assert!(writer.image(1, "none", 0, 0, &[]).is_err());
    writer.flush().unwrap();
    let records = records(&only_file(&dir.path().join("run")));
    assert_eq!(records.len(), 3);
    assert_eq!(get(&records[0], field::FILE_VERSION), b"brain.Event:2");
    let time = f64::from_le_bytes(get(&records[1], field::WALL_TIME).try_into().unwrap());
    assert!((now() - time).abs() < 60.0);
    assert_eq!(get(&records[1], field::STEP), 300u64.to_le_bytes());
    let entry = |record: &[u8]| get(&get(record, field::SUMMARY), field::VALUE);
    assert_eq!(get(&entry(&records[1]), field::TAG), b"loss/total");
    let value = get(&entry(&records[1]), field::SIMPLE_VALUE);
    assert_eq!(value, 0.25f32.to_le_bytes());
    assert_eq!(get(&records[2], field::STEP), (1u64 << 40).to_le_bytes());
    let picture = get(&entry(&records[2]), field::IMAGE);
    assert_eq!(get(&picture, field::WIDTH), 3u64.to_le_bytes());
    let png = get(&picture, field::ENCODED_IMAGE);
    let decoded = image::load_from_memory(&png).unwrap().to_rgb8();
    assert_eq!(decoded.as_raw().as_slice(), RGB);
}

#[test]
fn two_writers_of_one_folder_do_not_share_a_file() {
    let dir = tempfile::tempdir().unwrap();
    let _first = EventWriter::create(dir.path()).unwrap();
    let _second = EventWriter::resume(dir.path(), 5).unwrap();
    assert_eq!(fs::read_dir(dir.path()).unwrap().count(), 2);
}

const CHECK: &str = r#"
import sys
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator
e = EventAccumulator(sys.argv[1], size_guidance={"scalars": 0, "images": 0})
e.Reload()
print([(s.step, s.value) for s in e.Scalars("a/b")])
i = e.Images("view")[0]
print(i.step, i.width, i.height, i.encoded_image_string[1:4].decode())
"#;

/// Needs the Python package `tensorboard`; `PYTHON` names another interpreter than `python3`.
#[test]
fn tensorboard_itself_reads_the_files() {
    let python = std::env::var("PYTHON").unwrap_or_else(|_| "python3".to_owned());
    let run = |script: &str, dir: &Path| {
        let mut command = Command::new(&python);
        command.arg("-c").arg(script).arg(dir).output()
    };
    let dir = tempfile::tempdir().unwrap();
    let found = run("import tensorboard", dir.path()).is_ok_and(|o| o.status.success());
    if !found {
        println!("skipped: {python} has no package `tensorboard`");
        return;
    }
    let mut writer = EventWriter::create(dir.path()).unwrap();
    for step in 0..5 {
        writer.scalar(step, "a/b", step as f32 * 0.5).unwrap();
    }
    writer.image(4, "view", 3, 2, &RGB).unwrap();
    writer.flush().unwrap();
    let mut resumed = EventWriter::resume(dir.path(), 3).unwrap();
    resumed.scalar(3, "a/b", 8.0).unwrap();
    resumed.image(5, "view", 3, 2, &RGB).unwrap();
    resumed.flush().unwrap();
    let output = run(CHECK, dir.path()).unwrap();
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    let errors = String::from_utf8_lossy(&output.stderr);
    assert!(text.contains("[(0, 0.0), (1, 0.5), (2, 1.0), (3, 8.0)]\n5 3 2 PNG"), "{text}\n{errors}");
}
