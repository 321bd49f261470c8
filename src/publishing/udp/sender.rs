//! Sends frames as datagrams, on the fast side. Nothing here waits.

use std::sync::Arc;

use rustix::io::Errno;
use rustix::net::{SendFlags, sendto};
use tokio::sync::watch;
use trifacet_core::telemetry::Counters;
use trifacet_wire::PoseFrame;
use trifacet_wire::byte_order::big_endian;
use trifacet_wire::frame::FrameBytes;
use trifacet_wire::held::Hold;
use trifacet_wire::stream::Delivery;

use super::receiver::{Receiver, Way};
use crate::config::Deviations;

/// A list of receivers that the main thread replaces when it changes.
pub type Receivers = watch::Receiver<Arc<[Receiver]>>;

/// Sends to all receivers.
#[derive(Debug, Default)]
pub struct Sender {
    lists: Vec<List>,
    hold: Hold,
    deviations: Deviations,
}

#[derive(Debug)]
struct List {
    newest: Receivers,
    current: Arc<[Receiver]>,
}

impl Sender {
    /// Sends to the receivers in these lists.
    pub fn new(lists: impl IntoIterator<Item = Receivers>) -> Self {
        let list = |mut newest: Receivers| {
            let current = Arc::clone(&newest.borrow_and_update());
            List { newest, current }
        };
        Self {
            lists: lists.into_iter().map(list).collect(),
            hold: Hold::default(),
            deviations: Deviations::Total,
        }
    }

    /// The frames carry these standard uncertainties.
    #[must_use]
    pub fn stating(self, deviations: Deviations) -> Self {
        Self { deviations, ..self }
    }

    /// Sends a frame to all receivers that are due for it. What is not accepted is counted in `counters`.
    pub fn send(&mut self, frame: &PoseFrame, counters: &Counters) {
        let frame = &self.deviations.stated(frame);
        let mut forms = Forms::new(frame, self.hold.next(frame));
        for list in &mut self.lists {
            // This check only reads an atomic; the lock is taken on a change. A closed channel changes nothing.
            if list.newest.has_changed().unwrap_or(false) {
                list.current = Arc::clone(&list.newest.borrow_and_update());
            }
            for receiver in list.current.iter() {
                let due = frame.sequence.is_multiple_of(receiver.delivery.divider.into());
                if due && !receiver.send(forms.get(receiver.delivery)) {
                    counters.udp_dropped.inc();
                }
            }
        }
    }
}

impl Receiver {
    /// Sends a datagram. Returns whether it was accepted and can be transmitted.
    fn send(&self, bytes: &FrameBytes) -> bool {
        let result = match &self.way {
            Some(way) => way.send(bytes).map_err(|e| Some(e.raw_os_error())),
            None => Err(None),
        };
        match result {
            Ok(()) => self.tally.accepted(),
            Err(errno) => {
                self.tally.lost(errno);
                false
            }
        }
    }
}

impl Way {
    /// A host without a listener refuses datagrams: this is not a loss, and a listener that starts later
    /// receives them. The refusal of an earlier datagram is reported by the next call, which then sends nothing.
    fn send(&self, bytes: &FrameBytes) -> Result<(), Errno> {
        let send = || match sendto(&*self.socket, bytes, SendFlags::empty(), &self.to) {
            Err(Errno::CONNREFUSED) => Ok(false),
            result => result.map(|_| true),
        };
        if !send()? {
            send()?;
        }
        Ok(())
    }
}

/// The encodings of one frame. Each is made once, when a receiver first needs it.
struct Forms<'a> {
    frame: &'a PoseFrame,
    held: Option<PoseFrame>,
    made: [Option<FrameBytes>; 4],
}

impl<'a> Forms<'a> {
    fn new(frame: &'a PoseFrame, held: Option<PoseFrame>) -> Self {
        Self { frame, held, made: [None; 4] }
    }

    fn get(&mut self, delivery: Delivery) -> &FrameBytes {
        let held = self.held.as_ref().filter(|_| delivery.held);
        let frame = held.unwrap_or(self.frame);
        let which = usize::from(held.is_some()) * 2 + usize::from(delivery.big_endian);
        self.made[which].get_or_insert_with(|| {
            let little = frame.encode();
            if delivery.big_endian { big_endian(&little) } else { little }
        })
    }
}
