//! Control of a running daemon: through `trifacet ctl`, the control socket, and SIGHUP.

mod first_steps;
mod fixture;
mod reload;
mod self_check;
mod socket;
mod steer;
mod tare;
mod twin_pose;
mod unreadable;
