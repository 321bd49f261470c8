//! Straight lines, averages, and minima of functions.

/// Orthonormal basis of the straight lines over the times of a window.
pub(super) struct Line {
    constant: Vec<f64>,
    slope: Vec<f64>,
}

impl Line {
    pub(super) fn new(times: &[f64]) -> Self {
        let n = times.len() as f64;
        let middle = times.iter().sum::<f64>() / n;
        let length = times.iter().map(|t| (t - middle).powi(2)).sum::<f64>().sqrt();
        let slope = times.iter().map(|t| (t - middle) / length).collect();
        Self { constant: vec![1.0 / n.sqrt(); times.len()], slope }
    }

    /// The least-squares line through `y`.
    pub(super) fn nearest(&self, y: &[f64]) -> Vec<f64> {
        let dot = |q: &[f64]| q.iter().zip(y).map(|(q, y)| q * y).sum::<f64>();
        let (a, b) = (dot(&self.constant), dot(&self.slope));
        self.constant.iter().zip(&self.slope).map(|(c, s)| a * c + b * s).collect()
    }

    pub(super) fn of(&self, times: &[f64], f: impl Fn(f64) -> f64) -> Vec<f64> {
        self.nearest(&times.iter().map(|t| f(*t)).collect::<Vec<_>>())
    }

    pub(super) fn taken_out_of(&self, y: &[f64]) -> Vec<f64> {
        y.iter().zip(self.nearest(y)).map(|(y, line)| y - line).collect()
    }

    pub(super) fn taken_out(&self, window: &[[f64; 2]]) -> Vec<[f64; 2]> {
        let [x, y] = [0, 1].map(|k| self.taken_out_of(&window.iter().map(|v| v[k]).collect::<Vec<_>>()));
        x.into_iter().zip(y).map(|(x, y)| [x, y]).collect()
    }
}

/// The second element of the pair with the smallest first one.
pub(super) fn least(of: impl Iterator<Item = (f64, f64)>) -> f64 {
    of.min_by(|a, b| a.0.total_cmp(&b.0)).map_or(0.0, |(_, x)| x)
}

/// Minimum of a function with a single valley, and its position, to a millionth of the range, by
/// golden-section search.
pub(super) fn golden([mut low, mut high]: [f64; 2], f: impl Fn(f64) -> f64) -> (f64, f64) {
    const PART: f64 = 0.618_033_988_749_895;
    let inner = |low: f64, high: f64| [high - PART * (high - low), low + PART * (high - low)];
    let mut x = inner(low, high);
    let mut y = x.map(&f);
    for _ in 0..29 {
        if y[0] < y[1] {
            high = x[1];
            x = [inner(low, high)[0], x[0]];
            y = [f(x[0]), y[0]];
        } else {
            low = x[0];
            x = [x[1], inner(low, high)[1]];
            y = [y[1], f(x[1])];
        }
    }
    if y[0] < y[1] { (y[0], x[0]) } else { (y[1], x[1]) }
}

pub(super) fn mean(values: Vec<f64>) -> f64 {
    let count = values.len() as f64;
    values.into_iter().sum::<f64>() / count
}

/// Median. `values` must not be empty.
pub(super) fn middle(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

/// Median, and the standard deviation estimated from the median absolute deviation (factor 1.4826 for a
/// normal distribution).
pub(super) fn middle_and_spread(values: &[f64]) -> (f64, f64) {
    let usual = middle(values.to_vec());
    (usual, 1.4826 * middle(values.iter().map(|v| (v - usual).abs()).collect()))
}
