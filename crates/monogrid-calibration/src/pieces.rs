//! A large scene cut into pieces that are adjusted one by one.

use crate::adjust::{Scene, Sighting};
use monogrid_geometry::median::median;

/// Fewest views that see a point of a piece.
const MIN_VIEWS_OF_POINT: usize = 3;

/// Fewest points and views of a piece.
const MIN_POINTS: usize = 40;
const MIN_VIEWS: usize = 4;

impl Scene {
    /// Pieces of `num_views` views that follow each other, with the points that at least three of
    /// them see; each has its first view at the origin and a median depth of one. What is left at
    /// the end, and pieces of fewer than four views or forty points, are left out. Each is made
    /// when it is asked for: all together are larger than the scene.
    pub fn pieces(&self, num_views: usize) -> impl Iterator<Item = Self> {
        let views = num_views.max(MIN_VIEWS);
        let starts = (0..self.poses.len()).step_by(views);
        starts.filter_map(move |first| self.piece(first, views.min(self.poses.len() - first)))
    }

    /// The piece of `num_views` views from `first` on.
    fn piece(&self, first: usize, num_views: usize) -> Option<Self> {
        let seen = self.sightings.iter().filter_map(|sighting| {
            let view = sighting
                .view
                .checked_sub(first)
                .filter(|&v| v < num_views)?;
            Some(Sighting { view, ..*sighting })
        });
        let seen: Vec<Sighting> = seen.collect();
        let mut piece = Self {
            intrinsics: self.intrinsics,
            poses: Vec::with_capacity(num_views),
            points: Vec::new(),
            sightings: Vec::new(),
        };
        let first_from_world = *self.poses.get(first)?;
        let world_from_first = first_from_world.inverse();
        for of_point in seen.chunk_by(|a, b| a.point == b.point) {
            let Some(point) = of_point.first().and_then(|s| self.points.get(s.point)) else {
                continue;
            };
            if of_point.len() < MIN_VIEWS_OF_POINT {
                continue;
            }
            let index = piece.points.len();
            let renamed = of_point.iter().map(|s| Sighting { point: index, ..*s });
            piece.sightings.extend(renamed);
            piece.points.push(first_from_world * *point);
        }
        let poses = self.poses.iter().skip(first).take(num_views);
        piece
            .poses
            .extend(poses.map(|pose| *pose * world_from_first));
        let is_enough = num_views >= MIN_VIEWS && piece.points.len() >= MIN_POINTS;
        (is_enough && piece.normalise()).then_some(piece)
    }

    /// Brings the median depth to one; false where no point lies in front.
    fn normalise(&mut self) -> bool {
        let depths = self.points.iter().map(|p| p.z);
        let mut in_front: Vec<f64> = depths.filter(|z| *z > 0.0).collect();
        let Some(median) = median(&mut in_front) else {
            return false;
        };
        let scale = 1.0 / median;
        for point in &mut self.points {
            *point *= scale;
        }
        let poses = self.poses.iter();
        self.poses = poses.map(|pose| pose.stretched(scale)).collect();
        true
    }
}

#[cfg(test)]
mod tests {
    use super::{Scene, Sighting};
    use crate::Intrinsics;
    use monogrid_geometry::{Se3, Vec2, Vec3, rotation_exp};

    /// Fifty points in front of twenty-three views that move sideways; each point is seen by six.
    fn scene() -> Scene {
        let intrinsics = Intrinsics::centred(500.0, (640, 480));
        let pose = |k: usize| {
            Se3::new(
                rotation_exp(&Vec3::new(0.0, 0.01 * k as f64, 0.0)),
                Vec3::new(-0.1 * k as f64, 0.0, 0.0),
            )
        };
        let poses: Vec<Se3> = (0..23).map(pose).collect();
        let mut scene = Scene {
            intrinsics,
            poses,
            points: Vec::new(),
            sightings: Vec::new(),
        };
        for k in 0..230 {
            let first = k / 10 % 18;
            scene.points.push(Vec3::new(
                0.1 * first as f64,
                0.1 * (k % 10) as f64 - 0.5,
                3.0 + 0.01 * k as f64,
            ));
            for view in first..first + 6 {
                scene.sightings.push(Sighting {
                    view,
                    point: k,
                    pixel: Vec2::zeros(),
                    bend: Vec2::zeros(),
                });
            }
        }
        for sighting in &mut scene.sightings {
            let in_camera = scene.poses[sighting.view] * scene.points[sighting.point];
            sighting.pixel = intrinsics.project(&in_camera).unwrap();
        }
        scene
    }

    #[test]
    fn pieces_show_what_the_whole_shows() {
        let whole = scene();
        let pieces = whole.pieces(10).collect::<Vec<_>>();
        assert_eq!(pieces.len(), 2, "the last three views are too few");
        for piece in &pieces {
            assert_eq!(piece.poses.len(), 10);
            assert!(piece.poses[0].translation.norm() < 1e-12);
            for sighting in &piece.sightings {
                let in_camera = piece.poses[sighting.view] * piece.points[sighting.point];
                let pixel = piece.intrinsics.project(&in_camera).unwrap();
                assert!((pixel - sighting.pixel).norm() < 1e-9);
            }
            for point in 0..piece.points.len() {
                let seen = piece.sightings.iter().filter(|s| s.point == point).count();
                assert!((3..=6).contains(&seen), "{seen}");
            }
            let mut depths: Vec<f64> = piece.points.iter().map(|p| p.z).collect();
            depths.sort_by(f64::total_cmp);
            assert!((depths[depths.len() / 2] - 1.0).abs() < 1e-12);
        }
    }

    #[test]
    fn too_little_is_no_piece() {
        let mut few = scene();
        few.sightings.retain(|s| s.point % 10 == 0);
        assert!(few.pieces(10).next().is_none());
        let behind = Scene {
            points: vec![-Vec3::z(); 230],
            ..scene()
        };
        assert!(behind.pieces(10).next().is_none());
    }
}
