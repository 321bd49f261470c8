//! An emulated LabJack T7 with the twin behind it, without its sockets: frames of Modbus TCP in and out, packets of the
//! stream out.
//!
//! It knows the registers of [`crate::acquisition::labjack::registers`]; others are refused, as on the device. Its
//! calibration constants differ from the nominal ones, and its timer wraps soon after power-up, so that a host which
//! ignores either is found out.

mod memory;
mod stream;

use memory::{Memory, flash};
use stream::Streaming;
use trifacet_core::time::{Mono, NS_PER_S};

use super::board_state::{BoardState, Steering};
use super::{MirrorMove, Outputs as Stage, Twin, TwinError, TwinScan};
use crate::acquisition::labjack::modbus::{EXCEPTION, Frame, READ, WRITE};
use crate::acquisition::labjack::outputs::Outputs;
use crate::acquisition::labjack::registers::{self as reg, CORE_TIMER_HZ, Register, Value, f32_at, u32_at};
use crate::acquisition::labjack::stream::StreamStatus;
use crate::config::{Config, FaultKind};

/// The timer at power-up: it wraps after three seconds.
const TIMER_AT_START: u32 = u32::MAX - 3 * CORE_TIMER_HZ;
/// The full-scale code of the twin's stage.
const FULL_SCALE: f64 = 32_768.0;

/// Function: several reads and writes.
const FEEDBACK: u8 = 76;
/// Function: read registers, as [`READ`].
const READ_INPUTS: u8 = 4;
/// Function: write one register.
const WRITE_ONE: u8 = 6;

/// Errors of the device, as in its last error.
pub(super) mod error {
    pub const ADDRESS: u16 = 2500;
    pub const ACTIVE: u16 = 2605;
    pub const LIST: u16 = 2607;
    pub const RATE: u16 = 2608;
    pub const TARGET: u16 = 2612;
    pub const BUFFER: u16 = 2615;
    pub const PACKET: u16 = 2618;
    pub const NOT_RUNNING: u16 = 2620;
    pub const SETTLING: u16 = 2621;
    pub const CHANNEL: u16 = 2625;
    pub const WATCHDOG: u16 = 2671;
}

/// A fault that only a T7 has.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum T7Fault {
    /// The buffer counts as full until this number of scans is skipped.
    Recovery(u16),
    /// The stream ends with this status.
    End(StreamStatus),
    /// This number of packets is not sent.
    Jump(u16),
    /// Another program ends the stream, and streams itself for this time, seconds.
    SecondSession(f64),
}

/// An emulated T7.
#[derive(Debug)]
pub struct T7 {
    twin: Twin,
    stage: Stage,
    outputs: Outputs,
    /// The analog input of each channel of the twin.
    inputs: Vec<u8>,
    memory: Memory,
    stream: Option<Streaming>,
    /// Another program streams until then.
    other_until: Option<Mono>,
    /// The last scan of the twin.
    scan: Option<TwinScan>,
    /// Time of the last power-up by the clock of the device, seconds since the start of the twin.
    powered_s: f64,
    start: Mono,
    /// The last request, unless the watchdog has expired since.
    last_request: Option<Mono>,
    state: BoardState,
}

impl T7 {
    /// A device that is powered up at `start`.
    ///
    /// # Errors
    /// As [`Twin::new`].
    pub fn new(config: &Config, start: Mono) -> Result<Self, TwinError> {
        let twin = Twin::new(config)?;
        let labjack = &config.acquisition.labjack;
        let mut device = Self {
            stage: twin.outputs().clone(),
            twin,
            outputs: Outputs::of(labjack),
            inputs: labjack.channels(),
            memory: Memory::new(),
            stream: None,
            other_until: None,
            scan: None,
            powered_s: 0.0,
            start,
            last_request: None,
            state: BoardState::default(),
        };
        device.move_outputs(start, Steering::Idle);
        Ok(device)
    }

    /// Restarts the device at `now`, as after a short failure of its supply.
    pub fn restart(&mut self, now: Mono) {
        self.memory.power_up();
        (self.stream, self.other_until, self.last_request) = (None, None, None);
        self.powered_s = self.scan.map_or(0.0, |scan| scan.clock_s);
        self.state.started = false;
        self.move_outputs(now, Steering::Idle);
    }

    /// The state of the device.
    pub fn state(&self) -> BoardState {
        self.state
    }

    /// Injects a fault of the twin for `for_s` seconds or, with `None`, without end.
    ///
    /// # Errors
    /// A value of the fault is out of range.
    pub fn inject(&mut self, kind: FaultKind, for_s: Option<f64>) -> Result<(), TwinError> {
        self.twin.inject(kind, for_s)
    }

    /// Injects a fault of the device.
    pub fn fail(&mut self, fault: T7Fault, now: Mono) {
        match fault {
            T7Fault::SecondSession(for_s) => {
                self.end_stream();
                self.memory.set(reg::START_TIME_STAMP, Value::U32(self.timer()));
                self.other_until = Some(now + (for_s * NS_PER_S as f64) as i64);
            }
            T7Fault::Recovery(_) | T7Fault::End(_) | T7Fault::Jump(_) => {
                let ended = self.stream.as_mut().is_some_and(|stream| stream.fail(fault));
                self.state.started &= !ended;
            }
        }
    }

    /// Moves the mirror, and holds it there.
    pub fn travel(&mut self, to: &MirrorMove) {
        self.twin.travel(to.to(), to.over_s);
    }

    /// The bytes of the stream to write next.
    pub fn output(&mut self) -> &[u8] {
        self.stream.as_mut().map_or(&[], Streaming::output)
    }

    /// Records that `bytes` bytes of the stream have been written.
    pub fn written(&mut self, bytes: usize) {
        if let Some(stream) = &mut self.stream {
            stream.written(bytes);
        }
    }

    /// The connection of the stream has ended: what was written in part is of no use.
    pub fn unheard(&mut self) {
        if let Some(stream) = &mut self.stream {
            stream.unheard();
        }
    }

    /// Takes the next scan of the twin, which is due at `now`.
    pub fn sample(&mut self, now: Mono) {
        self.watch(now);
        self.other_until = self.other_until.filter(|until| now < *until);
        let scan = self.twin.next_scan();
        self.state.time_s = scan.t_s;
        self.state.mirror = scan.truth.pose.to_array();
        self.scan = Some(scan);
        let (timer, inputs) = (self.timer(), self.samples());
        if let Some(stream) = &mut self.stream {
            let [sent, unsent] = stream.scan(timer, &inputs, &scan);
            self.state.scans_sent += sent;
            self.state.scans_unsent += unsent;
        }
    }

    fn timer(&self) -> u32 {
        let running_s = self.scan.map_or(0.0, |scan| scan.clock_s) - self.powered_s;
        TIMER_AT_START.wrapping_add((running_s * f64::from(CORE_TIMER_HZ)) as u64 as u32)
    }

    /// Volts at an analog input.
    fn volts(&self, input: u8) -> f64 {
        let channel = self.inputs.iter().position(|wired| *wired == input);
        let code = channel.zip(self.scan).and_then(|(channel, scan)| scan.codes.get(channel).copied());
        f64::from(code.unwrap_or(0)) * self.twin.identity().converter.step_v()
    }

    /// The codes of all analog inputs.
    fn samples(&self) -> [u16; memory::INPUTS] {
        std::array::from_fn(|input| {
            let range = f32_at(&self.memory.read(reg::AIN_RANGE.at(input as u8)), 0);
            flash::sample(self.volts(input as u8), range.into())
        })
    }

    /// The value of a register of 32 bits.
    fn whole(&self, register: Register) -> u32 {
        u32_at(&self.memory.read(register), 0)
    }

    /// The watchdog.
    fn watch(&mut self, now: Mono) {
        let limit_ns = i64::from(self.whole(reg::WATCHDOG_TIMEOUT)) * NS_PER_S;
        let due = self.last_request.is_some_and(|last| now - last >= limit_ns);
        if self.whole(reg::WATCHDOG) == 0 || !due {
            return;
        }
        self.last_request = None;
        for axis in 0..2 {
            if self.whole(reg::WATCHDOG_DAC_ENABLE[axis]) == 1 {
                let parked = self.memory.read(reg::WATCHDOG_DAC[axis]);
                self.memory.write(reg::DAC.at(axis as u8).address, &parked);
            }
        }
        self.move_outputs(now, Steering::Parked);
    }

    /// Moves the stage to the voltages of the outputs.
    fn move_outputs(&mut self, now: Mono, steering: Steering) {
        let registers = self.memory.read_at(self.outputs.first.address, 4);
        let code = |place: usize| (self.outputs.part(f32_at(&registers, place)) * FULL_SCALE).round() as i32;
        let codes = [code(0), code(2)].map(|code| code.min(i32::from(i16::MAX)));
        self.twin.steer(codes, now.seconds_since(self.start));
        self.state.output_codes = codes;
        self.state.output_um = self.stage.metres(codes).map(|metres| metres * 1e6);
        self.state.steering = steering;
        self.state.lease_expired = steering == Steering::Parked;
    }

    /// The answer to a request that arrived at `now`.
    pub fn answer(&mut self, request: &Frame, now: Mono) -> Frame {
        self.last_request = Some(now);
        let body = self.execute(request.function, &request.body, now);
        let (function, body) = match body {
            Ok(body) => (request.function, body),
            Err(error) => {
                self.memory.write(reg::LAST_ERROR.address, &[error]);
                (request.function | EXCEPTION, vec![if error == error::ADDRESS { 2 } else { 4 }])
            }
        };
        Frame { transaction: request.transaction, unit: request.unit, function, body }
    }

    fn execute(&mut self, function: u8, body: &[u8], now: Mono) -> Result<Vec<u8>, u16> {
        let number = |at: usize| Some(u16::from_be_bytes([*body.get(at)?, *body.get(at + 1)?]));
        let (Some(address), Some(count)) = (number(0), number(2)) else { return Err(error::ADDRESS) };
        match function {
            READ | READ_INPUTS => {
                let data = bytes(&self.read(address, count)?);
                Ok([vec![data.len() as u8], data].concat())
            }
            WRITE_ONE => self.write(address, &[count], now).map(|()| body.to_vec()),
            WRITE => {
                let data = body
                    .get(5..)
                    .filter(|data| data.len() == 2 * usize::from(count))
                    .ok_or(error::ADDRESS)?;
                self.write(address, &words(data), now).map(|()| body[..4].to_vec())
            }
            FEEDBACK => self.feedback(body, now),
            _ => Err(error::ADDRESS),
        }
    }

    /// Several reads and writes in one request.
    fn feedback(&mut self, mut body: &[u8], now: Mono) -> Result<Vec<u8>, u16> {
        let mut answer = Vec::new();
        while let [kind, high, low, count, rest @ ..] = body {
            let address = u16::from_be_bytes([*high, *low]);
            body = rest;
            if *kind == 0 {
                answer.extend(bytes(&self.read(address, (*count).into())?));
                continue;
            }
            let (data, rest) = body.split_at_checked(2 * usize::from(*count)).ok_or(error::ADDRESS)?;
            self.write(address, &words(data), now)?;
            body = rest;
        }
        Ok(answer)
    }

    fn is_streaming(&self) -> bool {
        self.stream.as_ref().is_some_and(Streaming::is_running) || self.other_until.is_some()
    }

    fn read(&mut self, address: u16, count: u16) -> Result<Vec<u16>, u16> {
        let inputs = reg::AIN.at(memory::INPUTS as u8).address;
        if address < inputs {
            if self.is_streaming() {
                return Err(error::ACTIVE);
            }
            let volts =
                (address / 2..).take(usize::from(count / 2)).map(|input| self.volts(input as u8) as f32);
            return Ok(volts.flat_map(|volts| Value::F32(volts).registers()).collect());
        }
        if address == reg::FLASH.address {
            return Ok(flash::read(u32_at(&self.memory.read(reg::FLASH_POINTER), 0), count));
        }
        self.memory.set(reg::CORE_TIMER, Value::U32(self.timer()));
        self.memory.set(reg::ENABLE, Value::U32(self.is_streaming().into()));
        if !self.memory.has(address, count) {
            return Err(error::ADDRESS);
        }
        Ok(self.memory.read_at(address, count))
    }

    fn write(&mut self, address: u16, registers: &[u16], now: Mono) -> Result<(), u16> {
        if address == reg::ENABLE.address {
            return self.enable(u32_at(registers, 0) == 1);
        }
        if !self.memory.is_writable(address, registers.len() as u16) {
            return Err(error::ADDRESS);
        }
        if memory::is_of_stream(address) && self.is_streaming() {
            return Err(error::ACTIVE);
        }
        let armed = u32_at(&self.memory.read(reg::WATCHDOG), 0) == 1;
        if memory::is_of_watchdog(address) && address != reg::WATCHDOG.address && armed {
            return Err(error::WATCHDOG);
        }
        self.memory.write(address, registers);
        if (self.outputs.first.address..self.outputs.first.address + 4).contains(&address) {
            self.state.commands_taken += 1;
            self.move_outputs(now, Steering::Commanded);
        }
        if address == reg::SCAN_RATE.address {
            let rate = f32_at(registers, 0);
            let taken = self.twin.identity().rate_hz / self.divisor(rate.into());
            self.memory.set(reg::SCAN_RATE, Value::F32(taken as f32));
        }
        Ok(())
    }

    /// Number of scans of the twin in one scan of the stream.
    fn divisor(&self, rate_hz: f64) -> f64 {
        (self.twin.identity().rate_hz / rate_hz.max(1e-3)).round().max(1.0)
    }

    fn enable(&mut self, on: bool) -> Result<(), u16> {
        if !on {
            if !self.is_streaming() {
                return Err(error::NOT_RUNNING);
            }
            self.other_until = None;
            self.end_stream();
            return Ok(());
        }
        if self.is_streaming() {
            return Err(error::ACTIVE);
        }
        let rate_hz = f64::from(f32_at(&self.memory.read(reg::SCAN_RATE), 0));
        if rate_hz.is_nan() || rate_hz <= 0.0 {
            return Err(error::RATE);
        }
        let stream = Streaming::of(&self.memory, self.divisor(rate_hz) as u64)?;
        let ticks = f64::from(CORE_TIMER_HZ) / self.twin.identity().rate_hz;
        let begin = self.timer().wrapping_add(ticks as u32);
        self.memory.set(reg::START_TIME_STAMP, Value::U32(begin));
        self.stream = Some(stream);
        self.state.started = true;
        Ok(())
    }

    fn end_stream(&mut self) {
        self.stream = None;
        self.state.started = false;
    }
}

fn bytes(registers: &[u16]) -> Vec<u8> {
    registers.iter().flat_map(|register| register.to_be_bytes()).collect()
}

fn words(data: &[u8]) -> Vec<u16> {
    data.chunks_exact(2).map(|pair| u16::from_be_bytes([pair[0], pair[1]])).collect()
}
