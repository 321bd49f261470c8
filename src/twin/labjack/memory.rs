//! The registers of the emulated T7, and its flash.

use std::collections::BTreeMap;

use crate::acquisition::labjack::registers::{self as reg, Kind, Register, Value};
use crate::acquisition::labjack::setup::EMULATOR;

/// Number of analog inputs.
pub const INPUTS: usize = 14;
/// Entries of the scan list.
const LIST: u8 = 128;
/// Digital lines at which an LJTick-DAC may be.
const TDACS: u8 = 23;
/// Registers for users.
const USER: u8 = 40;

/// Whether a register belongs to the settings of the stream.
pub fn is_of_stream(address: u16) -> bool {
    (reg::SCAN_RATE.address..reg::ENABLE.address).contains(&address)
}

/// Whether a register belongs to the watchdog. These are in flash, and survive a restart.
pub fn is_of_watchdog(address: u16) -> bool {
    (reg::WATCHDOG.address..reg::WATCHDOG_DAC[1].address + 2).contains(&address)
}

/// The registers.
#[derive(Clone, Debug)]
pub struct Memory {
    registers: BTreeMap<u16, u16>,
}

impl Memory {
    /// The registers at power-up, with the watchdog of the factory.
    pub fn new() -> Self {
        let mut memory = Self { registers: BTreeMap::new() };
        memory.set(reg::WATCHDOG_TIMEOUT, Value::U32(60));
        let off = [reg::WATCHDOG, reg::WATCHDOG_ADVANCED, reg::WATCHDOG_STRICT, reg::WATCHDOG_RESET];
        for register in off.into_iter().chain(reg::WATCHDOG_DAC_ENABLE).chain(reg::WATCHDOG_DAC) {
            memory.set(register, Value::U32(0));
        }
        memory.power_up();
        memory
    }

    /// Sets all registers that are not in flash to their values at power-up.
    pub fn power_up(&mut self) {
        for (register, number) in
            [(reg::DAC, 2), (reg::TDAC, TDACS), (reg::SCAN_LIST, LIST), (reg::USER_RAM, USER)]
        {
            (0..number).for_each(|i| self.set(register.at(i), Value::U32(0)));
        }
        for input in 0..INPUTS as u8 {
            self.set(reg::AIN_RANGE.at(input), Value::F32(10.0));
            self.set(reg::AIN_NEGATIVE.at(input), Value::U16(199));
        }
        for (register, value) in [
            (reg::SCAN_RATE, Value::F32(0.0)),
            (reg::SETTLING, Value::F32(0.0)),
            (reg::BUFFER_SIZE, Value::U32(4096)),
            (reg::LAST_ERROR, Value::U16(0)),
            (reg::PRODUCT, Value::F32(7.0)),
            (reg::FIRMWARE, Value::F32(1.0302)),
            (reg::SERIAL, Value::U32(470_000_000)),
            (TEST, Value::U32(0x0011_2233)),
        ] {
            self.set(register, value);
        }
        for register in [
            reg::NUM_ADDRESSES,
            reg::SAMPLES_PER_PACKET,
            reg::RESOLUTION,
            reg::CLOCK_SOURCE,
            reg::AUTO_TARGET,
            reg::DATATYPE,
            reg::NUM_SCANS,
            reg::TRIGGER,
            reg::START_TIME_STAMP,
            reg::AUTORECOVER_DISABLE,
            reg::ENABLE,
            reg::CORE_TIMER,
            reg::FLASH_POINTER,
        ] {
            self.set(register, Value::U32(0));
        }
        let mut name = EMULATOR.as_bytes().to_vec();
        name.resize(2 * usize::from(reg::NAME_LENGTH), 0);
        for (i, pair) in name.chunks_exact(2).enumerate() {
            self.set(reg::NAME.at(i as u8), Value::U16(u16::from_be_bytes([pair[0], pair[1]])));
        }
    }

    /// Sets a register.
    pub fn set(&mut self, register: Register, value: Value) {
        self.write(register.address, &value.registers());
    }

    /// Writes registers.
    pub fn write(&mut self, address: u16, values: &[u16]) {
        self.registers.extend((address..).zip(values.iter().copied()));
    }

    /// The contents of a register.
    pub fn read(&self, register: Register) -> Vec<u16> {
        self.read_at(register.address, if register.kind == Kind::U16 { 1 } else { 2 })
    }

    /// Registers from this address on.
    pub fn read_at(&self, address: u16, count: u16) -> Vec<u16> {
        (address..).take(count.into()).map(|at| self.registers.get(&at).copied().unwrap_or(0)).collect()
    }

    /// Whether all of these registers exist.
    pub fn has(&self, address: u16, count: u16) -> bool {
        count > 0 && (address..).take(count.into()).all(|at| self.registers.contains_key(&at))
    }

    /// Whether all of these registers exist and can be written.
    pub fn is_writable(&self, address: u16, count: u16) -> bool {
        let fixed = [
            reg::START_TIME_STAMP,
            reg::LAST_ERROR,
            reg::PRODUCT,
            reg::FIRMWARE,
            reg::SERIAL,
            reg::CORE_TIMER,
            TEST,
        ];
        self.has(address, count) && !fixed.iter().any(|register| register.address == address)
    }
}

/// Always 0x00112233.
const TEST: Register = Register { name: "TEST", address: 55_100, kind: Kind::U32 };

/// The calibration in flash.
pub mod flash {
    use crate::acquisition::labjack::registers::{FLASH_CALIBRATION, Value};

    /// By how much the slopes differ from the nominal ones.
    const SLOPE: f64 = 1.004;
    /// The code of 0 V; nominal is 33 523.
    const CENTER: f64 = 33_461.25;
    /// Nominal volts per code in the range of +-10 V.
    const NOMINAL: f64 = 3.158_058e-4;
    /// The ranges in the order of their constants, of the fast converter and of the precise one.
    const RANGES_V: [f64; 8] = [10.0, 1.0, 0.1, 0.01, 10.0, 1.0, 0.1, 0.01];

    fn slope(range_v: f64) -> f64 {
        NOMINAL * SLOPE * range_v / 10.0
    }

    /// The code of a voltage.
    pub fn sample(volts: f64, range_v: f64) -> u16 {
        let range_v = if range_v > 0.0 { range_v } else { 10.0 };
        (volts / slope(range_v) + CENTER).round().clamp(0.0, f64::from(u16::MAX)) as u16
    }

    /// Registers from this address of the flash on; 0xffff beyond the constants.
    pub fn read(pointer: u32, count: u16) -> Vec<u16> {
        let inputs = RANGES_V.into_iter().flat_map(|range_v| {
            let slope = slope(range_v);
            [slope, -slope, CENTER, -slope * CENTER]
        });
        let others = [13_200.0, 0.0, 13_200.0, 0.0, -92.6, 467.6, 1e-5, 2e-4, 1.5e-8];
        let constants: Vec<u16> =
            inputs.chain(others).flat_map(|value| Value::F32(value as f32).registers()).collect();
        let first = (pointer.wrapping_sub(FLASH_CALIBRATION) / 2) as usize;
        (first..).take(count.into()).map(|at| constants.get(at).copied().unwrap_or(u16::MAX)).collect()
    }
}
