use super::*;
use burn::tensor::f16;
use proptest::prelude::*;

const ZIP: &[u8] = include_bytes!("../../../tests/data/state_dict/zip.pth");
const LEGACY: &[u8] = include_bytes!("../../../tests/data/state_dict/legacy.pth");
const MODULE: &[u8] = include_bytes!("../../../tests/data/state_dict/module.pth");
const TRANSPOSED: &[u8] = include_bytes!("../../../tests/data/state_dict/transposed.pth");

/// Names and shapes of the tensors in both files.
const SHAPES: [(&str, &[usize]); 9] = [
    ("features.0.weight", &[2, 3, 2, 2]),
    ("features.0.bias", &[2]),
    ("lin0.model.1.weight", &[1, 3, 1, 1]),
    ("half", &[5]),
    ("parameter", &[2, 2]),
    ("first", &[4]),
    ("second", &[2, 3]),
    ("scalar", &[]),
    ("empty", &[0, 3]),
];

fn open(bytes: &[u8]) -> Result<StateDict> {
    let file = tempfile::NamedTempFile::new().unwrap();
    std::fs::write(file.path(), bytes).unwrap();
    // values are read from the file although its name is gone
    StateDict::open(file.path())
}

fn refusal(bytes: &[u8]) -> String {
    open(bytes).unwrap_err().to_string()
}

/// A pickle of the given instructions in the legacy container.
fn legacy(pickle: &[u8]) -> Vec<u8> {
    let system = b"\x80\x02}U\x0dlittle_endian\x88s.";
    [super::LEGACY, b"\x80\x02M\xe9\x03.", system, b"\x80\x02", pickle, b".\x80\x02]."].concat()
}

/// Names and shapes of the tensors in a file.
fn tensors(file: &StateDict) -> Vec<(String, Vec<usize>)> {
    match file {
        StateDict::Torch(file) => file.tensors().iter().map(|(k, t)| (k.clone(), t.shape().to_vec())).collect(),
        StateDict::Safetensors(header, _) => header.tensors().into_iter().map(|(k, t)| (k, t.shape.clone())).collect(),
    }
}

/// Reads everything that can be read from a file.
fn read_all(bytes: &[u8]) -> Result<usize> {
    let file = open(bytes)?;
    let mut values = 0;
    for (key, shape) in tensors(&file) {
        let count = file.values(&key, &shape)?.len();
        assert_eq!(count, shape.iter().product::<usize>());
        values += count;
    }
    Ok(values)
}

#[test]
fn both_containers_of_pytorch_give_the_same_tensors() {
    for bytes in [ZIP, LEGACY] {
        let file = open(bytes).unwrap();
        assert_eq!(tensors(&file).len(), SHAPES.len());
        let starts = [0.0, 50.0, 60.0, 70.0, 80.0, 100.0, 104.0, 12.0, 0.0];
        for ((key, shape), start) in SHAPES.into_iter().zip(starts) {
            assert_eq!(file.shape(key), Some(shape), "{key}");
            let count: usize = shape.iter().product();
            let expected: Vec<f32> = (0..count).map(|i| (start + i as f32) / 8.0).collect();
            assert_eq!(file.values(key, shape).unwrap(), expected, "{key}");
        }
        assert_eq!(file.shape("no"), None);
        assert!(matches!(file.values("no", &[1]), Err(StateDictError::Missing(key)) if key == "no"));
        let error = file.values("half", &[6]).unwrap_err().to_string();
        assert_eq!(error, "`half` has shape [5], expected [6]");
    }
}

/// The files of 2017 name a function with four arguments and may place a tensor in a view of a storage.
#[test]
fn the_first_files_of_pytorch_are_read() {
    let part = b"(U\x07storagectorch\nHalfStorage\nU\x01kU\x03cpuK\x04U\x01vK\x01K\x03\x87tQ";
    let call = [b"}U\x01xctorch._utils\n_rebuild_tensor\n(", &part[..], b"K\x01K\x02\x85K\x01\x85tRs."].concat();
    let system = b"\x80\x02}U\x0dlittle_endian\x88s.";
    let start = [super::LEGACY, b"\x80\x02M\xe9\x03.", system, b"\x80\x02", &call, b"\x80\x02]U\x01ka."].concat();
    let values: Vec<u8> = [0.5, 1.5, 2.5, 3.5].iter().flat_map(|v| f16::from_f32(*v).to_le_bytes()).collect();
    let bytes = [&start[..], &4u64.to_le_bytes(), &values].concat();
    assert_eq!(open(&bytes).unwrap().values("x", &[2]).unwrap(), [2.5, 3.5]);
    // a view that ends beyond the storage
    let mut beyond = bytes.clone();
    let at = beyond.windows(4).position(|w| w == b"K\x01K\x03").unwrap();
    beyond[at + 3] = 4;
    assert_eq!(
        refusal(&beyond),
        "damaged: storage 'k' has a view of 4 elements at offset 1, past its 4 elements; download it again"
    );
    let wrong = [&start[..], &5u64.to_le_bytes(), &values].concat();
    let error = open(&wrong).unwrap().values("x", &[2]).unwrap_err().to_string();
    assert!(error.starts_with("damaged: ") && error.contains("storage 'k' holds 5 elements"), "{error}");
}

#[test]
fn safetensors_give_the_same() {
    let values: Vec<u8> = [1.0f32, -2.0, 0.5].iter().flat_map(|v| v.to_le_bytes()).collect();
    let single = safetensors::tensor::TensorView::new(Dtype::F32, vec![3], &values).unwrap();
    let other = safetensors::tensor::TensorView::new(Dtype::I32, vec![3], &values).unwrap();
    let bytes = safetensors::serialize([("a", single), ("b", other)], None).unwrap();
    let file = open(&bytes).unwrap();
    assert_eq!(file.values("a", &[3]).unwrap(), [1.0, -2.0, 0.5]);
    let error = file.values("b", &[3]).unwrap_err().to_string();
    assert_eq!(error, "not a state dict of weights: `b` holds I32 values, not F32 or F16");
    for length in 8..bytes.len() {
        assert!(open(&bytes[..length]).is_err(), "{length}");
    }
}

#[test]
fn files_without_weights_are_refused() {
    for other in [&b""[..], b"<!DOCTYPE html>", b"PK", b"\x80\x02}."] {
        assert!(refusal(other).starts_with("neither a PyTorch file"), "{other:?}");
    }
    let tar = [&[b'x'; 257][..], b"ustar\x0000", &[0; 248]].concat();
    assert!(refusal(&tar).contains("use the file published now"), "{}", refusal(&tar));
    // a function is never called: its name stands for what it would return
    let error = refusal(&legacy(b"cos\nsystem\nU\x02ls\x85R"));
    assert!(error.contains("found os.system"), "{error}");
    let error = refusal(&legacy(b"\xff"));
    assert!(error.starts_with("damaged: invalid pickle opcode: 0xff"), "{error}");
    assert!(tensors(&open(&legacy(b"}")).unwrap()).is_empty());
    let folder = tempfile::tempdir().unwrap();
    assert!(StateDict::open(folder.path()).unwrap_err().to_string().contains("not a regular file"));
    assert!(matches!(StateDict::open(&folder.path().join("no")), Err(StateDictError::Io(_))));
}

/// A whole module, which `torch.save(model)` writes, is read as its state dict.
#[test]
fn a_module_is_read_as_its_state_dict() {
    let file = open(MODULE).unwrap();
    assert_eq!(tensors(&file).len(), 2);
    let weight = file.values("weight", &[1, 2]).unwrap();
    assert!((weight[0] + 0.476_744).abs() < 1e-6 && (weight[1] + 0.027_940).abs() < 1e-6, "{weight:?}");
    assert!((file.values("bias", &[1]).unwrap()[0] + 0.664_564).abs() < 1e-6);
}

#[test]
fn a_transposed_tensor_is_read_in_row_major_order() {
    let file = open(TRANSPOSED).unwrap();
    assert_eq!(file.values("features.0.weight", &[3, 2]).unwrap(), [0.0, 0.375, 0.125, 0.5, 0.25, 0.625]);
}

#[test]
fn other_types_are_refused_when_read() {
    let part = b"(U\x07storagectorch\nLongStorage\nU\x01kU\x03cpuK\x01tQ";
    let call = [b"}U\x01xctorch._utils\n_rebuild_tensor\n(", &part[..], b"K\x00K\x01\x85K\x01\x85tRs"].concat();
    let error = open(&legacy(&call)).unwrap().values("x", &[1]).unwrap_err().to_string();
    assert_eq!(error, "not a state dict of weights: `x` holds I64 values, not F32 or F16");
}

#[test]
fn descriptions_that_ask_for_too_much_are_refused() {
    let deep =
        |levels| [b"}U\x01x".to_vec(), b"]".repeat(levels), b"a".repeat(levels - 1), b"q\x00h\x00".to_vec()].concat();
    let error = refusal(&legacy(&deep(100_000)));
    assert!(error.contains("nesting exceeds 1000 levels"), "{error}");
    // the deepest that is allowed is copied and freed on the stack of a thread
    assert!(open(&legacy(&[&deep(1000)[..], b"0s"].concat())).is_ok());
    // a long list that is copied repeatedly
    let mut bomb = b"ccollections\nOrderedDict\nq\x00](".to_vec();
    bomb.extend(b"K\x01N\x86".repeat(10_000));
    bomb.extend(b"e\x85q\x01");
    bomb.extend(b"h\x00h\x01R".repeat(10_000));
    assert!(refusal(&legacy(&bomb)).contains("memo bomb"));
    // more values than the file holds: 2^40 of them, and more than 2^64 bytes
    for count in [&b"\x8a\x06\x00\x00\x00\x00\x00\x01"[..], b"\x8a\x08\xff\xff\xff\xff\xff\xff\xff\x7f"] {
        let storage = [&b"(U\x07storagectorch\nFloatStorage\nU\x01kU\x03cpu"[..], count, b"tQ"].concat();
        let call = [b"}U\x01xctorch._utils\n_rebuild_tensor_v2\n(", &storage[..], b"K\x00", count, b"\x85K\x01\x85tRs"];
        let error = refusal(&legacy(&call.concat()));
        assert!(error.starts_with("damaged: "), "{error}");
    }
}

#[test]
fn an_empty_tensor_may_have_giant_sides() {
    let giant = b"\x8a\x06\x00\x00\x00\x00\x00\x01";
    let storage = b"(U\x07storagectorch\nFloatStorage\nU\x01kU\x03cpuK\x00tQ";
    let shape = [b"(K\x00", &giant[..], giant, giant, b"t"].concat();
    let call = [b"}U\x01xctorch._utils\n_rebuild_tensor\n(", &storage[..], b"K\x00", &shape, &shape, b"tRs"].concat();
    let bytes = legacy(&call);
    let sides = [0, 1 << 40, 1 << 40, 1 << 40];
    let listed = [&bytes[..bytes.len() - 2], b"]U\x01ka.", &0u64.to_le_bytes()].concat();
    assert!(open(&listed).unwrap().values("x", &sides).unwrap().is_empty());
    // its storage is not in the list
    assert!(matches!(open(&bytes).unwrap().values("x", &sides), Err(StateDictError::Damaged(_))));
}

#[test]
fn every_truncation_is_detected() {
    for (bytes, name) in [(ZIP, "zip"), (LEGACY, "legacy")] {
        for length in 0..bytes.len() {
            // the last storage of the legacy file might have bytes that no tensor uses, but here it does not
            assert!(read_all(&bytes[..length]).is_err(), "{name} cut at {length}");
        }
        assert_eq!(read_all(bytes).unwrap(), 24 + 2 + 3 + 5 + 4 + 4 + 6 + 1);
    }
}

#[test]
fn every_changed_value_of_a_zip_is_detected() {
    let values: Vec<u8> = (0..24).flat_map(|i| (i as f32 / 8.0).to_le_bytes()).collect();
    let start = ZIP.windows(values.len()).position(|w| w == values).unwrap();
    for at in start..start + values.len() {
        let mut bytes = ZIP.to_vec();
        bytes[at] ^= 1;
        let error = open(&bytes).unwrap().values("features.0.weight", &[2, 3, 2, 2]).unwrap_err().to_string();
        assert!(
            error.starts_with("damaged: tensor 'features.0.weight'") && error.contains("Invalid checksum"),
            "{error}"
        );
    }
}

proptest! {
    /// Damage gives an error or tensors of their shape, and never a panic.
    #[test]
    fn damage_never_panics(
        zip: bool,
        flips in proptest::collection::vec((any::<prop::sample::Index>(), 1..=u8::MAX), 1..6),
        cut in proptest::option::weighted(0.3, any::<prop::sample::Index>()),
    ) {
        let mut bytes = if zip { ZIP } else { LEGACY }.to_vec();
        for (at, flip) in flips {
            let at = at.index(bytes.len());
            bytes[at] ^= flip;
        }
        if let Some(cut) = cut {
            bytes.truncate(cut.index(bytes.len()));
        }
        let _ = read_all(&bytes);
    }

    #[test]
    fn no_pickle_panics(instructions in proptest::collection::vec(
        prop::sample::select(b"\x80.(N\x88\x89JKMUTXc)]}t\x85\x86\x87aesuqrhjQRb\x00\x01\x02\n".as_slice()), 0..200
    )) {
        let _ = read_all(&legacy(&instructions));
    }
}
