//! Runs jobs of the graph on a thread of its own.

use super::keyframe_graph::{GraphJob, GraphUpdate, KeyframeGraph};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::thread::JoinHandle;

/// The graph and the thread on which it works. At most one job is under way.
#[derive(Debug)]
pub(crate) enum GraphWorker {
    /// With a single thread a job is done when it is given.
    Inline {
        graph: Box<KeyframeGraph>,
        done: Option<GraphUpdate>,
    },
    Threaded {
        jobs: Option<Sender<GraphJob>>,
        updates: Receiver<GraphUpdate>,
        thread: Option<JoinHandle<()>>,
        under_way: bool,
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
        let (jobs, inbox) = channel::<GraphJob>();
        let (outbox, updates) = channel();
        let mut threaded = graph.clone();
        let work = move || {
            while let Ok(job) = inbox.recv() {
                if outbox.send(threaded.run(job)).is_err() {
                    return;
                }
            }
        };
        let name = "keyframe-graph".to_owned();
        match std::thread::Builder::new().name(name).spawn(work) {
            Ok(thread) => Self::Threaded {
                jobs: Some(jobs),
                updates,
                thread: Some(thread),
                under_way: false,
            },
            Err(_) => Self::new(graph, 1),
        }
    }

    /// Starts a job; the result of the one before must have been taken.
    pub(crate) fn submit(&mut self, job: GraphJob) {
        match self {
            Self::Inline { graph, done } => *done = Some(graph.run(job)),
            Self::Threaded {
                jobs, under_way, ..
            } => {
                *under_way = jobs.as_ref().is_some_and(|jobs| jobs.send(job).is_ok());
            }
        }
    }

    /// The result of the job under way, waiting for it; `None` without one.
    pub(crate) fn take(&mut self) -> Option<GraphUpdate> {
        match self {
            Self::Inline { done, .. } => done.take(),
            Self::Threaded {
                updates, under_way, ..
            } => std::mem::take(under_way)
                .then(|| updates.recv().ok())
                .flatten(),
        }
    }
}

impl Drop for GraphWorker {
    fn drop(&mut self) {
        if let Self::Threaded { jobs, thread, .. } = self {
            jobs.take();
            if let Some(thread) = thread.take() {
                // a panic there has been reported there; nothing is left to do here
                let _ = thread.join();
            }
        }
    }
}
