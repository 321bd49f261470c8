//! The stream from end to end: server, client, `trifacet watch`, and the document that describes it.

#![allow(clippy::unwrap_used)]

mod document;
mod fixture;
mod tcp;
mod watch;
