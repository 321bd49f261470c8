//! Commands that were sent, in the order of their ids.

use std::collections::VecDeque;

/// Commands that wait for an event which covers all earlier ones, such as an acknowledgement. `T` is what is
/// remembered of each.
#[derive(Clone, Debug)]
pub struct SentCommands<T>(VecDeque<(u32, T)>);

impl<T> Default for SentCommands<T> {
    fn default() -> Self {
        Self(VecDeque::new())
    }
}

impl<T> SentCommands<T> {
    /// Adds the newest command. If there are `most` already, the second one is dropped: the first keeps the age of
    /// the oldest.
    pub fn push(&mut self, id: u32, command: T, most: usize) {
        if self.0.len() >= most {
            self.0.remove(1);
        }
        self.0.push_back((id, command));
    }

    /// Removes the command with this id and all before it. Returns it, or `None` if it is not there.
    pub fn take(&mut self, id: u32) -> Option<T> {
        let place = self.0.iter().position(|(sent, _)| *sent == id)?;
        self.0.drain(..=place).last().map(|(_, command)| command)
    }

    /// Keeps the commands that fulfil the condition.
    pub fn retain(&mut self, mut keep: impl FnMut(&T) -> bool) {
        self.0.retain(|(_, command)| keep(command));
    }

    /// The oldest command.
    pub fn oldest(&self) -> Option<&T> {
        self.0.front().map(|(_, command)| command)
    }

    /// Number of commands.
    pub fn len(&self) -> usize {
        self.0.len()
    }

    /// Whether no command waits.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// Forgets all commands.
    pub fn clear(&mut self) {
        self.0.clear();
    }
}
