//! `volseggs lpips`

use super::{CliError, print_json};
use crate::lpips_weights::{InputFile, convert};
use crate::memory::Bytes;
use crate::shell;
use clap::Args;
use std::path::PathBuf;

/// Make the weights file for `eval --lpips-weights` from the published files.
#[derive(Debug, Args)]
#[command(
    after_help = "LPIPS compares images by the features of a network: a backbone, trained on photographs, and heads\nthat weight its features. Both are published, and neither is part of this program.\n\nBackbones, from torchvision:\n  AlexNet  https://download.pytorch.org/models/alexnet-owt-7be5be79.pth  (244 MB)\n  VGG-16   https://download.pytorch.org/models/vgg16-397923af.pth        (553 MB)\nHeads, version 0.1: lpips/weights/v0.1/alex.pth and vgg.pth\n  from https://github.com/richzhang/PerceptualSimilarity, or from the PyPI package:\n  pip download --no-deps lpips && unzip -j lpips-*.whl 'lpips/weights/v0.1/*'\n\nExamples:\n  volseggs lpips --backbone alexnet-owt-7be5be79.pth --heads alex.pth --out lpips_alex.safetensors\n  volseggs lpips --backbone vgg16-397923af.pth --heads vgg.pth --out lpips_vgg.safetensors\n  volseggs eval checkpoints/first --lpips-weights lpips_alex.safetensors\n\nSafetensors files with the same tensor names are also accepted. No code in the files is executed."
)]
pub struct LpipsArgs {
    /// Backbone: the state dict of torchvision's AlexNet or VGG-16 (recognised automatically).
    #[arg(long, value_name = "FILE")]
    backbone: PathBuf,
    /// Heads of LPIPS v0.1 for the same network: alex.pth or vgg.pth.
    #[arg(long, value_name = "FILE")]
    heads: PathBuf,
    /// Safetensors file to write.
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
    /// Print one JSON object on standard output.
    #[arg(long)]
    json: bool,
}

impl LpipsArgs {
    pub(super) fn run(self) -> Result<(), CliError> {
        let made = convert(&self.backbone, &self.heads, &self.out)?;
        for input in [&made.backbone, &made.heads].into_iter().filter(|i| !i.published) {
            errln!(
                "note: {} is not the published file (its SHA-256 begins {}); its values are used as they are",
                input.file.display(),
                input.sha256
            );
        }
        if self.json {
            return print_json(&made);
        }
        let line = |input: &InputFile| {
            let origin = if input.published { ", the published file" } else { "" };
            format!("{}: {} tensors{origin}", input.file.display(), input.tensors)
        };
        outln!("network   {}", made.network);
        outln!("backbone  {}", line(&made.backbone));
        outln!("heads     {}", line(&made.heads));
        outln!("written   {}: {} tensors, {}", made.file.display(), made.tensors.len(), Bytes(made.bytes));
        outln!("next      volseggs eval RUN --lpips-weights {}", shell::path(&made.file));
        Ok(())
    }
}
