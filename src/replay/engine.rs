//! Entries of a recording to reports. Pure.

use std::sync::Arc;

use trifacet_core::centering::LoopState;
use trifacet_core::channels::MissingSignal;
use trifacet_core::estimation::{Estimation, EstimatorState, PoseReport};
use trifacet_core::pipeline::Measurement;
use trifacet_core::signals::{Identity, Sample, Scan};

use crate::config::CalibrationContext;
use crate::exit::{self, Failure};
use crate::recording::{Entry, Keyframe};

/// Channel map and estimation as they were, or with another configuration.
///
/// It begins at the first keyframe. From there it goes on by itself, and takes the state of a later keyframe
/// only where that is not its own: where the source came up again, where samples and poses began to mean
/// something else, or where the record has a hole.
#[derive(Debug, Default)]
pub struct Engine {
    /// What samples and poses shall mean, whatever they meant then.
    other: Option<Arc<CalibrationContext>>,
    state: Option<State>,
    report: Option<PoseReport>,
    /// How often the state of a keyframe was taken.
    pub taken_up: u64,
    /// Samples and silences before the first keyframe, or without a source: nothing can be said of them.
    pub passed_over: u64,
}

#[derive(Debug)]
struct State {
    context: Arc<CalibrationContext>,
    source: Option<Arc<Identity>>,
    last: Option<Scan>,
    /// The sample of that scan.
    sample: Option<Sample>,
    measurement: Measurement,
}

impl Engine {
    /// With the configurations that were in force then, so that the same reports come out.
    pub fn new() -> Self {
        Self::default()
    }

    /// With this configuration throughout.
    pub fn with(context: CalibrationContext) -> Self {
        Self { other: Some(Arc::new(context)), ..Self::default() }
    }

    /// Whether the same reports must come out.
    pub fn repeats(&self) -> bool {
        self.other.is_none()
    }

    /// Takes the next entry.
    ///
    /// # Errors
    /// The configuration and the source of a keyframe do not go together.
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

    /// What came out of the last sample or silence, if it gave something, in the user's frame.
    pub fn report(&self) -> Option<&PoseReport> {
        self.report.as_ref()
    }

    /// Something is missing on record: nothing can be said before the next keyframe.
    pub fn hole(&mut self) {
        (self.state, self.report) = (None, None);
    }

    /// Begins without what estimation remembered then, where that cannot be read; goes on if it has begun.
    ///
    /// # Errors
    /// The configuration and the source do not go together.
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

    /// The state between the last sample and the next, to go on from; none before the first keyframe.
    pub fn now(&self) -> Option<Keyframe> {
        let State { context, source, last, measurement, .. } = self.state.as_ref()?;
        let (context, memory) = (Arc::clone(context), measurement.estimation.memory().clone());
        Some(Keyframe { context, source: source.clone(), last: *last, memory })
    }

    /// Estimation as it is between the last sample and the next; none before the first keyframe.
    pub fn estimation(&self) -> Option<&Estimation> {
        self.state.as_ref().map(|state| &state.measurement.estimation)
    }

    /// What the channel map made of the last scan.
    pub fn sample_now(&self) -> Option<Sample> {
        self.state.as_ref()?.sample
    }

    fn keyframe(&mut self, keyframe: &Keyframe) -> Result<(), Failure> {
        match (&mut self.state, &self.other) {
            (Some(state), None) if state.is(keyframe) => {}
            (Some(state), Some(_)) if state.source == keyframe.source => {
                // The settings stay; what was before a hole, or before the source came up, is not told again.
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
            self.hole(); // that nobody told of: a file that was cut, or put together
        }
        let state = self.state.as_mut().filter(|state| state.source.is_some());
        self.passed_over += u64::from(state.is_none());
        let State { last, sample: made, measurement, .. } = state?;
        let mut sample = measurement.mapping.sample(scan)?;
        *last = Some(*scan);
        if then.lost != scan.lost && self.other.is_none() {
            // Estimation had no room for the scan before: it is not on record, but was interpolated from.
            sample = *then;
        }
        sample.lost = then.lost;
        *made = Some(sample);
        measurement.sample(&sample, steering)
    }
}

impl State {
    fn new(keyframe: &Keyframe, other: Option<&Arc<CalibrationContext>>) -> Result<Self, Failure> {
        let context = Arc::clone(other.unwrap_or(&keyframe.context));
        let wrong = |missing: MissingSignal| Failure::new(exit::CONFIG, missing.to_string());
        let mut measurement = context.config.measurement(&context.tables, context.id())?;
        if let Some(source) = &keyframe.source {
            measurement.source(Arc::clone(source)).map_err(wrong)?;
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

    /// Whether this is the state of the keyframe.
    fn is(&self, keyframe: &Keyframe) -> bool {
        let same = |a: &Arc<CalibrationContext>, b| Arc::ptr_eq(a, b) || a == b;
        same(&self.context, &keyframe.context)
            && self.source == keyframe.source
            && self.last == keyframe.last
            && bytes(self.measurement.estimation.memory()) == bytes(&keyframe.memory)
    }

    fn interrupt(&mut self, keyframe: &Keyframe) -> Result<(), Failure> {
        let fresh = Self::new(keyframe, Some(&self.context))?;
        self.measurement.mapping = fresh.measurement.mapping;
        self.last = keyframe.last;
        if let Some(source) = &self.source {
            self.measurement.estimation.source(source.simulated);
        }
        Ok(())
    }
}

/// A memory to be compared: what is not a number must be the same nothing.
fn bytes(memory: &EstimatorState) -> Option<Vec<u8>> {
    postcard::to_stdvec(memory).ok()
}
