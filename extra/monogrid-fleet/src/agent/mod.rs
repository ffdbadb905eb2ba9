//! An agent: reads the recording of a run as it grows and delivers it.

mod link;
mod packer;
mod tail;

pub use link::{Link, LinkError, REFUSED};
pub use packer::{NewestPose, Packer};

use crate::messages::{AgentPose, BadName, Fleet, RunKey, WARNING, run_number};
use crate::network::{self, NetworkError};
use crate::packet::PacketError;
use crate::packet_log::PacketLog;
use monogrid_datasets::{DatasetError, Record};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};
use tail::Tail;

/// Time between looks at the recording when there is nothing to deliver.
const LOOK_EVERY: Duration = Duration::from_millis(100);
/// Time after which a lost link is tried again.
const RETRY_AFTER: Duration = Duration::from_secs(1);

/// What an agent is told.
#[derive(Clone, Debug)]
pub struct AgentConfig {
    /// Its name.
    pub name: String,
    /// Endpoints of the server, `tcp/HOST:PORT`; without any those of the file of settings.
    pub connect: Vec<String>,
    /// Settings of Zenoh, a JSON5 file.
    pub zenoh_config: Option<PathBuf>,
    /// Bytes of packets per second at most, over any time; positive.
    pub max_bytes_per_s: f64,
    /// After the end of the run the server is tried for so long.
    pub give_up_after: Duration,
    /// Quality of the JPEG images of keyframes, 1 to 100.
    pub jpeg_quality: u8,
}

/// Why an agent cannot go on.
#[derive(Debug, thiserror::Error)]
pub enum AgentError {
    /// The recording is none.
    #[error(transparent)]
    Recording(#[from] DatasetError),
    /// What was recorded has no packet.
    #[error(transparent)]
    Packet(#[from] PacketError),
    /// What was delivered cannot be read back or kept.
    #[error("the packets that wait cannot be kept in a temporary file: {0}")]
    Log(#[from] std::io::Error),
    /// The name cannot be one.
    #[error(transparent)]
    Name(#[from] BadName),
    /// Its network cannot be set up.
    #[error(transparent)]
    Settings(#[from] NetworkError),
}

/// What was delivered.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Delivered {
    /// Packets that there were.
    pub packets: u64,
    /// Packets that the server has.
    pub taken: u64,
    /// Bytes of packets that were sent, those that were sent again among them.
    pub bytes: u64,
    /// Time of the newest keyframe since the first, s.
    pub recorded_s: f64,
    /// Time from the first packet that was sent to the last, s.
    pub sending_s: f64,
}

/// An agent at work.
pub struct Agent {
    config: AgentConfig,
    tail: Tail,
    packer: Packer,
    log: PacketLog,
    session: Option<Record>,
    run: Option<RunKey>,
    first_ns: Option<i64>,
    link: LinkState,
    /// Why the server could not be reached when that was last said.
    unreached: Option<String>,
    /// Number of the packet that is next, as the server said.
    next: u64,
    fleet: Fleet,
    told: Option<(u32, u64)>,
    pace: Pace,
    delivered: Delivered,
}

enum LinkState {
    Up(Link),
    /// Until then it is not tried.
    Down(Instant),
    /// It is not tried any more.
    Refused,
}

impl Agent {
    /// An agent that delivers this recording, which need not exist yet.
    ///
    /// # Errors
    /// When its name cannot be one, no server is named, or no temporary file can be made.
    pub fn new(config: AgentConfig, recording: &Path) -> Result<Self, AgentError> {
        RunKey::new(&config.name, 0)?;
        network::of_agent(&config.connect, config.zenoh_config.as_deref())?;
        Ok(Self {
            tail: Tail {
                path: recording.to_owned(),
                ..Tail::default()
            },
            packer: Packer::new(config.jpeg_quality),
            log: PacketLog::temporary()?,
            pace: Pace {
                bytes_per_s: config.max_bytes_per_s,
                ..Pace::default()
            },
            config,
            session: None,
            run: None,
            first_ns: None,
            link: LinkState::Down(Instant::now()),
            unreached: None,
            next: 0,
            fleet: Fleet::default(),
            told: None,
            delivered: Delivered::default(),
        })
    }

    /// Works until the run is over and everything is delivered, or the server was not there for too
    /// long after it. `is_over` says whether the run has ended, `say` hears what is new, in words.
    ///
    /// # Errors
    /// When the recording cannot be read or packed. A link that is lost is no error.
    pub fn work(
        &mut self,
        mut is_over: impl FnMut() -> bool,
        say: &mut dyn FnMut(String),
    ) -> Result<Delivered, AgentError> {
        let mut over_since: Option<Instant> = None;
        loop {
            // before the recording is read: what was written last is not missed
            if is_over() {
                over_since.get_or_insert_with(Instant::now);
            }
            let has_grown = self.follow()?;
            let has_sent = self.deliver(say);
            self.tell_pose(say);
            if let Some(since) = over_since {
                let is_done = self.next >= self.log.len() && matches!(self.link, LinkState::Up(_));
                let gave_up = since.elapsed() > self.config.give_up_after;
                let is_refused = matches!(self.link, LinkState::Refused);
                if !has_grown && (is_done || gave_up || is_refused || self.log.is_empty()) {
                    return Ok(self.summary());
                }
            }
            if !has_sent {
                std::thread::sleep(LOOK_EVERY);
            }
        }
    }

    /// Packs what has been recorded since the last time; whether there was anything.
    fn follow(&mut self) -> Result<bool, AgentError> {
        self.tail.read(|record| {
            match (record, &self.session) {
                (Record::Session(_), _) => self.session = Some(record.clone()),
                (Record::Keyframe(first), Some(session)) if self.run.is_none() => {
                    let number = run_number(session, record);
                    self.run = Some(RunKey::new(&self.config.name, number)?);
                    self.first_ns = Some(first.timestamp_ns);
                }
                _ => {}
            }
            self.packer.pack(record, &mut self.log)
        })
    }

    /// Sends the next packet, if there is one and the server is there; whether it was sent.
    fn deliver(&mut self, say: &mut dyn FnMut(String)) -> bool {
        let Some(run) = self.run.clone() else {
            return false;
        };
        let sent = match &self.link {
            LinkState::Refused => return false,
            LinkState::Down(until) if Instant::now() < *until => return false,
            LinkState::Down(_) => self.connect(&run, say).map(|()| false),
            LinkState::Up(link) => {
                if let Some(fleet) = link.news() {
                    self.fleet = fleet;
                }
                self.send_next(&run)
            }
        };
        match sent {
            Ok(has_sent) => has_sent,
            Err(LinkError::Lost(why)) => {
                if matches!(self.link, LinkState::Up(_)) {
                    say(format!("{WARNING}the link is lost, the run goes on: {why}"));
                } else if self.unreached.as_ref() != Some(&why) {
                    say(format!("{WARNING}no server yet, the run goes on: {why}"));
                    self.unreached = Some(why);
                }
                self.link = LinkState::Down(Instant::now() + RETRY_AFTER);
                false
            }
            Err(LinkError::Refused(why)) => {
                say(format!(
                    "{WARNING}nothing more is delivered, the run goes on: {why}"
                ));
                self.link = LinkState::Refused;
                false
            }
        }
    }

    fn connect(&mut self, run: &RunKey, say: &mut dyn FnMut(String)) -> Result<(), LinkError> {
        let config = &self.config;
        let link = Link::open(&config.connect, config.zenoh_config.as_deref())?;
        self.next = link.deliver(&run.key("missing"), None)?.from;
        self.fleet = link.fleet()?;
        self.link = LinkState::Up(link);
        let of = self.log.len();
        let waiting = of.saturating_sub(self.next);
        say(format!("connected; {waiting} of {of} packets wait"));
        Ok(())
    }

    fn send_next(&mut self, run: &RunKey) -> Result<bool, LinkError> {
        let LinkState::Up(link) = &self.link else {
            return Ok(false);
        };
        let lost = |error: std::io::Error| LinkError::Lost(error.to_string());
        let now = Instant::now();
        if !self.pace.is_free(now) {
            return Ok(false);
        }
        let Some(packet) = self.log.read(self.next).map_err(lost)? else {
            return Ok(false);
        };
        let bytes = packet.len();
        self.pace.sent(now, bytes);
        self.delivered.bytes += bytes as u64;
        let key = run.key(&format!("packets/{}", self.next));
        self.next = link.deliver(&key, Some(packet))?.from;
        Ok(true)
    }

    /// Says and publishes where the newest keyframe is, when it or the transform is new.
    fn tell_pose(&mut self, say: &mut dyn FnMut(String)) {
        let (Some(newest), Some(run)) = (self.packer.newest_pose(), &self.run) else {
            return;
        };
        let now = (newest.keyframe, self.fleet.version);
        if self.told == Some(now) {
            return;
        }
        self.told = Some(now);
        let world_from_keyframe = newest.world_from_keyframe;
        let shared = self.fleet.shared_from(run);
        let pose = AgentPose {
            timestamp_ns: newest.timestamp_ns,
            keyframe: newest.keyframe,
            world_from_keyframe: (&world_from_keyframe).into(),
            shared_from_keyframe: shared.map(|s| (&(s * world_from_keyframe)).into()),
            version: self.fleet.version,
        };
        if let (LinkState::Up(link), Ok(text)) = (&self.link, serde_json::to_string(&pose)) {
            // the next one comes soon
            let _ = link.publish(&run.key("pose"), text);
        }
        say(pose.sentence());
    }

    fn summary(&self) -> Delivered {
        let times = self.packer.newest_pose().zip(self.first_ns);
        let recorded_ns = times.map_or(0, |(newest, first_ns)| newest.timestamp_ns - first_ns);
        Delivered {
            packets: self.log.len(),
            taken: self.next,
            recorded_s: recorded_ns as f64 * 1e-9,
            sending_s: self.pace.sending_s(),
            ..self.delivered
        }
    }
}

/// Lets no more bytes through than a rate allows: after so many bytes it is closed for as long as
/// they take at that rate.
#[derive(Debug, Default)]
struct Pace {
    bytes_per_s: f64,
    closed_until: Option<Instant>,
    first_sent: Option<Instant>,
    last_sent: Option<Instant>,
}

impl Pace {
    fn is_free(&self, now: Instant) -> bool {
        self.closed_until.is_none_or(|until| now >= until)
    }

    fn sent(&mut self, now: Instant, bytes: usize) {
        self.closed_until = Some(now + Duration::from_secs_f64(bytes as f64 / self.bytes_per_s));
        self.first_sent.get_or_insert(now);
        self.last_sent = Some(now);
    }

    fn sending_s(&self) -> f64 {
        let times = self.first_sent.zip(self.last_sent);
        times.map_or(0.0, |(first, last)| (last - first).as_secs_f64())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_pace_is_kept_over_any_time() {
        let begin = Instant::now();
        let at = |ms: u64| begin + Duration::from_millis(ms);
        let mut pace = Pace {
            bytes_per_s: 1000.0,
            ..Pace::default()
        };
        assert!(pace.is_free(begin));
        pace.sent(begin, 500);
        assert!(!pace.is_free(at(499)));
        assert!(pace.is_free(at(500)));
        // time in which nothing was sent is not saved up
        pace.sent(at(5000), 500);
        assert!(!pace.is_free(at(5499)));
        assert!(pace.is_free(at(5500)));
        assert_eq!(pace.sending_s(), 5.0);
    }
}
