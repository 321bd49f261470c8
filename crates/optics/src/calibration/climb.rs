//! The search for the most likely prior of the splines among those of a grid: from one to its neighbours, uphill. The
//! likelihood has one maximum over rms and length, and each prior costs a factorisation.

use super::map::Field;

/// The priors with the same knots, and which of them have been judged.
#[derive(Debug)]
pub(super) struct Climb<'a> {
    fields: &'a [Field],
    /// The climb begins with the prior nearest to this one.
    start: Field,
    judged: Vec<Option<f64>>,
    /// The one that was given out last.
    at: Option<usize>,
}

impl<'a> Climb<'a> {
    /// Begins near `start`, whatever its knots.
    pub fn new(fields: &'a [Field], start: Field) -> Self {
        Self { fields, start, judged: vec![None; fields.len()], at: None }
    }

    /// The next prior to judge; `None` when none next to the best one is better.
    pub fn next(&mut self) -> Option<Field> {
        let value = |k: &usize| self.judged[*k].unwrap_or(f64::NEG_INFINITY);
        let known = (0..self.fields.len()).filter(|k| self.judged[*k].is_some());
        let best = known.max_by(|a, b| value(a).total_cmp(&value(b)));
        self.at = match best {
            None => (0..self.fields.len()).min_by(|a, b| self.far(*a).total_cmp(&self.far(*b))),
            Some(best) => {
                (0..self.fields.len()).find(|k| self.judged[*k].is_none() && self.neighbours(best, *k))
            }
        };
        self.at.map(|k| self.fields[k])
    }

    /// How far a prior is from that with which the climb begins.
    fn far(&self, k: usize) -> f64 {
        let ratio = |a: f64, b: f64| (a / b).ln().abs();
        ratio(self.fields[k].rms, self.start.rms) + ratio(self.fields[k].length, self.start.length)
    }

    /// The likelihood of the prior that was given out last.
    pub fn judged(&mut self, ln_likelihood: f64) {
        if let Some(k) = self.at {
            self.judged[k] = Some(ln_likelihood);
        }
    }

    /// Whether two priors are neighbours of the grid: no other one lies between them along rms or length. The likelihood
    /// has a ridge along which both grow; the neighbours across it are left out.
    fn neighbours(&self, a: usize, b: usize) -> bool {
        let (a, b) = (&self.fields[a], &self.fields[b]);
        let apart = |of: fn(&Field) -> f64| {
            let (low, high) = (of(a).min(of(b)), of(a).max(of(b)));
            self.fields.iter().map(of).any(|x| x > low && x < high)
        };
        let across = (a.rms - b.rms) * (a.length - b.length) < 0.0;
        !across && !apart(|f| f.rms) && !apart(|f| f.length)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::calibration::fit::{USUAL_FIELD, fields};

    /// Climbs a hill with its top at these logarithms; returns the last best and the number of judged priors.
    fn climbed(rms: f64, length: f64) -> (Field, usize) {
        let all: Vec<Field> = fields().into_iter().filter(|f| f.knots == USUAL_FIELD.knots).collect();
        let height = |f: &Field| {
            let (a, b) = ((f.rms / rms).ln(), (f.length / length).ln());
            -(a * a + b * b - a * b)
        };
        let (mut climb, mut seen) = (Climb::new(&all, USUAL_FIELD), Vec::new());
        while let Some(field) = climb.next() {
            climb.judged(height(&field));
            seen.push(field);
        }
        let best = *seen.iter().max_by(|a, b| height(a).total_cmp(&height(b))).unwrap();
        let highest = *all.iter().max_by(|a, b| height(a).total_cmp(&height(b))).unwrap();
        assert_eq!(best, highest);
        (best, seen.len())
    }

    #[test]
    fn the_top_of_the_grid_is_found_without_judging_all() {
        let all = fields().len() / 2;
        for (rms, length) in [(2e-6, 0.5e-3), (0.5e-6, 1e-3), (0.1e-6, 3e-3), (9e-6, 0.6e-3), (1e-6, 0.7e-3)]
        {
            let (best, judged) = climbed(rms, length);
            assert!(judged < all, "{best:?} {judged} of {all}");
        }
    }

    #[test]
    fn a_single_prior_is_judged_once() {
        let one = [Field { knots: 0.5e-3, rms: 7e-6, length: 2e-3 }];
        let mut climb = Climb::new(&one, USUAL_FIELD);
        assert_eq!(climb.next(), Some(one[0]));
        climb.judged(-1.0);
        assert_eq!(climb.next(), None);
    }
}
