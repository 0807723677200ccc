//! The feature field as plain f64 loops: the oracle of the fast kernels, gradient included.
//! Written for reading, not for speed.

use super::shape::{FieldShape, PLANE_AXES, PLANE_LINE};

/// The three flat parameter buffers in f64.
pub type FieldParamsF64<'a> = super::FieldParams<'a, f64>;

/// Gradients of [`forward`], each as long as the buffer it belongs to.
#[derive(Clone, Debug)]
pub struct FieldGradsF64 {
    /// Gradient of the plane buffer.
    pub planes: Vec<f64>,
    /// Gradient of the line buffer.
    pub lines: Vec<f64>,
    /// Gradient of the time buffer.
    pub times: Vec<f64>,
    /// Gradient of the points `[N, 3]`.
    pub points: Vec<f64>,
}

/// Two nodes, each with its weight and the derivative of the weight with respect to the coordinate.
type Taps = [(usize, f64, f64); 2];

fn taps(unit: f64, slope: f64, n: usize) -> Taps {
    let last = (n - 1) as f64;
    let raw = unit * last;
    let inside = raw > 0.0 && raw < last;
    let grid = if raw.is_nan() { 0.0 } else { raw.clamp(0.0, last) };
    let lo = (grid.floor() as usize).min(n.saturating_sub(2));
    let frac = grid - lo as f64;
    let slope = if inside { slope * last } else { 0.0 };
    [(lo, 1.0 - frac, -slope), ((lo + 1).min(n - 1), frac, slope)]
}

/// Nodes that one sample reads: index in the flat buffer (of channel 0), weight, and the derivatives of the weight with
/// respect to x, y and z.
type WeightedNodes = Vec<(usize, f64, [f64; 3])>;

struct SampledNodes {
    /// Nodes of xy, xz, yz and of the line multiplied by each.
    planes: [WeightedNodes; 3],
    lines: [WeightedNodes; 3],
}

fn sample(shape: &FieldShape, level: usize, point: &[f64]) -> SampledNodes {
    let n = shape.levels[level].resolution;
    let axes = [0, 1, 2].map(|a| taps(point[a] * 0.5 + 0.5, 0.5, n[a]));
    let (plane_spans, line_spans) = (shape.plane_spans(), shape.line_spans());
    let planes = [0, 1, 2].map(|k| {
        let (fast, slow) = PLANE_AXES[k];
        let span = plane_spans[3 * level + k];
        let mut nodes = WeightedNodes::new();
        for (y, wy, dy) in axes[slow] {
            for (x, wx, dx) in axes[fast] {
                let mut slope = [0.0; 3];
                slope[fast] = dx * wy;
                slope[slow] = dy * wx;
                let at = span.offset + (y * span.width + x) * shape.channels;
                nodes.push((at, wx * wy, slope));
            }
        }
        nodes
    });
    let lines = [0, 1, 2].map(|k| {
        let axis = PLANE_LINE[k];
        let span = line_spans[3 * level + axis];
        let node = |(i, w, d): (usize, f64, f64)| {
            let mut slope = [0.0; 3];
            slope[axis] = d;
            (span.offset + i * shape.channels, w, slope)
        };
        axes[axis].map(node).to_vec()
    });
    SampledNodes { planes, lines }
}

/// Whether the point has a NaN coordinate: it then has features of 0 and passes no gradient on.
fn nowhere(point: &[f64]) -> bool {
    point.iter().any(|v| v.is_nan())
}

fn value(nodes: &WeightedNodes, data: &[f64], r: usize) -> f64 {
    nodes.iter().map(|&(at, w, _)| w * data[at + r]).sum()
}

/// Returns the features `[N, levels * R]` of `points` `[N, 3]` at `time` in [0, 1].
pub fn forward(shape: &FieldShape, params: FieldParamsF64<'_>, points: &[f64], time: f64) -> Vec<f64> {
    let knots = taps(time, 1.0, shape.time_knots);
    let mut features = Vec::new();
    for point in points.chunks_exact(3) {
        if nowhere(point) {
            features.resize(features.len() + shape.features_len(), 0.0);
            continue;
        }
        for (level, span) in shape.time_spans().iter().enumerate() {
            let nodes = sample(shape, level, point);
            for r in 0..shape.channels {
                let mut sum = 0.0;
                for k in 0..3 {
                    sum += value(&nodes.planes[k], params.planes, r) * value(&nodes.lines[k], params.lines, r);
                }
                let mut at_time = 0.0;
                for (knot, w, _) in knots {
                    at_time += w * params.times[span.offset + knot * shape.channels + r];
                }
                features.push(sum * at_time);
            }
        }
    }
    features
}

/// Returns the gradients of [`forward`] for `grad_features` `[N, levels * R]`.
pub fn backward(
    shape: &FieldShape,
    params: FieldParamsF64<'_>,
    points: &[f64],
    time: f64,
    grad_features: &[f64],
) -> FieldGradsF64 {
    let mut grads = FieldGradsF64 {
        planes: vec![0.0; params.planes.len()],
        lines: vec![0.0; params.lines.len()],
        times: vec![0.0; params.times.len()],
        points: vec![0.0; points.len()],
    };
    let knots = taps(time, 1.0, shape.time_knots);
    let spans = shape.time_spans();
    for (i, point) in points.chunks_exact(3).enumerate().filter(|(_, point)| !nowhere(point)) {
        for level in 0..shape.levels.len() {
            let nodes = sample(shape, level, point);
            for r in 0..shape.channels {
                let g = grad_features[(i * shape.levels.len() + level) * shape.channels + r];
                let knot_at = |knot: usize| spans[level].offset + knot * shape.channels + r;
                let at_time: f64 = knots.iter().map(|&(knot, w, _)| w * params.times[knot_at(knot)]).sum();
                let mut sum = 0.0;
                for k in 0..3 {
                    let plane = value(&nodes.planes[k], params.planes, r);
                    let line = value(&nodes.lines[k], params.lines, r);
                    sum += plane * line;
                    for &(at, w, slope) in &nodes.planes[k] {
                        let factor = g * at_time * line;
                        grads.planes[at + r] += factor * w;
                        for axis in 0..3 {
                            grads.points[3 * i + axis] += factor * params.planes[at + r] * slope[axis];
                        }
                    }
                    for &(at, w, slope) in &nodes.lines[k] {
                        let factor = g * at_time * plane;
                        grads.lines[at + r] += factor * w;
                        for axis in 0..3 {
                            grads.points[3 * i + axis] += factor * params.lines[at + r] * slope[axis];
                        }
                    }
                }
                for (knot, w, _) in knots {
                    grads.times[knot_at(knot)] += g * sum * w;
                }
            }
        }
    }
    grads
}
