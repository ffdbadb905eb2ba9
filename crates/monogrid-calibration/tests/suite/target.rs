//! A camera is found from rendered pictures of a chessboard, and of a grid of tags.
#![allow(clippy::unwrap_used, reason = "a test may panic")]

use monogrid_calibration::target::{
    BoardCollector, BoardSize, BoardView, LensModel, TagGrid, TargetCalibration, TargetConfig,
    TargetError, calibrate, find_board, find_tags,
};
use monogrid_features::Rng;
use monogrid_geometry::{Camera, Distortion, Pinhole, Se3, Vec2, Vec3, rotation_exp};
use monogrid_image::GrayImage;

const SIZE: (usize, usize) = (400, 300);

/// Samples per pixel along each side.
const SAMPLES: usize = 3;

fn camera(focal: f64, distortion: Distortion) -> Camera {
    Camera {
        width: SIZE.0,
        height: SIZE.1,
        pinhole: Pinhole::new(focal, 1.004 * focal, 203.0, 146.0),
        distortion,
    }
}

fn ordinary() -> Camera {
    let distortion = Distortion::RadialTangential {
        k1: -0.21,
        k2: 0.06,
        p1: 0.001,
        p2: -0.002,
        k3: 0.0,
    };
    camera(310.0, distortion)
}

/// A fisheye of some 115 degrees.
fn wide() -> Camera {
    let k = [0.02, -0.01, 0.003, 0.0];
    camera(200.0, Distortion::Equidistant { k })
}

/// Pictures of a chessboard by one camera.
struct Studio {
    /// Directions of all samples; none where the camera sees nothing.
    rays: Vec<Option<Vec3>>,
    board: BoardSize,
}

impl Studio {
    fn new(camera: &Camera, board: BoardSize) -> Self {
        let (wide, high) = (SIZE.0 * SAMPLES, SIZE.1 * SAMPLES);
        let place = |k: usize| (k as f64 + 0.5) / SAMPLES as f64 - 0.5;
        let ray = |k: usize| camera.unproject(&Vec2::new(place(k % wide), place(k / wide)));
        Self {
            rays: (0..wide * high).map(ray).collect(),
            board,
        }
    }

    /// The board with a white border on grey, with noise of two grey levels.
    fn picture(&self, camera_from_board: &Se3, seed: u64) -> GrayImage {
        let (columns, rows) = (self.board.columns as f64, self.board.rows as f64);
        let is_black = |at: &Vec2| {
            let is_within = |margin: f64| {
                (-1.0 - margin..columns + margin).contains(&at.x)
                    && (-1.0 - margin..rows + margin).contains(&at.y)
            };
            let is_odd = (at.x.floor() + at.y.floor()).rem_euclid(2.0) < 0.5;
            is_within(0.8).then(|| is_within(0.0) && is_odd)
        };
        self.picture_of(&is_black, camera_from_board, seed)
    }

    /// A plane of which is known what is black, and what is nothing but grey.
    fn picture_of(
        &self,
        is_black: &dyn Fn(&Vec2) -> Option<bool>,
        camera_from_board: &Se3,
        seed: u64,
    ) -> GrayImage {
        let board_from_camera = camera_from_board.inverse();
        let centre = board_from_camera.translation;
        let grey = |ray: &Option<Vec3>| {
            let way = board_from_camera.rotation * ray.as_ref()?;
            let distance = -centre.z / way.z;
            let at = centre + way * distance;
            let is_black = is_black(&at.xy()).filter(|_| distance > 0.0)?;
            Some(if is_black { 30.0 } else { 220.0 })
        };
        let mut rng = Rng::new(seed);
        GrayImage::from_fn(SIZE.0, SIZE.1, |x, y| {
            let mut sum = 0.0;
            for k in 0..SAMPLES * SAMPLES {
                let (column, row) = (x * SAMPLES + k % SAMPLES, y * SAMPLES + k / SAMPLES);
                sum += grey(&self.rays[row * SIZE.0 * SAMPLES + column]).unwrap_or(110.0);
            }
            let mean = sum / (SAMPLES * SAMPLES) as f64;
            (mean + 2.0 * rng.normal()).round().clamp(0.0, 255.0) as f32
        })
    }

    /// The board tilted each way, near and far, in the middle and in the corners.
    fn poses(&self, distance: f64) -> Vec<Se3> {
        let (columns, rows) = (self.board.columns as f64, self.board.rows as f64);
        poses_around(Vec3::new(columns - 1.0, rows - 1.0, 0.0) / 2.0, distance)
    }
}

/// A board with this middle tilted each way, near and far, in the middle of the image and in its
/// corners.
fn poses_around(middle: Vec3, distance: f64) -> Vec<Se3> {
    let tilts = [
        [0.0, 0.0, 0.0],
        [0.5, 0.1, 0.1],
        [-0.5, 0.0, -0.2],
        [0.1, 0.5, 0.0],
        [0.0, -0.5, 0.3],
        [0.35, 0.35, -0.1],
        [-0.35, 0.4, 0.0],
        [0.3, -0.3, 1.5],
    ];
    let offsets = [
        [0.0, 0.0],
        [-0.2, 0.1],
        [0.2, 0.12],
        [0.22, -0.12],
        [-0.2, -0.1],
        [0.0, 0.15],
        [0.1, -0.1],
        [0.0, 0.0],
    ];
    (tilts.iter().zip(offsets).enumerate())
        .map(|(k, (tilt, [x, y]))| {
            let far = distance * (1.0 + 0.08 * k as f64);
            let turn = rotation_exp(&Vec3::from(*tilt));
            Se3::new(turn, Vec3::new(x, y, 1.0) * far - turn * middle)
        })
        .collect()
}

fn views_of(camera: &Camera, distance: f64) -> Vec<BoardView> {
    let studio = Studio::new(camera, BoardSize::new(8, 6).unwrap());
    let mut collector = BoardCollector::new(TargetConfig::default());
    for (k, pose) in studio.poses(distance).iter().enumerate() {
        let picture = studio.picture(pose, k as u64);
        // held still: only what two images in a row show alike is used
        collector.add(&GrayImage::filled(SIZE.0, SIZE.1, 110.0));
        collector.add(&picture);
    }
    collector.finish().unwrap()
}

fn assert_found(found: &TargetCalibration, truth: &Camera) {
    let (found_at, true_at) = (found.camera.pinhole, truth.pinhole);
    for (name, found, truth) in [
        ("fx", found_at.fx, true_at.fx),
        ("fy", found_at.fy, true_at.fy),
    ] {
        assert!(
            (found / truth - 1.0).abs() < 0.002,
            "{name} {found} {truth}"
        );
    }
    assert!((found_at.cx - true_at.cx).abs() < 1.0, "cx {}", found_at.cx);
    assert!((found_at.cy - true_at.cy).abs() < 1.0, "cy {}", found_at.cy);
    assert!(found.rms_px < 0.15, "{}", found.rms_px);
    // distortion as the images show it
    for pixel in [
        Vec2::new(80.0, 70.0),
        Vec2::new(320.0, 150.0),
        Vec2::new(200.0, 240.0),
    ] {
        let ray = truth.unproject(&pixel).unwrap();
        let seen = found.camera.project(&ray).unwrap();
        assert!((seen - pixel).norm() < 0.7, "{pixel} {seen}");
    }
    let claimed = 4.0 * found.sigma_px[0] + 0.3;
    assert!(
        (found_at.fx - true_at.fx).abs() < claimed,
        "{:?}",
        found.sigma_px
    );
}

#[test]
fn an_ordinary_lens_is_found() {
    let truth = ordinary();
    let views = views_of(&truth, 13.0);
    assert!(views.len() >= 7, "{} views", views.len());
    assert_eq!(views[0].size.to_string(), "8x6");
    let found = calibrate(&views, SIZE, &TargetConfig::default()).unwrap();
    assert_eq!(found.model, LensModel::RadialTangential);
    assert_found(&found, &truth);
    assert!(found.other_rms_px.unwrap() > 0.9 * found.rms_px);
    assert_eq!(found.errors.len(), 48 * found.num_views.0);
}

#[test]
fn a_wide_lens_is_found() {
    let truth = wide();
    let views = views_of(&truth, 8.0);
    let config = |model| TargetConfig {
        model,
        ..TargetConfig::default()
    };
    let equidistant = config(Some(LensModel::Equidistant));
    let found = calibrate(&views, SIZE, &equidistant).unwrap();
    assert_found(&found, &truth);
    // nothing says which model it is but the error, and then the first must be clearly worse
    let free = calibrate(&views, SIZE, &config(None)).unwrap();
    let other = calibrate(&views, SIZE, &config(Some(LensModel::RadialTangential))).unwrap();
    let is_clear = 1.05 * found.rms_px < other.rms_px;
    assert_eq!(free.model == LensModel::Equidistant, is_clear);
}

/// A grid of tags as Kalibr prints it: numbered from below, borders of two bits, squares between
/// the corners.
fn tag_is_black(grid: &TagGrid, at: &Vec2) -> Option<bool> {
    let BoardSize { columns, rows } = grid.size;
    let pitch = 1.0 + grid.spacing;
    let cell = (at / pitch).map(f64::floor);
    let within = at - cell * pitch;
    let is_on = |k: f64, count: usize| (0.0..count as f64).contains(&k);
    let is_near = |k: f64, count: usize| (-1.0..=count as f64).contains(&k);
    if !is_near(cell.x, columns) || !is_near(cell.y, rows) {
        return None;
    }
    if within.x >= 1.0 && within.y >= 1.0 {
        // squares around the outer tags too
        let is_square = |k: f64, count: usize| (-1.0..count as f64).contains(&k);
        return Some(is_square(cell.x, columns) && is_square(cell.y, rows));
    }
    if within.x >= 1.0 || within.y >= 1.0 || !is_on(cell.x, columns) || !is_on(cell.y, rows) {
        return Some(false);
    }
    let number = (rows - 1 - cell.y as usize) * columns + cell.x as usize;
    let mut codes = include_str!("../../src/target/tag36h11.txt").lines();
    let code = u64::from_str_radix(codes.nth(number).unwrap(), 16).unwrap();
    let [x, y] = [within.x, within.y].map(|v| (v * 10.0) as usize);
    let is_bit = (2..8).contains(&x) && (2..8).contains(&y);
    Some(!is_bit || (code >> (35 - (y - 2) * 6 - (x - 2))) & 1 == 0)
}

#[test]
fn a_grid_of_tags_shows_an_ordinary_and_a_wide_lens() {
    let grid = TagGrid {
        size: BoardSize {
            columns: 5,
            rows: 4,
        },
        spacing: 0.3,
    };
    let mut num_parts = 0;
    for (truth, model, distance) in [
        (ordinary(), LensModel::RadialTangential, 5.6),
        (wide(), LensModel::Equidistant, 3.6),
    ] {
        let config = TargetConfig {
            tags: Some(grid),
            model: Some(model),
            ..TargetConfig::default()
        };
        let studio = Studio::new(&truth, grid.size);
        let mut collector = BoardCollector::new(config);
        let poses = poses_around(Vec3::new(3.1, 2.45, 0.0), distance);
        for (k, pose) in poses.iter().enumerate() {
            let picture = studio.picture_of(&|at| tag_is_black(&grid, at), pose, k as u64);
            let view = find_tags(&picture, &grid).unwrap();
            for (place, pixel) in view.places.iter().zip(&view.corners) {
                let seen = truth.project(&(*pose * place.push(0.0))).unwrap();
                assert!((seen - pixel).norm() < 1.0, "{k}: {place} {pixel} {seen}");
            }
            collector.add(&GrayImage::filled(SIZE.0, SIZE.1, 110.0));
            collector.add(&picture);
        }
        let views = collector.finish().unwrap();
        assert!(views.len() >= 7, "{} views", views.len());
        num_parts += views.iter().filter(|v| v.corners.len() < 4 * 20).count();
        assert_found(&calibrate(&views, SIZE, &config).unwrap(), &truth);
    }
    assert!(num_parts > 0, "a part of the grid is enough");
}

#[test]
fn without_tags_there_is_no_grid() {
    let grid = TagGrid {
        size: BoardSize {
            columns: 6,
            rows: 6,
        },
        spacing: 0.3,
    };
    let (truth, board) = (ordinary(), BoardSize::new(8, 6).unwrap());
    let studio = Studio::new(&truth, board);
    let chessboard = studio.picture(&studio.poses(13.0)[0], 1);
    assert_eq!(find_tags(&chessboard, &grid), None);
    let mut collector = BoardCollector::new(TargetConfig {
        tags: Some(grid),
        ..TargetConfig::default()
    });
    collector.add(&chessboard);
    let error = collector.finish().unwrap_err().to_string();
    assert!(error.contains("four tags of a grid of 6x6"), "{error}");
}

/// Views as a perfect detector would have them.
fn exact_views(camera: &Camera, board: BoardSize, poses: &[Se3]) -> Vec<BoardView> {
    let view = |pose: &Se3| {
        let corner = |k: usize| {
            let (column, row) = (k % board.columns, k / board.columns);
            camera.project(&(*pose * Vec3::new(column as f64, row as f64, 0.0)))
        };
        let corners = (0..board.columns * board.rows).map(corner);
        let corners = corners.collect::<Option<Vec<Vec2>>>()?;
        Some(BoardView::chessboard(board, corners))
    };
    poses.iter().filter_map(view).collect()
}

#[test]
fn a_view_that_does_not_fit_is_left_out() {
    let (truth, board) = (ordinary(), BoardSize::new(8, 6).unwrap());
    let poses = Studio {
        rays: Vec::new(),
        board,
    }
    .poses(13.0);
    let mut views = exact_views(&truth, board, &poses);
    for (k, corner) in views[3].corners.iter_mut().enumerate() {
        *corner += Vec2::new((k % 5) as f64 - 2.0, (k % 3) as f64 - 1.0) * 2.0;
    }
    let found = calibrate(&views, SIZE, &TargetConfig::default()).unwrap();
    assert_eq!(found.num_views, (7, 8));
    assert!((found.camera.pinhole.fx - 310.0).abs() < 0.01);
}

#[test]
fn what_cannot_be_found_is_said() {
    let (truth, board) = (ordinary(), BoardSize::new(8, 6).unwrap());
    let studio = Studio::new(&truth, board);
    let picture = studio.picture(&studio.poses(13.0)[0], 1);
    assert_eq!(find_board(&picture).unwrap().size, board);
    let asked = TargetConfig {
        board: BoardSize::new(9, 6),
        ..TargetConfig::default()
    };
    let mut collector = BoardCollector::new(asked);
    collector.add(&picture);
    let error = collector.finish().unwrap_err().to_string();
    assert!(error.contains("8x6") && error.contains("9x6"), "{error}");
    let mut collector = BoardCollector::new(TargetConfig::default());
    collector.add(&GrayImage::filled(SIZE.0, SIZE.1, 90.0));
    assert_eq!(
        collector.finish(),
        Err(TargetError::NoBoard { num_images: 1 })
    );
    // the same view twice is one, and one is too few
    let mut collector = BoardCollector::new(TargetConfig::default());
    collector.add(&picture);
    collector.add(&picture);
    let views = collector.finish().unwrap();
    let few = calibrate(&views, SIZE, &TargetConfig::default());
    assert_eq!(few, Err(TargetError::FewViews { found: 1 }));
    // held straight in front of the camera at any distance, a board says nothing of the focal
    // length
    let straight: Vec<Se3> = (0..6)
        .map(|k| {
            Se3::new(
                rotation_exp(&Vec3::zeros()),
                Vec3::new(-3.5, -2.5, 11.0 + f64::from(k)),
            )
        })
        .collect();
    let views = exact_views(&camera(310.0, Distortion::None), board, &straight);
    let error = calibrate(&views, SIZE, &TargetConfig::default()).unwrap_err();
    assert!(
        matches!(error, TargetError::NotDetermined { .. }),
        "{error}"
    );
}

#[test]
fn a_board_that_moves_is_not_used() {
    let (truth, board) = (ordinary(), BoardSize::new(8, 6).unwrap());
    let studio = Studio::new(&truth, board);
    let mut collector = BoardCollector::new(TargetConfig::default());
    for (k, pose) in studio.poses(13.0).iter().take(3).enumerate() {
        collector.add(&studio.picture(pose, k as u64));
    }
    // the first has none before it, the others come right after a very different one
    assert_eq!(collector.finish().unwrap().len(), 1);
}
