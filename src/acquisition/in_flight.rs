//! The commands that were sent to the steering outputs and have not been acknowledged. Pure.

use std::sync::Arc;

use trifacet_core::sent_commands::SentCommands;
use trifacet_core::telemetry::Counters;
use trifacet_core::time::{Mono, NS_PER_S};
use trifacet_wire::actuator::OutputCommand;

use crate::config::Config;

/// Commands in flight in addition to those that the loop computes within its delay.
const SPARE: f64 = 2.0;
/// A command without an acknowledgement counts as lost after this time at the latest, nanoseconds.
const LOST_NS: i64 = NS_PER_S / 2;

/// Largest number of commands that are remembered. Within half a second, no loop sends more.
const MOST: usize = 16_384;

/// The largest number of commands in flight: those that the loop computes within its delay, and two more. More
/// commands would wait in the receiver, and add to the delay of the loop.
pub fn most_in_flight(config: &Config) -> usize {
    let rate_hz = config.acquisition.rate_hz;
    (config.centering.loop_delay_s(rate_hz) * rate_hz + SPARE).ceil() as usize
}

/// The commands in flight.
#[derive(Debug)]
pub struct InFlight {
    most: usize,
    /// The times at which the commands count as lost.
    commands: SentCommands<Mono>,
    counters: Arc<Counters>,
}

impl InFlight {
    /// No commands, and at most `most` in future.
    pub fn new(most: usize, counters: Arc<Counters>) -> Self {
        Self { most, commands: SentCommands::default(), counters }
    }

    /// Whether another command may be sent.
    pub fn has_room(&self) -> bool {
        self.commands.len() < self.most
    }

    /// Records a command that is sent.
    pub fn sent(&mut self, command: &OutputCommand, now: Mono) {
        // After half of its lease a command counts as lost, so that a later one renews the lease in time.
        let half_lease_ns = i64::from(command.lease_ms) * (NS_PER_S / 2000);
        self.commands.push(command.id, now + half_lease_ns.min(LOST_NS), MOST);
    }

    /// Removes the commands that count as lost at `now`.
    pub fn expire(&mut self, now: Mono) {
        self.commands.retain(|lost| now < *lost);
    }

    /// Records an acknowledgement, which also covers the commands before. Returns false, and counts, if no
    /// command with this id is in flight.
    pub fn acknowledged(&mut self, id: u32) -> bool {
        let known = self.commands.take(id).is_some();
        self.counters.acks_unknown.add(u64::from(!known));
        known
    }

    /// Forgets all commands: the receiver has started again.
    pub fn clear(&mut self) {
        self.commands.clear();
    }
}
