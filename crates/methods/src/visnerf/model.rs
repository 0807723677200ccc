//! A trained model: grids and networks in a box, and how images are rendered from them.

use super::grid::{BatchTimes, mixture, neighbours};
use super::network::{VisNerfNetwork, parameters};
use super::occupancy::OccupancyGrid;
use super::rays::RayCamera;
use crate::file;
use crate::learner::plain;
use crate::visnerf::VisNerfConfig;
use burn::module::Module;
use burn::tensor::{Device, Tensor, TensorData};
use glam::DVec3;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::Path;
use volseggs_core::model::params::{self, HostTensor, to_vec};
use volseggs_core::model::{Counts, Model, SceneError};
use volseggs_kernels::PinholeCamera;
use volseggs_kernels::march::{Box3, Ray, RaySamples, Samples, cpu, sample};
use volseggs_volume::data::hull::{Aabb, HullOptions, VisualHull};
use volseggs_volume::data::{DataError, Split};

/// The name of the method, of its configuration section and of the header entry in its file.
pub(super) const NAME: &str = "visnerf";

/// The tensor of the file that is not a parameter.
const OCCUPANCY: &str = "occupancy";

/// Number of rays drawn at a time.
const PART: usize = 4096;
/// Number of positions that the networks evaluate at a time: their inputs take some 80 MB.
const PLACES: usize = 131_072;

/// What the tensors do not determine.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct VisNerfSpec {
    /// Settings.
    pub config: VisNerfConfig,
    /// Centre of the box, scene units.
    pub centre: [f32; 3],
    /// Half the side lengths of the box, scene units.
    pub half: [f32; 3],
    /// Nodes of the grids along each axis.
    pub resolution: [usize; 3],
    /// The first and the last training time.
    pub ends: [f64; 2],
    /// Number of training times, assumed to be evenly spaced.
    pub knots: usize,
    /// Background colour of the training images.
    pub background: [f32; 3],
}

impl VisNerfSpec {
    /// The spec for training on a split: the box of the visual hull with its margin, divided into voxels that are as
    /// nearly cubic as whole numbers of them allow.
    ///
    /// # Errors
    /// If the hull is empty.
    pub fn new(config: &VisNerfConfig, split: &Split, background: [f32; 3]) -> Result<Self, DataError> {
        let hull = VisualHull::carve(split, &HullOptions::default())?;
        let bounds: Aabb = hull.bounds.grown(config.bounds_margin);
        let size = bounds.size().max(DVec3::splat(1e-6));
        let voxel = (size.element_product() / config.voxels as f64).cbrt();
        let times = split.times();
        Ok(Self {
            config: config.clone(),
            centre: bounds.centre().as_vec3().to_array(),
            half: (0.5 * size).as_vec3().to_array(),
            resolution: size.to_array().map(|side| ((side / voxel) as usize).max(2)),
            ends: [times.first().copied().unwrap_or(0.0), times.last().copied().unwrap_or(0.0)],
            knots: times.len().max(1),
            background,
        })
    }

    /// The box.
    pub fn bounds(&self) -> Box3 {
        Box3 { centre: self.centre, half: self.half }
    }

    /// Fraction of the way from the first to the last training time at which `time` lies.
    pub fn part(&self, time: f64) -> f64 {
        let [first, last] = self.ends;
        if last > first { (time - first) / (last - first) } else { 0.0 }
    }

    /// The distance between samples in rendered images, scene units, and the number that fit into the box's diagonal.
    pub fn render_step(&self) -> (f32, usize) {
        let voxel = (0..3).map(|k| 2.0 * self.half[k] / (self.resolution[k] - 1) as f32).sum::<f32>() / 3.0;
        let step = voxel * self.config.render_step as f32;
        let diagonal = 2.0 * self.half.iter().map(|v| v * v).sum::<f32>().sqrt();
        (step, (diagonal / step) as usize + 1)
    }

    /// Rejects values that no training produces, since a file may hold anything.
    fn check(&self) -> Result<(), String> {
        self.config.check()?;
        let numbers = self.centre.iter().chain(&self.half).chain(&self.background);
        let are_finite = numbers.copied().all(f32::is_finite) && self.ends.iter().all(|v| v.is_finite());
        if !are_finite || self.half.iter().any(|v| *v <= 0.0) {
            return Err("the box, times and background must be finite, half sides above 0".into());
        }
        if self.knots == 0 || self.resolution.iter().any(|n| *n < 2) {
            return Err("there must be at least one time, and two nodes along each axis".into());
        }
        Ok(())
    }
}

/// Grids and networks with the box that they represent.
#[derive(Module, Debug)]
pub struct VisNerf {
    /// What is trained.
    pub network: VisNerfNetwork,
    /// The occupied cells.
    #[module(skip)]
    pub occupancy: OccupancyGrid,
    /// Everything else.
    #[module(skip)]
    pub spec: VisNerfSpec,
}

impl VisNerf {
    /// A model with random weights.
    pub fn new(spec: VisNerfSpec, seed: u64, device: &Device) -> Self {
        let network = VisNerfNetwork::new(&spec.config, spec.resolution, spec.knots, seed, device);
        Self { network, occupancy: OccupancyGrid::unknown(), spec }
    }

    /// Opens the file of a model.
    ///
    /// # Errors
    /// If the file is missing or damaged, holds a NaN or an infinity, or belongs to another method.
    pub fn read(path: &Path, device: &Device) -> Result<Self, SceneError> {
        let mut file = file::read::<VisNerfSpec>(path, NAME)?;
        let occupancy = file.tensors.remove(OCCUPANCY);
        let spec = file.spec.clone();
        spec.check().map_err(|e| file::wrong(path, format!("header: {e}")))?;
        file.check_size(path, parameters(&spec.config, spec.resolution, spec.knots))?;
        let occupancy = OccupancyGrid::from_tensor(occupancy.as_ref(), spec.config.occupancy, spec.knots);
        let model = file.fill(path, Self::new(spec, 0, device))?;
        Ok(Self { occupancy: occupancy.map_err(|e| file::wrong(path, e))?, ..model })
    }

    /// Marks the cells in which the networks have density, at each training time.
    pub fn occupied(&self) -> OccupancyGrid {
        let (network, device) = plain(&self.network);
        let spec = &self.spec;
        let side = spec.config.occupancy;
        let centres = OccupancyGrid::centres(side);
        let distance = spec.config.distance_scale as f32 * spec.render_step().0;
        let least = spec.config.occupancy_threshold as f32;
        let at = |knot: usize| -> Vec<bool> {
            let mut mixture = vec![0.0; spec.knots];
            mixture[knot] = 1.0;
            let densities = centres.chunks(3 * PLACES).flat_map(|places| {
                let times = BatchTimes::new(std::slice::from_ref(&mixture), &vec![0; places.len() / 3], &device);
                to_vec(network.densities(places, &times, &device))
            });
            densities.map(|density| 1.0 - (-density * distance).exp() > least).collect()
        };
        OccupancyGrid::new(side, (0..spec.knots).map(at).collect())
    }

    /// Colour and alpha of rays at one time, `[R, 4]`.
    fn see(&self, network: &VisNerfNetwork, rays: &[Ray], time: f64, device: &Device) -> Vec<f32> {
        let spec = &self.spec;
        let part = spec.part(time);
        let knots = neighbours(spec.knots, part);
        let mixture = mixture(spec.knots, part);
        let (step, most) = spec.render_step();
        let Samples { points, offsets } =
            sample(rays, spec.bounds(), step, most, |_, point| self.occupancy.holds(knots, point));
        let times = |n: usize| BatchTimes::new(std::slice::from_ref(&mixture), &vec![0; n], device);
        let distance = spec.config.distance_scale as f32 * step;
        let mut depths = Vec::with_capacity(points.len() / 3);
        for places in points.chunks(3 * PLACES) {
            let densities = network.densities(places, &times(places.len() / 3), device);
            depths.extend(to_vec(densities.mul_scalar(distance)));
        }
        let weights = cpu::weights(&offsets, &depths);
        let coloured: Vec<bool> = weights.iter().map(|w| *w > spec.config.least_weight as f32).collect();
        let (mut places, mut directions) = (Vec::new(), Vec::new());
        for (ray, ends) in rays.iter().zip(offsets.windows(2)) {
            for s in (ends[0] as usize..ends[1] as usize).filter(|s| coloured[*s]) {
                places.extend_from_slice(&points[3 * s..3 * s + 3]);
                directions.extend(ray.direction);
            }
        }
        let mut colours = Vec::with_capacity(places.len());
        for (places, directions) in places.chunks(3 * PLACES).zip(directions.chunks(3 * PLACES)) {
            colours.extend(to_vec(network.colours(places, directions, &times(places.len() / 3), device)));
        }
        let mut out = vec![0.0; 4 * rays.len()];
        cpu::forward(&RaySamples::new(&offsets, &coloured), &depths, &colours, spec.background, &mut out);
        out
    }
}

impl Model for VisNerf {
    fn image(&self, camera: PinholeCamera, time: f32) -> Tensor<3> {
        let (network, device) = plain(&self.network);
        let rays = RayCamera::new(camera);
        let pixels: Vec<usize> = (0..camera.width * camera.height).collect();
        let values: Vec<f32> = pixels
            .chunks(PART)
            .flat_map(|part| {
                let rays: Vec<Ray> = part.iter().map(|at| rays.ray(*at, 0.0)).collect();
                self.see(&network, &rays, f64::from(time), &device)
            })
            .collect();
        Tensor::from_data(TensorData::new(values, [camera.height, camera.width, 4]), &device)
    }

    fn device(&self) -> Device {
        self.network.density.planes.device()
    }

    fn background(&self) -> [f32; 3] {
        self.spec.background
    }

    fn place(&self) -> (DVec3, f64) {
        let half = self.spec.half.into_iter().fold(f32::MIN_POSITIVE, f32::max);
        (DVec3::from_array(self.spec.centre.map(f64::from)), half.into())
    }

    fn counts(&self) -> Counts {
        Counts { parameters: params::sizes(self).values().sum(), primitives: 0 }
    }

    fn parameters(&self) -> BTreeMap<String, HostTensor> {
        params::collect(self)
    }

    fn save(&self, path: &Path) -> Result<(), SceneError> {
        let mut tensors = params::collect(self);
        tensors.extend(self.occupancy.to_tensor().map(|tensor| (OCCUPANCY.to_owned(), tensor)));
        file::save(path, NAME, &tensors, &self.spec)
    }
}
