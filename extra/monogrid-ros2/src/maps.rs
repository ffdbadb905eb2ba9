//! The thread of the maps: publishes what the mapper has when it has something new, how the node
//! is, and writes files.

use crate::args::Args;
use crate::clock::Clock;
use crate::convert::{Condition, MAX_PATH_POSES, NOT_METRIC, diagnostics};
use crate::frames::{frame_of_map, map_from_camera};
use crate::log::{Log, Severity, has_grown};
use crate::save::{save, save_to_load};
use crate::shown::{Seen, Shown};
use crate::topics::MapTopics;
use crate::trail::Trail;
use crate::wheels::Scale;
use crate::work::{Answer, Begun, Counts, Known, News, Tracked, response};
use monogrid_geometry::{Pinhole, Se3, Sim3};
use monogrid_mapping::{LiveView, MapReader};
use monogrid_messages::builtin_interfaces::Time;
use monogrid_messages::diagnostic_msgs::{ERROR, OK};
use monogrid_messages::std_msgs::Header;
use monogrid_occupancy::MapError;
use monogrid_slam::{Keyframe, PoseSnapshot};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError};
use std::sync::{Arc, OnceLock};
use std::time::{Duration, Instant};

/// How often the node says how it is.
const DIAGNOSTICS_EVERY: Duration = Duration::from_secs(1);
/// How often the mapper is asked for a new map while images come.
const ASK_EVERY: Duration = Duration::from_millis(50);
/// A camera that sends nothing for so long is silent.
const SILENT_AFTER: Duration = Duration::from_secs(2);

/// A world that is mapped.
struct World {
    number: u32,
    coming: Receiver<Result<MapReader, MapError>>,
    reader: Arc<OnceLock<MapReader>>,
    pinhole: Pinhole,
    trail: Trail,
    poses: Arc<PoseSnapshot>,
    /// The images with which keyframes were finished, one after the other.
    finished: Vec<Time>,
    /// The newest map that was seen.
    seen: Option<Arc<LiveView>>,
}

/// What was counted since the node began.
#[derive(Default)]
struct Totals {
    processed: u64,
    unusable: u64,
    unusable_because: String,
    unsent: u64,
    tracking_ms: f64,
}

/// Publishes maps.
pub struct Maps {
    args: Args,
    /// How long a unit of the world is, where somebody tells it or wheels have shown it.
    scale: Option<Scale>,
    /// The frame of maps before an inertial sensor has a say.
    map_from_world: Sim3,
    topics: MapTopics,
    counts: Arc<Counts>,
    world: Option<World>,
    condition: Condition,
    totals: Totals,
    last_image: Option<Instant>,
    last_look: Option<Instant>,
    /// How many maps were seen.
    number: u64,
    log: Arc<Log>,
    clock: Arc<Clock>,
    said: Said,
}

/// What was said last.
#[derive(Default)]
struct Said {
    condition: String,
    dropped: u64,
    lost: u64,
    unusable: u64,
    unsent: u64,
}

impl Maps {
    /// With nothing to publish yet; `map_from_world` is the frame of maps before an inertial sensor
    /// has a say.
    #[must_use]
    pub fn new(
        args: Args,
        map_from_world: Sim3,
        topics: MapTopics,
        counts: &Arc<Counts>,
        log: &Arc<Log>,
        clock: &Arc<Clock>,
    ) -> Self {
        Self {
            scale: args.metres_per_unit.map(Scale::given),
            args,
            map_from_world,
            topics,
            counts: Arc::clone(counts),
            log: Arc::clone(log),
            clock: Arc::clone(clock),
            said: Said::default(),
            world: None,
            condition: Condition::Waiting("no image has come yet".to_owned()),
            totals: Totals::default(),
            last_image: None,
            last_look: None,
            number: 0,
        }
    }

    /// Publishes what there is, until no more news come.
    pub fn run(mut self, news: &Receiver<News>) {
        let mut last_said = Instant::now();
        let period = Duration::from_secs_f64(self.args.map_period);
        loop {
            let said = DIAGNOSTICS_EVERY.saturating_sub(last_said.elapsed());
            let last_image = self.last_image;
            let is_awake = last_image.is_some_and(|at| at.elapsed() < SILENT_AFTER);
            let wait = if is_awake { said.min(ASK_EVERY) } else { said };
            match news.recv_timeout(wait) {
                Ok(news) => self.take(news),
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => return,
            }
            if last_said.elapsed() >= DIAGNOSTICS_EVERY {
                last_said = Instant::now();
                self.say_condition();
            }
            self.topics.send_next();
            let is_due = self.last_look.is_none_or(|at| at.elapsed() >= period);
            if is_due && let Err(error) = self.publish_new_map() {
                self.condition = Condition::Waiting(format!("the map cannot be shown: {error}"));
            }
        }
    }

    fn take(&mut self, news: News) {
        match news {
            News::Begun(begun) => {
                let Begun {
                    number,
                    coming,
                    maps,
                    map_from_world,
                    pinhole,
                    finished,
                } = *begun;
                self.map_from_world = map_from_world;
                self.world = Some(World {
                    number,
                    coming,
                    reader: maps,
                    pinhole,
                    trail: Trail::default(),
                    poses: Arc::default(),
                    finished,
                    seen: None,
                });
            }
            News::Tracked(tracked) => self.take_tracked(&tracked),
            News::Unusable(why) => {
                self.last_image = Some(Instant::now());
                self.totals.unusable += 1;
                self.totals.unusable_because = why;
            }
            News::Waiting(why) => {
                self.last_image = None;
                self.condition = Condition::Waiting(why);
            }
            News::Keyframe(world, keyframe, poses) => {
                if let Some(keyframe) = keyframe.load() {
                    let said = format!("keyframe {} finished", keyframe.id);
                    self.log.say(Severity::Debug, &said);
                    self.publish_points(world, &keyframe, &poses);
                }
            }
            News::Scale(scale) => {
                self.say_scale(scale);
                self.scale = scale;
                // the newest map is published once more, since all lengths are others
                self.topics.forget();
            }
            News::Ended => {
                self.world = None;
                self.topics.forget();
                self.condition = Condition::Waiting("begun again".to_owned());
            }
            News::Save(answer, known) => self.save(answer, known),
        }
    }

    fn take_tracked(&mut self, tracked: &Tracked) {
        let report = &tracked.report;
        self.last_image = Some(Instant::now());
        self.totals.processed += 1;
        self.totals.unsent += tracked.unsent as u64;
        let times = report.milliseconds;
        self.totals.tracking_ms = times.tracking + times.depth + times.graph;
        self.condition = Condition::Tracked(report.state, report.reason);
        let Some(world) = &mut self.world else {
            return;
        };
        world.poses = Arc::clone(&tracked.poses);
        if report.finished_keyframe.is_some() {
            world.finished.push(tracked.stamp);
        }
        if let (Some(pose), Some(keyframe)) = (report.world_from_camera, report.keyframe) {
            let World { trail, poses, .. } = world;
            trail.add(tracked.stamp, &pose, keyframe, poses, MAX_PATH_POSES);
        }
    }

    /// The frame in which the mapper has its maps now.
    fn frame_of_mapper(&self) -> Sim3 {
        let world = self.world.as_ref();
        let view = world.and_then(|world| world.reader.get()?.latest());
        view.map_or(self.map_from_world, |view| view.map_from_world)
    }

    /// The frame of what is published of a map that the mapper has in another.
    fn frame_of(&self, mapper_from_world: &Sim3) -> Sim3 {
        frame_of_map(mapper_from_world, self.scale)
    }

    /// Metres of a unit of the world, where somebody gave it, or wheels, or an inertial sensor,
    /// which changes the scale of the frame.
    fn metres_per_unit(&self) -> Option<f64> {
        let sensed = self.frame_of_mapper().scale;
        let is_sensed = sensed != self.map_from_world.scale;
        let known = self.scale.map(|scale| scale.metres_per_unit);
        known.or(is_sensed.then_some(sensed))
    }

    /// Publishes what somebody wants of the newest map.
    fn publish_new_map(&mut self) -> Result<(), MapError> {
        self.last_look = Some(Instant::now());
        let Some(view) = self.look()? else {
            return Ok(());
        };
        if !self.topics.wants(self.number) {
            return Ok(());
        }
        let shown = self.shown(&view)?;
        shown.map_or(Ok(()), |shown| self.topics.publish(self.number, &shown))
    }

    /// The newest map, which has a number.
    fn look(&mut self) -> Result<Option<Arc<LiveView>>, MapError> {
        let Some(world) = &mut self.world else {
            return Ok(None);
        };
        if let Ok(reader) = world.coming.try_recv() {
            // it comes once
            let _ = world.reader.set(reader?);
        }
        let Some(view) = world.reader.get().and_then(MapReader::latest) else {
            return Ok(None);
        };
        let is_same = |seen: &Arc<LiveView>| Arc::ptr_eq(seen, &view);
        if !world.seen.as_ref().is_some_and(is_same) {
            world.seen = Some(Arc::clone(&view));
            self.number += 1;
        }
        Ok(Some(view))
    }

    /// A map in metres with all that belongs to it.
    fn shown(&self, view: &LiveView) -> Result<Option<Shown>, MapError> {
        let Some(world) = &self.world else {
            return Ok(None);
        };
        let map_from_world = self.frame_of(&view.map_from_world);
        let trail = world.trail.now(&world.poses).into_iter();
        let path = trail.map(|(stamp, pose)| (stamp, map_from_camera(&map_from_world, &pose)));
        let path: Vec<(Time, Se3)> = path.collect();
        let seen = Seen {
            stamp: newest_image(&world.finished, view.stats.keyframes),
            metres_per_unit: map_from_world.scale / view.map_from_world.scale,
            band_over_base: self.args.height_band,
            origin_over_base: self.args.frames.mount().translation.z - map_from_world.translation.z,
            path: &path,
        };
        let shown = Shown::new(&view.global, &seen)?;
        Ok(Some(shown.with_large(&view.large, seen.metres_per_unit)))
    }

    /// Publishes the points of a keyframe in the map.
    fn publish_points(&mut self, number: u32, keyframe: &Keyframe, poses: &PoseSnapshot) {
        let world = self.world.as_ref().filter(|world| world.number == number);
        let (Some(world), Some(world_from_keyframe)) = (world, poses.in_main_map(keyframe.id))
        else {
            return;
        };
        let map_from_world = self.frame_of(&self.frame_of_mapper());
        let map_from_keyframe = map_from_world * *world_from_keyframe;
        let (topics, pinhole) = (&mut self.topics, &world.pinhole);
        topics.publish_points(keyframe, pinhole, &map_from_keyframe);
    }

    /// Publishes the newest map as a whole and writes the same to files.
    fn save(&mut self, answer: Answer, known: Option<Box<Known>>) {
        let saved = self.publish_and_save(known);
        let saved = saved.map_err(|error| format!("{error:#}"));
        match &saved {
            Ok(folder) => self
                .log
                .say(Severity::Info, &format!("map saved: {folder}")),
            Err(why) => self
                .log
                .say(Severity::Error, &format!("no map saved: {why}")),
        }
        // whoever has gone away needs no answer
        let _ = answer.send(response(saved));
    }

    fn publish_and_save(&mut self, known: Option<Box<Known>>) -> anyhow::Result<String> {
        let view = self.look()?;
        let shown = view.map(|view| self.shown(&view)).transpose()?.flatten();
        let Some((shown, known)) = shown.zip(known) else {
            anyhow::bail!("there is no map yet: no keyframe is finished");
        };
        self.topics.forget();
        self.topics.publish(self.number, &shown)?;
        let is_metric = self.metres_per_unit().is_some();
        let map_from_world = self.frame_of(&self.frame_of_mapper());
        let poses = known.trajectory.iter().map(|pose| {
            let map_from_camera = map_from_camera(&map_from_world, &pose.world_from_camera);
            (Time::from_nanoseconds(pose.timestamp_ns), map_from_camera)
        });
        let poses: Vec<(Time, Se3)> = poses.collect();
        let folder = save(&self.args.save_dir, &shown, &poses, is_metric)?;
        save_to_load(&folder, known.map, &map_from_world, is_metric)?;
        let folder = folder.canonicalize().unwrap_or(folder);
        Ok(folder.display().to_string())
    }

    fn say_condition(&mut self) {
        let silent = self.last_image.map(|at| at.elapsed());
        let silent = silent.filter(|silent| *silent >= SILENT_AFTER);
        let condition = match silent {
            Some(silent) => &Condition::Silent(silent.as_secs_f64()),
            None => &self.condition,
        };
        let header = Header {
            stamp: self.clock.now(),
            ..Header::default()
        };
        let is_metric = self.metres_per_unit().is_some();
        let message = diagnostics(header, &self.args.name, condition, is_metric, self.facts());
        let status = &message.status[0];
        let condition = match silent {
            Some(_) => "no image comes any more".to_owned(),
            None => status.message.clone(),
        };
        let severity = match status.level {
            OK => Severity::Info,
            ERROR => Severity::Error,
            _ => Severity::Warn,
        };
        self.say_news(severity, condition);
        self.topics.publish_diagnostics(message);
    }

    /// Says what has changed since this was called last.
    fn say_news(&mut self, severity: Severity, condition: String) {
        let (said, log) = (&mut self.said, &self.log);
        if said.condition != condition {
            log.say(severity, &condition);
            said.condition = condition;
        }
        let load = |count: &AtomicU64| count.load(Ordering::Relaxed);
        let why = &self.totals.unusable_because;
        for (count, said, what) in [
            (
                load(&self.counts.dropped),
                &mut said.dropped,
                "images dropped (busy)",
            ),
            (
                load(&self.counts.lost),
                &mut said.lost,
                "images lost on the way",
            ),
            (
                self.totals.unusable,
                &mut said.unusable,
                &*format!("images of no use: {why}"),
            ),
            (
                self.totals.unsent + self.topics.unsent,
                &mut said.unsent,
                "messages not sent",
            ),
        ] {
            if has_grown(count, said) {
                log.say(Severity::Warn, &format!("{count} {what}"));
            }
        }
    }

    fn say_scale(&self, scale: Option<Scale>) {
        if let Some(scale) = scale.filter(|scale| self.scale != Some(*scale)) {
            let deviation = scale
                .deviation
                .map(|d| format!(", standard error {:.1} %", d * 100.0));
            let (metres, deviation) = (scale.metres_per_unit, deviation.unwrap_or_default());
            let said = format!("a unit of the camera's world is {metres} m{deviation}");
            self.log.say(Severity::Info, &said);
        }
    }

    fn facts(&self) -> Vec<(&'static str, String)> {
        let (counts, totals) = (&self.counts, &self.totals);
        let count = |count: &AtomicU64| count.load(Ordering::Relaxed).to_string();
        let unsent = totals.unsent + self.topics.unsent;
        let tracking = format!("{:.1}", totals.tracking_ms);
        let keyframes = self.world.as_ref().map_or(0, |world| world.finished.len());
        let scale = match self.metres_per_unit() {
            Some(metres) => metres.to_string(),
            None => NOT_METRIC.to_owned(),
        };
        let window = match self.topics.window {
            Some(radius) => format!("{radius:.1} m around the camera"),
            None => "everything".to_owned(),
        };
        let deviation = self.scale.and_then(|scale| scale.deviation);
        let deviation = deviation.map_or_else(String::new, |d| format!("{:.1}", d * 100.0));
        vec![
            ("images received", count(&counts.received)),
            ("images processed", totals.processed.to_string()),
            ("images dropped (busy)", count(&counts.dropped)),
            ("images lost on the way", count(&counts.lost)),
            ("images of no use", totals.unusable.to_string()),
            ("last of no use because", totals.unusable_because.clone()),
            ("inertial readings", count(&counts.readings)),
            ("odometry readings", count(&counts.odometry)),
            ("whole maps sent", self.topics.wholes.to_string()),
            ("messages not sent", unsent.to_string()),
            ("tracking of the last image, ms", tracking),
            ("keyframes", keyframes.to_string()),
            ("metres per unit", scale),
            ("its standard error by wheels, %", deviation),
            ("map sent", window),
        ]
    }
}

/// The image with which the last of so many keyframes was finished.
fn newest_image(finished: &[Time], num_keyframes: usize) -> Time {
    let known = num_keyframes.min(finished.len());
    finished[..known].last().copied().unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_map_has_the_time_of_the_image_that_finished_its_newest_keyframe() {
        let time = |sec| Time { sec, nanosec: 0 };
        let finished = [time(1), time(4), time(9)];
        assert_eq!(newest_image(&finished, 2), time(4));
        // a keyframe of which the maps heard first
        assert_eq!(newest_image(&finished, 4), time(9));
        assert_eq!(newest_image(&finished, 0), Time::default());
        assert_eq!(newest_image(&[], 3), Time::default());
    }
}
