//! Segments of a scene: found by colour, by masks and by clicks ([`segment`]), followed through time ([`track`]) and
//! edited ([`edit`]).
//!
//! ```text
//! coarse:   material's colour over directions, averaged with similar ones of the neighbours over time
//!           -> modes of their density -> vote
//!           -> surface layers are merged into what they cover                                       segments.safetensors
//!           (or mean colour -> k-means) -> palette; outliers by neighbours in a radius
//! masks:    each segment alone from N views -> a source (regions, labels, dir, sam) -> COCO runs    masks.jsonl, streamed
//! fine:     contributors of sampled pixels -> encoded position + scale -> MLP -> features summed by weight
//!           -> contrast by mask; scales are ranks of the 3D spreads of the masks                     affinity.safetensors
//! split:    features at a scale -> HDBSCAN or k-means                                               segments.safetensors
//! pick:     the segment with most of the pixel -> levels: its piece there, or the part of it separated by the affinity or
//!           a neck; the whole segment; the object across segments; plateaus of the affinity
//!           -> Gaussians that appear in it at other times                                           segments.safetensors
//! track:    the same Gaussians at other times -> connected components -> events, statistics         track/NAME/
//! edit:     operations on names -> applied afresh to the Gaussians of each time drawn               edits.json
//! ```
//!
//! A click goes through `volseggs::run::pick` to [`segment::pick`], which `volseggs::eval::segments` calls too. There, `select` and `setting`
//! (the fixed settings) know nothing of the ground truth; it is used by `prompt` to place clicks, by `oracle` to choose
//! among settings, and by `volume` and `measure` for comparison, in space and in images.
//!
//! A segment is a list of indices into the scene's Gaussians, tied to the scene by its fingerprint: a scene that was
//! trained further since is refused.

#![deny(clippy::print_stdout, clippy::print_stderr)] // they panic on a closed pipe; see `volseggs_base::terminal`

pub mod edit;
pub mod segment;
pub mod track;

use volseggs_base::{csv, draw, files, memory, name, points, rng, tensors, versioned, words};
use volseggs_core::{config, device, export, model, train};
use volseggs_volume::{data, volume};
