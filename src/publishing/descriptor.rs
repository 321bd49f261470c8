//! The descriptor of this daemon and the heartbeat of a client.

use std::collections::BTreeMap;

use trifacet_core::telemetry::Counters;
use trifacet_wire::layout::{COLUMNS, FIELDS};
use trifacet_wire::message::{MAJOR, MINOR};
use trifacet_wire::stream::{CalibrationEntry, Descriptor, FieldEntry, Heartbeat, LockEvent};
use trifacet_wire::{LockState, Status};

use super::publisher::StreamId;
use crate::config::{CalibrationState, Config, Deviations, Model};

/// The facts about the stream that the descriptor needs from outside this module.
#[derive(Clone, Debug)]
pub struct StreamFacts {
    /// Session and configuration.
    pub id: StreamId,
    /// Sample rate in Hz.
    pub sample_rate_hz: f64,
    /// Samples averaged into a frame; at least 1.
    pub average: u16,
    /// The sensor model of the estimator.
    pub model: Model,
    /// The calibration of the head.
    pub calibration: CalibrationState,
    /// As `calibration.expires_days`.
    pub expires_days: Option<f64>,
    /// As in [`Descriptor::systematic`].
    pub systematic: [f64; 6],
    /// Which standard uncertainties binary frames carry.
    pub deviations: Deviations,
}

impl StreamFacts {
    /// The facts of this configuration.
    pub fn new(id: StreamId, config: &Config, calibration: CalibrationState) -> Self {
        Self {
            id,
            sample_rate_hz: config.acquisition.rate_hz,
            average: config.estimation.average,
            model: config.estimation.model,
            systematic: config.systematic(calibration.spread.is_some()),
            calibration,
            expires_days: config.calibration.expires_days,
            deviations: config.publishing.deviations,
        }
    }

    /// A stream of 1 kHz, for examples and tests.
    pub fn example(id: StreamId) -> Self {
        Self {
            id,
            sample_rate_hz: 1000.0,
            average: 1,
            model: Model::Ray,
            calibration: CalibrationState::default(),
            expires_days: None,
            systematic: [0.0; 6],
            deviations: Deviations::Total,
        }
    }

    /// The descriptor of this daemon.
    pub fn descriptor(&self) -> Descriptor {
        let (facts, average) = (self, self.average.max(1));
        Descriptor {
            stream_version: format!("{MAJOR}.{MINOR}"),
            daemon_version: env!("CARGO_PKG_VERSION").into(),
            session: facts.id.session,
            config: facts.id.config,
            rate_hz: facts.sample_rate_hz / f64::from(average),
            average,
            group_delay_s: f64::from(average - 1) / 2.0 / facts.sample_rate_hz,
            model: match facts.model {
                Model::Ray => "ray".into(),
                Model::Gaussian => "gaussian".into(),
            },
            calibrated: facts.calibration.is_valid(),
            uncalibrated: facts.calibration.objection(),
            calibration: calibration_entry(&facts.calibration, facts.expires_days),
            systematic: facts.systematic,
            deviations: facts.deviations.name().into(),
            units: words(&[
                ("length", "m"),
                ("angle", "rad"),
                ("power", "W"),
                ("time", "ns since 1970, UTC"),
            ]),
            coordinates: words(&[
                (
                    "world",
                    "origin at the nominal apex, z up, x towards PSD A; nominally the laser falls along -z",
                ),
                ("pose", "position of the apex and rotation of the mirror in the world"),
                (
                    "beam_offset",
                    "beam centre minus apex, across the beam (world x and y for a vertical beam)",
                ),
                ("spots", "on each PSD, u horizontal, v up, from the centre of its area"),
            ]),
            euler: "R = Rz(yaw) * Ry(pitch) * Rx(roll), rotation = (roll, pitch, yaw)".into(),
            status_bits: Status::NAMES.iter().map(|(_, name)| (*name).to_owned()).collect(),
            lock_states: LockState::ALL.iter().map(|l| l.name().to_owned()).collect(),
            fields: FIELDS.iter().map(FieldEntry::from).collect(),
            columns: COLUMNS.map(str::to_owned).to_vec(),
            replay: None,
            stream: None,
        }
    }
}

/// What the record of a calibration states.
pub fn calibration_entry(
    calibration: &CalibrationState,
    expires_days: Option<f64>,
) -> Option<CalibrationEntry> {
    let record = calibration.record.as_ref()?;
    let ([x, y, z], [roll, pitch, yaw]) = (record.std_um, record.std_urad);
    Some(CalibrationEntry {
        date: record.date.clone(),
        method: record.method.clone(),
        range: [record.range_mm / 1e3, record.range_mrad / 1e3],
        uncertainty: [x, y, z, roll, pitch, yaw].map(|micro| micro * 1e-6),
        expires: calibration.expiry(expires_days).map(|end| end.to_string()),
    })
}

fn words(pairs: &[(&str, &str)]) -> BTreeMap<String, String> {
    pairs.iter().map(|(key, value)| ((*key).to_owned(), (*value).to_owned())).collect()
}

/// The heartbeat of a client: frames sent to it, frames dropped for it, all counters of the daemon, and the
/// cause of the lock state.
pub fn heartbeat(sent: u64, dropped: u64, counters: &Counters, lock: Option<LockEvent>) -> Heartbeat {
    let counters = counters.list().into_iter().map(|(name, count)| (name.to_owned(), count)).collect();
    Heartbeat { sent, dropped, counters, lock }
}
