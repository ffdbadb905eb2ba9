//! The server: takes packets, joins the maps of all agents now and then, says where their worlds
//! lie in the shared one.

mod companion;
mod joining;
mod limits;
mod metrics;
mod store;
mod transforms;

pub use joining::{APART, JoiningConfig, is_due};
pub use limits::{Limits, OverLimit, Usage};
pub use store::StoreError;
pub use transforms::similarity_of;

use crate::agent::REFUSED;
use crate::messages::{AgentState, Asked, Fleet, Missing, PREFIX, RunKey, Similarity, WARNING};
use crate::network::{self, NetworkError};
use joining::{Joining, Next, Search};
use metrics::{Counted, Metrics};
use monogrid_report::ReportError;
use std::collections::BTreeMap;
use std::net::SocketAddr;
use std::path::PathBuf;
use std::time::{Duration, Instant};
use store::{Store, StoredRun};
use transforms::{Place, shared_from_agents, shared_run};
use zenoh::handlers::{FifoChannel, FifoChannelHandler};
use zenoh::query::{Query, Queryable};
use zenoh::{Session, Wait};

/// Time for which the server waits for a question before it looks at the rest of its work.
const LOOK_EVERY: Duration = Duration::from_millis(100);

/// Questions that wait for their answer at most: each can hold a packet. Connections wait where
/// there are more.
const WAITING_QUESTIONS: usize = 8;
/// Refusals and failures that are said in a minute; the rest is counted. An attack does not fill a
/// disk with what the server says of it.
const SAID_PER_MINUTE: u32 = 60;

/// What a server is told.
#[derive(Clone, Debug)]
pub struct ServerConfig {
    /// Endpoints at which it listens, `tcp/ADDRESS:PORT`; without any those of the file of
    /// settings, or [`network::LOOPBACK`].
    pub listen: Vec<String>,
    /// Settings of Zenoh, a JSON5 file.
    pub zenoh_config: Option<PathBuf>,
    /// Where Prometheus reads how it is.
    pub metrics: Option<SocketAddr>,
    /// What it keeps at most.
    pub limits: Limits,
    /// Folder of its files.
    pub out: PathBuf,
    /// When it joins.
    pub joining: JoiningConfig,
    /// It ends when so many runs have ended and all their packets have come; otherwise when it is
    /// interrupted.
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
    /// Metrics cannot be served at their address.
    #[error("metrics: {0}")]
    Metrics(#[from] ReportError),
    /// Its network cannot be set up.
    #[error(transparent)]
    Settings(#[from] NetworkError),
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
    /// Which run keeps others from being joined, where one does; with the size of the trial that
    /// goes on.
    search: Option<(Search, usize)>,
    last_joined: Instant,
    /// Keyframes that the last joining knew.
    joined_keyframes: u64,
    version: u64,
    placed: Place,
    /// The run in whose world the others are placed, once some are joined.
    shared: Option<RunKey>,
    voice: Voice,
    metrics: Option<Metrics>,
    /// When the last packet of each run came.
    heard: BTreeMap<RunKey, Instant>,
    /// Packets that were not taken.
    refused: u64,
}

impl Server {
    /// Listens; what an earlier server left in the folder is taken up again. `say` hears what of it
    /// cannot be.
    ///
    /// # Errors
    /// When it cannot listen, or the folder cannot be read.
    pub fn start(config: ServerConfig, say: &mut dyn FnMut(String)) -> Result<Self, ServerError> {
        let network = network::of_server(&config.listen, config.zenoh_config.as_deref())?;
        let metrics = config.metrics.map(Metrics::listen).transpose()?;
        let store = Store::open(&config.out, config.limits, say)?;
        let session = zenoh::open(network).wait()?;
        let questions = session.declare_queryable(format!("{PREFIX}/**"));
        let questions = questions.with(FifoChannel::new(WAITING_QUESTIONS)).wait()?;
        Ok(Self {
            config,
            session,
            questions,
            store,
            joining: None,
            search: None,
            last_joined: Instant::now(),
            joined_keyframes: 0,
            version: 0,
            placed: Place::new(),
            shared: None,
            voice: Voice::default(),
            metrics,
            heard: BTreeMap::new(),
            refused: 0,
        })
    }

    /// Works until all runs have ended that were to, or an interrupt; joins everything once more
    /// then, until the next one. `interrupts` says how many there were, `say` hears what is new, in
    /// words. What goes wrong with one agent, or for a while, is said and does not end it.
    pub fn work(&mut self, interrupts: impl Fn() -> usize, say: &mut dyn FnMut(String)) -> Fleet {
        loop {
            self.look(say);
            let all = self.config.until_ended;
            let is_over = all.is_some_and(|all| self.store.count(|run| run.known.has_ended) >= all);
            if interrupts() > 0 || is_over {
                break;
            }
            let since = self.last_joined.elapsed();
            let new = self
                .store
                .num_keyframes()
                .saturating_sub(self.joined_keyframes);
            let joinable = self.store.count(StoredRun::is_joinable);
            if self.joining.is_none() && is_due(&self.config.joining, since, new, joinable) {
                self.begin_joining(say);
            }
        }
        (self.joining, self.search) = (None, None);
        if self.store.count(StoredRun::is_joinable) >= 2 {
            self.begin_joining(say);
        }
        // agents that wait for an answer get it meanwhile
        let before = interrupts();
        while self.joining.is_some() && interrupts() == before {
            self.look(say);
        }
        (self.joining, self.search) = (None, None);
        self.end_trials();
        self.voice.end(say);
        self.fleet()
    }

    /// Answers a question, or waits for one, and takes up what was joined.
    fn look(&mut self, say: &mut dyn FnMut(String)) {
        if let Ok(Some(question)) = self.questions.recv_timeout(LOOK_EVERY) {
            self.answer(&question, say);
        }
        self.take_joined(say);
        self.count();
    }

    /// Counts what Prometheus reads, when it is time.
    fn count(&mut self) {
        if !self.metrics.as_ref().is_some_and(Metrics::is_due) {
            return;
        }
        let goes_on = |key: &RunKey| {
            let run = self.store.runs.get(key);
            run.is_some_and(|run| !run.known.has_ended)
        };
        let heard = self.heard.iter().filter(|(key, _)| goes_on(key));
        let counted = Counted {
            fleet: &self.fleet(),
            bytes: self.store.usage().bytes,
            refused: self.refused,
            silent: heard
                .map(|(key, at)| (key.to_string(), at.elapsed()))
                .collect(),
        };
        if let Some(metrics) = &self.metrics {
            metrics.set(&counted, self.store.why_nothing_is_kept());
        }
    }

    /// What is known of all.
    #[must_use]
    pub fn fleet(&self) -> Fleet {
        let state = |key: &RunKey| {
            let run = self.store.runs.get(key)?;
            let apart = run.apart.as_ref().filter(|_| run.is_apart());
            Some(AgentState {
                run: key.to_string(),
                packets: run.log.len(),
                keyframes: run.known.frames.len() as u64,
                has_ended: run.known.has_ended,
                shared_from_agent: self.placed.get(key).map(Similarity::from),
                set_apart: apart.map(|apart| apart.why.clone()),
            })
        };
        Fleet {
            version: self.version,
            shared: self.shared_run().map(RunKey::to_string),
            agents: self.store.order.iter().filter_map(state).collect(),
        }
    }

    /// The run in whose world the others are: before any are joined, the first that can be.
    fn shared_run(&self) -> Option<&RunKey> {
        let mut order = self.store.order.iter();
        let is_usable = |key: &&RunKey| !self.store.runs.get(*key).is_some_and(StoredRun::is_apart);
        self.shared.as_ref().or_else(|| order.find(is_usable))
    }

    fn answer(&mut self, question: &Query, say: &mut dyn FnMut(String)) {
        let key = question.key_expr().as_str().to_owned();
        let packet = question.payload().map(|payload| payload.to_bytes());
        let refused = |why: String| format!("{REFUSED}{why}");
        let answer = match Asked::of(&key) {
            Some(Asked::Fleet) => Ok(json(&self.fleet())),
            Some(Asked::Missing(run)) => Ok(json(&self.missing(&run))),
            Some(Asked::Packet(run, number)) => match packet {
                Some(packet) => self.take(&run, number, &packet, say),
                None => match self.store.packet(&run, number) {
                    Ok(Some(packet)) => Ok(packet),
                    Ok(None) => Err(refused(format!("packet {number} of {run} has not come"))),
                    Err(error) => Err(error.to_string()),
                },
            },
            None => Err(refused(format!(
                "found the key {key}; expected one of those in the documentation"
            ))),
        };
        // who asked may be gone
        let _ = match answer {
            Ok(bytes) => question.reply(key, bytes).wait(),
            Err(why) => question.reply_err(why).wait(),
        };
    }

    fn missing(&self, run: &RunKey) -> Missing {
        let from = self.store.runs.get(run).map_or(0, |run| run.log.len());
        Missing { from }
    }

    /// Takes a packet, if it is the next one; what is missing then, or why the packet is not taken.
    fn take(
        &mut self,
        run: &RunKey,
        number: u64,
        packet: &[u8],
        say: &mut dyn FnMut(String),
    ) -> Result<Vec<u8>, String> {
        if number == self.missing(run).from {
            let has_ended =
                |store: &Store| store.runs.get(run).is_some_and(|run| run.known.has_ended);
            let had_ended = has_ended(&self.store);
            if let Err(error) = self.store.take(run, packet) {
                let (verb, why) = match error.can_pass() {
                    true => (
                        "not kept",
                        format!("the server cannot keep it now: {error}"),
                    ),
                    false => ("refused", format!("{REFUSED}{error}")),
                };
                let text = format!("{verb}: packet {number} of {run}: {error}");
                self.voice.complain(text, say);
                self.refused += 1;
                return Err(why);
            }
            self.heard.insert(run.clone(), Instant::now());
            if number == 0 {
                say(format!("{run} has come"));
            }
            if !had_ended && has_ended(&self.store) {
                say(format!("{run} has ended"));
            }
        }
        Ok(json(&self.missing(run)))
    }

    /// Begins to join all that can be. What keeps it from beginning may pass: it is tried again
    /// when it is due.
    fn begin_joining(&mut self, say: &mut dyn FnMut(String)) {
        self.joined_keyframes = self.store.num_keyframes();
        self.last_joined = Instant::now();
        let mut joinable = self.store.joinable();
        for text in std::mem::take(&mut joinable.left_out) {
            self.voice.complain(text, say);
        }
        if joinable.runs.len() < 2 {
            return;
        }
        match Joining::begin(&self.store, &self.config.joining, joinable) {
            Ok(joining) => self.joining = Some(joining),
            Err(error) => self.voice.complain(
                format!("the process that joins maps cannot be started: {error}"),
                say,
            ),
        }
    }

    /// Takes up what the process that joins maps has found, once it has ended.
    fn take_joined(&mut self, say: &mut dyn FnMut(String)) {
        let Some(result) = self.joining.as_mut().and_then(Joining::ended) else {
            return;
        };
        let Some(joining) = self.joining.take() else {
            return;
        };
        self.last_joined = Instant::now();
        if let Some((mut search, count)) = self.search.take() {
            search.tried(count, result);
            return self.go_on_searching(search, say);
        }
        match result.and_then(|()| joining.joined()) {
            Ok(joined) => self.place(&joined, say),
            Err(why) => {
                say(format!(
                    "{WARNING}nothing was joined: {why}; each run is looked at"
                ));
                let files = self.store.files(&joining.runs);
                drop(joining);
                self.go_on_searching(Search::new(files.0, files.1), say);
            }
        }
    }

    /// Does what is next in the search for a run that keeps others from being joined.
    fn go_on_searching(&mut self, search: Search, say: &mut dyn FnMut(String)) {
        match search.next() {
            Next::Try(count) => {
                let files = &search.files[..count];
                match Joining::begin_trial(&self.store, &self.config.joining, files) {
                    Ok(trial) => (self.joining, self.search) = (Some(trial), Some((search, count))),
                    Err(why) => self
                        .voice
                        .complain(format!("runs cannot be looked at: {why}"), say),
                }
                return;
            }
            Next::SetApart(run, why) => {
                say(format!(
                    "{WARNING}{run} is set apart, the others are joined: {why}"
                ));
                if let Some(stored) = self.store.runs.get_mut(&run) {
                    let until_packets = 2 * stored.log.len();
                    stored.set_apart(why, until_packets);
                }
                if self.shared.as_ref() == Some(&run) {
                    self.shared = None;
                }
                self.placed.remove(&run);
                self.publish(say);
            }
            Next::Passed => {}
            Next::Nobody(why) => {
                say(format!(
                    "{WARNING}maps cannot be joined on this computer: {why}"
                ));
                self.end_trials();
                return;
            }
        }
        self.end_trials();
        self.begin_joining(say);
    }

    /// Removes what trials left.
    fn end_trials(&mut self) {
        // the next ones begin anew
        let _ = std::fs::remove_dir_all(self.store.trial());
    }

    /// Takes up where the runs lie that were joined, and tells everybody.
    fn place(&mut self, joined: &[Place], say: &mut dyn FnMut(String)) {
        let is_usable = |key: &&RunKey| !self.store.runs.get(*key).is_some_and(StoredRun::is_apart);
        let order: Vec<&RunKey> = self.store.order.iter().filter(is_usable).collect();
        self.shared = shared_run(self.shared.as_ref(), &order, joined);
        let Some(shared) = &self.shared else {
            return;
        };
        self.placed = shared_from_agents(joined, shared);
        self.publish(say);
    }

    /// Tells everybody how it is now.
    fn publish(&mut self, say: &mut dyn FnMut(String)) {
        self.version += 1;
        let fleet = self.fleet();
        if let Err(error) = self.store.write_fleet(&json(&fleet)) {
            let text = format!("the transforms cannot be written: {error}");
            self.voice.complain(text, say);
        }
        // who is not there asks later
        let key = format!("{PREFIX}/fleet");
        let _ = self.session.put(key, json(&fleet)).wait();
        say(fleet.sentence());
    }
}

/// What is said of packets that are not taken, in bounds.
#[derive(Debug, Default)]
struct Voice {
    minute: Option<Instant>,
    said: u32,
    unsaid: u64,
}

impl Voice {
    fn complain(&mut self, text: String, say: &mut dyn FnMut(String)) {
        let minute = Duration::from_secs(60);
        if self.minute.is_none_or(|begin| begin.elapsed() >= minute) {
            self.end(say);
            (self.minute, self.said) = (Some(Instant::now()), 0);
        }
        if self.said < SAID_PER_MINUTE {
            self.said += 1;
            say(format!("{WARNING}{text}"));
        } else {
            self.unsaid += 1;
        }
    }

    /// Says how much was not said.
    fn end(&mut self, say: &mut dyn FnMut(String)) {
        if self.unsaid > 0 {
            say(format!("{WARNING}{} more of the kind", self.unsaid));
            self.unsaid = 0;
        }
    }
}

fn json(value: &impl serde::Serialize) -> Vec<u8> {
    // plain structs of numbers and texts always have a text
    serde_json::to_vec(value).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_attack_does_not_fill_a_disk_with_words() {
        let mut voice = Voice::default();
        let mut said = Vec::new();
        for number in 0..1000 {
            voice.complain(number.to_string(), &mut |text| said.push(text));
        }
        voice.end(&mut |text| said.push(text));
        assert_eq!(said.len(), SAID_PER_MINUTE as usize + 1);
        assert_eq!(said.last().unwrap(), "warning: 940 more of the kind");
    }
}
