//! Tracking, mapping and listeners put together.

use crate::finished::{Cpu, Finished};
use crate::listener::{Listener, ListenerError, Listening, Run};
use crate::mapper::MapperThread;
use crate::panics::{attempt, message_of};
use crate::preparation::{Preparation, Preparer};
use crate::read_frame::ReadFrame;
use crate::readings::LiveReadings;
use crate::shutter::Rectifier;
use crate::source::{FrameSource, ReadOn, Reading, read_ahead};
use crate::unusable::Unusable;
use monogrid_geometry::{Camera, Sim3};
use monogrid_image::{GrayImage, Mask, Photometric, WorkingSize};
use monogrid_inertial::{Imu, ImuSample};
use monogrid_mapping::{
    KeyframeCamera, LiveMaps, MapQuality, MapReader, Mapper, MappingConfig, z_up_from_camera_world,
};
use monogrid_occupancy::{MapError, OccupancyMap};
use monogrid_slam::{
    Effort, FrameInput, FrameReport, Purpose, Slam, SlamConfig, SpillError, StoredMap, Told,
};
use std::ops::ControlFlow;
use std::sync::Arc;
use std::sync::mpsc::Receiver;

/// Everything that decides the result of a pipeline, besides its camera and its images.
#[derive(Clone, Debug)]
pub struct Settings {
    /// Tracking, depth and keyframes.
    pub slam: SlamConfig,
    /// Occupancy maps.
    pub mapping: MappingConfig,
    /// Seed of everything random.
    pub seed: u64,
    /// Threads that build maps, at least 1; no result depends on it.
    pub threads: usize,
    /// Size of the images that are worked with.
    pub working_size: WorkingSize,
    /// Of the size of the images, 0 where pixels must be ignored.
    pub mask: Option<Mask>,
    /// Correction of response and vignette.
    pub photometric: Photometric,
    /// Time that the camera takes from its first row to the last, ms; 0 where it reads all at once.
    pub readout_ms: f64,
    /// Readings of an inertial sensor beside the camera, on the clock of the images; of a live one
    /// those of before the first image, or none ([`Pipeline::push_readings`]).
    pub imu: Option<Arc<Imu>>,
    /// The number of the first frame of which the depth was measured, where one is: the run begins
    /// with that, and frames before it are tracked backwards.
    pub first_measured: Option<usize>,
    /// The frame of the maps, where no inertial sensor makes it level and metric. By default they
    /// are z up as the first camera was held.
    pub map_from_world: Sim3,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            slam: SlamConfig::default(),
            mapping: MappingConfig::default(),
            seed: 0,
            threads: std::thread::available_parallelism().map_or(1, std::num::NonZero::get),
            working_size: WorkingSize::AUTOMATIC,
            mask: None,
            photometric: Photometric::default(),
            readout_ms: 0.0,
            imu: None,
            first_measured: None,
            map_from_world: z_up_from_camera_world(),
        }
    }
}

impl Settings {
    /// How images of a camera become working images.
    #[must_use]
    pub fn preparation(&self, camera: &Camera) -> Preparation {
        let (mask, photometric) = (self.mask.as_ref(), self.photometric.clone());
        let prepared = Preparation::new(camera, self.working_size, mask, photometric);
        prepared.with_readout_ms(self.readout_ms)
    }

    /// The settings of a profile: `default`, `fast` (for small computers) or `thesis` (LSD-SLAM and
    /// the mapping rules of the thesis); `None` for other names.
    #[must_use]
    pub fn of_profile(name: &str) -> Option<Self> {
        let mut settings = Self::default();
        match name {
            "default" => {}
            "fast" => {
                settings.working_size = WorkingSize::Pixels(400 * 300);
                settings.mapping.quality = MapQuality::Fast;
                // in smaller images the start takes longer to be sure of; as many more of them fit
                // in the same memory
                settings.slam.initialization.max_buffered_frames *= 2;
                // the second round moves points by hundredths of a pixel
                settings.slam.sparse.final_rounds = 1;
            }
            "thesis" => {
                settings.slam = SlamConfig::thesis();
                settings.mapping = MappingConfig::thesis();
            }
            _ => return None,
        }
        Some(settings)
    }
}

/// Why a pipeline cannot begin, or not end well.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum PipelineError {
    /// A setting, or a map to go on with, that cannot be.
    #[error("{0}")]
    Settings(String),
    /// A map that cannot be built.
    #[error(transparent)]
    Map(#[from] MapError),
    /// Depth of keyframes is lost, so that maps would lack it.
    #[error(transparent)]
    Spilled(#[from] SpillError),
    /// The system has no more threads.
    #[error("cannot start a thread: {0}")]
    Thread(#[from] std::io::Error),
    /// A part of the pipeline has panicked, which is a fault of the program.
    #[error("the {part} failed: {message}")]
    Failed {
        /// Which part.
        part: &'static str,
        /// What its panic says.
        message: String,
    },
    /// A listener gave up.
    #[error("a listener failed: {0}")]
    Listener(#[source] ListenerError),
}

/// A running system: frames in, events and a map that grows out. The calling thread tracks.
#[derive(Debug)]
pub struct Pipeline {
    preparation: Preparation,
    preparer: Preparer,
    /// Of images that are pushed, where rows are read one after the other.
    rectifier: Option<Rectifier>,
    /// Of an inertial sensor that is read while images are pushed.
    readings: LiveReadings,
    slam: Slam,
    listeners: Vec<Listening>,
    mapper: MapperThread,
    /// The settings of the mapper, to make maps of should it fail.
    empty: Mapper,
    threads: usize,
    map_from_world: Sim3,
    num_frames: usize,
    /// Whether there is a map of an earlier session that must not change.
    localise_only: bool,
}

impl Pipeline {
    /// A pipeline that starts from nothing, for images of `camera`.
    ///
    /// # Errors
    /// A setting outside its range.
    pub fn new(camera: &Camera, settings: Settings) -> Result<Self, PipelineError> {
        Self::with(settings.preparation(camera), settings, None)
    }

    /// A pipeline for images that are prepared by `preparation` (the settings' size, mask,
    /// correction and shutter are not used), which goes on with a map if there is one.
    ///
    /// # Errors
    /// A setting outside its range, or a map that is not of these settings.
    pub fn with(
        preparation: Preparation,
        settings: Settings,
        earlier: Option<(StoredMap, Purpose)>,
    ) -> Result<Self, PipelineError> {
        let pinhole = *preparation.pinhole();
        let mask = preparation.mask().clone();
        let localise_only = matches!(earlier, Some((_, Purpose::LocaliseOnly)));
        let (slam, seed) = (settings.slam, settings.seed);
        let refused = |error: &dyn ToString| PipelineError::Settings(error.to_string());
        let mut slam = match earlier {
            None => Slam::new(slam, pinhole, mask, seed).map_err(|error| refused(&error))?,
            Some((map, purpose)) => Slam::continue_from(slam, pinhole, mask, seed, map, purpose)
                .map_err(|error| refused(&error))?,
        };
        if let Some(imu) = settings.imu {
            slam = slam.with_imu(imu);
        }
        if let Some(index) = settings.first_measured {
            slam = slam.with_first_measured(index);
        }
        let camera = KeyframeCamera::new(pinhole, preparation.size());
        let mapper = Mapper::new(settings.mapping, settings.threads);
        let maps = LiveMaps::new(mapper.clone(), settings.map_from_world)?;
        let pipeline = Self {
            rectifier: preparation.shutter().map(Rectifier::new),
            preparation,
            preparer: Preparer::default(),
            readings: LiveReadings::default(),
            slam,
            listeners: Vec::new(),
            mapper: MapperThread::start(maps, camera)?,
            empty: mapper,
            threads: settings.threads,
            map_from_world: settings.map_from_world,
            num_frames: 0,
            localise_only,
        };
        pipeline.tell();
        Ok(pipeline)
    }

    /// Adds a listener, which hears of everything from now on, in a thread of its own. The
    /// keyframes of an earlier session are new to it when no frame was taken yet. Nothing is said
    /// of a map that must not change.
    ///
    /// # Errors
    /// When the system has no more threads.
    pub fn listen(&mut self, listener: impl Listener) -> Result<(), PipelineError> {
        if self.localise_only {
            return Ok(());
        }
        let listening = Listening::start(Box::new(listener))?;
        if self.num_frames == 0 {
            let events = self.slam.events().iter();
            events.for_each(|event| listening.tell(event));
        }
        self.listeners.push(listening);
        Ok(())
    }

    /// For threads that read the maps while they grow, in the frame of the settings. From now on
    /// the mapper keeps them up to date.
    ///
    /// # Errors
    /// A map that would exceed its memory.
    pub fn live_map(&self) -> Result<MapReader, PipelineError> {
        let reader = self.live_map_later().recv();
        let ended = |_| PipelineError::Failed {
            part: "mapper",
            message: "it has ended".to_owned(),
        };
        Ok(reader.map_err(ended)??)
    }

    /// As [`Self::live_map`] without waiting until the keyframes of now are in the maps: where the
    /// reader will arrive.
    #[must_use]
    pub fn live_map_later(&self) -> Receiver<Result<MapReader, MapError>> {
        self.mapper.ask_for_reader()
    }

    /// What maps are built with.
    #[must_use]
    pub fn mapper(&self) -> &Mapper {
        &self.empty
    }

    /// How images become working images.
    #[must_use]
    pub fn preparation(&self) -> &Preparation {
        &self.preparation
    }

    /// The system: keyframes, poses, counts.
    #[must_use]
    pub fn slam(&self) -> &Slam {
        &self.slam
    }

    /// The map as it is now: all keyframes that are finished, in the frame of the settings; `None`
    /// before the first. It stays as it is while the pipeline goes on. [`Self::live_map`] is for
    /// threads that look often.
    ///
    /// # Errors
    /// A map that would exceed its memory.
    pub fn map(&self) -> Result<Option<Arc<OccupancyMap>>, PipelineError> {
        let view = self.live_map()?.latest();
        Ok(view.map(|view| Arc::clone(&view.global)))
    }

    /// Adjusts the keyframes in the end by what the calibration has left of the radial distortion
    /// ([`Slam::take_left_radial`]).
    pub fn take_left_radial(&mut self, radial: f64) {
        self.slam.take_left_radial(radial);
    }

    /// Takes the next image of the camera (grey, 0 to 255); what became of it. With a rolling
    /// shutter, what became of the image before ([`FrameReport::index`]): its rows are put right by
    /// what moved until this one. An image that is newer than the readings of a live inertial
    /// sensor waits for them until the next image.
    ///
    /// # Errors
    /// An image of another size than the camera's, or one that repeats the one before;
    /// [`Unusable::Waits`] for the first image of a rolling shutter, and for one that waits for
    /// readings.
    pub fn push(&mut self, image: GrayImage, timestamp_ns: i64) -> Result<FrameReport, Unusable> {
        self.push_telling(image, timestamp_ns, &mut |_| Effort::Whole)
    }

    /// The same; the frame is told of as soon as it has its pose, as by [`Self::track_telling`].
    ///
    /// # Errors
    /// As [`Self::push`].
    pub fn push_telling(
        &mut self,
        image: GrayImage,
        timestamp_ns: i64,
        told: &mut Told<'_>,
    ) -> Result<FrameReport, Unusable> {
        let rectified_later = self.rectifier.as_ref().map_or(0, Rectifier::num_waiting);
        let index = self.num_frames + rectified_later + self.readings.num_waiting();
        let image = self.preparer.next(&self.preparation, &image, false);
        let image = image.inspect_err(|_| self.pass_over())?;
        let frame = ReadFrame {
            index,
            timestamp_ns,
            image: Some(Ok(image)),
            depth: None,
            readout_ms: self.preparation.readout_ms(),
            rectification: None,
            due: None,
        };
        let ready = match &mut self.rectifier {
            None => Some(frame),
            Some(rectifier) => {
                rectifier.add(frame);
                rectifier.take()
            }
        };
        let ready = ready.and_then(|frame| self.readings.take_frame(frame));
        let tracked = ready.and_then(|frame| self.track_read(frame, told));
        tracked.unwrap_or(Err(Unusable::Waits))
    }

    /// Takes readings of a live inertial sensor, which [`Settings::imu`] describes, on the clock of
    /// the images and, as far as possible, before images that are later. What became of the image
    /// that waited for them, if one did. The growing maps ([`Self::live_map`]) become level and
    /// metric when the readings are sure enough.
    pub fn push_readings(
        &mut self,
        readings: &[ImuSample],
    ) -> Option<Result<FrameReport, Unusable>> {
        self.slam.add_readings(readings);
        let newest_ns = readings.iter().map(|reading| reading.timestamp_ns).max()?;
        let ready = self.readings.take_readings(newest_ns)?;
        self.track_read(ready, &mut |_| Effort::Whole)
    }

    /// Tracks a frame that was read; one that cannot be used is counted, nothing is said of one
    /// that was dropped.
    fn track_read(
        &mut self,
        frame: ReadFrame,
        told: &mut Told<'_>,
    ) -> Option<Result<FrameReport, Unusable>> {
        let image = frame.image?.inspect_err(|_| self.pass_over());
        Some(image.map(|image| {
            let frame = FrameInput {
                index: frame.index,
                timestamp_ns: frame.timestamp_ns,
                image,
                depth: frame.depth.and_then(Result::ok),
            };
            self.track_telling(frame, told)
        }))
    }

    /// Takes a working image, with depth to start with if there is some.
    pub fn track(&mut self, frame: FrameInput) -> FrameReport {
        self.track_telling(frame, &mut |_| Effort::Whole)
    }

    /// The same; a frame that is tracked is told of as soon as it has its pose
    /// ([`Slam::process_frame_telling`]): a robot that steers by poses need not wait until the
    /// frame has made the map better, and may say that there is no time for that.
    pub fn track_telling(&mut self, frame: FrameInput, told: &mut Told<'_>) -> FrameReport {
        self.num_frames += 1;
        let report = self.slam.process_frame_telling(frame, told);
        self.tell();
        if self.readings.is_question_due(&report)
            && let Some(path) = self.slam.inertial_path()
        {
            self.mapper.be_level(path);
        }
        report
    }

    /// Counts a frame of the source that is not tracked.
    pub fn pass_over(&mut self) {
        self.num_frames += 1;
    }

    /// Takes all frames of a source, decoded and prepared ahead in a thread of its own, until there
    /// are no more or `heard` breaks; it is told what became of each.
    ///
    /// # Errors
    /// When the system has no more threads.
    pub fn run(
        &mut self,
        source: impl FrameSource,
        mut heard: impl FnMut(usize, Result<&FrameReport, &Unusable>) -> ControlFlow<()>,
    ) -> Result<(), PipelineError> {
        let preparation = self.preparation.clone();
        read_ahead(source, &preparation, Reading::default(), |frame| {
            let index = frame.index;
            if let Some(outcome) = self.track_read(frame, &mut |_| Effort::Whole) {
                heard(index, outcome.as_ref())?;
            }
            ControlFlow::Continue(ReadOn::AsBefore)
        })?;
        Ok(())
    }

    /// Whether the mapper or a listener has panicked: the run should be finished, which says why
    /// ([`Finished::failure`]).
    #[must_use]
    pub fn has_failed(&self) -> bool {
        self.mapper.has_failed() || self.listeners.iter().any(Listening::has_failed)
    }

    /// Finishes the last keyframe and ends all threads.
    ///
    /// # Errors
    /// What a listener gave up for, or that a thread has panicked; [`Self::finish_telling`] has
    /// what there is all the same. Maps that could not grow are said by [`Finished::maps`].
    pub fn finish(self) -> Result<Finished, PipelineError> {
        let mut finished = self.finish_telling(&mut |_| ());
        finished.failure.take().map_or(Ok(finished), Err)
    }

    /// The same; `released` hears of it when the last frame is processed, only what was found is
    /// still there, and images and depth of keyframes are not needed for a while
    /// ([`Slam::conclude`]): a good time to give memory back. What went wrong is
    /// [`Finished::failure`], beside all that was found until then.
    pub fn finish_telling(mut self, released: &mut dyn FnMut(&Slam)) -> Finished {
        let mut failure = attempt(|| self.conclude(released))
            .map_err(|message| PipelineError::Failed {
                part: "tracking",
                message,
            })
            .err();
        let Self {
            mut slam,
            listeners,
            mapper,
            num_frames,
            ..
        } = self;
        let mut cpu = Cpu::default();
        let run = Run {
            slam: &slam,
            num_frames,
        };
        for listener in listeners {
            match listener.join(run) {
                Ok(time) => cpu.listening += time,
                Err(error) => failure = failure.or(Some(PipelineError::Listener(error))),
            }
        }
        let (maps, must_be_remade) = match mapper.join() {
            Ok((maps, mapping)) => {
                cpu.mapping = mapping;
                (maps, false)
            }
            Err(panic) => {
                let message = message_of(&*panic);
                failure = failure.or(Some(PipelineError::Failed {
                    part: "mapper",
                    message,
                }));
                (LiveMaps::new(self.empty, self.map_from_world), true)
            }
        };
        let map_size = slam.map_size();
        if failure.is_none() {
            slam.release();
        }
        Finished {
            map_size,
            trajectory: slam.whole_trajectory(),
            poses: slam.snapshot(),
            slam,
            maps: Some(maps),
            must_be_remade,
            failure,
            cpu,
            threads: self.threads,
            map_from_world: self.map_from_world,
            localise_only: self.localise_only,
        }
    }

    /// Tracks what still waits, finishes the last keyframe and adjusts all of them.
    fn conclude(&mut self, released: &mut dyn FnMut(&Slam)) {
        if let Some(frame) = self.readings.take_waiting() {
            self.track_read(frame, &mut |_| Effort::Whole);
        }
        if let Some(mut rectifier) = self.rectifier.take() {
            rectifier.finish();
            while let Some(frame) = rectifier.take() {
                self.track_read(frame, &mut |_| Effort::Whole);
            }
        }
        self.slam.conclude(released);
        self.tell();
    }

    /// Tells everybody what the last call has changed.
    fn tell(&self) {
        for event in self.slam.events() {
            let listeners = self.listeners.iter();
            listeners.for_each(|listener| listener.tell(event));
            self.mapper.tell(event);
        }
    }
}
