//! Valid files of every kind, made by the program.

use crate::common::copy_of_small_sequence;
use crate::limits::{limited, run};
use std::fs;
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
            &["run", &video, "--out", &run_folder, "--threads", "2"][..],
            &["convert", &map, &bt],
            &["convert", &map, &mgo],
            &["convert", &map, &at("cloud.ply")],
            &[
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
                "sweep",
                &recording,
                "--resolutions",
                "0.2,0.4",
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

    fn write_others(&self) {
        let write = |name: &str, content: &[u8]| fs::write(self.path(name), content).unwrap();
        write("scans.scans", &scans());
        write(
            "mesh.obj",
            b"v 0 0 0\nv 1 0 0\nv 0 1 0.5\nv 1 1 0\nf 1 2 3\nf 2/1/1 3/1/1 4/1/1\nf 1 2 3 4\n",
        );
        write(
            "mesh.ply",
            b"ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n\
              element face 2\nproperty list uchar int vertex_indices\nend_header\n\
              0 0 0\n1 0 0\n0 1 0\n1 1 0\n3 0 1 2\n3 1 2 3\n",
        );
        write("gray.pgm", &pgm());
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
