//! Correspondences where a pose predicts them.

use super::view::Landmark;
use crate::Feature;
use monogrid_geometry::{Pinhole, Sim3, Vec2};
use std::collections::BTreeMap;

/// Features in square cells, to find those near a pixel.
pub(super) struct FeatureGrid<'a> {
    features: &'a [Feature],
    cells: Vec<Vec<u32>>,
    columns: i64,
    rows: i64,
}

const CELL_PX: f64 = 20.0;

impl<'a> FeatureGrid<'a> {
    pub(super) fn new(features: &'a [Feature], width: usize, height: usize) -> Self {
        let columns = (width as f64 / CELL_PX).ceil().max(1.0) as i64;
        let rows = (height as f64 / CELL_PX).ceil().max(1.0) as i64;
        let mut grid = Self {
            features,
            cells: vec![Vec::new(); (columns * rows) as usize],
            columns,
            rows,
        };
        for (i, feature) in features.iter().enumerate() {
            let column = ((feature.pixel.x / CELL_PX) as i64).clamp(0, columns - 1);
            let row = ((feature.pixel.y / CELL_PX) as i64).clamp(0, rows - 1);
            grid.cells[(row * columns + column) as usize].push(i as u32);
        }
        grid
    }

    /// Indices of the features within a square around a pixel.
    fn near(&self, pixel: Vec2, radius_px: f64) -> impl Iterator<Item = usize> + '_ {
        let range = |v: f64, count: i64| {
            let first = (((v - radius_px) / CELL_PX).floor() as i64).max(0);
            let last = (((v + radius_px) / CELL_PX).floor() as i64).min(count - 1);
            first..last + 1
        };
        let columns = range(pixel.x, self.columns);
        range(pixel.y, self.rows)
            .flat_map(move |row| columns.clone().map(move |column| (row, column)))
            .flat_map(move |(row, column)| &self.cells[(row * self.columns + column) as usize])
            .map(|i| *i as usize)
            .filter(move |i| (self.features[*i].pixel - pixel).amax() <= radius_px)
    }
}

/// A landmark and the feature that shows it, by their indices.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Pair {
    pub landmark_idx: usize,
    pub feature_idx: usize,
}

/// How [`search`] looks.
#[derive(Clone, Copy, Debug)]
pub(super) struct SearchArea {
    /// Half width of the square, px of the landmark's level.
    pub radius_px: f64,
    /// Most differing bits.
    pub max_distance: u32,
}

/// The most similar feature near the predicted pixel of each landmark, one to one.
pub(super) fn search(
    landmarks: &[Option<Landmark>],
    grid: &FeatureGrid<'_>,
    image_from_keyframe: &Sim3,
    pinhole: &Pinhole,
    area: SearchArea,
) -> Vec<Pair> {
    // best landmark of every feature: (distance, landmark)
    let mut best: BTreeMap<usize, (u32, usize)> = BTreeMap::new();
    for (landmark_idx, landmark) in landmarks.iter().enumerate() {
        let Some(landmark) = landmark else { continue };
        let point = *image_from_keyframe * landmark.point;
        if point.z < Pinhole::MIN_DEPTH {
            continue;
        }
        let pixel = pinhole.project(&point);
        let radius = area.radius_px * (1usize << landmark.feature.level) as f64;
        let distance_to = |i: usize| {
            grid.features[i]
                .descriptor
                .distance(&landmark.feature.descriptor)
        };
        let found = grid
            .near(pixel, radius)
            .map(|i| (distance_to(i), i))
            .min()
            .filter(|(distance, _)| *distance <= area.max_distance);
        if let Some((distance, feature_idx)) = found {
            let entry = best.entry(feature_idx).or_insert((distance, landmark_idx));
            *entry = (*entry).min((distance, landmark_idx));
        }
    }
    let pairs = best
        .into_iter()
        .map(|(feature_idx, (_, landmark_idx))| Pair {
            landmark_idx,
            feature_idx,
        });
    pairs.collect()
}
