//! The command line.

use crate::agent::{Agent, AgentConfig, Delivered};
use crate::config::with_file;
use crate::messages::WARNING;
use crate::network::connections;
use crate::panics::Panics;
use crate::server::{APART, JoiningConfig, Limits, Server, ServerConfig};
use anyhow::Context as _;
use clap::builder::PossibleValue;
use clap::{Args, Parser, Subcommand, ValueEnum};
use monogrid_app::process::console::LogArgs;
use std::ffi::OsString;
use std::net::SocketAddr;
use std::panic::AssertUnwindSafe;
use std::path::PathBuf;
use std::process::{self, Child};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

/// Several cameras, one map: agents that run alone, and a server that joins what they see
#[derive(Debug, Parser)]
#[command(name = "monogrid-fleet", version, max_term_width = 110)]
pub struct Cli {
    /// What to do
    #[command(subcommand)]
    pub command: Command,
    /// What it says of it
    #[command(flatten)]
    pub log: LogArgs,
}

/// The commands.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Run `monogrid run` on a source and deliver its keyframes to a server, as far as there is a
    /// way to it
    Agent(AgentArgs),
    /// Take what agents deliver, join their maps, and say where their worlds lie in the shared one
    Server(ServerArgs),
    /// The program `monogrid`, as agents and server call it
    #[command(disable_help_flag = true)]
    Monogrid {
        /// Its command line
        #[arg(trailing_var_arg = true, allow_hyphen_values = true)]
        arguments: Vec<OsString>,
    },
}

/// `monogrid-fleet agent`.
#[derive(Debug, Args)]
pub struct AgentArgs {
    /// What `monogrid run` reads: a video, a camera, a stream, a folder of images
    #[arg(required_unless_present = "follow")]
    pub source: Option<PathBuf>,
    /// Name of the agent: letters, digits, - and _
    #[arg(long, value_name = "NAME")]
    pub name: String,
    /// Where the server listens; several times for several ways to it
    #[arg(
        long,
        value_name = "tcp/HOST:PORT",
        required_unless_present = "zenoh_config"
    )]
    pub connect: Vec<String>,
    /// Settings of Zenoh (JSON5): TLS, name and password; other options stand over what they name
    #[arg(long, value_name = "FILE")]
    pub zenoh_config: Option<PathBuf>,
    /// Output folder of the run
    #[arg(long, value_name = "DIR", required_unless_present = "follow")]
    pub out: Option<PathBuf>,
    /// Deliver the recording of a run that goes on elsewhere, or has ended, instead of starting one
    #[arg(long, value_name = "RECORDING", conflicts_with_all = ["source", "out"])]
    pub follow: Option<PathBuf>,
    /// Kilobytes (1000) of packets per second at most
    #[arg(long, value_name = "KB", default_value_t = 180.0, value_parser = rate)]
    pub max_rate: f64,
    /// Quality of the JPEG images of keyframes, 1 to 100
    #[arg(
        long, value_name = "Q", default_value_t = 75,
        value_parser = clap::value_parser!(u8).range(1..=100)
    )]
    pub jpeg_quality: u8,
    /// Seconds for which the server is still tried when the run has ended; --follow delivers the
    /// rest later
    #[arg(long, value_name = "SECONDS", default_value_t = 600)]
    pub give_up_after: u64,
    /// Options from a file (TOML): max_rate = 90 is --max-rate 90; the command line holds over it
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// Further options of `monogrid run`, behind --
    #[arg(last = true)]
    pub run: Vec<OsString>,
}

/// `monogrid-fleet server`.
#[derive(Debug, Args)]
pub struct ServerArgs {
    /// Where to listen; several times for several [default: tcp/127.0.0.1:7447, this computer only]
    #[arg(long, value_name = "tcp/ADDRESS:PORT")]
    pub listen: Vec<String>,
    /// Settings of Zenoh (JSON5): TLS, access control; other options stand over what they name
    #[arg(long, value_name = "FILE")]
    pub zenoh_config: Option<PathBuf>,
    /// Where Prometheus reads how the server is, at /metrics, and whether it works, at /health;
    /// whoever reaches the address can read
    #[arg(long, value_name = "ADDRESS:PORT")]
    pub metrics: Option<SocketAddr>,
    /// Runs of all agents at most; of one agent a quarter
    #[arg(
        long, value_name = "N", default_value_t = Limits::default().runs,
        value_parser = clap::value_parser!(u64).range(1..)
    )]
    pub max_runs: u64,
    /// Keyframes of all agents at most; of one agent a quarter
    #[arg(
        long, value_name = "N", default_value_t = Limits::default().keyframes,
        value_parser = clap::value_parser!(u64).range(1..=100_000_000)
    )]
    pub max_keyframes: u64,
    /// Gigabytes (1000^3) on the disk that agents may fill, without the joined map; one agent a
    /// quarter
    #[arg(
        long, value_name = "GB", default_value_t = Limits::default().disk_bytes as f64 / 1e9,
        value_parser = rate
    )]
    pub max_disk: f64,
    /// Folder for what agents deliver (agents) and the joined map (map); that of an earlier server
    /// is taken up again
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Seconds between the end of a joining and the next one at least
    #[arg(long, value_name = "SECONDS", default_value_t = 10)]
    pub join_every: u64,
    /// Seconds that a joining may take; runs with which it takes longer are set apart
    #[arg(long, value_name = "SECONDS", default_value_t = 1800)]
    pub join_within: u64,
    /// So many new keyframes are worth a joining
    #[arg(
        long, value_name = "N", default_value_t = 5,
        value_parser = clap::value_parser!(u64).range(1..)
    )]
    pub min_new_keyframes: u64,
    /// End when so many runs have ended and all of them is here [default: when interrupted]
    #[arg(long, value_name = "N")]
    pub until_ended: Option<usize>,
    /// Options from a file (TOML): max_runs = 8 is --max-runs 8; the command line holds over it
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// Further options of `monogrid merge-runs`, behind --
    #[arg(last = true)]
    pub merge: Vec<OsString>,
}

fn rate(text: &str) -> Result<f64, String> {
    let rate: f64 = text.parse().map_err(|error| format!("{error}"))?;
    let rate = Some(rate).filter(|rate| rate.is_finite() && *rate > 0.0);
    rate.ok_or_else(|| "expected a positive number".to_owned())
}

/// Does what a command line asks for, the name of the program first; the exit code: that of the run
/// for an agent, 1 where not everything could be delivered.
pub fn main(arguments: impl IntoIterator<Item = OsString>) -> u8 {
    let arguments = match with_file(arguments.into_iter().collect()) {
        Ok(arguments) => arguments,
        Err(error) => {
            tell(&format!("error: {error}"));
            return 2;
        }
    };
    let cli = match Cli::try_parse_from(arguments) {
        Ok(cli) => cli,
        Err(error) => {
            if error.use_stderr() {
                tell(error.to_string().trim_end());
                return 2;
            }
            let _ = error.print();
            return 0;
        }
    };
    let log = cli.log;
    let is_program = matches!(cli.command, Command::Monogrid { .. });
    if !is_program {
        // the program says things itself
        log.begin("monogrid-fleet");
    }
    let result = match cli.command {
        Command::Agent(args) => agent(&args, log),
        Command::Server(args) => server(args),
        Command::Monogrid { arguments } => {
            let name = OsString::from("monogrid");
            return monogrid_cli::program::main(std::iter::once(name).chain(arguments));
        }
    };
    result.unwrap_or_else(|error| {
        tell(&format!("error: {error:#}"));
        1
    })
}

/// To whoever looks after it. Names and reasons may come from agents, servers and files.
fn tell(text: &str) {
    monogrid_app::eprintln!("{text}");
}

/// What an agent or a server says; how bad it is comes first.
fn tell_of(who: &str, news: &str) {
    match news.strip_prefix(WARNING) {
        Some(news) => tell(&format!("{WARNING}{who}: {news}")),
        None => tell(&format!("{who}: {news}")),
    }
}

/// This program as `monogrid`.
fn monogrid() -> anyhow::Result<Vec<OsString>> {
    let program = std::env::current_exe().context("this program cannot be found")?;
    Ok(vec![program.into(), "monogrid".into()])
}

/// How often Ctrl-C was pressed.
fn interrupted() -> anyhow::Result<Arc<AtomicUsize>> {
    let count = Arc::new(AtomicUsize::new(0));
    let counting = Arc::clone(&count);
    ctrlc::set_handler(move || {
        counting.fetch_add(1, Ordering::Relaxed);
    })?;
    Ok(count)
}

fn agent(args: &AgentArgs, log: LogArgs) -> anyhow::Result<u8> {
    let config = AgentConfig {
        name: args.name.clone(),
        connect: args.connect.clone(),
        zenoh_config: args.zenoh_config.clone(),
        max_bytes_per_s: args.max_rate * 1e3,
        give_up_after: Duration::from_secs(args.give_up_after),
        jpeg_quality: args.jpeg_quality,
    };
    let (recording, mut run) = match (&args.follow, &args.source, &args.out) {
        (Some(recording), ..) => (recording.clone(), None),
        (None, Some(source), Some(out)) => (
            out.join("recording.mgk"),
            Some(Run::start(source, out, args, log)?),
        ),
        _ => anyhow::bail!("expected a source and --out, or --follow"),
    };
    let interrupted = interrupted()?;
    let mut agent = Agent::new(config, &recording)?;
    let is_over = || match &mut run {
        Some(run) => run.is_over(&interrupted),
        None => true,
    };
    let name = &args.name;
    let worked = agent.work(is_over, &mut |news| tell_of(name, &news));
    let run_code = run.as_mut().map_or(Ok(0), Run::code)?;
    let delivered = worked?;
    tell(&format!("{name}: {}", summary(&delivered)));
    let is_all = delivered.taken >= delivered.packets;
    // the code of the run comes first
    Ok(if is_all { run_code } else { run_code.max(1) })
}

/// A run in a process of its own: whatever becomes of the agent, it goes on.
struct Run {
    child: Child,
    was_asked: bool,
}

impl Run {
    fn start(
        source: &PathBuf,
        out: &PathBuf,
        args: &AgentArgs,
        log: LogArgs,
    ) -> anyhow::Result<Self> {
        let program = monogrid()?;
        let mut command = process::Command::new(&program[0]);
        command.args(&program[1..]).arg("run").arg(source);
        command.arg("--out").arg(out);
        let form = log.log.to_possible_value();
        let level = log.log_level.to_possible_value();
        for (option, value) in [("--log", form), ("--log-level", level)] {
            command
                .arg(option)
                .args(value.as_ref().map(PossibleValue::get_name));
        }
        command.args(&args.run);
        #[cfg(unix)]
        // an interrupt from the terminal is for this process, which passes it on
        std::os::unix::process::CommandExt::process_group(&mut command, 0);
        let child = command.spawn().context("the run cannot be started")?;
        let was_asked = false;
        Ok(Self { child, was_asked })
    }

    /// Whether it has ended; an interrupt is passed on once.
    fn is_over(&mut self, interrupted: &AtomicUsize) -> bool {
        if interrupted.load(Ordering::Relaxed) > 0 && !self.was_asked {
            self.was_asked = true;
            ask_to_stop(&mut self.child);
        }
        !matches!(self.child.try_wait(), Ok(None))
    }

    fn code(&mut self) -> anyhow::Result<u8> {
        let status = self.child.wait()?;
        let code = status.code().and_then(|code| u8::try_from(code).ok());
        Ok(code.unwrap_or(1))
    }
}

/// As Ctrl-C does: it saves what it has.
#[cfg(unix)]
fn ask_to_stop(child: &mut Child) {
    use rustix::process::{Pid, Signal, kill_process};
    // it may have ended just now
    let _ = kill_process(Pid::from_child(child), Signal::INT);
}

#[cfg(not(unix))]
fn ask_to_stop(child: &mut Child) {
    let _ = child.kill();
}

fn summary(delivered: &Delivered) -> String {
    let Delivered {
        packets,
        taken,
        bytes,
        recorded_s,
        sending_s,
    } = *delivered;
    let per_second = |seconds: f64| bytes as f64 / 1e3 / seconds.max(1e-9);
    format!(
        "{taken} of {packets} packets delivered, {bytes} bytes: {:.0} kB/s over the \
         {recorded_s:.1} s of the recording, {:.0} kB/s over the {sending_s:.1} s of sending",
        per_second(recorded_s),
        per_second(sending_s),
    )
}

fn server(args: ServerArgs) -> anyhow::Result<u8> {
    let panics = Panics::watch();
    let config = ServerConfig {
        listen: args.listen,
        zenoh_config: args.zenoh_config,
        metrics: args.metrics,
        limits: Limits {
            runs: args.max_runs,
            keyframes: args.max_keyframes,
            disk_bytes: (args.max_disk * 1e9) as u64,
        },
        out: args.out,
        joining: JoiningConfig {
            every: Duration::from_secs(args.join_every),
            within: Duration::from_secs(args.join_within),
            min_new_keyframes: args.min_new_keyframes,
            program: monogrid()?,
            arguments: args.merge,
        },
        until_ended: args.until_ended,
    };
    let interrupted = interrupted()?;
    let map = config.out.join("map");
    let say = &mut |news: String| tell_of("server", &news);
    let mut server = Server::start(config, say)?;
    say(format!("listens; {} connections at most", connections()));
    let dies = std::env::var(DIES).ok();
    if dies.as_deref() == Some("beside") {
        std::thread::spawn(|| panic!("a thread beside the server"));
    }
    let interrupts = || {
        assert!(dies.as_deref() != Some("itself"), "the server itself");
        interrupted.load(Ordering::Relaxed) + usize::from(panics.first().is_some())
    };
    // a panic of its own is no other: it is said, and what came is on the disk
    let work = AssertUnwindSafe(|| server.work(interrupts, say));
    let worked = std::panic::catch_unwind(work);
    if let Some(died) = panics.first() {
        anyhow::bail!("{died}; what agents delivered is kept, start the server again");
    }
    let fleet = worked.map_err(|_| anyhow::anyhow!("the server died"))?;
    let agents = fleet.agents.iter();
    let placed = agents.filter(|a| a.shared_from_agent.is_some()).count();
    let (all, map) = (fleet.agents.len(), map.display());
    tell(&format!("server: {placed} of {all} runs in one map: {map}"));
    Ok(if placed == all { 0 } else { APART as u8 })
}

/// For tests: which thread of a server dies.
const DIES: &str = "MONOGRID_FLEET_DIES";
