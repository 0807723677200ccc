//! Point clouds: clustering, neighbours, outliers, connected components. Results do not depend on the number of
//! threads. Nothing here reads files, renders images, or knows what the points stand for.

pub(crate) mod chunks;
pub mod components;
pub mod error;
pub(crate) mod flood;
pub mod hdbscan;
pub mod kmeans;
pub mod modes;
pub mod moving;
pub mod nearest_rows;
pub mod neighbours;
pub mod outliers;
pub mod principal;
pub mod regions;
pub mod sampling;
pub mod suggest;
pub(crate) mod union_find;

pub use error::PointsError;
