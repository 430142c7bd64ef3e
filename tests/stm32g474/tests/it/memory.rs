//! RAM after power-on: content and parity are arbitrary, so a word must be written before it is read (RM0440, 2.4.3).

use ihd_sim::behavioural::PotKind;

use crate::board::with_pot;

/// End of SRAM1, in bytes from the RAM's beginning; parity is checked in its first 32 KiB and in CCM SRAM. SRAM2 has
/// none. It holds the crash record, which start-up reads before anything else.
const SRAM1_BYTES: usize = 80 * 1024;

/// Time until the program proper begins; not longer, as Unicorn's exclusive stores fail while memory is watched.
const START_S: f64 = 0.061;

#[test]
fn start_up_writes_the_ram_before_it_reads_it() {
    let bench = with_pot(PotKind::Ferromagnetic);
    bench.with(|machine| {
        machine.power_cycle().unwrap();
        machine.watch_ram().unwrap();
    });
    bench.run_s(START_S);
    let (read, unwritten) = bench.with(|machine| {
        let written = machine.written();
        let unwritten = written
            .iter()
            .take(SRAM1_BYTES)
            .filter(|&&done| !done)
            .count();
        (machine.read_unwritten(), unwritten)
    });
    assert_eq!(unwritten, 0, "bytes of SRAM1");
    let in_sram1 = |address: u32| ((address - 0x2000_0000) as usize) < SRAM1_BYTES;
    assert!(
        !read.iter().any(|&(address, _)| in_sram1(address)),
        "{read:x?}"
    );
}
