//! Commands of clients: lines and datagrams are decoded or refused with a short answer, decoded commands
//! survive a round trip, and no client is subscribed without the nonce.

#![no_main]

use std::net::SocketAddr;

use libfuzzer_sys::fuzz_target;
use tokio::sync::watch;
use trifacet::core::time::Mono;
use trifacet::config::Network;
use trifacet::publishing::StreamId;
use trifacet::publishing::descriptor::StreamFacts;
use trifacet::publishing::subscription::Subscriptions;
use trifacet_wire::stream::{ClientCommand, SubscriptionRequest};
use trifacet_wire::stream::lines::Lines;

fuzz_target!(|bytes: &[u8]| {
    let mut lines = Lines::default();
    for part in bytes.chunks(100) {
        lines.push(part);
        while let Some(Ok(line)) = lines.next_line() {
            understand(&line);
        }
    }
    subscribe(bytes);
    control(bytes);
});

/// Lines on the control socket.
fn control(bytes: &[u8]) {
    let Ok(text) = std::str::from_utf8(bytes) else { return };
    for line in text.lines() {
        if let Err(refusal) = line.parse::<trifacet::control::Command>() {
            assert!(refusal.to_string().len() < 1000, "a short answer");
        }
    }
}

fn understand(line: &[u8]) {
    match ClientCommand::parse(line) {
        Ok(ClientCommand::Stream(request)) => {
            let again = ClientCommand::parse(request.to_string().as_bytes());
            assert_eq!(again, Ok(ClientCommand::Stream(request)));
        }
        Ok(_) => {}
        Err(error) => {
            let text = error.to_string();
            assert!(text.is_ascii() && !text.contains(['\n', '\r']));
        }
    }
}

fn subscribe(bytes: &[u8]) {
    if let Some(Ok(ask)) = SubscriptionRequest::parse(bytes) {
        assert_eq!(SubscriptionRequest::parse(ask.to_string().as_bytes()), Some(Ok(ask)));
    }
    let client = SocketAddr::from(([127, 0, 0, 1], 1));
    let facts = StreamFacts::example(StreamId { session: 1, config: 0 });
    let (_, descriptor) = watch::channel(facts.descriptor());
    let mut subscriptions = Subscriptions::new(descriptor, 1, Network::loopback());
    for datagram in bytes.split(|byte| *byte == 0) {
        let outcome = subscriptions.datagram(client, datagram, Mono(0));
        assert!(!outcome.changed);
        assert!(outcome.answer.is_none_or(|answer| answer.len() <= 2 * datagram.len()));
    }
}
