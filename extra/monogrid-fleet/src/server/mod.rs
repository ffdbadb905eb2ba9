//! The server: takes packets, joins the maps of all agents now and then, says where their worlds lie in the shared one.

mod joining;
mod store;
mod transforms;

pub use joining::{Joining, JoiningConfig, is_due};
pub use store::{Store, StoreError, StoredRun};
pub use transforms::{Joined, merged_from_agents, read_joined, similarity_of};

use crate::agent::{REFUSED, alone};
use crate::messages::{AgentState, Asked, Fleet, Missing, PREFIX, RunKey, Similarity};
use monogrid_geometry::Sim3;
use std::collections::BTreeMap;
use std::path::PathBuf;
use std::time::{Duration, Instant};
use zenoh::handlers::FifoChannelHandler;
use zenoh::query::{Query, Queryable};
use zenoh::{Session, Wait};

/// Time for which the server waits for a question before it looks at the rest of its work.
const LOOK_EVERY: Duration = Duration::from_millis(100);

/// What a server is told.
#[derive(Clone, Debug)]
pub struct ServerConfig {
    /// Endpoints at which it listens, `tcp/ADDRESS:PORT`.
    pub listen: Vec<String>,
    /// Folder of its files.
    pub out: PathBuf,
    /// When it joins.
    pub joining: JoiningConfig,
    /// It ends when so many runs have ended and all their packets have come; otherwise when it is interrupted.
    pub until_ended: Option<usize>,
}

/// Why a server cannot go on.
#[derive(Debug, thiserror::Error)]
pub enum ServerError {
    /// It cannot listen.
    #[error("cannot listen: {0}")]
    Network(zenoh::Error),
    /// Its files cannot be written or read.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// The process that joins maps cannot be started.
    #[error("the process that joins maps cannot be started: {0}")]
    Process(#[from] std::io::Error),
}

impl From<zenoh::Error> for ServerError {
    fn from(error: zenoh::Error) -> Self {
        Self::Network(error)
    }
}

/// What a server has to say.
#[derive(Clone, Debug, PartialEq)]
pub enum ServerNews {
    /// A run sends its first packet.
    Came(String),
    /// A run has ended, and all of it is here.
    Ended(String),
    /// A packet was refused.
    Refused(String),
    /// There are new transforms.
    Placed(Fleet),
    /// Maps were not joined.
    NotJoined(String),
}

/// A server at work.
pub struct Server {
    config: ServerConfig,
    session: Session,
    questions: Queryable<FifoChannelHandler<Query>>,
    store: Store,
    joining: Option<Joining>,
    last_joined: Instant,
    /// Keyframes that the last joining knew.
    joined_keyframes: u64,
    version: u64,
    placed: BTreeMap<RunKey, Sim3>,
}

impl Server {
    /// Listens; what an earlier server left in the folder is taken up again.
    ///
    /// # Errors
    /// When it cannot listen, or the folder holds what cannot be read.
    pub fn start(config: ServerConfig) -> Result<Self, ServerError> {
        let store = Store::open(&config.out)?;
        let mut network = alone()?;
        network.insert_json5("mode", "\"router\"")?;
        let endpoints = serde_json::json!(config.listen).to_string();
        network.insert_json5("listen/endpoints", &endpoints)?;
        let session = zenoh::open(network).wait()?;
        let questions = session.declare_queryable(format!("{PREFIX}/**")).wait()?;
        Ok(Self {
            config,
            session,
            questions,
            store,
            joining: None,
            last_joined: Instant::now(),
            joined_keyframes: 0,
            version: 0,
            placed: BTreeMap::new(),
        })
    }

    /// Works until all runs have ended that were to, or `is_interrupted`; joins everything once more then.
    ///
    /// # Errors
    /// When its files cannot be written.
    pub fn work(
        &mut self,
        is_interrupted: impl Fn() -> bool,
        say: &mut dyn FnMut(&ServerNews),
    ) -> Result<Fleet, ServerError> {
        loop {
            if let Ok(Some(question)) = self.questions.recv_timeout(LOOK_EVERY) {
                self.answer(&question, say)?;
            }
            self.take_joined(say)?;
            let all = self.config.until_ended;
            let is_over = all.is_some_and(|all| self.store.num_ended() >= all);
            if is_interrupted() || is_over {
                break;
            }
            let since = self.last_joined.elapsed();
            let new = self.store.num_keyframes() - self.joined_keyframes;
            let is_idle = self.joining.is_none();
            if is_idle && is_due(&self.config.joining, since, new, self.store.num_joinable()) {
                self.begin_joining()?;
            }
        }
        self.joining = None;
        if self.store.num_joinable() >= 2 {
            self.begin_joining()?;
        }
        // agents that wait for an answer get it meanwhile
        while self.joining.is_some() {
            if let Ok(Some(question)) = self.questions.recv_timeout(LOOK_EVERY) {
                self.answer(&question, say)?;
            }
            self.take_joined(say)?;
        }
        Ok(self.fleet())
    }

    /// What is known of all.
    #[must_use]
    pub fn fleet(&self) -> Fleet {
        let state = |(key, run): (&RunKey, &StoredRun)| AgentState {
            run: key.to_string(),
            packets: run.packets(),
            keyframes: run.keyframes(),
            has_ended: run.has_ended(),
            shared_from_agent: self.placed.get(key).map(Similarity::from),
        };
        Fleet {
            version: self.version,
            shared: self.store.first().map(RunKey::to_string),
            agents: self.store.in_order().map(state).collect(),
        }
    }

    fn answer(
        &mut self,
        question: &Query,
        say: &mut dyn FnMut(&ServerNews),
    ) -> Result<(), ServerError> {
        let key = question.key_expr().as_str().to_owned();
        let packet = question
            .payload()
            .map(|payload| payload.to_bytes().into_owned());
        let answer = match Asked::of(&key) {
            Some(Asked::Fleet) => Ok(json(&self.fleet())),
            Some(Asked::Missing(run)) => Ok(json(&self.missing(&run))),
            Some(Asked::Packet(run, number)) => match packet {
                Some(packet) => self.take(&run, number, &packet, say)?,
                None => {
                    let known = self.store.packet(&run, number)?;
                    known.ok_or_else(|| format!("packet {number} of {run} has not come"))
                }
            },
            None => Err(format!(
                "found the key {key}; expected one of those in the documentation"
            )),
        };
        // who asked may be gone
        let _ = match answer {
            Ok(bytes) => question.reply(key, bytes).wait(),
            Err(why) => question.reply_err(format!("{REFUSED}{why}")).wait(),
        };
        Ok(())
    }

    fn missing(&self, run: &RunKey) -> Missing {
        let from = self.store.run(run).map_or(0, StoredRun::packets);
        Missing { from }
    }

    /// Takes a packet, if it is the next one; what is missing then, or why the packet is refused.
    fn take(
        &mut self,
        run: &RunKey,
        number: u64,
        packet: &[u8],
        say: &mut dyn FnMut(&ServerNews),
    ) -> Result<Result<Vec<u8>, String>, ServerError> {
        if number == self.missing(run).from {
            let had_ended = self.store.run(run).is_some_and(StoredRun::has_ended);
            if let Err(error) = self.store.take(run, packet) {
                let StoreError::Packet(why) = error else {
                    return Err(error.into());
                };
                say(&ServerNews::Refused(format!(
                    "packet {number} of {run}: {why}"
                )));
                return Ok(Err(why.to_string()));
            }
            if number == 0 {
                say(&ServerNews::Came(run.to_string()));
            }
            if !had_ended && self.store.run(run).is_some_and(StoredRun::has_ended) {
                say(&ServerNews::Ended(run.to_string()));
            }
        }
        Ok(Ok(json(&self.missing(run))))
    }

    fn begin_joining(&mut self) -> Result<(), ServerError> {
        self.joined_keyframes = self.store.num_keyframes();
        self.joining = Some(Joining::begin(&mut self.store, &self.config.joining)?);
        Ok(())
    }

    /// Takes up what the process that joins maps has found, once it has ended.
    fn take_joined(&mut self, say: &mut dyn FnMut(&ServerNews)) -> Result<(), ServerError> {
        let Some(joining) = &mut self.joining else {
            return Ok(());
        };
        let Some(joined) = joining.ended()? else {
            return Ok(());
        };
        self.joining = None;
        self.last_joined = Instant::now();
        match joined {
            Ok(joined) => {
                let Some(first) = self.store.first() else {
                    return Ok(());
                };
                self.placed = joined.shared_from_agents(first);
                self.version += 1;
                let fleet = self.fleet();
                self.store.write_fleet(&json(&fleet))?;
                // who is not there asks later
                let _ = self
                    .session
                    .put(format!("{PREFIX}/fleet"), json(&fleet))
                    .wait();
                say(&ServerNews::Placed(fleet));
            }
            Err(why) => say(&ServerNews::NotJoined(why)),
        }
        Ok(())
    }
}

fn json(value: &impl serde::Serialize) -> Vec<u8> {
    // plain structs of numbers and texts always have a text
    serde_json::to_vec(value).unwrap_or_default()
}
