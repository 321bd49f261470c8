//! Computes reports from the entries of a recording. Pure.

use std::sync::Arc;

use trifacet_core::centering::LoopState;
use trifacet_core::estimation::{Estimation, EstimatorState, PoseReport};
use trifacet_core::pipeline::Measurement;
use trifacet_core::signals::{Identity, Sample, Scan};

use crate::config::CalibrationContext;
use crate::exit::Failure;
use crate::recording::{Entry, Keyframe};

/// Channel map and estimation, with the recorded or another configuration.
///
/// The engine starts at the first keyframe and then continues by itself. It takes the state of a later
/// keyframe only if that differs from its own: after a restart of the source, after a change of the
/// configuration, or after a gap in the recording.
#[derive(Debug, Default)]
pub struct Engine {
    /// Configuration to use instead of the recorded ones.
    other: Option<Arc<CalibrationContext>>,
    state: Option<State>,
    report: Option<PoseReport>,
    /// Number of keyframes whose state was taken.
    pub taken_up: u64,
    /// Samples and silences that cannot be processed: before the first keyframe, or without a source.
    pub passed_over: u64,
}

#[derive(Debug)]
struct State {
    context: Arc<CalibrationContext>,
    source: Option<Arc<Identity>>,
    last: Option<Scan>,
    /// The sample computed from `last`.
    sample: Option<Sample>,
    measurement: Measurement,
}

impl Engine {
    /// An engine that uses the recorded configurations and reproduces the recorded reports.
    pub fn new() -> Self {
        Self::default()
    }

    /// An engine that uses this configuration throughout.
    pub fn with(context: CalibrationContext) -> Self {
        Self { other: Some(Arc::new(context)), ..Self::default() }
    }

    /// Whether the recorded reports are reproduced.
    pub fn repeats(&self) -> bool {
        self.other.is_none()
    }

    /// Processes the next entry.
    ///
    /// # Errors
    /// Configuration and source of a keyframe are incompatible.
    pub fn take(&mut self, entry: &Entry) -> Result<(), Failure> {
        match entry {
            Entry::Keyframe(keyframe) => self.keyframe(keyframe)?,
            Entry::Sample { scan, sample, steering } => self.report = self.sample(scan, sample, steering),
            Entry::Silence { time, steering, .. } => {
                self.passed_over += u64::from(self.state.is_none());
                self.report = self.state.as_mut().map(|state| state.measurement.silence(*time, steering));
            }
            Entry::Frame { .. } | Entry::Lock { .. } => {}
        }
        Ok(())
    }

    /// The report of the last sample or silence, if there is one, in the user's frame.
    pub fn report(&self) -> Option<&PoseReport> {
        self.report.as_ref()
    }

    /// Notes a gap in the recording: nothing can be computed before the next keyframe.
    pub fn hole(&mut self) {
        (self.state, self.report) = (None, None);
    }

    /// Starts without the recorded state of the estimation, if that cannot be read. If already started,
    /// continues.
    ///
    /// # Errors
    /// Configuration and source are incompatible.
    pub fn cold(
        &mut self,
        context: &Arc<CalibrationContext>,
        source: Option<&Arc<Identity>>,
    ) -> Result<(), Failure> {
        let goes_on = |state: &State| state.context == *context && state.source.as_ref() == source;
        if self.state.as_ref().is_none_or(|state| self.other.is_none() && !goes_on(state)) {
            let (context, source) = (Arc::clone(context), source.cloned());
            let keyframe = Keyframe { context, source, last: None, memory: EstimatorState::default() };
            let own = self.other.as_ref().unwrap_or(&keyframe.context);
            self.state = Some(State::new(&keyframe, Some(own))?);
            self.taken_up += 1;
        }
        Ok(())
    }

    /// The state between the last sample and the next; `None` before the first keyframe.
    pub fn now(&self) -> Option<Keyframe> {
        let State { context, source, last, measurement, .. } = self.state.as_ref()?;
        let (context, memory) = (Arc::clone(context), measurement.estimation.memory().clone());
        Some(Keyframe { context, source: source.clone(), last: *last, memory })
    }

    /// The estimation between the last sample and the next; `None` before the first keyframe.
    pub fn estimation(&self) -> Option<&Estimation> {
        self.state.as_ref().map(|state| &state.measurement.estimation)
    }

    /// The sample that the channel map computed from the last scan.
    pub fn sample_now(&self) -> Option<Sample> {
        self.state.as_ref()?.sample
    }

    fn keyframe(&mut self, keyframe: &Keyframe) -> Result<(), Failure> {
        match (&mut self.state, &self.other) {
            (Some(state), None) if state.is(keyframe) => {}
            (Some(state), Some(_)) if state.source == keyframe.source => {
                // Keep the settings, and drop only the history before the gap or the restart of the source.
                if state.last != keyframe.last {
                    self.taken_up += 1;
                    state.interrupt(keyframe)?;
                }
            }
            (_, other) => {
                self.taken_up += 1;
                self.state = Some(State::new(keyframe, other.as_ref())?);
            }
        }
        Ok(())
    }

    fn sample(&mut self, scan: &Scan, then: &Sample, steering: &LoopState) -> Option<PoseReport> {
        let last = self.state.as_ref().and_then(|state| state.last);
        if last.is_some_and(|last| !then.follows(last.index)) {
            self.hole(); // without a recorded reason: the file was cut or joined
        }
        let state = self.state.as_mut().filter(|state| state.source.is_some());
        self.passed_over += u64::from(state.is_none());
        let State { last, sample: made, measurement, .. } = state?;
        let mut sample = measurement.mapping.sample(scan)?;
        *last = Some(*scan);
        if then.lost != scan.lost && self.other.is_none() {
            // Estimation had no room for the previous scan: it is not recorded, but was used to interpolate.
            sample = Sample { uncovered: sample.uncovered, ..*then };
        }
        sample.lost = then.lost;
        *made = Some(sample);
        measurement.sample(&sample, steering)
    }
}

impl State {
    fn new(keyframe: &Keyframe, other: Option<&Arc<CalibrationContext>>) -> Result<Self, Failure> {
        let context = Arc::clone(other.unwrap_or(&keyframe.context));
        let mut measurement = context.config.measurement(&context)?;
        if let Some(source) = &keyframe.source {
            measurement.source(Arc::clone(source))?;
        }
        if other.is_none() {
            measurement.estimation.remember(keyframe.memory.clone());
        }
        if let Some(last) = &keyframe.last {
            measurement.mapping.follow(last);
        }
        let (source, last) = (keyframe.source.clone(), keyframe.last);
        Ok(Self { context, source, last, sample: None, measurement })
    }

    /// Whether this state equals that of the keyframe.
    fn is(&self, keyframe: &Keyframe) -> bool {
        let same = |a: &Arc<CalibrationContext>, b| Arc::ptr_eq(a, b) || a == b;
        same(&self.context, &keyframe.context)
            && self.source == keyframe.source
            && self.last == keyframe.last
            && bytes(&self.measurement.estimation.memory().as_far_as(&keyframe.memory))
                == bytes(&keyframe.memory)
    }

    fn interrupt(&mut self, keyframe: &Keyframe) -> Result<(), Failure> {
        let fresh = Self::new(keyframe, Some(&self.context))?;
        self.measurement.mapping = fresh.measurement.mapping;
        self.last = keyframe.last;
        if let Some(source) = &self.source {
            self.measurement.estimation.source(Arc::clone(source));
        }
        Ok(())
    }
}

/// A state as bytes for comparison, so that NaN equals NaN.
fn bytes(memory: &EstimatorState) -> Option<Vec<u8>> {
    postcard::to_stdvec(memory).ok()
}
