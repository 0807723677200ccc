//! Gradient registration for [`super::splat`].

use super::{SplatBackwardOps, SplatForward, SplatOps, SplatSaved, SplatSettings};
use burn::backend::Autodiff;
use burn::backend::autodiff::checkpoint::{base::Checkpointer, strategy::CheckpointStrategy};
use burn::backend::autodiff::grads::Gradients;
use burn::backend::autodiff::ops::{Backward, Ops, OpsKind};
use burn::backend::tensor::FloatTensor;

#[derive(Clone, Debug)]
struct State<B: SplatBackwardOps> {
    means: FloatTensor<B>,
    rotations: FloatTensor<B>,
    log_scales: FloatTensor<B>,
    opacity_logits: FloatTensor<B>,
    sh: FloatTensor<B>,
    settings: SplatSettings,
    saved: SplatSaved,
}

#[derive(Debug)]
struct SplatBackward;

impl<B: SplatBackwardOps> Backward<B, 6> for SplatBackward {
    type State = State<B>;

    fn backward(self, ops: Ops<Self::State, 6>, grads: &mut Gradients, _checkpointer: &mut Checkpointer) {
        let grad_image = grads.consume::<B>(&ops.node);
        let s = ops.state;
        let out = B::splat_backward(
            s.means,
            s.rotations,
            s.log_scales,
            s.opacity_logits,
            s.sh,
            grad_image,
            s.settings,
            s.saved,
        );
        let all = [out.means, out.rotations, out.log_scales, out.opacity_logits, out.sh, out.screen_offsets];
        for (parent, grad) in ops.parents.into_iter().zip(all) {
            if let Some(node) = parent {
                grads.register::<B>(node.id, grad);
            }
        }
    }
}

impl<B: SplatOps + SplatBackwardOps, C: CheckpointStrategy> SplatOps for Autodiff<B, C> {
    fn splat_forward(
        means: FloatTensor<Self>,
        rotations: FloatTensor<Self>,
        log_scales: FloatTensor<Self>,
        opacity_logits: FloatTensor<Self>,
        sh: FloatTensor<Self>,
        screen_offsets: FloatTensor<Self>,
        settings: SplatSettings,
        _: bool,
    ) -> SplatForward<Self> {
        let (means, n_means) = means.into_parts();
        let (rotations, n_rotations) = rotations.into_parts();
        let (log_scales, n_log_scales) = log_scales.into_parts();
        let (opacity_logits, n_opacity) = opacity_logits.into_parts();
        let (sh, n_sh) = sh.into_parts();
        let (screen_offsets, n_offsets) = screen_offsets.into_parts();
        let forward = |save| {
            let [means, rotations, log_scales] = [means.clone(), rotations.clone(), log_scales.clone()];
            let (logits, sh, offsets) = (opacity_logits.clone(), sh.clone(), screen_offsets.clone());
            B::splat_forward(means, rotations, log_scales, logits, sh, offsets, settings, save)
        };
        let nodes = [n_means, n_rotations, n_log_scales, n_opacity, n_sh, n_offsets];
        match SplatBackward.prepare::<C>(nodes).compute_bound().stateful() {
            OpsKind::Tracked(prep) => {
                let out = forward(true);
                let saved = out.saved.clone();
                let state = State::<B> { means, rotations, log_scales, opacity_logits, sh, settings, saved };
                SplatForward { image: prep.finish(state, out.image), radii: out.radii, saved: out.saved }
            }
            OpsKind::UnTracked(prep) => {
                let out = forward(false);
                SplatForward { image: prep.finish(out.image), radii: out.radii, saved: out.saved }
            }
        }
    }
}
