//! Folders of images without a list: plain, TUM monoVO, KITTI and 7-Scenes.

use super::kinds::{Kinds, kinds_of};
use super::{
    DEFAULT_FPS, Dataset, DepthEntry, Layout, Parts, SourceOptions, natural_order, note_unit,
};
use crate::DatasetError;
use crate::archive::Archive;
use crate::files::{is_file, is_folder, paths_in};
use crate::images::IMAGE_ENDINGS;
use crate::text::{data_lines, read_text};
use crate::timestamp::{TimeUnit, parse_date};
use std::ffi::OsStr;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Subfolders in which images may lie, in the order of preference.
const IMAGE_FOLDERS: [&str; 12] = [
    "images",
    "rgb",
    "image_0",
    "image_00",
    "image_2",
    "data",
    "frames",
    "color",
    "image_00/data",
    "image_01/data",
    "image_02/data",
    "image_03/data",
];

/// Images that belong to the calibration, not to the sequence.
const NOT_FRAMES: [&str; 3] = ["vignette.png", "vignettesmoothed.png", "mask.png"];

/// Opens a folder of images, with the times of `times.txt` if there is one.
pub(super) fn open(root: &Path, options: SourceOptions) -> Result<Dataset, DatasetError> {
    let Images {
        folder,
        images,
        archive,
    } = find_images(root)?;
    let Kinds {
        colours: images,
        depths,
        poses,
    } = kinds_of(images);
    let times_file = ["times.txt", "timestamps.txt"]
        .into_iter()
        .flat_map(|name| [root.join(name), folder.with_file_name(name)])
        .find(|p| is_file(p));
    let is_at_rate = times_file.is_none();
    let note = archive.as_ref().and_then(|archive| archive.note());
    let mut warnings: Vec<String> = note.into_iter().collect();
    let (layout, entries) = match times_file {
        Some(times) => read_times(&times, images, &mut warnings)?,
        None => {
            let entries = timed(images, options, &folder, &mut warnings)?;
            (Layout::Folder, entries)
        }
    };
    let layout = match (layout, poses.is_empty()) {
        (Layout::Folder, false) => Layout::SevenScenes,
        (layout, _) => layout,
    };
    let (depths, pose_files) = (depths.timed(&entries), poses.timed(&entries));
    let depth = |(timestamp_ns, path)| DepthEntry { timestamp_ns, path };
    Dataset::assemble(
        Parts {
            root: root.to_path_buf(),
            layout,
            list: folder,
            is_at_rate,
            entries,
            depths: depths.into_iter().map(depth).collect(),
            pose_files,
            warnings,
            archive,
            ..Parts::default()
        },
        options,
    )
}

/// The images of a folder with the times that are their names, else at a constant rate.
pub(super) fn timed_by_name(
    folder: &Path,
    options: SourceOptions,
    warnings: &mut Vec<String>,
) -> Result<Vec<(i64, PathBuf)>, DatasetError> {
    timed(images_in(folder)?, options, folder, warnings)
}

/// Images in natural order with the times that are their names, where these are dates of our time
/// and nobody gave a rate; else at a constant rate.
fn timed(
    images: Vec<PathBuf>,
    options: SourceOptions,
    folder: &Path,
    warnings: &mut Vec<String>,
) -> Result<Vec<(i64, PathBuf)>, DatasetError> {
    let name = |path: &PathBuf| Some(path.file_stem()?.to_str()?.to_owned());
    let names: Option<Vec<String>> = images.iter().map(name).collect();
    let names = names.unwrap_or_default();
    let unit = TimeUnit::of_dates(names.iter().map(String::as_str));
    if let Some(unit) = unit.filter(|_| options.fps.is_none()) {
        let timed = names.iter().zip(&images);
        let timed = timed.map(|(name, path)| Some((unit.parse(name)?, path.clone())));
        if let Some(mut timed) = timed.collect::<Option<Vec<_>>>() {
            warnings.push(format!(
                "the names of the images in {} are taken for their times, in {}",
                folder.display(),
                unit.name()
            ));
            timed.sort();
            return Ok(timed);
        }
    }
    warn_name_order(folder, &images, warnings);
    timed_at_rate(images, options, folder, warnings)
}

/// The folder with images and its images in natural order.
struct Images {
    folder: PathBuf,
    images: Vec<PathBuf>,
    /// The archive that the folder is in.
    archive: Option<Arc<Archive>>,
}

/// The images of a sequence, those in its `images.zip` (TUM monoVO) if there are no others.
fn find_images(root: &Path) -> Result<Images, DatasetError> {
    let candidates =
        std::iter::once(root.to_path_buf()).chain(IMAGE_FOLDERS.iter().map(|name| root.join(name)));
    for folder in candidates.filter(|f| is_folder(f)) {
        let images = images_in(&folder)?;
        if !images.is_empty() {
            return Ok(Images {
                folder,
                images,
                archive: None,
            });
        }
    }
    let zipped = root.join("images.zip");
    if zipped.is_file() {
        let archive = Archive::open(&zipped)?;
        return Ok(Images {
            archive: Some(Arc::clone(&archive)),
            ..find_images(&archive.root())?
        });
    }
    let entries = paths_in(root).map_err(|e| DatasetError::io("read", root, e))?;
    let found = match entries.len() {
        0 => "an empty folder".to_owned(),
        n => format!("{n} files and folders, none of them an image or a list of images"),
    };
    let expected = "images, rgb.txt, times.txt with images/, or mav0/";
    Err(DatasetError::no_frames(root, found, expected))
}

/// Image files directly in a folder, in natural order.
pub(super) fn images_in(folder: &Path) -> Result<Vec<PathBuf>, DatasetError> {
    let paths = paths_in(folder).map_err(|e| DatasetError::io("read", folder, e))?;
    let named = paths
        .into_iter()
        .filter_map(|p| Some((p.file_name()?.to_string_lossy().into_owned(), p)));
    let is_frame = |(name, path): &(String, PathBuf)| is_frame_name(name) && is_file(path);
    let mut named: Vec<(String, PathBuf)> = named.filter(is_frame).collect();
    named.sort_by(|a, b| natural_order(&a.0, &b.0));
    Ok(named.into_iter().map(|(_, path)| path).collect())
}

fn is_frame_name(name: &str) -> bool {
    let lower = name.to_ascii_lowercase();
    let extension = lower.rsplit_once('.').map_or("", |(_, e)| e);
    !lower.starts_with('.')
        && IMAGE_ENDINGS.contains(&extension)
        && !NOT_FRAMES.contains(&lower.as_str())
}

/// Other programs sort by bytes; who compares with them should know.
fn warn_name_order(folder: &Path, images: &[PathBuf], warnings: &mut Vec<String>) {
    if !images.is_sorted() {
        warnings.push(format!(
            "the names in {} were put into natural order (frame2 before frame10), which is not \
             their alphabetical order",
            folder.display()
        ));
    }
}

/// Frames at a constant rate, the first at time 0.
pub(super) fn timed_at_rate(
    images: Vec<PathBuf>,
    options: SourceOptions,
    source: &Path,
    warnings: &mut Vec<String>,
) -> Result<Vec<(i64, PathBuf)>, DatasetError> {
    let fps = rate(options, source)?;
    if options.fps.is_none() {
        warnings.push(format!(
            "{} has no times; {DEFAULT_FPS} frames per second assumed (set the rate with --fps)",
            source.display()
        ));
    }
    let timed = |(i, path): (usize, PathBuf)| ((i as f64 * 1e9 / fps).round() as i64, path);
    Ok((0..).zip(images).map(timed).collect())
}

/// The rate of images without times, Hz.
pub(super) fn rate(options: SourceOptions, source: &Path) -> Result<f64, DatasetError> {
    let fps = options.fps.unwrap_or(DEFAULT_FPS);
    if fps.is_finite() && (1e-3..=1e5).contains(&fps) {
        return Ok(fps);
    }
    let found = format!("{fps} frames per second");
    let expected = "a frame rate between 0.001 and 100000";
    Err(DatasetError::content(source, found, expected))
}

/// Frames with the times of a `times.txt`: a time per line (KITTI), or id, time and exposure (TUM
/// monoVO), where the id is the stem of the image.
fn read_times(
    times: &Path,
    images: Vec<PathBuf>,
    warnings: &mut Vec<String>,
) -> Result<(Layout, Vec<(i64, PathBuf)>), DatasetError> {
    let text = read_text(times)?;
    if let Some(dates) = parse_dates(&text, times) {
        return Ok((Layout::KittiRaw, numbered(&dates?, images)));
    }
    let (with_ids, parsed, unit) = parse_times(&text, times)?;
    note_unit(times, unit, TimeUnit::Seconds, warnings);
    if parsed.len() != images.len() {
        warnings.push(format!(
            "{} has {} times for {} images; only those with both are used",
            times.display(),
            parsed.len(),
            images.len()
        ));
    }
    // ids that are no file names still number the images when there is one for each
    let is_id = |stem: &OsStr| parsed.iter().any(|(id, _)| stem == *id);
    let is_named = |image: &PathBuf| image.file_stem().is_some_and(is_id);
    let ids_are_names = with_ids && images.iter().any(is_named);
    if !ids_are_names && (!with_ids || parsed.len() == images.len()) {
        let layout = match with_ids {
            true => Layout::TumMonoVo,
            false => Layout::Kitti,
        };
        let entries = parsed.iter().map(|p| p.1).zip(images).collect();
        return Ok((layout, entries));
    }
    let entries = pair_by_name(&parsed, images);
    if entries.is_empty() {
        let found = format!(
            "{} ids, none of which is the name of an image",
            parsed.len()
        );
        let expected = "ids that are file names without their ending";
        return Err(DatasetError::no_frames(times, found, expected));
    }
    Ok((Layout::TumMonoVo, entries))
}

/// The dates of a raw recording of KITTI, one for each line.
fn parse_dates(text: &str, times: &Path) -> Option<Result<Vec<i64>, DatasetError>> {
    parse_date(data_lines(text).next()?.1)?;
    let date = |(number, line)| {
        let expected = "a date such as 2011-09-26 13:02:25.964389445";
        parse_date(line).ok_or_else(|| DatasetError::line(times, number, line, expected))
    };
    Some(data_lines(text).map(date).collect())
}

/// Images with the times of the lines that have their numbers, from 0; with those of the lines in
/// turn where their names are no numbers.
fn numbered(times_ns: &[i64], images: Vec<PathBuf>) -> Vec<(i64, PathBuf)> {
    let timed = |(turn, path): (usize, PathBuf)| {
        let number = path.file_stem()?.to_str()?.parse().ok();
        Some((*times_ns.get(number.unwrap_or(turn))?, path))
    };
    images.into_iter().enumerate().filter_map(timed).collect()
}

/// First word and time of each line.
type Times<'a> = Vec<(&'a str, i64)>;

/// Whether the lines begin with ids, per line its first word and its time, and their unit.
fn parse_times<'a>(
    text: &'a str,
    times: &Path,
) -> Result<(bool, Times<'a>, TimeUnit), DatasetError> {
    let mut lines = data_lines(text).peekable();
    let first = lines.peek();
    let with_ids = first.is_some_and(|(_, line)| line.split_whitespace().nth(1).is_some());
    let column = usize::from(with_ids);
    let in_column = |line: &'a str| line.split_whitespace().nth(column);
    let unit = TimeUnit::of(data_lines(text).filter_map(|(_, line)| in_column(line)));
    let parse = |(number, line): (usize, &'a str)| {
        let id = line.split_whitespace().next().unwrap_or_default();
        let time = in_column(line).and_then(|time| unit.parse(time));
        time.map(|time| (id, time)).ok_or_else(|| {
            let expected = "a time in seconds, or id, time and exposure";
            DatasetError::line(times, number, line, expected)
        })
    };
    Ok((with_ids, lines.map(parse).collect::<Result<_, _>>()?, unit))
}

/// Times with the images that are called as their ids.
fn pair_by_name(parsed: &[(&str, i64)], images: Vec<PathBuf>) -> Vec<(i64, PathBuf)> {
    let stem = |p: PathBuf| Some((p.file_stem()?.to_string_lossy().into_owned(), p));
    let mut by_stem: Vec<(String, PathBuf)> = images.into_iter().filter_map(stem).collect();
    by_stem.sort();
    let entry = |(id, time): &(&str, i64)| {
        let found = by_stem.binary_search_by(|(stem, _)| stem.as_str().cmp(id));
        Some((*time, by_stem[found.ok()?].1.clone()))
    };
    parsed.iter().filter_map(entry).collect()
}
