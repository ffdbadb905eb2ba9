//! A server with agents that mean harm: they are refused and named, and the honest one is served.
#![allow(clippy::unwrap_used, reason = "a test may panic")]

mod common;

use common::{PROGRAM, endpoint, linked, server_config, session};
use monogrid_datasets::{
    Continuation, DepthPixel, EndRecord, KeyframeRecord, PoseSnapshot, Record, RecordedFrame,
    SessionInfo, encode_jpeg, is_obeyed,
};
use monogrid_fleet::agent::{Link, LinkError};
use monogrid_fleet::messages::{Fleet, PREFIX, RunKey};
use monogrid_fleet::packet::{
    MAX_PACKET_BYTES, PackedDepth, PackedKeyframe, Packet, RecordPart, parts_of,
};
use monogrid_fleet::server::{Limits, Server, ServerConfig};
use monogrid_geometry::nalgebra::Quaternion;
use monogrid_geometry::{Pinhole, Rotation, Se3, Sim3, Vec3};
use monogrid_image::Image;
use rcgen::{BasicConstraints, CertificateParams, CertifiedIssuer, IsCa, KeyPair, KeyUsagePurpose};
use std::fs;
use std::io::{Read, Write};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

/// A server in a thread of its own.
struct Serving {
    thread: JoinHandle<(Fleet, Vec<String>)>,
    is_over: Arc<AtomicBool>,
}

impl Serving {
    fn start(config: ServerConfig) -> Self {
        let is_over = Arc::new(AtomicBool::new(false));
        let over = Arc::clone(&is_over);
        let mut said = Vec::new();
        let mut server = Server::start(config, &mut |news| said.push(news)).unwrap();
        let thread = thread::spawn(move || {
            let fleet = server.work(|| usize::from(over.load(Ordering::Relaxed)), &mut |news| {
                said.push(news);
            });
            (fleet, said)
        });
        Self { thread, is_over }
    }

    /// What is known at the end, and all that was said.
    fn end(self) -> (Fleet, Vec<String>) {
        self.is_over.store(true, Ordering::Relaxed);
        self.thread.join().unwrap()
    }
}

/// A run that is delivered packet by packet.
struct Sender<'a> {
    link: &'a Link,
    run: RunKey,
    next: u64,
}

impl<'a> Sender<'a> {
    fn new(link: &'a Link, name: &str, run: u64) -> Self {
        let run = RunKey::new(name, run).unwrap();
        let next = 0;
        Self { link, run, next }
    }

    fn send(&mut self, bytes: Vec<u8>) -> Result<(), LinkError> {
        let key = self.run.key(&format!("packets/{}", self.next));
        self.next = self.link.deliver(&key, Some(bytes))?.from;
        Ok(())
    }

    fn packet(&mut self, packet: &Packet) -> Result<(), LinkError> {
        self.send(packet.encode().unwrap())
    }

    fn record(&mut self, record: &Record) -> Result<(), LinkError> {
        let parts = parts_of(record).unwrap();
        parts.iter().try_for_each(|part| self.packet(part))
    }

    /// Why it is refused.
    fn refused(&mut self, packet: &Packet) -> String {
        self.refused_bytes(packet.encode().unwrap())
    }

    fn refused_bytes(&mut self, bytes: Vec<u8>) -> String {
        match self.send(bytes) {
            Err(LinkError::Refused(why)) => why,
            other => panic!("{other:?}"),
        }
    }
}

/// A keyframe of noise that differs with `seed`, with depth.
fn keyframe(id: u32, seed: u32) -> KeyframeRecord {
    let (width, height) = (80, 60);
    let noise = |x: usize, y: usize| {
        let cell = (x / 4 + 512 * (y / 4)) as u32 + 77_777 * seed;
        (cell.wrapping_mul(2_654_435_761) >> 24) as u8
    };
    let places = (0..height).flat_map(|y| (0..width).map(move |x| (x, y)));
    let pixels = places.filter(|(x, y)| x % 4 == 0 && y % 4 == 0);
    let pixels = pixels.map(|(x, y)| DepthPixel {
        x: x as u16,
        y: y as u16,
        idepth: 0.5,
        idepth_var: 1e-4,
    });
    KeyframeRecord {
        id,
        frame_index: u64::from(id),
        timestamp_ns: i64::from(id),
        camera: None,
        image: Some(Image::from_fn(width, height, |x, y| {
            noise(x + 3 * id as usize, y)
        })),
        pixels: pixels.collect(),
    }
}

fn packed(id: u32, seed: u32) -> Packet {
    Packet::Keyframe(PackedKeyframe::pack(&keyframe(id, seed), 75).unwrap())
}

fn pose(id: u32, x: f64) -> (u32, Sim3) {
    let at = Vec3::new(x, 0.0, 0.0);
    (id, Sim3::new(1.0, Rotation::identity(), at))
}

fn poses(poses: Vec<(u32, Sim3)>) -> Record {
    Record::Poses(PoseSnapshot { revision: 1, poses })
}

/// Delivers a small whole run of three keyframes, as an honest agent does.
fn deliver(link: &Link, name: &str, seed: u32) {
    let mut sender = Sender::new(link, name, u64::from(seed));
    sender.record(&session()).unwrap();
    for id in 0..3 {
        sender.packet(&packed(id, seed)).unwrap();
    }
    let places = (0..3).map(|id| pose(id, 0.1 * f64::from(id)));
    sender.record(&poses(places.collect())).unwrap();
    sender
        .record(&Record::Continuation(Continuation::default()))
        .unwrap();
    sender.record(&Record::End(EndRecord::default())).unwrap();
}

fn bytes_below(folder: &Path) -> u64 {
    let entries = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap());
    entries
        .map(|entry| match entry.path().is_dir() {
            true => bytes_below(&entry.path()),
            false => entry.metadata().unwrap().len(),
        })
        .sum()
}

/// Packets that an agent with three keyframes of 80x60 px can send to do harm, and what the refusal
/// says.
#[allow(clippy::too_many_lines, reason = "a list")]
fn attacks() -> Vec<(Vec<u8>, &'static str)> {
    let bytes = |packet: Packet| packet.encode().unwrap();
    let record = |record: Record| bytes(parts_of(&record).unwrap().remove(0));
    let posed = |pose: Sim3| record(poses(vec![(0, pose)]));
    let scaled = |scale: f64| Sim3::new(scale, Rotation::identity(), Vec3::zeros());
    let (_, far) = pose(0, 1e300);
    let (_, nan) = pose(0, f64::NAN);
    let turned = Rotation::new_unchecked(Quaternion::new(3.0, 0.0, 0.0, 0.0));
    let image = |size: (u16, u16), jpeg: (usize, usize)| {
        let mut jpeg = encode_jpeg(&Image::from_fn(jpeg.0, jpeg.1, |_, _| 9), 50);
        jpeg.resize(4 << 20, 0);
        bytes(Packet::Keyframe(PackedKeyframe {
            id: 9,
            frame_index: 9,
            timestamp_ns: 9,
            camera: Some([1e3, 1e3, 10.0, 10.0]),
            size,
            jpeg,
            depth: PackedDepth::pack(&[], (80, 60)),
        }))
    };
    let part = |index: u32, count: u32| {
        let Packet::Record(part) = parts_of(&session()).unwrap().remove(0) else {
            panic!("expected a record");
        };
        bytes(Packet::Record(RecordPart {
            index,
            count,
            ..part
        }))
    };
    let frame = RecordedFrame {
        session: 0,
        frame_index: 0,
        timestamp_ns: i64::MIN,
        keyframe: 0,
        keyframe_from_frame: Se3::identity(),
    };
    let continuation = Continuation {
        frames: vec![frame],
        ..Continuation::default()
    };
    let long = EndRecord {
        summary: "x".repeat(100 << 20),
        ..EndRecord::default()
    };
    let Record::Session(sane) = session() else {
        panic!("expected a session");
    };
    let lens = SessionInfo {
        pinhole: Pinhole::new(f64::NAN, 1.0, 0.0, 0.0),
        ..sane
    };
    vec![
        (image((16_000, 16_000), (64, 64)), "16000x16000 px"),
        (image((8192, 8192), (64, 64)), "8192x8192 px"),
        (
            image((64, 64), (8192, 8192)),
            "no grey JPEG file of its size",
        ),
        (
            bytes(packed_of_other_size()),
            "not of the size of its camera",
        ),
        (vec![b'M'; MAX_PACKET_BYTES + 1], "at most"),
        (posed(far), "1e300"),
        (posed(nan), "none that this program knows"),
        (posed(scaled(1e-300)), "scale 1e-300"),
        (posed(scaled(-1.0)), "none that this program knows"),
        (
            posed(Sim3::new(1.0, turned, Vec3::zeros())),
            "none that this program knows",
        ),
        (
            record(poses(vec![pose(77, 0.0)])),
            "no keyframe that has come",
        ),
        (record(Record::Continuation(continuation)), "a time"),
        (record(Record::Keyframe(keyframe(8, 1))), "came as a record"),
        (record(Record::End(long)), "a record of 104857"),
        (record(Record::Session(lens)), "a camera"),
        (part(0, u32::MAX), "another number of parts"),
        (part(1, 2), "do not follow"),
    ]
}

/// A keyframe without a camera of its own.
fn packed_of_other_size() -> Packet {
    let image = Image::from_fn(640, 480, |x, _| x as u8);
    let record = KeyframeRecord {
        image: Some(image),
        pixels: Vec::new(),
        ..keyframe(7, 1)
    };
    Packet::Keyframe(PackedKeyframe::pack(&record, 75).unwrap())
}

#[test]
fn whatever_one_agent_sends_is_refused_and_named_and_another_one_is_served() {
    let folder = tempfile::tempdir().unwrap();
    let endpoint = endpoint();
    let serving = Serving::start(server_config(&endpoint, folder.path()));
    let (liar, honest) = (linked(&endpoint), linked(&endpoint));
    let mut attacker = Sender::new(&liar, "liar", 1);
    attacker.record(&session()).unwrap();
    for id in 0..3 {
        attacker.packet(&packed(id, 1)).unwrap();
    }
    let before = bytes_below(folder.path());
    let attacks = attacks();
    for (number, (bytes, why)) in attacks.iter().enumerate() {
        let begin = Instant::now();
        let refused = attacker.refused_bytes(bytes.clone());
        assert!(refused.contains(why), "{why}: {refused}");
        assert!(begin.elapsed() < Duration::from_secs(3), "{why}");
        if number == 0 {
            deliver(&honest, "honest", 2);
        }
    }
    let of_honest = bytes_below(&folder.path().join("agents/honest-0000000000000002"));
    // runs.txt has a line more
    assert!(bytes_below(folder.path()) <= before + of_honest + 100);
    // nothing of it stuck: the run goes on
    attacker.packet(&packed(3, 1)).unwrap();
    let (fleet, said) = serving.end();
    for (_, why) in &attacks {
        let named = |news: &&String| news.contains("liar/0000000000000001") && news.contains(why);
        assert!(said.iter().any(|news| named(&news)), "{why}: {said:?}");
    }
    let honest = fleet.agents.iter().find(|a| a.run.starts_with("honest"));
    assert!(honest.unwrap().has_ended);
}

#[test]
fn limits_are_kept_of_each_agent_and_of_all_and_after_a_restart() {
    let folder = tempfile::tempdir().unwrap();
    let endpoint = endpoint();
    let mut config = server_config(&endpoint, folder.path());
    config.until_ended = None;
    config.limits = Limits {
        runs: 8,
        keyframes: 16,
        disk_bytes: 800_000,
    };
    for _ in 0..2 {
        let serving = Serving::start(config.clone());
        let link = linked(&endpoint);
        let begin = |name: &str, run: u64| {
            let mut sender = Sender::new(&link, name, run);
            sender.next = link.deliver(&sender.run.key("missing"), None).unwrap().from;
            if sender.next > 0 {
                return Ok(sender);
            }
            sender.record(&session()).map(|()| sender)
        };
        let refused = |result: Result<Sender, LinkError>| match result.map(|_| ()) {
            Err(LinkError::Refused(why)) => why,
            other => panic!("{other:?}"),
        };
        // a quarter of the runs
        let mut honest = begin("honest", 1).unwrap();
        for run in 1..=2 {
            begin("many", run).unwrap();
        }
        let why = refused(begin("many", 3));
        assert!(why.contains("agent many") && why.contains("2") && why.contains("--max-runs"));
        for k in 0..5 {
            begin(&format!("name-{k}"), 1).unwrap();
        }
        let why = refused(begin("name-5", 1));
        assert!(
            why.contains("all agents") && why.contains("--max-runs"),
            "{why}"
        );
        // who is there already goes on: keyframes, of which the same again is none
        for id in honest.next.saturating_sub(1)..4 {
            honest.packet(&packed(id as u32, 1)).unwrap();
        }
        let why = honest.refused(&packed(4, 1));
        assert!(
            why.contains("agent honest") && why.contains("keyframes"),
            "{why}"
        );
        // bytes
        let mut filler = begin("name-0", 1).unwrap();
        let filled = (0..1000).find_map(|_| filler.packet(&packed(0, 1)).err());
        let Some(LinkError::Refused(why)) = filled else {
            panic!("{filled:?}");
        };
        assert!(
            why.contains("bytes on the disk") || why.contains("packets"),
            "{why}"
        );
        assert!(bytes_below(folder.path()) < 1_000_000);
        serving.end();
    }
}

#[test]
fn many_runs_and_few_file_handles_do_not_end_a_server() {
    let folder = tempfile::tempdir().unwrap();
    let endpoint = endpoint();
    let mut server = Command::new("bash")
        .args(["-c", "ulimit -n 100; exec \"$@\"", "bash", PROGRAM])
        .args([
            "server",
            "--listen",
            &endpoint,
            "--max-runs",
            "120",
            "--out",
        ])
        .arg(folder.path())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let begin = Instant::now();
    let link = loop {
        // it listens a moment before it answers
        let link = Link::open(std::slice::from_ref(&endpoint), None);
        if let Some(link) = link.ok().filter(|link| link.fleet().is_ok()) {
            break link;
        }
        assert!(begin.elapsed() < Duration::from_secs(30));
        thread::sleep(Duration::from_millis(100));
    };
    for run in 0..120 {
        let mut sender = Sender::new(&link, &format!("agent-{run}"), run);
        sender.record(&session()).unwrap();
    }
    let mut over = Sender::new(&link, "over", 0);
    let why = over.refused(&parts_of(&session()).unwrap()[0]);
    assert!(why.contains("120") && why.contains("--max-runs"), "{why}");
    assert_eq!(link.fleet().unwrap().agents.len(), 120);
    assert!(server.try_wait().unwrap().is_none());
    server.kill().unwrap();
    server.wait().unwrap();
}

#[test]
fn a_run_that_cannot_be_joined_is_set_apart_and_named() {
    let folder = tempfile::tempdir().unwrap();
    let endpoint = endpoint();
    let mut config = server_config(&endpoint, folder.path());
    config.until_ended = Some(4);
    let serving = Serving::start(config);
    let link = linked(&endpoint);
    // the same recording of two agents is an error of merge-runs; and what came first is nothing at
    // all
    Sender::new(&link, "empty", 9).record(&session()).unwrap();
    for (name, seed) in [("a", 1), ("b", 2), ("copy", 1), ("c", 3)] {
        deliver(&link, name, seed);
    }
    let (fleet, said) = serving.thread.join().unwrap();
    let apart = |run: &&str| {
        let agent = fleet.agents.iter().find(|agent| agent.run.starts_with(run));
        agent.unwrap().set_apart.is_some()
    };
    let set_apart: Vec<&str> = ["empty", "a/", "b/", "copy/", "c/"]
        .into_iter()
        .filter(apart)
        .collect();
    assert_eq!(set_apart, ["copy/"], "{said:?}");
    let named = |news: &String| news.contains("copy/0000000000000001 is set apart");
    assert!(said.iter().any(named), "{said:?}");
    // the others were joined, each in a map of its own
    for map in ["map", "map/apart_1", "map/apart_2"] {
        assert!(
            folder.path().join(map).join("recording.mgk").is_file(),
            "{map}: {said:?}"
        );
    }
    assert!(!folder.path().join("agents/trial").exists());
}

#[test]
fn when_no_maps_can_be_joined_at_all_no_run_is_blamed() {
    let folder = tempfile::tempdir().unwrap();
    let endpoint = endpoint();
    let mut config = server_config(&endpoint, folder.path());
    config.joining.program = vec!["false".into()];
    let serving = Serving::start(config);
    let link = linked(&endpoint);
    deliver(&link, "a", 1);
    deliver(&link, "b", 2);
    let (fleet, said) = serving.thread.join().unwrap();
    assert!(fleet.agents.iter().all(|agent| agent.set_apart.is_none()));
    assert!(
        said.iter().any(|news| news.contains("on this computer")),
        "{said:?}"
    );
}

#[test]
fn a_joining_that_never_ends_is_ended() {
    let folder = tempfile::tempdir().unwrap();
    let endpoint = endpoint();
    let mut config = server_config(&endpoint, folder.path());
    config.joining.program = ["bash", "-c", "sleep 1000"].map(Into::into).into();
    config.joining.within = Duration::from_millis(200);
    let serving = Serving::start(config);
    let link = linked(&endpoint);
    deliver(&link, "a", 1);
    deliver(&link, "b", 2);
    let (_, said) = serving.thread.join().unwrap();
    assert!(
        said.iter().any(|news| news.contains("--join-within")),
        "{said:?}"
    );
}

#[test]
fn a_run_of_an_earlier_server_that_cannot_be_gone_on_with_is_closed_and_the_server_starts() {
    let folder = tempfile::tempdir().unwrap();
    let endpoint = endpoint();
    let serving = Serving::start(server_config(&endpoint, folder.path()));
    let honest = linked(&endpoint);
    deliver(&honest, "a", 1);
    Sender::new(&honest, "b", 2).record(&session()).unwrap();
    Sender::new(&honest, "c", 3).record(&session()).unwrap();
    drop(honest);
    serving.end();
    // kept by a server that looked at nothing: a pose far away; and damage
    let file = |run: &str| folder.path().join(format!("agents/{run}/packets.mgf"));
    let far = parts_of(&poses(vec![pose(0, 1e300)])).unwrap();
    let mut packets = fs::read(file("b-0000000000000002")).unwrap();
    packets.extend(packed(0, 2).encode().unwrap());
    packets.extend(far[0].encode().unwrap());
    fs::write(file("b-0000000000000002"), packets).unwrap();
    fs::write(
        file("c-0000000000000003"),
        b"something else that is no packet",
    )
    .unwrap();

    let serving = Serving::start(server_config(&endpoint, folder.path()));
    let link = linked(&endpoint);
    for (name, run, next) in [("b", 2, 3), ("c", 3, 0)] {
        let mut sender = Sender::new(&link, name, run);
        sender.next = link.deliver(&sender.run.key("missing"), None).unwrap().from;
        assert_eq!(sender.next, next);
        let why = sender.refused(&packed(1, 2));
        assert!(why.contains("closed"), "{why}");
    }
    deliver(&link, "d", 4);
    let (fleet, said) = serving.end();
    let b = fleet
        .agents
        .iter()
        .find(|agent| agent.run.starts_with("b/"));
    assert!(b.unwrap().set_apart.as_ref().unwrap().contains("1e300"));
    for run in ["closed: b/", "closed: c/"] {
        assert!(said.iter().any(|news| news.contains(run)), "{said:?}");
    }
}

#[test]
fn nobody_but_the_server_says_how_the_fleet_is() {
    let folder = tempfile::tempdir().unwrap();
    let endpoint = endpoint();
    let mut config = server_config(&endpoint, folder.path());
    (config.until_ended, config.joining.every) = (None, Duration::ZERO);
    let serving = Serving::start(config);
    let (liar, honest) = (linked(&endpoint), linked(&endpoint));
    let forged = serde_json::to_string(&Fleet::default()).unwrap();
    liar.publish(&format!("{PREFIX}/fleet"), forged).unwrap();
    // what comes behind it has come
    deliver(&liar, "liar", 1);
    thread::sleep(Duration::from_millis(500));
    assert_eq!(honest.news(), None);
    // two runs: the server joins them and says so
    deliver(&honest, "honest", 2);
    let begin = Instant::now();
    let news = loop {
        if let Some(news) = honest.news() {
            break news;
        }
        assert!(begin.elapsed() < Duration::from_secs(120));
        thread::sleep(Duration::from_millis(50));
    };
    assert!(news.version > 0 && !news.agents.is_empty());
    serving.end();
}

#[test]
fn a_file_of_zenohs_settings_lets_in_only_who_knows_the_password() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str, text: &str| {
        let path = folder.path().join(name);
        fs::write(&path, text).unwrap();
        path
    };
    let users = at("users.txt", "drone:secret\n");
    let users = users.display();
    let server = format!(
        "// who may come\n{{ transport: {{ auth: {{ usrpwd: {{ user: 'server', password: 'x', \
         dictionary_file: '{users}' }} }} }} }}"
    );
    let known = "{ transport: { auth: { usrpwd: { user: 'drone', password: 'secret' } } } }";
    let endpoint = endpoint();
    let mut config = server_config(&endpoint, folder.path());
    config.zenoh_config = Some(at("server.json5", &server));
    let serving = Serving::start(config);
    let open = |file: Option<&Path>| Link::open(std::slice::from_ref(&endpoint), file);
    let stranger = at("stranger.json5", &known.replace("secret", "guess"));
    assert!(open(None).is_err());
    assert!(open(Some(&stranger)).is_err());
    let link = open(Some(&at("drone.json5", known))).unwrap();
    deliver(&link, "drone", 1);
    let (fleet, _) = serving.end();
    assert!(fleet.agents[0].has_ended);
}

/// An authority, and a certificate of this computer by it: files of the authority, the
/// certificate and its key.
fn certified(folder: &Path, name: &str) -> [PathBuf; 3] {
    let of = |names: &[&str]| {
        let names: Vec<String> = names.iter().map(|name| (*name).to_owned()).collect();
        CertificateParams::new(names).unwrap()
    };
    let mut authority = of(&[]);
    authority.is_ca = IsCa::Ca(BasicConstraints::Unconstrained);
    authority.key_usages = vec![KeyUsagePurpose::KeyCertSign];
    let authority = CertifiedIssuer::self_signed(authority, KeyPair::generate().unwrap()).unwrap();
    let key = KeyPair::generate().unwrap();
    let computer = of(&["localhost"]).signed_by(&key, &authority).unwrap();
    let texts = [authority.pem(), computer.pem(), key.serialize_pem()];
    let mut kinds = ["ca", "pem", "key"].into_iter();
    texts.map(|text| {
        let path = folder.join(format!("{name}.{}", kinds.next().unwrap()));
        fs::write(&path, text).unwrap();
        path
    })
}

/// Both ends show who they are: the server is believed by its certificate, and so is an agent.
#[test]
fn over_tls_a_wrong_certificate_is_refused_and_the_right_one_works() {
    let folder = tempfile::tempdir().unwrap();
    let [ours, theirs] = ["ours", "theirs"].map(|name| certified(folder.path(), name));
    let settings = |name: &str, tls: &str| {
        let path = folder.path().join(name);
        fs::write(
            &path,
            format!("{{ transport: {{ link: {{ tls: {{ {tls} }} }} }} }}"),
        )
        .unwrap();
        path
    };
    let [ca, pem, key] = ours.each_ref().map(|path| path.display());
    let server = settings(
        "server.json5",
        &format!(
            "listen_private_key: '{key}', listen_certificate: '{pem}', enable_mtls: true, \
             root_ca_certificate: '{ca}'"
        ),
    );
    let agent = |name: &str, believes: &Path, shows: &[PathBuf; 3]| {
        let [_, pem, key] = shows.each_ref().map(|path| path.display());
        let believes = believes.display();
        let tls = format!(
            "root_ca_certificate: '{believes}', enable_mtls: true, connect_private_key: '{key}', \
             connect_certificate: '{pem}'"
        );
        settings(name, &tls)
    };
    let endpoint = endpoint().replace("tcp/127.0.0.1", "tls/localhost");
    let mut config = server_config(&endpoint, folder.path());
    config.zenoh_config = Some(server);
    let metrics = loopback_port();
    config.metrics = Some(metrics);
    let serving = Serving::start(config);
    let open = |file: &Path| Link::open(std::slice::from_ref(&endpoint), Some(file));
    let is_let_in = |file: &Path| open(file).is_ok_and(|link| link.fleet().is_ok());
    // an agent that believes another authority than that of the server
    assert!(!is_let_in(&agent("believes.json5", &theirs[0], &ours)));
    // an agent that the server has no reason to believe
    assert!(!is_let_in(&agent("shows.json5", &ours[0], &theirs)));
    // one without TLS
    let plain = endpoint.replace("tls/localhost", "tcp/127.0.0.1");
    let plain = Link::open(&[plain], None);
    assert!(!plain.is_ok_and(|link| link.fleet().is_ok()));
    let link = open(&agent("right.json5", &ours[0], &ours)).unwrap();
    deliver(&link, "drone", 1);
    let begin = Instant::now();
    while !scraped(metrics).contains("\nmonogrid_fleet_runs_ended 1\n") {
        assert!(
            begin.elapsed() < Duration::from_secs(30),
            "{}",
            scraped(metrics)
        );
        thread::sleep(Duration::from_millis(100));
    }
    assert!(answered(metrics, "/health").starts_with("HTTP/1.1 200 OK"));
    assert!(answered(metrics, "/").starts_with("HTTP/1.1 404 "));
    let (fleet, _) = serving.end();
    assert!(fleet.agents.len() == 1 && fleet.agents[0].has_ended);
}

/// An address of this computer at which nobody listens yet.
fn loopback_port() -> SocketAddr {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    listener.local_addr().unwrap()
}

/// The answer to a question.
fn answered(address: SocketAddr, path: &str) -> String {
    let mut stream = TcpStream::connect(address).unwrap();
    write!(stream, "GET {path} HTTP/1.1\r\nHost: fleet\r\n\r\n").unwrap();
    let mut answer = String::new();
    stream.read_to_string(&mut answer).unwrap();
    answer
}

/// What Prometheus reads.
fn scraped(address: SocketAddr) -> String {
    let answer = answered(address, "/metrics");
    assert!(answer.starts_with("HTTP/1.1 200 OK"), "{answer}");
    answer
}

#[test]
fn a_thread_that_dies_ends_a_server_with_code_1_and_a_sentence() {
    for which in ["beside", "itself"] {
        let folder = tempfile::tempdir().unwrap();
        let died = Command::new(PROGRAM)
            .args(["server", "--listen", &endpoint(), "--out"])
            .arg(folder.path())
            .env("MONOGRID_FLEET_DIES", which)
            .output()
            .unwrap();
        assert_eq!(died.status.code(), Some(1));
        let said = String::from_utf8_lossy(&died.stderr);
        let sentence = said
            .lines()
            .find(|line| line.starts_with("error: the thread"));
        assert!(
            sentence.is_some() && said.contains("start the server again"),
            "{said}"
        );
    }
}

#[test]
fn names_are_shown_and_never_obeyed() {
    let name = "\x1b[2J\u{9b}31m\u{202e}gnp";
    let option = format!("--{name}");
    for words in [
        &[
            "agent",
            "--name",
            name,
            "--follow",
            "none.mgk",
            "--connect",
            "tcp/127.0.0.1:1",
        ][..],
        &["server", "--out", "/dev/null", "--zenoh-config", name],
        &["agent", &option],
    ] {
        let ended = Command::new(PROGRAM).args(words).output().unwrap();
        let said = String::from_utf8_lossy(&ended.stderr);
        assert!(!said.contains(|c| c != '\n' && is_obeyed(c)), "{said:?}");
        assert!(said.contains("202e") && said.contains("gnp"), "{said}");
    }
}
