//! What users write on the command line: names, colours, sizes, whole lines of arguments.

use crate::driver::{Target, accepted, fuzz};
use std::path::{Component, Path};
use volseggs::cli::Cli;
use volseggs::data::SplitName;
use volseggs::data::paths::Axis;
use volseggs::device::DeviceName;
use volseggs::memory::Bytes;
use volseggs::name::Name;
use volseggs::volume::synthetic::Synthetic;
use volseggs::volume::transfer::{TransferFunction, color, colormap};

#[test]
fn words() {
    fuzz("words", |_| {
        let read = |bytes: &[u8]| {
            let text = String::from_utf8_lossy(bytes);
            let mut any = false;
            if let Some(name) = accepted(text.parse::<Name>()) {
                let parts: Vec<_> = Path::new(name.as_str()).components().collect();
                assert!(matches!(parts[..], [Component::Normal(_)]), "{name}");
                any = true;
            }
            let from_json = accepted(serde_json::from_slice::<Name>(bytes));
            any |= from_json.is_some_and(|n| !n.as_str().contains('/'));
            any |= color::parse_hex(&text).is_some_and(|c| c.iter().all(|v| (0.0..=1.0).contains(v)));
            any |= colormap::named(&text).is_some_and(|map| !map.is_empty());
            any |= accepted(text.parse::<Bytes>()).is_some_and(|b| b.0 > 0);
            any |= accepted(text.parse::<DeviceName>()).is_some();
            any |= accepted(text.parse::<SplitName>()).is_some();
            any |= accepted(text.parse::<Axis>()).is_some();
            any |= accepted(text.parse::<Synthetic>()).is_some();
            // only presets: a path would be read
            any || !text.contains('.') && accepted(TransferFunction::load(&text)).is_some()
        };
        let seeds = [
            "red.1",
            "\"dark-grey_2\"",
            "#ff8000",
            "viridis",
            "cool-warm",
            "1.5GiB",
            "800M",
            "flex",
            "train",
            "x",
            "jets",
            "fire",
        ];
        Target::new(seeds.map(|s| s.as_bytes().to_vec()).to_vec(), read)
            .sizes(256, 16)
            .tokens(&["..", "#", "GiB", "e308", "-", "_"])
    });
}

/// The command line, parsed but not run.
#[test]
fn arguments() {
    fuzz("arguments", |_| {
        let read = |bytes: &[u8]| {
            let text = String::from_utf8_lossy(bytes).into_owned();
            let line = std::iter::once("volseggs").chain(text.split(' '));
            accepted(Cli::from_line(line)).is_some()
        };
        let seeds = [
            "train --data d --out o --config quick --set seed=3 --device flex --stop-after 10",
            "prepare --volume a.nrrd --transfer-function fire --out d --size 100 --views 3 --label-names 1=core,2=shell",
            "render r --path orbit --out f --size 64 --frames 3",
            "edit recolour r --segment red --colour #ff0000",
            "edit translate r --segment red --by 0,-1,2",
            "segment pick r --pixel 3,4 --name x --threshold 0.5",
            "export ply r --out x.ply --time 0.5",
            "sweep s.toml --jobs 2 --seeds 1,2 --dry-run",
            "compare a b --metrics psnr",
        ];
        Target::new(seeds.map(|s| s.as_bytes().to_vec()).to_vec(), read).sizes(1024, 32).tokens(&[
            "--size", "--time", "nan", "--set", "--views", "--device", "--memory", "--out", "--name", "../x", "--by",
            "--json", "--help",
        ])
    });
}
