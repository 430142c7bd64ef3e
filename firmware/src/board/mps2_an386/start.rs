//! Wires the board to the app.

use cortex_m::peripheral::NVIC;
use embassy_executor::Executor;
use embassy_executor::raw::TaskStorage;
use ihd_firmware::link::housekeeping::Housekeeping;
use ihd_firmware::link::service::NoBoardServices;
use ihd_firmware::retained::reset::{self, ResetFlags};
use ihd_shared::hob::F_SW_MAX_HZ;
use ihd_shared::lookup::prior::prior;
use ihd_shared::wire::hello::{CAP_SIMULATED, ROLE_DEVICE, ours};
use ihd_shared::wire::messages::Hello;
use static_cell::StaticCell;

use super::blocks::{SAMPLING_EXECUTOR, SilentAdc};
use super::vectors::Interrupt;
use super::{fault_injection, uart};
use crate::board::link::{self, NoPort};
use crate::board::sampling::{self, SamplingTask, ThreadSide};
use crate::board::{crash, sampling::InterruptSide};

static SAMPLING_TASK: TaskStorage<SamplingTask<SilentAdc>> = TaskStorage::new();
static EXECUTOR: StaticCell<Executor> = StaticCell::new();
static HOUSEKEEPING: StaticCell<Housekeeping> = StaticCell::new();

#[cortex_m_rt::entry]
fn main() -> ! {
    let last = crash::read_crash_record(ResetFlags::default());
    fault_injection::if_asked(last);
    let (r, l) = prior().interpolate(F_SW_MAX_HZ, 0);
    let Some((interrupt_side, thread_side)) = sampling::split(r, l) else {
        unreachable!("main runs once");
    };
    start_sampling(interrupt_side);
    EXECUTOR.init(Executor::new()).run(|spawner| {
        let hello = hello(last);
        if let Ok(token) = link_task(hello, thread_side) {
            spawner.spawn(token);
        }
    })
}

fn hello(last: Option<reset::CrashRecord>) -> Hello {
    // The absence of a crash record indicates power-on; every other start follows a reset
    // that this program asked for.
    let flags = ResetFlags {
        software: last.is_some(),
        ..ResetFlags::default()
    };
    let build = concat!("ihd-firmware ", env!("CARGO_PKG_VERSION"));
    let boot_id = last.map_or(0, |record| u32::from(record.starts) + 1);
    let mut hello = ours(ROLE_DEVICE, CAP_SIMULATED, boot_id, build, "mps2-an386");
    hello.reset_reason = reset::reason(flags, last) as u8;
    hello.fault_before_reset = last.map_or(0, |record| record.fault);
    hello
}

fn start_sampling(path: InterruptSide) {
    // SAFETY: before any interrupt is unmasked, nothing else uses the NVIC.
    let mut nvic: NVIC = unsafe { core::mem::transmute(()) };
    for (interrupt, priority) in [
        (Interrupt::Timer0, 1 << 5),
        (Interrupt::Uart0Receive, 3 << 5),
    ] {
        // SAFETY: no critical section relies on priorities, they mask all interrupts.
        unsafe { nvic.set_priority(interrupt, priority) };
    }
    let spawner = SAMPLING_EXECUTOR.start(Interrupt::Timer0);
    if let Ok(token) = SAMPLING_TASK.spawn(|| SamplingTask::new(SilentAdc::start(), path)) {
        spawner.spawn(token);
    }
}

#[embassy_executor::task]
async fn link_task(hello: Hello, path: ThreadSide) -> ! {
    let housekeeping = HOUSEKEEPING.init_with(|| Housekeeping::new(hello));
    let ports = uart::start();
    let tick = |housekeeping: &mut Housekeeping, path: &mut ThreadSide| {
        housekeeping.serve(path, &mut NoBoardServices);
    };
    link::run(ports, (NoPort, NoPort), housekeeping, path, tick).await
}
