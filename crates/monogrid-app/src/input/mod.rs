//! Opening a source: frames, calibration, working images.

pub mod depth_images;
pub mod frame_colours;
pub mod frame_masks;
pub mod image_files;
pub mod readings;
pub mod seen;
pub mod video_source;

use self::frame_colours::FrameColours;
use self::frame_masks::FrameMasks;
use self::image_files::read_files;
use self::readings::Inertial;
use self::seen::Motion;
use self::video_source::{VideoItem, VideoSource, check_topic, is_video};
use crate::args::SourceArgs;
use crate::camera::self_calibration::{Expected, OwnCalibration};
use crate::process::failure::{Classify, Failure};
use crate::process::interrupt::is_interrupted;
use monogrid_calibration::CameraMotion;
use monogrid_datasets::{
    Calibration, Dataset, FixedPart, FrameEntry, Levels, SourceOptions, read_gray_in,
    read_photometric,
};
use monogrid_geometry::{Camera, Pinhole, ReadoutDirection, Se3};
use monogrid_image::{GrayImage, Mask, Photometric, WorkingSize};
use monogrid_pipeline::{Preparation, SourceFrame, Unusable};

use monogrid_video::{Patience, is_recording, is_video_file};
use monogrid_worlds::SynthSequence;
use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

/// Images in a row that may be unreadable before a source is given up.
pub const MAX_UNREADABLE_IN_A_ROW: usize = 10;

/// Where images come from.
#[derive(Debug)]
pub enum Images {
    /// Files.
    Files(Box<Dataset>),
    /// A video, camera or stream.
    Video(Box<VideoSource>),
    /// A built-in world, rendered frame by frame.
    Rendered(Box<SynthSequence>),
}

impl Images {
    /// All frames in order, as the camera took them; none of what is rendered. What a video shows
    /// beside luma goes to `colours`.
    fn items<'a>(
        &'a self,
        (frames, reading): (&[FrameEntry], &'a Reading),
        colours: Option<&'a FrameColours>,
    ) -> Box<dyn Iterator<Item = VideoItem> + Send + 'a> {
        let items = match self {
            Self::Files(dataset) => {
                let files = (frames.to_vec(), reading.levels, dataset.pixel_budget());
                read_files(files, reading.patience, &reading.cpu_ns)
            }
            Self::Video(video) => video.frames(colours),
            Self::Rendered(_) => Box::new(std::iter::empty()),
        };
        match &reading.masks {
            Some(masks) => masks.applied(items),
            None => items,
        }
    }

    /// Whether they can be read more than once.
    fn is_repeatable(&self) -> bool {
        match self {
            Self::Files(_) | Self::Rendered(_) => true,
            Self::Video(video) => video.is_file,
        }
    }

    /// The images that can be read and their times, ns, until the source ends; where it breaks off,
    /// why goes to `broke_off`.
    fn readable<'a>(
        &'a self,
        source: (&[FrameEntry], &'a Reading),
        mut broke_off: impl FnMut(Unusable) + 'a,
    ) -> impl Iterator<Item = (i64, GrayImage)> + 'a {
        let items = self.items(source, None);
        items.filter_map(move |(_, time_ns, image)| match image {
            Ok(image) => Some((time_ns, image)),
            Err(reason) => {
                if matches!(reason, Unusable::BrokeOff(_)) {
                    broke_off(reason);
                }
                None
            }
        })
    }
}

/// How a source is read.
#[derive(Debug)]
pub struct Reading {
    patience: Patience,
    /// What the files use of 16 bits.
    pub levels: Levels,
    /// What must not be seen of each frame.
    pub masks: Option<Arc<FrameMasks>>,
    /// CPU time of the last reading of files, ns.
    cpu_ns: AtomicU64,
}

impl Default for Reading {
    fn default() -> Self {
        Self {
            patience: Patience::default(),
            levels: Levels::ALL,
            masks: None,
            cpu_ns: AtomicU64::default(),
        }
    }
}

impl Reading {
    fn with(patience: Patience) -> Self {
        Self {
            patience,
            ..Self::default()
        }
    }
}

/// Images of a camera of which nothing is known.
#[derive(Debug)]
pub struct RawInput {
    /// For people and for names of folders.
    pub name: String,
    images: Images,
    frames: Vec<FrameEntry>,
    reading: Reading,
}

impl RawInput {
    /// Opens a source without asking for a calibration.
    pub fn open(source: &Path, args: &SourceArgs) -> Result<Self, Failure> {
        check_topic(source, args)?;
        let reading = Reading::with(args.patience(source));
        if is_video(source) {
            let video = VideoSource::open(source, args)?;
            let (name, images) = (video.name(), Images::Video(Box::new(video)));
            let masks = FrameMasks::open(args, None)?.map(Arc::new);
            return Ok(Self {
                name,
                images,
                frames: Vec::new(),
                reading: Reading { masks, ..reading },
            });
        }
        let options = SourceOptions { fps: args.fps };
        let mut dataset = Dataset::open(source, options).bad_input()?;
        // those of the whole source: what a part of it shows is the same as in the whole
        let levels = Levels::of_images(dataset.frames.iter().map(|frame| &*frame.path));
        dataset.warnings.extend(levels.note());
        let (name, frames) = (dataset.name.clone(), selected(&dataset, args)?);
        let images = Images::Files(Box::new(dataset));
        let masks = FrameMasks::open(args, Some(&frames))?.map(Arc::new);
        Ok(Self {
            name,
            images,
            frames,
            reading: Reading {
                levels,
                masks,
                ..reading
            },
        })
    }

    /// The images that can be read (grey, 0 to 255), once; where the source breaks off, why goes to
    /// `broke_off`.
    pub fn images<'a>(
        &'a self,
        broke_off: impl FnMut(Unusable) + 'a,
    ) -> impl Iterator<Item = GrayImage> + 'a {
        let source = (self.frames.as_slice(), &self.reading);
        let images = self.images.readable(source, broke_off);
        images.map(|(_, image)| image)
    }

    /// The files of a folder.
    pub fn dataset(&self) -> Option<&Dataset> {
        match &self.images {
            Images::Files(dataset) => Some(dataset),
            Images::Video(_) | Images::Rendered(_) => None,
        }
    }

    /// Width and height of the images, and which way a rolling shutter runs over them.
    fn shape(&self) -> Result<Shape, Failure> {
        if let Images::Video(video) = &self.images {
            return Ok((video.size, video.direction));
        }
        let size = match &self.images {
            Images::Files(dataset) => usual_size(&self.frames, &self.reading, dataset)?,
            _ => return Err(Failure::input("the source has no frames")),
        };
        Ok((size, ReadoutDirection::of_size(size)))
    }

    /// The calibration that was named, lies in the source, or was recorded with the images; the
    /// field of view in its place stands above the latter two.
    fn calibration(
        &self,
        args: &SourceArgs,
        size: (usize, usize),
    ) -> Result<Option<Calibration>, Failure> {
        match (&args.calibration, &self.images) {
            (Some(path), Images::Files(dataset)) => {
                let read = dataset.read_calibration(path, Some(size));
                read.map(Some).bad_input()
            }
            (Some(path), _) => Calibration::read(path, Some(size)).map(Some).bad_input(),
            (None, Images::Files(dataset)) if args.fov.is_none() => {
                dataset.calibration(Some(size)).bad_input()
            }
            (None, Images::Video(video)) if args.fov.is_none() => recorded_calibration(video),
            _ => Ok(None),
        }
    }

    /// The camera that the images show; where they do not, an ordinary one, and why.
    fn own_calibration(
        &self,
        shape: Shape,
        fixed: Option<&FixedPart>,
    ) -> Result<OwnCalibration, Failure> {
        let first = self.frames.first();
        let expected = first.map_or(Expected::ORDINARY, |frame| {
            Expected::of_image(&frame.path, shape.0)
        });
        let expected = expected.within(fixed.map(|fixed| fixed.picture), shape.0);
        let assumed = |reason: &str| {
            OwnCalibration::assumed(shape.0, &expected, reason)
                .ok_or_else(|| no_calibration("no calibration"))
        };
        if !self.images.is_repeatable() {
            return assumed("what is seen only once cannot show its camera first");
        }
        let mut broke_off = None;
        let source = (self.frames.as_slice(), &self.reading);
        let images = self
            .images
            .readable(source, |reason| broke_off = Some(reason));
        let mask = fixed.map(|fixed| &fixed.mask);
        let own = OwnCalibration::from_images(images, (shape, mask), &expected);
        if is_interrupted() {
            // nothing will be tracked with it
            return assumed("nobody waited").map_err(|_| Failure::Interrupted);
        }
        match (own, broke_off) {
            (Ok(own), _) => Ok(own),
            (Err(_), Some(reason)) => Err(Failure::running(reason)),
            (Err(reason), None) => {
                assumed(&format!("{reason} (the map of a first pass may show it)"))
            }
        }
    }

    /// The part of the picture that is fixed to the camera; none of what is seen only once, or is
    /// rendered.
    fn fixed_part(&self, size: (usize, usize)) -> Option<FixedPart> {
        let source = (self.frames.as_slice(), &self.reading);
        match &self.images {
            Images::Files(_) => {
                let sampled = seen::sampled(self.frames.len());
                let frames: Vec<FrameEntry> = sampled.map(|at| self.frames[at].clone()).collect();
                let images = self.images.readable((&frames, &self.reading), |_| {});
                seen::fixed_in(size, images.map(|(_, image)| image))
            }
            Images::Video(video) if video.is_file => {
                let images = self.images.readable(source, |_| {});
                seen::fixed_in_video(size, images.map(|(_, image)| image))
            }
            Images::Video(_) | Images::Rendered(_) => None,
        }
    }
}

/// Width and height of images, and which way a rolling shutter runs over them.
type Shape = ((usize, usize), ReadoutDirection);

/// A source that is ready to be read.
#[derive(Debug)]
pub struct Input {
    /// For people and for names of folders.
    pub name: String,
    /// Where images come from.
    pub images: Images,
    /// The frames to use, in order; those of a built-in world have no path, a video lists none.
    pub frames: Vec<FrameEntry>,
    /// How the calibration was understood, for people.
    pub interpretation: String,
    /// Where the camera was not given.
    pub own_calibration: Option<OwnCalibration>,
    /// From images of the camera to working images.
    pub preparation: Preparation,
    /// Whether somebody said how long the camera takes from the first row to the last, or that it
    /// takes no time.
    pub is_shutter_known: bool,
    /// The inertial sensor beside the camera, where there is one.
    pub inertial: Option<Inertial>,
    /// The part of the picture that is fixed to the camera.
    pub fixed: Option<FixedPart>,
    /// How the camera moves, where somebody has looked.
    pub motion: Option<Motion>,
    /// What looked odd, in sentences for people.
    pub warnings: Vec<String>,
    /// How it is read.
    pub reading: Reading,
}

/// What a source knows of its camera at some time.
#[derive(Debug)]
pub struct CameraOfInput {
    interpretation: String,
    own_calibration: Option<OwnCalibration>,
    preparation: Preparation,
    warnings: Vec<String>,
}

impl Input {
    /// Opens a source. Its images are worked with at the `usual` size, where the arguments say no
    /// other.
    pub fn open(source: &Path, args: &SourceArgs, usual: WorkingSize) -> Result<Self, Failure> {
        let raw = RawInput::open(source, args)?;
        let (size, direction) = raw.shape()?;
        let mut given = raw.calibration(args, size)?;
        if let (Some(calibration), Images::Video(video)) = (&mut given, &raw.images) {
            make_square(calibration, video);
        }
        let fixed = raw.fixed_part(size);
        let from_images = || raw.own_calibration((size, direction), fixed.as_ref());
        let known = known_camera(given, args, size, from_images)?;
        let dataset = raw.dataset();
        let photometric = dataset.map_or_else(
            || Ok(Photometric::default()),
            |dataset| {
                let vignette = dataset.vignette_path.as_deref();
                read_photometric(dataset.response_path.as_deref(), vignette).bad_input()
            },
        )?;
        if let Some(masks) = &raw.reading.masks {
            masks.check(size)?;
        }
        let preparation = preparation(&known, (args, usual, fixed.as_ref()), photometric)?;
        let (inertial, no_readings) = readings(&raw, args, known.body_from_camera)?;
        let mut warnings = match &raw.images {
            Images::Files(dataset) => dataset.warnings.clone(),
            Images::Video(video) => video.notes.clone(),
            Images::Rendered(_) => Vec::new(),
        };
        warnings.extend(known.warnings);
        warnings.extend(fixed.as_ref().map(FixedPart::finding));
        warnings.extend(no_readings);
        Ok(Self {
            name: raw.name,
            images: raw.images,
            frames: raw.frames,
            interpretation: known.interpretation,
            own_calibration: known.own,
            preparation: preparation.with_readout_direction(direction),
            is_shutter_known: known.readout_ms.is_some(),
            inertial,
            fixed,
            motion: None,
            warnings,
            reading: raw.reading,
        })
    }

    /// A built-in world.
    pub fn rendered(sequence: SynthSequence, size: WorkingSize) -> Self {
        let frames = (0..sequence.len())
            .map(|index| FrameEntry {
                index,
                timestamp_ns: sequence.timestamp_ns(index).unwrap_or_default(),
                path: PathBuf::new(),
            })
            .collect();
        let camera = *sequence.camera();
        Self {
            name: "demo".to_owned(),
            images: Images::Rendered(Box::new(sequence)),
            frames,
            interpretation: String::new(),
            own_calibration: None,
            preparation: Preparation::new(&camera, size, None, Photometric::default()),
            is_shutter_known: true,
            inertial: None,
            fixed: None,
            motion: None,
            warnings: Vec::new(),
            reading: Reading::default(),
        }
    }

    /// The images that can be read, from the first one on; none of what can be read only once, or
    /// is rendered.
    pub fn images_again(&self) -> Box<dyn Iterator<Item = GrayImage> + '_> {
        Box::new(self.timed_images_again().map(|(_, image)| image))
    }

    /// The same with their times, ns.
    pub fn timed_images_again(&self) -> Box<dyn Iterator<Item = (i64, GrayImage)> + '_> {
        match &self.images {
            images if !images.is_repeatable() => Box::new(std::iter::empty()),
            images => {
                let source = (self.frames.as_slice(), &self.reading);
                // a run that needs what is missing says it
                Box::new(images.readable(source, |_| {}))
            }
        }
    }

    /// Whether its images can be read more than once.
    pub fn is_repeatable(&self) -> bool {
        self.images.is_repeatable()
    }

    /// What is known of the camera, to [return](Self::return_to_camera) to it.
    pub fn known_camera(&self) -> CameraOfInput {
        CameraOfInput {
            interpretation: self.interpretation.clone(),
            own_calibration: self.own_calibration.clone(),
            preparation: self.preparation.clone(),
            warnings: self.warnings.clone(),
        }
    }

    /// Takes the camera that was [known](Self::known_camera) before.
    pub fn return_to_camera(&mut self, known: CameraOfInput) {
        self.interpretation = known.interpretation;
        self.own_calibration = known.own_calibration;
        self.preparation = known.preparation;
        self.warnings = known.warnings;
    }

    /// Takes another camera for images of the same size.
    pub fn take_camera(&mut self, own: OwnCalibration) {
        if let Some(replaced) = self.own_calibration.take() {
            self.warnings.retain(|w| !replaced.warnings.contains(w));
        }
        self.preparation = self.preparation.with_camera(&own.camera);
        self.interpretation.clone_from(&own.interpretation);
        self.own_calibration = Some(own);
    }

    /// Intrinsics of the working images.
    pub fn pinhole(&self) -> &Pinhole {
        self.preparation.pinhole()
    }

    /// Width and height of the working images.
    pub fn size(&self) -> (usize, usize) {
        self.preparation.size()
    }

    /// Pixels of the working images that may be used.
    pub fn mask(&self) -> &Mask {
        self.preparation.mask()
    }

    /// The camera of the images.
    pub fn camera(&self) -> &Camera {
        self.preparation.camera()
    }

    /// The camera of the images, and which way a rolling shutter runs over them.
    pub fn lens(&self) -> (&Camera, ReadoutDirection) {
        (self.camera(), self.preparation.readout_direction())
    }

    /// How the camera moves, where that is why there can be no map.
    pub fn no_map(&self) -> Option<CameraMotion> {
        let did = self.motion.map(|motion| motion.did);
        did.filter(|did| seen::no_map(*did).is_some())
    }

    /// Pixels of the images that are not fixed to the camera, where some are.
    pub fn fixed_mask(&self) -> Option<&Mask> {
        self.fixed.as_ref().map(|fixed| &fixed.mask)
    }

    /// Width and height of the image of a frame, 0 where it cannot be read, and its working image.
    pub fn read(&self, frame: &FrameEntry) -> ((usize, usize), Result<GrayImage, Unusable>) {
        match self.read_image(frame) {
            Ok(image) => {
                let size = (image.width(), image.height());
                (size, self.preparation.apply(&image))
            }
            Err(error) => ((0, 0), Err(error)),
        }
    }

    /// The image of a frame as it is.
    fn read_image(&self, frame: &FrameEntry) -> Result<GrayImage, Unusable> {
        match &self.images {
            Images::Files(_) => {
                let image = read_gray_in(&frame.path, self.reading.levels);
                let image = image.map_err(|error| Unusable::Unreadable(error.to_string()))?;
                match &self.reading.masks {
                    Some(masks) => masks.apply_to(frame.index, image),
                    None => Ok(image),
                }
            }
            Images::Video(_) => Err(Unusable::Unreadable("a video lists no frames".to_owned())),
            Images::Rendered(sequence) => {
                let reason = || "the sequence ends before this frame".to_owned();
                let rendered = sequence.frame(frame.index).map(|frame| frame.image);
                rendered.ok_or_else(|| Unusable::Unreadable(reason()))
            }
        }
    }

    /// How many frames there are to use, where that is known.
    pub fn expected_frames(&self) -> Option<usize> {
        match &self.images {
            Images::Video(video) => video.expected_frames,
            Images::Files(_) | Images::Rendered(_) => Some(self.frames.len()),
        }
    }

    /// What was wrong with the frames of a video, in sentences.
    pub fn faults(&self) -> Vec<String> {
        let mut faults = match &self.images {
            Images::Video(video) => video.faults(),
            Images::Files(_) | Images::Rendered(_) => Vec::new(),
        };
        let masks = self.reading.masks.as_ref();
        faults.extend(masks.and_then(|masks| masks.fault()));
        faults
    }

    /// What kind of source it is, for people.
    pub fn layout(&self) -> &str {
        match &self.images {
            Images::Files(dataset) => dataset.layout.name(),
            Images::Video(video) => &video.description,
            Images::Rendered(_) => "built-in world",
        }
    }

    /// All frames one after the other; a stream has them only once. What a video shows beside luma
    /// goes to `colours`.
    pub fn source<'a>(
        &'a self,
        colours: Option<&'a FrameColours>,
    ) -> Box<dyn Iterator<Item = SourceFrame> + Send + 'a> {
        let Images::Rendered(_) = &self.images else {
            let source = (self.frames.as_slice(), &self.reading);
            let frame = |(index, timestamp_ns, image): VideoItem| SourceFrame {
                index,
                timestamp_ns,
                image,
                depth: None,
            };
            return Box::new(self.images.items(source, colours).map(frame));
        };
        Box::new(self.frames.iter().map(|frame| SourceFrame {
            index: frame.index,
            timestamp_ns: frame.timestamp_ns,
            image: self.read_image(frame),
            depth: None,
        }))
    }

    /// CPU time of the last reading, beside that of preparing the images.
    pub fn reading_cpu(&self) -> Duration {
        let cpu_ns = match &self.images {
            Images::Video(video) => &video.cpu_ns,
            Images::Files(_) | Images::Rendered(_) => &self.reading.cpu_ns,
        };
        Duration::from_nanos(cpu_ns.load(Ordering::Relaxed))
    }
}

fn selected(dataset: &Dataset, args: &SourceArgs) -> Result<Vec<FrameEntry>, Failure> {
    let count = dataset.frames.len();
    if args.start >= count {
        return Err(Failure::input(format!(
            "--start {} is beyond the last frame of {}, which has {count} frames",
            args.start,
            dataset.root.display()
        )));
    }
    if args.max_frames == Some(0) {
        return Err(Failure::input("--max-frames is 0, expected at least 1"));
    }
    Ok(chosen(&dataset.frames, args))
}

/// Every n-th frame from the first on, up to as many as are wanted.
fn chosen<T: Clone>(frames: &[T], args: &SourceArgs) -> Vec<T> {
    let every = args.every.map_or(1, NonZeroUsize::get);
    let frames_from_start = frames.iter().skip(args.start).step_by(every);
    let at_most = args.max_frames.unwrap_or(frames.len());
    frames_from_start.take(at_most).cloned().collect()
}

/// Images of one size that make it that of the source, where none of another came before them.
const ALIKE: usize = 3;

/// Width and height of most of the first images that can be decoded; of equally many, those of the
/// earlier ones.
fn usual_size(
    frames: &[FrameEntry],
    reading: &Reading,
    dataset: &Dataset,
) -> Result<(usize, usize), Failure> {
    let cpu_ns = AtomicU64::new(0);
    let tried = frames.len().min(MAX_UNREADABLE_IN_A_ROW);
    let mut first_error = None;
    let mut sizes: Vec<((usize, usize), usize)> = Vec::new();
    let files = (
        frames[..tried].to_vec(),
        reading.levels,
        dataset.pixel_budget(),
    );
    for (.., image) in read_files(files, reading.patience, &cpu_ns) {
        match image {
            Ok(image) => {
                let size = (image.width(), image.height());
                match sizes.iter_mut().find(|(known, _)| *known == size) {
                    Some((_, count)) => *count += 1,
                    None => sizes.push((size, 1)),
                }
                if matches!(*sizes, [(_, ALIKE)]) {
                    break;
                }
            }
            Err(Unusable::BrokeOff(reason)) if sizes.is_empty() => {
                return Err(Failure::running(reason));
            }
            Err(Unusable::BrokeOff(_)) => break,
            Err(error) => {
                first_error.get_or_insert(error);
            }
        }
    }
    // the last of equal ones, from behind
    if let Some((size, _)) = sizes.iter().rev().max_by_key(|(_, count)| *count) {
        return Ok(*size);
    }
    if is_interrupted() {
        return Err(Failure::Interrupted);
    }
    let error = first_error.ok_or_else(|| Failure::input("the source has no frames"))?;
    let said = format!("none of the first {tried} images can be read");
    Err(Failure::Input(anyhow::Error::from(error).context(said)))
}

/// The inertial sensor beside the camera, or why it is left out: of a recording its topic, unless a
/// path is named.
fn readings(
    raw: &RawInput,
    args: &SourceArgs,
    body_from_camera: Option<Se3>,
) -> Result<(Option<Inertial>, Option<String>), Failure> {
    let is_path = args.imu.as_deref().is_some_and(Path::exists);
    if let Images::Video(video) = &raw.images
        && is_recording(&video.path)
        && !is_path
    {
        let readings = Inertial::of_recording(args, &video.path, body_from_camera)?;
        return Ok(match readings {
            Ok(inertial) => (inertial, None),
            Err(reason) => (None, Some(reason)),
        });
    }
    if let Images::Video(video) = &raw.images
        && args.imu.is_none()
        && is_video_file(&video.path)
    {
        return Ok(match Inertial::of_camera(args, &video.path)? {
            Ok(inertial) => (inertial, None),
            Err(reason) => (None, Some(reason)),
        });
    }
    let inertial = Inertial::open(args, raw.dataset(), body_from_camera)?;
    Ok((inertial, None))
}

/// The calibration that was recorded with the images.
fn recorded_calibration(video: &VideoSource) -> Result<Option<Calibration>, Failure> {
    let recorded = video.recorded.as_ref().map_err(|error| {
        Failure::input(format!(
            "{error}; give another calibration with --calibration FILE, or the horizontal field of \
             view with --fov DEG"
        ))
    })?;
    Ok(recorded.map(|camera| Calibration {
        camera,
        body_from_camera: None,
        readout_ms: None,
        format: "CameraInfo of the recording",
        notes: Vec::new(),
        path: video.path.clone(),
    }))
}

/// A camera and where it comes from.
struct KnownCamera {
    camera: Camera,
    /// Time from the first row to the last, where something says it.
    readout_ms: Option<f64>,
    /// Its pose in the body, where something says it.
    body_from_camera: Option<Se3>,
    interpretation: String,
    warnings: Vec<String>,
    own: Option<OwnCalibration>,
}

/// The calibration that was given, else the field of view that was, else what the images show.
fn known_camera(
    given: Option<Calibration>,
    args: &SourceArgs,
    image_size: (usize, usize),
    from_images: impl FnOnce() -> Result<OwnCalibration, Failure>,
) -> Result<KnownCamera, Failure> {
    if let Some(mut calibration) = given {
        scale_to(&mut calibration, image_size)?;
        return Ok(KnownCamera {
            camera: calibration.camera,
            readout_ms: args.rolling_shutter.or(calibration.readout_ms),
            body_from_camera: calibration.body_from_camera,
            interpretation: calibration.interpretation(),
            warnings: calibration.notes,
            own: None,
        });
    }
    let own = match args.fov {
        Some(fov_deg) => OwnCalibration::from_fov(fov_deg, image_size)?,
        None => from_images()?,
    };
    Ok(KnownCamera {
        camera: own.camera,
        readout_ms: args.rolling_shutter.or(own.readout_ms),
        body_from_camera: None,
        interpretation: own.interpretation.clone(),
        warnings: own.warnings.clone(),
        own: Some(own),
    })
}

/// Nothing says what the camera is.
fn no_calibration(reason: &str) -> Failure {
    Failure::input(format!(
        "{reason}; give one with --calibration FILE, or the horizontal field of view with --fov DEG"
    ))
}

/// From images of this camera to working images.
fn preparation(
    known: &KnownCamera,
    (args, usual, fixed): (&SourceArgs, WorkingSize, Option<&FixedPart>),
    photometric: Photometric,
) -> Result<Preparation, Failure> {
    let camera = &known.camera;
    let mask = fixed.map(|fixed| &fixed.mask);
    let size = match args.size {
        None => usual,
        Some((width, height)) => WorkingSize::Exact { width, height },
    };
    let preparation = Preparation::new(camera, size, mask, photometric)
        .with_readout_ms(known.readout_ms.unwrap_or(0.0));
    let usable = preparation.mask().as_slice();
    if usable.iter().all(|&valid| valid == 0) {
        return Err(Failure::input(
            "no pixel of the image may be used: check the calibration",
        ));
    }
    Ok(preparation)
}

/// How much the two ratios of sizes may differ: a rounded row or column.
const MAX_ASPECT_CHANGE: f64 = 0.005;

/// Brings a calibration of another size, but the same picture, to the size of the images; a note
/// says so.
fn scale_to(calibration: &mut Calibration, (width, height): (usize, usize)) -> Result<(), Failure> {
    let camera = &mut calibration.camera;
    let (found_width, found_height) = (camera.width, camera.height);
    if (found_width, found_height) == (width, height) {
        return Ok(());
    }
    let said = format!(
        "calibration {} is for images of {found_width}x{found_height} pixels, the images are \
         {width}x{height}",
        calibration.path.display()
    );
    let factor_x = width as f64 / found_width as f64;
    let factor_y = height as f64 / found_height as f64;
    if (factor_x / factor_y - 1.0).abs() > MAX_ASPECT_CHANGE {
        return Err(Failure::input(format!(
            "{said}, which is another picture and not only another size; calibrate at the size of \
             the images"
        )));
    }
    camera.pinhole = camera.pinhole.scaled(factor_x, factor_y);
    (camera.width, camera.height) = (width, height);
    calibration.notes.push(format!(
        "{said}: it was scaled, which is right if the images were made smaller or larger and \
         nothing was cut off"
    ));
    Ok(())
}

/// Brings a calibration of images as they are stored, whose pixels are not square, to the images
/// that are used; a note says so.
fn make_square(calibration: &mut Calibration, video: &VideoSource) {
    let camera = &mut calibration.camera;
    let (stored_width, stored_height) = video.stored_size;
    let (width, height) = video.size;
    if (camera.width, camera.height) != video.stored_size || video.stored_size == video.size {
        return;
    }
    let factor_x = width as f64 / stored_width as f64;
    let factor_y = height as f64 / stored_height as f64;
    camera.pinhole = camera.pinhole.scaled(factor_x, factor_y);
    (camera.width, camera.height) = video.size;
    calibration.notes.push(format!(
        "calibration {} is for the images as they are stored, {stored_width}x{stored_height}: it \
         was stretched with them",
        calibration.path.display()
    ));
}

#[cfg(test)]
mod tests {
    use super::*;
    use monogrid_datasets::encode_png;
    use monogrid_image::Image;

    #[test]
    fn the_size_of_most_of_the_first_images_counts() {
        let folder = tempfile::tempdir().unwrap();
        let args = SourceArgs {
            fov: Some(60.0),
            ..SourceArgs::default()
        };
        for (sizes, expected) in [
            (vec![40, 80, 80, 80, 40], 80),
            (vec![80, 40, 80, 40], 80),
            (vec![40], 40),
        ] {
            let path = folder.path().join(sizes.len().to_string());
            std::fs::create_dir(&path).unwrap();
            for (k, width) in sizes.into_iter().enumerate() {
                let image = Image::from_fn(width, 60, |x, y| (3 * x + y) as u8);
                std::fs::write(path.join(format!("{k}.png")), encode_png(&image)).unwrap();
            }
            let input = Input::open(&path, &args, WorkingSize::AUTOMATIC).unwrap();
            assert_eq!(input.camera().width, expected);
        }
    }

    #[test]
    fn frames_are_counted_after_those_left_out() {
        let frames: Vec<usize> = (0..10).collect();
        let args = |every: usize, max_frames: Option<usize>| SourceArgs {
            start: 1,
            every: NonZeroUsize::new(every),
            max_frames,
            ..SourceArgs::default()
        };
        assert_eq!(chosen(&frames, &args(0, None)), frames[1..]);
        assert_eq!(chosen(&frames, &args(3, None)), [1, 4, 7]);
        assert_eq!(chosen(&frames, &args(4, Some(2))), [1, 5]);
    }
}
