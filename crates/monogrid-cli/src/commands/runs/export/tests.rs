use super::reconstruction::{Candidate, Point, Reconstruction, Seen, View};
use super::{colmap, nerf};
use monogrid_app::output::{Inputs, OutputFolder};
use monogrid_datasets::RecordedCamera;
use monogrid_geometry::{Pinhole, Rotation, Se3, Vec2, Vec3};
use std::path::Path;

const CAMERA: RecordedCamera = RecordedCamera {
    pinhole: Pinhole {
        fx: 300.0,
        fy: 310.0,
        cx: 159.5,
        cy: 119.5,
    },
    width: 320,
    height: 240,
};

/// Two turned cameras that see three points exactly.
fn scene() -> Reconstruction {
    let pose = |k: f64| Se3 {
        rotation: Rotation::from_euler_angles(0.1 * k, -0.2, 0.3),
        translation: Vec3::new(0.1, -0.3 * k, 0.2),
    };
    let mut views = [0, 1].map(|k| View {
        name: format!("{k:05}.png"),
        keyframe: k,
        camera: 0,
        camera_from_map: pose(k as f64),
        features: Vec::new(),
    });
    let places = [
        Vec3::new(0.2, 0.1, 2.0),
        Vec3::new(-0.4, 0.3, 3.0),
        Vec3::new(0.1, -0.2, 2.5),
    ];
    let points: Vec<Point> = places
        .iter()
        .enumerate()
        .map(|(index, place)| {
            let track = views.iter_mut().enumerate().map(|(k, view)| {
                let at = CAMERA.pinhole.project(&(view.camera_from_map * *place));
                view.features.push((at, index));
                (k, view.features.len() - 1)
            });
            Point {
                track: track.collect(),
                place: *place,
                colour: [index as u8, 100, 200],
                error: 0.0,
            }
        })
        .collect();
    Reconstruction {
        cameras: vec![CAMERA],
        points,
        views: views.into(),
        ..Reconstruction::default()
    }
}

#[test]
fn what_is_seen_far_from_where_a_point_should_be_is_left_out() {
    let mut scene = Reconstruction {
        cameras: vec![CAMERA],
        views: scene().views,
        ..Reconstruction::default()
    };
    scene
        .views
        .iter_mut()
        .for_each(|view| view.features.clear());
    let candidate = |errors: &[f64]| Candidate {
        place: Vec3::new(0.0, 0.0, 2.0),
        colour: [1, 2, 3],
        seen: errors
            .iter()
            .enumerate()
            .map(|(view, error)| Seen {
                view,
                at: Vec2::new(10.0, 20.0),
                error: *error,
            })
            .collect(),
    };
    // the median is 0.5: beyond 2 px is far, and one view alone shows no point
    let errors = [[0.2, 0.3], [0.5, 1.9], [0.5, 2.1], [0.4, 0.6]];
    scene.add_points(errors.iter().map(|errors| candidate(errors)).collect());
    assert_eq!(
        (scene.points.len(), scene.left_out, scene.limit),
        (3, 1, 2.0)
    );
    assert_eq!(scene.num_observations(), 6);
    assert!((scene.points[1].error - 1.2).abs() < 1e-12);
    assert_eq!(scene.views[1].features.len(), 3);
    // less than a pixel is never far
    scene.points.clear();
    scene.add_points(vec![candidate(&[0.0, 0.0]), candidate(&[0.0, 0.9])]);
    assert_eq!((scene.points.len(), scene.left_out), (2, 1));
}

fn written(write: impl FnOnce(&OutputFolder)) -> tempfile::TempDir {
    let dir = tempfile::tempdir().unwrap();
    let folder = OutputFolder::replace(&dir.path().join("out"), false, &Inputs::default());
    write(&folder.unwrap());
    dir
}

fn lines(file: &Path) -> Vec<Vec<String>> {
    let text = std::fs::read_to_string(file).unwrap();
    let rows = text.lines().filter(|line| !line.starts_with('#'));
    rows.map(|line| line.split_whitespace().map(str::to_owned).collect())
        .collect()
}

fn number(word: &str) -> f64 {
    word.parse().unwrap()
}

#[test]
fn points_of_the_text_project_to_the_features_of_the_text() {
    let dir = written(|folder| colmap::write(folder, &scene()).unwrap());
    let model = dir.path().join("out/sparse/0");
    let cameras = lines(&model.join("cameras.txt"));
    assert_eq!(cameras[0][..4], ["1", "PINHOLE", "320", "240"]);
    let [fx, fy, cx, cy] = [4, 5, 6, 7].map(|k| number(&cameras[0][k]));
    assert_eq!([fx, fy, cx, cy], [300.0, 310.0, 160.0, 120.0]);
    let points = lines(&model.join("points3D.txt"));
    let images = lines(&model.join("images.txt"));
    assert_eq!((points.len(), images.len()), (3, 4));
    for (k, rows) in images.chunks(2).enumerate() {
        let (header, features) = (&rows[0], &rows[1]);
        assert_eq!(
            (number(&header[0]), header[8].as_str()),
            (k as f64 + 1.0, "1")
        );
        let q = [1, 2, 3, 4].map(|k| number(&header[k]));
        let rotation = nalgebra_quaternion(q);
        let t = Vec3::new(number(&header[5]), number(&header[6]), number(&header[7]));
        for (index, feature) in features.chunks(3).enumerate() {
            let point = &points[number(&feature[2]) as usize - 1];
            let place = Vec3::new(number(&point[1]), number(&point[2]), number(&point[3]));
            let seen = rotation * place + t;
            // the centre of the top-left pixel is (0.5, 0.5)
            let at = Vec2::new(fx * seen.x / seen.z + cx, fy * seen.y / seen.z + cy);
            assert!((at - Vec2::new(number(&feature[0]), number(&feature[1]))).norm() < 1e-9);
            // the track leads back to this feature
            let seen_from: Vec<f64> = point[8..].iter().map(|word| number(word)).collect();
            assert_eq!(seen_from[2 * k..2 * k + 2], [k as f64 + 1.0, index as f64]);
        }
    }
}

fn nalgebra_quaternion([w, x, y, z]: [f64; 4]) -> Rotation {
    Rotation::from_quaternion(monogrid_geometry::nalgebra::Quaternion::new(w, x, y, z))
}

#[test]
fn the_binary_model_holds_the_numbers_of_the_text() {
    let scene = scene();
    let dir = written(|folder| colmap::write(folder, &scene).unwrap());
    let model = dir.path().join("out/sparse/0");
    let read = |name: &str| std::fs::read(model.join(name)).unwrap();
    let cameras = read("cameras.bin");
    assert_eq!(cameras.len(), 8 + 4 + 4 + 16 + 32);
    assert_eq!(cameras[8..16], [1, 0, 0, 0, 1, 0, 0, 0]);
    let images = read("images.bin");
    let (name, features) = ("00000.png\0".len(), 8 + 3 * 24);
    assert_eq!(images.len(), 8 + 2 * (4 + 56 + 4 + name + features));
    let float = |bytes: &[u8], at: usize| f64::from_le_bytes(bytes[at..at + 8].try_into().unwrap());
    let header = &lines(&model.join("images.txt"))[0];
    for k in 0..7 {
        let binary = float(&images, 12 + 8 * k);
        assert_eq!(binary.to_bits(), number(&header[1 + k]).to_bits());
    }
    assert_eq!(&images[72..72 + name], b"00000.png\0");
    let points = read("points3D.bin");
    assert_eq!(points.len(), 8 + 3 * (8 + 24 + 3 + 8 + 8 + 2 * 8));
    assert_eq!(points[40..43], [0, 100, 200]);
}

#[test]
fn cameras_of_transforms_look_along_negative_z_with_y_up() {
    let scene = scene();
    let dir = written(|folder| nerf::write(folder, &scene, Path::new("/nowhere")).unwrap());
    let text = std::fs::read_to_string(dir.path().join("out/transforms.json")).unwrap();
    let read: serde_json::Value = serde_json::from_str(&text).unwrap();
    assert_eq!(read["cx"], 160.0);
    // the run has no cloud
    assert!(read["ply_file_path"].is_null());
    for (frame, view) in read["frames"].as_array().unwrap().iter().zip(&scene.views) {
        let entry = |row: usize, column: usize| frame["transform_matrix"][row][column].as_f64();
        let column = |k: usize| Vec3::from_fn(|row, _| entry(row, k).unwrap());
        for (at, point) in &view.features {
            let to_point = scene.points[*point].place - column(3);
            let [right, up, back] = [0, 1, 2].map(|k| column(k).dot(&to_point));
            assert!(back < 0.0);
            let seen = CAMERA.pinhole.project(&Vec3::new(right, -up, -back));
            assert!((seen - at).norm() < 1e-9);
        }
    }
}
