//! Runs the work of the graph on a thread of its own. A panic there goes on in the thread that
//! waits for it.

use super::{GraphJob, GraphUpdate, KeyframeGraph, Relocalised};
use crate::fault;
use crate::view::View;
use monogrid_image::Pyramid;
use std::panic::resume_unwind;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, Sender, channel};
use std::thread::JoinHandle;

/// What the thread is asked.
pub(crate) enum Request {
    Job(Box<GraphJob>),
    /// A frame, and the keyframe in use as it is.
    Relocalise(Arc<Pyramid>, Option<Arc<View>>),
}

/// The graph and the thread on which it works. At most one job is under way.
#[derive(Debug)]
pub(crate) enum GraphWorker {
    /// With a single thread a job is done when it is given.
    Inline {
        graph: Box<KeyframeGraph>,
        done: Option<Box<GraphUpdate>>,
    },
    Threaded {
        requests: Option<Sender<Request>>,
        updates: Receiver<GraphUpdate>,
        places: Receiver<Vec<Relocalised>>,
        thread: Option<JoinHandle<()>>,
    },
}

impl GraphWorker {
    /// On a thread of its own where there is more than one core and the thread can be made.
    pub(crate) fn new(graph: KeyframeGraph, num_threads: usize) -> Self {
        if num_threads < 2 {
            return Self::Inline {
                graph: Box::new(graph),
                done: None,
            };
        }
        let (requests, inbox) = channel::<Request>();
        let (outbox, updates) = channel();
        let (place_outbox, places) = channel();
        let mut threaded = graph.clone();
        let work = move || {
            let _own_pool = pool_of_this_thread();
            // ends when the system is gone: then either channel is closed
            while let Ok(request) = inbox.recv() {
                let answered = match request {
                    Request::Job(job) => {
                        fault::pass("graph");
                        outbox.send(threaded.run(*job)).is_ok()
                    }
                    Request::Relocalise(frame, in_use) => place_outbox
                        .send(threaded.relocalise(&frame, in_use))
                        .is_ok(),
                };
                if !answered {
                    return;
                }
            }
        };
        let name = "keyframe-graph".to_owned();
        match std::thread::Builder::new().name(name).spawn(work) {
            Ok(thread) => Self::Threaded {
                requests: Some(requests),
                updates,
                places,
                thread: Some(thread),
            },
            Err(_) => Self::new(graph, 1),
        }
    }

    /// Starts a job; the result of the one before must have been taken.
    pub(crate) fn submit(&mut self, job: GraphJob) {
        match self {
            Self::Inline { graph, done } => {
                fault::pass("graph");
                *done = Some(Box::new(graph.run(job)));
            }
            Self::Threaded { requests, .. } => ask(requests, Request::Job(Box::new(job))),
        }
    }

    /// The result of the job under way, of which there must be one, waiting for it; `None` once the
    /// thread has failed.
    ///
    /// # Panics
    /// With the panic of the thread, once.
    pub(crate) fn take(&mut self) -> Option<GraphUpdate> {
        match self {
            Self::Inline { done, .. } => done.take().map(|update| *update),
            Self::Threaded {
                updates, thread, ..
            } => match updates.recv() {
                Ok(update) => Some(update),
                Err(_) => {
                    pass_on(thread);
                    None
                }
            },
        }
    }

    /// Where a frame is among the keyframes of all jobs so far and the one in use, waiting for the
    /// answer; nowhere once the thread has failed.
    ///
    /// # Panics
    /// With the panic of the thread, once.
    pub(crate) fn relocalise(
        &mut self,
        frame: &Arc<Pyramid>,
        in_use: Option<Arc<View>>,
    ) -> Vec<Relocalised> {
        match self {
            Self::Inline { graph, .. } => graph.relocalise(frame, in_use),
            Self::Threaded {
                requests,
                places,
                thread,
                ..
            } => {
                ask(requests, Request::Relocalise(Arc::clone(frame), in_use));
                match places.recv() {
                    Ok(found) => found,
                    Err(_) => {
                        pass_on(thread);
                        Vec::new()
                    }
                }
            }
        }
    }
}

/// Goes on with the panic of a thread that has ended before it was asked to.
fn pass_on(thread: &mut Option<JoinHandle<()>>) {
    if let Some(Err(panic)) = thread.take().map(JoinHandle::join) {
        resume_unwind(panic);
    }
}

/// A thread that has failed is noticed by whoever waits for its answer.
fn ask(requests: &Option<Sender<Request>>, request: Request) {
    let _ = requests.as_ref().map(|requests| requests.send(request));
}

/// A pool for the parallel loops of this thread that consists of this thread alone.
///
/// In the pool of the others a thread that waits for a part of this thread's loop may take up the
/// next frame meanwhile, and tracking that frame may wait for this thread: both would wait for
/// ever.
fn pool_of_this_thread() -> Option<rayon::ThreadPool> {
    let builder = rayon::ThreadPoolBuilder::new().num_threads(1);
    builder.use_current_thread().build().ok()
}

impl Drop for GraphWorker {
    fn drop(&mut self) {
        if let Self::Threaded {
            requests, thread, ..
        } = self
        {
            requests.take();
            if let Some(thread) = thread.take() {
                // nobody waits for what it does any more, and a panic while another goes on would
                // end the process
                let _ = thread.join();
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rayon::prelude::*;

    #[test]
    fn loops_of_the_worker_stay_on_its_thread() {
        let thread = std::thread::spawn(|| {
            let pool = pool_of_this_thread();
            let here = std::thread::current().id();
            let elsewhere = (0..1000)
                .into_par_iter()
                .filter(|_| std::thread::current().id() != here)
                .count();
            (pool.is_some(), elsewhere)
        });
        assert_eq!(thread.join().ok(), Some((true, 0)));
    }
}
