//! Progress messages of the identification.

use indicatif::{ProgressBar, ProgressStyle};
use trifacet::identification::plan::{Plan, um};
use trifacet::identification::task::Audience;
use trifacet_core::signals::Identity;
use trifacet_core::steering::StagePosition;

/// Writes to standard error. The progress bar is shown only on a terminal.
pub(super) struct Show {
    dry: bool,
    bar: Option<ProgressBar>,
}

impl Show {
    /// `dry`: print only what would be done.
    pub(super) fn new(dry: bool) -> Self {
        eprintln!("checking the light and the stage; nothing moves yet");
        Self { dry, bar: None }
    }

    /// Removes the progress bar.
    pub(super) fn end(&self) {
        if let Some(bar) = &self.bar {
            bar.finish_and_clear();
        }
    }
}

impl Audience for Show {
    fn plan(&mut self, plan: &Plan, source: &Identity) -> bool {
        let um = |at: &[f64; 2]| format!("{} {} um", um(at[0]), um(at[1]));
        let half = plan.step / 2.0 * 1e6;
        eprintln!("source: {}", source.name);
        eprintln!("the stage is at {}, the beam is {} off the apex", um(&plan.found), um(&plan.offset));
        eprintln!(
            "each axis moves {half:.3} um to either side of that, {} steps of {:.3} um, within +-{:.1} um; \
             this takes {:.0} s",
            plan.steps,
            plan.step * 1e6,
            plan.limit * 1e6,
            plan.duration
        );
        eprintln!("then the stage is left at {}; Ctrl-C moves it there at any time", um(&plan.end));
        if !self.dry {
            let style = ProgressStyle::with_template("{bar:40} {pos}/{len} steps, {eta} left");
            let bar = ProgressBar::new(u64::from(2 * plan.steps));
            self.bar = Some(bar.with_style(style.unwrap_or_else(|_| ProgressStyle::default_bar())));
        }
        !self.dry
    }

    fn progress(&mut self, made: u32, _of: u32) {
        if let Some(bar) = &self.bar {
            bar.set_position(made.into());
        }
    }

    fn back(&mut self, position: StagePosition, complaint: Option<&str>) {
        self.end();
        let at = format!("{} {} um", um(position[0]), um(position[1]));
        match complaint {
            None => eprintln!("the stage is left at {at}, acknowledged"),
            Some(complaint) => eprintln!("the stage was sent to {at}, but {complaint}"),
        }
    }
}
