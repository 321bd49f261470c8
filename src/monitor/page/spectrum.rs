//! Amplitude spectral density of the six axes by Welch's method: Hann windows with an overlap of one half,
//! the mean of each removed, averaged exponentially, from every pose at the full rate. Pure.
//!
//! Source: Welch 1967, "The use of fast Fourier transform for the estimation of power spectra", IEEE Trans.
//! Audio Electroacoust. 15.

use std::f64::consts::PI;
use std::fmt;
use std::sync::Arc;

use rustfft::num_complex::Complex64;
use rustfft::{Fft, FftPlanner};
use serde::Serialize;
use trifacet_wire::PoseFrame;

/// Longest segment: 0.8 s at 10 kHz.
const LONGEST: usize = 8192;
/// Shortest segment. At the lowest rates it lasts longer than a second.
const SHORTEST: usize = 64;
/// Effective number of segments in the average.
const AVERAGED: f64 = 16.0;
/// Most lines shown per decade.
const PER_DECADE: f64 = 100.0;

/// Collects segments and averages their spectra.
pub struct Welch {
    rate_hz: f64,
    fft: Arc<dyn Fft<f64>>,
    window: Vec<f64>,
    /// Poses of the current segment.
    segment: Vec<[f64; 6]>,
    /// Mean power density per line, unit^2/Hz.
    density: [Vec<f64>; 6],
    segments: u32,
    /// Time of the last pose in the average, UTC.
    until_ns: i64,
    /// Sequence number of the previous frame.
    sequence: u64,
}

/// The spectrum as shown on the page.
#[derive(Clone, Debug, Serialize)]
pub struct Spectrum {
    /// Segments so far. With few segments the spectrum is noisy.
    pub segments: u32,
    /// Time of the last pose in the average, milliseconds of UTC since 1970.
    pub until_ms: f64,
    /// Distance of adjacent lines before they are combined, Hz.
    pub resolution_hz: f64,
    /// Frequencies, Hz.
    pub hz: Vec<f32>,
    /// Amplitude spectral density per axis: m/sqrt(Hz), rad/sqrt(Hz).
    pub asd: [Vec<f32>; 6],
}

impl Welch {
    /// An average for `rate_hz` poses per second, with segments of about a second.
    pub fn new(rate_hz: f64) -> Self {
        let n = (rate_hz.max(1.0) as usize).next_power_of_two().clamp(SHORTEST, LONGEST);
        let window = (0..n).map(|i| 0.5 - 0.5 * (2.0 * PI * i as f64 / n as f64).cos()).collect();
        Self {
            rate_hz,
            fft: FftPlanner::new().plan_fft_forward(n),
            window,
            segment: Vec::with_capacity(n),
            density: std::array::from_fn(|_| vec![0.0; n / 2]),
            segments: 0,
            until_ns: 0,
            sequence: 0,
        }
    }

    /// Rate of the poses, Hz.
    pub fn rate_hz(&self) -> f64 {
        self.rate_hz
    }

    /// Takes every frame in turn. A segment with a gap is discarded.
    pub fn frame(&mut self, frame: &PoseFrame) {
        let whole = frame.lost == 0 && frame.sequence == self.sequence + 1;
        self.sequence = frame.sequence;
        if frame.pose[0].is_nan() || !whole {
            self.segment.clear();
        }
        if frame.pose[0].is_nan() {
            return;
        }
        self.segment.push(frame.pose);
        if self.segment.len() == self.window.len() {
            self.add();
            self.until_ns = frame.time_ns;
            self.segment.drain(..self.window.len() / 2);
        }
    }

    fn add(&mut self) {
        self.segments = self.segments.saturating_add(1);
        let weight = f64::max(1.0 / f64::from(self.segments), 1.0 / AVERAGED);
        let n = self.window.len() as f64;
        let norm = 2.0 / (self.rate_hz * self.window.iter().map(|w| w * w).sum::<f64>());
        // Two real axes in one complex transform.
        for pair in 0..3 {
            let (a, b) = (2 * pair, 2 * pair + 1);
            let mean = |axis: usize| self.segment.iter().map(|pose| pose[axis]).sum::<f64>() / n;
            let (mean_a, mean_b) = (mean(a), mean(b));
            let windowed = self.segment.iter().zip(&self.window);
            let mut z: Vec<_> =
                windowed.map(|(pose, w)| Complex64::new(pose[a] - mean_a, pose[b] - mean_b) * *w).collect();
            self.fft.process(&mut z);
            for line in 1..z.len() / 2 {
                let (p, q) = (z[line], z[z.len() - line].conj());
                for (axis, part) in [(a, p + q), (b, p - q)] {
                    let density = &mut self.density[axis][line];
                    *density += (norm * part.norm_sqr() / 4.0 - *density) * weight;
                }
            }
        }
    }

    /// The average so far; `None` before the first segment.
    pub fn spectrum(&self) -> Option<Spectrum> {
        if self.segments == 0 {
            return None;
        }
        let resolution_hz = self.rate_hz / self.window.len() as f64;
        let mut shown = Spectrum {
            segments: self.segments,
            until_ms: self.until_ns as f64 * 1e-6,
            resolution_hz,
            hz: vec![],
            asd: <_>::default(),
        };
        let mut line = 1;
        while line < self.density[0].len() {
            // Combined lines show their mean power density.
            let next = (line as f64 * 10f64.powf(1.0 / PER_DECADE)).floor() as usize;
            let next = next.clamp(line + 1, self.density[0].len());
            shown.hz.push(((line + next - 1) as f64 / 2.0 * resolution_hz) as f32);
            for (asd, density) in shown.asd.iter_mut().zip(&self.density) {
                let mean = density[line..next].iter().sum::<f64>() / (next - line) as f64;
                asd.push(mean.sqrt() as f32);
            }
            line = next;
        }
        Some(shown)
    }
}

impl fmt::Debug for Welch {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Welch").field("rate_hz", &self.rate_hz).finish_non_exhaustive()
    }
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_distr::StandardNormal;

    use super::*;

    fn fed(rate_hz: f64, seconds: f64, mut x: impl FnMut(usize, f64) -> f64) -> Welch {
        let mut welch = Welch::new(rate_hz);
        let frame = PoseFrame { lost: 0, ..PoseFrame::example() };
        for i in 0..(seconds * rate_hz) as usize {
            let pose = std::array::from_fn(|axis| x(axis, i as f64 / rate_hz));
            let time_ns = (i as f64 / rate_hz * 1e9) as i64;
            welch.frame(&PoseFrame { pose, time_ns, sequence: i as u64, ..frame });
        }
        welch
    }

    /// The power of a sine of amplitude A is A^2 / 2, wherever it lies between two lines.
    #[test]
    fn a_sine_has_its_amplitude_on_its_axis_only() {
        for (rate_hz, f_hz) in [(1000.0, 50.0), (10_000.0, 437.21), (125.0, 11.3)] {
            let welch = fed(rate_hz, 40.0, |axis, t| {
                let amplitude = if axis == 1 { 3e-6 } else { 1e-9 * axis as f64 };
                7e-3 + amplitude * (2.0 * PI * f_hz * t).sin()
            });
            let width = rate_hz / welch.window.len() as f64;
            for axis in 0..6 {
                let amplitude = (2.0 * welch.density[axis].iter().sum::<f64>() * width).sqrt();
                let wanted = if axis == 1 { 3e-6 } else { 1e-9 * axis as f64 };
                assert!((amplitude - wanted).abs() < 1e-3 * wanted + 1e-14, "{rate_hz} {axis}: {amplitude}");
            }
            let peak = (0..welch.window.len() / 2)
                .max_by(|a, b| welch.density[1][*a].total_cmp(&welch.density[1][*b]));
            assert!((peak.unwrap() as f64 * width - f_hz).abs() <= width);
            if f_hz / width > 80.0 {
                continue; // adjacent lines are combined there
            }
            // The peak as shown. Hann windows have an equivalent noise bandwidth of 1.5 lines, and a loss of
            // at most 1.42 dB between two lines (Harris 1978, Proc. IEEE 66).
            let shown = welch.spectrum().unwrap();
            let top = shown.asd[1].iter().copied().fold(0.0, f32::max);
            let full = 3e-6 / (2.0 * 1.5 * width).sqrt();
            assert!(f64::from(top) < 1.01 * full && f64::from(top) > 0.84 * full, "{top} of {full}");
        }
    }

    #[test]
    fn white_noise_is_flat_at_its_density() {
        let mut rng = rand_pcg::Pcg64::seed_from_u64(1);
        let welch = fed(1000.0, 60.0, |_, _| 1e-6 * rng.sample::<f64, _>(StandardNormal));
        let shown = welch.spectrum().unwrap();
        let wanted = 1e-6 * (2.0 / 1000.0_f64).sqrt();
        let dense = shown.hz.iter().zip(&shown.asd[4]).filter(|(hz, _)| **hz > 20.0);
        let mean = dense.clone().map(|(_, x)| f64::from(*x)).sum::<f64>() / dense.count() as f64;
        assert!((mean / wanted - 1.0).abs() < 0.05, "{mean} instead of {wanted}");
        assert!(shown.hz.len() < 400 && shown.hz.is_sorted());
    }

    #[test]
    fn gaps_give_no_spectra() {
        let mut samples = 0;
        let welch = fed(1000.0, 20.0, |axis, _| {
            samples += usize::from(axis == 0);
            if samples.is_multiple_of(1000) { f64::NAN } else { 1e-6 }
        });
        assert!(welch.spectrum().is_none(), "every second has a gap");
        let welch = fed(1000.0, 20.0, |_, t| if t > 4.0 { f64::NAN } else { 1e-6 });
        let until_ms = welch.spectrum().unwrap().until_ms;
        assert!((3400.0..=4000.0).contains(&until_ms), "time of the last pose: {until_ms}");
    }
}
