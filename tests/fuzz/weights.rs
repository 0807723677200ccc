//! Published weights, which `volseggs lpips` converts: PyTorch files and safetensors.

use crate::driver::{Target, accepted, fuzz};
use std::path::Path;
use volseggs::lpips_weights::convert;

/// Returns a file with the first tensor of AlexNet and that of its heads, both of them one stored value repeated by
/// strides of 0, in the container of PyTorch before 1.6.
fn repeated() -> Vec<u8> {
    let tensor = |name: &str, shape: &[u8]| {
        let sizes: Vec<u8> = shape.iter().flat_map(|n| [b'K', *n]).collect();
        let name = [b"U", &[name.len() as u8][..], name.as_bytes()].concat();
        let storage =
            b"ctorch._utils\n_rebuild_tensor\n((U\x07storagectorch\nFloatStorage\nU\x01kU\x03cpuK\x01tQK\x00(";
        [&name, &storage[..], &sizes, b"t(", &b"K\x00".repeat(shape.len()), b"ttR"].concat()
    };
    let start =
        b"\x80\x02\x8a\x0al\xfc\x9cF\xf9 j\xa8P\x19.\x80\x02M\xe9\x03.\x80\x02}U\x0dlittle_endian\x88s.\x80\x02}(";
    let tensors =
        [tensor("features.0.weight", &[64, 3, 11, 11]), tensor("lin0.model.1.weight", &[1, 64, 1, 1])].concat();
    [&start[..], &tensors, b"u.\x80\x02]U\x01ka.", &1u64.to_le_bytes(), &0.5f32.to_le_bytes()].concat()
}

/// No file of this size holds a network, so the tensors after the first are missing in each.
#[test]
fn published_weights() {
    fuzz("published weights", |scratch| {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/state_dict");
        let files = ["zip.pth", "legacy.pth", "module.pth", "transposed.pth"];
        let mut seeds = files.map(|name| std::fs::read(folder.join(name)).unwrap()).to_vec();
        seeds.push(repeated());
        let (path, out, scratch) = (scratch.path("case.pth"), scratch.path("out.safetensors"), scratch.clone());
        let missing = convert(&scratch.write("seed.pth", &repeated()), &scratch.path("seed.pth"), &out).unwrap_err();
        assert!(missing.to_string().contains("no tensor `features.0.bias`"), "{missing}");
        let read = move |bytes: &[u8]| {
            scratch.overwrite(&path, bytes);
            accepted(convert(&path, &path, &out)).is_none()
        };
        Target::new(seeds, read).tokens(&["FloatStorage", "HalfStorage", "_rebuild_tensor_v2", "data.pkl", "data/0"])
    });
}
