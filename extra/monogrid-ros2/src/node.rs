//! The node: topics, and how reliable they are.

use anyhow::Context as _;
use monogrid_messages::RosMessage;
use monogrid_messages::std_srvs::{TriggerRequest, TriggerResponse};
use ros2_client::dds::rustdds::{DomainParticipantBuilder, Topic};
use ros2_client::qos::{Durability, History, WhenFull};
use ros2_client::{
    Context, Message, MessageTypeName, Name, Node, NodeName, NodeOptions, Publisher, QosProfile,
    Server, ServiceMapping, ServiceTypeName, Subscription,
};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use std::net::Ipv4Addr;

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

/// How a topic is sent or received.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Quality {
    /// The newest, late or never: images, as cameras send them.
    Sensor,
    /// The last second of them, late or never: readings of an inertial sensor.
    Readings,
    /// All of them, to those who listen now; what cannot be sent at once is not sent.
    Stream,
    /// The last one, also to those who come later: maps, as nav2 and RViz want them.
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
            Self::Latched => QosProfile::publisher_default()
                .durability(Durability::TransientLocal)
                .history(last(1)),
        }
    }
}

fn last(depth: usize) -> History {
    History::KeepLast { depth }
}

/// A node, and the namespace of its topics.
pub struct RosNode {
    /// The node itself.
    pub node: Node,
    namespace: String,
    name: String,
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
            node: context.new_node(node_name, options)?,
            namespace: namespace.to_owned(),
            name: name.to_owned(),
        })
    }

    /// A topic by its name, from the root or in the node's namespace.
    fn name_of(&self, topic: &str) -> anyhow::Result<Name> {
        let absolute = if topic.starts_with('/') {
            topic.to_owned()
        } else {
            format!("{}/{topic}", self.namespace.trim_end_matches('/'))
        };
        let name = Name::parse(&absolute);
        name.with_context(|| format!("{topic:?} is no name of a topic"))
    }

    /// A topic with messages of this type.
    fn topic<M: RosMessage>(&self, topic: &str, profile: &QosProfile) -> anyhow::Result<Topic> {
        let type_name = MessageTypeName::new(M::PACKAGE, M::NAME);
        let name = self.name_of(topic)?;
        Ok(self.node.create_topic(&name, type_name, profile)?)
    }

    /// Begins to publish.
    ///
    /// # Errors
    /// A name that is none, or a network that cannot be used.
    pub fn publisher<M: RosMessage>(
        &mut self,
        topic: &str,
        quality: Quality,
    ) -> anyhow::Result<Publisher<M>> {
        let profile = quality.profile();
        let topic = self.topic::<M>(topic, &profile)?;
        Ok(self.node.create_publisher(&topic, Some(profile))?)
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
        let profile = quality.profile();
        let topic = self.topic::<M>(topic, &profile)?;
        Ok(self.node.create_subscription(&topic, Some(profile))?)
    }

    /// Offers a service that needs to know nothing, below the name of the node.
    ///
    /// # Errors
    /// A name that is none, or a network that cannot be used.
    pub fn trigger(&mut self, service: &str) -> anyhow::Result<Trigger> {
        let profile = QosProfile::publisher_default().history(last(10));
        let name = self.name_of(&format!("{}/{service}", self.name))?;
        let type_name = ServiceTypeName::new("std_srvs", "Trigger");
        let mapping = ServiceMapping::Enhanced;
        Ok(self
            .node
            .create_server(mapping, &name, &type_name, profile.clone(), profile)?)
    }
}

/// A service of `std_srvs/srv/Trigger`.
pub type Trigger = Server<Wire<TriggerRequest>, Wire<TriggerResponse>>;

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
