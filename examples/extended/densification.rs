//! A densification rule: only opaque Gaussians are copied, those with the largest gradients first.

use volseggs::extend::{Candidates, DensificationRule, RowSource};

/// As many as in `budget` mode, among those of at least this opacity.
pub struct Opaque {
    /// The opacity, in [0, 1].
    pub opacity: f32,
}

impl DensificationRule for Opaque {
    fn plan(&self, seen: &Candidates<'_>) -> Vec<RowSource> {
        let score = |i: &usize| seen.statistics.score(*i);
        let is_opaque = |i: &usize| seen.opacities[*i] >= self.opacity && score(i) > 0.0;
        let mut chosen: Vec<usize> = seen.alive.iter().copied().filter(is_opaque).collect();
        chosen.sort_by(|a, b| score(b).total_cmp(&score(a)).then(a.cmp(b)));
        chosen.truncate(seen.target.map_or(0, |target| target.saturating_sub(seen.alive.len())));
        let kept = seen.alive.iter().map(|&i| RowSource::Keep(i));
        kept.chain(chosen.into_iter().map(RowSource::Clone)).collect()
    }
}
