//! How the mirror splits a Gaussian beam.
//!
//! Seen along the beam, each facet is a wedge with its tip at the apex, between two of the three edges of the
//! pyramid. Its power and centroid follow in closed form from quantities of these two edges. Each edge serves
//! two facets, so that the three powers add up to exactly one.
//!
//! Everything here is in the beam frame (light along -z) and across the beam. `d` is the offset of the beam
//! centre from the apex in units of `sigma`, the standard deviation of the beam per axis (a quarter of the
//! 1/e^2 diameter).

use std::f64::consts::{FRAC_1_SQRT_2, PI, TAU};

use nalgebra::{Matrix2, Matrix2x3};

use super::{Vec2, Vec3};

/// A facet with less than this fraction of the beam is dark: its light has no usable centroid.
pub const DARK: f64 = 1e-12;

/// 1/sqrt(2 pi).
const INV_SQRT_TAU: f64 = 0.398_942_280_401_432_7;

/// An edge of the pyramid, with the light around it.
#[derive(Clone, Copy, Debug)]
struct Edge {
    /// Unit vector along the edge, away from the apex.
    e: Vec2,
    /// Unit vector across it, counter-clockwise.
    m: Vec2,
    /// Derivative of the azimuth of the edge with respect to a rotation of the mirror.
    turn: Vec3,
    /// `m . d`: distance of the beam from the edge.
    h: f64,
    /// Density along the edge: `exp(-h^2/2) Phi(b) / sqrt(2 pi)`, with `b = e . d`.
    l: f64,
    /// First moment of the density along the edge: power per radian that the edge sweeps.
    f: f64,
    /// Density at the apex.
    q: f64,
    /// Power that the edge moves from the facet before it to the facet behind it.
    g: f64,
}

/// The light on one facet.
#[derive(Clone, Copy, Debug)]
pub struct Wedge {
    /// Fraction of the beam.
    pub power: f64,
    /// First moment of the light about the beam centre, in units of sigma; also dP/dd.
    pub moment: Vec2,
}

/// Derivatives of a [`Wedge`].
#[derive(Clone, Copy, Debug)]
pub struct WedgeSlopes {
    /// dP/dw for a rotation w of the mirror.
    pub power_turn: Vec3,
    /// d(moment)/dd.
    pub moment_offset: Matrix2<f64>,
    /// d(moment)/dw.
    pub moment_turn: Matrix2x3<f64>,
}

/// A beam on the three edges of a mirror.
#[derive(Clone, Copy, Debug)]
pub struct Split {
    edges: [Edge; 3],
    angles: [f64; 3],
}

impl Split {
    /// The beam at offset `d` (in units of sigma) on a mirror with these facet normals.
    ///
    /// Edge `i` lies between facet `i` and the next one counter-clockwise.
    #[inline(always)]
    pub fn new(normals: &[Vec3; 3], d: Vec2) -> Self {
        let [a, b, c] = normals;
        let q = (-0.5 * d.norm_squared()).exp() / TAU;
        let edges =
            [Edge::new(&b.cross(a), d, q), Edge::new(&c.cross(b), d, q), Edge::new(&a.cross(c), d, q)];
        let first = angle(edges[2].e, edges[0].e);
        let second = angle(edges[0].e, edges[1].e);
        Self { edges, angles: [first, second, TAU - first - second] }
    }

    #[inline(always)]
    fn around(&self, facet: usize) -> (&Edge, &Edge) {
        (&self.edges[(facet + 2) % 3], &self.edges[facet])
    }

    /// The light on a facet.
    #[inline(always)]
    pub fn wedge(&self, facet: usize) -> Wedge {
        let (lo, hi) = self.around(facet);
        Wedge { power: self.angles[facet] / TAU - hi.g + lo.g, moment: lo.m * lo.l - hi.m * hi.l }
    }

    /// Derivatives of the light on a facet with respect to offset and rotation.
    #[inline(always)]
    pub fn jacobian(&self, facet: usize) -> WedgeSlopes {
        let (lo, hi) = self.around(facet);
        WedgeSlopes {
            power_turn: hi.turn * hi.f - lo.turn * lo.f,
            moment_offset: hi.moment_offset() - lo.moment_offset(),
            moment_turn: hi.moment_turn() - lo.moment_turn(),
        }
    }
}

impl Edge {
    #[inline(always)]
    fn new(along: &Vec3, d: Vec2, q: f64) -> Self {
        let length = along.xy().norm();
        let e = along.xy() / length;
        let m = Vec2::new(-e.y, e.x);
        let (b, h) = (e.dot(&d), m.dot(&d));
        let l = (-0.5 * h * h).exp() * phi(b) * INV_SQRT_TAU;
        Self {
            e,
            m,
            turn: Vec3::new(-along.z * m.y, along.z * m.x, along.x * m.y - along.y * m.x) / length,
            h,
            l,
            f: q + b * l,
            q,
            g: 0.25 * libm::erf(h * FRAC_1_SQRT_2) + owen_v(h, b),
        }
    }

    #[inline(always)]
    fn moment_offset(&self) -> Matrix2<f64> {
        self.m * (self.m * (self.h * self.l) - self.e * self.q).transpose()
    }

    #[inline(always)]
    fn moment_turn(&self) -> Matrix2x3<f64> {
        (self.e * self.l - self.m * (self.h * self.f)) * self.turn.transpose()
    }
}

/// The angle from `from` counter-clockwise to `to`, both of unit length, below pi.
#[inline(always)]
fn angle(from: Vec2, to: Vec2) -> f64 {
    let (sin, cos) = (from.perp(&to), from.dot(&to));
    // At about a third of a circle, as on all practical mirrors, the arc sine is four times cheaper.
    let (sin60, cos60) = (0.75_f64.sqrt(), 0.5);
    if sin * sin60 - cos * cos60 > cos60 {
        TAU / 3.0 - (cos * sin60 + sin * cos60).asin()
    } else {
        sin.atan2(cos)
    }
}

/// The normal distribution function.
fn phi(x: f64) -> f64 {
    0.5 + 0.5 * libm::erf(x * FRAC_1_SQRT_2)
}

/// Owen's V: the standard normal probability of the triangle (0, 0), (h, 0), (h, b); odd in both.
///
/// A power series near the apex. Far from it, where the series cancels, Owen's T function. Source: D. B.
/// Owen, "Tables for computing bivariate normal probabilities", Ann. Math. Statist. 27 (1956) 1075-1090.
#[inline(always)]
fn owen_v(h: f64, b: f64) -> f64 {
    let c = h * h + b * b;
    if c > 7.0 { owen_v_far(h, b) } else { h * b / (4.0 * PI) * v_series(0.5 * c, h * h) }
}

#[cold]
fn owen_v_far(h: f64, b: f64) -> f64 {
    if h == 0.0 { 0.0 } else { (b / h).atan() / TAU - owens_t::owens_t(h, b / h) }
}

/// Largest number of terms: enough for a rounding error of 1e-17 in the range of the series.
const TERMS: usize = 40;

/// 1/(k+1) and 1/(2k+1).
const RECIPROCALS: [(f64, f64); TERMS] = {
    let mut table = [(1.0, 1.0); TERMS];
    let mut k = 1;
    while k < TERMS {
        table[k] = (1.0 / (k as f64 + 1.0), 1.0 / (2.0 * k as f64 + 1.0));
        k += 1;
    }
    table
};

/// Sum of tau_k: tau_0 = 1, (2k+1) tau_k = zeta_k - k/(k+1) h^2 tau_(k-1), zeta_k = (-c/2)^k / (k+1)!.
#[inline(always)]
fn v_series(half_c: f64, h2: f64) -> f64 {
    let (mut sum, mut tau, mut zeta) = (1.0, 1.0, 1.0);
    for (by_k1, by_2k1) in &RECIPROCALS[1..] {
        zeta *= -half_c * by_k1;
        tau = (zeta - (1.0 - by_k1) * h2 * tau) * by_2k1;
        sum += tau;
        if tau.abs() < 1e-17 {
            break;
        }
    }
    sum
}
