//! What the methods need before a click: colours, masks, affinity fields, and the baselines' features and votes. Each
//! method is timed for all that it needs, masks too.

use super::methods::Method;
use super::run::{MaskKind, SegmentOptions};
use super::truth::Labelled;
use crate::data::Truth;
use crate::data::paths::{Lens, biased, training_cameras};
use crate::model::{GaussiansAt, Scene};
use crate::segment::baselines::saga::{self, SagaModel};
use crate::segment::baselines::sagd::SagdView;
use crate::segment::coarse::{Coarse, coarse};
use crate::segment::fine::network::Frame;
use crate::segment::fine::views::{FineView, read_views};
use crate::segment::fine::{AffinityField, train as fine};
use crate::segment::masks::make::{MaskJob, Shot, make_masks};
use crate::segment::masks::source::{Group, MaskSource, labels::Labels, regions::Regions};
use crate::segment::masks::{MaskReader, RegionOptions};
use burn::tensor::Device;
use glam::DVec3;
use std::collections::HashMap;
use std::path::Path;
use std::time::Instant;

/// What clicks are put to.
pub struct Trained {
    /// Gaussians by colour.
    pub coarse: Coarse,
    /// Field trained on masks of each colour alone.
    pub parts: Option<(AffinityField, Frame)>,
    /// Field trained on masks of the whole scene.
    pub whole: Option<(AffinityField, Frame)>,
    /// SAGA's features.
    pub saga: Option<SagaModel>,
    /// SAGD's masks.
    pub votes: Option<Vec<SagdView>>,
    /// Seconds by method.
    pub seconds: HashMap<Method, f64>,
}

/// How to get there.
pub struct Trainers<'a> {
    /// The scene.
    pub scene: &'a Scene,
    /// What is known.
    pub truth: &'a Truth,
    /// The Gaussians at the time of the clicks.
    pub at: &'a GaussiansAt,
    /// Labelled views of that time.
    pub views: &'a [Labelled],
    /// What is asked for.
    pub options: &'a SegmentOptions,
    /// Folder for masks.
    pub work: &'a Path,
    /// Where to draw and train.
    pub device: &'a Device,
}

impl Trainers<'_> {
    /// Makes all that the chosen methods need.
    pub fn train(&self, time: f64, say: &mut impl FnMut(&str)) -> Result<Trained, String> {
        let wants = |m: Method| self.options.methods.contains(&m);
        let mut seconds = HashMap::new();
        say("coarse: colours");
        let started = Instant::now();
        let largest = self.scene.largest_opacity(&self.options.coarse.hidden(self.at));
        let coarse = coarse(self.at, Some(&largest), &self.options.coarse).map_err(|e| e.to_string())?;
        let coarse_seconds = started.elapsed().as_secs_f64();
        seconds.insert(Method::Coarse, coarse_seconds);
        let frame = Frame::around(&self.at.visible_means());
        let mut trained = Trained { coarse, parts: None, whole: None, saga: None, votes: None, seconds };

        if wants(Method::CoarseFine) {
            let started = Instant::now();
            let name = |(label, entry): (u32, &crate::segment::palette::PaletteEntry)| Group {
                name: entry.name.clone(),
                members: (0..).zip(&trained.coarse.labels).filter(|(_, l)| **l == label).map(|(i, _)| i).collect(),
            };
            let groups: Vec<Group> = (1..).zip(&trained.coarse.palette).map(name).collect();
            let masks = self.masks(&groups, "parts.jsonl", time, say)?;
            let views = self.fine_views(&masks, &groups, &frame)?;
            trained.parts = Some((self.field(&views, "coarse+fine", say)?, frame));
            trained.seconds.insert(Method::CoarseFine, coarse_seconds + started.elapsed().as_secs_f64());
        }
        if wants(Method::Fine) || wants(Method::Saga) || wants(Method::Sagd) {
            let started = Instant::now();
            let all = [Group { name: "scene".into(), members: (0..self.at.len() as u32).collect() }];
            let masks = self.masks(&all, "whole.jsonl", time, say)?;
            let mask_seconds = started.elapsed().as_secs_f64();
            if wants(Method::Sagd) {
                trained.votes = Some(votes(&masks)?);
                trained.seconds.insert(Method::Sagd, started.elapsed().as_secs_f64());
            }
            let started = Instant::now();
            let views = self.fine_views(&masks, &all, &frame)?;
            let before = mask_seconds + started.elapsed().as_secs_f64();
            if wants(Method::Fine) {
                let started = Instant::now();
                trained.whole = Some((self.field(&views, "fine", say)?, frame));
                trained.seconds.insert(Method::Fine, before + started.elapsed().as_secs_f64());
            }
            if wants(Method::Saga) {
                say(&format!("saga: {} steps", self.options.saga.steps));
                let started = Instant::now();
                let model = saga::train(&views, &self.at.means, &self.options.saga, |_, _| true);
                trained.saga = Some(model.map_err(|e| e.to_string())?);
                trained.seconds.insert(Method::Saga, before + started.elapsed().as_secs_f64());
            }
        }
        Ok(trained)
    }

    fn masks(&self, groups: &[Group], file: &str, time: f64, say: &mut impl FnMut(&str)) -> Result<MaskReader, String> {
        let first = self.views.first().ok_or("no labelled views at this time")?;
        let (shots, source): (Vec<Shot>, Box<dyn MaskSource>) = match self.options.masks {
            MaskKind::Labels => {
                let shot = |v: &Labelled| Shot { file: v.view.name.clone(), camera: v.view.camera.clone() };
                let views = self.views.iter().map(|v| v.view.clone()).collect();
                (self.views.iter().map(shot).collect(), Box::new(Labels::new(self.truth.clone(), views)))
            }
            MaskKind::Regions => {
                let camera = &first.view.camera;
                let lens = Lens { fov_x: camera.fov_x(), width: camera.width, height: camera.height };
                let centre = DVec3::from_array(self.scene.spec.centre.map(f64::from));
                let (views, radius) = (self.options.views, camera.position().distance(centre));
                let cameras = match self.options.bias {
                    Some((axis, angle)) => biased(views, radius, axis, angle, lens),
                    None => training_cameras(views, radius, lens),
                };
                (Shot::numbered(cameras), Box::new(Regions::new(self.scene.spec.background, RegionOptions::default())))
            }
        };
        say(&format!(
            "masks of {} in {} views",
            groups.iter().map(|g| g.name.as_str()).collect::<Vec<_>>().join(", "),
            shots.len()
        ));
        let job = MaskJob {
            at: self.at,
            groups,
            shots: &shots,
            time,
            background: self.scene.spec.background,
            sh_degree: self.scene.spec.sh_degree,
            device: self.device,
        };
        let path = self.work.join(file);
        make_masks(&job, source.as_ref(), &path, |_, _| true).map_err(|e| e.to_string())?;
        MaskReader::open(&path).map_err(|e| e.to_string())
    }

    fn fine_views(&self, masks: &MaskReader, groups: &[Group], frame: &Frame) -> Result<Vec<FineView>, String> {
        let members: Vec<Vec<u32>> = groups.iter().map(|g| g.members.clone()).collect();
        let seed = self.options.fine.seed;
        let views = read_views(masks, self.at, frame, &members, seed, self.device, |_| {});
        Ok(views.map_err(|e| e.to_string())?.0)
    }

    fn field(&self, views: &[FineView], name: &str, say: &mut impl FnMut(&str)) -> Result<AffinityField, String> {
        say(&format!("{name}: {} steps", self.options.fine.steps));
        fine::train(views, &self.options.fine, self.device, |_, _| true).map_err(|e| e.to_string())
    }
}

/// The masks of each view, for votes.
fn votes(masks: &MaskReader) -> Result<Vec<SagdView>, String> {
    let header = masks.header();
    let views = header.views.iter().enumerate();
    views
        .map(|(i, view)| {
            let found = masks.view(i).map_err(|e| e.to_string())?;
            let camera = view.camera(header.width, header.height).to_kernel();
            Ok(SagdView { camera, masks: found.into_iter().map(|a| a.mask).collect() })
        })
        .collect()
}
