//! How large cells should be where the scale is not known: from what keyframes see and how
//! precisely.

use crate::{MappingConfig, UprightView};
use monogrid_geometry::median::median;
use serde::Serialize;

/// Edge of a cell over the median depth: 5 cm in a room that is seen from 2.5 m.
const CELL_PER_DEPTH: f64 = 0.02;
/// Cells that all keyframes may look into, counted for each: what a map takes some seconds for.
const MAX_LOOKS: f64 = 4e8;
/// Edges are one of these times a power of ten.
const STEPS: [f64; 4] = [1.0, 2.0, 5.0, 10.0];

/// A cell that follows from the scene.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct SceneCell {
    /// Edge, map units.
    pub edge: f64,
    /// Median over the keyframes of their median depth, map units.
    pub median_depth: f64,
    /// Median of the relative standard deviation of the depth.
    pub relative_sigma: f64,
    /// What decided.
    pub because: CellReason,
}

/// What decides the edge of a cell.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum CellReason {
    /// The distance of the scene: a fiftieth of it.
    Depth,
    /// Finer cells than the depth is precise would hold its errors.
    Precision,
    /// Finer cells would cost too much.
    Cost,
}

impl SceneCell {
    /// One sentence for people; `unit` is that of lengths. How precise the depth is says itself
    /// alone, so that it is said only where `shows_depth`: something else has shown that there is
    /// some.
    #[must_use]
    pub fn reason(&self, unit: &str, shows_depth: bool) -> String {
        let because = match self.because {
            CellReason::Depth => "a fiftieth of that",
            CellReason::Precision => "as fine as the depth is precise",
            CellReason::Cost => "finer ones would cost too much",
        };
        let precision = match shows_depth {
            true => format!("precise to {:.1} %", 100.0 * self.relative_sigma),
            false => "uncertain: the images show no parallax by themselves".to_owned(),
        };
        format!(
            "cells of {} {unit}: the scene is {:.2} away (median), its depth {precision}; \
             {because}",
            self.edge, self.median_depth
        )
    }
}

/// The cell for a scene; `None` without depth.
#[must_use]
pub fn scene_cell(views: &[UprightView], config: &MappingConfig) -> Option<SceneCell> {
    let mut depths = Vec::new();
    let mut sigmas = Vec::new();
    // free space before each: a pyramid
    let mut volume = 0.0;
    for view in views {
        let scale = view.world_from_keyframe.scale;
        let pixels = view.scan.pixels();
        let pixels = pixels.iter().filter(|p| p.idepth > 0.0);
        let mut of_view = Vec::new();
        for pixel in pixels.step_by(7) {
            of_view.push(scale / f64::from(pixel.idepth));
            sigmas.push(f64::from(pixel.sigma_idepth / pixel.idepth));
        }
        if let Some(depth) = median(&mut of_view) {
            let camera = &view.scan.camera;
            let across = camera.width as f64 / camera.pinhole.fx;
            let down = camera.height as f64 / camera.pinhole.fy;
            volume += across * down * depth.min(config.max_range).powi(3) / 3.0;
            depths.push(depth);
        }
    }
    let median_depth = median(&mut depths)?;
    let relative_sigma = median(&mut sigmas)?;
    let candidates = [
        (CELL_PER_DEPTH * median_depth, CellReason::Depth),
        (relative_sigma * median_depth, CellReason::Precision),
        ((volume / MAX_LOOKS).cbrt(), CellReason::Cost),
    ];
    let (edge, because) = candidates
        .into_iter()
        // the first of equal ones
        .rev()
        .max_by(|a, b| a.0.total_cmp(&b.0))?;
    Some(SceneCell {
        edge: rounded(edge)?,
        median_depth,
        relative_sigma,
        because,
    })
}

/// The nearest of 1, 2, 5, 10, 20 ... by ratio.
fn rounded(edge: f64) -> Option<f64> {
    if !edge.is_normal() || edge < 0.0 {
        return None;
    }
    let exponent = edge.log10().floor();
    let distance = |candidate: f64| (candidate / edge).ln().abs();
    STEPS
        .iter()
        // a literal gives the same number on every machine
        .filter_map(|step| format!("{step}e{exponent}").parse::<f64>().ok())
        .min_by(|a, b| distance(*a).total_cmp(&distance(*b)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{KeyframeCamera, KeyframeScan};
    use monogrid_geometry::{Pinhole, Rotation, Sim3, Vec3};
    use monogrid_occupancy::DepthPixel as Measurement;

    const CAMERA: KeyframeCamera = KeyframeCamera {
        pinhole: Pinhole {
            fx: 100.0,
            fy: 100.0,
            cx: 59.5,
            cy: 44.5,
        },
        width: 120,
        height: 90,
    };

    fn cell(depth: f32, relative_sigma: f32, scale: f64, keyframes: usize) -> SceneCell {
        let pixels = (0..100)
            .map(|x| Measurement {
                x,
                y: 0,
                idepth: 1.0 / depth,
                sigma_idepth: relative_sigma / depth,
            })
            .collect();
        let scan = KeyframeScan::of_measurements(0, CAMERA, pixels, 0);
        let view = UprightView {
            scan: &scan,
            image: None,
            world_from_keyframe: Sim3::new(scale, Rotation::identity(), Vec3::zeros()),
        };
        scene_cell(&vec![view; keyframes], &MappingConfig::default()).unwrap()
    }

    #[test]
    fn cells_follow_the_depth_its_precision_and_the_cost() {
        // a room in metres, the same in the units of a keyframe, a road
        for (depth, scale, expected) in [(2.5, 1.0, 0.05), (1.0, 2.5, 0.05), (0.9, 1.0, 0.02)] {
            let found = cell(depth, 0.01, scale, 10);
            assert!((found.edge - expected).abs() < 1e-12, "{found:?}");
            assert_eq!(found.because, CellReason::Depth);
            assert!((found.median_depth - f64::from(depth) * scale).abs() < 1e-6);
        }
        let imprecise = cell(2.5, 0.08, 1.0, 10);
        assert!((imprecise.edge - 0.2).abs() < 1e-12, "{imprecise:?}");
        assert_eq!(imprecise.because, CellReason::Precision);
        // each looks into 5.6 cubic metres
        let many = cell(2.5, 0.01, 1.0, 30_000);
        assert_eq!(many.because, CellReason::Cost, "{many:?}");
        assert!(many.edge > 0.05);
        assert!(many.reason("m", true).contains("cost"));
        assert!(
            many.reason("m", true).contains("precise")
                && !many.reason("m", false).contains("precise")
        );
    }

    #[test]
    fn edges_are_round_numbers() {
        for (edge, expected) in [
            (0.018, 0.02),
            (0.013, 0.01),
            (0.08, 0.1),
            (3.3, 5.0),
            (3.0, 2.0),
        ] {
            assert_eq!(rounded(edge), Some(expected), "{edge}");
        }
        for none in [0.0, f64::NAN, f64::INFINITY, -1.0] {
            assert_eq!(rounded(none), None);
        }
        assert!(scene_cell(&[], &MappingConfig::default()).is_none());
    }
}
