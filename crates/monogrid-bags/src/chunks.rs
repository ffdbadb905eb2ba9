//! Recordings whose messages come in chunks.

use crate::error::BagError;
use crate::message::Raw;
use std::collections::VecDeque;
use std::ops::ControlFlow;
use std::path::PathBuf;

/// The records of a file.
pub trait Records {
    /// Reads some of the file and adds the messages that are in it; breaks at the end.
    fn read_on(&mut self, messages: &mut VecDeque<Raw>) -> Result<ControlFlow<()>, String>;
}

/// Messages one by one, until the end of the file or the first damage.
pub struct InChunks<R> {
    records: R,
    path: PathBuf,
    /// Of the chunk that was read last.
    ready: VecDeque<Raw>,
    ended: bool,
}

impl<R: Records> InChunks<R> {
    pub fn new(records: R, path: PathBuf) -> Self {
        Self {
            records,
            path,
            ready: VecDeque::new(),
            ended: false,
        }
    }
}

impl<R: Records> Iterator for InChunks<R> {
    type Item = Result<Raw, BagError>;

    fn next(&mut self) -> Option<Self::Item> {
        loop {
            if let Some(message) = self.ready.pop_front() {
                return Some(Ok(message));
            }
            if self.ended {
                return None;
            }
            match self.records.read_on(&mut self.ready) {
                Ok(ControlFlow::Continue(())) => {}
                Ok(ControlFlow::Break(())) => self.ended = true,
                Err(reason) => {
                    self.ended = true;
                    return Some(Err(BagError::damaged(&self.path, reason)));
                }
            }
        }
    }
}
