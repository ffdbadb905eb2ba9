//! Reading in a thread of its own: whoever waits for what is read can stop waiting, whatever the
//! source does.

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// How long a source on the network may send nothing that is whole, unless something else is asked
/// for.
const NETWORK_LIMIT: Duration = Duration::from_secs(10);

/// Time between looks at whether the wait was interrupted.
const LOOK_EVERY: Duration = Duration::from_millis(20);

/// How long to wait for a source.
#[derive(Clone, Copy, Debug, Default)]
pub struct Patience {
    /// Longest wait for one frame; `None`: as long as it takes.
    pub limit: Option<Duration>,
    /// Ends the wait, and the frames, when it becomes true.
    pub interrupted: Option<&'static AtomicBool>,
}

impl Patience {
    /// Ten seconds for an address; files, pipes and cameras may take as long as they like.
    #[must_use]
    pub fn usual(source: &Path) -> Self {
        let is_address = source.to_string_lossy().contains("://");
        Self {
            limit: is_address.then_some(NETWORK_LIMIT),
            interrupted: None,
        }
    }

    fn is_interrupted(&self) -> bool {
        self.interrupted
            .is_some_and(|interrupted| interrupted.load(Ordering::Relaxed))
    }
}

/// How a wait ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Waited<T> {
    /// With the next item.
    Item(T),
    /// There are no more.
    Ended,
    /// It took longer than the limit.
    TooLong(Duration),
    /// Somebody interrupted it.
    Interrupted,
}

/// Items that a thread of its own makes. The thread ends with its work, or when it has an item that
/// nobody takes any more; one that hangs in the system is left alone and never waited for.
#[derive(Debug)]
pub struct Aside<T> {
    items: Receiver<T>,
    thread: Option<JoinHandle<()>>,
    patience: Patience,
    cpu_ns: Arc<AtomicU64>,
}

/// Where the thread hands its items over.
#[derive(Debug)]
pub struct Sink<T> {
    items: SyncSender<T>,
    cpu_ns: Arc<AtomicU64>,
}

impl<T> Sink<T> {
    /// Hands an item over; false where nobody wants more.
    pub fn put(&self, item: T) -> bool {
        self.cpu_ns.store(thread_cpu_ns(), Ordering::Relaxed);
        self.items.send(item).is_ok()
    }
}

impl<T: Send + 'static> Aside<T> {
    /// Starts a thread of this name that does this work.
    ///
    /// # Errors
    /// When the system has no more threads.
    pub fn start(
        name: &str,
        patience: Patience,
        work: impl FnOnce(&Sink<T>) + Send + 'static,
    ) -> std::io::Result<Self> {
        // none waits between: the thread is ahead by the one that it holds, which may be 100 MB
        let (sender, items) = sync_channel(0);
        let cpu_ns = Arc::<AtomicU64>::default();
        let sink = Sink {
            items: sender,
            cpu_ns: Arc::clone(&cpu_ns),
        };
        let thread = std::thread::Builder::new().name(name.to_owned());
        Ok(Self {
            thread: Some(thread.spawn(move || work(&sink))?),
            items,
            patience,
            cpu_ns,
        })
    }

    /// Waits for the next item. A panic of the thread goes on here.
    pub fn wait(&mut self) -> Waited<T> {
        self.wait_within(self.patience)
    }

    /// As [`Self::wait`], with another patience this time.
    pub fn wait_within(&mut self, patience: Patience) -> Waited<T> {
        let begin = Instant::now();
        loop {
            if patience.is_interrupted() {
                return Waited::Interrupted;
            }
            match self.items.recv_timeout(LOOK_EVERY) {
                Ok(item) => return Waited::Item(item),
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => {
                    // it has left its work: this takes no time
                    if let Some(Err(panic)) = self.thread.take().map(JoinHandle::join) {
                        std::panic::resume_unwind(panic);
                    }
                    return Waited::Ended;
                }
            }
            if let Some(limit) = patience.limit
                && begin.elapsed() >= limit
            {
                return Waited::TooLong(limit);
            }
        }
    }

    /// CPU time of the thread until its last item.
    #[must_use]
    pub fn cpu(&self) -> Duration {
        Duration::from_nanos(self.cpu_ns.load(Ordering::Relaxed))
    }
}

#[cfg(unix)]
fn thread_cpu_ns() -> u64 {
    use rustix::time::{ClockId, clock_gettime};
    let time = clock_gettime(ClockId::ThreadCPUTime);
    time.tv_sec.max(0) as u64 * 1_000_000_000 + time.tv_nsec.max(0) as u64
}

#[cfg(not(unix))]
fn thread_cpu_ns() -> u64 {
    0
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Hands over 1 and 2, then hangs for a minute.
    fn hanging(patience: Patience) -> Aside<u8> {
        let work = |sink: &Sink<u8>| {
            assert!(sink.put(1) && sink.put(2));
            std::thread::sleep(Duration::from_secs(60));
        };
        Aside::start("hanging", patience, work).unwrap()
    }

    #[test]
    fn what_hangs_is_left_alone() {
        let limit = Duration::from_millis(200);
        let begin = Instant::now();
        let mut items = hanging(Patience {
            limit: Some(limit),
            interrupted: None,
        });
        assert_eq!(items.wait(), Waited::Item(1));
        assert_eq!(items.wait(), Waited::Item(2));
        assert_eq!(items.wait(), Waited::TooLong(limit));
        drop(items);
        assert!(begin.elapsed() < Duration::from_secs(10));
    }

    #[test]
    fn no_more_is_made_than_one_item_ahead() {
        static MADE: AtomicU64 = AtomicU64::new(0);
        let work = |sink: &Sink<u64>| {
            for number in 1..100 {
                MADE.store(number, Ordering::Relaxed);
                if !sink.put(number) {
                    return;
                }
            }
        };
        let mut items = Aside::start("ahead", Patience::default(), work).unwrap();
        for number in 1..20 {
            assert_eq!(items.wait(), Waited::Item(number));
            std::thread::sleep(Duration::from_millis(20));
            assert!(MADE.load(Ordering::Relaxed) <= number + 1);
        }
    }

    #[test]
    fn an_interrupt_ends_the_wait_at_once() {
        static INTERRUPTED: AtomicBool = AtomicBool::new(false);
        let mut items = hanging(Patience {
            limit: None,
            interrupted: Some(&INTERRUPTED),
        });
        assert_eq!(items.wait(), Waited::Item(1));
        assert_eq!(items.wait(), Waited::Item(2));
        std::thread::spawn(|| {
            std::thread::sleep(Duration::from_millis(100));
            INTERRUPTED.store(true, Ordering::Relaxed);
        });
        let begin = Instant::now();
        assert_eq!(items.wait(), Waited::Interrupted);
        assert!(begin.elapsed() < Duration::from_secs(10));
    }

    #[test]
    fn a_panic_is_no_end() {
        let work = |sink: &Sink<u8>| {
            assert!(!sink.put(1), "on purpose");
        };
        let mut items = Aside::start("panics", Patience::default(), work).unwrap();
        assert_eq!(items.wait(), Waited::Item(1));
        let wait = std::panic::AssertUnwindSafe(|| items.wait());
        assert!(std::panic::catch_unwind(wait).is_err());
    }

    #[test]
    fn only_addresses_have_a_limit_of_their_own() {
        let limit = |source: &str| Patience::usual(Path::new(source)).limit;
        assert_eq!(limit("rtsp://camera/x"), Some(Duration::from_secs(10)));
        for source in ["-", "/dev/video0", "a.mp4", "C:\\a.mp4"] {
            assert_eq!(limit(source), None, "{source}");
        }
    }
}
