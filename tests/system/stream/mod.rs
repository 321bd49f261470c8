//! The stream from end to end: server, client, `trifacet watch`, and the document that describes it.

mod crowd;
mod doctor;
mod document;
mod fixture;
mod lines;
mod rare;
mod receivers;
mod tcp;
mod udp;
mod watch;
