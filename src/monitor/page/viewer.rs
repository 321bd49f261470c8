//! A viewer of the page: one WebSocket.
//!
//! A viewer requests a length of history in seconds (`{"watch": 60}`). It receives this history and then
//! every update. With `{"pause": true}` updates stop. A viewer that does not keep up receives the number of
//! missed updates and requests the history again; other viewers are not affected.

use std::sync::Arc;
use std::time::Duration;

use axum::extract::State;
use axum::extract::ws::{CloseFrame, Message, Utf8Bytes, WebSocket, WebSocketUpgrade, close_code};
use axum::http::{HeaderMap, StatusCode};
use axum::response::{IntoResponse, Response};
use serde::Deserialize;
use serde_json::json;
use tokio::sync::broadcast::Receiver;
use tokio::sync::broadcast::error::RecvError;
use tokio::time::{MissedTickBehavior, interval, timeout};
use trifacet_core::telemetry::Counters;
use trifacet_wire::Status;

use crate::monitor::host_filter::own_page;
use crate::monitor::view::View;

/// A viewer that accepts no data for this time is disconnected.
const STALL: Duration = Duration::from_secs(10);
/// Interval of pings, which detect that the other side has gone.
const PING: Duration = Duration::from_secs(20);
/// Longest message of a viewer in bytes.
const LONGEST: usize = 256;

/// A message of a viewer.
#[derive(Debug, Deserialize)]
#[serde(rename_all = "lowercase", deny_unknown_fields)]
enum ViewerRequest {
    /// Send this many seconds of history, then updates.
    Watch(u32),
    /// Stop sending updates.
    Pause(bool),
}

/// `GET /live`.
pub async fn open(State(view): State<Arc<View>>, headers: HeaderMap, upgrade: WebSocketUpgrade) -> Response {
    let counters = &view.sources.condition.counters;
    if !own_page(&headers) {
        counters.monitor_forbidden.inc();
        return (StatusCode::FORBIDDEN, "requests from the page of another server are refused\n")
            .into_response();
    }
    let Ok(seat) = Arc::clone(&view.seats).try_acquire_owned() else {
        counters.monitor_refused.inc();
        return (StatusCode::SERVICE_UNAVAILABLE, "too many viewers\n").into_response();
    };
    upgrade.max_message_size(LONGEST).on_upgrade(async move |socket| {
        // Errors of the connection are ignored.
        let _ = Viewer { socket, view, updates: None }.serve().await;
        drop(seat);
    })
}

/// The connection has ended.
struct Gone;

struct Viewer {
    socket: WebSocket,
    view: Arc<View>,
    /// `None` while paused.
    updates: Option<Receiver<Utf8Bytes>>,
}

impl Viewer {
    async fn serve(mut self) -> Result<(), Gone> {
        let view = Arc::clone(&self.view);
        let mut config = view.sources.config.clone();
        let mut descriptor = view.sources.descriptor.clone();
        let mut pings = interval(PING);
        pings.set_missed_tick_behavior(MissedTickBehavior::Delay);
        self.hello().await?;
        loop {
            tokio::select! {
                () = view.ending.cancelled() => return self.bye(close_code::AWAY, "the daemon stops").await,
                said = self.socket.recv() => self.handle(said.ok_or(Gone)?.map_err(|_| Gone)?).await?,
                update = next(self.updates.as_mut()) => self.pass_on(update).await?,
                Ok(()) = config.changed() => self.hello().await?,
                Ok(()) = descriptor.changed() => self.hello().await?,
                _ = pings.tick() => self.send(Message::Ping(<_>::default())).await?,
            }
        }
    }

    async fn send(&mut self, message: Message) -> Result<(), Gone> {
        timeout(STALL, self.socket.send(message)).await.map_err(|_| Gone)?.map_err(|_| Gone)
    }

    async fn say(&mut self, what: &serde_json::Value) -> Result<(), Gone> {
        self.send(Message::Text(what.to_string().into())).await
    }

    async fn bye(&mut self, code: u16, reason: &'static str) -> Result<(), Gone> {
        self.send(Message::Close(Some(CloseFrame { code, reason: reason.into() }))).await
    }

    /// Sends the data that do not change with every update.
    async fn hello(&mut self) -> Result<(), Gone> {
        let bits = Status::NAMES.iter().zip(Status::MEANINGS);
        let bits: Vec<_> =
            bits.map(|((_, name), context)| json!({ "name": name, "meaning": context })).collect();
        let sources = &self.view.sources;
        let counters: serde_json::Map<_, _> =
            Counters::DEFINITIONS.iter().map(|d| (d.name.to_owned(), d.meaning.into())).collect();
        let hello = json!({ "hello": {
            "descriptor": *sources.descriptor.borrow(),
            "config": *sources.config.borrow(),
            "bits": bits,
            "counters": counters,
            "losses": Counters::losses().collect::<Vec<_>>(),
            "control": sources.control.is_some(),
        }});
        self.say(&hello).await
    }

    async fn handle(&mut self, said: Message) -> Result<(), Gone> {
        let text = match said {
            Message::Text(text) => text,
            Message::Ping(_) | Message::Pong(_) => return Ok(()),
            Message::Binary(_) | Message::Close(_) => return Err(Gone),
        };
        match serde_json::from_str(&text) {
            Ok(ViewerRequest::Watch(span_s)) => {
                // Subscribe before the history is read, so that no update is missed in between.
                self.updates.get_or_insert_with(|| self.view.updates());
                let past = json!({
                    "history": self.view.history(span_s),
                    "span_s": span_s,
                    "events": self.view.events(),
                });
                self.say(&past).await
            }
            Ok(ViewerRequest::Pause(true)) => {
                self.updates = None;
                Ok(())
            }
            Ok(ViewerRequest::Pause(false)) | Err(_) => {
                self.bye(close_code::POLICY, "allowed: {\"watch\": seconds} and {\"pause\": true}").await?;
                Err(Gone)
            }
        }
    }

    async fn pass_on(&mut self, update: Result<Utf8Bytes, RecvError>) -> Result<(), Gone> {
        match update {
            Ok(update) => self.send(Message::Text(update)).await,
            Err(RecvError::Lagged(missed)) => {
                self.view.sources.condition.counters.page_skips.add(missed);
                self.say(&json!({ "missed": missed })).await
            }
            Err(RecvError::Closed) => Err(Gone),
        }
    }
}

/// The next update; waits forever while paused.
async fn next(updates: Option<&mut Receiver<Utf8Bytes>>) -> Result<Utf8Bytes, RecvError> {
    match updates {
        Some(updates) => updates.recv().await,
        None => std::future::pending().await,
    }
}
