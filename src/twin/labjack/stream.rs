//! The stream of the emulated T7.

use std::collections::VecDeque;

use super::memory::{INPUTS, Memory};
use super::{T7Fault, error};
use crate::acquisition::labjack::registers::{self as reg, Register, f32_at, u32_at};
use crate::acquisition::labjack::stream::{MOST_SAMPLES, Packet, StreamStatus};
use crate::twin::{Fate, TwinScan};

/// Longest settling time, microseconds.
const LONGEST_SETTLING: f32 = 4400.0;
/// Largest buffer, bytes.
const LARGEST_BUFFER: u32 = 32_768;

/// An entry of the scan list.
#[derive(Clone, Copy, Debug)]
pub enum Entry {
    /// An analog input.
    Input(usize),
    /// The lower half of the timer.
    Timer,
    /// The upper half of the timer.
    Capture,
}

/// A stream that has been started.
#[derive(Debug)]
pub struct Streaming {
    list: Vec<Entry>,
    samples_per_packet: usize,
    buffer_bytes: usize,
    /// Scans of the twin in one scan of the stream, and those that have been taken.
    divisor: u64,
    taken: u64,
    transaction: u16,
    /// Samples of the packet that is not yet complete, and whether a scan of it is dropped or damaged.
    pending: Vec<u16>,
    pending_status: StreamStatus,
    fate: Fate,
    /// Complete packets.
    queue: VecDeque<(Packet, Fate)>,
    /// Bytes of the packet that is being sent.
    out: Vec<u8>,
    /// While recovering: scans that have been skipped.
    skipped: Option<u32>,
    /// Scans to be skipped at least.
    to_skip: u32,
    /// Packets not to be sent.
    jump: u16,
    ended: bool,
    /// The device sends in bursts: the output waits until then, seconds since the start of the twin.
    held: bool,
    last_burst: f64,
}

impl Streaming {
    /// The stream of these registers.
    ///
    /// # Errors
    /// The error of the device.
    pub fn of(memory: &Memory, divisor: u64) -> Result<Self, u16> {
        let whole = |register: Register| u32_at(&memory.read(register), 0);
        let entries = whole(reg::NUM_ADDRESSES) as usize;
        let samples_per_packet = whole(reg::SAMPLES_PER_PACKET) as usize;
        let buffer = whole(reg::BUFFER_SIZE);
        if !(1..=128).contains(&entries) {
            return Err(error::LIST);
        }
        if !(1..=MOST_SAMPLES).contains(&samples_per_packet) {
            return Err(error::PACKET);
        }
        if buffer > LARGEST_BUFFER || !(buffer == 0 || buffer.is_power_of_two()) {
            return Err(error::BUFFER);
        }
        if !(0.0..=LONGEST_SETTLING).contains(&f32_at(&memory.read(reg::SETTLING), 0)) {
            return Err(error::SETTLING);
        }
        if whole(reg::AUTO_TARGET) != 1 {
            return Err(error::TARGET);
        }
        let list =
            (0..entries).map(|i| entry(whole(reg::SCAN_LIST.at(i as u8)))).collect::<Result<_, _>>()?;
        Ok(Self {
            list,
            samples_per_packet,
            buffer_bytes: if buffer == 0 { 4096 } else { buffer as usize },
            divisor,
            taken: 0,
            transaction: 0,
            pending: Vec::new(),
            pending_status: StreamStatus::Running,
            fate: Fate::Sent,
            queue: VecDeque::new(),
            out: Vec::new(),
            skipped: None,
            to_skip: 0,
            jump: 0,
            ended: false,
            held: false,
            last_burst: 0.0,
        })
    }

    /// Whether it runs; after its end, its last packets may still have to be sent.
    pub fn is_running(&self) -> bool {
        !self.ended
    }

    /// Injects a fault; returns whether the stream has ended.
    pub fn fail(&mut self, fault: T7Fault) -> bool {
        match fault {
            T7Fault::Recovery(scans) => {
                // One more packet is sent, with the status; then scans are skipped.
                (self.to_skip, self.pending_status) = (scans.into(), StreamStatus::Recovering);
            }
            T7Fault::Jump(packets) => self.jump = packets,
            T7Fault::End(status) => self.end(status),
            T7Fault::SecondSession(_) => {}
        }
        self.ended
    }

    fn end(&mut self, status: StreamStatus) {
        self.ended = true;
        self.complete(status, Vec::new());
    }

    fn begin_recovery(&mut self) {
        self.skipped.get_or_insert(0);
        if let Some((last, _)) = self.queue.back_mut() {
            last.status = StreamStatus::Recovering;
        }
    }

    /// Takes a scan of the twin; returns the numbers of scans that are sent and not sent.
    pub fn scan(&mut self, timer: u32, inputs: &[u16; INPUTS], scan: &TwinScan) -> [u64; 2] {
        let burst = (scan.t_s / scan.burst_s).floor();
        self.held = scan.fate == Fate::Stalled || (scan.burst_s > 0.0 && burst <= self.last_burst);
        self.last_burst = if scan.burst_s > 0.0 { burst } else { 0.0 };
        let due = self.taken.is_multiple_of(self.divisor);
        self.taken += 1;
        if !due || self.ended {
            return [0, 0];
        }
        if self.skips() {
            return [0, 1];
        }
        let mut captured = 0;
        for entry in &self.list {
            self.pending.push(match entry {
                Entry::Input(input) => inputs[*input],
                Entry::Timer => {
                    captured = (timer >> 16) as u16;
                    timer as u16
                }
                Entry::Capture => captured,
            });
        }
        if matches!(scan.fate, Fate::Dropped | Fate::Corrupted) {
            self.fate = scan.fate;
        }
        self.cut();
        if self.to_skip > 0 {
            self.skipped.get_or_insert(0);
        }
        let sent = scan.fate != Fate::Dropped;
        [sent.into(), (!sent).into()]
    }

    /// Whether the scan that is due is skipped, because the buffer was full.
    fn skips(&mut self) -> bool {
        let held = 2 * self.queue.iter().map(|(packet, _)| packet.samples.len()).sum::<usize>();
        if self.skipped.is_none() && held > self.buffer_bytes {
            self.begin_recovery();
        }
        let Some(skipped) = self.skipped else { return false };
        if skipped >= self.to_skip && self.queue.is_empty() && skipped > 0 {
            let Ok(skipped) = u16::try_from(skipped) else {
                self.end(StreamStatus::Overflow);
                return true;
            };
            (self.skipped, self.to_skip) = (None, 0);
            self.pending.extend(std::iter::repeat_n(u16::MAX, self.list.len()));
            self.pending_status = StreamStatus::Recovered { skipped };
            self.cut();
            return false;
        }
        self.skipped = Some(skipped + 1);
        true
    }

    /// Completes packets.
    fn cut(&mut self) {
        while self.pending.len() >= self.samples_per_packet {
            let samples = self.pending.drain(..self.samples_per_packet).collect();
            let status = std::mem::replace(&mut self.pending_status, StreamStatus::Running);
            self.complete(status, samples);
        }
    }

    fn complete(&mut self, status: StreamStatus, samples: Vec<u16>) {
        let transaction = self.transaction;
        self.transaction = transaction.wrapping_add(1);
        let fate = std::mem::replace(&mut self.fate, Fate::Sent);
        if self.jump > 0 {
            self.jump -= 1;
        } else if fate != Fate::Dropped {
            self.queue.push_back((Packet { transaction, backlog: 0, status, samples }, fate));
        }
    }

    /// The bytes to write next.
    pub fn output(&mut self) -> &[u8] {
        if self.out.is_empty()
            && !self.held
            && let Some((packet, fate)) = self.queue.pop_front()
        {
            let backlog = 2 * self.queue.iter().map(|(packet, _)| packet.samples.len()).sum::<usize>();
            Packet { backlog: u16::try_from(backlog).unwrap_or(u16::MAX), ..packet }.encode(&mut self.out);
            if fate == Fate::Corrupted {
                self.out[7] ^= 0x55;
            }
        }
        &self.out
    }

    /// Records that `bytes` bytes have been written.
    pub fn written(&mut self, bytes: usize) {
        self.out.drain(..bytes);
    }

    /// The connection has ended.
    pub fn unheard(&mut self) {
        self.out.clear();
    }
}

fn entry(address: u32) -> Result<Entry, u16> {
    let is = |register: Register| u32::from(register.address) == address;
    match address {
        _ if is(reg::CORE_TIMER) => Ok(Entry::Timer),
        _ if is(reg::DATA_CAPTURE) => Ok(Entry::Capture),
        address if address.is_multiple_of(2) && (address / 2) < INPUTS as u32 => {
            Ok(Entry::Input(address as usize / 2))
        }
        _ => Err(error::CHANNEL),
    }
}
