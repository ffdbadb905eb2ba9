//! Ground truth of a room that is known by formula.

use monogrid_evaluation::{
    Triangle, TruthConfig, TruthError, TruthGrid, truth_from_points, truth_from_triangles,
};
use monogrid_occupancy::Occupancy;

/// The twelve triangles of a box.
fn cuboid(low: [f64; 3], high: [f64; 3]) -> Vec<Triangle> {
    let corner = |i: usize| -> [f64; 3] {
        std::array::from_fn(|a| if i >> a & 1 == 0 { low[a] } else { high[a] })
    };
    let mut triangles = Vec::new();
    for axis in 0..3 {
        let (u, v) = (1 << ((axis + 1) % 3), 1 << ((axis + 2) % 3));
        for side in [0, 1 << axis] {
            triangles.push([corner(side), corner(side + u), corner(side + u + v)]);
            triangles.push([corner(side), corner(side + u + v), corner(side + v)]);
        }
    }
    triangles
}

/// A room of 2.01 x 1.51 x 1.21 m with a box in it; no wall lies on a boundary of cells.
fn room() -> Vec<Triangle> {
    let mut triangles = cuboid([0.013; 3], [2.023, 1.523, 1.223]);
    triangles.extend(cuboid([0.513, 0.513, 0.013], [0.923, 0.813, 0.613]));
    triangles
}

fn truth(resolution: f64) -> TruthGrid {
    let config = TruthConfig::with_resolution(resolution);
    let truth = truth_from_triangles(&room(), &[[1.5, 1.0, 0.8]], &config).expect("truth");
    assert!(!truth.reaches_border && truth.cameras_in_free_space == 1);
    truth.grid
}

#[test]
fn walls_are_occupied_the_room_is_free_the_rest_is_unknown() {
    let grid = truth(0.02);
    for key in grid.keys_in(Occupancy::Unknown) {
        let p = grid.center(key);
        let in_box = p[0] > 0.513 && p[0] < 0.923 && p[1] > 0.513 && p[1] < 0.813 && p[2] < 0.613;
        let in_room = p[0] > 0.013 && p[0] < 2.023 && p[1] > 0.013 && p[1] < 1.523;
        let in_room = in_room && p[2] > 0.013 && p[2] < 1.223;
        assert!(in_box || !in_room, "{p:?} is in the air");
    }
    let wall = |p: [f64; 3]| grid.state(grid.key(p).expect("finite"));
    assert_eq!(wall([0.013, 1.0, 1.0]), Occupancy::Occupied);
    assert_eq!(wall([1.0, 1.0, 1.223]), Occupancy::Occupied);
    assert_eq!(wall([0.6, 0.6, 0.613]), Occupancy::Occupied);
    assert_eq!(wall([0.7, 0.7, 0.3]), Occupancy::Unknown);
    assert_eq!(wall([0.03, 0.03, 0.03]), Occupancy::Free);
    // Free volume to within the cells that surfaces fill.
    let volume = grid.counts().free as f64 * 0.02_f64.powi(3);
    let expected = 2.01 * 1.51 * 1.21 - 0.41 * 0.3 * 0.6;
    assert!(
        volume < expected && volume > 0.9 * expected,
        "{volume} of {expected}"
    );
}

#[test]
fn coarse_surfaces_equal_the_maximum_over_fine_ones() {
    let (fine, coarse) = (truth(0.02), truth(0.08));
    let derived = fine.coarsened(4).expect("a factor");
    assert_eq!(derived.resolution(), 0.08);
    let occupied = |grid: &TruthGrid| grid.keys_in(Occupancy::Occupied).collect::<Vec<_>>();
    assert_eq!(occupied(&derived), occupied(&coarse));
    let twice = fine
        .coarsened(2)
        .and_then(|g| g.coarsened(2))
        .expect("two factors");
    assert_eq!(occupied(&twice), occupied(&derived));
    assert_eq!(twice.counts().free, derived.counts().free);
}

#[test]
fn a_dense_cloud_gives_nearly_the_same_as_the_mesh() {
    let spacing = 0.009;
    let mut points = Vec::new();
    for triangle in room() {
        let [a, b, c] = triangle;
        let steps = (3.0 / spacing) as usize;
        for i in 0..=steps {
            for j in 0..=steps - i {
                let (u, v) = (i as f64 / steps as f64, j as f64 / steps as f64);
                points.push(std::array::from_fn(|k| {
                    a[k] + u * (b[k] - a[k]) + v * (c[k] - a[k])
                }));
            }
        }
    }
    let config = TruthConfig::with_resolution(0.02);
    let cloud = truth_from_points(&points, &[[1.5, 1.0, 0.8]], &config).expect("truth");
    let mesh = truth(0.02);
    assert!(!cloud.reaches_border);
    let missing = mesh
        .keys_in(Occupancy::Occupied)
        .filter(|k| cloud.grid.state(*k) != Occupancy::Occupied)
        .count();
    assert_eq!(missing, 0);
    assert_eq!(cloud.grid.counts().free, mesh.counts().free);
}

#[test]
fn a_splat_fills_the_gaps_of_a_sparse_cloud() {
    let points: Vec<[f64; 3]> = (0..20)
        .flat_map(|i| (0..20).map(move |j| [0.05 * f64::from(i), 0.05 * f64::from(j), 0.0]))
        .collect();
    let config = TruthConfig {
        splat_radius: 0.036,
        ..TruthConfig::with_resolution(0.01)
    };
    let truth = truth_from_points(&points, &[[0.5, 0.5, 0.1]], &config).expect("truth");
    assert!(truth.reaches_border, "a plane closes nothing off");
    for i in 0..95 {
        let key = [i, i, 0];
        assert_eq!(truth.grid.state(key), Occupancy::Occupied, "{key:?}");
    }
}

#[test]
fn truth_survives_the_way_through_an_occupancy_map() {
    let grid = truth(0.05);
    let map = grid.to_map().expect("a map");
    let back = TruthGrid::from_map(&map, 1 << 30).expect("a grid");
    for state in [Occupancy::Free, Occupancy::Occupied] {
        assert!(grid.keys_in(state).eq(back.keys_in(state)));
    }
}

#[test]
fn bad_input_is_named() {
    let config = TruthConfig::with_resolution(0.05);
    let nothing = truth_from_triangles(&[], &[[0.0; 3]], &config);
    assert_eq!(nothing, Err(TruthError::NothingKnown));
    let cameras = [[0.6, 0.6, 0.613], [0.013, 0.6, 0.6], [0.063, 0.6, 0.6]];
    let outside = truth_from_triangles(&room(), &cameras, &config);
    let expected = TruthError::NoFreeCamera {
        cameras: 3,
        in_surface: 2,
        near_surface: 1,
    };
    assert_eq!(outside, Err(expected));
    let nan = [[[f64::NAN; 3]; 3]];
    assert!(matches!(
        truth_from_triangles(&nan, &[], &config),
        Err(TruthError::Point { index: 0, .. })
    ));
    let huge = TruthConfig {
        max_cells: 1000,
        ..config
    };
    assert!(matches!(
        truth_from_triangles(&room(), &[[1.0; 3]], &huge),
        Err(TruthError::TooManyCells {
            max_cells: 1000,
            ..
        })
    ));
}

#[test]
fn triangles_that_lie_in_one_another_are_refused() {
    let config = TruthConfig {
        max_cells: 1 << 20,
        ..TruthConfig::with_resolution(0.04)
    };
    let room = room();
    let camera = [[1.5, 1.0, 0.8]];
    assert!(truth_from_triangles(&room, &camera, &config).is_ok());
    let many: Vec<Triangle> = room.iter().copied().cycle().take(24 * 100).collect();
    let error = truth_from_triangles(&many, &camera, &config);
    assert!(
        matches!(
            error,
            Err(TruthError::TooMuchSurface {
                max_cells: 131_072,
                ..
            })
        ),
        "{error:?}"
    );
}
