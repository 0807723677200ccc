//! Applies a stack of edits to the Gaussians of one time. Edits are checked before anything is changed; their meaning
//! is documented at [`Operation`].

use super::error::EditError;
use super::operation::{Edit, Operation};
use super::sh::ShRotation;
use super::stack::EditStack;
use super::state::{HIDDEN_LOGIT, check};
use crate::model::HostGaussians;
use crate::model::sh::C0;
use glam::{DMat3, DQuat, DVec3};
use rayon::prelude::*;
use volseggs_kernels::activation::{logit_f64, sigmoid_f64};

/// Maximum opacity, as in drawing.
const MAX_OPACITY: f64 = 0.99;

/// Applies the edits in order to the Gaussians at the time being drawn. `segments` returns the Gaussians of a segment
/// by name, or `None` for a name that does not exist.
///
/// Hidden Gaussians get the logit [`HIDDEN_LOGIT`]. Gaussians outside the segments of an edit stay bit-identical,
/// except for those that [`Operation::Isolate`] hides. Centres are weighted with the opacities before any edit, so that
/// no edit of opacity moves them; non-finite values are excluded from centres and mean colours.
///
/// # Errors
/// [`EditError::Shape`] and [`EditError::ShStride`] for inconsistent arrays, [`EditError::Value`],
/// [`EditError::UnknownSegment`] or [`EditError::Index`]; `state` is then unchanged.
pub fn apply<'s>(
    stack: &EditStack,
    segments: &dyn Fn(&str) -> Option<&'s [u32]>,
    state: &mut HostGaussians,
) -> Result<(), EditError> {
    check(state)?;
    stack.validate(&|name| segments(name).is_some())?;
    let n = state.len();
    let mut resolved = Vec::with_capacity(stack.operations.len());
    for edit in &stack.operations {
        resolved.push(resolve(edit, segments, n)?);
    }
    let weights = state.opacity_logits.iter().map(|&logit| sigmoid_f64(logit.into())).collect();
    let mut editor = Editor { weights, hidden: vec![false; n], owner: vec![0; n], members: Vec::new(), state };
    for (edit, lists) in stack.operations.iter().zip(&resolved) {
        editor.claim(lists);
        editor.edit(&edit.operation);
    }
    let Editor { hidden, state, .. } = editor;
    for (logit, _) in state.opacity_logits.iter_mut().zip(hidden).filter(|(_, hidden)| *hidden) {
        *logit = HIDDEN_LOGIT;
    }
    Ok(())
}

/// Returns the opacity-weighted mean of the finite positions of `members` in `now`, scene units: the centre about which
/// an edit of them rotates and scales. The weights are the opacities of `before`, the same Gaussians with no edit
/// applied, as in [`apply`]. `None` if no position is finite.
pub fn centre(before: &HostGaussians, now: &HostGaussians, members: &[u32]) -> Option<[f64; 3]> {
    let weights: Vec<f64> = before.opacity_logits.iter().map(|&logit| sigmoid_f64(logit.into())).collect();
    let own: Vec<usize> = members.iter().map(|i| *i as usize).collect();
    weighted_mean(&own, &weights, |i| triple(&now.means, 3 * i)).map(|c| c.to_array())
}

fn resolve<'s>(
    edit: &Edit,
    segments: &dyn Fn(&str) -> Option<&'s [u32]>,
    count: usize,
) -> Result<Vec<&'s [u32]>, EditError> {
    let mut lists = Vec::with_capacity(edit.segments.len());
    for name in &edit.segments {
        let list = segments(name).unwrap_or_default();
        if let Some(&index) = list.iter().find(|&&i| i as usize >= count) {
            return Err(EditError::Index { name: name.clone(), index, count });
        }
        lists.push(list);
    }
    Ok(lists)
}

struct Editor<'a> {
    /// Linear opacity before any edit `[N]`.
    weights: Vec<f64>,
    hidden: Vec<bool>,
    /// The named segment that contains each Gaussian in the current edit, from 1; 0 for none `[N]`.
    owner: Vec<u32>,
    /// The same as lists, one per named segment.
    members: Vec<Vec<usize>>,
    state: &'a mut HostGaussians,
}

impl Editor<'_> {
    /// Assigns each Gaussian to the first list that contains it.
    fn claim(&mut self, lists: &[&[u32]]) {
        self.owner.fill(0);
        self.members.clear();
        for (list, number) in lists.iter().zip(1..) {
            let mut own = Vec::with_capacity(list.len());
            for &i in *list {
                let i = i as usize;
                if self.owner[i] == 0 {
                    self.owner[i] = number;
                    own.push(i);
                }
            }
            self.members.push(own);
        }
    }

    fn edit(&mut self, operation: &Operation) {
        match operation {
            Operation::Recolour { rgb, keep_shading } => self.recolour(*rgb, *keep_shading),
            Operation::Opacity { factor: 0.0, .. } | Operation::Hide => self.hide(true),
            Operation::Opacity { factor, show } => {
                self.opacity(f64::from(*factor));
                if *show {
                    self.hide(false);
                }
            }
            Operation::Show => self.hide(false),
            Operation::Isolate => {
                for (hidden, owner) in self.hidden.iter_mut().zip(&self.owner) {
                    *hidden |= *owner == 0;
                }
            }
            Operation::Translate { by } => {
                let by = vector(by);
                self.move_means(|_, p| p + by);
            }
            Operation::Rotate { axis, degrees, about } => {
                let turn = DQuat::from_axis_angle(vector(axis).normalize(), f64::from(*degrees).to_radians());
                self.rotate(turn, about.as_ref());
            }
            Operation::Scale { factor, about } => self.scale(f64::from(*factor), about.as_ref()),
        }
    }

    fn hide(&mut self, hide: bool) {
        for &i in self.members.iter().flatten() {
            self.hidden[i] = hide;
        }
    }

    fn opacity(&mut self, factor: f64) {
        for &i in self.members.iter().flatten() {
            let logit = &mut self.state.opacity_logits[i];
            let opacity = (sigmoid_f64((*logit).into()) * factor).min(MAX_OPACITY);
            // An opacity of 0 has no finite logit and stays as it is; `min` turns NaN into a number.
            if opacity > 0.0 && !logit.is_nan() {
                *logit = logit_f64(opacity) as f32;
            }
        }
    }

    fn recolour(&mut self, rgb: [f32; 3], keep_shading: bool) {
        let width = 3 * self.state.sh_stride;
        for own in &self.members {
            if keep_shading {
                let mean = weighted_mean(own, &self.weights, |i| triple(&self.state.sh, i * width));
                let target = DVec3::from(rgb.map(|c| (f64::from(c) - 0.5) / f64::from(C0)));
                let step = mean.map_or(DVec3::ZERO, |mean| target - mean);
                for &i in own {
                    let moved = triple(&self.state.sh, i * width) + step;
                    put(&mut self.state.sh, i * width, moved);
                }
            } else {
                for &i in own {
                    let sh = &mut self.state.sh[i * width..(i + 1) * width];
                    sh.fill(0.0);
                    sh[..3].copy_from_slice(&rgb.map(|c| (c - 0.5) / C0));
                }
            }
        }
    }

    fn rotate(&mut self, turn: DQuat, about: Option<&[f32; 3]>) {
        let centres = self.centres(about);
        self.move_means(|owner, p| centres[owner] + turn * (p - centres[owner]));
        for &i in self.members.iter().flatten() {
            let q = &mut self.state.rotations[4 * i..4 * i + 4];
            let old = DQuat::from_xyzw(q[1].into(), q[2].into(), q[3].into(), q[0].into());
            let new = product(turn, old);
            q.copy_from_slice(&[new.w as f32, new.x as f32, new.y as f32, new.z as f32]);
        }
        if self.state.sh_stride > 1 {
            let sh = ShRotation::new(DMat3::from_quat(turn).transpose().to_cols_array_2d());
            let each = self.state.sh.par_chunks_exact_mut(3 * self.state.sh_stride).zip(&self.owner);
            each.filter(|(_, owner)| **owner != 0).for_each(|(coefficients, _)| sh.rotate(coefficients));
        }
    }

    fn scale(&mut self, factor: f64, about: Option<&[f32; 3]>) {
        let centres = self.centres(about);
        self.move_means(|owner, p| centres[owner] + factor * (p - centres[owner]));
        let step = factor.ln();
        for &i in self.members.iter().flatten() {
            for s in &mut self.state.log_scales[3 * i..3 * i + 3] {
                *s = (f64::from(*s) + step) as f32;
            }
        }
    }

    /// Returns, for each named segment, the fixed point or its current opacity-weighted centre.
    fn centres(&self, about: Option<&[f32; 3]>) -> Vec<DVec3> {
        let centre = |own: &Vec<usize>| match about {
            Some(point) => vector(point),
            None => weighted_mean(own, &self.weights, |i| triple(&self.state.means, 3 * i)).unwrap_or_default(),
        };
        self.members.iter().map(centre).collect()
    }

    /// Replaces the position of every named Gaussian; `to` receives the number of its segment, from 0.
    fn move_means(&mut self, to: impl Fn(usize, DVec3) -> DVec3) {
        for (number, own) in self.members.iter().enumerate() {
            for &i in own {
                let moved = to(number, triple(&self.state.means, 3 * i));
                put(&mut self.state.means, 3 * i, moved);
            }
        }
    }
}

/// Returns the weighted mean of the finite values, unweighted if all weights are 0; `None` if there is no finite value.
fn weighted_mean(own: &[usize], weights: &[f64], value: impl Fn(usize) -> DVec3) -> Option<DVec3> {
    let mean = |weight: &dyn Fn(usize) -> f64| {
        let (mut sum, mut total) = (DVec3::ZERO, 0.0);
        for &i in own {
            let (v, w) = (value(i), weight(i));
            if v.is_finite() && w.is_finite() {
                sum += w * v;
                total += w;
            }
        }
        (total > 0.0).then(|| sum / total)
    };
    mean(&|i| weights[i]).or_else(|| mean(&|_| 1.0))
}

/// Returns the Hamilton product `a b`; `b` need not be of unit length, and its length is kept.
fn product(a: DQuat, b: DQuat) -> DQuat {
    let (u, v) = (a.xyz(), b.xyz());
    let (w, xyz) = (a.w * b.w - u.dot(v), a.w * v + b.w * u + u.cross(v));
    DQuat::from_xyzw(xyz.x, xyz.y, xyz.z, w)
}

fn vector(v: &[f32; 3]) -> DVec3 {
    DVec3::from(v.map(f64::from))
}

fn triple(values: &[f32], at: usize) -> DVec3 {
    DVec3::new(values[at].into(), values[at + 1].into(), values[at + 2].into())
}

fn put(values: &mut [f32], at: usize, v: DVec3) {
    values[at..at + 3].copy_from_slice(&[v.x as f32, v.y as f32, v.z as f32]);
}
