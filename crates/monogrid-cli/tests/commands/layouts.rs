//! `check` names the layout of what it is given; the folders are made here.

use crate::common::{json, monogrid};
use monogrid_datasets::{encode_png, encode_png_16};
use monogrid_image::Image;
use std::fs;
use std::path::Path;
use tempfile::TempDir;

struct Folder(TempDir);

impl Folder {
    fn write(&self, name: &str, content: impl AsRef<[u8]>) {
        let path = self.0.path().join(name);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(path, content).unwrap();
    }

    /// An image that is not that of another number.
    fn image(&self, name: &str, number: usize) {
        let image = Image::from_fn(96, 72, |x, y| (((x + 5 * number) * 7 + y * 13) % 251) as u8);
        self.write(name, encode_png(&image));
    }

    fn depth(&self, name: &str) {
        self.write(name, encode_png_16(&Image::filled(96, 72, 1500_u16)));
    }
}

const COUNT: usize = 3;
const DATES: [&str; COUNT] = [
    "1403636579763555584",
    "1403636579813555584",
    "1403636579863555584",
];

fn lines(line: impl Fn(usize) -> String) -> String {
    (0..COUNT).map(|k| line(k) + "\n").collect()
}

fn tum(folder: &Folder) {
    for k in 0..COUNT {
        folder.image(&format!("rgb/{k}.png"), k);
        folder.depth(&format!("depth/{k}.png"));
    }
    let list = |kind: &'static str| lines(move |k| format!("5436.{k} {kind}/{k}.png"));
    folder.write("rgb.txt", list("rgb"));
    folder.write("depth.txt", list("depth"));
}

fn euroc(folder: &Folder) {
    for (k, date) in DATES.into_iter().enumerate() {
        folder.image(&format!("mav0/cam0/data/{date}.png"), k);
    }
}

fn kitti_odometry(folder: &Folder) {
    for k in 0..COUNT {
        folder.image(&format!("image_0/{k:06}.png"), k);
    }
    folder.write("times.txt", lines(|k| format!("0.{k}")));
}

fn kitti_raw(folder: &Folder) {
    for k in 0..COUNT {
        folder.image(&format!("image_00/data/{k:010}.png"), k);
    }
    let dates = lines(|k| format!("2011-09-26 13:02:25.{k}00000000"));
    folder.write("image_00/timestamps.txt", dates);
}

fn seven_scenes(folder: &Folder) {
    for k in 0..COUNT {
        folder.image(&format!("frame-{k:06}.color.png"), k);
        folder.depth(&format!("frame-{k:06}.depth.png"));
        let pose = format!("1 0 0 {k}\n0 1 0 0\n0 0 1 0\n0 0 0 1\n");
        folder.write(&format!("frame-{k:06}.pose.txt"), pose);
    }
}

fn icl_nuim(folder: &Folder) {
    for k in 0..COUNT {
        folder.image(&format!("rgb/{k}.png"), k);
        folder.depth(&format!("depth/{k}.png"));
    }
    let list = lines(|k| format!("{k} depth/{k}.png {k} rgb/{k}.png"));
    folder.write("associations.txt", list);
    folder.write(
        "office.gt.freiburg",
        lines(|k| format!("{k} {k} 0 0 0 0 0 1")),
    );
}

fn tum_mono_vo(folder: &Folder) {
    for k in 0..COUNT {
        folder.image(&format!("images/{k:05}.png"), k);
    }
    folder.write("times.txt", lines(|k| format!("{k:05} 0.{k} 5.0")));
}

fn scannet(folder: &Folder) {
    for k in 0..COUNT {
        folder.image(&format!("color/{k}.png"), k);
        folder.depth(&format!("depth/{k}.png"));
        let pose = format!("1 0 0 {k}\n0 1 0 0\n0 0 1 0\n0 0 0 1\n");
        folder.write(&format!("pose/{k}.txt"), pose);
    }
}

/// Makes the files of a layout.
type Maker<'a> = &'a dyn Fn(&Folder);

#[test]
fn check_names_the_layout_of_each_data_set() {
    let tum_vi = |folder: &Folder| {
        euroc(folder);
        folder.write(
            "mav0/cam0/data.csv",
            DATES.map(|d| format!("{d},{d}.png\n")).concat(),
        );
        folder.write(
            "mav0/mocap0/data.csv",
            format!("{},1,2,3,1,0,0,0\n", DATES[0]),
        );
    };
    let eth3d = |folder: &Folder| {
        tum(folder);
        folder.write("associated.txt", "");
    };
    let plain = |folder: &Folder| (0..COUNT).for_each(|k| folder.image(&format!("{k}.png"), k));
    let kinds: [(&str, Maker); 11] = [
        ("TUM RGB-D", &tum),
        ("ETH3D", &eth3d),
        ("TUM monoVO", &tum_mono_vo),
        ("EuRoC", &euroc),
        ("TUM-VI", &tum_vi),
        ("KITTI", &kitti_odometry),
        ("KITTI raw", &kitti_raw),
        ("7-Scenes", &seven_scenes),
        ("ICL-NUIM", &icl_nuim),
        ("ScanNet", &scannet),
        ("image folder", &plain),
    ];
    let formats = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs/formats.md");
    let layouts = fs::read_to_string(formats).unwrap();
    for (name, make) in kinds {
        let folder = Folder(tempfile::tempdir().unwrap());
        make(&folder);
        let path: &Path = folder.0.path();
        let output = monogrid(["check".as_ref(), path.as_os_str(), "--json".as_ref()]);
        let report = json(&output);
        assert_eq!(report["layout"], name, "{report}");
        assert_eq!(report["frames"], COUNT, "{name}: {report}");
        // each has its line in the table of the documents
        let line = format!("| {} |", name.replace("image folder", "folder"));
        assert!(layouts.contains(&line), "{line}");
    }
}
