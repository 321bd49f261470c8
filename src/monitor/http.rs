//! The HTTP server, on the main thread.
//!
//! The number of connections is limited, and so is the time to send a request and to read the answer. Each
//! connection has its own task, so that a slow one does not delay others.

use std::convert::Infallible;
use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;

use axum::extract::{ConnectInfo, State};
use axum::http::{HeaderMap, HeaderName, Request, StatusCode, header};
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use axum::{Json, Router};
use hyper::body::Incoming;
use hyper::server::conn::http1;
use hyper::service::{Service, service_fn};
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::service::TowerToHyperService;
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::mpsc;
use tokio::task::JoinSet;
use tokio::time::timeout;
use trifacet_wire::PoseFrame;

use super::exposition::Exposition;
use super::host_filter::Hosts;
use super::page;
use super::view::View;
use crate::exit::Failure;
use crate::listening::{Accepting, open_tcp};

/// Most connections at a time; further ones are closed.
const CONNECTIONS: usize = 128;
/// A connection is closed after this time without a complete request header.
const REQUEST_TIMEOUT: Duration = Duration::from_secs(30);
/// A connection that accepts none of its answer for this time is closed, milliseconds.
const STALL_MS: u32 = 10_000;
/// Time limit at shutdown for answers in progress.
const DRAIN: Duration = Duration::from_millis(500);

/// Answers describe the present and must not be cached.
const FRESH: [(HeaderName, &str); 1] = [(header::CACHE_CONTROL, "no-store")];

/// Opens the port and logs the address of the page. Must be called within a runtime.
///
/// # Errors
/// The port cannot be opened; with [`crate::exit::IN_USE`] if another process uses it.
pub fn bind(address: SocketAddr) -> Result<TcpListener, Failure> {
    let listener = open_tcp(address)
        .map_err(|e| Failure::port(format_args!("open {address} for the monitor (monitor.listen)"), &e))?;
    let address = listener.local_addr().unwrap_or(address);
    tracing::info!(url = format!("http://{address}/"), "monitor is open");
    Ok(listener)
}

/// Serves until the channel of frames closes.
pub async fn serve(listener: TcpListener, mut frames: mpsc::Receiver<PoseFrame>, view: View, hosts: Hosts) {
    let view = Arc::new(view);
    let mut server = Server { view: Arc::clone(&view), hosts, router: router(&view), open: JoinSet::new() };
    tokio::select! {
        () = view.feed(&mut frames) => {}
        () = server.accept_all(&listener) => {}
    }
    drop(listener);
    view.ending.cancel();
    // Connections that are still open after the time limit are closed.
    let all_done = async { while server.open.join_next().await.is_some() {} };
    let _ = timeout(DRAIN, all_done).await;
}

/// All pages. A handler takes `State<Arc<View>>`.
fn router(view: &Arc<View>) -> Router {
    Router::new()
        .route("/healthz", get(healthz))
        .route("/readyz", get(readyz))
        .route("/metrics", get(metrics))
        .merge(page::routes())
        .with_state(Arc::clone(view))
}

async fn healthz(State(view): State<Arc<View>>) -> Response {
    let answer = match view.dead() {
        None => (StatusCode::OK, "ok\n".to_owned()),
        Some(still) => (StatusCode::SERVICE_UNAVAILABLE, still.why + "\n"),
    };
    (FRESH, answer).into_response()
}

async fn readyz(State(view): State<Arc<View>>) -> Response {
    let readiness = view.readiness();
    let code = if readiness.ready { StatusCode::OK } else { StatusCode::SERVICE_UNAVAILABLE };
    (code, FRESH, Json(readiness)).into_response()
}

async fn metrics(State(view): State<Arc<View>>, headers: HeaderMap) -> Response {
    let format = Exposition::preferred(&headers);
    let kind = [(header::CONTENT_TYPE, format.content_type()), (header::VARY, "Accept")];
    match super::metrics::render(view, format) {
        Ok(text) => (kind, FRESH, text).into_response(),
        Err(e) => (StatusCode::INTERNAL_SERVER_ERROR, format!("{e}\n")).into_response(),
    }
}

struct Server {
    view: Arc<View>,
    hosts: Hosts,
    router: Router,
    open: JoinSet<()>,
}

impl Server {
    async fn accept_all(&mut self, listener: &TcpListener) {
        let mut accepting = Accepting::new("a connection to the monitor");
        loop {
            if let Some((stream, peer)) = accepting.taken(listener.accept().await).await {
                self.admit(stream, peer);
            }
        }
    }

    fn admit(&mut self, stream: TcpStream, peer: SocketAddr) {
        while self.open.try_join_next().is_some() {}
        if self.open.len() < CONNECTIONS {
            let (view, hosts, router) = (Arc::clone(&self.view), self.hosts.clone(), self.router.clone());
            self.open.spawn(talk(stream, peer, view, hosts, router));
        } else {
            self.view.sources.condition.counters.monitor_refused.inc();
            tracing::warn!("monitor: refused a connection: {CONNECTIONS} are already open");
        }
    }
}

/// Serves one connection to its end. Errors of the connection are ignored.
async fn talk(stream: TcpStream, peer: SocketAddr, view: Arc<View>, hosts: Hosts, router: Router) {
    let Ok(own) = stream.local_addr() else { return };
    if rustix::net::sockopt::set_tcp_user_timeout(&stream, STALL_MS).is_err() {
        return;
    }
    let router = TowerToHyperService::new(router);
    let service = service_fn(|mut request: Request<Incoming>| {
        let refusal = hosts.refusal(&request, own.ip()).map(|(code, why)| {
            view.sources.condition.counters.monitor_forbidden.inc();
            match request.uri().path() {
                "/control" => page::control::refusal(code, why.trim_end()),
                _ => (code, why).into_response(),
            }
        });
        request.extensions_mut().insert(ConnectInfo(peer));
        let answer = refusal.is_none().then(|| router.call(request));
        async move {
            match answer {
                Some(answer) => answer.await,
                None => Ok::<Response, Infallible>(refusal.unwrap_or_default()),
            }
        }
    });
    let connection = http1::Builder::new()
        .timer(TokioTimer::new())
        .header_read_timeout(REQUEST_TIMEOUT)
        // Simple health checks close their side after the request, and wait for the answer.
        .half_close(true)
        .serve_connection(TokioIo::new(stream), service)
        .with_upgrades();
    let mut connection = std::pin::pin!(connection);
    tokio::select! {
        _ = connection.as_mut() => return,
        () = view.ending.cancelled() => {}
    }
    connection.as_mut().graceful_shutdown();
    let _ = connection.await;
}
