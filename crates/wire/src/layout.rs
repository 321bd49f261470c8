//! The byte table of the pose frame as data (sent to every client in the descriptor), and the names of its
//! values in text formats.

/// Bytes of a pose frame.
pub const FRAME_SIZE: usize = 192;

/// One field of the pose frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Field {
    /// Name.
    pub name: &'static str,
    /// First byte.
    pub offset: u16,
    /// Type of an element: `u8`, `u16`, `u32`, `u64`, `i64`, `f32`, `f64`; little-endian.
    pub kind: &'static str,
    /// Number of elements.
    pub count: u16,
    /// Unit of an element; empty if it has none.
    pub unit: &'static str,
}

impl Field {
    /// Bytes of an element.
    pub const fn width(&self) -> usize {
        match self.kind.as_bytes() {
            [_, b'8'] => 1,
            [_, b'1', b'6'] => 2,
            [_, b'3', b'2'] => 4,
            _ => 8,
        }
    }
}

const fn field(offset: u16, kind: &'static str, count: u16, name: &'static str, unit: &'static str) -> Field {
    Field { name, offset, kind, count, unit }
}

/// Every field of the pose frame, in order, without gaps.
pub const FIELDS: [Field; 32] = [
    field(0, "u8", 4, "magic", ""),
    field(4, "u8", 1, "major", ""),
    field(5, "u8", 1, "minor", ""),
    field(6, "u16", 1, "size", "byte"),
    field(8, "u32", 1, "session", ""),
    field(12, "u32", 1, "config", ""),
    field(16, "u64", 1, "sequence", ""),
    field(24, "u64", 1, "sample_index", ""),
    field(32, "i64", 1, "time_ns", "ns"),
    field(40, "u32", 1, "solve_delay_ns", "ns"),
    field(44, "u32", 1, "send_delay_ns", "ns"),
    field(48, "u32", 1, "status", ""),
    field(52, "u16", 1, "clock_quality", "100 ns"),
    field(54, "u8", 1, "lock", ""),
    field(55, "u8", 1, "iterations", ""),
    field(56, "f64", 3, "position", "m"),
    field(80, "f64", 3, "rotation", "rad"),
    field(104, "f32", 3, "sd_position", "m"),
    field(116, "f32", 3, "sd_rotation", "rad"),
    field(128, "f32", 2, "beam_offset", "m"),
    field(136, "f32", 1, "steering_residual", "m"),
    field(140, "u16", 1, "averaged", ""),
    field(142, "u16", 1, "lost", ""),
    field(144, "f32", 2, "spot_a", "m"),
    field(152, "f32", 2, "spot_b", "m"),
    field(160, "f32", 2, "spot_c", "m"),
    field(168, "f32", 1, "power_a", "W"),
    field(172, "f32", 1, "power_b", "W"),
    field(176, "f32", 1, "power_c", "W"),
    field(180, "f32", 1, "steering_x", "m"),
    field(184, "f32", 1, "steering_y", "m"),
    field(188, "u32", 1, "crc", ""),
];

/// The names of a frame's values in text formats (JSON, CSV), in order.
pub const COLUMNS: [&str; 47] = [
    "sequence",
    "sample_index",
    "time",
    "time_ns",
    "lock",
    "status",
    "status_bits",
    "tx_m",
    "ty_m",
    "tz_m",
    "roll_rad",
    "pitch_rad",
    "yaw_rad",
    "sd_tx_m",
    "sd_ty_m",
    "sd_tz_m",
    "sd_roll_rad",
    "sd_pitch_rad",
    "sd_yaw_rad",
    "beam_dx_m",
    "beam_dy_m",
    "steering_residual_m",
    "u_a_m",
    "v_a_m",
    "u_b_m",
    "v_b_m",
    "u_c_m",
    "v_c_m",
    "power_a_w",
    "power_b_w",
    "power_c_w",
    "steering_x_m",
    "steering_y_m",
    "averaged",
    "lost",
    "iterations",
    "solve_delay_ns",
    "send_delay_ns",
    "clock_sigma_s",
    "session",
    "config",
    "sys_sd_tx_m",
    "sys_sd_ty_m",
    "sys_sd_tz_m",
    "sys_sd_roll_rad",
    "sys_sd_pitch_rad",
    "sys_sd_yaw_rad",
];

/// The names of the pose components: m and rad.
pub const POSE: [&str; 6] = ["tx_m", "ty_m", "tz_m", "roll_rad", "pitch_rad", "yaw_rad"];
/// The names of their standard uncertainties.
pub const DEVIATIONS: [&str; 6] =
    ["sd_tx_m", "sd_ty_m", "sd_tz_m", "sd_roll_rad", "sd_pitch_rad", "sd_yaw_rad"];
/// The names of the part of them that averaging does not reduce.
pub const SYSTEMATIC: [&str; 6] =
    ["sys_sd_tx_m", "sys_sd_ty_m", "sys_sd_tz_m", "sys_sd_roll_rad", "sys_sd_pitch_rad", "sys_sd_yaw_rad"];
/// The names of the beam offset, metres.
pub const BEAM: [&str; 2] = ["beam_dx_m", "beam_dy_m"];
/// The names of the spots, metres.
pub const SPOTS: [&str; 6] = ["u_a_m", "v_a_m", "u_b_m", "v_b_m", "u_c_m", "v_c_m"];
/// The names of the powers, watts.
pub const POWERS: [&str; 3] = ["power_a_w", "power_b_w", "power_c_w"];
/// The names of the steering position, metres.
pub const STEERING: [&str; 2] = ["steering_x_m", "steering_y_m"];

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_fields_fill_the_frame_without_gaps_and_are_aligned() {
        let mut end = 0;
        for f in FIELDS {
            let bits: u16 = f.kind[1..].parse().unwrap();
            assert_eq!(usize::from(bits / 8), f.width());
            assert_eq!(f.offset, end, "{}", f.name);
            assert_eq!(f.offset % (bits / 8), 0, "{} is aligned", f.name);
            end += f.count * bits / 8;
        }
        assert_eq!(usize::from(end), FRAME_SIZE);
    }
}
