//! The live page: its data and its files.
//!
//! - [`bins`], [`status_history`], [`spectrum`]: evaluation of every frame. [`events`]: what has changed. Pure.
//! - [`state`]: makes one update for all viewers, ten times a second.
//! - [`viewer`]: a WebSocket for each viewer. [`control`]: the commands that the page can give.
//!
//! The page itself stands in `assets`, and goes into the binary with the chart library (`charts`).

pub mod bins;
pub mod control;
pub mod events;
pub mod spectrum;
pub mod state;
pub mod status_history;
pub mod viewer;

use std::sync::Arc;

use axum::Router;
use axum::extract::DefaultBodyLimit;
use axum::http::{HeaderName, header};
use axum::routing::{MethodRouter, get, post};

use super::view::View;
use crate::charts;

/// Scripts, sockets, styles and pictures from here only, none of them within the page.
const POLICY: &str = "default-src 'none'; script-src 'self'; connect-src 'self'; img-src 'self'; \
    style-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'";

/// All paths of the page.
pub fn routes() -> Router<Arc<View>> {
    Router::new()
        .route("/", asset("text/html; charset=utf-8", include_str!("assets/page.html")))
        .route("/page.css", asset("text/css", include_str!("assets/page.css")))
        .route("/page.js", asset("text/javascript", include_str!("assets/page.js")))
        .route("/link.js", asset("text/javascript", include_str!("assets/link.js")))
        .route("/uplot.js", asset("text/javascript", charts::UPLOT))
        .route("/plot.js", asset("text/javascript", charts::PLOT))
        .route("/plot.css", asset("text/css", charts::STYLE))
        .route("/charts.js", asset("text/javascript", include_str!("assets/charts.js")))
        .route("/optics.js", asset("text/javascript", include_str!("assets/optics.js")))
        .route("/tools.js", asset("text/javascript", include_str!("assets/tools.js")))
        .route("/words.js", asset("text/javascript", include_str!("assets/words.js")))
        .route("/icon.svg", asset("image/svg+xml", include_str!("assets/icon.svg")))
        .route("/icon-good.svg", asset("image/svg+xml", include_str!("assets/icon-good.svg")))
        .route("/icon-limited.svg", asset("image/svg+xml", include_str!("assets/icon-limited.svg")))
        .route("/icon-bad.svg", asset("image/svg+xml", include_str!("assets/icon-bad.svg")))
        .route("/icon-note.svg", asset("image/svg+xml", include_str!("assets/icon-note.svg")))
        .route("/icon-none.svg", asset("image/svg+xml", include_str!("assets/icon-none.svg")))
        .route("/live", get(viewer::open))
        .route("/control", post(control::obey).layer(DefaultBodyLimit::max(control::LONGEST)))
}

/// A handler that answers with a file of the page.
fn asset<S: Clone + Send + Sync + 'static>(kind: &'static str, text: &'static str) -> MethodRouter<S> {
    let headers: [(HeaderName, &str); 5] = [
        (header::CONTENT_TYPE, kind),
        (header::CACHE_CONTROL, "no-cache"),
        (header::CONTENT_SECURITY_POLICY, POLICY),
        (header::X_CONTENT_TYPE_OPTIONS, "nosniff"),
        (header::REFERRER_POLICY, "no-referrer"),
    ];
    get(async move || (headers, text))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_policy_allows_no_inline_scripts_and_no_other_sites() {
        let allowed =
            ["default-src", "script-src", "connect-src", "img-src", "style-src", "'none'", "'self'"];
        let rest = POLICY.split([';', ' ']).filter(|word| !word.is_empty() && !allowed.contains(word));
        assert!(rest.eq(["base-uri", "form-action", "frame-ancestors"]), "{POLICY}");
    }
}
