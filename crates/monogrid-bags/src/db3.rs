//! rosbag2 in SQLite files: a table of topics (id, name, type, ...) and one of messages (id, topic,
//! time, data).

use crate::error::BagError;
use crate::message::{Messages, Raw, Wire};
use crate::part::Part;
use crate::sqlite::{Database, Row, Value};
use crate::topic::{Indexed, Topic};
use std::collections::HashMap;
use std::sync::Arc;

/// Each topic by its number; only ever asked by number.
type Topics = HashMap<i64, Arc<Topic>>;

fn database(part: &Part) -> Result<Database, BagError> {
    let mut log = part.path.as_os_str().to_owned();
    log.push("-wal");
    if std::fs::metadata(&log).is_ok_and(|log| log.len() > 0) {
        let reason = "it was not closed: messages are still in the -wal file beside it; open and \
            close it once with sqlite3, or with ros2 bag reindex";
        return Err(BagError::damaged(&part.path, reason));
    }
    Database::open(part.open()?).map_err(|reason| BagError::damaged(&part.path, reason))
}

fn read_topics(part: &Part) -> Result<Topics, BagError> {
    let damaged = |reason| BagError::damaged(&part.path, reason);
    let mut topics = Topics::new();
    for row in database(part)?.table("topics").map_err(damaged)? {
        let (number, values) = row.map_err(damaged)?;
        if let [_, Value::Text(name), Value::Text(kind), ..] = values.as_slice() {
            topics.insert(number, Arc::new(Topic::new(name, kind)));
        }
    }
    Ok(topics)
}

/// The topics of a file; nothing says how many messages they have.
pub fn topics(part: &Part) -> Result<Vec<Indexed>, BagError> {
    let topics = read_topics(part)?.into_values();
    Ok(topics
        .map(|topic| Indexed {
            topic: Topic::clone(&topic),
            messages: None,
        })
        .collect())
}

/// The messages of a file.
pub fn messages(part: &Part) -> Result<Messages, BagError> {
    let topics = read_topics(part)?;
    let damaged = |reason| BagError::damaged(&part.path, reason);
    let rows = database(part)?.table("messages").map_err(damaged)?;
    let path = part.path.clone();
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
    let topic = found.ok_or_else(|| format!("message {number} has no topic"))?;
    Ok(Raw::new(topic, *log_ns, Some(Wire::Cdr), data))
}
