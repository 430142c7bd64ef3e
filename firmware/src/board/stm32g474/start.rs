//! Wires the board to the app.

use embassy_executor::raw::TaskStorage;
use embassy_executor::{Executor, Spawner};
use embassy_stm32::flash::{self, Flash};
use embassy_stm32::gpio::{AfType, Flex, Output, OutputType, Pull, Speed};
use embassy_stm32::interrupt::{InterruptExt, Priority};
use embassy_stm32::peripherals::{CRC, IWDG, LPUART1, USB};
use embassy_stm32::rcc;
use embassy_stm32::usart::{self, BufferedUart};
use embassy_stm32::usb::Driver;
use embassy_stm32::wdg::IndependentWatchdog;
use embassy_stm32::{Peri, Peripherals, bind_interrupts, interrupt, peripherals, uid};
use embassy_usb::UsbDevice;
use ihd_firmware::drive::bridge::Bridge;
use ihd_firmware::limits::WATCHDOG_US;
use ihd_firmware::link::housekeeping::Housekeeping;
use ihd_firmware::retained::reset;
use ihd_firmware::retained::save_interval::SaveInterval;
use ihd_firmware::sampling::path::SamplingLock;
use ihd_firmware::self_test::heartbeat::Heartbeat;
use ihd_shared::board::{COIL_NTC_PIN, FAN_PIN, GLASS_NTC_PIN, HEAT_SINK_NTC_PIN};
use ihd_shared::fault::Fault;
use ihd_shared::lookup::prior::start_load;
use ihd_shared::wire::hello::{ROLE_DEVICE, ours};
use ihd_shared::wire::messages::{Comparators, Hello, State};
use static_cell::StaticCell;

use super::adc::{self, Adc, SAMPLING_EXECUTOR};
use super::led::Led;
use super::log::LINK_LOG;
use super::nonvolatile::{self as nonvolatile_pages, LookupPages, TO_KEEP};
use super::panel::Panel;
use super::pins::{low_output, of_board};
use super::self_test::SelfTest;
use super::service::{self, ChipServices};
use super::share_wire::ShareWire;
use super::temperatures::TemperatureAdc;
use super::{registers, serial, usb};
use crate::board::link::NoPort;
use crate::board::sampling::{self, SamplingTask, ThreadSide};
use crate::board::{crash, cycles, link};

bind_interrupts!(struct Irqs {
    USB_LP => embassy_stm32::usb::InterruptHandler<USB>;
    LPUART1 => usart::BufferedInterruptHandler<LPUART1>;
    FLASH => flash::InterruptHandler;
});

static SAMPLING_TASK: TaskStorage<SamplingTask<Adc>> = TaskStorage::new();
static EXECUTOR: StaticCell<Executor> = StaticCell::new();
static HOUSEKEEPING: StaticCell<Housekeeping> = StaticCell::new();

type UsbDriver = Driver<'static, USB>;

/// Parts that the link task owns besides the link itself.
struct Board {
    watchdog: IndependentWatchdog<'static, IWDG>,
    led: Led,
    heartbeat: Heartbeat,
    saves: SaveInterval,
    self_test: SelfTest,
    temperatures: TemperatureAdc,
    fan: Output<'static>,
    panel: Panel,
    share_wire: ShareWire,
}

#[cortex_m_rt::entry]
fn main() -> ! {
    let (flags, reset_flags, watchdog_is_sound) = registers::supply::reset_flags();
    crash::count_start(flags);
    let last = crash::read_crash_record();
    let p = registers::clocks::start();
    registers::supply::protect_code();
    if let Some(mut core) = cortex_m::Peripherals::take() {
        registers::supply::guard_stack(&mut core.MPU);
    }
    cycles::keep_running();
    defmt::info!(
        "reset reason {=u8}, fault before it {=u16}; {=u32} MHz",
        reset::reason(flags, last) as u8,
        last.map_or(0, |record| record.fault),
        registers::clocks::CORE_MHZ
    );
    let (r, l) = start_load();
    let Some((interrupt_side, thread_side)) = sampling::split(r, l) else {
        unreachable!("main runs once");
    };
    EXECUTOR.init(Executor::new()).run(|spawner| {
        let hello = hello(flags, last);
        let watchdog_fault = (!watchdog_is_sound).then_some(Fault::WATCHDOG_TEST);
        let sides = (interrupt_side, thread_side);
        let before = (reset_flags, last);
        start(spawner, p, hello, before, sides, watchdog_fault);
    })
}

fn hello(flags: reset::ResetFlags, last: Option<reset::CrashRecord>) -> Hello {
    let build = concat!("ihd-firmware ", env!("CARGO_PKG_VERSION"));
    // Noise, as nothing else differs from one power-on to the next; else the starts since power-on. The chip's number makes both
    // different from other boards'.
    let starts = || last.map_or(0, |record| u32::from(record.starts) + 1);
    let seed = registers::random::word().unwrap_or_else(starts);
    let boot_id = uid::uid().iter().fold(seed, |id, &byte| {
        id.wrapping_mul(0x0100_0193) ^ u32::from(byte)
    });
    let mut hello = ours(ROLE_DEVICE, 0, boot_id, build, "stm32g474");
    hello.reset_reason = reset::reason(flags, last) as u8;
    hello.fault_before_reset = last.map_or(0, |record| record.fault);
    hello
}

/// Not inlined: its frame of 3 KiB would stay on the stack under everything that runs afterwards.
#[inline(never)]
fn start(
    spawner: Spawner,
    p: Peripherals,
    hello: Hello,
    (reset_flags, last): (u32, Option<reset::CrashRecord>),
    (interrupt_side, mut thread_side): (sampling::InterruptSide, ThreadSide),
    watchdog_fault: Option<Fault>,
) {
    let mut watchdog = IndependentWatchdog::new(p.IWDG, WATCHDOG_US);
    let housekeeping = HOUSEKEEPING.init_with(|| Housekeeping::new(hello));
    if !option_bytes_ok() {
        thread_side.with(|path| path.latch_fault(Fault::OPTION_BYTES));
    }
    let mut self_test = self_test(p.CRC, &mut thread_side, watchdog_fault);
    let (kept, fault) = reset::CrashRecord::kept_control(last);
    housekeeping.restore_control(&mut thread_side, kept, fault);
    housekeeping.set_identity(service::identity(reset_flags, last, &self_test));
    housekeeping.set_log(&LINK_LOG);
    let pages = lookup_pages(p.FLASH, housekeeping, &mut thread_side);
    let led = Led::new();
    // The thresholds first, then what compares with them, then what could switch on.
    registers::comparators::start();
    defmt::info!("comparators on");
    for pin in [
        Flex::new(p.PA0),
        Flex::new(p.PA1),
        Flex::new(p.PA7),
        Flex::new(p.PB0),
        Flex::new(p.PB1),
        Flex::new(of_board(HEAT_SINK_NTC_PIN)),
        Flex::new(of_board(GLASS_NTC_PIN)),
        Flex::new(of_board(COIL_NTC_PIN)),
    ] {
        analog(pin);
    }
    enable_clocks();
    // Only now: until HRTIM drives them low, the gate driver's pull-downs hold them.
    bridge_pin(Flex::new(p.PA8));
    bridge_pin(Flex::new(p.PA9));
    interrupt::DMA1_CHANNEL1.set_priority(Priority::P1);
    interrupt::USB_LP.set_priority(Priority::P3);
    interrupt::LPUART1.set_priority(Priority::P3);
    interrupt::FLASH.set_priority(Priority::P3);
    let sampling_spawner = SAMPLING_EXECUTOR.start(interrupt::DMA1_CHANNEL1);
    if let Ok(token) = SAMPLING_TASK.spawn(|| SamplingTask::new(Adc::start(), interrupt_side)) {
        sampling_spawner.spawn(token);
    }
    defmt::info!("timers and ADCs run, faults armed");
    if !is_sound(&registers::comparators::trip()) {
        thread_side.with(|path| path.latch_fault(Fault::COMPARATOR_TEST));
    }
    if !registers::sampling_watchdog::is_sound() {
        thread_side.with(|path| path.latch_fault(Fault::WATCHDOG_TEST));
    }
    let driver = Driver::new(p.USB, Irqs, p.PA12, p.PA11);
    let (device, usb_receiver, usb_sender) = usb::start(driver, uid::uid_hex());
    let uart = serial_port(p.LPUART1, p.PA3, p.PA2);
    self_test.begin();
    watchdog.unleash();
    // It counts from 0xFFF, 512 ms, until its own value is loaded (RM0440, IWDG).
    watchdog.pet();
    defmt::info!("watchdog runs: {=u32} µs", WATCHDOG_US);
    let board = Board {
        watchdog,
        led,
        heartbeat: Heartbeat::default(),
        saves: SaveInterval::default(),
        self_test,
        temperatures: TemperatureAdc::start(adc::sampled_cycles()),
        fan: low_output(FAN_PIN),
        panel: Panel::new(),
        share_wire: ShareWire::new(),
    };
    if let Ok(token) = nonvolatile_pages::keep(pages) {
        spawner.spawn(token);
    }
    if let Ok(token) = usb_task(device) {
        spawner.spawn(token);
    }
    let usb = (usb_receiver, usb_sender);
    if let Ok(token) = link_task(usb, uart, housekeeping, thread_side, board) {
        spawner.spawn(token);
    }
}

/// Returns `true` if each comparator tripped, and neither still does.
fn is_sound(test: &Comparators) -> bool {
    test.positive_tripped && test.positive_quiet && test.negative_tripped && test.negative_quiet
}

/// Self-tests at start that go on while the program runs.
fn self_test(
    unit: Peri<'static, CRC>,
    path: &mut ThreadSide,
    watchdog_fault: Option<Fault>,
) -> SelfTest {
    let (self_test, faults) = SelfTest::at_start(unit);
    for fault in faults.into_iter().chain([watchdog_fault]).flatten() {
        defmt::error!("self-test: fault {=u16}", fault.number());
        path.with(|path| path.latch_fault(fault));
    }
    self_test
}

/// FLASH_OPTR; what is wrong is a fault as long as the program runs.
fn option_bytes_ok() -> bool {
    let (banks, parity) = (
        registers::supply::has_two_banks(),
        registers::supply::has_parity(),
    );
    defmt::info!(
        "option bytes: DBANK {=bool}, RAM parity {=bool}",
        banks,
        parity
    );
    if !(banks && parity) {
        defmt::error!("set option bytes DBANK = 1 and SRAM_PE = 0 (docs/board.md)");
    }
    banks && parity
}

/// The pages of the lookup; what they hold becomes active. embassy's driver panics where its idea of the
/// banks is not the chip's.
fn lookup_pages(
    flash: Peri<'static, peripherals::FLASH>,
    housekeeping: &mut Housekeeping,
    path: &mut ThreadSide,
) -> LookupPages {
    let two_banks = registers::supply::has_two_banks();
    let (pages, lookup) = LookupPages::load(two_banks.then(|| Flash::new(flash, Irqs)));
    match lookup {
        Some(lookup) => {
            defmt::info!("lookup {=u32} from flash", lookup.version);
            housekeeping.restore(path, lookup);
        }
        None => defmt::info!("no lookup in flash"),
    }
    pages
}

/// The clocks of what [`registers`] drives.
fn enable_clocks() {
    rcc::enable_and_reset::<peripherals::HRTIM1>();
    rcc::enable_and_reset::<peripherals::ADC1>();
    rcc::enable_and_reset::<peripherals::ADC3>();
    rcc::enable_and_reset::<peripherals::DMA1>();
    rcc::enable_and_reset::<peripherals::DMAMUX1>();
}

fn analog(mut pin: Flex<'static>) {
    pin.set_as_analog();
    // Dropped, it would be disconnected.
    core::mem::forget(pin);
}

/// HRTIM's alternate function on port A is 13 (DS12288, table "Alternate function").
fn bridge_pin(mut pin: Flex<'static>) {
    pin.set_as_af_unchecked(13, AfType::output(OutputType::PushPull, Speed::VeryHigh));
    core::mem::forget(pin);
}

fn serial_port(
    uart: Peri<'static, LPUART1>,
    receive: Peri<'static, peripherals::PA3>,
    transmit: Peri<'static, peripherals::PA2>,
) -> Option<(serial::Receiver, serial::Sender)> {
    static TRANSMIT: StaticCell<[u8; serial::TRANSMIT_BUFFER]> = StaticCell::new();
    static RECEIVE: StaticCell<[u8; serial::RECEIVE_BUFFER]> = StaticCell::new();
    let out = TRANSMIT.init([0; serial::TRANSMIT_BUFFER]);
    let inbound = RECEIVE.init([0; serial::RECEIVE_BUFFER]);
    let mut config = usart::Config::default();
    config.baudrate = ihd_shared::wire::SERIAL_BAUD;
    // Without a cable the pin would pick up noise, and a byte takes the answers to this port.
    config.rx_pull = Pull::Up;
    let uart = BufferedUart::new(uart, receive, transmit, out, inbound, Irqs, config).ok()?;
    let (sender, receiver) = uart.split();
    Some((serial::Receiver(receiver), serial::Sender(sender)))
}

#[embassy_executor::task]
async fn usb_task(mut device: UsbDevice<'static, UsbDriver>) -> ! {
    device.run().await
}

#[embassy_executor::task]
async fn link_task(
    usb: (usb::Receiver, usb::Sender),
    serial: Option<(serial::Receiver, serial::Sender)>,
    housekeeping: &'static mut Housekeeping,
    path: ThreadSide,
    mut board: Board,
) -> ! {
    let tick = |housekeeping: &mut Housekeeping, path: &mut ThreadSide| {
        board.after_block(housekeeping, path);
    };
    match serial {
        Some(serial) => link::run(usb, serial, housekeeping, path, tick).await,
        None => link::run(usb, (NoPort, NoPort), housekeeping, path, tick).await,
    }
}

impl Board {
    /// Exchanges faults, temperatures and the fan with the hardware after each block.
    fn after_block(&mut self, housekeeping: &mut Housekeeping, path: &mut ThreadSide) {
        let is_slow_stopped = registers::adc::is_slow_stopped();
        cycles::keep_running();
        let (blocks, now_ms) = path.with(|path| {
            if let Some(fault) = registers::faults::hardware_fault(path) {
                path.raise(fault);
            }
            if is_slow_stopped {
                path.raise(Fault::SAMPLES_LOST);
            }
            (path.blocks(), path.now_ms())
        });
        let control = housekeeping.control();
        let (state, fault) = (control.state(), path.with(|path| path.fault()));
        let now = adc::sampled_cycles();
        self.led.show(state, fault, now);
        if self.temperatures.after_block(now) {
            housekeeping.set_temperatures(self.temperatures.codes());
            if self.temperatures.has_new_reference() {
                let scale = housekeeping.set_reference(self.temperatures.reference());
                adc::set_supply_scale(scale);
                registers::comparators::correct(scale);
            }
            self.fan.set_level(housekeeping.fan().into());
            self.panel.exchange(housekeeping, path);
            self.share_wire.exchange(housekeeping, path);
        }
        let failed = self.self_test.after_block(housekeeping, blocks);
        if let Some(fault) = failed {
            path.with(|path| path.latch_fault(fault));
        }
        let mut services = ChipServices {
            self_test: &mut self.self_test,
            temperatures: &self.temperatures,
        };
        housekeeping.serve(path, &mut services);
        let is_open = path.with(|path| path.drive().bridge == Bridge::Open);
        let is_right = self.self_test.is_flow_right() || is_open;
        if self.heartbeat.beat(blocks) && is_right && !is_slow_stopped {
            self.watchdog.pet();
        }
        // Where a turn takes longer than a block, not every count is seen here.
        if blocks >= reset::GOOD_START_BLOCKS {
            crash::ran_well();
        }
        // By the count of changes: a version may come again after a reset.
        let changes = housekeeping.lookup_changes();
        if housekeeping.control().state() == State::Idle && self.saves.begin(changes, now_ms) {
            TO_KEEP.signal(housekeeping.lookup().clone());
        }
    }
}
