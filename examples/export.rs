//! The Gaussians of a run at one time, as a file for other programs: `cargo run --release --example export -- RUN TIME OUT`.
//!
//! The extension of OUT chooses the format, also one that a program has registered. `volseggs export` does more: it applies
//! edits, selects segments, and refits the Gaussians to how other programs draw them.

use std::path::Path;
use volseggs::export::exporters::{Content, Exporter};
use volseggs::export::splat_file::SplatFileOptions;
use volseggs::prelude::*;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [run, time, out] = &arguments[..] else { return Err("usage: export RUN TIME OUT".into()) };
    let out = Path::new(out);
    let extension = out.extension().and_then(|extension| extension.to_str()).unwrap_or_default();
    let format = Exporter::of_extension(extension).ok_or("OUT: no format has this extension")?;
    let Content::Gaussians { write, .. } = format.content.clone() else {
        return Err("OUT: files of this format hold no Gaussians".into());
    };

    let run = OpenRun::open(Path::new(run), &DeviceName::all()[0].open()?)?;
    let gaussians = run.scene.host_at(time.parse()?).with_unit_rotations();
    write(&gaussians, out, &SplatFileOptions::default())?;
    Ok(())
}
