//! ScanNet (`[DAI17]`) as its reader exports a scan: `color/N.jpg`, `depth/N.png` in millimetres,
//! `pose/N.txt`, and a matrix for each camera in `intrinsic/`.

use super::{Dataset, DepthEntry, Layout, Parts, SourceOptions, folder};
use crate::files::{is_file, is_folder};
use crate::images::{DepthCalibration, read_depth};
use crate::{Calibration, DatasetError};
use monogrid_geometry::Se3;
use std::path::{Path, PathBuf};

const UNITS_PER_METRE: f64 = 1000.0;

/// Opens a folder of this layout.
pub(super) fn read(root: &Path, options: SourceOptions) -> Option<Result<Dataset, DatasetError>> {
    let is_here = ["color", "pose"]
        .iter()
        .all(|name| is_folder(&root.join(name)));
    is_here.then(|| open(root, options))
}

fn open(root: &Path, options: SourceOptions) -> Result<Dataset, DatasetError> {
    let folder = root.join("color");
    let mut warnings = Vec::new();
    let images = folder::images_in(&folder)?;
    let entries = folder::timed_at_rate(images, options, &folder, &mut warnings)?;
    let of_frames = |name: &str, ending: &str| {
        let file = |(time_ns, image): &(i64, PathBuf)| {
            let path = root
                .join(name)
                .join(image.file_stem()?)
                .with_extension(ending);
            is_file(&path).then_some((*time_ns, path))
        };
        entries.iter().filter_map(file).collect::<Vec<_>>()
    };
    let depth = |(timestamp_ns, path)| DepthEntry { timestamp_ns, path };
    let intrinsic = root.join("intrinsic/intrinsic_color.txt");
    Dataset::assemble(
        Parts {
            root: root.to_path_buf(),
            layout: Layout::ScanNet,
            list: folder,
            is_at_rate: true,
            depths: of_frames("depth", "png").into_iter().map(depth).collect(),
            pose_files: of_frames("pose", "txt"),
            calibration_path: is_file(&intrinsic).then_some(intrinsic),
            entries,
            warnings,
            ..Parts::default()
        },
        options,
    )
}

/// The depth camera, which sits where the colour camera does; `None` where nothing says what it is.
pub(super) fn depth_calibration(
    root: &Path,
    depths: &[DepthEntry],
) -> Result<Option<DepthCalibration>, DatasetError> {
    let path = root.join("intrinsic/intrinsic_depth.txt");
    let Some(first) = depths.first().filter(|_| is_file(&path)) else {
        return Ok(None);
    };
    let image = read_depth(&first.path, UNITS_PER_METRE)?;
    let size = Some((image.width(), image.height()));
    Ok(Some(DepthCalibration {
        camera: Calibration::read(&path, size)?.camera,
        units_per_metre: UNITS_PER_METRE,
        colour_from_depth: Se3::identity(),
    }))
}
