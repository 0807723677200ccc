//! When the components of a segment appear, vanish, split and merge. The overlap of components is measured in
//! `overlap`; the components of one time are found by `points::components`.

pub use super::event::{EventConfig, EventKind, SegmentAtTime, SegmentEvent, TrackPoint, Tracking};
use super::overlap::{Graph, LabelSum, OverlapNodes, SharedOpacity, label_sums, usable};
use crate::points::PointsError;
use crate::points::chunks::map_chunks;
use crate::points::error::check_len;
use rayon::prelude::*;
use std::collections::BTreeMap;

/// Finds the events between consecutive `frames`, and the track of every component.
///
/// Components of two times are linked by the Gaussians they share, weighted by opacity. A track is a run of one-to-one
/// links; a component with several successors splits, one with several predecessors is a merge, and one with none
/// appears or vanishes. Flicker is suppressed: components under `min_share` are ignored; a part that lives for fewer
/// than `persistence` times, and a merger undone within as many, are skipped by linking what is before to what is
/// after; an absence shorter than that is bridged. A change is reported only if its new state is seen for `persistence`
/// times, so never within that many times of the ends. A part that flickers at every time is skipped entirely. Frames
/// in reverse order give the mirrored events: split for merge, appear for vanish, parents for children.
///
/// # Errors
/// If frames have different numbers of Gaussians, a label is above that number, a share is outside 0..=1, or the
/// persistence is 0.
pub fn find_events(frames: &[SegmentAtTime<'_>], config: &EventConfig) -> Result<Tracking, PointsError> {
    check(frames, config)?;
    if frames.is_empty() {
        return Ok(Tracking::default());
    }
    let persistence = config.persistence;
    let totals: Vec<f64> = frames.par_iter().map(|f| f.opacity.iter().map(|&o| usable(o)).sum()).collect();
    let most = totals.iter().copied().fold(0.0, f64::max);
    let present: Vec<bool> = totals.iter().map(|&t| t > 0.0 && t >= config.presence_share * most).collect();
    let sums: Vec<Vec<LabelSum>> = frames.par_iter().map(label_sums).collect();
    let mut nodes = OverlapNodes::new(&sums, &present, config.min_share);

    let graph = nodes.links(frames, persistence, config.min_share);
    let lives = nodes.chain_lengths(&nodes.strongest(&graph));
    nodes.kept = lives.iter().map(|&life| life >= persistence).collect();
    let graph = nodes.links(frames, persistence, config.min_share);
    drop_brief_mergers(&mut nodes, &graph, persistence, frames.len());
    let graph = nodes.links(frames, persistence, config.min_share);

    let heads = nodes.chains(&nodes.only(&graph));
    let mut tracks = vec![0u32; nodes.list.len()];
    let mut next = 0;
    for node in (0..nodes.list.len()).filter(|&n| nodes.kept[n]) {
        if heads[node] == node {
            next += 1;
        }
        tracks[node] = if heads[node] == node { next } else { tracks[heads[node]] };
    }
    let lasting = nodes.chain_lengths(&nodes.only(&graph));
    let history = TrackHistory { frames, nodes: &nodes, graph: &graph, tracks: &tracks, lasting, persistence };
    let mut events = history.component_events();
    events.extend(history.segment_events(&present));
    events.extend(history.continuations());
    let index = |time: f64| frames.iter().position(|f| f.time == time);
    events
        .sort_by_cached_key(|e| (index(e.time_from), index(e.time_to), e.kind, e.parents.clone(), e.children.clone()));
    Ok(Tracking { events, points: history.points(&sums) })
}

fn check(frames: &[SegmentAtTime<'_>], config: &EventConfig) -> Result<(), PointsError> {
    for (field, share) in [("min_share", config.min_share), ("presence_share", config.presence_share)] {
        if !(0.0..=1.0).contains(&share) {
            return Err(PointsError::Setting { field, value: share.to_string(), want: "a fraction from 0 to 1" });
        }
    }
    if config.persistence == 0 {
        return Err(PointsError::Setting { field: "persistence", value: "0".into(), want: "at least 1" });
    }
    let count = frames.first().map_or(0, |f| f.labels.len());
    for frame in frames {
        check_len("labels", frame.labels.len(), count, "[S], the same at all times")?;
        check_len("opacity", frame.opacity.len(), count, "[S], the same at all times")?;
        if let Some(label) = frame.labels.iter().find(|&&l| l as usize > count) {
            let value = label.to_string();
            return Err(PointsError::Setting { field: "labels", value, want: "at most the number of Gaussians" });
        }
    }
    Ok(())
}

/// Drops runs shorter than `persistence` into which several steady components merge (or with which the series starts)
/// and from which several steady ones emerge (or with which it ends), so that each of those is linked to its own
/// continuation.
fn drop_brief_mergers(nodes: &mut OverlapNodes, graph: &Graph, persistence: usize, times: usize) {
    let only = nodes.only(graph);
    let (heads, lengths) = (nodes.chains(&only), nodes.chain_lengths(&only));
    let steady = |list: &[super::overlap::SharedOpacity]| list.iter().all(|s| lengths[s.other] >= persistence);
    let mut dropped = Vec::new();
    for tail in (0..only.len()).filter(|&n| nodes.kept[n] && only[n].is_none() && lengths[n] < persistence) {
        let head = heads[tail];
        let (parents, children) = (&graph.parents[head], &graph.children[tail]);
        let merged = parents.len() > 1 || (parents.is_empty() && nodes.list[head].time == 0);
        let parted = children.len() > 1 || (children.is_empty() && nodes.list[tail].time + 1 == times);
        if merged && parted && parents.len() + children.len() > 1 && steady(parents) && steady(children) {
            dropped.push(head);
        }
    }
    for node in 0..only.len() {
        nodes.kept[node] &= !dropped.contains(&heads[node]);
    }
}

/// Everything known once the links are final.
struct TrackHistory<'a> {
    frames: &'a [SegmentAtTime<'a>],
    nodes: &'a OverlapNodes,
    graph: &'a Graph,
    tracks: &'a [u32],
    /// Number of times that the track of each node lasts.
    lasting: Vec<usize>,
    persistence: usize,
}

impl TrackHistory<'_> {
    fn event(&self, kind: EventKind, from: usize, to: usize, parents: &[usize], children: &[usize]) -> SegmentEvent {
        let tracks = |list: &[usize]| list.iter().map(|&n| self.tracks[n]).collect();
        let weights = |list: &[usize]| list.iter().map(|&n| self.nodes.list[n].weight).collect();
        SegmentEvent {
            time_from: self.frames[from].time,
            time_to: self.frames[to].time,
            kind,
            parents: tracks(parents),
            children: tracks(children),
            parent_weights: weights(parents),
            child_weights: weights(children),
            confidence: 1.0,
        }
    }

    /// Enters the confidence of an event that accounts for the share `shared` of its parts' weight; `more` are the
    /// numbers of times that states last which are no track, such as an absence.
    fn sure(&self, event: SegmentEvent, nodes: &[usize], more: Option<usize>, shared: f64) -> SegmentEvent {
        let lasting = nodes.iter().map(|&n| self.lasting[n]).chain(more).min().unwrap_or(0);
        let confidence = shared.clamp(0.0, 1.0) * lasting as f64 / (lasting + self.persistence) as f64;
        SegmentEvent { confidence, ..event }
    }

    /// The least share of weight, of `node` and of each of the parts that it is linked to, that the links carry; `own`
    /// and `other` are their ends.
    fn carried(
        &self,
        node: usize,
        links: &[SharedOpacity],
        own: fn(&SharedOpacity) -> f64,
        other: fn(&SharedOpacity) -> f64,
    ) -> f64 {
        let weight = |n: usize| self.nodes.list[n].weight;
        let of_node = links.iter().map(own).sum::<f64>() / weight(node);
        links.iter().map(|s| other(s) / weight(s.other)).fold(of_node, f64::min)
    }

    fn component_events(&self) -> Vec<SegmentEvent> {
        let mut events = Vec::new();
        let time = |n: usize| self.nodes.list[n].time;
        for node in (0..self.nodes.list.len()).filter(|&n| self.nodes.kept[n]) {
            let at = time(node);
            let children: Vec<usize> = self.graph.children[node].iter().map(|s| s.other).collect();
            let parents: Vec<usize> = self.graph.parents[node].iter().map(|s| s.other).collect();
            if children.len() > 1 {
                let to = children.iter().map(|&c| time(c)).max().unwrap_or(at);
                let event = self.event(EventKind::Split, at, to, &[node], &children);
                let carried = self.carried(node, &self.graph.children[node], |s| s.before, |s| s.after);
                events.push(self.sure(event, &[&[node], &children[..]].concat(), None, carried));
            }
            if parents.len() > 1 {
                let from = parents.iter().map(|&p| time(p)).min().unwrap_or(at);
                let event = self.event(EventKind::Merge, from, at, &parents, &[node]);
                let carried = self.carried(node, &self.graph.parents[node], |s| s.after, |s| s.before);
                events.push(self.sure(event, &[&[node], &parents[..]].concat(), None, carried));
            }
            let last = self.frames.len() - 1;
            if children.is_empty()
                && let Some((to, absent)) = self.gone(node, at + 1..=last)
            {
                let event = self.event(EventKind::Vanish, at, to, &[node], &[]);
                events.push(self.sure(event, &[node], Some(absent), 1.0));
            }
            if parents.is_empty()
                && let Some((from, absent)) = self.gone(node, (0..at).rev())
            {
                let event = self.event(EventKind::Appear, from, at, &[], &[node]);
                events.push(self.sure(event, &[node], Some(absent), 1.0));
            }
        }
        events
    }

    /// Returns the first of `times`, going away from the node, from which its absence is certain: times at which at
    /// least half of its weight lies in components that are not kept are skipped, and at least `persistence` times must
    /// be left, whose number is returned too.
    fn gone(&self, node: usize, times: impl Iterator<Item = usize>) -> Option<(usize, usize)> {
        let own = &self.nodes.list[node];
        let frame = &self.frames[own.time];
        let mut absent = times.skip_while(|&time| {
            let other = &self.frames[time];
            let hidden: f64 = (0..frame.labels.len())
                .filter(|&i| frame.labels[i] == own.label)
                .filter(|&i| {
                    self.nodes.at(time, other.labels[i], other.opacity[i]).is_some_and(|n| !self.nodes.kept[n])
                })
                .map(|i| usable(frame.opacity[i]))
                .sum();
            hidden >= 0.5 * own.weight
        });
        let first = absent.next()?;
        let count = absent.count() + 1;
        (count >= self.persistence).then_some((first, count))
    }

    fn segment_events(&self, present: &[bool]) -> Vec<SegmentEvent> {
        let mut events = Vec::new();
        // whether it was present, until when, and for how many times
        let mut before: Option<(bool, usize, usize)> = None;
        let mut start = 0;
        for run in present.chunk_by(|a, b| a == b) {
            if run.len() >= self.persistence {
                if let Some((was, end, lasted)) = before
                    && was != run[0]
                {
                    let at = |time: usize| -> Vec<usize> {
                        let kept = |n: &usize| self.nodes.kept[*n] && self.nodes.list[*n].time == time;
                        (0..self.nodes.list.len()).filter(kept).collect()
                    };
                    let event = if was {
                        self.event(EventKind::SegmentVanish, end, start, &at(end), &[])
                    } else {
                        self.event(EventKind::SegmentAppear, end, start, &[], &at(start))
                    };
                    events.push(self.sure(event, &[], Some(lasted.min(run.len())), 1.0));
                }
                before = Some((run[0], start + run.len() - 1, run.len()));
            }
            start += run.len();
        }
        events
    }

    fn continuations(&self) -> Vec<SegmentEvent> {
        let mut ends: BTreeMap<u32, (usize, usize)> = BTreeMap::new();
        for node in (0..self.nodes.list.len()).filter(|&n| self.nodes.kept[n]) {
            ends.entry(self.tracks[node]).or_insert((node, node)).1 = node;
        }
        ends.into_values()
            .filter(|(first, last)| first != last)
            .map(|(first, last)| {
                let times = (self.nodes.list[first].time, self.nodes.list[last].time);
                let event = self.event(EventKind::Continue, times.0, times.1, &[first], &[last]);
                self.sure(event, &[last], None, 1.0)
            })
            .collect()
    }

    fn points(&self, sums: &[Vec<LabelSum>]) -> Vec<TrackPoint> {
        let lent = self.lent_tracks();
        let mut known = BTreeMap::new();
        for (node, n) in self.nodes.list.iter().enumerate().filter(|(n, _)| self.nodes.kept[*n]) {
            known.insert((n.time, n.label), self.tracks[node]);
        }
        let mut points = Vec::new();
        for (time, labels) in sums.iter().enumerate() {
            for (label, sum) in labels.iter().enumerate().filter(|(_, s)| s.weight > 0.0) {
                let key = (time, label as u32);
                let own = known.get(&key);
                let track = own.or_else(|| lent.get(&key)).copied().unwrap_or(0);
                let weight = sum.weight;
                points.push(TrackPoint {
                    time: self.frames[time].time,
                    component: key.1,
                    track,
                    weight,
                    lent: own.is_none() && track > 0,
                });
            }
        }
        points
    }

    /// Returns, for components that are not kept nodes, the track that most of their weight has before and after.
    fn lent_tracks(&self) -> BTreeMap<(usize, u32), u32> {
        let track_at = |time: usize, i: usize| {
            let frame = &self.frames[time];
            let node = self.nodes.at(time, frame.labels[i], frame.opacity[i])?;
            self.nodes.kept[node].then(|| self.tracks[node])
        };
        let parts = map_chunks(self.frames[0].labels.len(), |range| {
            let mut votes: BTreeMap<(usize, u32, u32), f64> = BTreeMap::new();
            for i in range {
                let mut vote = |time: usize, last: &mut Option<u32>| {
                    let (label, opacity) = (self.frames[time].labels[i], self.frames[time].opacity[i]);
                    if let Some(track) = track_at(time, i) {
                        *last = Some(track);
                    } else if let (Some(track), true) = (*last, label > 0 && usable(opacity) > 0.0) {
                        *votes.entry((time, label, track)).or_default() += usable(opacity);
                    }
                };
                let (mut before, mut after) = (None, None);
                (0..self.frames.len()).for_each(|time| vote(time, &mut before));
                (0..self.frames.len()).rev().for_each(|time| vote(time, &mut after));
            }
            votes
        });
        let mut votes: BTreeMap<(usize, u32, u32), f64> = BTreeMap::new();
        parts.into_iter().flatten().for_each(|(key, weight)| *votes.entry(key).or_default() += weight);
        let mut best: BTreeMap<(usize, u32), (f64, u32)> = BTreeMap::new();
        for ((time, label, track), weight) in votes {
            let entry = best.entry((time, label)).or_insert((weight, track));
            if weight > entry.0 {
                *entry = (weight, track);
            }
        }
        best.into_iter().map(|(key, (_, track))| (key, track)).collect()
    }
}

#[cfg(test)]
#[path = "events_tests.rs"]
mod tests;
