//! Agents and a server over real connections of this computer.
#![allow(clippy::unwrap_used, reason = "a test may panic")]

mod common;

use common::{PROGRAM, endpoint, linked, server_config, session};
use monogrid_datasets::{ReadOptions, Recording};
use monogrid_fleet::agent::{Agent, AgentConfig, Delivered, Link, LinkError};
use monogrid_fleet::messages::{Fleet, PREFIX, RunKey};
use monogrid_fleet::packet::parts_of;
use monogrid_fleet::server::{JoiningConfig, Server, similarity_of};
use monogrid_geometry::Sim3;
use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::{self, JoinHandle};
use std::time::Duration;

/// Runs `monogrid`.
fn monogrid(arguments: &str, folder: &Path) {
    let mut command = Command::new(PROGRAM);
    command
        .arg("monogrid")
        .args(arguments.split(' '))
        .current_dir(folder);
    let done = command.output().unwrap();
    assert!(
        done.status.success(),
        "{arguments}: {}",
        String::from_utf8_lossy(&done.stderr)
    );
}

/// An agent in a thread of its own; what it did, and what it said.
fn agent(
    name: &str,
    server: &str,
    recording: PathBuf,
    is_over: Arc<AtomicBool>,
) -> JoinHandle<(Delivered, Vec<String>)> {
    let config = AgentConfig {
        name: name.into(),
        connect: vec![server.into()],
        zenoh_config: None,
        max_bytes_per_s: 1e7,
        give_up_after: Duration::from_secs(120),
        jpeg_quality: 75,
    };
    let mut agent = Agent::new(config, &recording).unwrap();
    thread::spawn(move || {
        let mut said = Vec::new();
        let is_over = || is_over.load(Ordering::Relaxed);
        let delivered = agent.work(is_over, &mut |news| said.push(news));
        (delivered.unwrap(), said)
    })
}

/// `merged_from_world` of a run whose source has this name.
fn place_of(merged: &Recording, run: &Recording) -> Sim3 {
    let sessions = &merged.continuation.as_ref().unwrap().sessions;
    let is_its = |id: u32| {
        let before = sessions.iter().rfind(|s| s.first_keyframe <= id).unwrap();
        before.source == run.session.source
    };
    let pairs = merged.keyframes.iter().filter(|k| is_its(k.id)).map(|k| {
        let same = |own: &&monogrid_datasets::RecordedKeyframe| own.frame_index == k.frame_index;
        let own = run.keyframes.iter().find(same).unwrap();
        (
            k.world_from_keyframe.unwrap(),
            own.world_from_keyframe.unwrap(),
        )
    });
    similarity_of(&pairs.collect::<Vec<_>>()).unwrap()
}

fn read(path: &Path) -> Recording {
    Recording::read(path, ReadOptions { with_images: false }).unwrap()
}

/// Where the world of `b` lies in that of `a`.
fn relative(fleet: &Fleet, a: &str, b: &str) -> Sim3 {
    let place = |name: &str| {
        let agent = fleet
            .agents
            .iter()
            .find(|agent| agent.run.starts_with(name))
            .unwrap();
        Sim3::from(agent.shared_from_agent.as_ref().unwrap())
    };
    place(a).inverse() * place(b)
}

fn assert_close(found: &Sim3, expected: &Sim3) {
    let difference = found.inverse() * *expected;
    assert!(
        difference.rotation.angle() < 0.3_f64.to_radians(),
        "{difference:?}"
    );
    assert!(difference.scale.ln().abs() < 0.01, "{difference:?}");
    assert!(difference.translation.norm() < 0.01, "{difference:?}");
}

/// Writes a copy of a file in thirty pieces.
fn copied_slowly(from: &Path, to: &Path) {
    let bytes = fs::read(from).unwrap();
    let mut growing = fs::File::create(to).unwrap();
    for piece in bytes.chunks(bytes.len() / 30) {
        growing.write_all(piece).unwrap();
        thread::sleep(Duration::from_millis(50));
    }
}

/// Two runs, a and b, of which the second half of one sees what the first half of the other does,
/// and both merged.
fn two_runs(folder: &Path) {
    let at = |name: &str| folder.join(name);
    monogrid(
        "synth office --frames 500 --max-frames 130 --depth-every 0 --truth-resolution 0.4 \
         --quick-light --size 320x240 --out east",
        folder,
    );
    fs::create_dir(at("west")).unwrap();
    for name in ["rgb", "rgb.txt", "calibration.txt"] {
        fs::rename(at("east").join(name), at("west").join(name)).unwrap();
        std::os::unix::fs::symlink(at("west").join(name), at("east").join(name)).unwrap();
    }
    let run = "--rolling-shutter 0 --resolution 0.2";
    monogrid(&format!("run east --max-frames 80 {run} --out a"), folder);
    monogrid(&format!("run west --start 45 {run} --out b"), folder);
    monogrid("merge-runs a b --resolution 0.2 --out merged", folder);
}

#[test]
fn an_agent_without_server_goes_on_and_catches_up_and_lies_where_merge_runs_has_it() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    two_runs(folder.path());

    // the recording of a grows, and nobody is there
    let server = endpoint();
    let is_over = Arc::new(AtomicBool::new(false));
    let a = agent("a", &server, at("growing.mgk"), Arc::clone(&is_over));
    copied_slowly(&at("a/recording.mgk"), &at("growing.mgk"));
    is_over.store(true, Ordering::Relaxed);
    assert!(!a.is_finished());

    let mut config = server_config(&server, &at("fleet"));
    config.until_ended = Some(3);
    let serving = thread::spawn(move || {
        let mut server = Server::start(config, &mut |_| {}).unwrap();
        server.work(|| 0, &mut |_| {})
    });
    let b = agent(
        "b",
        &server,
        at("b/recording.mgk"),
        Arc::new(AtomicBool::new(true)),
    );
    for (agent, keyframes) in [
        (a, read(&at("a/recording.mgk"))),
        (b, read(&at("b/recording.mgk"))),
    ] {
        let (delivered, said) = agent.join().unwrap();
        // all of them, which are more than keyframes
        let waited = said.iter().find_map(|news| {
            let (waited, all) = news.strip_prefix("connected; ")?.split_once(" of ")?;
            Some((
                waited.parse().unwrap(),
                all.strip_suffix(" packets wait")?.parse().unwrap(),
            ))
        });
        let (waited, all): (usize, usize) = waited.unwrap();
        assert!(waited == all && all > keyframes.keyframes.len());
        assert_eq!(delivered.taken, delivered.packets);
    }
    // nobody can join a recording with itself: who delivers that of another agent keeps nobody from
    // being joined
    let again = Arc::new(AtomicBool::new(true));
    let c = agent("c", &server, at("a/recording.mgk"), again);
    c.join().unwrap();
    let fleet = serving.join().unwrap();
    assert!(fleet.agents.iter().all(|agent| agent.has_ended));
    for agent in &fleet.agents {
        let why = agent.set_apart.clone().unwrap_or_default();
        assert_eq!(
            why.contains("same recording"),
            agent.run.starts_with("c/"),
            "{why}"
        );
    }

    let merged = read(&at("merged/recording.mgk"));
    let place = |name: &str| place_of(&merged, &read(&at(name).join("recording.mgk")));
    let expected = place("a").inverse() * place("b");
    let found = relative(&fleet, "a", "b");
    assert_close(&found, &expected);
    // of all keyframes, in one map that all commands read
    let joined = read(&at("fleet/map/recording.mgk"));
    assert_eq!(joined.keyframes.len(), merged.keyframes.len());
}

#[test]
fn a_server_refuses_what_is_no_packet_says_what_it_misses_and_goes_on_after_a_restart() {
    let folder = tempfile::tempdir().unwrap();
    let endpoint = endpoint();
    let is_over = Arc::new(AtomicBool::new(false));
    let serve = || {
        let config = server_config(&endpoint, folder.path());
        let (is_over, mut server) = (
            Arc::clone(&is_over),
            Server::start(config, &mut |_| {}).unwrap(),
        );
        thread::spawn(move || {
            server.work(|| usize::from(is_over.load(Ordering::Relaxed)), &mut |_| {})
        })
    };
    let packet = parts_of(&session()).unwrap()[0].encode().unwrap();
    let run = RunKey::new("drone", 5).unwrap();
    let key = |number: u64| run.key(&format!("packets/{number}"));
    let refused = |link: &Link, packet: Vec<u8>| match link.deliver(&key(0), Some(packet)) {
        Err(LinkError::Refused(why)) => why,
        other => panic!("{other:?}"),
    };

    let serving = serve();
    let link = linked(&endpoint);
    let mut damaged = packet.clone();
    damaged[20] ^= 1;
    assert!(refused(&link, damaged).contains("checksum"));
    let mut newer = packet.clone();
    newer[4] = 2;
    assert!(refused(&link, newer).contains("version 2"));
    // nothing was kept of them; what comes too early is not taken either
    assert_eq!(link.deliver(&key(3), Some(packet.clone())).unwrap().from, 0);
    assert_eq!(link.deliver(&key(0), Some(packet.clone())).unwrap().from, 1);
    // an answer that was lost: the same once more
    assert_eq!(link.deliver(&key(0), Some(packet.clone())).unwrap().from, 1);
    assert_eq!(link.ask(&key(0), None).unwrap(), packet);
    assert!(matches!(
        link.ask(&key(1), None),
        Err(LinkError::Refused(_))
    ));
    assert!(matches!(
        link.ask(&format!("{PREFIX}/nothing"), None),
        Err(LinkError::Refused(_))
    ));
    drop(link);
    is_over.store(true, Ordering::Relaxed);
    serving.join().unwrap();

    // killed between the name of a run and its first packet, a server names it again
    let list = fs::read_to_string(folder.path().join("agents/runs.txt")).unwrap();
    fs::write(folder.path().join("agents/runs.txt"), list.repeat(2)).unwrap();
    is_over.store(false, Ordering::Relaxed);
    let serving = serve();
    let link = linked(&endpoint);
    assert_eq!(link.deliver(&run.key("missing"), None).unwrap().from, 1);
    assert_eq!(link.ask(&key(0), None).unwrap(), packet);
    let fleet = link.fleet().unwrap();
    assert_eq!(fleet.shared, Some(run.to_string()));
    assert_eq!(fleet.agents.len(), 1);
    assert_eq!(
        (fleet.agents[0].packets, fleet.agents[0].shared_from_agent),
        (1, None)
    );
    is_over.store(true, Ordering::Relaxed);
    serving.join().unwrap();
}

#[test]
fn a_joining_is_due_when_two_maps_have_enough_that_is_new() {
    let config = server_config("tcp/127.0.0.1:1", Path::new("")).joining;
    let config = JoiningConfig {
        every: Duration::from_secs(10),
        min_new_keyframes: 5,
        ..config
    };
    let is_due = |seconds, new, joinable| {
        monogrid_fleet::server::is_due(&config, Duration::from_secs(seconds), new, joinable)
    };
    assert!(is_due(10, 5, 2));
    assert!(!is_due(9, 5, 2));
    assert!(!is_due(10, 4, 2));
    assert!(!is_due(10, 5, 1));
}
