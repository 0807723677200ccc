//! `volseggs lpips` as a whole program: from PyTorch files to weights that `eval` accepts.

use crate::common::{json, names, refused, volseggs};
use safetensors::tensor::{Dtype, TensorView};
use std::path::Path;
use volseggs::device::DeviceName;
use volseggs::metrics::lpips::{Lpips, LpipsNet};
use volseggs::tensors;

/// Name, shape and values.
type Tensors = Vec<(String, Vec<usize>, Vec<f32>)>;

/// Index in `features`, shape of the kernel.
const ALEX: [(usize, [usize; 4]); 5] =
    [(0, [64, 3, 11, 11]), (3, [192, 64, 5, 5]), (6, [384, 192, 3, 3]), (8, [256, 384, 3, 3]), (10, [256, 256, 3, 3])];
const ALEX_HEADS: [usize; 5] = [64, 192, 384, 256, 256];
const VGG_HEADS: [usize; 5] = [64, 128, 256, 512, 512];

/// Returns a tensor of noise in [0, `scale`), determined by its name and shape.
fn tensor(name: String, shape: &[usize], scale: f32) -> (String, Vec<usize>, Vec<f32>) {
    let count = shape.iter().product();
    let mut state = name.bytes().fold(7u32, |h, b| h.wrapping_mul(31) + u32::from(b));
    let noise = std::iter::repeat_with(move || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        scale * (state >> 8) as f32 / (1 << 24) as f32
    });
    (name, shape.to_vec(), noise.take(count).collect())
}

/// Returns AlexNet with part of its classifier.
fn backbone() -> Tensors {
    let layer = |(place, shape): &(usize, [usize; 4])| {
        let weight = tensor(format!("features.{place}.weight"), shape, 0.01);
        [weight, tensor(format!("features.{place}.bias"), &shape[..1], 0.1)]
    };
    let mut all: Tensors = ALEX.iter().flat_map(layer).collect();
    all.push(tensor("classifier.6.bias".into(), &[1000], 1.0));
    all
}

fn heads(channels: [usize; 5]) -> Tensors {
    let head = |(i, c): (usize, usize)| tensor(format!("lin{i}.model.1.weight"), &[1, c, 1, 1], 1.0);
    channels.into_iter().enumerate().map(head).collect()
}

/// Returns a file as `torch.save` wrote it up to PyTorch 1.5.
fn pth(tensors: &Tensors) -> Vec<u8> {
    let text = |s: &str| [b"X".as_slice(), &(s.len() as u32).to_le_bytes(), s.as_bytes()].concat();
    let int = |n: usize| [b"J".as_slice(), &(n as u32).to_le_bytes()].concat();
    let tuple = |sizes: &[usize]| [b"(".to_vec(), sizes.iter().flat_map(|n| int(*n)).collect(), b"t".to_vec()].concat();
    let mut file = b"\x80\x02\x8a\x0al\xfc\x9cF\xf9 j\xa8P\x19.\x80\x02M\xe9\x03.".to_vec();
    file.extend([b"\x80\x02}".to_vec(), text("little_endian"), b"\x88s.".to_vec()].concat());
    file.extend(b"\x80\x02}(");
    for (name, shape, values) in tensors {
        let strides: Vec<usize> = (0..shape.len()).map(|i| shape[i + 1..].iter().product()).collect();
        file.extend([text(name), b"ctorch._utils\n_rebuild_tensor_v2\n((".to_vec(), text("storage")].concat());
        file.extend([b"ctorch\nFloatStorage\n".to_vec(), text(name), text("cpu"), int(values.len())].concat());
        file.extend([b"tQK\x00".to_vec(), tuple(shape), tuple(&strides), b"\x89NtR".to_vec()].concat());
    }
    file.extend(b"u.\x80\x02](");
    tensors.iter().for_each(|(name, ..)| file.extend(text(name)));
    file.extend(b"e.");
    for (.., values) in tensors {
        file.extend((values.len() as u64).to_le_bytes());
        file.extend(values.iter().flat_map(|v| v.to_le_bytes()));
    }
    file
}

fn safetensors(tensors: &Tensors) -> Vec<u8> {
    let bytes = |values: &[f32]| values.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>();
    let data: Vec<_> = tensors.iter().map(|(name, shape, values)| (name, shape, bytes(values))).collect();
    let view = |(name, shape, bytes)| (name, TensorView::new(Dtype::F32, Vec::clone(shape), bytes).unwrap());
    safetensors::serialize(data.iter().map(|(n, s, b)| view((n, s, b))), None).unwrap()
}

fn lpips(root: &Path, backbone: &str, heads: &str, out: &str) -> assert_cmd::Command {
    let mut command = volseggs();
    command.current_dir(root).args(["lpips", "--backbone", backbone, "--heads", heads, "--out", out]);
    command
}

#[test]
fn published_files_are_converted_to_weights() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    let write = |name: &str, bytes: Vec<u8>| std::fs::write(root.join(name), bytes).unwrap();
    write("alexnet.pth", pth(&backbone()));
    write("alex.pth", pth(&heads(ALEX_HEADS)));
    write("alexnet.safetensors", safetensors(&backbone()));
    write("alex.safetensors", safetensors(&heads(ALEX_HEADS)));

    let output = lpips(root, "alexnet.pth", "alex.pth", "a.safetensors").assert().success().get_output().clone();
    let text = String::from_utf8(output.stdout).unwrap();
    for line in ["network   alex", "alexnet.pth: 10 tensors", "alex.pth: 5 tensors", "a.safetensors: 15 tensors, 10 MB"]
    {
        assert!(text.contains(line), "{line} is not in {text}");
    }
    let notes = String::from_utf8(output.stderr).unwrap();
    assert!(notes.contains("alex.pth is not the published file"), "{notes}");

    let bytes = tensors::read(&root.join("a.safetensors")).unwrap();
    let file = safetensors::SafeTensors::deserialize(&bytes).unwrap();
    let mut all = backbone();
    all.pop();
    all.extend(heads(ALEX_HEADS));
    let renamed = (0..10).map(|i| format!("net.conv{}.{}", i / 2, ["weight", "bias"][i % 2]));
    let renamed = renamed.chain((0..5).map(|i| format!("lin{i}.weight")));
    for (name, (_, shape, values)) in renamed.zip(all) {
        let found = file.tensor(&name).unwrap();
        assert_eq!((found.dtype(), found.shape()), (Dtype::F32, shape.as_slice()), "{name}");
        let expected: Vec<u8> = values.iter().flat_map(|v| v.to_le_bytes()).collect();
        assert!(found.data() == expected, "{name} has other values");
    }

    // eval's reader accepts it, and both formats give the same file, which may be rewritten
    let weights = Lpips::load(root.join("a.safetensors"), &DeviceName::all()[0].open().unwrap()).unwrap();
    assert_eq!(weights.net(), LpipsNet::Alex);
    let image: Vec<f32> = (0..40 * 40 * 3).map(|i| (i % 7) as f32 / 7.0).collect();
    assert_eq!(weights.distance(&image, &image, 40, 40).unwrap(), 0.0);
    let grey = vec![0.5; image.len()];
    assert!(weights.distance(&image, &grey, 40, 40).unwrap() > 0.0);
    let again = lpips(root, "alexnet.safetensors", "alex.safetensors", "a.safetensors")
        .arg("--json")
        .assert()
        .success()
        .get_output()
        .stdout
        .clone();
    assert!(std::fs::read(root.join("a.safetensors")).unwrap() == bytes);
    write("again.json", again);
    let report = json(&root.join("again.json"));
    assert_eq!(report["network"], "alex");
    assert_eq!(report["backbone"]["published"], false);
    assert_eq!(report["tensors"][14]["name"], "lin4.weight");
    assert_eq!(report["tensors"][14]["shape"], serde_json::json!([1, 256, 1, 1]));
}

#[test]
fn wrong_files_are_reported_by_name_and_key() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    let write = |name: &str, bytes: &[u8]| std::fs::write(root.join(name), bytes).unwrap();
    let whole = pth(&backbone());
    write("alexnet.pth", &whole);
    write("alex.pth", &pth(&heads(ALEX_HEADS)));
    write("vgg.pth", &pth(&heads(VGG_HEADS)));
    write("cut.pth", &whole[..whole.len() - 1_000_000]);
    write("begun.pth", &whole[..300]);
    write("page.html", b"<!DOCTYPE html><title>404</title>");
    write("thesis.safetensors", b"a thesis");
    let changed = |name: &str, change: &dyn Fn(&mut Tensors)| {
        let mut tensors = backbone();
        change(&mut tensors);
        write(name, &pth(&tensors));
    };
    changed("lacks.pth", &|t| drop(t.remove(5)));
    changed("shape.pth", &|t| t[3] = tensor("features.3.bias".into(), &[191], 1.0));
    changed("first.pth", &|t| t[0] = tensor("features.0.weight".into(), &[64, 3, 7, 7], 1.0));
    changed("nan.pth", &|t| t[2].2[77] = f32::NAN);
    let mut short = heads(ALEX_HEADS);
    short.pop();
    write("short.pth", &pth(&short));
    let squeeze = [64, 128, 256, 384, 384];
    write("squeeze.pth", &pth(&heads(squeeze)));
    let before = names(root);

    let with = |backbone: &str, heads: &str, words: &[&str]| {
        refused(&mut lpips(root, backbone, heads, "out.safetensors"), words);
    };
    with("no.pth", "alex.pth", &["no.pth: cannot be read"]);
    with(".", "alex.pth", &["not a regular file"]);
    with(
        "cut.pth",
        "alex.pth",
        &["cut.pth: damaged: storage 'features.10.weight'", "beyond the end of the file; download it again"],
    );
    with("begun.pth", "alex.pth", &["begun.pth: damaged: it ends in the middle of its description"]);
    with("page.html", "alex.pth", &["page.html: neither a PyTorch file (.pth) nor safetensors"]);
    with("lacks.pth", "alex.pth", &["lacks.pth: there is no tensor `features.6.bias`", "volseggs lpips --help"]);
    with("shape.pth", "alex.pth", &["shape.pth: `features.3.bias` has shape [191], expected [192]"]);
    with("first.pth", "alex.pth", &["first.pth: `features.0.weight` has shape [64, 3, 7, 7]"]);
    with("nan.pth", "alex.pth", &["nan.pth: `features.3.weight` holds values that are not finite"]);
    with("alex.pth", "alexnet.pth", &["alex.pth: holds the heads of LPIPS", "--heads"]);
    with("alexnet.pth", "alexnet.pth", &["alexnet.pth: holds a backbone", "--backbone"]);
    with(
        "alexnet.pth",
        "vgg.pth",
        &["vgg.pth: holds the heads of vgg (`lin1.model.1.weight` has shape [1, 128, 1, 1])"],
    );
    with("alexnet.pth", "short.pth", &["short.pth: there is no tensor `lin4.model.1.weight`"]);
    with(
        "alexnet.pth",
        "squeeze.pth",
        &["squeeze.pth: `lin1.model.1.weight` has shape [1, 128, 1, 1], expected [1, 192"],
    );
    assert_eq!(names(root), before, "something was left behind");

    // files that this program did not make are not replaced, and neither are inputs
    let out = |out: &str, words: &[&str]| {
        refused(&mut lpips(root, "alexnet.pth", "alex.pth", out), words);
    };
    out("thesis.safetensors", &["thesis.safetensors: was not made by volseggs"]);
    out("no/x.safetensors", &["no/x.safetensors: there is no folder no"]);
    assert_eq!(std::fs::read(root.join("thesis.safetensors")).unwrap(), b"a thesis");
    let mut small = lpips(root, "alexnet.pth", "alex.pth", "out.safetensors");
    refused(small.args(["--memory", "1M"]), &["--backbone alexnet.pth: needs about", "--memory"]);
    assert_eq!(names(root), before, "something was left behind");
}

#[test]
fn the_help_says_where_the_files_come_from() {
    let output = volseggs().args(["lpips", "--help"]).assert().success().get_output().stdout.clone();
    let help = String::from_utf8(output).unwrap();
    for place in [
        "https://download.pytorch.org/models/alexnet-owt-7be5be79.pth",
        "https://download.pytorch.org/models/vgg16-397923af.pth",
        "https://github.com/richzhang/PerceptualSimilarity",
        "pip download --no-deps lpips",
    ] {
        assert!(help.contains(place), "{place} is not in {help}");
    }
}
