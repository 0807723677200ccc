//! Tensor files: scenes, optimiser states, affinity fields, segments, weights.

use crate::driver::{Scratch, Target, accepted, fuzz};
use safetensors::tensor::{Dtype, TensorView};
use std::collections::BTreeMap;
use std::path::Path;
use volseggs::burn::tensor::Device;
use volseggs::config::types::{Config, ModelConfig, ShBands};
use volseggs::data::paths::{Lens, training_cameras};
use volseggs::device::DeviceName;
use volseggs::method::Model;
use volseggs::method::coordnet::CoordNetConfig;
use volseggs::method::coordnet::CoordNetSpec;
use volseggs::method::coordnet::network::SineNetwork;
use volseggs::method::insitunet::InSituNetConfig;
use volseggs::method::insitunet::{InSituNet, InSituNetSpec};
use volseggs::method::sphere::ViewSphere;
use volseggs::method::visnerf::VisNerfConfig;
use volseggs::method::visnerf::{VisNerf, VisNerfSpec};
use volseggs::metrics::lpips::Lpips;
use volseggs::model::HostGaussians;
use volseggs::model::ToKernel;
use volseggs::model::params::{self, HostTensor};
use volseggs::model::scene_file::{read_tensors, write_tensors};
use volseggs::model::{Scene, SceneSpec};
use volseggs::segment::fine::AffinityField;
use volseggs::segment::fine::file as affinity;
use volseggs::segment::fine::network::PositionBox;
use volseggs::segment::masks::sam::{Sam, SamConfig};
use volseggs::segment::segmentation::{Segment, SegmentOrigin, Segmentation};
use volseggs::tensors;
use volseggs::train::culling::Culling;
use volseggs::train::optimizer::{AdamConstants, Optimizer};

/// A case that begins with this is a header and, after [`SPLIT`], the data; any other is a file as it is.
const APART: &[u8] = b"apart ";
const SPLIT: u8 = 1;

pub fn device() -> Device {
    DeviceName::all()[0].open().unwrap()
}

/// Returns the file as it is, and split into header and data.
fn both(file: &[u8]) -> [Vec<u8>; 2] {
    let length = u64::from_le_bytes(file[..8].try_into().unwrap()) as usize;
    let (header, data) = file[8..].split_at(length);
    [file.to_vec(), [APART, header, &[SPLIT], data].concat()]
}

/// Assembles a file and corrects its digest.
fn signed(mut bytes: Vec<u8>) -> Vec<u8> {
    if let Some(rest) = bytes.strip_prefix(APART) {
        let at = rest.iter().position(|b| *b == SPLIT).unwrap_or(rest.len());
        let (header, data) = (&rest[..at], rest.get(at + 1..).unwrap_or_default());
        bytes = [&(header.len() as u64).to_le_bytes(), header, data].concat();
    }
    // bytes that are no longer a tensor file have no digest to correct
    let _ = volseggs::tensors::sign(&mut bytes);
    bytes
}

fn target(scratch: &Scratch, seeds: &[Vec<u8>], read: impl Fn(&Path) -> bool + 'static) -> Target {
    let (path, scratch) = (scratch.path("case.safetensors"), scratch.clone());
    let read = move |bytes: &[u8]| {
        scratch.overwrite(&path, bytes);
        read(&path)
    };
    Target::new(seeds.iter().flat_map(|s| both(s)).collect(), read).assemble(signed).sizes(64 << 10, 64).tokens(&[
        "\"F32\"",
        "\"F16\"",
        "\"U8\"",
        "\"U16\"",
        ".range",
        "\"U32\"",
        "\"I64\"",
        "\"BOOL\"",
        "\"F4\"",
        "\"shape\":[",
        "\"data_offsets\":[0,0]",
        "\"__metadata__\"",
        "volseggs.digest",
        "[0]",
        "[1]",
        "[]",
        "null",
        "\\\"",
    ])
}

fn small() -> ModelConfig {
    let model = Config::default().model;
    ModelConfig {
        sh_bands: ShBands::All,
        sh_degree: 1,
        levels: 1,
        resolution: 2,
        time_knots: 2,
        channels: 2,
        width: 4,
        ..model
    }
}

fn spec(model: ModelConfig) -> SceneSpec {
    let (centre, half_size, background) = ([0.0; 3], [1.0; 3], [1.0; 3]);
    SceneSpec { model, centre, half_size, background, deformed: true, sh_degree: 1, d3dgs: None, packed_from: None }
}

/// A scene of three Gaussians.
pub fn scene(model: ModelConfig) -> Scene {
    let n = 3;
    let k = (model.sh_degree + 1).pow(2);
    let row = |len: usize| (0..n * len).map(|i| (i as f32 * 0.37).sin()).collect::<Vec<f32>>();
    let gaussians = HostGaussians {
        means: row(3),
        rotations: row(4),
        log_scales: vec![-2.0; 3 * n],
        opacity_logits: row(1),
        sh: row(3 * k),
        sh_stride: k,
        ..HostGaussians::default()
    };
    Scene::new(gaussians, spec(model), 1, &device())
}

/// Returns scenes whose header does not match their tensors, or that are empty.
fn contradictions() -> impl Iterator<Item = (BTreeMap<String, HostTensor>, SceneSpec)> {
    let tensors = params::collect(&scene(small()));
    let mut empty = tensors.clone();
    for (_, tensor) in empty.iter_mut().filter(|(name, _)| name.starts_with("gaussians.")) {
        tensor.shape[0] = 0;
        tensor.values.clear();
    }
    let models = [
        ModelConfig { resolution: 1 << 40, ..small() },
        ModelConfig { resolution: 4096, channels: 64, ..small() },
        ModelConfig { levels: 1 << 40, ..small() },
        ModelConfig { width: 1 << 33, ..small() },
        ModelConfig { sh_degree: usize::MAX, ..small() },
        ModelConfig { sh_degree: 1 << 15, ..small() },
        ModelConfig { levels: 0, ..small() },
        ModelConfig { embedding: 1 << 40, ..small() },
        ModelConfig { encoder: "hexplane".into(), time_knots: 1 << 40, ..small() },
        ModelConfig { channels: 0, time_knots: 0, ..small() },
    ];
    let specs = models.map(spec).into_iter().chain([
        SceneSpec { sh_degree: 3, ..spec(small()) },
        SceneSpec { half_size: [0.0, 1.0, -1.0], ..spec(small()) },
    ]);
    let whole = specs.map(move |spec| (tensors.clone(), spec));
    whole.chain([(empty, spec(small()))])
}

fn saved(scratch: &Scratch, save: impl FnOnce(&Path)) -> Vec<u8> {
    let path = scratch.path("seed.safetensors");
    save(&path);
    std::fs::read(&path).unwrap()
}

#[test]
fn scene_file() {
    fuzz("scene", |scratch| {
        let implicit = "implicit".into();
        let shape = ModelConfig { implicit_octaves: 1, implicit_time_octaves: 1, implicit_width: 4, ..small() };
        let mut seeds = [small(), ModelConfig { encoder: implicit, implicit_depth: 3, implicit_skip: 1, ..shape }]
            .map(|model| saved(scratch, |path| scene(model).save(path).unwrap()))
            .to_vec();
        let grid = ModelConfig { encoder: "hexplane".into(), embedding: 2, ..small() };
        seeds.push(saved(scratch, |path| scene(grid).save(path).unwrap()));
        seeds.push(saved(scratch, |path| scene(small()).save_packed(path).unwrap()));
        seeds.extend(contradictions().map(|(tensors, spec)| {
            let text = volseggs::versioned::to_json(&spec).unwrap();
            saved(scratch, |path| write_tensors(path, &tensors, Some(("volseggs", text))).unwrap())
        }));
        let device = device();
        let cameras = training_cameras(1, 4.0, Lens { fov_x: 0.5, width: 6, height: 4 });
        target(scratch, &seeds, move |path| {
            let Some(scene) = accepted(Scene::load(path, &device)) else { return false };
            let _ = (scene.fingerprint(), scene.gaussians.sh_degree(), scene.gaussians.to_host());
            let picture = scene.render(cameras[0].to_kernel(), 0.3);
            assert_eq!(picture.len(), 4 * 6 * 4);
            true
        })
    });
}

/// Returns a target for files of the method of that name.
fn of_method(scratch: &Scratch, name: &'static str, seeds: &[Vec<u8>]) -> Target {
    let device = device();
    let cameras = training_cameras(1, 4.0, Lens { fov_x: 0.5, width: 6, height: 4 });
    target(scratch, seeds, move |path| {
        let method = volseggs::method::find(name).unwrap();
        let Some(model) = accepted(method.open(path, &device)) else { return false };
        assert_eq!(model.render(cameras[0].to_kernel(), 0.3).len(), 4 * 6 * 4);
        let _ = (model.counts(), model.place(), model.background());
        true
    })
}

fn sphere() -> ViewSphere {
    ViewSphere { centre: [0.0; 3].into(), half_size: 1.0, up: 2, flipped: false }
}

#[test]
fn coordnet() {
    fuzz("coordnet", |scratch| {
        let config = CoordNetConfig { widths: vec![4, 6], blocks: 1, ..CoordNetConfig::default() };
        let tensors = params::collect(&SineNetwork::new(&config, 1, &device()));
        let wide = CoordNetConfig { widths: vec![1 << 40], blocks: 900, ..config.clone() };
        let spheres = [(config.clone(), sphere()), (wide, sphere()), (config, ViewSphere { up: 7, ..sphere() })];
        let seed = |(config, sphere): (CoordNetConfig, ViewSphere)| {
            let spec = CoordNetSpec { config, sphere };
            let header = serde_json::json!({ "format": 1, "background": [1.0, 1.0, 1.0], "spec": spec }).to_string();
            saved(scratch, |path| write_tensors(path, &tensors, Some(("network", header))).unwrap())
        };
        of_method(scratch, "coordnet", &spheres.map(seed))
    });
}

#[test]
fn insitunet() {
    fuzz("insitunet", |scratch| {
        let (channels, critic_channels) = (vec![3, 2], vec![2]);
        let config = InSituNetConfig { channels, critic_channels, encoder: 3, ..InSituNetConfig::default() };
        let spec = InSituNetSpec { config, sphere: sphere(), background: [1.0; 3] };
        let seed = saved(scratch, |path| InSituNet::new(spec, 1, &device()).save(path).unwrap());
        of_method(scratch, "insitunet", &[seed])
    });
}

#[test]
fn visnerf() {
    fuzz("visnerf", |scratch| {
        let (density_ranks, appearance_ranks, width, occupancy) = (2, 2, 4, 3);
        let config = VisNerfConfig {
            density_ranks,
            appearance_ranks,
            width,
            occupancy,
            features: 2,
            ..VisNerfConfig::default()
        };
        let (centre, half, resolution, background) = ([0.0; 3], [1.0; 3], [3, 2, 4], [1.0; 3]);
        let spec = VisNerfSpec { config, centre, half, resolution, ends: [0.0, 1.0], knots: 2, background };
        let mut marked = VisNerf::new(spec.clone(), 1, &device());
        let unmarked = saved(scratch, |path| marked.save(path).unwrap());
        marked.occupancy = marked.occupied();
        let seeds = [unmarked, saved(scratch, |path| marked.save(path).unwrap())];
        of_method(scratch, "visnerf", &seeds)
    });
}

#[test]
fn tensor_file() {
    fuzz("tensors", |scratch| {
        let seed = saved(scratch, |path| {
            let tensor =
                |shape: &[usize]| HostTensor { shape: shape.to_vec(), values: vec![0.5; shape.iter().product()] };
            let all = BTreeMap::from([("a".to_owned(), tensor(&[2, 3])), ("b".to_owned(), tensor(&[0]))]);
            write_tensors(path, &all, Some(("key", "{\"x\": 1}".into()))).unwrap();
        });
        target(scratch, &[seed], |path| {
            let whole = accepted(tensors::read(path)).is_some();
            let read = accepted(read_tensors(path));
            assert!(whole || read.is_none());
            if let Some((all, _)) = &read {
                assert!(all.values().all(|t| t.values.len() == t.shape.iter().product::<usize>()));
            }
            whole
        })
    });
}

#[test]
fn fourdgs() {
    fuzz("4dgs", |scratch| {
        let tensor = |(name, width): (&str, &[usize])| {
            let shape = [&[3], width].concat();
            let values = (0..shape.iter().product()).map(|i| (i as f32 * 0.7).sin()).collect();
            (format!("gaussians.{name}"), HostTensor { shape, values })
        };
        let widths: [(&str, &[usize]); 7] = [
            ("means", &[3]),
            ("times", &[]),
            ("log_scales", &[4]),
            ("left", &[4]),
            ("right", &[4]),
            ("opacity_logits", &[]),
            ("sh", &[8, 3]),
        ];
        let tensors: BTreeMap<String, HostTensor> = widths.into_iter().map(tensor).collect();
        let seed = |[sh_degree, time_degree, sh_stride, orders]: [usize; 4]| {
            let header = serde_json::json!({
                "format": volseggs::versioned::FORMAT, "sh_stride": sh_stride, "orders": orders, "sh_degree": sh_degree, "time_degree": time_degree,
                "background": [1.0, 1.0, 1.0], "dilation": 0.1, "centre": [0.0, 0.0, 0.0], "half_size": [1.0, 1.0, 1.0],
            });
            saved(scratch, |path| write_tensors(path, &tensors, Some(("4dgs", header.to_string()))).unwrap())
        };
        let seeds = [[1, 1, 4, 2], [0, 0, 4, 2], [0, 7, 1, 8], [2, 1, 4, 2], [1, 1, 4, usize::MAX]].map(seed);
        of_method(scratch, "4dgs", &seeds)
    });
}

/// Writes the state of Adam and of culling, as in a checkpoint.
fn optimizer_file(path: &Path, steps: Vec<f32>) {
    let tensor = |values: Vec<f32>| HostTensor { shape: vec![values.len()], values };
    let all = BTreeMap::from([
        ("adam.first.gaussians.means".to_owned(), tensor(vec![0.1; 9])),
        ("adam.second.gaussians.means".to_owned(), tensor(vec![0.2; 9])),
        ("adam.steps.gaussians.means".to_owned(), tensor(steps)),
        ("statistics.gradient".to_owned(), tensor(vec![0.0; 3])),
        (format!("culled.{:016x}", 0.5f64.to_bits()), tensor(vec![2.0, 5.0])),
    ]);
    write_tensors(path, &all, None).unwrap();
}

#[test]
fn optimizer() {
    fuzz("optimizer", |scratch| {
        let steps = [vec![0.0, 7.0], vec![1e30, 1e30], vec![f32::NAN, -1.0], vec![3.0], vec![]];
        let seeds = steps.map(|steps| saved(scratch, |path| optimizer_file(path, steps)));
        let device = device();
        target(scratch, &seeds, move |path| {
            let Some((tensors, _)) = accepted(read_tensors(path)) else { return false };
            let mut optimizer = Optimizer::new(AdamConstants { betas: [0.9, 0.999], epsilon: 1e-15, sh_rest: 1.0 });
            let sizes = BTreeMap::from([("gaussians.means".to_owned(), 9)]);
            let loaded = accepted(optimizer.load(&tensors, &sizes, &device)).is_some();
            let _ = optimizer.to_tensors();
            let mut culling = Culling::new(4);
            culling.load(&tensors, 3);
            for _ in 0..3 {
                culling.visit(0.5);
            }
            loaded
        })
    });
}

#[test]
fn affinity_field() {
    fuzz("affinity", |scratch| {
        let device = device();
        let seed = saved(scratch, |path| {
            let frame = PositionBox { centre: [0.0; 3], side: 1.0 };
            let spec =
                affinity::AffinitySpec { frame, time: 0.5, scene: "0123456789abcdef".into(), spreads: vec![0.1, 0.2] };
            affinity::save(path, &AffinityField::new(1, &device), &spec).unwrap();
        });
        target(scratch, &[seed], move |path| {
            let Some((field, spec)) = accepted(affinity::load(path, &device)) else { return false };
            let features = field.features(&spec.frame.encode(&[0.1, 0.2, 0.3]), 0.5);
            assert_eq!(features.len(), 16);
            true
        })
    });
}

#[test]
fn segments() {
    fuzz("segments", |scratch| {
        let seed = saved(scratch, |path| {
            let mut all = Segmentation::new(5, "0123456789abcdef".into());
            for (name, parent, origin, members) in [
                ("red", None, SegmentOrigin::Coarse, vec![0, 1, 2]),
                ("red.1", Some("red"), SegmentOrigin::Fine { scale: 0.5 }, vec![0, 2]),
                ("dot", Some("red"), SegmentOrigin::Pick { scale: 0.1, threshold: 0.9 }, vec![]),
            ] {
                let parent = parent.map(|p| p.parse().unwrap());
                let name = name.parse().unwrap();
                all.add(Segment { name, parent, colour: [1.0, 0.5, 0.0], time: 0.5, origin, members }).unwrap();
            }
            all.save(path).unwrap();
        });
        let again = scratch.path("again.safetensors");
        target(scratch, &[seed], move |path| {
            let Some(mut found) = accepted(Segmentation::load(path)) else { return false };
            let names = found.leaves();
            // whether the number matches the scene is for the program to check
            if found.gaussians <= 1 << 20 {
                let labels = accepted(found.labels(&names));
                assert!(labels.is_none_or(|l| l.len() == found.gaussians));
            }
            assert_eq!(found.depths().len(), found.segments.len());
            accepted(found.save(&again));
            found.remove(|s| s.parent.is_none());
            true
        })
    });
}

/// A file of zeros.
fn zeros(tensors: &[(&str, &[usize])]) -> Vec<u8> {
    let data: Vec<Vec<u8>> = tensors.iter().map(|(_, shape)| vec![0; 2 * shape.iter().product::<usize>()]).collect();
    let views = tensors
        .iter()
        .zip(&data)
        .map(|((name, shape), data)| (*name, TensorView::new(Dtype::F16, shape.to_vec(), data).unwrap()));
    safetensors::serialize(views, None).unwrap()
}

/// The whole weights are too large to damage a million times: only the first tensors are tested here.
#[test]
fn lpips_weights() {
    fuzz("lpips", |scratch| {
        let seeds = [
            zeros(&[("net.conv0.weight", &[64, 3, 11, 11]), ("net.conv0.bias", &[64])]),
            zeros(&[("net.conv0.weight", &[64, 3, 3, 3]), ("net.conv0.bias", &[64])]),
        ];
        let device = device();
        // no file of this size is complete, so accepting one is a failure in itself
        let read = move |path: &Path| accepted(Lpips::load(path, &device)).is_none();
        target(scratch, &seeds, read)
    });
}

#[test]
fn sam_weights() {
    fuzz("sam", |scratch| {
        let whole = std::fs::read(Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/sam.safetensors")).unwrap();
        let config = SamConfig {
            image_size: 64,
            embed_dims: [8, 16, 16, 24],
            depths: [1, 1, 2, 1],
            heads: [1, 2, 4, 3],
            windows: [1, 3, 4, 2],
            mlp_ratio: 2,
            expand_ratio: 3,
            prompt_dim: 16,
            decoder_depth: 2,
            decoder_heads: 2,
            decoder_mlp: 24,
            decoder_downsample: 2,
            candidates: 3,
            iou_depth: 3,
            iou_hidden: 12,
        };
        let device = device();
        let read = move |path: &Path| accepted(Sam::load(path, &config, &device)).is_some();
        target(scratch, &[whole], read).sizes(256 << 10, 64)
    });
}
