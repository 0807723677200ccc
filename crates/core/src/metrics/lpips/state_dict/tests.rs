use super::*;
use proptest::prelude::*;
use std::io::Cursor;

const ZIP: &[u8] = include_bytes!("../../../../../../tests/data/state_dict/zip.pth");
const LEGACY: &[u8] = include_bytes!("../../../../../../tests/data/state_dict/legacy.pth");
const MODULE: &[u8] = include_bytes!("../../../../../../tests/data/state_dict/module.pth");
const TRANSPOSED: &[u8] = include_bytes!("../../../../../../tests/data/state_dict/transposed.pth");

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

fn open(bytes: &[u8]) -> Result<StateDict<Cursor<&[u8]>>> {
    StateDict::read(Cursor::new(bytes))
}

fn refusal(bytes: &[u8]) -> String {
    open(bytes).unwrap_err().to_string()
}

/// A pickle of the given instructions in the legacy container.
fn legacy(pickle: &[u8]) -> Vec<u8> {
    let system = b"\x80\x02}U\x0dlittle_endian\x88s.";
    [legacy::MAGIC, b"\x80\x02M\xe9\x03.", system, b"\x80\x02", pickle, b".\x80\x02]."].concat()
}

/// Reads everything that can be read from a file.
fn read_all(bytes: &[u8]) -> Result<usize> {
    let mut file = open(bytes)?;
    let shapes: Vec<(String, Vec<usize>)> = file.tensors.iter().map(|(k, t)| (k.clone(), t.shape.clone())).collect();
    let mut values = 0;
    for (key, shape) in shapes {
        values += file.values(&key, &shape)?.len();
    }
    Ok(values)
}

#[test]
fn both_containers_of_pytorch_give_the_same_tensors() {
    for bytes in [ZIP, LEGACY] {
        let mut file = open(bytes).unwrap();
        assert_eq!(file.tensors.len(), SHAPES.len());
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
    let start = [legacy::MAGIC, b"\x80\x02M\xe9\x03.", system, b"\x80\x02", &call, b"\x80\x02]U\x01ka."].concat();
    let values: Vec<u8> = [0.5, 1.5, 2.5, 3.5].iter().flat_map(|v| f16::from_f32(*v).to_le_bytes()).collect();
    let bytes = [&start[..], &4u64.to_le_bytes(), &values].concat();
    assert_eq!(open(&bytes).unwrap().values("x", &[2]).unwrap(), [2.5, 3.5]);
    // a view that ends beyond the storage
    let mut beyond = bytes.clone();
    let at = beyond.windows(4).position(|w| w == b"K\x01K\x03").unwrap();
    beyond[at + 3] = 4;
    assert_eq!(refusal(&beyond), "damaged: the description of a storage is invalid; download it again");
    let wrong = [&start[..], &5u64.to_le_bytes(), &values].concat();
    assert!(refusal(&wrong).contains("the size of storage k"));
}

#[test]
fn safetensors_give_the_same() {
    let values: Vec<u8> = [1.0f32, -2.0, 0.5].iter().flat_map(|v| v.to_le_bytes()).collect();
    let single = safetensors::tensor::TensorView::new(Dtype::F32, vec![3], &values).unwrap();
    let other = safetensors::tensor::TensorView::new(Dtype::I32, vec![3], &values).unwrap();
    let bytes = safetensors::serialize([("a", single), ("b", other)], None).unwrap();
    let mut file = open(&bytes).unwrap();
    assert_eq!(file.values("a", &[3]).unwrap(), [1.0, -2.0, 0.5]);
    assert_eq!(file.shape("b"), None);
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
    assert!(refusal(MODULE).contains("torch.nn.modules.linear.Linear"), "{}", refusal(MODULE));
    assert!(refusal(TRANSPOSED).contains("row-major"), "{}", refusal(TRANSPOSED));
    assert!(refusal(&legacy(b"cos\nsystem\nU\x02ls\x85R")).contains("it refers to os.system, which is not supported"));
    assert!(refusal(&legacy(b"\x95")).contains("instruction 0x95"));
    assert!(open(&legacy(b"}")).unwrap().tensors.is_empty());
    let folder = tempfile::tempdir().unwrap();
    assert!(StateDict::open(folder.path()).unwrap_err().to_string().contains("not a regular file"));
    assert!(matches!(StateDict::open(&folder.path().join("no")), Err(StateDictError::Io(_))));
}

#[test]
fn descriptions_that_ask_for_too_much_are_refused() {
    // nesting uses no stack, and a file of brackets is parsed like any other
    let deep = "]".repeat(100_000) + &"a".repeat(99_999);
    assert!(open(&legacy(deep.as_bytes())).unwrap().tensors.is_empty());
    // a long list that is copied repeatedly
    let mut bomb = b"ccollections\nOrderedDict\nq\x00](".to_vec();
    bomb.extend(b"NN\x86".repeat(10_000));
    bomb.extend(b"e\x85q\x01");
    bomb.extend(b"h\x00h\x01R".repeat(10_000));
    assert!(refusal(&legacy(&bomb)).contains("again and again"));
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
    let call = [b"}U\x01xctorch._utils\n_rebuild_tensor_v2\n(", &storage[..], b"K\x00", &shape, &shape, b"tRs"];
    // strides that no tensor has
    assert!(refusal(&legacy(&call.concat())).contains("row-major"));
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
    let place = open(ZIP).unwrap().tensors["features.0.weight"].clone();
    for at in place.at..place.at + 96 {
        let mut bytes = ZIP.to_vec();
        bytes[at as usize] ^= 1;
        let error = open(&bytes).unwrap().values("features.0.weight", &[2, 3, 2, 2]).unwrap_err().to_string();
        assert!(error.contains("the checksum of `features.0.weight` is wrong"), "{error}");
    }
}

proptest! {
    /// Damage gives an error or a file whose tensors are not larger than the file, and never a panic.
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
        if let Ok(file) = open(&bytes) {
            for place in file.tensors.values() {
                let size = elements(&place.shape).unwrap() * place.kind.size();
                prop_assert!(place.at + size <= bytes.len() as u64);
            }
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
