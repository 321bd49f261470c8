//! The drift since the calibration, for occasional readers.

use super::known_number::KnownNumber;

/// Written by the estimation task, read on demand. The numbers are not read in one step.
#[derive(Debug, Default)]
pub struct DriftGauge {
    residual: [KnownNumber; 2],
    limit: KnownNumber,
    power_gains: [KnownNumber; 2],
    dark: [KnownNumber; 3],
}

/// What has changed since the calibration. Unknown until it is measured.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Drift {
    /// Slow mean of the steering residual less that of the calibration, x and y, metres.
    pub residual: Option<[f64; 2]>,
    /// Length of this difference that the combined uncertainty allows, metres.
    pub limit: Option<f64>,
    /// Relative changes of the power gains of PSD B and C against A that would explain this difference.
    pub power_gains: Option<[f64; 2]>,
    /// Dark readings of the sums of PSD A, B, C less those of the calibration, in parts of their usual power.
    pub dark: Option<[f64; 3]>,
}

impl DriftGauge {
    /// Records the residual, its limit, and what it says about the power gains; `None`: nothing is known.
    pub fn set_residual(
        &self,
        residual: Option<[f64; 2]>,
        limit: Option<f64>,
        power_gains: Option<[f64; 2]>,
    ) {
        write(&self.residual, residual);
        self.limit.set(limit);
        write(&self.power_gains, power_gains);
    }

    /// Records the dark readings; `None`: nothing is known.
    pub fn set_dark(&self, dark: Option<[f64; 3]>) {
        write(&self.dark, dark);
    }

    /// What is known now.
    pub fn get(&self) -> Drift {
        Drift {
            residual: read(&self.residual),
            limit: self.limit.get(),
            power_gains: read(&self.power_gains),
            dark: read(&self.dark),
        }
    }
}

fn write<const N: usize>(numbers: &[KnownNumber; N], values: Option<[f64; N]>) {
    for (i, number) in numbers.iter().enumerate() {
        number.set(values.map(|values| values[i]));
    }
}

fn read<const N: usize>(numbers: &[KnownNumber; N]) -> Option<[f64; N]> {
    let mut values = [0.0; N];
    for (value, number) in values.iter_mut().zip(numbers) {
        *value = number.get()?;
    }
    Some(values)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_not_measured_is_unknown() {
        let gauge = DriftGauge::default();
        assert_eq!(gauge.get(), Drift::default());
        gauge.set_residual(Some([1e-7, -2e-7]), Some(1e-6), Some([0.01, 0.0]));
        gauge.set_dark(Some([0.0, 1e-3, 0.0]));
        let drift = gauge.get();
        assert_eq!((drift.residual, drift.dark), (Some([1e-7, -2e-7]), Some([0.0, 1e-3, 0.0])));
        gauge.set_residual(None, None, None);
        assert_eq!(gauge.get(), Drift { dark: drift.dark, ..Drift::default() });
    }
}
