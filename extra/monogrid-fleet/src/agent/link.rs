//! The way to the server, while there is one.

use crate::messages::{Fleet, Missing, PREFIX};
use crate::network;
use serde::de::DeserializeOwned;
use std::path::Path;
use std::time::Duration;
use zenoh::handlers::{RingChannel, RingChannelHandler};
use zenoh::pubsub::Subscriber;
use zenoh::sample::Sample;
use zenoh::{Session, Wait};

/// Time in which an answer comes, or the link counts as lost.
const ANSWER_WITHIN: Duration = Duration::from_secs(5);

/// Why there is no answer.
#[derive(Debug, thiserror::Error)]
pub enum LinkError {
    /// There is no server, or no way to it. It is worth trying again.
    #[error("the server cannot be reached: {0}")]
    Lost(String),
    /// The server does not take what it was sent. Trying again does not help.
    #[error("the server refuses a packet: {0}")]
    Refused(String),
}

impl From<zenoh::Error> for LinkError {
    fn from(error: zenoh::Error) -> Self {
        Self::Lost(error.to_string())
    }
}

/// A session with the server.
pub struct Link {
    session: Session,
    fleet: Subscriber<RingChannelHandler<Sample>>,
}

impl Link {
    /// Connects to the server at these endpoints (`tcp/HOST:PORT`), or those of a file of Zenoh's
    /// settings.
    ///
    /// # Errors
    /// [`LinkError::Lost`].
    pub fn open(connect: &[String], zenoh_config: Option<&Path>) -> Result<Self, LinkError> {
        let config = network::of_agent(connect, zenoh_config);
        let config = config.map_err(|error| LinkError::Lost(error.to_string()))?;
        let session = zenoh::open(config).wait()?;
        let fleet = session.declare_subscriber(format!("{PREFIX}/fleet"));
        // only the newest counts
        let fleet = fleet.with(RingChannel::new(1)).wait()?;
        Ok(Self { session, fleet })
    }

    /// Delivers a packet, or only asks; what the server misses then.
    pub fn deliver(&self, key: &str, packet: Option<Vec<u8>>) -> Result<Missing, LinkError> {
        parsed(&self.ask(key, packet)?)
    }

    /// What the server knows of all.
    pub fn fleet(&self) -> Result<Fleet, LinkError> {
        parsed(&self.ask(&format!("{PREFIX}/fleet"), None)?)
    }

    /// What the server has published since the last call.
    #[must_use]
    pub fn news(&self) -> Option<Fleet> {
        let sample = self.fleet.try_recv().ok()??;
        serde_json::from_slice(&sample.payload().to_bytes()).ok()
    }

    /// Publishes for whoever listens.
    ///
    /// # Errors
    /// [`LinkError::Lost`].
    pub fn publish(&self, key: &str, text: String) -> Result<(), LinkError> {
        Ok(self.session.put(key, text).wait()?)
    }

    /// The bytes that the server answers.
    pub fn ask(&self, key: &str, payload: Option<Vec<u8>>) -> Result<Vec<u8>, LinkError> {
        let mut get = self.session.get(key).timeout(ANSWER_WITHIN);
        if let Some(bytes) = payload {
            get = get.payload(bytes);
        }
        let replies = get.wait()?;
        let reply = replies.recv_timeout(ANSWER_WITHIN)?;
        let reply = reply.ok_or_else(|| LinkError::Lost("no answer".to_owned()))?;
        let error = match reply.result() {
            Ok(sample) => return Ok(sample.payload().to_bytes().into_owned()),
            Err(error) => error.payload().to_bytes(),
        };
        let text: String = String::from_utf8_lossy(&error)
            .chars()
            .take(MAX_TEXT)
            .collect();
        // what the way itself says has no words of ours
        Err(match text.strip_prefix(REFUSED) {
            Some(why) => LinkError::Refused(why.to_owned()),
            None => LinkError::Lost(text),
        })
    }
}

/// Begins the answer of a server that refuses a packet.
pub const REFUSED: &str = "refused: ";

fn parsed<T: DeserializeOwned>(answer: &[u8]) -> Result<T, LinkError> {
    serde_json::from_slice(answer)
        .map_err(|error| LinkError::Refused(format!("its answer is not understood: {error}")))
}

/// Longest text of a server that is kept.
const MAX_TEXT: usize = 1000;
