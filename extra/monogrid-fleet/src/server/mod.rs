//! The server: takes packets, joins the maps of all agents now and then, says where their worlds lie in the shared one.

mod joining;
mod store;
mod transforms;

pub use joining::{APART, JoiningConfig, is_due};
pub use store::StoreError;
pub use transforms::similarity_of;

use crate::agent::{REFUSED, alone};
use crate::messages::{AgentState, Asked, Fleet, Missing, PREFIX, RunKey, Similarity};
use joining::Joining;
use std::path::PathBuf;
use std::time::{Duration, Instant};
use store::{Store, StoredRun};
use transforms::{Place, shared_from_agents};
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
    placed: Place,
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
            placed: Place::new(),
        })
    }

    /// Works until all runs have ended that were to, or `is_interrupted`; joins everything once more then. `say` hears what is new, in words.
    ///
    /// # Errors
    /// When its files cannot be written.
    pub fn work(
        &mut self,
        is_interrupted: impl Fn() -> bool,
        say: &mut dyn FnMut(String),
    ) -> Result<Fleet, ServerError> {
        loop {
            self.look(say)?;
            let all = self.config.until_ended;
            let is_over = all.is_some_and(|all| self.store.count(|run| run.known.has_ended) >= all);
            if is_interrupted() || is_over {
                break;
            }
            let since = self.last_joined.elapsed();
            let new = self.store.num_keyframes() - self.joined_keyframes;
            let joinable = self.store.count(StoredRun::is_joinable);
            if self.joining.is_none() && is_due(&self.config.joining, since, new, joinable) {
                self.begin_joining()?;
            }
        }
        self.joining = None;
        if self.store.count(StoredRun::is_joinable) >= 2 {
            self.begin_joining()?;
        }
        // agents that wait for an answer get it meanwhile
        while self.joining.is_some() {
            self.look(say)?;
        }
        Ok(self.fleet())
    }

    /// Answers a question, or waits for one, and takes up what was joined.
    fn look(&mut self, say: &mut dyn FnMut(String)) -> Result<(), ServerError> {
        if let Ok(Some(question)) = self.questions.recv_timeout(LOOK_EVERY) {
            self.answer(&question, say)?;
        }
        self.take_joined(say)
    }

    /// What is known of all.
    #[must_use]
    pub fn fleet(&self) -> Fleet {
        let state = |key: &RunKey| {
            let run = self.store.runs.get(key)?;
            Some(AgentState {
                run: key.to_string(),
                packets: run.log.len(),
                keyframes: run.known.frames.len() as u64,
                has_ended: run.known.has_ended,
                shared_from_agent: self.placed.get(key).map(Similarity::from),
            })
        };
        Fleet {
            version: self.version,
            shared: self.store.order.first().map(RunKey::to_string),
            agents: self.store.order.iter().filter_map(state).collect(),
        }
    }

    fn answer(&mut self, question: &Query, say: &mut dyn FnMut(String)) -> Result<(), ServerError> {
        let key = question.key_expr().as_str().to_owned();
        let packet = question.payload().map(|payload| payload.to_bytes());
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
        let from = self.store.runs.get(run).map_or(0, |run| run.log.len());
        Missing { from }
    }

    /// Takes a packet, if it is the next one; what is missing then, or why the packet is refused.
    fn take(
        &mut self,
        run: &RunKey,
        number: u64,
        packet: &[u8],
        say: &mut dyn FnMut(String),
    ) -> Result<Result<Vec<u8>, String>, ServerError> {
        if number == self.missing(run).from {
            let has_ended =
                |store: &Store| store.runs.get(run).is_some_and(|run| run.known.has_ended);
            let had_ended = has_ended(&self.store);
            if let Err(error) = self.store.take(run, packet) {
                let StoreError::Packet(why) = error else {
                    return Err(error.into());
                };
                say(format!("refused: packet {number} of {run}: {why}"));
                return Ok(Err(why.to_string()));
            }
            if number == 0 {
                say(format!("{run} has come"));
            }
            if !had_ended && has_ended(&self.store) {
                say(format!("{run} has ended"));
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
    fn take_joined(&mut self, say: &mut dyn FnMut(String)) -> Result<(), ServerError> {
        let ended = self.joining.as_mut().map(Joining::ended).transpose()?;
        let Some(joined) = ended.flatten() else {
            return Ok(());
        };
        self.joining = None;
        self.last_joined = Instant::now();
        match joined {
            Ok(joined) => {
                let Some(first) = self.store.order.first() else {
                    return Ok(());
                };
                self.placed = shared_from_agents(&joined, first);
                self.version += 1;
                let fleet = self.fleet();
                self.store.write_fleet(&json(&fleet))?;
                // who is not there asks later
                let key = format!("{PREFIX}/fleet");
                let _ = self.session.put(key, json(&fleet)).wait();
                say(fleet.sentence());
            }
            Err(why) => say(format!("nothing was joined: {why}")),
        }
        Ok(())
    }
}

fn json(value: &impl serde::Serialize) -> Vec<u8> {
    // plain structs of numbers and texts always have a text
    serde_json::to_vec(value).unwrap_or_default()
}
