//! What is measured at one point of a calibration.

/// A measured value and its standard uncertainty.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Known {
    /// The value, metres or radians.
    pub value: f64,
    /// Its standard uncertainty, in the same unit.
    pub deviation: f64,
}

/// One point: means of readings while the mirror was at rest.
#[derive(Clone, Debug, PartialEq)]
pub struct Point {
    /// u, v of A, B, C as read: before any correction table, metres.
    pub spots: [f64; 6],
    /// Standard uncertainties of the spots, metres.
    pub spot_deviations: [f64; 6],
    /// Powers on A, B, C as read, in any unit.
    pub powers: [f64; 3],
    /// Standard uncertainties of the powers, in their unit.
    pub power_deviations: [f64; 3],
    /// tx, ty, tz, roll, pitch, yaw of the reference's table in the reference's frame; `None`: not measured.
    pub reference: [Option<Known>; 6],
    /// Readback of the steering stage, x and y, metres.
    pub steering: Option<[Known; 2]>,
    /// The run whose zero the reference has; `None`: the zero that is common to all points.
    pub run: Option<usize>,
}

/// How steady a mirror stands during a scan of the steering, per point: metres, radians.
pub const AT_REST: (f64, f64) = (0.02e-6, 0.1e-6);

impl Point {
    /// The same point as a part of a scan of the steering: the mirror is at rest at an unknown pose.
    #[must_use]
    pub fn of_scan(mut self, run: usize) -> Self {
        self.run = Some(run);
        let (metres, radians) = AT_REST;
        self.reference = [metres, metres, metres, radians, radians, radians]
            .map(|deviation| Some(Known { value: 0.0, deviation }));
        self
    }

    /// Whether all six coordinates of the reference are measured, from the common zero.
    pub fn has_pose(&self) -> bool {
        self.run.is_none() && self.reference.iter().all(Option::is_some)
    }

    /// Values of the reference; NaN: not measured.
    pub fn reference_values(&self) -> [f64; 6] {
        self.reference.map(|known| known.map_or(f64::NAN, |k| k.value))
    }
}
