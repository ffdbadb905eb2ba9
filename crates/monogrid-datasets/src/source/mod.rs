//! Image sequences on disk: TUM layout, ETH3D, TUM monoVO, EuRoC, TUM-VI, KITTI, 7-Scenes,
//! ICL-NUIM, ScanNet, plain folders; each also as a zip or tar file.
//!
//! [`Dataset::open`] looks at what is there and returns a time-ordered list of frames with
//! whatever belongs to them. Nothing is decoded here; see [`crate::read_gray`].

mod euroc;
mod folder;
mod icl;
mod kinds;
mod list;
mod natural;
mod reference;
mod scannet;
mod stereo;
mod tum;

pub use natural::natural_order;

use crate::archive::{self, Archive};
use crate::calibration::Images;
use crate::files::is_file;
use crate::timestamp::TimeUnit;
use crate::{Calibration, DatasetError, DepthCalibration, PixelBudget, TUM_UNITS_PER_METRE};
use monogrid_geometry::Camera;
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// One image of a sequence.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FrameEntry {
    /// Position in the time-ordered sequence, from 0.
    pub index: usize,
    /// Time, nanoseconds, exactly as written in the source.
    pub timestamp_ns: i64,
    /// The image file.
    pub path: PathBuf,
}

/// One depth image of a sequence.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct DepthEntry {
    /// Time, nanoseconds.
    pub timestamp_ns: i64,
    /// The depth image file.
    pub path: PathBuf,
}

/// How the sequence lies on disk.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Layout {
    /// `rgb.txt` (time, path), optionally `depth.txt` and `groundtruth.txt`.
    Tum,
    /// `times.txt` (id, time, exposure) with a folder of images.
    TumMonoVo,
    /// `mav0/cam0/data.csv`.
    Euroc,
    /// As [`Self::Euroc`], with `dso/` or `mav0/mocap0/`.
    TumVi,
    /// As [`Self::Tum`], with `associated.txt`.
    Eth3d,
    /// `color/N.jpg`, `depth/N.png` and `pose/N.txt`.
    ScanNet,
    /// `image_0` (or another camera) with `times.txt`.
    Kitti,
    /// `image_00/data` (or another camera) with `image_00/timestamps.txt`.
    KittiRaw,
    /// `NAME.color.png`, `NAME.depth.png` and `NAME.pose.txt` side by side.
    SevenScenes,
    /// `associations.txt` with numbers of frames, `NAME.gt.freiburg`.
    IclNuim,
    /// Images in natural order of their names at a given rate.
    #[default]
    Folder,
}

impl Layout {
    /// For people.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Tum => "TUM RGB-D",
            Self::TumMonoVo => "TUM monoVO",
            Self::Euroc => "EuRoC",
            Self::TumVi => "TUM-VI",
            Self::Eth3d => "ETH3D",
            Self::ScanNet => "ScanNet",
            Self::Kitti => "KITTI",
            Self::KittiRaw => "KITTI raw",
            Self::SevenScenes => "7-Scenes",
            Self::IclNuim => "ICL-NUIM",
            Self::Folder => "image folder",
        }
    }
}

/// Opens a folder of its layout; `None` where the folder is of another.
type Reader = fn(&Path, SourceOptions) -> Option<Result<Dataset, DatasetError>>;

/// Readers of layouts that a list or the names of folders show, in the order in which they are
/// asked. A folder that none of them knows is one of images ([`folder::open`]).
const READERS: [Reader; 4] = [euroc::read, tum::read, icl::read, scannet::read];

/// What the user may say about a source.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SourceOptions {
    /// Frames per second of sources without times, Hz; `None`: [`DEFAULT_FPS`], with a warning.
    pub fps: Option<f64>,
}

/// Rate assumed for images without times, Hz.
pub const DEFAULT_FPS: f64 = 30.0;

/// Fraction of a frame's interval within which a depth image belongs to a frame.
const DEPTH_ASSOCIATION: f64 = 0.6;

/// An image sequence and what came with it.
#[derive(Clone, Debug)]
pub struct Dataset {
    /// Name of the folder, for output folders and titles.
    pub name: String,
    /// Folder that holds the sequence.
    pub root: PathBuf,
    /// How it lies on disk.
    pub layout: Layout,
    /// Frames in the order of time; none only where the source holds nothing but depth images.
    pub frames: Vec<FrameEntry>,
    /// Depth images in the order of time; often none.
    pub depths: Vec<DepthEntry>,
    /// Reference trajectory; of 7-Scenes the first of its files.
    pub ground_truth: Option<PathBuf>,
    /// Files with the pose of a frame each, and its time, ns.
    pose_files: Vec<(i64, PathBuf)>,
    /// What was said when it was opened.
    options: SourceOptions,
    /// Stored value of one metre in depth images of which no calibration says it.
    depth_units_per_metre: f64,
    /// Calibration of the camera.
    pub calibration_path: Option<PathBuf>,
    /// Calibration of the depth camera.
    pub depth_calibration_path: Option<PathBuf>,
    /// Inverse response (`pcalib.txt`).
    pub response_path: Option<PathBuf>,
    /// Vignette image.
    pub vignette_path: Option<PathBuf>,
    /// Readings of an inertial sensor.
    pub imu_path: Option<PathBuf>,
    /// What looked odd, in sentences for people.
    pub warnings: Vec<String>,
    /// Where its files are, if that is an archive: they can be read as long as it lives.
    archive: Option<Arc<Archive>>,
}

impl Dataset {
    /// Finds out what `path` (a folder, an archive of one, or a text file with a list of images)
    /// holds.
    ///
    /// # Errors
    /// When nothing is there, when it is no image sequence or an empty one, when a list cannot be
    /// parsed, or when most time stamps are duplicates.
    pub fn open(path: &Path, options: SourceOptions) -> Result<Self, DatasetError> {
        let metadata = std::fs::metadata(path).map_err(|e| match e.kind() {
            std::io::ErrorKind::NotFound => DatasetError::SourceMissing(path.to_path_buf()),
            _ => DatasetError::io("read", path, e),
        })?;
        if metadata.is_file() && archive::is_archive(path) {
            return Self::open_archive(path, options);
        }
        if metadata.is_file() {
            return list::open_list(path, options);
        }
        if !metadata.is_dir() {
            let expected = "a video, a folder of images, a list of them or an archive";
            return Err(DatasetError::content(
                path,
                "a pipe, socket or device",
                expected,
            ));
        }
        Self::open_folder(path, options)
    }

    fn open_folder(path: &Path, options: SourceOptions) -> Result<Self, DatasetError> {
        let opened = READERS.iter().find_map(|open| open(path, options));
        match opened.unwrap_or_else(|| folder::open(path, options)) {
            // depth alone, with poses, can be mapped
            Err(DatasetError::NoFrames { .. }) if is_file(&path.join("depth.txt")) => {
                tum::open_depth(path, options)
            }
            outcome => outcome,
        }
    }

    /// Opens what an archive holds; calibration and reference may lie beside its images as in a
    /// folder.
    fn open_archive(path: &Path, options: SourceOptions) -> Result<Self, DatasetError> {
        let archive = Archive::open(path)?;
        let mut dataset = Self::open_folder(&archive.root(), options)?;
        dataset.name = archive::stem(path);
        dataset.warnings.extend(archive.note());
        dataset.archive = Some(archive);
        Ok(dataset)
    }

    /// What its images may show together. One that is listed many times counts once, and so do
    /// files of an archive that lie in one another.
    #[must_use]
    pub fn pixel_budget(&self) -> PixelBudget {
        let paths = self.frames.iter().map(|frame| &frame.path);
        let paths: BTreeSet<&PathBuf> = paths.chain(self.depths.iter().map(|d| &d.path)).collect();
        let (path, stored_bytes) = match &self.archive {
            Some(archive) => (archive.path(), archive.stored_bytes()),
            None => {
                let lengths = paths.into_iter().map(std::fs::metadata);
                let lengths = lengths.map(|file| file.map_or(0, |file| file.len()));
                (self.root.as_path(), lengths.sum())
            }
        };
        PixelBudget::of_source(path, stored_bytes)
    }

    /// The calibration that lies in the source, or that of all sequences of its data set
    /// (ICL-NUIM); `None` when there is none.
    ///
    /// `image_size` (width, height) serves formats that do not say it.
    ///
    /// # Errors
    /// When the file exists and cannot be understood.
    pub fn calibration(
        &self,
        image_size: Option<(usize, usize)>,
    ) -> Result<Option<Calibration>, DatasetError> {
        let is_icl = self.layout == Layout::IclNuim && image_size.is_none_or(|s| s == icl::SIZE);
        match &self.calibration_path {
            Some(path) => self.read_calibration(path, image_size).map(Some),
            None if is_icl => {
                Calibration::parse(icl::CALIBRATION, &self.root, image_size).map(Some)
            }
            None => Ok(None),
        }
    }

    /// Reads a calibration for the images of this source: of a file for several cameras the one
    /// whose folder these lie in, or whose size is theirs.
    ///
    /// # Errors
    /// As [`Calibration::read`].
    pub fn read_calibration(
        &self,
        path: &Path,
        image_size: Option<(usize, usize)>,
    ) -> Result<Calibration, DatasetError> {
        let first = self.frames.first().and_then(|frame| frame.path.parent());
        let folders = first.into_iter().flat_map(Path::ancestors);
        let mut names = folders.filter_map(|folder| folder.file_name()?.to_str());
        let images = Images {
            size: image_size,
            folder: names.find(|name| name.starts_with("image_")),
        };
        Calibration::read_for(path, images)
    }

    /// The calibration of depth images that show what the colour camera shows, in the units of this
    /// layout.
    #[must_use]
    pub fn registered_depth(&self, colour: Camera) -> DepthCalibration {
        DepthCalibration {
            units_per_metre: self.depth_units_per_metre,
            ..DepthCalibration::registered(colour)
        }
    }

    /// The calibration of the depth camera that lies in the source; `None` when there is none.
    ///
    /// # Errors
    /// When the file exists and cannot be understood.
    pub fn depth_calibration(&self) -> Result<Option<DepthCalibration>, DatasetError> {
        let path = self.depth_calibration_path.as_ref();
        if let (Layout::ScanNet, None) = (self.layout, path) {
            return scannet::depth_calibration(&self.root, &self.depths);
        }
        path.map(|path| DepthCalibration::read(path)).transpose()
    }

    /// Median time between frames, seconds; `None` for a single frame.
    #[must_use]
    pub fn frame_interval_secs(&self) -> Option<f64> {
        let length =
            |pair: &[FrameEntry]| pair[1].timestamp_ns.saturating_sub(pair[0].timestamp_ns);
        let mut intervals: Vec<i64> = self.frames.windows(2).map(length).collect();
        intervals.sort_unstable();
        let median = intervals.get(intervals.len() / 2);
        median.map(|&ns| ns as f64 * 1e-9)
    }

    /// The depth image nearest in time to a frame, if it is near enough to be its own.
    ///
    /// Near enough: within 0.6 frame intervals.
    #[must_use]
    pub fn depth_of_frame(&self, timestamp_ns: i64) -> Option<&DepthEntry> {
        let depths = &self.depths;
        let after = depths.partition_point(|depth| depth.timestamp_ns < timestamp_ns);
        let around = depths[after.saturating_sub(1)..].iter().take(2);
        let distance = |depth: &&DepthEntry| depth.timestamp_ns.abs_diff(timestamp_ns);
        let nearest = around.min_by_key(distance)?;
        let limit_secs = DEPTH_ASSOCIATION * self.frame_interval_secs().unwrap_or(0.0);
        (distance(&nearest) as f64 * 1e-9 <= limit_secs).then_some(nearest)
    }

    /// Sorts the entries by time, drops duplicates, numbers the frames and looks for companions.
    fn assemble(parts: Parts, options: SourceOptions) -> Result<Self, DatasetError> {
        let (root, layout, list) = (parts.root, parts.layout, parts.list);
        let (mut depths, mut warnings) = (parts.depths, parts.warnings);
        if parts.entries.is_empty() && depths.is_empty() {
            let (found, expected) = ("times or images, but not both", "a time for each image");
            return Err(DatasetError::no_frames(&list, found, expected));
        }
        if options.fps.is_some() && !parts.is_at_rate {
            warnings.push(format!(
                "the frame rate that was given is not used: {} has its own times",
                list.display()
            ));
        }
        let frames = order_frames(&list, parts.entries, &mut warnings)?;
        warn_missing(&list, &frames, &mut warnings)?;
        depths.sort_by_key(|d| d.timestamp_ns);
        let named = |names: &[&str]| names.iter().map(|n| root.join(n)).find(|p| is_file(p));
        let first_pose = parts.pose_files.first().map(|(_, path)| path.clone());
        let truth = parts.ground_truth.or(first_pose);
        let truth = truth.or_else(|| named(&["groundtruth.txt", "gt.txt", "poses.txt"]));
        let calibration = named(&["calibration.toml", "calibration.txt"]);
        let calibration = calibration.or(parts.calibration_path);
        Ok(Self {
            name: source_name(&root),
            layout,
            frames,
            depths,
            ground_truth: truth.or_else(|| kitti_poses(&root, layout)),
            pose_files: parts.pose_files,
            options,
            depth_units_per_metre: match layout {
                Layout::SevenScenes | Layout::ScanNet => 1000.0,
                _ => TUM_UNITS_PER_METRE,
            },
            calibration_path: calibration
                .or_else(|| named(&CALIBRATION_NAMES))
                .or_else(|| kitti_raw_calibration(&root, layout)),
            depth_calibration_path: named(&["calibration_depth.txt"]),
            response_path: named(&["pcalib.txt"]),
            vignette_path: named(&["vignette.png"]),
            imu_path: named(&IMU_NAMES),
            warnings,
            archive: parts.archive,
            root,
        })
    }
}

/// KITTI odometry keeps the poses of `sequences/00` in `poses/00.txt`.
fn kitti_poses(root: &Path, layout: Layout) -> Option<PathBuf> {
    let name = format!("{}.txt", root.file_name()?.to_string_lossy());
    let path = root.parent()?.parent()?.join("poses").join(name);
    (layout == Layout::Kitti && is_file(&path)).then_some(path)
}

/// KITTI's raw recordings have the calibration of a day in the folder around those of its drives.
fn kitti_raw_calibration(root: &Path, layout: Layout) -> Option<PathBuf> {
    let folders = root.ancestors().take(3);
    let mut paths = folders.map(|folder| folder.join("calib_cam_to_cam.txt"));
    paths.find(|path| layout == Layout::KittiRaw && is_file(path))
}

/// Names under which other programs keep calibrations, besides ours.
const CALIBRATION_NAMES: [&str; 18] = [
    "calibration.yaml",
    "calibration.yml",
    "calibration.json",
    "calibration.xml",
    "camera.txt",
    "cameras.txt",
    "cameras.bin",
    "cameraCalibration.cfg",
    "calib.txt",
    "sensor.yaml",
    "camera.yaml",
    "camchain.yaml",
    "camera_info.yaml",
    "ost.yaml",
    "intrinsics.txt",
    "intrinsics.K.txt",
    "camera-intrinsics.txt",
    "intrinsic_color.txt",
];

/// Where the readings of an inertial sensor are looked for.
const IMU_NAMES: [&str; 4] = ["mav0/imu0/data.csv", "imu0/data.csv", "imu.csv", "imu.txt"];

/// What each layout finds before the common part.
#[derive(Default)]
struct Parts {
    root: PathBuf,
    layout: Layout,
    /// File or folder to name in messages about frames.
    list: PathBuf,
    entries: Vec<(i64, PathBuf)>,
    /// Whether nothing but a rate says when frames were taken.
    is_at_rate: bool,
    depths: Vec<DepthEntry>,
    ground_truth: Option<PathBuf>,
    pose_files: Vec<(i64, PathBuf)>,
    calibration_path: Option<PathBuf>,
    warnings: Vec<String>,
    archive: Option<Arc<Archive>>,
}

/// Frames sorted by time without duplicates.
fn order_frames(
    list: &Path,
    mut entries: Vec<(i64, PathBuf)>,
    warnings: &mut Vec<String>,
) -> Result<Vec<FrameEntry>, DatasetError> {
    let total = entries.len();
    let backwards = entries.windows(2).filter(|p| p[1].0 < p[0].0).count();
    if backwards > 0 {
        check_jumps(list, &entries, backwards)?;
        warnings.push(format!(
            "time runs backwards {backwards} times in {}; the frames were sorted by time",
            list.display()
        ));
        entries.sort_by_key(|e| e.0);
    }
    entries.dedup_by_key(|e| e.0);
    let duplicates = total - entries.len();
    if 2 * duplicates > total {
        return Err(DatasetError::DuplicateTimes {
            path: list.to_path_buf(),
            duplicates,
            frames: total,
        });
    }
    if duplicates > 0 {
        warnings.push(format!(
            "{duplicates} of {total} frames in {} repeat the time stamp of another frame; only the \
             first of each is used",
            list.display()
        ));
    }
    let frame = |(index, (timestamp_ns, path))| FrameEntry {
        index,
        timestamp_ns,
        path,
    };
    Ok(entries.into_iter().enumerate().map(frame).collect())
}

/// Steps of usual length that time may run backwards where frames are only out of order.
const MAX_STEPS_BACK: i64 = 10;
/// Frames for each step backwards of a clock that was set, or of recordings one behind the other.
const FRAMES_PER_JUMP: usize = 50;

/// Refuses times that rarely jump back, and far: sorted, the frames of two recordings would take
/// turns.
fn check_jumps(
    list: &Path,
    entries: &[(i64, PathBuf)],
    backwards: usize,
) -> Result<(), DatasetError> {
    let step = |pair: &[(i64, PathBuf)]| pair[1].0.saturating_sub(pair[0].0);
    let mut forwards: Vec<i64> = entries
        .windows(2)
        .map(step)
        .filter(|step| *step > 0)
        .collect();
    forwards.sort_unstable();
    let usual = forwards.get(forwards.len() / 2).copied().unwrap_or(0);
    let largest = entries
        .windows(2)
        .map(step)
        .enumerate()
        .min_by_key(|(_, step)| *step);
    match largest {
        Some((before, step))
            if backwards * FRAMES_PER_JUMP <= entries.len()
                && step < -MAX_STEPS_BACK.saturating_mul(usual) =>
        {
            Err(DatasetError::TimesJumpBack {
                path: list.to_path_buf(),
                frame: before + 1,
                seconds: -(step as f64) * 1e-9,
            })
        }
        _ => Ok(()),
    }
}

/// Says in which unit times were understood, where it is not the one that files of this kind have.
fn note_unit(list: &Path, unit: TimeUnit, usual: TimeUnit, warnings: &mut Vec<String>) {
    if unit != usual {
        warnings.push(format!(
            "the times in {} are taken for {}, by their size and steps",
            list.display(),
            unit.name()
        ));
    }
}

/// Complains about listed images that do not exist: all of them is an error, some a warning (a run
/// skips and counts them).
fn warn_missing(
    list: &Path,
    frames: &[FrameEntry],
    warnings: &mut Vec<String>,
) -> Result<(), DatasetError> {
    let missing: Vec<&FrameEntry> = frames.iter().filter(|f| !is_file(&f.path)).collect();
    let Some(first) = missing.first().map(|frame| frame.path.display()) else {
        return Ok(());
    };
    let all = frames.len();
    if missing.len() == all {
        let found = format!("{all} listed images of which none exists (first: {first})");
        let expected = "paths of existing images, relative to the folder of the list";
        return Err(DatasetError::no_frames(list, found, expected));
    }
    warnings.push(format!(
        "{} of {all} images listed in {} do not exist (first: {first})",
        missing.len(),
        list.display()
    ));
    Ok(())
}

/// Name of the folder, also for `.` and `..`.
fn source_name(root: &Path) -> String {
    let named = |p: &Path| Some(p.file_name()?.to_string_lossy().into_owned());
    let name = named(root).or_else(|| named(&root.canonicalize().ok()?));
    name.unwrap_or_else(|| "source".to_owned())
}
