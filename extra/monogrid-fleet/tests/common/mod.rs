//! What tests of a server have in common.

use monogrid_datasets::{Record, Scale, SessionInfo};
use monogrid_fleet::agent::Link;
use monogrid_fleet::server::{JoiningConfig, Limits, ServerConfig};
use monogrid_geometry::Pinhole;
use std::net::TcpListener;
use std::path::Path;
use std::time::Duration;

pub const PROGRAM: &str = env!("CARGO_BIN_EXE_monogrid-fleet");

/// An endpoint at which nobody listens yet.
pub fn endpoint() -> String {
    let port = TcpListener::bind("127.0.0.1:0")
        .unwrap()
        .local_addr()
        .unwrap()
        .port();
    format!("tcp/127.0.0.1:{port}")
}

/// A session with the server at an endpoint.
pub fn linked(endpoint: &str) -> Link {
    Link::open(&[endpoint.to_owned()], None).unwrap()
}

pub fn server_config(endpoint: &str, out: &Path) -> ServerConfig {
    ServerConfig {
        listen: vec![endpoint.into()],
        zenoh_config: None,
        metrics: None,
        limits: Limits::default(),
        out: out.into(),
        joining: JoiningConfig {
            every: Duration::from_secs(1000),
            within: Duration::from_secs(300),
            min_new_keyframes: 1,
            program: vec![PROGRAM.into(), "monogrid".into()],
            arguments: vec!["--resolution".into(), "0.1".into()],
        },
        until_ended: Some(2),
    }
}

/// What holds for a run with images of 80x60 px.
pub fn session() -> Record {
    Record::Session(SessionInfo {
        pinhole: Pinhole::new(60.0, 60.0, 39.5, 29.5),
        width: 80,
        height: 60,
        scale: Scale::Arbitrary,
        seed: 1,
        profile: String::new(),
        source: "camera".into(),
        config: String::new(),
    })
}
