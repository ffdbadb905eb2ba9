//! The node: topics, and how reliable they are.

use anyhow::Context as _;
use futures::StreamExt;
use futures::channel::oneshot;
use futures::future::{self, join_all};
use monogrid_messages::RosMessage;
use monogrid_messages::std_srvs::{TriggerRequest, TriggerResponse};
use ros2_client::dds::rustdds::{
    DomainParticipant, DomainParticipantBuilder, GUID, QosPolicies, QosPolicyBuilder, Topic,
    TopicDescription, TopicKind, policy,
};
use ros2_client::qos::{Durability, History, WhenFull};
use ros2_client::{
    Context, Message, MessageTypeName, Name, Node, NodeName, NodeOptions, Publisher, QosProfile,
    RmwRequestId, Server, ServiceMapping, ServiceTypeName, Subscription,
};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use std::future::Future;
use std::net::Ipv4Addr;
use std::pin::pin;
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::{Builder, sleep};
use std::time::{Duration, Instant};

/// Connects to the other nodes of the ROS domain (`ROS_DOMAIN_ID`); to those of this computer only
/// where `ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST` or `ROS_LOCALHOST_ONLY=1`.
///
/// # Errors
/// A domain that is no number, or a network that cannot be used.
pub fn connect() -> anyhow::Result<Context> {
    let variable = |name: &str| std::env::var(name).ok().filter(|value| !value.is_empty());
    let domain = match variable("ROS_DOMAIN_ID") {
        None => 0,
        Some(text) => {
            let domain = text.parse::<u16>().ok().filter(|domain| *domain <= 232);
            domain.with_context(|| format!("ROS_DOMAIN_ID is {text:?}, expected 0 to 232"))?
        }
    };
    let is_local = variable("ROS_AUTOMATIC_DISCOVERY_RANGE").as_deref() == Some("LOCALHOST")
        || variable("ROS_LOCALHOST_ONLY").as_deref() == Some("1");
    connect_to(domain, is_local)
}

/// Connects to the other nodes of a domain, or to those of this computer only.
///
/// # Errors
/// A network that cannot be used.
pub fn connect_to(domain: u16, is_local: bool) -> anyhow::Result<Context> {
    let mut participant = DomainParticipantBuilder::new(domain);
    if is_local {
        participant = participant.with_only_networks([Ipv4Addr::LOCALHOST]);
    }
    let participant = participant.build()?;
    Ok(Context::from_domain_participant(participant)?)
}

fn not_a_name(topic: &str) -> String {
    format!("{topic:?} is no name of a topic")
}

/// How a topic is sent or received.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Quality {
    /// The newest, late or never: images, as cameras send them.
    Sensor,
    /// The last second of them, late or never: readings of an inertial sensor.
    Readings,
    /// All of them, to those who listen now; what cannot be sent at once is not sent.
    Stream,
    /// All of them, one after the other, to those who listen now: parts of something large. The
    /// next one waits a moment for everybody to have the last one, and is not sent when that is too
    /// long.
    Parts,
    /// The newest of a clock, late or never.
    Clock,
    /// What is said, also to those who come a little later, as every node of ROS says it.
    Log,
    /// The last one, also to those who come later: maps, as nav2 and RViz want them. While somebody
    /// has not got it yet, no other can be sent.
    Latched,
}

impl Quality {
    /// The profile of the middleware.
    #[must_use]
    pub fn profile(self) -> QosProfile {
        match self {
            Self::Sensor => QosProfile::subscription_default().history(last(5)),
            Self::Readings => QosProfile::subscription_default().history(last(400)),
            Self::Stream => QosProfile::publisher_default()
                .reliability_reliable(WhenFull::Fail)
                .history(last(100)),
            Self::Parts => QosProfile::publisher_default()
                .reliability_reliable(WhenFull::Wait(PATIENCE))
                .history(last(10)),
            Self::Clock => QosProfile::subscription_default().history(last(1)),
            Self::Log => QosProfile::publisher_default()
                .reliability_reliable(WhenFull::Fail)
                .durability(Durability::TransientLocal)
                .history(last(1000)),
            Self::Latched => QosProfile::publisher_default()
                .reliability_reliable(WhenFull::Fail)
                .durability(Durability::TransientLocal)
                .history(last(1)),
        }
    }

    /// The policies of the middleware. Of what may be large one message is on its way: without this
    /// limit all are kept until everybody has them, and without a listener for ever.
    fn policies(self) -> QosPolicies {
        let policies = QosPolicies::from(self.profile());
        let limits = QosPolicyBuilder::new();
        let limits = match self {
            Self::Parts | Self::Latched => limits.resource_limits(policy::ResourceLimits {
                max_samples: 1,
                max_instances: 1,
                max_samples_per_instance: 1,
            }),
            Self::Log => limits.lifespan(policy::Lifespan {
                duration: LOG_LIFE.into(),
            }),
            _ => return policies,
        };
        policies.modify_by(&limits.build())
    }
}

/// How long those who come later get what was said.
const LOG_LIFE: Duration = Duration::from_secs(10);
/// How long a part waits for the one before.
const PATIENCE: Duration = Duration::from_millis(100);

fn last(depth: usize) -> History {
    History::KeepLast { depth }
}

/// A node, and the namespace of its topics.
pub struct RosNode {
    /// The node itself.
    pub node: Node,
    full_name: NodeName,
    participant: DomainParticipant,
    /// Other names for topics and services, from the root.
    remaps: Vec<(String, String)>,
}

/// Where messages go out.
pub struct Outlet<M: RosMessage> {
    publisher: Publisher<M>,
    topic: String,
    participant: DomainParticipant,
}

impl<M: RosMessage> Outlet<M> {
    /// Whether somebody listens.
    #[must_use]
    pub fn is_heard(&self) -> bool {
        let readers = self.participant.discovered_readers();
        let mut topics = readers
            .iter()
            .map(|r| r.subscription_topic_data.topic_name());
        topics.any(|topic| *topic == self.topic)
    }

    /// Sends a message; `false` where it could not be sent.
    #[must_use]
    pub fn publish(&self, message: M) -> bool {
        self.publisher.publish(message).is_ok()
    }
}

impl RosNode {
    /// A node with these options.
    ///
    /// # Errors
    /// A name that is none.
    pub fn new(
        context: &Context,
        namespace: &str,
        name: &str,
        options: NodeOptions,
    ) -> anyhow::Result<Self> {
        let node_name = NodeName::new(namespace, name)
            .with_context(|| format!("{namespace} {name} is no name of a node"))?;
        Ok(Self {
            node: context.new_node(node_name.clone(), options)?,
            full_name: node_name,
            participant: context.domain_participant(),
            remaps: Vec::new(),
        })
    }

    /// Topics and services that are made from now on have other names.
    ///
    /// # Errors
    /// A name that is none.
    pub fn remap(&mut self, rules: &[(String, String)]) -> anyhow::Result<()> {
        for (from, to) in rules {
            Name::parse(&self.absolute(to)).with_context(|| not_a_name(to))?;
            self.remaps.push((self.absolute(from), self.absolute(to)));
        }
        Ok(())
    }

    /// A name from the root.
    fn absolute(&self, name: &str) -> String {
        if name.starts_with('/') {
            return name.to_owned();
        }
        format!(
            "{}/{name}",
            self.full_name.namespace().trim_end_matches('/')
        )
    }

    /// A topic or service by its name, from the root or in the node's namespace.
    fn name_of(&self, topic: &str) -> anyhow::Result<Name> {
        let absolute = self.absolute(topic);
        let rule = self.remaps.iter().find(|(from, _)| *from == absolute);
        let name = Name::parse(rule.map_or(&absolute, |(_, to)| to));
        name.with_context(|| not_a_name(topic))
    }

    /// A topic with messages of this type.
    fn topic<M: RosMessage>(&self, topic: &str, quality: Quality) -> anyhow::Result<Topic> {
        let type_name = MessageTypeName::new(M::PACKAGE, M::NAME);
        let name = self.name_of(topic)?.to_dds_name("rt", &self.full_name, "");
        let (type_name, policies) = (type_name.dds_msg_type(), quality.policies());
        let participant = &self.participant;
        Ok(participant.create_topic(name, type_name, &policies, TopicKind::NoKey)?)
    }

    /// Begins to publish.
    ///
    /// # Errors
    /// A name that is none, or a network that cannot be used.
    pub fn publisher<M: RosMessage>(
        &mut self,
        topic: &str,
        quality: Quality,
    ) -> anyhow::Result<Outlet<M>> {
        let topic = self.topic::<M>(topic, quality)?;
        Ok(Outlet {
            publisher: self.node.create_publisher(&topic, None)?,
            topic: topic.name(),
            participant: self.participant.clone(),
        })
    }

    /// Begins to receive.
    ///
    /// # Errors
    /// A name that is none, or a network that cannot be used.
    pub fn subscription<M: RosMessage + 'static>(
        &mut self,
        topic: &str,
        quality: Quality,
    ) -> anyhow::Result<Subscription<M>> {
        let topic = self.topic::<M>(topic, quality)?;
        Ok(self.node.create_subscription(&topic, None)?)
    }

    /// Offers a service below the name of the node, to clients of all middlewares.
    ///
    /// # Errors
    /// A name that is none, or a network that cannot be used.
    pub fn service<Request: Message + Clone + 'static, Response: Message + 'static>(
        &mut self,
        service: &str,
        type_name: &ServiceTypeName,
    ) -> anyhow::Result<Service<Request, Response>> {
        let profile = QosProfile::publisher_default().history(last(10));
        let name = self.name_of(&format!("{}/{service}", self.full_name.base_name()))?;
        let mut server = |mapping| {
            let (request, response) = (profile.clone(), profile.clone());
            let node = &mut self.node;
            node.create_server(mapping, &name, type_name, request, response)
        };
        Ok(Service {
            enhanced: server(ServiceMapping::Enhanced)?,
            cyclone: server(ServiceMapping::Cyclone)?,
            readers: ReplyReaders {
                participant: self.participant.clone(),
                topic: name.to_dds_name("rr", &self.full_name, "Reply"),
                met: Arc::default(),
            },
        })
    }
}

/// A service. CycloneDDS writes into a message what others write beside it, so there are two
/// servers, and each client is answered as it asked.
pub struct Service<Request: Message, Response: Message> {
    enhanced: Server<Request, Response>,
    cyclone: Server<Request, Response>,
    readers: ReplyReaders,
}

impl<Request: Message + 'static, Response: Message + 'static> Service<Request, Response> {
    /// Answers what is asked, one after the other; does not end.
    pub async fn answer<F>(&self, reply: impl Fn(Request) -> F)
    where
        F: Future<Output = Response>,
    {
        let servers = [(&self.enhanced, false), (&self.cyclone, true)];
        let answers = servers.map(|(server, is_cyclone)| {
            let reply = &reply;
            async move {
                let mut requests = pin!(server.receive_request_stream());
                while let Some(request) = requests.next().await {
                    // what the other server understands may be an error here
                    if let Ok((id, request)) = request
                        && is_of_cyclone(&id) == is_cyclone
                    {
                        let known = self.readers.until_known(&id);
                        let (response, ()) = future::join(reply(request), known).await;
                        // whoever has gone away needs no answer
                        let _ = server.async_send_response(id, response).await;
                    }
                }
            }
        });
        join_all(answers).await;
    }
}

/// Time for which an answer waits for its reader to be known.
const KNOWN_WITHIN: Duration = Duration::from_secs(1);
/// Time between looks whether it is.
const LOOK_EVERY: Duration = Duration::from_millis(2);
/// Time that both middlewares may then take to take each other up. CycloneDDS drops what comes
/// before the first heartbeat that it has asked for, which it does after 10 ms.
const TAKING_UP: Duration = Duration::from_millis(100);
/// Readers that are remembered of a service.
const MOST_MET: usize = 256;
/// Bytes of an identifier that are the same for what a process asks with and reads with, in every
/// form of a request.
const SHARED_BYTES: usize = 8;

/// Those who read the answers of a service.
#[derive(Clone)]
struct ReplyReaders {
    participant: DomainParticipant,
    topic: String,
    /// Those to whom an answer was sent already, the latest last.
    met: Arc<Mutex<Vec<GUID>>>,
}

impl ReplyReaders {
    /// Waits until the reader of whoever asked is known, or for too long. A request may come before
    /// it is, and an answer that is sent then never comes to it.
    async fn until_known(&self, id: &RmwRequestId) {
        let (known, is_known) = oneshot::channel();
        let (readers, asker) = (self.clone(), id.writer_gid.to_bytes16());
        let wait = move || {
            readers.wait(&asker[..SHARED_BYTES]);
            // the node may be ending
            let _ = known.send(());
        };
        if Builder::new().name("answer".to_owned()).spawn(wait).is_ok() {
            // it always says so
            let _ = is_known.await;
        }
    }

    fn wait(&self, process: &[u8]) {
        let begin = Instant::now();
        let mut known = self.of(process);
        while known.is_empty() && begin.elapsed() < KNOWN_WITHIN {
            sleep(LOOK_EVERY);
            known = self.of(process);
        }
        let met = || self.met.lock().unwrap_or_else(PoisonError::into_inner);
        known.retain(|reader| !met().contains(reader));
        if !known.is_empty() {
            sleep(TAKING_UP);
            let mut met = met();
            met.extend(known);
            let old = met.len().saturating_sub(MOST_MET);
            met.drain(..old);
        }
    }

    /// Those of a process.
    fn of(&self, process: &[u8]) -> Vec<GUID> {
        let readers = self.participant.discovered_readers();
        let of_topic = readers
            .iter()
            .filter(|reader| *reader.subscription_topic_data.topic_name() == self.topic);
        of_topic
            .map(|reader| reader.reader_proxy.remote_reader_guid)
            .filter(|reader| reader.to_bytes().starts_with(process))
            .collect()
    }
}

/// Whether CycloneDDS asked: the identifier of a client begins with that of its vendor.
fn is_of_cyclone(id: &RmwRequestId) -> bool {
    id.writer_gid.to_bytes16().starts_with(&[0x01, 0x10])
}

/// A service of `std_srvs/srv/Trigger`.
pub type Trigger = Service<Wire<TriggerRequest>, Wire<TriggerResponse>>;

/// A message of this project as the middleware wants it.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Wire<T>(pub T);

impl<T: Serialize + DeserializeOwned> Message for Wire<T> {}

#[cfg(test)]
mod tests {
    use super::*;
    use ros2_client::qos::Reliability;

    #[test]
    fn qualities_are_those_that_nav2_and_rviz_ask_for() {
        for quality in [Quality::Sensor, Quality::Readings] {
            let sensor = quality.profile();
            assert_eq!(sensor.reliability, Reliability::BestEffort);
            assert_eq!(sensor.durability, Durability::Volatile);
        }
        let latched = Quality::Latched.profile();
        assert_eq!(latched.durability, Durability::TransientLocal);
        assert_eq!(latched.history, History::KeepLast { depth: 1 });
        for quality in [Quality::Latched, Quality::Stream] {
            let reliability = quality.profile().reliability;
            assert!(matches!(reliability, Reliability::Reliable { .. }));
        }
        assert_eq!(Quality::Stream.profile().durability, Durability::Volatile);
    }
}
