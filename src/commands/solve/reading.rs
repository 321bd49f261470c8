//! A row of signals: spots and powers, with their noise.

use nalgebra::Matrix2;
use trifacet::config::{AssemblyError, Config};
use trifacet_core::channels::PsdChannels;
use trifacet_optics::calibration::result::Raw;
use trifacet_optics::{FACETS, Model, Noise, Sensitivity, Signals};
use trifacet_wire::layout::{self, SPOTS};

use super::super::table::Column;
use super::super::trace::{POWERS, needed};

/// Columns of the standard uncertainties of the signals.
const STD_SPOTS: [&str; 6] = ["std_u_a_m", "std_v_a_m", "std_u_b_m", "std_v_b_m", "std_u_c_m", "std_v_c_m"];
const STD_POWERS: [&str; 3] = ["std_power_a", "std_power_b", "std_power_c"];

/// Step for the derivative of a correction, metres: above the noise, below the pitch of a table.
const STEP: f64 = 10e-6;

/// How rows are read.
pub(super) struct Readings {
    model: Model,
    /// The channels whose corrections and gains apply; `None`: the signals are true ones.
    channels: Option<[PsdChannels; 3]>,
    spot_noise: f64,
    /// Relative.
    power_noise: f64,
}

/// The signals of a row.
pub(super) struct Reading {
    /// True spots and powers.
    pub(super) signals: Signals,
    /// Standard uncertainties of the readings.
    pub(super) noise: Noise,
    /// Derivatives of the true spots with respect to the readings, and of the powers.
    pub(super) slopes: Slopes,
    /// The signals as they are in the row.
    pub(super) raw: Raw,
    /// Spots that are outside the calibrated area.
    pub(super) warning: Option<String>,
}

/// Derivatives of true signals with respect to readings.
pub(super) struct Slopes {
    spots: [Matrix2<f64>; 3],
    powers: [f64; 3],
}

impl Readings {
    /// `as_read`: the signals are readings, from before correction tables and power gains.
    pub(super) fn new(config: &Config, as_read: bool, model: Model) -> Result<Self, AssemblyError> {
        Ok(Self {
            model,
            channels: if as_read { Some(config.read_channels()?.psds) } else { None },
            spot_noise: config.estimation.spot_noise_um * 1e-6,
            power_noise: config.estimation.power_noise,
        })
    }

    pub(super) fn model(&self) -> Model {
        self.model
    }

    /// The columns of a row. Those of standard uncertainties are optional.
    pub(super) fn columns(&self, sigma: bool) -> Vec<Column> {
        let optional = |name| Column { name, alias: None, default: Some(f64::NAN) };
        let mut columns: Vec<_> = needed(&SPOTS).collect();
        if self.model == Model::Gaussian {
            // `watch` and `export` name the powers with their unit.
            let powers = needed(&POWERS).zip(layout::POWERS);
            columns.extend(powers.map(|(column, watts)| Column { alias: Some(watts), ..column }));
        }
        if sigma {
            columns.extend(STD_SPOTS.map(optional));
            if self.model == Model::Gaussian {
                columns.extend(STD_POWERS.map(optional));
            }
        }
        columns
    }

    /// Reads the numbers of a row, in the order of the columns.
    pub(super) fn read(&self, numbers: &[f64]) -> Result<Reading, String> {
        let mut numbers = numbers.iter().copied();
        let mut take = |count: usize| -> Vec<f64> {
            (0..count).map(|_| numbers.next().unwrap_or(f64::NAN)).collect() // a column that was not asked for
        };
        let powers_read = if self.model == Model::Gaussian { 3 } else { 0 };
        let (spots, powers) = (take(6), take(powers_read));
        let (std_spots, std_powers) = (take(6), take(powers_read));
        let read = |from: &[f64], i: usize| from.get(i).copied().unwrap_or(f64::NAN);
        let mut signals = Signals {
            spots: std::array::from_fn(|i| read(&spots, i)),
            powers: std::array::from_fn(|i| read(&powers, i)),
        };
        let raw = Raw { spots: signals.spots, powers: signals.powers };
        let noise = self.noise(&signals, &std_spots, &std_powers)?;
        let (slopes, warning) = self.correct(&mut signals);
        Ok(Reading { signals, noise, slopes, raw, warning })
    }

    /// The stated standard uncertainties; the configured ones where a column is absent.
    fn noise(&self, signals: &Signals, spots: &[f64], powers: &[f64]) -> Result<Noise, String> {
        let named = STD_SPOTS.iter().zip(spots).chain(STD_POWERS.iter().zip(powers));
        if let Some((name, sigma)) = named.into_iter().find(|(_, sigma)| **sigma < 0.0) {
            return Err(format!("{name} is {sigma}: allowed is at least 0"));
        }
        let stated = |stated: &[f64], i: usize, configured: f64| {
            stated.get(i).copied().filter(|sigma| !sigma.is_nan()).unwrap_or(configured)
        };
        Ok(Noise {
            spots: std::array::from_fn(|i| stated(spots, i, self.spot_noise)),
            powers: std::array::from_fn(|i| {
                let configured = self.power_noise * signals.powers[i].abs();
                // The ray model does not use the powers.
                stated(powers, i, if configured.is_nan() { 0.0 } else { configured })
            }),
        })
    }

    /// Turns readings into true signals.
    fn correct(&self, signals: &mut Signals) -> (Slopes, Option<String>) {
        let mut slopes = Slopes { spots: [Matrix2::identity(); 3], powers: [1.0; 3] };
        let mut uncovered = Vec::new();
        for (i, psd) in self.channels.iter().flatten().enumerate() {
            let spot = [signals.spots[2 * i], signals.spots[2 * i + 1]];
            let corrected = psd.corrected(spot);
            slopes.spots[i] = slope(psd, spot);
            slopes.powers[i] = psd.gain[2];
            [signals.spots[2 * i], signals.spots[2 * i + 1]] = corrected.spot;
            signals.powers[i] *= psd.gain[2];
            if !corrected.covered {
                uncovered.push(FACETS[i].to_string());
            }
        }
        let psds = uncovered.join(", ");
        let warning =
            format!("warning: outside the calibrated area of PSD {psds}: the uncertainty does not hold");
        (slopes, (!uncovered.is_empty()).then_some(warning))
    }
}

/// The derivative of a corrected spot, by central differences.
fn slope(psd: &PsdChannels, [u, v]: [f64; 2]) -> Matrix2<f64> {
    if psd.correction.is_none() {
        return Matrix2::identity();
    }
    let by = |ahead: [f64; 2], behind: [f64; 2]| {
        let [ahead, behind] = [ahead, behind].map(|spot| psd.corrected(spot).spot);
        [0, 1].map(|k| (ahead[k] - behind[k]) / (2.0 * STEP))
    };
    let [by_u, by_v] = [by([u + STEP, v], [u - STEP, v]), by([u, v + STEP], [u, v - STEP])];
    Matrix2::new(by_u[0], by_v[0], by_u[1], by_v[1])
}

/// The sensitivity to the readings, from that to the true signals.
pub(super) fn before_tables(true_signals: &Sensitivity, slopes: &Slopes) -> Sensitivity {
    let mut matrix = true_signals.0;
    for i in 0..3 {
        let spot = matrix.fixed_columns::<2>(2 * i) * slopes.spots[i];
        matrix.fixed_columns_mut::<2>(2 * i).copy_from(&spot);
        let power = matrix.column(6 + i) * slopes.powers[i];
        matrix.set_column(6 + i, &power);
    }
    Sensitivity(matrix)
}
