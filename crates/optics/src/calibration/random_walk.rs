//! A random walk, smoothed from noisy values at some times.

/// A value at a time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Visit {
    pub time: f64,
    pub value: f64,
    /// Of the noise of the value.
    pub variance: f64,
}

/// The rates among which the most likely one is chosen: mean step between visits in units of the mean noise, by factors
/// of the root of two.
const SMALLEST_STEP: f64 = 1.0 / 64.0;
const STEPS: i32 = 40;

/// The smoothed course of a random walk: at each visit its most probable value, less the mean over the visits, and its
/// variance.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Walk {
    /// Growth of the variance per unit of time.
    rate: f64,
    nodes: Vec<Node>,
}

#[derive(Clone, Copy, Debug, PartialEq)]
struct Node {
    time: f64,
    value: f64,
    variance: f64,
    /// Covariance with the value at the next visit.
    with_next: f64,
}

impl Walk {
    /// The walk through these visits, which ascend in time; at least one. Its rate is the most likely one.
    pub fn new(visits: &[Visit]) -> Self {
        let n = visits.len() as f64;
        let noise = visits.iter().map(|v| v.variance).sum::<f64>() / n;
        let span = visits.last().map_or(0.0, |last| last.time - visits[0].time);
        let unit = if span > 0.0 { noise * (n - 1.0) / span } else { 0.0 };
        let rates = (0..=STEPS).map(|k| unit * SMALLEST_STEP.powi(2) * 2.0_f64.powi(k));
        let likely = |rate: f64| filter(visits, rate).1;
        let rate = rates.max_by(|a, b| likely(*a).total_cmp(&likely(*b))).unwrap_or(0.0);
        let mut nodes = smooth(visits, rate);
        let mean = nodes.iter().map(|node| node.value).sum::<f64>() / n;
        for node in &mut nodes {
            node.value -= mean;
        }
        Self { rate, nodes }
    }

    /// Largest difference between two visits.
    pub fn range(&self) -> f64 {
        let values = || self.nodes.iter().map(|node| node.value);
        values().fold(f64::NEG_INFINITY, f64::max) - values().fold(f64::INFINITY, f64::min)
    }

    /// Value and variance at a time: a line between two visits, the value of the nearest one outside of them.
    pub fn at(&self, time: f64) -> (f64, f64) {
        let next = self.nodes.partition_point(|node| node.time <= time);
        let outside = |node: &Node| (node.value, node.variance + self.rate * (time - node.time).abs());
        match (next.checked_sub(1).and_then(|k| self.nodes.get(k)), self.nodes.get(next)) {
            (Some(a), Some(b)) => {
                let gap = b.time - a.time;
                let (q, p) = ((time - a.time) / gap, (b.time - time) / gap);
                let ends = p * p * a.variance + q * q * b.variance + 2.0 * p * q * a.with_next;
                (p * a.value + q * b.value, ends + self.rate * gap * p * q)
            }
            (Some(end), None) | (None, Some(end)) => outside(end),
            (None, None) => (0.0, 0.0),
        }
    }
}

/// Value and variance at each visit, by it and those before; and the logarithm of the likelihood of all values after the
/// first, up to a constant.
fn filter(visits: &[Visit], rate: f64) -> (Vec<(f64, f64)>, f64) {
    let mut states: Vec<(f64, f64)> = Vec::with_capacity(visits.len());
    let mut ln_likelihood = 0.0;
    for (k, visit) in visits.iter().enumerate() {
        let Some((value, variance)) = states.last().copied() else {
            states.push((visit.value, visit.variance));
            continue;
        };
        let expected = variance + rate * (visit.time - visits[k - 1].time);
        let (total, missing) = (expected + visit.variance, visit.value - value);
        ln_likelihood -= 0.5 * (total.ln() + missing * missing / total);
        let gain = expected / total;
        states.push((value + gain * missing, expected * (1.0 - gain)));
    }
    (states, ln_likelihood)
}

/// The states by all visits, before and after (Rauch, Tung and Striebel).
fn smooth(visits: &[Visit], rate: f64) -> Vec<Node> {
    let (states, _) = filter(visits, rate);
    let mut nodes: Vec<Node> = Vec::with_capacity(visits.len());
    for (k, (value, variance)) in states.iter().copied().enumerate().rev() {
        let time = visits[k].time;
        let Some(next) = nodes.last() else {
            nodes.push(Node { time, value, variance, with_next: 0.0 });
            continue;
        };
        let expected = variance + rate * (next.time - time);
        let gain = if expected > 0.0 { variance / expected } else { 1.0 };
        nodes.push(Node {
            time,
            value: value + gain * (next.value - value),
            variance: variance + gain * gain * (next.variance - expected),
            with_next: gain * next.variance,
        });
    }
    nodes.reverse();
    nodes
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Visits at times 0, 1, ... of this course, with noise of 1 that does not repeat.
    fn visits(course: impl Fn(f64) -> f64) -> Vec<Visit> {
        let noise = [0.3, -1.1, 0.8, 1.4, -0.6, -0.2, 0.9, -1.5, 0.1, 0.5, -0.9, 1.2, -0.4];
        let visit = |(k, noise): (usize, f64)| {
            let time = k as f64;
            Visit { time, value: course(time) + noise, variance: 1.0 }
        };
        noise.into_iter().enumerate().map(visit).collect()
    }

    #[test]
    fn a_course_far_above_the_noise_is_followed_and_noise_alone_is_not() {
        let walk = Walk::new(&visits(|t| 20.0 * t));
        assert!((walk.range() - 240.0).abs() < 4.0, "{walk:?}");
        let (value, variance) = walk.at(5.5);
        assert!(
            (value - (110.0 - 120.0)).abs() < 3.0 && variance > 1.0 && variance < 200.0,
            "{value} {variance}"
        );
        let still = Walk::new(&visits(|_| 7.0));
        assert!(still.range() < 0.7, "{still:?}");
        assert!(still.at(5.5).1 < 0.3);
    }

    #[test]
    fn between_visits_and_outside_of_them_less_is_known() {
        let walk = Walk::new(&visits(|t| 20.0 * t));
        let at = |time| walk.at(time).1;
        assert!(at(4.5) > at(4.0) && at(14.0) > at(12.0) && at(-1.0) > at(0.0));
        assert!((walk.at(4.0 - 1e-9).0 - walk.at(4.0).0).abs() < 1e-6);
        assert_eq!(walk.at(-3.0).0, walk.at(0.0).0);
    }

    #[test]
    fn visits_at_the_same_time_are_averaged() {
        let together = [1.0, 3.0].map(|value| Visit { time: 2.0, value, variance: 1.0 });
        let walk = Walk::new(&together);
        assert_eq!((walk.range(), walk.at(2.0)), (0.0, (0.0, 0.5)));
    }
}
