//! The registers of the LabJack T7 that are used here, and the values that they hold.
//!
//! Source: "T-Series Datasheet" of LabJack and its list of registers (`ljm_constants.json`). A value of 32 bits takes
//! two registers, the upper half first.

use std::fmt;

/// Type of the value of a register.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Unsigned, 16 bits.
    U16,
    /// Unsigned, 32 bits.
    U32,
    /// Floating point, 32 bits.
    F32,
}

/// A register, or one of a row of registers with the same name.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Register {
    /// Its name; `#` stands for the number within a row.
    pub name: &'static str,
    /// Its address.
    pub address: u16,
    /// The type of its value.
    pub kind: Kind,
}

impl Register {
    const fn new(name: &'static str, address: u16, kind: Kind) -> Self {
        Self { name, address, kind }
    }

    /// The register with this number in a row.
    #[must_use]
    pub const fn at(self, number: u8) -> Self {
        let step = match self.kind {
            Kind::U16 => 1,
            Kind::U32 | Kind::F32 => 2,
        };
        Self { address: self.address + number as u16 * step, ..self }
    }
}

impl fmt::Display for Register {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} (register {})", self.name, self.address)
    }
}

/// The value of a register.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Value {
    /// Unsigned, 16 bits.
    U16(u16),
    /// Unsigned, 32 bits.
    U32(u32),
    /// Floating point, 32 bits.
    F32(f32),
}

impl Value {
    /// Appends the value as registers.
    pub fn push_to(self, registers: &mut Vec<u16>) {
        let whole = match self {
            Self::U16(value) => return registers.push(value),
            Self::U32(value) => value,
            Self::F32(value) => value.to_bits(),
        };
        registers.extend([(whole >> 16) as u16, whole as u16]);
    }

    /// The value as registers.
    pub fn registers(self) -> Vec<u16> {
        let mut registers = Vec::with_capacity(2);
        self.push_to(&mut registers);
        registers
    }
}

impl fmt::Display for Value {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::U16(value) => value.fmt(f),
            Self::U32(value) => value.fmt(f),
            Self::F32(value) => value.fmt(f),
        }
    }
}

/// The value of 32 bits at this place of some registers; 0 beyond their end.
pub fn u32_at(registers: &[u16], place: usize) -> u32 {
    let half = |place: usize| u32::from(registers.get(place).copied().unwrap_or(0));
    half(place) << 16 | half(place + 1)
}

/// The floating-point value at this place of some registers.
pub fn f32_at(registers: &[u16], place: usize) -> f32 {
    f32::from_bits(u32_at(registers, place))
}

use Kind::{F32, U16, U32};

/// Voltage of an analog input. In a scan list it stands for the input; its code is that of the converter.
pub const AIN: Register = Register::new("AIN#", 0, F32);
/// Voltage of one of the two outputs of 0 to 5 V.
pub const DAC: Register = Register::new("DAC#", 1000, F32);
/// Rate of the stream. Reads as the rate that the device really takes.
pub const SCAN_RATE: Register = Register::new("STREAM_SCANRATE_HZ", 4002, F32);
/// Number of entries of the scan list.
pub const NUM_ADDRESSES: Register = Register::new("STREAM_NUM_ADDRESSES", 4004, U32);
/// Samples in a packet of the stream, at most 512.
pub const SAMPLES_PER_PACKET: Register = Register::new("STREAM_SAMPLES_PER_PACKET", 4006, U32);
/// Settling time before each entry, microseconds; 0: chosen by the device.
pub const SETTLING: Register = Register::new("STREAM_SETTLING_US", 4008, F32);
/// Resolution of the stream, 0 to 8.
pub const RESOLUTION: Register = Register::new("STREAM_RESOLUTION_INDEX", 4010, U32);
/// Buffer of the stream in bytes, a power of two, at most 32768.
pub const BUFFER_SIZE: Register = Register::new("STREAM_BUFFER_SIZE_BYTES", 4012, U32);
/// Clock of the stream; 0: its own.
pub const CLOCK_SOURCE: Register = Register::new("STREAM_CLOCK_SOURCE", 4014, U32);
/// Where packets are sent; 1: Ethernet.
pub const AUTO_TARGET: Register = Register::new("STREAM_AUTO_TARGET", 4016, U32);
/// Must be 0.
pub const DATATYPE: Register = Register::new("STREAM_DATATYPE", 4018, U32);
/// Scans after which the stream ends; 0: without end.
pub const NUM_SCANS: Register = Register::new("STREAM_NUM_SCANS", 4020, U32);
/// Trigger of the stream; 0: none.
pub const TRIGGER: Register = Register::new("STREAM_TRIGGER_INDEX", 4024, U32);
/// CORE_TIMER at the first scan.
pub const START_TIME_STAMP: Register = Register::new("STREAM_START_TIME_STAMP", 4026, U32);
/// 1: the stream ends when its buffer is full. 0: it skips scans and goes on.
pub const AUTORECOVER_DISABLE: Register = Register::new("STREAM_AUTORECOVER_DISABLE", 4028, U32);
/// Entries of the scan list.
pub const SCAN_LIST: Register = Register::new("STREAM_SCANLIST_ADDRESS#", 4100, U32);
/// In a scan list: the upper half of the value of 32 bits before it.
pub const DATA_CAPTURE: Register = Register::new("STREAM_DATA_CAPTURE_16", 4899, U16);
/// 1 starts the stream, 0 ends it; reads 1 while it runs.
pub const ENABLE: Register = Register::new("STREAM_ENABLE", 4990, U32);
/// Voltage of an output of an LJTick-DAC, by the number of its digital line.
pub const TDAC: Register = Register::new("TDAC#", 30_000, F32);
/// Range of an analog input, volts.
pub const AIN_RANGE: Register = Register::new("AIN#_RANGE", 40_000, F32);
/// Negative input; 199: ground.
pub const AIN_NEGATIVE: Register = Register::new("AIN#_NEGATIVE_CH", 41_000, U16);
/// Memory for users, lost at a reset.
pub const USER_RAM: Register = Register::new("USER_RAM#_U32", 46_100, U32);
/// The last error of the device.
pub const LAST_ERROR: Register = Register::new("LAST_ERR_DETAIL", 55_000, U16);
/// 7 for a T7.
pub const PRODUCT: Register = Register::new("PRODUCT_ID", 60_000, F32);
/// Version of the firmware.
pub const FIRMWARE: Register = Register::new("FIRMWARE_VERSION", 60_004, F32);
/// Serial number.
pub const SERIAL: Register = Register::new("SERIAL_NUMBER", 60_028, U32);
/// Name of the device: text of up to 49 bytes that ends with a zero.
pub const NAME: Register = Register::new("DEVICE_NAME_DEFAULT", 60_500, U16);
/// Number of registers of the name.
pub const NAME_LENGTH: u16 = 25;
/// Counter of 40 MHz, which wraps every 107 s.
pub const CORE_TIMER: Register = Register::new("CORE_TIMER", 61_520, U32);
/// Frequency of the counter, Hz.
pub const CORE_TIMER_HZ: u32 = 40_000_000;
/// 1: the watchdog is on. Its other registers can only be written while it is off. All of them are in flash.
pub const WATCHDOG: Register = Register::new("WATCHDOG_ENABLE_DEFAULT", 61_600, U32);
/// 1, 2: the watchdog sets the configuration of factory or power-up.
pub const WATCHDOG_ADVANCED: Register = Register::new("WATCHDOG_ADVANCED_DEFAULT", 61_602, U32);
/// The watchdog expires after this time without communication, seconds.
pub const WATCHDOG_TIMEOUT: Register = Register::new("WATCHDOG_TIMEOUT_S_DEFAULT", 61_604, U32);
/// 1: only a key counts as communication.
pub const WATCHDOG_STRICT: Register = Register::new("WATCHDOG_STRICT_ENABLE_DEFAULT", 61_610, U32);
/// 1: the watchdog resets the device.
pub const WATCHDOG_RESET: Register = Register::new("WATCHDOG_RESET_ENABLE_DEFAULT", 61_620, U32);
/// 1: the watchdog sets DAC0, DAC1.
pub const WATCHDOG_DAC_ENABLE: [Register; 2] = [
    Register::new("WATCHDOG_DAC0_ENABLE_DEFAULT", 61_640, U32),
    Register::new("WATCHDOG_DAC1_ENABLE_DEFAULT", 61_650, U32),
];
/// The voltage to which it sets DAC0, DAC1.
pub const WATCHDOG_DAC: [Register; 2] = [
    Register::new("WATCHDOG_DAC0_DEFAULT", 61_642, F32),
    Register::new("WATCHDOG_DAC1_DEFAULT", 61_652, F32),
];
/// Address in flash from which is read.
pub const FLASH_POINTER: Register = Register::new("INTERNAL_FLASH_READ_POINTER", 61_810, U32);
/// Data from flash.
pub const FLASH: Register = Register::new("INTERNAL_FLASH_READ", 61_812, U32);
/// Where the constants of the calibration begin in flash.
pub const FLASH_CALIBRATION: u32 = 0x3C_4000;

/// What the errors of a device mean that its settings may cause (`LAST_ERR_DETAIL`).
pub fn describe_error(error: u16) -> &'static str {
    match error {
        2600 => "the scan list is empty",
        2605 => "a stream runs already",
        2606 => "the settings of the stream are not possible",
        2607 => "the scan list is not possible",
        2608 => "the scan rate is not possible",
        2612 => "packets cannot be sent there",
        2615 => "the size of the buffer is not possible",
        2618 => "the size of a packet is not possible",
        2621 => "the settling time is not possible",
        2625 => "an entry of the scan list cannot be streamed",
        2671 => "the watchdog is on, and its settings cannot change",
        _ => "see the error codes of LabJack",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_and_values_follow_the_list_of_registers() {
        let addresses = [AIN.at(13), AIN_RANGE.at(3), AIN_NEGATIVE.at(3), TDAC.at(2), SCAN_LIST.at(12)];
        assert_eq!(addresses.map(|register| register.address), [26, 40_006, 41_003, 30_004, 4124]);
        assert_eq!(Value::F32(-10.0).registers(), [0xC120, 0]);
        assert_eq!(Value::U16(199).registers(), [199]);
        let two = [0xC120, 0, 0x003C, 0x4000];
        assert_eq!((f32_at(&two, 0), u32_at(&two, 2), u32_at(&two, 9)), (-10.0, FLASH_CALIBRATION, 0));
        assert_eq!(ENABLE.to_string(), "STREAM_ENABLE (register 4990)");
    }
}
