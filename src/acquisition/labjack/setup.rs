//! From a connection to a running stream: the requests, in order, and what their answers must be. Pure.

use std::collections::VecDeque;
use std::net::IpAddr;

use trifacet_core::time::{Mono, NS_PER_S};

use super::calibration::{self, Calibration};
use super::modbus::{Frame, READ, WRITE};
use super::registers::{self as reg, Register, Value, describe_error, f32_at, u32_at};
use super::settings::{Settings, Watchdog};

/// Time limit for an answer, nanoseconds.
pub const ANSWER_NS: i64 = NS_PER_S;
/// A session that is alive changes its beat within this time, nanoseconds.
const BEAT_NS: i64 = NS_PER_S;
/// Marks the registers of a session: "trif".
const MAGIC: u32 = 0x7472_6966;
/// The name of an emulated device begins with this.
pub const EMULATOR: &str = "trifacet emulator";
/// The rate may differ from the configured one by this part.
const RATE_TOLERANCE: f64 = 1e-3;
/// Number of the register of the beat in [`reg::USER_RAM`].
pub const BEAT: u8 = 3;
/// Number of the register that marks a session.
pub const MARK: u8 = 0;
/// Number of the register with the timer at the first scan of the session.
pub const BEGIN: u8 = 4;
/// Number of the registers of a session: mark, host, process, beat, timer at the first scan.
const MARKS: usize = 5;
/// The timers at the first scan, by the session and by the device, agree within this number of ticks: 1 ms.
const SAME_BEGIN: u32 = 40_000;

/// What the device has told.
#[derive(Clone, Debug, Default)]
struct Facts {
    firmware: f32,
    serial: u32,
    name: String,
    /// The session that streams already: its registers.
    other: Option<[u32; MARKS]>,
    calibration: Option<Calibration>,
    /// A register of the watchdog differs.
    watchdog_differs: bool,
}

/// What an answer is for.
#[derive(Clone, Debug, PartialEq)]
enum Question {
    Product,
    Firmware,
    Serial,
    Name,
    Streaming,
    Session,
    Begin,
    SessionAgain,
    Calibration,
    Watchdog(Value),
    WatchdogEnd(Value),
    Rate,
    /// The reason of a refusal of this.
    Refused(String),
}

#[derive(Clone, Debug, PartialEq)]
enum Step {
    Read(Register, u16, Question),
    Write(Register, Vec<Value>),
    Pause,
}

/// A device that streams.
#[derive(Clone, Debug, PartialEq)]
pub struct Started {
    /// Its name.
    pub name: String,
    /// Whether it is emulated.
    pub simulated: bool,
    /// The rate that it takes, Hz.
    pub rate_hz: f64,
    /// Calibration of its inputs.
    pub calibration: Calibration,
}

/// The state after an answer.
#[derive(Clone, Debug, PartialEq)]
pub enum Progress {
    /// More requests follow.
    Continues,
    /// The stream runs.
    Done(Started),
}

/// The requests until the stream runs.
#[derive(Clone, Debug)]
pub struct Setup {
    settings: Settings,
    /// Host and process of this session.
    own: [u32; 2],
    steps: VecDeque<Step>,
    /// The request without an answer, and its number.
    current: Option<(Step, u16)>,
    /// End of the time limit, or of a pause.
    until: Mono,
    facts: Facts,
    /// The request to start the stream has been sent: what arrives from then on belongs to it.
    pub enabled: bool,
}

impl Setup {
    /// For a connection from this address of the host.
    pub fn new(settings: &Settings, host: IpAddr, now: Mono) -> Self {
        let host = if let IpAddr::V4(host) = host { host.to_bits() } else { 0 };
        let own = [host, std::process::id()];
        let mut setup = Self {
            settings: settings.clone(),
            own,
            steps: VecDeque::new(),
            current: None,
            until: now + ANSWER_NS,
            facts: Facts::default(),
            enabled: false,
        };
        for (register, count, question) in [
            (reg::PRODUCT, 2, Question::Product),
            (reg::FIRMWARE, 2, Question::Firmware),
            (reg::SERIAL, 2, Question::Serial),
            (reg::NAME, reg::NAME_LENGTH, Question::Name),
            (reg::ENABLE, 2, Question::Streaming),
        ] {
            setup.steps.push_back(Step::Read(register, count, question));
        }
        let mark = [MAGIC, own[0], own[1], 0, 0].map(Value::U32);
        setup.write(reg::USER_RAM.at(MARK), mark);
        setup.inputs();
        setup.stream();
        setup.watchdog();
        setup.write(reg::ENABLE, [Value::U32(1)]);
        setup.steps.push_back(Step::Read(reg::SCAN_RATE, 2, Question::Rate));
        setup
    }

    fn write(&mut self, register: Register, values: impl Into<Vec<Value>>) {
        self.steps.push_back(Step::Write(register, values.into()));
    }

    fn inputs(&mut self) {
        let constants = reg::FLASH_CALIBRATION + self.settings.range_place() as u32 * calibration::BYTES;
        self.write(reg::FLASH_POINTER, [Value::U32(constants)]);
        self.steps.push_back(Step::Read(reg::FLASH, calibration::REGISTERS, Question::Calibration));
        for (input, _) in self.settings.inputs.clone() {
            self.write(reg::AIN_RANGE.at(input), [Value::F32(self.settings.range_v as f32)]);
            self.write(reg::AIN_NEGATIVE.at(input), [Value::U16(199)]);
        }
    }

    fn stream(&mut self) {
        let settings = self.settings.clone();
        let entries = settings.entries() as u32;
        for (register, value) in [
            (reg::SCAN_RATE, Value::F32(settings.rate_hz as f32)),
            (reg::NUM_ADDRESSES, Value::U32(entries)),
            (reg::SAMPLES_PER_PACKET, Value::U32(entries * settings.scans_per_packet())),
            (reg::SETTLING, Value::F32(settings.settling_us as f32)),
            (reg::RESOLUTION, Value::U32(settings.resolution.into())),
            (reg::BUFFER_SIZE, Value::U32(settings.buffer_bytes())),
            (reg::CLOCK_SOURCE, Value::U32(0)),
            (reg::AUTO_TARGET, Value::U32(1)),
            (reg::DATATYPE, Value::U32(0)),
            (reg::NUM_SCANS, Value::U32(0)),
            (reg::TRIGGER, Value::U32(0)),
            (reg::AUTORECOVER_DISABLE, Value::U32(0)),
        ] {
            self.write(register, [value]);
        }
        let inputs = settings.inputs.iter().map(|(input, _)| reg::AIN.at(*input));
        let list = [reg::CORE_TIMER, reg::DATA_CAPTURE].into_iter().chain(inputs);
        let list: Vec<_> = list.map(|register| Value::U32(register.address.into())).collect();
        self.write(reg::SCAN_LIST, list);
    }

    /// Reads the registers of the watchdog, which are in flash: they are written only if they differ.
    fn watchdog(&mut self) {
        let wanted = wanted(self.settings.watchdog);
        let last = wanted.len().saturating_sub(1);
        for (i, (register, value)) in wanted.into_iter().enumerate() {
            let question = if i == last { Question::WatchdogEnd(value) } else { Question::Watchdog(value) };
            self.steps.push_back(Step::Read(register, 2, question));
        }
    }

    /// End of the present time limit.
    pub fn until(&self) -> Mono {
        self.until
    }

    /// The next request, if none waits for its answer.
    pub fn request(&mut self, transaction: &mut u16, now: Mono) -> Option<Frame> {
        if self.current.is_some() || matches!(self.steps.front(), Some(Step::Pause)) {
            return None;
        }
        let step = self.steps.pop_front()?;
        *transaction = transaction.wrapping_add(1);
        let frame = match &step {
            Step::Read(register, count, _) => Frame::read(*transaction, *register, *count),
            Step::Write(register, values) => {
                self.enabled |= *register == reg::ENABLE && values[..] == [Value::U32(1)];
                Frame::write(*transaction, *register, values)
            }
            Step::Pause => return None,
        };
        self.current = Some((step, *transaction));
        self.until = now + ANSWER_NS;
        Some(frame)
    }

    /// The time limit has passed.
    ///
    /// # Errors
    /// Fails with the reason if an answer is missing.
    pub fn timed_out(&mut self) -> Result<(), String> {
        if let Some((step, _)) = &self.current {
            return Err(format!("no answer to {} within {} ms", named(step), ANSWER_NS / 1_000_000));
        }
        if self.steps.front() == Some(&Step::Pause) {
            self.steps.pop_front();
        }
        Ok(())
    }

    /// Takes an answer.
    ///
    /// # Errors
    /// Fails with the reason why the device cannot be used.
    pub fn answered(&mut self, frame: &Frame, now: Mono) -> Result<Progress, String> {
        let Some((step, transaction)) = self.current.take() else {
            return Err("it answers without a request".into());
        };
        if frame.transaction != transaction {
            return Err(format!("it answers request {} instead of {transaction}", frame.transaction));
        }
        let function = if matches!(step, Step::Read(..)) { READ } else { WRITE };
        let answer = frame.answer(function).map_err(|broken| format!("{}: {broken}", named(&step)))?;
        match (answer, step) {
            (Err(code), Step::Read(reg::LAST_ERROR, _, Question::Refused(what))) => {
                Err(format!("{what}, and does not say why (exception {code})"))
            }
            (Err(code), step) => {
                let what = format!("it refuses {} with exception {code}", named(&step));
                self.steps.push_front(Step::Read(reg::LAST_ERROR, 1, Question::Refused(what)));
                Ok(Progress::Continues)
            }
            (Ok(registers), Step::Read(register, count, question)) => {
                if registers.len() != usize::from(count) {
                    return Err(format!(
                        "it answers {} registers of {register}, not {count}",
                        registers.len()
                    ));
                }
                self.learn(question, &registers, now)
            }
            (Ok(_), _) => Ok(Progress::Continues),
        }
    }

    fn learn(&mut self, question: Question, registers: &[u16], now: Mono) -> Result<Progress, String> {
        let (float, whole) = (f32_at(registers, 0), u32_at(registers, 0));
        match question {
            Question::Product if float == 7.0 => {}
            Question::Product => {
                return Err(format!("it is a product {float} of LabJack, not a T7"));
            }
            Question::Firmware => self.facts.firmware = float,
            Question::Serial => self.facts.serial = whole,
            Question::Name => self.facts.name = text(registers),
            Question::Streaming if whole == 0 => {}
            Question::Streaming => self.next(reg::USER_RAM.at(MARK), 2 * MARKS, Question::Session),
            Question::Session => {
                self.facts.other = Some(session(registers));
                self.next(reg::START_TIME_STAMP, 2, Question::Begin);
            }
            Question::Begin => {
                let [mark, host, process, _, begin] = self.facts.other.unwrap_or_default();
                let apart = whole.wrapping_sub(begin).min(begin.wrapping_sub(whole));
                if mark != MAGIC || apart > SAME_BEGIN {
                    return Err("a program that is not trifacet streams from it: end that stream, or restart the device"
                        .into());
                }
                self.next(reg::USER_RAM.at(MARK), 2 * MARKS, Question::SessionAgain);
                if [host, process] != self.own {
                    self.steps.push_front(Step::Pause);
                    self.until = now + BEAT_NS;
                }
            }
            Question::SessionAgain => {
                let session = session(registers);
                if self.facts.other != Some(session) {
                    let [_, host, process, ..] = session;
                    let host = std::net::Ipv4Addr::from_bits(host);
                    return Err(format!(
                        "process {process} at {host} streams from it: one session at a time"
                    ));
                }
                // The process that started the stream has ended without ending it.
                self.steps.push_front(Step::Write(reg::ENABLE, vec![Value::U32(0)]));
            }
            Question::Calibration => {
                self.facts.calibration = Some(Calibration::of(registers, self.settings.range_v)?);
            }
            Question::Watchdog(wanted) => self.facts.watchdog_differs |= wanted.registers() != registers,
            Question::WatchdogEnd(wanted) => {
                self.facts.watchdog_differs |= wanted.registers() != registers;
                self.set_watchdog();
            }
            Question::Rate => return self.started(f64::from(float)),
            Question::Refused(what) => {
                let error = registers[0];
                return Err(format!("{what}: error {error}, {}", describe_error(error)));
            }
        }
        Ok(Progress::Continues)
    }

    /// Reads these registers next.
    fn next(&mut self, register: Register, count: usize, question: Question) {
        self.steps.push_front(Step::Read(register, count as u16, question));
    }

    fn set_watchdog(&mut self) {
        if !self.facts.watchdog_differs {
            return;
        }
        // It must be off while its settings change; the first of the wanted ones is whether it is on.
        for (register, value) in wanted(self.settings.watchdog) {
            self.steps.push_front(Step::Write(register, vec![value]));
        }
        self.steps.push_front(Step::Write(reg::WATCHDOG, vec![Value::U32(0)]));
    }

    fn started(&self, rate_hz: f64) -> Result<Progress, String> {
        let wanted_hz = self.settings.rate_hz;
        // A comparison with NaN is false.
        if (rate_hz / wanted_hz - 1.0).abs() <= RATE_TOLERANCE {
            let Facts { firmware, serial, name, calibration, .. } = &self.facts;
            let calibration = calibration.ok_or("it has told no calibration")?;
            let called = if name.is_empty() { String::new() } else { format!(", {name}") };
            return Ok(Progress::Done(Started {
                name: format!("LabJack T7 {serial}, firmware {firmware}{called}"),
                simulated: name.starts_with(EMULATOR),
                rate_hz,
                calibration,
            }));
        }
        Err(format!(
            "it samples at {rate_hz} Hz instead of acquisition.rate_hz = {wanted_hz}; set a rate that it has"
        ))
    }
}

/// The registers of the watchdog with their values; whether it is on comes first.
fn wanted(watchdog: Watchdog) -> Vec<(Register, Value)> {
    let on = |on: u32| (reg::WATCHDOG, Value::U32(on));
    match watchdog {
        Watchdog::AsItIs => Vec::new(),
        Watchdog::Off => vec![on(0)],
        Watchdog::Parks { timeout_s, at } => vec![
            on(1),
            (reg::WATCHDOG_TIMEOUT, Value::U32(timeout_s)),
            (reg::WATCHDOG_ADVANCED, Value::U32(0)),
            (reg::WATCHDOG_STRICT, Value::U32(0)),
            (reg::WATCHDOG_RESET, Value::U32(0)),
            (reg::WATCHDOG_DAC_ENABLE[0], Value::U32(1)),
            (reg::WATCHDOG_DAC[0], at[0]),
            (reg::WATCHDOG_DAC_ENABLE[1], Value::U32(1)),
            (reg::WATCHDOG_DAC[1], at[1]),
        ],
    }
}

fn named(step: &Step) -> String {
    match step {
        Step::Read(register, ..) => format!("reading {register}"),
        Step::Write(register, values) => {
            let values: Vec<_> = values.iter().map(ToString::to_string).collect();
            format!("writing {} to {register}", values.join(", "))
        }
        Step::Pause => "a pause".into(),
    }
}

/// The registers of a session.
fn session(registers: &[u16]) -> [u32; MARKS] {
    std::array::from_fn(|number| u32_at(registers, 2 * number))
}

/// Text in registers, up to its zero.
fn text(registers: &[u16]) -> String {
    let bytes: Vec<u8> =
        registers.iter().flat_map(|r| r.to_be_bytes()).take_while(|byte| *byte != 0).collect();
    String::from_utf8_lossy(&bytes).trim().chars().filter(|c| !c.is_control()).collect()
}
