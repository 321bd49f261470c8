//! Recognises a board that has restarted by its boot id.

use trifacet_wire::board::BoardIdentity;

/// Name and boot id of the last board, if it speaks version 1.1.
#[derive(Debug, Default)]
pub(super) struct BootWatch(Option<(String, u32)>);

impl BootWatch {
    /// Whether a boot id is known.
    pub(super) fn is_known(&self) -> bool {
        self.0.is_some()
    }

    /// Whether this is the last board with another boot id.
    pub(super) fn is_other(&self, board: &BoardIdentity) -> bool {
        let boot = boot_of(board);
        self.0.as_ref().zip(boot.as_ref()).is_some_and(|(before, now)| before.0 == now.0 && before.1 != now.1)
    }

    /// Remembers the boot id of the board. Returns true, with a log line, if the board has restarted.
    pub(super) fn note(&mut self, board: &BoardIdentity) -> bool {
        let restarted = self.is_other(board);
        if restarted {
            tracing::warn!(
                board = board.name,
                "the board has restarted: its outputs went to code 0 without a command, and its clock began anew"
            );
        }
        self.0 = boot_of(board);
        restarted
    }
}

fn boot_of(board: &BoardIdentity) -> Option<(String, u32)> {
    board.extension.as_ref().map(|extension| (board.name.clone(), extension.boot_id))
}
