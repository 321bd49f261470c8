//! Programs that keep a processor busy take turns, so that daemons of other tests keep their time.

use std::sync::{Condvar, Mutex, PoisonError};

/// Two of these programs run at a time. A test holds one turn at most.
static FREE: (Mutex<u32>, Condvar) = (Mutex::new(2), Condvar::new());

/// The right to keep a processor busy, until it is dropped.
pub(crate) struct Turn(());

impl Turn {
    /// Waits for a turn.
    pub(crate) fn wait() -> Self {
        let free = FREE.0.lock().unwrap_or_else(PoisonError::into_inner);
        *FREE.1.wait_while(free, |free| *free == 0).unwrap_or_else(PoisonError::into_inner) -= 1;
        Self(())
    }
}

impl Drop for Turn {
    fn drop(&mut self) {
        *FREE.0.lock().unwrap_or_else(PoisonError::into_inner) += 1;
        FREE.1.notify_one();
    }
}
