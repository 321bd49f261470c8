//! A running daemon is told what to do: through `trifacet ctl`, its socket, and SIGHUP.

mod fixture;
mod reload;
mod socket;
mod steer;
mod tare;
