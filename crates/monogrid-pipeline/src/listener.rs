//! Who hears of changes of the map of keyframes.

use crate::clock;
use crate::panics::message_of;
use monogrid_slam::{Event, Slam};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::thread::{self, JoinHandle};
use std::time::Duration;

/// Events that may wait for a listener before tracking waits for it.
pub(crate) const EVENTS_AHEAD: usize = 4;

/// Why a listener gave up.
pub type ListenerError = Box<dyn std::error::Error + Send + Sync>;

/// A run that is over.
#[derive(Clone, Copy, Debug)]
pub struct Run<'a> {
    /// The system, which holds the finished keyframes.
    pub slam: &'a Slam,
    /// Frames of the source, those that could not be used among them.
    pub num_frames: usize,
}

/// Hears of changes in a thread of its own; a closure that takes an event is one.
///
/// An error ends the listening, not the run, and is returned by [`crate::Pipeline::finish`].
pub trait Listener: Send + 'static {
    /// Something has changed.
    ///
    /// # Errors
    /// Whatever keeps the listener from hearing more.
    fn hear(&mut self, event: &Event) -> Result<(), ListenerError>;

    /// The run is over, and every event was heard.
    ///
    /// # Errors
    /// Whatever keeps the listener from ending well.
    fn end(&mut self, run: Run<'_>) -> Result<(), ListenerError> {
        let _ = run;
        Ok(())
    }
}

impl<F: FnMut(&Event) + Send + 'static> Listener for F {
    fn hear(&mut self, event: &Event) -> Result<(), ListenerError> {
        self(event);
        Ok(())
    }
}

type Heard = (Box<dyn Listener>, Result<(), ListenerError>, Duration);

/// A listener and its thread.
#[derive(Debug)]
pub(crate) struct Listening {
    events: SyncSender<Event>,
    thread: JoinHandle<Heard>,
}

impl Listening {
    pub(crate) fn start(listener: Box<dyn Listener>) -> std::io::Result<Self> {
        let (events, heard) = sync_channel(EVENTS_AHEAD);
        let builder = thread::Builder::new().name("listener".into());
        let thread = builder.spawn(move || hear_all(listener, &heard))?;
        Ok(Self { events, thread })
    }

    /// Tells the listener; one that has failed says so when it is joined.
    pub(crate) fn tell(&self, event: &Event) {
        let _ = self.events.send(event.clone());
    }

    /// Whether it has panicked.
    pub(crate) fn has_failed(&self) -> bool {
        // it ends when there are no more events, which cannot be while this exists
        self.thread.is_finished()
    }

    /// Ends the listening; the CPU time that it took.
    pub(crate) fn join(self, run: Run<'_>) -> Result<Duration, ListenerError> {
        drop(self.events);
        let heard = self.thread.join();
        let heard = heard.map_err(|panic| format!("a listener panicked: {}", message_of(&*panic)));
        let (mut listener, heard, cpu) = heard?;
        heard?;
        let before = clock::thread_cpu();
        listener.end(run)?;
        Ok(cpu + clock::thread_cpu().saturating_sub(before))
    }
}

/// After an error the events are still received, so that nobody waits.
fn hear_all(mut listener: Box<dyn Listener>, events: &Receiver<Event>) -> Heard {
    let mut result = Ok(());
    for event in events {
        if result.is_ok() {
            result = listener.hear(&event);
        }
    }
    (listener, result, clock::thread_cpu())
}
