//! Commands that the stage has not acknowledged.

use crate::sent_commands::SentCommands;
use crate::steering::StagePosition;
use crate::time::Mono;

/// Largest number of commands that are remembered. Far more than a working stage leaves unanswered.
const MOST: usize = 1024;

/// A summary of the commands that the stage has not acknowledged.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct CommandBacklog {
    /// Number of commands without an acknowledgement. An acknowledgement also covers all earlier commands.
    pub count: u32,
    /// Time of the oldest of them.
    pub oldest: Option<Mono>,
    /// Answers have been too late, or absent, for longer than the time allowed. Only answers in time end this.
    pub overdue: bool,
}

impl CommandBacklog {
    /// Age of the oldest command without an acknowledgement, seconds; 0 if all are acknowledged.
    pub fn age_s(&self, now: Mono) -> f64 {
        self.oldest.map_or(0.0, |oldest| now.seconds_since(oldest).max(0.0))
    }
}

/// The commands without an acknowledgement, and whether answers are overdue.
#[derive(Clone, Debug, Default)]
pub struct UnansweredCommands {
    /// Positions and times.
    list: SentCommands<(StagePosition, Mono)>,
    overdue: bool,
    /// How long the age of the oldest command has contradicted `overdue`, seconds.
    contrary_s: f64,
}

impl UnansweredCommands {
    /// Records a command that is sent at `now`.
    pub fn sent(&mut self, id: u32, position: StagePosition, now: Mono) {
        self.list.push(id, (position, now), MOST);
    }

    /// Records the answer to a command. Returns its position, unless no such command waits for an answer.
    pub fn answered(&mut self, id: u32) -> Option<StagePosition> {
        self.list.take(id).map(|(position, _)| position)
    }

    /// Forgets all commands: the stage was replaced, or has acted on its own. Only answers end `overdue`.
    pub fn forget(&mut self) {
        self.list.clear();
    }

    /// Compares the age of the oldest command with `limit_s`, `dt` seconds after the previous comparison.
    /// Answers become overdue when the age has been above the limit for `patience_s`, and in time again when it
    /// has been within the limit for as long.
    pub fn check(&mut self, now: Mono, limit_s: f64, patience_s: f64, dt: f64) {
        let late = self.backlog().age_s(now) > limit_s;
        self.contrary_s = if late == self.overdue { 0.0 } else { self.contrary_s + dt };
        if self.contrary_s > patience_s {
            (self.overdue, self.contrary_s) = (late, 0.0);
        }
    }

    /// The summary.
    pub fn backlog(&self) -> CommandBacklog {
        CommandBacklog {
            count: self.list.len() as u32,
            oldest: self.list.oldest().map(|(_, sent)| *sent),
            overdue: self.overdue,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: i64 = 1_000_000;

    /// Sends one command per millisecond for `ms` milliseconds; each is answered after `delay` of them.
    fn run(commands: &mut UnansweredCommands, from: i64, ms: i64, delay: Option<i64>) {
        for k in from..from + ms {
            let now = Mono(k * MS);
            commands.sent(k as u32, StagePosition::default(), now);
            if let Some(delay) = delay {
                commands.answered((k - delay) as u32);
            }
            commands.check(now, 10e-3, 50e-3, 1e-3);
        }
    }

    #[test]
    fn answers_are_overdue_after_the_time_allowed_and_in_time_again_after_the_same_time() {
        let mut commands = UnansweredCommands::default();
        run(&mut commands, 0, 1000, Some(8));
        assert_eq!((commands.backlog().count, commands.backlog().overdue), (8, false));
        run(&mut commands, 1000, 50, None);
        assert!(!commands.backlog().overdue);
        run(&mut commands, 1050, 10_000, None);
        let backlog = commands.backlog();
        assert!(backlog.overdue && backlog.count == MOST as u32, "{backlog:?}");
        assert!((backlog.age_s(Mono(11_000 * MS)) - 10.008).abs() < 1e-9, "{backlog:?}");
        run(&mut commands, 11_050, 100, Some(20));
        assert!(commands.backlog().overdue, "late answers");
        run(&mut commands, 11_150, 80, Some(0));
        assert_eq!(commands.backlog(), CommandBacklog::default());
    }

    #[test]
    fn an_answer_covers_earlier_commands_and_a_strange_id_none() {
        let mut commands = UnansweredCommands::default();
        (1..=3).for_each(|id| commands.sent(id, StagePosition([f64::from(id), 0.0]), Mono(0)));
        assert_eq!(commands.answered(9), None);
        assert_eq!(commands.answered(2), Some(StagePosition([2.0, 0.0])));
        assert_eq!((commands.answered(1), commands.backlog().count), (None, 1));
        commands.forget();
        assert_eq!(commands.backlog().age_s(Mono(MS)), 0.0);
    }
}
