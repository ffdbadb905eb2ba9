//! Valid files of every kind, made by the program.

use super::limits::{limited, run};
use crate::common::copy_of_small_sequence;
use std::fs::{self, File};
use std::io::Write;
use std::path::{Path, PathBuf};

/// Folder with `video/` (TUM layout), `run/` (its results) and a file of every other kind.
pub struct Seeds {
    folder: tempfile::TempDir,
}

impl Seeds {
    pub fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name).display().to_string();
        let (video, run_folder, recording) = (at("video"), at("run"), at("run/recording.mgk"));
        let (map, bt, mgo) = (at("run/global.ot"), at("map.bt"), at("map.mgo"));
        copy_of_small_sequence(Path::new(&video));
        for args in [
            &[
                "run",
                &video,
                "--out",
                &run_folder,
                "--submaps=2",
                "--threads",
                "2",
            ][..],
            &["convert", &map, &bt],
            &["convert", &map, &mgo],
            &["convert", &map, &at("cloud.ply")],
            &[
                "thesis",
                "vocabulary",
                &video,
                "--every",
                "3",
                "--words",
                "40",
                "--samples",
                "5",
                "--out",
                &at("places.vocabulary"),
            ],
            &[
                "thesis",
                "sweep",
                &recording,
                "--resolutions",
                "0.4",
                "--out",
                &at("sweep"),
            ],
        ] {
            let ended = run(limited("", args), folder.path());
            assert_eq!(ended.code, Some(0), "{args:?}: {}", ended.said);
        }
        let seeds = Self { folder };
        seeds.write_others();
        seeds
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    pub fn root(&self) -> &Path {
        self.folder.path()
    }

    /// Nine images of the video in a zip and a tar archive.
    fn write_archives(&self) {
        let mut images: Vec<PathBuf> = fs::read_dir(self.path("video/rgb"))
            .unwrap()
            .map(|entry| entry.unwrap().path())
            .collect();
        images.sort();
        images.truncate(9);
        let mut zip = zip::ZipWriter::new(File::create(self.path("images.zip")).unwrap());
        let mut tar = tar::Builder::new(File::create(self.path("images.tar")).unwrap());
        for (index, image) in images.iter().enumerate() {
            let name = format!("{index}.png");
            let how = zip::write::SimpleFileOptions::default();
            zip.start_file(&name, how).unwrap();
            zip.write_all(&fs::read(image).unwrap()).unwrap();
            tar.append_path_with_name(image, &name).unwrap();
        }
        zip.finish().unwrap();
        tar.finish().unwrap();
        let tar = fs::read(self.path("images.tar")).unwrap();
        let packed = File::create(self.path("images.tar.gz")).unwrap();
        let mut packed = flate2::write::GzEncoder::new(packed, flate2::Compression::fast());
        packed.write_all(&tar).unwrap();
        packed.finish().unwrap();
    }

    /// The first submap of the run, whose name is its content, under a name that is known.
    fn name_a_submap(&self) {
        let mut submaps: Vec<PathBuf> = fs::read_dir(self.path("run/submaps"))
            .unwrap()
            .map(|entry| entry.unwrap().path())
            .filter(|path| path.extension().is_some_and(|ending| ending == "mgs"))
            .collect();
        submaps.sort();
        fs::copy(&submaps[0], self.path("first.mgs")).unwrap();
    }

    fn write_others(&self) {
        let write = |name: &str, content: &[u8]| fs::write(self.path(name), content).unwrap();
        write("scans.scans", &scans());
        write(
            "mesh.obj",
            b"v 0 0 0\nv 1 0 0\nv 0 1 0.5\nv 1 1 0\nf 1 2 3\nf 2/1/1 3/1/1 4/1/1\nf 1 2 3 4\n",
        );
        write(
            "mesh.ply",
            b"ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\n\
             property float z\nelement face 2\nproperty list uchar int vertex_indices\nend_header\n\
             0 0 0\n1 0 0\n0 1 0\n1 1 0\n3 0 1 2\n3 1 2 3\n",
        );
        write("gray.pgm", &pgm());
        write("gray.y4m", &y4m());
        for name in ["reordered.mp4", "mjpeg.avi"] {
            let video = Path::new(env!("CARGO_MANIFEST_DIR")).join("../monogrid-video/tests/data");
            fs::copy(video.join(name), self.path(name)).unwrap();
        }
        for (name, text) in CALIBRATIONS {
            write(name, text.as_bytes());
        }
        for name in ["plain.db3", "plain.mcap", "zstd.mcap", "lz4.bag", "bz2.bag"] {
            let bags = Path::new(env!("CARGO_MANIFEST_DIR")).join("../monogrid-bags/tests/data");
            fs::copy(bags.join(name), self.path(name)).unwrap();
        }
        write("imu.csv", imu().as_bytes());
        write("identity.txt", b"0 0 0 0 0 0 1\n");
        self.name_a_submap();
        self.write_archives();
        // lists of few frames, beside the images that they name
        let text = fs::read_to_string(self.path("video/rgb.txt")).unwrap();
        let folder = self.path("video").display().to_string();
        let few: Vec<String> = text
            .lines()
            .take(12)
            .map(|line| line.replace(" rgb/", &format!(" {folder}/rgb/")))
            .collect();
        write("video/few.txt", few.join("\n").as_bytes());
    }
}

/// A calibration for each of the readers.
const CALIBRATIONS: [(&str, &str); 5] = [
    (
        "ros.yaml",
        "image_width: 320\nimage_height: 240\ncamera_matrix:\n  rows: 3\n  cols: 3\n  \
         data: [277.0, 0.0, 160.0, 0.0, 277.0, 120.0, 0.0, 0.0, 1.0]\ndistortion_model: plumb_bob\n\
         distortion_coefficients:\n  rows: 1\n  cols: 5\n  data: [-0.1, 0.02, 0.0, 0.0, 0.0]\n",
    ),
    (
        "kalibr.yaml",
        "cam0:\n  camera_model: pinhole\n  distortion_coeffs: [-0.1, 0.02, 0.001, 0.0]\n  \
         distortion_model: radtan\n  intrinsics: [277.0, 277.0, 160.0, 120.0]\n  resolution: [320, \
         240]\n",
    ),
    (
        "orb.yaml",
        "%YAML:1.0\nCamera.type: \"KannalaBrandt8\"\nCamera.fx: 277.0\nCamera.fy: 277.0\n\
         Camera.cx: 160.0\nCamera.cy: 120.0\nCamera.k1: 0.01\nCamera.k2: 0.001\nCamera.k3: 0.0\n\
         Camera.k4: 0.0\nCamera.width: 320\nCamera.height: 240\n",
    ),
    (
        "colmap.txt",
        "# Camera list with one line of data per camera:\n1 OPENCV 320 240 277 277 160 120 -0.1 \
         0.02 0 0\n",
    ),
    (
        "own.toml",
        "width = 320\nheight = 240\nmodel = \"radial-tangential\"\nfx = 277.0\nfy = 277.0\ncx = \
         160.0\ncy = 120.0\ndistortion = [-0.1, 0.02, 0.0, 0.0]\n",
    ),
];

/// Half a second of a sensor that lies still: ns, rad/s, m/s².
fn imu() -> String {
    let reading = |k: i64| format!("{},0.001,-0.002,0.0,0.0,0.0,9.81\n", k * 5_000_000);
    (0..100).map(reading).collect()
}

/// Nine grey frames in which stripes move.
fn y4m() -> Vec<u8> {
    let mut file = b"YUV4MPEG2 W64 H48 F30:1 Ip A1:1 Cmono\n".to_vec();
    for frame in 0..9 {
        file.extend(b"FRAME\n");
        file.extend((0..64 * 48).map(|i| ((i % 64 + frame) * 9 + (i / 64) * 5) as u8));
    }
    file
}

/// Two scans of three points.
fn scans() -> Vec<u8> {
    let mut file = Vec::new();
    file.extend(0x4f47_4d31_u32.to_le_bytes());
    file.extend(2_u32.to_le_bytes());
    for scan in 0..2 {
        let row = [
            1.0,
            0.0,
            0.0,
            0.1,
            0.0,
            1.0,
            0.0,
            0.2,
            0.0,
            0.0,
            1.0,
            f64::from(scan),
        ];
        row.iter().for_each(|v: &f64| file.extend(v.to_le_bytes()));
        file.extend(3_u32.to_le_bytes());
        for value in [
            1.0, 0.5, 0.3, 0.01, 0.4, 1.0, 0.2, 0.02, 2.0, 0.1, 0.1, 0.05_f32,
        ] {
            file.extend(value.to_le_bytes());
        }
    }
    file
}

/// A textured grey image of the size of the video.
fn pgm() -> Vec<u8> {
    let mut file = b"P5\n320 240\n255\n".to_vec();
    file.extend((0..320 * 240).map(|i| ((i % 320) * 7 + (i / 320) * 13) as u8));
    file
}
