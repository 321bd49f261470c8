//! Causes of changes of the lock state.

use std::fmt;

macro_rules! causes {
    ($($(#[doc = $doc:literal])* $name:ident = $label:literal, $text:literal;)*) => {
        /// The cause of a change of the lock state.
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        #[repr(u8)]
        pub enum LockCause { $($(#[doc = $doc])* $name),* }

        impl LockCause {
            /// Every cause.
            pub const ALL: &'static [LockCause] = &[$(LockCause::$name),*];

            /// The cause as a label of metrics: "no_light".
            pub fn label(self) -> &'static str {
                match self { $(Self::$name => $label),* }
            }

            /// The loop has given up: it waits for light elsewhere, or for the operator.
            pub fn gives_up(self) -> bool {
                matches!(self, Self::SearchesFailed | Self::LostTooOften)
            }

            /// The cause as a clause for logs and recordings: "no PSD sees light".
            pub fn text(self) -> &'static str {
                match self { $(Self::$name => $text),* }
            }
        }
    };
}

causes! {
    /// The operator has switched the loop on.
    SwitchedOn = "switched_on", "switched on";
    /// The operator has switched the loop off, or to shadow mode.
    SwitchedOff = "switched_off", "switched off";
    /// The operator has switched the loop to manual mode.
    SwitchedToManual = "switched_to_manual", "switched to manual";
    /// A jump or a search has found the apex.
    LightFound = "light_found", "all PSDs see light";
    /// The steering has reached a limit.
    AtLimit = "at_limit", "the steering is at a limit";
    /// The offset, or its rms, is above `lock_limit_um`.
    OffsetTooLarge = "offset_too_large", "the offset, or its rms, is above the limit";
    /// The offset was within the limit for `lock_time_ms`.
    OffsetWithinLimit = "offset_within_limit", "the offset is within the limit";
    /// The offset is within the limit, but not yet for `lock_time_ms`.
    Confirming = "confirming", "the offset is within the limit, but not yet for lock_time_ms";
    /// No PSD sees light.
    NoLight = "no_light", "no PSD sees light";
    /// A jump has ended in darkness.
    NoLightAtApex = "no_light_at_apex", "no PSD sees light where the apex should be";
    /// One or two PSDs see too little light.
    LittleLight = "little_light", "a PSD sees too little light";
    /// A jump has ended with too little light on a PSD.
    LittleLightAtApex = "little_light_at_apex", "a PSD sees too little light where the apex should be";
    /// One or two PSDs have a clipped channel.
    Clipped = "clipped", "a channel is clipped";
    /// All PSDs have a clipped channel.
    AllClipped = "all_clipped", "every PSD is clipped";
    /// A channel repeats the same code.
    Frozen = "frozen", "a channel repeats the same code";
    /// The powers cannot come from a beam near the apex.
    NoOffset = "no_offset", "the powers give no offset";
    /// The spots show the apex at another position, and the stage moves there.
    ApexSeen = "apex_seen", "a spot shows where the apex should be";
    /// All searches have failed.
    SearchesFailed = "searches_failed", "all searches failed: waiting for light or `ctl search`";
    /// The apex was found and lost again too often.
    LostTooOften = "lost_too_often", "found and lost too often (is steering.matrix right?): waiting for `ctl search`";
    /// No samples arrive.
    NoSamples = "no_samples", "no samples";
    /// Samples arrive later than the loop delay.
    SamplesTooLate = "samples_too_late", "samples arrive later than centering.loop_delay_ms";
    /// The readback does not follow the commands.
    StageStuck = "stage_stuck", "the stage does not follow its commands";
    /// The stage has refused a command.
    StageRefuses = "stage_refuses", "the stage refuses its commands";
    /// The stage acknowledges commands too late, or not at all.
    CommandsUnanswered = "commands_unanswered", "the stage does not answer commands";
    /// The stage takes no commands.
    StageGone = "stage_gone", "the stage takes no commands";
}

impl fmt::Display for LockCause {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.text())
    }
}
