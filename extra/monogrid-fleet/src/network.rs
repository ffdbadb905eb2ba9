//! Zenoh's settings: ours, and those of a file of the user's, which come first.

use crate::messages::PREFIX;
use serde_json::{Value, json};
use std::path::{Path, PathBuf};

/// Where a server listens that was not told otherwise: nobody but this computer reaches it.
pub const LOOPBACK: &str = "tcp/127.0.0.1:7447";
/// Bytes of a file of settings at most.
const MAX_FILE_BYTES: u64 = 1 << 20;
/// Bytes of a message at most: a packet, which is refused in words where it is somewhat too large,
/// and what Zenoh puts around it. Parts of what is larger are dropped as they come.
const MAX_MESSAGE_BYTES: usize = 2 * crate::packet::MAX_PACKET_BYTES;
/// Connections at most: each is a file handle, and can hold a message in parts.
const MAX_CONNECTIONS: u64 = 128;
/// Time after which a connection is closed whose other end does not read its answers, microseconds.
const UNREAD_CLOSES_US: u64 = 1_000_000;

/// Why there are no settings.
#[derive(Debug, thiserror::Error)]
pub enum NetworkError {
    /// The file cannot be read.
    #[error("{path}: {error}")]
    File {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        error: std::io::Error,
    },
    /// The file does not hold settings.
    #[error("{path}: {error}; expected settings of Zenoh as JSON5")]
    Content {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        error: String,
    },
    /// There is no server.
    #[error(
        "found no server: expected --connect, or connect/endpoints in the file of --zenoh-config"
    )]
    NoServer,
    /// Zenoh does not take a setting.
    #[error("Zenoh does not take {key}: {error}")]
    Setting {
        /// The setting.
        key: &'static str,
        /// What it says.
        error: String,
    },
}

/// Settings of Zenoh as they become.
struct Settings {
    config: zenoh::Config,
    /// What the file names.
    named: Value,
}

impl Settings {
    /// Those of a file, or none.
    fn read(file: Option<&Path>) -> Result<Self, NetworkError> {
        let Some(path) = file else {
            let (config, named) = (zenoh::Config::default(), Value::Null);
            return Ok(Self { config, named });
        };
        let content = |error: String| NetworkError::Content {
            path: path.to_owned(),
            error,
        };
        let text = read_text(path).map_err(|error| NetworkError::File {
            path: path.to_owned(),
            error,
        })?;
        let named: Value = json5::from_str(&text).map_err(|error| content(error.to_string()))?;
        if !named.is_object() {
            return Err(content("found no object".to_owned()));
        }
        let config = zenoh::Config::from_json5(&text);
        let config = config.map_err(|error| content(error.to_string()))?;
        Ok(Self { config, named })
    }

    fn names(&self, key: &str) -> bool {
        let found = self.named.pointer(&format!("/{key}"));
        found.is_some_and(|value| !value.is_null())
    }

    fn set(&mut self, key: &'static str, value: &Value) -> Result<(), NetworkError> {
        let set = self.config.insert_json5(key, &value.to_string());
        set.map_err(|error| NetworkError::Setting {
            key,
            error: error.to_string(),
        })
    }

    /// Sets what the file does not name.
    fn set_unnamed(&mut self, key: &'static str, value: &Value) -> Result<(), NetworkError> {
        match self.names(key) {
            true => Ok(()),
            false => self.set(key, value),
        }
    }

    /// Finds nobody by itself.
    fn set_alone(&mut self) -> Result<(), NetworkError> {
        self.set_unnamed("scouting/multicast/enabled", &json!(false))?;
        self.set_unnamed("scouting/gossip/enabled", &json!(false))
    }
}

fn read_text(path: &Path) -> std::io::Result<String> {
    use std::io::Read;
    let mut text = String::new();
    let file = std::fs::File::open(path)?.take(MAX_FILE_BYTES + 1);
    std::io::BufReader::new(file).read_to_string(&mut text)?;
    if text.len() as u64 > MAX_FILE_BYTES {
        return Err(std::io::Error::other(format!(
            "found more than {MAX_FILE_BYTES} bytes"
        )));
    }
    Ok(text)
}

/// Settings of an agent: those of `file`, and `connect`, endpoints of a server, where there are
/// any.
///
/// # Errors
/// When the file holds no settings, or nobody names a server.
pub fn of_agent(connect: &[String], file: Option<&Path>) -> Result<zenoh::Config, NetworkError> {
    let mut settings = Settings::read(file)?;
    settings.set_alone()?;
    settings.set_unnamed("mode", &json!("client"))?;
    settings.set_unnamed("listen/endpoints", &json!([]))?;
    if !connect.is_empty() {
        settings.set("connect/endpoints", &json!(connect))?;
    } else if !settings.names("connect/endpoints") {
        return Err(NetworkError::NoServer);
    }
    Ok(settings.config)
}

/// Settings of a server: those of `file`, and `listen`, endpoints, where there are any; without
/// both it listens at [`LOOPBACK`].
///
/// # Errors
/// When the file holds no settings.
pub fn of_server(listen: &[String], file: Option<&Path>) -> Result<zenoh::Config, NetworkError> {
    let mut settings = Settings::read(file)?;
    settings.set_alone()?;
    settings.set_unnamed("mode", &json!("router"))?;
    if listen.is_empty() {
        settings.set_unnamed("listen/endpoints", &json!([LOOPBACK]))?;
    } else {
        settings.set("listen/endpoints", &json!(listen))?;
    }
    let limits = [
        (
            "transport/link/rx/max_message_size",
            json!(MAX_MESSAGE_BYTES),
        ),
        ("transport/unicast/max_sessions", json!(connections())),
        ("transport/unicast/accept_pending", json!(16)),
        // each priority gathers messages of its own
        ("transport/unicast/qos/enabled", json!(false)),
        (
            "transport/link/tx/queue/congestion_control/block/wait_before_close",
            json!(UNREAD_CLOSES_US),
        ),
        ("access_control", rights()),
    ];
    for (key, value) in &limits {
        settings.set_unnamed(key, value)?;
    }
    Ok(settings.config)
}

/// Connections that a server takes: half of the file handles that this process may have, as others
/// need some.
#[must_use]
pub fn connections() -> u64 {
    #[cfg(unix)]
    let handles = rustix::process::getrlimit(rustix::process::Resource::Nofile).current;
    #[cfg(not(unix))]
    let handles = None;
    handles.map_or(MAX_CONNECTIONS, |handles| MAX_CONNECTIONS.min(handles / 2))
}

/// What others may do: ask the server, publish poses, and listen. Nobody but the server publishes
/// the state of the fleet or answers questions.
fn rights() -> Value {
    let (all, poses) = (format!("{PREFIX}/**"), format!("{PREFIX}/agents/*/*/pose"));
    let rule = |id: &str, messages: &[&str], flow: &str, key: &str| {
        json!({
            "id": id, "messages": messages, "flows": [flow], "permission": "allow",
            "key_exprs": [key],
        })
    };
    let rules = [
        rule("ask", &["query", "declare_subscriber"], "ingress", &all),
        rule("pose", &["put"], "ingress", &poses),
        rule(
            "tell",
            &["put", "reply", "declare_queryable", "declare_subscriber"],
            "egress",
            &all,
        ),
    ];
    let names = ["ask", "pose", "tell"];
    json!({
        "enabled": true,
        "default_permission": "deny",
        "rules": rules,
        "subjects": [{ "id": "anyone" }],
        "policies": [{ "rules": names, "subjects": ["anyone"] }],
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn file(text: &str) -> tempfile::NamedTempFile {
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), text).unwrap();
        file
    }

    fn get(config: &zenoh::Config, key: &str) -> Value {
        serde_json::from_str(&config.get_json(key).unwrap()).unwrap()
    }

    #[test]
    fn a_server_listens_at_loopback_unless_it_is_told_otherwise() {
        let endpoints = |listen: &[String], file: Option<&Path>| {
            let config = of_server(listen, file).unwrap();
            get(&config, "listen/endpoints").to_string()
        };
        let of_file = file("{ listen: { endpoints: ['tls/[::]:7000'] }, }");
        let told = ["tcp/[::]:1".to_owned()];
        assert!(endpoints(&[], None).contains(LOOPBACK));
        assert!(endpoints(&[], Some(of_file.path())).contains("tls/[::]:7000"));
        assert!(endpoints(&told, None).contains("tcp/[::]:1"));
        let both = endpoints(&told, Some(of_file.path()));
        assert!(
            both.contains("tcp/[::]:1") && !both.contains("tls"),
            "{both}"
        );
    }

    #[test]
    fn what_the_file_names_stays_and_the_rest_is_ours() {
        let ours = of_server(&[], None).unwrap();
        assert_eq!(get(&ours, "scouting/multicast/enabled"), json!(false));
        assert_eq!(get(&ours, "access_control/default_permission"), "deny");
        let largest = get(&ours, "transport/link/rx/max_message_size");
        assert_eq!(largest, json!(MAX_MESSAGE_BYTES));
        let named = file(
            "// users\n{ access_control: { enabled: false },
               scouting: { multicast: { enabled: true } },
               transport: { auth: { usrpwd: { dictionary_file: '/x' } } } }",
        );
        let config = of_server(&[], Some(named.path())).unwrap();
        assert_eq!(get(&config, "access_control/enabled"), json!(false));
        assert_eq!(get(&config, "scouting/multicast/enabled"), json!(true));
        assert_eq!(get(&config, "scouting/gossip/enabled"), json!(false));
        assert_eq!(get(&config, "transport/auth/usrpwd/dictionary_file"), "/x");
        assert_eq!(
            get(&config, "transport/link/rx/max_message_size"),
            json!(MAX_MESSAGE_BYTES)
        );
    }

    #[test]
    fn an_agent_needs_a_server_and_a_file_that_is_none_is_named() {
        assert!(matches!(of_agent(&[], None), Err(NetworkError::NoServer)));
        let named = file("{ connect: { endpoints: ['tls/host:1'] } }");
        let config = of_agent(&[], Some(named.path())).unwrap();
        assert!(
            get(&config, "connect/endpoints")
                .to_string()
                .contains("tls/host:1")
        );
        let told = of_agent(&["tcp/a:1".to_owned()], Some(named.path())).unwrap();
        assert!(!get(&told, "connect/endpoints").to_string().contains("tls"));
        for bad in ["{ mode: ", "{ mode: 'boss' }", "[]"] {
            let bad = file(bad);
            let error = of_server(&[], Some(bad.path())).err().unwrap();
            let path = bad.path().display().to_string();
            assert!(error.to_string().starts_with(&path), "{error}");
        }
        let gone = of_server(&[], Some(Path::new("/nowhere.json5")));
        assert!(matches!(gone, Err(NetworkError::File { .. })));
    }
}
