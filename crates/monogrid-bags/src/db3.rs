//! rosbag2 in SQLite files: a table of topics (id, name, type, ...) and one of messages (id, topic, time, data).

use crate::bag::{Messages, TopicKind};
use crate::error::BagError;
use crate::message::{Raw, Wire};
use crate::sqlite::{Database, Row, Value};
use std::collections::HashMap;
use std::fs::File;
use std::path::Path;
use std::sync::Arc;

/// Name and kind of each topic by its number; only ever asked by number.
type Topics = HashMap<i64, (Arc<str>, TopicKind)>;

/// The messages of a file.
pub fn messages(path: &Path) -> Result<Messages, BagError> {
    let mut log = path.as_os_str().to_owned();
    log.push("-wal");
    if std::fs::metadata(&log).is_ok_and(|log| log.len() > 0) {
        let reason = "it was not closed: messages are still in the -wal file beside it; open and close it once with sqlite3, or \
                      with ros2 bag reindex";
        return Err(BagError::damaged(path, reason));
    }
    let open = || {
        let file = File::open(path).map_err(BagError::io(path))?;
        Database::open(file).map_err(|reason| BagError::damaged(path, reason))
    };
    let damaged = |reason| BagError::damaged(path, reason);
    let mut topics = Topics::new();
    for row in open()?.table("topics").map_err(damaged)? {
        let (number, values) = row.map_err(damaged)?;
        if let [_, Value::Text(name), Value::Text(kind), ..] = values.as_slice() {
            topics.insert(number, (name.as_str().into(), TopicKind::of(kind)));
        }
    }
    let rows = open()?.table("messages").map_err(damaged)?;
    let path = path.to_owned();
    Ok(Box::new(rows.map(move |row| {
        let message = row.and_then(|row| message(row, &topics));
        message.map_err(|reason| BagError::damaged(&path, reason))
    })))
}

fn message((number, values): Row, topics: &Topics) -> Result<Raw, String> {
    let [
        _,
        Value::Integer(topic),
        Value::Integer(log_ns),
        Value::Blob(data),
        ..,
    ] = &values[..]
    else {
        return Err(format!(
            "message {number} is not a number, a topic, a time and bytes"
        ));
    };
    let found = topics.get(topic);
    let (topic, kind) = found.ok_or_else(|| format!("message {number} has no topic"))?;
    Ok(Raw::new(topic, *kind, *log_ns, Wire::Cdr, data))
}
