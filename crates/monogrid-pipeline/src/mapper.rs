//! The thread that maps: integrates keyframes as they are finished and lets the maps follow the
//! graph.

use crate::clock::{give_way, thread_cpu};
use monogrid_geometry::Sim3;
use monogrid_mapping::{KeyframeCamera, LiveMaps, MapReader, Waiting};
use monogrid_occupancy::MapError;
use monogrid_slam::{Event, InertialPath, fault};
use std::sync::Arc;
use std::sync::mpsc::{Receiver, SyncSender, TryRecvError, sync_channel};
use std::thread::{self, JoinHandle};
use std::time::Duration;

/// Events that may wait for the mapper, which gives way to everybody, before tracking waits for it:
/// on a busy computer a map may be late, poses must not be. What waits is kept by the system as
/// well.
const EVENTS_AHEAD: usize = 64;

/// What the mapper is told.
enum Message {
    /// Something has changed.
    Event(Event),
    /// Somebody wants to read the maps while they grow.
    Reader(SyncSender<Result<MapReader, MapError>>),
    /// An inertial sensor may say what is level, and how long a metre is.
    Path(InertialPath),
}

type Mapped = (Result<LiveMaps, MapError>, Duration);

/// The mapper and its thread.
#[derive(Debug)]
pub(crate) struct MapperThread {
    messages: SyncSender<Message>,
    thread: JoinHandle<Mapped>,
}

impl MapperThread {
    pub(crate) fn start(maps: LiveMaps, camera: KeyframeCamera) -> std::io::Result<Self> {
        let (messages, received) = sync_channel(EVENTS_AHEAD);
        let builder = thread::Builder::new().name("mapper".into());
        let thread = builder.spawn(move || grow_maps(&received, maps, &camera))?;
        Ok(Self { messages, thread })
    }

    /// Tells the mapper; one that has failed says so when it is joined.
    pub(crate) fn tell(&self, event: &Event) {
        let _ = self.messages.send(Message::Event(event.clone()));
    }

    /// Where a reader of the maps will arrive; nothing arrives when the mapper has failed.
    pub(crate) fn ask_for_reader(&self) -> Receiver<Result<MapReader, MapError>> {
        let (sender, reader) = sync_channel(1);
        // one that has failed drops the sender, which the receiver hears of
        let _ = self.messages.send(Message::Reader(sender));
        reader
    }

    /// Brings the maps that grow to the frame that an inertial sensor has, when it is sure and
    /// somebody reads them.
    pub(crate) fn be_level(&self, path: InertialPath) {
        let _ = self.messages.send(Message::Path(path));
    }

    /// Whether it has panicked.
    pub(crate) fn has_failed(&self) -> bool {
        // it ends when there are no more messages, which cannot be while this exists
        self.thread.is_finished()
    }

    /// Ends it; the maps as far as they have come, and the CPU time that they took.
    ///
    /// # Errors
    /// Its panic.
    pub(crate) fn join(self) -> thread::Result<Mapped> {
        drop(self.messages);
        self.thread.join()
    }
}

/// Integrates keyframes as they are finished, and lets the maps follow the graph while there is
/// nothing else to do.
fn grow_maps(messages: &Receiver<Message>, mut maps: LiveMaps, camera: &KeyframeCamera) -> Mapped {
    give_way();
    let base = *maps.map_from_world();
    let mut result = Ok(());
    let mut has_work = false;
    loop {
        let received = if has_work {
            messages.try_recv()
        } else {
            messages.recv().map_err(|_| TryRecvError::Disconnected)
        };
        match received {
            // what is left to be done is done for the final maps, on all threads
            Err(TryRecvError::Disconnected) => break,
            // after an error messages are still received, so that nobody waits for this thread
            _ if result.is_err() => has_work = false,
            Ok(Message::Event(event)) => {
                result = take_event(&mut maps, &event, camera);
                has_work = true;
            }
            Ok(Message::Reader(wanted)) => {
                // one who has gone away does not need it
                let _ = wanted.send(maps.reader());
                has_work = true;
            }
            Ok(Message::Path(path)) => {
                result = be_level(&mut maps, &path, &base);
                has_work = true;
            }
            Err(TryRecvError::Empty) => match maps.step() {
                Ok(has_worked) => has_work = has_worked,
                Err(error) => result = Err(error),
            },
        }
    }
    maps.rest();
    (result.map(|()| maps), thread_cpu())
}

/// Brings the maps to the frame that an inertial sensor makes of `base`.
fn be_level(maps: &mut LiveMaps, path: &InertialPath, base: &Sim3) -> Result<(), MapError> {
    if maps.is_read()
        && let Ok(sensed) = path.sensed(base)
        && sensed.is_another(maps.map_from_world())
    {
        return maps.bring_to(sensed.map_from_world);
    }
    // nothing new, or nothing certain yet
    Ok(())
}

fn take_event(maps: &mut LiveMaps, event: &Event, camera: &KeyframeCamera) -> Result<(), MapError> {
    fault::pass("mapper");
    match event {
        Event::Finished(keyframe, poses) => {
            let waiting = Waiting::Keyframe(keyframe.clone(), *camera);
            match poses.in_main_map(keyframe.id) {
                Some(pose) => maps.add(waiting, *pose)?,
                None => maps.add_apart(waiting),
            }
            maps.follow(Arc::clone(poses))
        }
        Event::Revised(keyframe) => {
            maps.revise(Waiting::Keyframe(keyframe.clone(), *camera));
            Ok(())
        }
        Event::Moved(poses) => maps.follow(Arc::clone(poses)),
        // nothing that maps show
        _ => Ok(()),
    }
}
