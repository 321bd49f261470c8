//! The gauge: changes of the parameters that change no pose in the frame of the reference, so that no measurement
//! tells them. A rigid motion of the sensor's world (6), the axes of the mirror's frame (3), and the turn of each PSD
//! about its normal, which the linear part of its error undoes (3). The tolerances decide where the fit puts them.

use nalgebra::Vector2;

use super::linearised::{Layout, Neighbours, Response, coordinates};
use super::map::Lattice;
use super::parameters::{GEOMETRY, Nominal, Tolerances, parameters};
use super::point::{Known, Point};
use super::result::{Raw, radical_inverse};
use super::{Matrix, Vector};
use crate::Pose;

/// Number of directions of the gauge.
const DIRECTIONS: usize = 12;
/// Points of a measurement in which everything that can be determined is determined.
const POINTS: usize = 64;
/// Linear polynomials of a coordinate of a PSD; they are the first ones.
const LINEAR: usize = 2;

/// Part of the variance before the fit of each geometric parameter that no measurement can reduce, 0 to 1; `None` if
/// the nominal head cannot be measured.
pub fn shares(nominal: &Nominal, tolerances: &Tolerances) -> Option<Vec<f64>> {
    let (_, directions) = directions(nominal)?;
    let default = deviations(&Tolerances::default());
    let own = deviations(tolerances);
    let scaled = Matrix::from_fn(own.len(), DIRECTIONS, |i, j| directions[(i, j)] * default[i] / own[i]);
    let orthonormal = scaled.qr().q();
    Some((0..GEOMETRY).map(|i| orthonormal.row(i).norm_squared()).collect())
}

/// Tolerances of the geometric parameters and of the linear polynomials.
fn deviations(tolerances: &Tolerances) -> Vec<f64> {
    let geometry = parameters(tolerances).into_iter().map(|parameter| parameter.deviation);
    geometry.chain(std::iter::repeat_n(tolerances.psd_error_um[0] * 1e-6, 6 * LINEAR)).collect()
}

/// Singular values of a thorough measurement of the nominal head, ascending, and the directions of the smallest ones,
/// each parameter in units of its built-in tolerance.
fn directions(nominal: &Nominal) -> Option<(Vec<f64>, Matrix)> {
    let half_sizes = nominal.head.psds.map(|psd| psd.half_size);
    let lattices = half_sizes.map(|half| Lattice::of_cells(1e-3, half, Vec::new()));
    let layout = Layout { runs: 0, lattices, half_sizes };
    let theta = vec![0.0; layout.parameters()];
    let instruments = Neighbours::new(nominal, &theta);
    let linear = coordinates().flat_map(|(psd, k)| {
        let from = layout.polynomials(psd, k);
        from..from + LINEAR
    });
    let columns: Vec<usize> = (0..GEOMETRY).chain(linear).collect();
    let scale = Vector::from_vec(deviations(&Tolerances::default()));
    let mut rows = Vec::new();
    for k in 0..POINTS {
        let Some(point) = point(&instruments, k) else { continue };
        let basis = layout.basis(&point.spots, None);
        let response = Response::new(&layout, &instruments, &theta, (&point, &basis), None)?;
        let own = response.whitened(&instruments.centre, &point)?.jacobian;
        // Without splines, the columns of the basis are those of the layout.
        rows.extend(own.row_iter().map(|row| row.select_columns(&columns)));
    }
    if rows.len() < columns.len() {
        return None;
    }
    let mut jacobian = Matrix::from_rows(&rows);
    for (mut column, scale) in jacobian.column_iter_mut().zip(scale.iter()) {
        column *= *scale;
    }
    let svd = jacobian.svd(false, true);
    let mut order: Vec<usize> = (0..svd.singular_values.len()).collect();
    order.sort_by(|a, b| svd.singular_values[*a].total_cmp(&svd.singular_values[*b]));
    let right = svd.v_t?;
    let found = Matrix::from_fn(columns.len(), DIRECTIONS, |i, j| right[(order[j], i)]);
    Some((order.iter().map(|k| svd.singular_values[*k]).collect(), found))
}

/// A point with everything measured: pose over 1 mm and 5 mrad, beam up to 100 um off the apex.
fn point(instruments: &Neighbours, k: usize) -> Option<Point> {
    let unit = [2, 3, 5, 7, 11, 13, 17, 19].map(|base| 2.0 * radical_inverse(k + 1, base) - 1.0);
    let [tx, ty, tz, roll, pitch, yaw, x, y] = unit;
    let (t, r) = ([tx, ty, tz].map(|x| x * 1e-3), [roll, pitch, yaw].map(|x| x * 5e-3));
    let pose = [t[0], t[1], t[2], r[0], r[1], r[2]];
    let offset = Vector2::new(x, y) * 100e-6;
    let signals = instruments.centre.signals(&instruments.centre.state(&Pose::from_array(pose), offset))?;
    let raw =
        Raw { spots: [0, 1, 2, 3, 4, 5].map(|i| signals[i]), powers: [6, 7, 8].map(|i| signals[i].exp()) };
    let mut point: Point = raw.point();
    point.spot_deviations = [0.1e-6; 6];
    point.power_deviations = point.powers.map(|power| 1e-4 * power);
    point.reference = std::array::from_fn(|i| {
        Some(Known { value: pose[i], deviation: if i < 3 { 0.1e-6 } else { 0.5e-6 } })
    });
    point.steering =
        Some([t[0] + offset[0], t[1] + offset[1]].map(|value| Known { value, deviation: 0.1e-6 }));
    Some(point)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Head, Rigid};

    #[test]
    fn twelve_directions_have_no_effect_on_any_measurement() {
        let nominal = Nominal {
            head: Head::default(),
            steering_matrix: nalgebra::Matrix2::identity(),
            steering_origin: Vector2::zeros(),
            stage: Rigid::identity(),
            table: Rigid::identity(),
        };
        let (values, _) = directions(&nominal).unwrap();
        assert!(values[DIRECTIONS - 1] < 1e-2 * values[DIRECTIONS], "{:?}", &values[..16]);
        let shares = shares(&nominal, &Tolerances::default()).unwrap();
        assert!(shares.iter().all(|share| (-1e-9..=1.0 + 1e-9).contains(share)), "{shares:?}");
        // The power gains and the shape of the beam can be measured; the places of the PSDs move with the world.
        assert!(shares[26..31].iter().all(|share| *share < 1e-6), "{shares:?}");
        assert!(shares[..3].iter().any(|share| *share > 0.1), "{shares:?}");
    }
}
