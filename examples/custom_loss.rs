//! Training with a loss term of one's own: `cargo run --release --example custom_loss -- DATA OUT.safetensors [STEPS]`.
//!
//! The term rewards Gaussians that are either clear or opaque. With `volseggs::main()` in place of the loop, every command
//! and configuration would know it; `examples/extended` is such a program.

use std::path::Path;
use volseggs::burn::tensor::{Tensor, activation::sigmoid};
use volseggs::extend::{LossInput, LossTerm, loss_term};
use volseggs::prelude::*;

struct ClearOrOpaque;

impl LossTerm for ClearOrOpaque {
    fn loss(&self, seen: &LossInput<'_>) -> Tensor<1> {
        let opacity = sigmoid(seen.gaussians.opacity_logits.clone());
        (opacity.clone() * (opacity.neg() + 1.0)).mean()
    }
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [data, out, rest @ ..] = &arguments[..] else { return Err("usage: custom_loss DATA OUT [STEPS]".into()) };
    let steps: usize = rest.first().map_or(Ok(500), |text| text.parse())?;
    loss_term("clear-or-opaque", ClearOrOpaque);
    let mut config = preset("quick")?;
    config.loss.extra.insert("clear-or-opaque".into(), 0.01);

    let dataset = Dataset::open(Path::new(data), &OpenOptions::default())?;
    let mut trainer = Trainer::new(config, &dataset, &DeviceName::all()[0].open()?)?;
    for _ in 0..steps {
        trainer.step(&dataset.train)?;
    }
    trainer.scene().save(Path::new(out))?;
    Ok(())
}
