//! The splat op on a GPU: the stages in order, and the binding to the Cube backend.
//!
//! project -> sort by depth -> count, scan and list tile entries -> sort by tile -> blend; backward: replay segments of
//! the tiles' lists, one unit per Gaussian -> sum each Gaussian's entries -> back through the projection. Every sum has
//! a fixed order, so the same device gives the same bits each time.
//!
//! All that the host must know is how many entries to make room for; see [`mod@capacity`].
// compile-time conditions of a kernel are kept apart from those of its units
#![allow(clippy::collapsible_if)]

mod bin;
mod blend;
mod blend_backward;
mod capacity;
mod covariance;
mod project;
mod project_backward;
pub(super) mod rule;
mod sh;
mod views;

use super::{CovarianceTensors, SplatBackwardOps, SplatForward, SplatOps, SplatSaved, SplatSettings, SplatTensors};
use crate::cube::prelude::*;
use crate::cube::{UNITS, Words, arg, cubes, empty_f32, empty_i32, rows};
use crate::sh::Bands;
use bin::TileEntries;
use std::sync::Arc;

/// Tile side in pixels.
pub(super) const TILE: usize = 16;
/// Entries staged through shared memory together.
const BATCH: u32 = 256;
/// Entries between two saved states of a tile's pixels; divides [`BATCH`].
const SEGMENT: u32 = 128;
/// Gaussians that the backward pass replays in parallel; divides [`SEGMENT`].
const LINE: u32 = 32;

/// State that the forward pass keeps for the backward pass.
#[derive(Debug)]
struct CubeForwardState {
    screen: Words,
    bins: TileEntries,
    used: Words,
    states: Words,
    image: CubeTensor,
}

/// Gaussians on screen, sorted into tiles.
pub(super) struct Binned {
    pub(super) screen: Words,
    pub(super) radii: CubeTensor,
    pub(super) bins: TileEntries,
}

/// Parameters of the covariances, as the kernels take them.
struct CovarianceSource {
    /// Quaternions `[N, 4]`, or covariances `[N, 6]`.
    rows: CubeTensor,
    /// `[N, 3]`, with quaternions.
    log_scales: Option<CubeTensor>,
}

impl CovarianceSource {
    fn new(covariances: CovarianceTensors<CubeBackend>) -> Self {
        match covariances {
            CovarianceTensors::Factored { rotations, log_scales } => {
                Self { rows: rows(rotations), log_scales: Some(rows(log_scales)) }
            }
            CovarianceTensors::Entries(entries) => Self { rows: rows(entries), log_scales: None },
        }
    }

    /// Allocates the gradients.
    fn empty_like(&self) -> Self {
        let like = |tensor: &CubeTensor| empty_f32(tensor, tensor.meta.shape().clone());
        Self { rows: like(&self.rows), log_scales: self.log_scales.as_ref().map(like) }
    }

    fn into_tensors(self) -> CovarianceTensors<CubeBackend> {
        match self.log_scales {
            Some(log_scales) => CovarianceTensors::Factored { rotations: self.rows, log_scales },
            None => CovarianceTensors::Entries(self.rows),
        }
    }

    /// Returns the argument for the log-scales; if there are none, one that no kernel accesses.
    fn log_scales(&self, client: &Client) -> BufferArg {
        self.log_scales.as_ref().map_or_else(|| Words::empty(client, 1).arg(), arg)
    }

    /// Whether the rows are covariances.
    fn entries(&self) -> bool {
        self.log_scales.is_none()
    }
}

pub(super) fn tiles(settings: &SplatSettings) -> [usize; 2] {
    [settings.camera.width.div_ceil(TILE), settings.camera.height.div_ceil(TILE)]
}

/// Projects and bins; with `exact`, the host waits for the number of entries.
pub(super) fn binned(inputs: SplatTensors<CubeBackend>, settings: &SplatSettings, exact: bool) -> Binned {
    let SplatTensors { means, covariances, opacity_logits, sh, screen_offsets } = inputs;
    let [means, logits, sh, offsets] = &[means, opacity_logits, sh, screen_offsets].map(rows);
    let source = CovarianceSource::new(covariances);
    let client = &means.client;
    let n = means.meta.shape()[0];
    let screen = Words::empty(client, n * project::SCREEN);
    let (keys, indices) = (Words::empty(client, n), Words::empty(client, n));
    let radii = empty_i32(means, [n]);
    let camera = Words::f32s(client, &project::camera_words(settings));
    project::project::launch(
        client,
        cubes(n, UNITS),
        CubeDim::new_1d(UNITS),
        arg(means),
        arg(&source.rows),
        source.log_scales(client),
        arg(logits),
        arg(sh),
        arg(offsets),
        camera.arg(),
        screen.arg(),
        keys.arg(),
        indices.arg(),
        arg(&radii),
        n as u32,
        sh.meta.shape()[1] as u32,
        settings.rendering.sh_degree as u32,
        Bands::of_any(sh.meta.shape()[1]) == Bands::Even,
        source.entries(),
    );
    let tiles = tiles(settings);
    let (order, starts) = bin::order(client, &screen, keys, indices, n, tiles);
    let limit = client.properties().memory.max_page_size;
    // gradients need nine words an entry, and the states of the pixels about as much
    let bytes = |capacity: usize| match exact {
        true => 4 * capacity as u64,
        false => (36 * capacity as u64).max(4096 * segments(capacity, tiles[0] * tiles[1]) as u64),
    };
    let capacity = capacity::capacity(client, &starts, n, settings, exact, &|capacity| bytes(capacity) <= limit);
    let needs = bytes(capacity);
    assert!(
        needs <= limit,
        "splat: {capacity} tile entries need {} MB in one buffer, but this GPU allows {} MB; use smaller images, fewer \
         or smaller Gaussians, or a CPU device",
        needs / 1_000_000,
        limit / 1_000_000
    );
    let bins = bin::list(client, &screen, order, starts, n, tiles, capacity);
    Binned { screen, radii, bins }
}

/// Returns the number of segments to make room for: each tile starts one of its own.
fn segments(capacity: usize, tile_count: usize) -> usize {
    capacity / SEGMENT as usize + tile_count + 1
}

fn blend(client: &Client, binned: &Binned, image: &CubeTensor, settings: &SplatSettings, save: bool) -> [Words; 2] {
    let [tiles_x, tiles_y] = tiles(settings);
    let tile_count = tiles_x * tiles_y;
    let bins = &binned.bins;
    let states = Words::empty(client, if save { 1024 * segments(bins.capacity, tile_count) } else { 1 });
    let used = Words::empty(client, if save { tile_count } else { 1 });
    blend::blend::launch(
        client,
        cubes(tile_count, 1),
        CubeDim::new_1d((TILE * TILE) as u32),
        binned.screen.arg(),
        bins.gaussians.arg(),
        bins.sorted.arg(),
        bins.tiles.arg(),
        arg(image),
        states.arg(),
        used.arg(),
        settings.camera.width as u32,
        settings.camera.height as u32,
        tiles_x as u32,
        tile_count as u32,
        settings.rendering.background[0],
        settings.rendering.background[1],
        settings.rendering.background[2],
        save,
    );
    [states, used]
}

impl SplatOps for CubeBackend {
    fn splat_forward(inputs: SplatTensors<Self>, settings: SplatSettings, save: bool) -> SplatForward<Self> {
        let client = inputs.means.client.clone();
        let image = empty_f32(&inputs.means, [settings.camera.height, settings.camera.width, 4]);
        let binned = binned(inputs, &settings, !save);
        let [states, used] = blend(&client, &binned, &image, &settings, save);
        let Binned { screen, radii, bins } = binned;
        let saved = SplatSaved(Arc::new(CubeForwardState { screen, bins, used, states, image: image.clone() }));
        SplatForward { image, radii, saved }
    }
}

impl SplatBackwardOps for CubeBackend {
    fn splat_backward(
        inputs: SplatTensors<Self>,
        grad_image: FloatTensor<Self>,
        settings: SplatSettings,
        saved: SplatSaved,
    ) -> SplatTensors<Self> {
        let [means, sh] = [inputs.means, inputs.sh].map(rows);
        let source = CovarianceSource::new(inputs.covariances);
        let saved = saved.0.downcast_ref::<CubeForwardState>().expect("the forward pass ran on the same backend");
        let client = means.client.clone();
        let n = means.meta.shape()[0];
        let sh_stride = sh.meta.shape()[1];
        let [tiles_x, tiles_y] = tiles(&settings);
        let bins = &saved.bins;
        let sums = Words::empty(&client, 9 * bins.capacity);
        blend_backward::blend_backward::launch(
            &client,
            cubes(segments(bins.capacity, tiles_x * tiles_y), 1),
            CubeDim::new_1d(LINE),
            saved.screen.arg(),
            bins.gaussians.arg(),
            bins.sorted.arg(),
            bins.tiles.arg(),
            saved.used.arg(),
            saved.states.arg(),
            arg(&saved.image),
            arg(&rows(grad_image)),
            sums.arg(),
            settings.camera.width as u32,
            settings.camera.height as u32,
            tiles_x as u32,
            (tiles_x * tiles_y) as u32,
        );
        blend_backward::clear_unlisted::launch(
            &client,
            cubes(1, 1),
            CubeDim::new_1d(UNITS),
            bins.sorted.arg(),
            bins.tiles.arg(),
            bins.starts.arg(),
            sums.arg(),
            (tiles_x * tiles_y) as u32,
            n as u32,
            bins.capacity as u32,
        );
        let out_source = source.empty_like();
        let [out_means, out_offsets] = [3, 2].map(|width| empty_f32(&means, [n, width]));
        let (out_logits, out_sh) = (empty_f32(&means, [n]), empty_f32(&means, [n, sh_stride, 3]));
        let camera = Words::f32s(&client, &project::camera_words(&settings));
        project_backward::project_backward::launch(
            &client,
            cubes(n, UNITS),
            CubeDim::new_1d(UNITS),
            arg(&means),
            arg(&source.rows),
            source.log_scales(&client),
            arg(&sh),
            camera.arg(),
            saved.screen.arg(),
            bins.order.arg(),
            bins.starts.arg(),
            sums.arg(),
            arg(&out_means),
            arg(&out_source.rows),
            out_source.log_scales(&client),
            arg(&out_logits),
            arg(&out_sh),
            arg(&out_offsets),
            n as u32,
            bins.capacity as u32,
            sh_stride as u32,
            settings.rendering.sh_degree as u32,
            Bands::of_any(sh_stride) == Bands::Even,
            source.entries(),
        );
        SplatTensors {
            means: out_means,
            covariances: out_source.into_tensors(),
            opacity_logits: out_logits,
            sh: out_sh,
            screen_offsets: out_offsets,
        }
    }
}
