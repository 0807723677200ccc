use std::collections::BTreeMap;
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
        assert_eq!(crc(&rest[8..12]), masked(&rest[..8]));
        let payload = &rest[12..12 + length];
        assert_eq!(crc(&rest[12 + length..16 + length]), masked(payload));
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

/// Output and errors of `script` in a Python with TensorBoard; `None` without the package, so that the test is skipped.
fn ask_tensorboard(script: &str, dir: &Path) -> Option<(String, String)> {
    let python = volseggs_testing::python_with("tensorboard", volseggs_testing::Need::Tensorboard)?;
    let output = Command::new(&python).arg("-c").arg(script).arg(dir).output().unwrap();
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    Some((text(&output.stdout), text(&output.stderr)))
}

#[test]
fn tensorboard_itself_reads_the_files() {
    let dir = tempfile::tempdir().unwrap();
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
    let Some((text, errors)) = ask_tensorboard(CHECK, dir.path()) else { return };
    assert!(text.contains("[(0, 0.0), (1, 0.5), (2, 1.0), (3, 8.0)]\n5 3 2 PNG"), "{text}\n{errors}");
}

/// Settings as a run has them, with a number that JSON cannot hold and a letter that is not ASCII.
fn settings(rate: f64) -> BTreeMap<String, HyperParameter> {
    [
        ("loss.rate", HyperParameter::Number(rate)),
        ("broken", HyperParameter::Number(f64::NAN)),
        ("encoder", HyperParameter::Text("hexplane \u{3b1}".to_owned())),
        ("late", HyperParameter::Flag(rate < 0.1)),
    ]
    .map(|(name, value)| (name.to_owned(), value))
    .into()
}

fn session(dir: &Path, rate: f64, group: &str, psnr: f32, end: Option<SessionEnd>) {
    let metrics = [("eval/psnr", "PSNR, dB"), ("eval/ssim", "SSIM")];
    let mut writer = EventWriter::create(dir).unwrap();
    writer.hparams(&settings(rate), &metrics, group).unwrap();
    writer.scalar(10, "eval/psnr", psnr).unwrap();
    writer.flush().unwrap();
    if let Some(end) = end {
        // a run that was stopped and resumed writes its settings again
        let mut resumed = EventWriter::resume(dir, 20).unwrap();
        resumed.hparams(&settings(rate), &metrics, group).unwrap();
        resumed.scalar(20, "eval/psnr", psnr + 1.0).unwrap();
        resumed.session_end(end).unwrap();
        resumed.flush().unwrap();
    }
}

#[test]
fn hyperparameters_decode_to_what_was_written() {
    let dir = tempfile::tempdir().unwrap();
    let mut writer = EventWriter::create(dir.path()).unwrap();
    writer.hparams(&settings(0.25), &[("psnr", "PSNR")], "base").unwrap();
    writer.hparams(&BTreeMap::new(), &[], "").unwrap();
    writer.flush().unwrap();
    let records = records(&only_file(dir.path()));
    assert_eq!(records.len(), 5);
    let entry = |record: &[u8]| get(&get(record, field::SUMMARY), field::VALUE);
    assert_eq!(get(&entry(&records[1]), field::TAG), b"_hparams_/experiment");
    let start = entry(&records[2]);
    assert_eq!(get(&start, field::TAG), b"_hparams_/session_start_info");
    // The empty tensor, byte by byte as TensorBoard writes it.
    assert_eq!(get(&start, 8), [8, 1, 18, 2, 18, 0]);
    let plugin = get(&get(&start, 9), 1);
    assert_eq!(get(&plugin, 1), b"hparams");
    let session = get(&get(&plugin, 2), 3);
    let entries = fields(&session).into_iter().filter(|(field, _)| *field == 1);
    let values: Vec<_> = entries.map(|(_, entry)| (get(&entry, 1), fields(&get(&entry, 2)))).collect();
    let expected = [
        (b"broken".to_vec(), vec![(3, b"NaN".to_vec())]),
        (b"encoder".to_vec(), vec![(3, "hexplane \u{3b1}".as_bytes().to_vec())]),
        (b"late".to_vec(), vec![(4, 0u64.to_le_bytes().to_vec())]),
        (b"loss.rate".to_vec(), vec![(2, 0.25f64.to_le_bytes().to_vec())]),
    ];
    assert_eq!(values, expected);
    assert_eq!(get(&session, 4), b"base");
}

const CHECK_HPARAMS: &str = r#"
import json, sys
from google.protobuf import json_format
from tensorboard import context
from tensorboard.backend.event_processing import data_provider, plugin_event_multiplexer
from tensorboard.plugins import base_plugin
from tensorboard.plugins.hparams import api_pb2, backend_context, list_session_groups
m = plugin_event_multiplexer.EventMultiplexer()
m.AddRunsFromDirectory(sys.argv[1])
m.Reload()
tb = base_plugin.TBContext(data_provider=data_provider.MultiplexerDataProvider(m, sys.argv[1]))
hp, ctx = backend_context.Context(tb), context.RequestContext()
found = hp.hparams_metadata(ctx, "e")
e = hp.experiment_from_metadata(ctx, "e", True, found, hp.hparams_from_data_provider(ctx, "e", None))
print(sorted((i.name, i.type, i.differs) for i in e.hparam_infos))
print([(i.name.tag, i.display_name) for i in e.metric_infos])
r = api_pb2.ListSessionGroupsRequest(
    experiment_name="e", allowed_statuses=[0, 1, 2, 3], start_index=0, slice_size=10, include_metrics=True,
    aggregation_type=api_pb2.AGGREGATION_AVG,
    col_params=[api_pb2.ColParams(hparam=i.name, include_in_result=True) for i in e.hparam_infos]
    + [api_pb2.ColParams(metric=i.name) for i in e.metric_infos])
groups = list_session_groups.Handler(ctx, hp, "e", r).run().session_groups
for g in sorted(groups, key=lambda g: g.name):
    print(g.name, json.dumps({k: json_format.MessageToDict(v) for k, v in sorted(g.hparams.items())}))
    for s in sorted(g.sessions, key=lambda s: s.name):
        print(" ", s.name, s.status, [(v.name.tag, v.value, v.training_step) for v in s.metric_values])
"#;

#[test]
fn tensorboard_itself_shows_sessions_with_settings_and_metrics() {
    let dir = tempfile::tempdir().unwrap();
    session(&dir.path().join("a"), 0.01, "slow", 30.0, Some(SessionEnd::Success));
    session(&dir.path().join("b"), 0.5, "fast", 20.0, Some(SessionEnd::Failure));
    session(&dir.path().join("c"), 0.5, "fast", 22.0, None);
    let Some((text, errors)) = ask_tensorboard(CHECK_HPARAMS, dir.path()) else { return };
    let expected = [
        "[('broken', 1, True), ('encoder', 1, True), ('late', 2, True), ('loss.rate', 3, True)]",
        "[('eval/psnr', 'PSNR, dB'), ('eval/ssim', 'SSIM')]",
        r#"fast {"broken": "NaN", "encoder": "hexplane \u03b1", "late": false, "loss.rate": 0.5}"#,
        "  b 2 [('eval/psnr', 21.0, 20)]",
        "  c 0 [('eval/psnr', 22.0, 10)]",
        r#"slow {"broken": "NaN", "encoder": "hexplane \u03b1", "late": true, "loss.rate": 0.01}"#,
        "  a 1 [('eval/psnr', 31.0, 20)]",
    ];
    assert_eq!(text.lines().collect::<Vec<_>>(), expected, "{errors}");
}

#[test]
fn checksums_agree_with_the_published_check_values() {
    // RFC 3720, appendix B.4, and the usual check string.
    assert_eq!(crc32c::crc32c(b"123456789"), 0xe306_9283);
    assert_eq!(crc32c::crc32c(&[0; 32]), 0x8a91_36aa);
    assert_eq!(crc32c::crc32c(&[0xff; 32]), 0x62a8_ab43);
    assert_eq!(crc32c::crc32c(b""), 0);
}
