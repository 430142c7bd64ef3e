//! MQTT through the NATS server: messages that a dashboard and Home Assistant receive, and their rights.

use std::sync::atomic::{AtomicU32, Ordering::Relaxed};
use std::time::Duration;

use futures_util::StreamExt;
use ihd_fleet::{StateMessage, discovery, names};
use rumqttc::mqttbytes::v4::{Packet, SubscribeReasonCode};
use rumqttc::{
    AsyncClient, ConnectionError, Event, EventLoop, MqttOptions, PublishOptions, QoS, Transport,
};
use serde_json::Value;

use crate::lab::Lab;

/// Number of the next client.
static NEXT: AtomicU32 = AtomicU32::new(1);

const WITHIN: Duration = Duration::from_secs(300);

/// Time within which any message would have come.
const QUIET: Duration = Duration::from_millis(700);

/// Returns a state as an edge publishes it.
fn state() -> String {
    let state = StateMessage {
        at_ms: 1_795_412_345_678,
        state: "learning".to_owned(),
        pot: Some("ferromagnetic".to_owned()),
        power_w: Some(1_203.5),
        asked_w: Some(1_200),
        r_ohm: Some(3.7),
        l_h: Some(7.83e-5),
        f_sw_hz: Some(55_200),
        pot_rise_k: None,
        lookup_version: 4,
    };
    serde_json::to_string(&state).unwrap()
}

/// A client of MQTT and its events.
struct Mqtt {
    client: AsyncClient,
    events: EventLoop,
}

impl Mqtt {
    /// Connects over TLS with the seed of a key as the password; waits for the server's acknowledgement.
    async fn connect(lab: &Lab, user: &str, password: &str) -> Result<Self, ConnectionError> {
        let address = lab.server.mqtt_address();
        let host = address.ip().to_string();
        // An id of its own: the server rejects frequent reconnections of one id.
        let id = format!("test-{}", NEXT.fetch_add(1, Relaxed));
        let mut options = MqttOptions::new(id, (host, address.port()));
        options.set_credentials(user, password.to_owned());
        let certificate = std::fs::read(lab.certificate()).unwrap();
        options.set_transport(Transport::tls(certificate, None, None));
        let (client, events) = AsyncClient::builder(options).capacity(16).build();
        let mut mqtt = Self { client, events };
        let accepted = mqtt.until(WITHIN, |packet| matches!(packet, Packet::ConnAck(_)));
        accepted.await?.expect("an answer of the server");
        Ok(mqtt)
    }

    /// Connects as a user of the lab.
    async fn connect_as(lab: &Lab, user: &str) -> Self {
        let connected = Self::connect(lab, user, lab.key(user).seed()).await;
        connected.unwrap_or_else(|why| panic!("{user}: {why}\n{}", lab.server.log()))
    }

    /// Returns the first matching packet; `None` if it does not come in time.
    async fn until(
        &mut self,
        within: Duration,
        matches: impl Fn(&Packet) -> bool,
    ) -> Result<Option<Packet>, ConnectionError> {
        let next = async {
            loop {
                match self.events.poll().await? {
                    Event::Incoming(packet) if matches(&packet) => return Ok(packet),
                    _ => {}
                }
            }
        };
        tokio::time::timeout(within, next).await.ok().transpose()
    }

    /// Subscribes; returns `true` if it was granted.
    async fn subscribe(&mut self, topics: &str) -> bool {
        self.client
            .subscribe(topics, QoS::AtMostOnce)
            .await
            .unwrap();
        let answer = self.until(WITHIN, |packet| matches!(packet, Packet::SubAck(_)));
        match answer.await.unwrap() {
            Some(Packet::SubAck(answer)) => answer
                .return_codes
                .iter()
                .all(|code| matches!(code, SubscribeReasonCode::Success(_))),
            other => panic!("{topics}: {other:?}"),
        }
    }

    /// Returns topic and content of the next message.
    async fn next(&mut self, within: Duration) -> Option<(String, Vec<u8>)> {
        let came = self.until(within, |packet| matches!(packet, Packet::Publish(_)));
        match came.await {
            Ok(Some(Packet::Publish(message))) => {
                let topic = String::from_utf8(message.topic.to_vec()).unwrap();
                Some((topic, message.payload.to_vec()))
            }
            _ => None,
        }
    }

    /// Publishes and gives the client time to send.
    async fn publish(&mut self, topic: &str, content: &'static str) {
        let options = PublishOptions::new(QoS::AtMostOnce);
        let sent = self.client.publish(topic.to_owned(), content, options);
        sent.await.unwrap();
        // The server may end the connection.
        let _ = self.until(QUIET, |_| false).await;
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn states_that_an_edge_publishes_arrive_over_mqtt() {
    let lab = Lab::start().await;
    let mut mqtt = Mqtt::connect_as(&lab, "lab-mqtt").await;
    assert!(mqtt.subscribe("ihd/v1/+/state").await);
    let edge = lab.client("lab-edge-lab-1").await;
    for hob in ["hob-a", "hob-b"] {
        let sent = edge.publish(names::state(hob), state().into());
        sent.await.unwrap();
        let (topic, content) = mqtt.next(WITHIN).await.unwrap();
        assert_eq!(topic, format!("ihd/v1/{hob}/state"));
        assert_eq!(content, state().as_bytes());
    }
    // Nothing of another site arrives.
    let other = lab.client("field-edge-field-1").await;
    let sent = other.publish(names::state("hob-a"), state().into());
    sent.await.unwrap();
    assert_eq!(mqtt.next(QUIET).await, None);
}

/// Publishes discovery messages at each start of Home Assistant, as an edge does (edge/states.rs).
async fn publish_at_birth(edge: async_nats::Client, hob: &'static str) {
    let mut births = edge.subscribe(discovery::STATUS).await.unwrap();
    edge.flush().await.unwrap();
    tokio::spawn(async move {
        while let Some(birth) = births.next().await {
            if birth.payload != "online" {
                continue;
            }
            for (subject, config) in discovery::sensor_messages(hob) {
                edge.publish(subject, config.into()).await.unwrap();
            }
        }
    });
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn home_assistant_finds_each_quantity_after_its_birth() {
    let lab = Lab::start().await;
    let edge = lab.client("lab-edge-lab-1").await;
    // Published before Home Assistant starts: it never receives them.
    for (subject, config) in discovery::sensor_messages("hob-a") {
        edge.publish(subject, config.into()).await.unwrap();
    }
    edge.flush().await.unwrap();
    publish_at_birth(edge.clone(), "hob-a").await;
    let mut home = Mqtt::connect_as(&lab, "lab-home-assistant").await;
    assert!(home.subscribe("homeassistant/+/+/+/config").await);
    assert_eq!(home.next(QUIET).await, None);

    let online = PublishOptions::new(QoS::AtMostOnce).retained();
    let birth = home
        .client
        .publish("homeassistant/status", "online", online);
    birth.await.unwrap();
    let mut topics = Vec::new();
    for (subject, config) in discovery::sensor_messages("hob-a") {
        let (topic, content) = home.next(WITHIN).await.expect("its sensor");
        assert_eq!(topic, discovery::topic(&subject));
        assert_eq!(content, config);
        let config: Value = serde_json::from_slice(&content).unwrap();
        topics.push(config["state_topic"].as_str().unwrap().to_owned());
    }
    assert_eq!(home.next(QUIET).await, None);
    // The state is published on the configured topic.
    topics.dedup();
    assert_eq!(topics.len(), 1);
    assert!(home.subscribe(&topics[0]).await);
    let sent = edge.publish(names::state("hob-a"), state().into());
    sent.await.unwrap();
    let (topic, content) = home.next(WITHIN).await.unwrap();
    assert_eq!(topic, topics[0]);
    let state: Value = serde_json::from_slice(&content).unwrap();
    // An unknown value is `null` and not omitted: Home Assistant would keep the former value.
    assert!(discovery::fields().all(|field| state.get(field).is_some()));
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn who_reads_by_mqtt_may_only_read_and_only_states() {
    let lab = Lab::start().await;
    let operator = lab.client("lab-operator").await;
    let mut all = operator.subscribe("ihd.>").await.unwrap();
    let mut status = operator.subscribe(discovery::STATUS).await.unwrap();
    operator.flush().await.unwrap();
    let hears = |subscription: &mut async_nats::Subscriber| {
        let message = futures_util::FutureExt::now_or_never(subscription.next());
        message.flatten().map(|message| message.payload)
    };
    for user in ["lab-mqtt", "lab-home-assistant"] {
        let mut mqtt = Mqtt::connect_as(&lab, user).await;
        mqtt.publish("ihd/v1/hob-a/state", "no").await;
        let mut mqtt = Mqtt::connect_as(&lab, user).await;
        mqtt.publish("ihd/v1/hob-a/window", "no").await;
        assert_eq!(hears(&mut all), None, "{user}");
        // A new connection: the server may have ended the one before.
        let mut mqtt = Mqtt::connect_as(&lab, user).await;
        mqtt.publish("homeassistant/status", "online").await;
        let may = user == "lab-home-assistant";
        assert_eq!(hears(&mut status).is_some(), may, "{user}");
        let mut mqtt = Mqtt::connect_as(&lab, user).await;
        for (topics, may) in [
            ("ihd/v1/hob-a/state", true),
            ("homeassistant/#", true),
            ("ihd/v1/+/window", false),
            ("ihd/v1/+/result/#", false),
            ("$KV/ihd_lookups/#", false),
            ("#", false),
        ] {
            assert_eq!(mqtt.subscribe(topics).await, may, "{user} {topics}");
        }
    }
    // The operator may: the subscription above works.
    let sent = operator.publish(names::state("hob-a"), "yes".into());
    sent.await.unwrap();
    let heard = tokio::time::timeout(WITHIN, all.next()).await.unwrap();
    assert_eq!(heard.unwrap().payload, "yes");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_password_of_mqtt_opens_mqtt_alone() {
    let lab = Lab::start().await;
    let (user, other) = ("lab-mqtt", "lab-home-assistant");
    let wrong = Mqtt::connect(&lab, user, lab.key(other).seed()).await;
    let why = wrong.err().expect("a refusal");
    assert!(
        matches!(why, ConnectionError::ConnectionRefused(_)),
        "{why}"
    );
    assert!(
        Mqtt::connect(&lab, user, lab.key(user).seed())
            .await
            .is_ok()
    );
    let password = lab.key(user).seed().to_owned();
    let by_nats = async_nats::ConnectOptions::with_user_and_password(user.to_owned(), password)
        .add_root_certificates(lab.certificate())
        .require_tls(true);
    let refused = by_nats.connect(lab.url()).await.unwrap_err();
    let kind = async_nats::ConnectErrorKind::AuthorizationViolation;
    assert_eq!(refused.kind(), kind);
}
