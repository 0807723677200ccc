//! A file format: the centres of the Gaussians as lines of text, which programs for point clouds read.

use std::path::Path;
use volseggs::extend::{Content, Exporter, SplatFileError, SplatFileOptions};
use volseggs::files::{MARK, write_named};
use volseggs::model::HostGaussians;

/// A line for each Gaussian: x, y, z and opacity.
pub const XYZ: Exporter = Exporter {
    extension: "xyz",
    endings: &[],
    description: "Centres and opacities as text",
    content: Content::Gaussians { write, log_scales: f32::NEG_INFINITY..=f32::INFINITY, has_sh_degree: false },
};

fn write(gaussians: &HostGaussians, path: &Path, options: &SplatFileOptions) -> Result<(), SplatFileError> {
    // by this mark the program knows later that it may replace the file
    let mut text = format!("# {MARK}: x y z opacity\n");
    options.comments.iter().for_each(|line| text += &format!("# {line}\n"));
    for (mean, opacity) in gaussians.means.chunks_exact(3).zip(gaussians.opacity()) {
        text += &format!("{} {} {} {opacity}\n", mean[0], mean[1], mean[2]);
    }
    Ok(write_named(path, text.as_bytes())?)
}
