//! RNG: noise of the chip itself (RM0440, 26), clocked by HSI48.

use embassy_stm32::pac;

/// Polls of RNG_SR that a word may take: it takes about a microsecond.
const MAX_POLLS: u32 = 10_000;

/// Random word; `None` if the generator reports an error or delivers nothing.
pub fn word() -> Option<u32> {
    let rcc = pac::RCC;
    rcc.ahb2enr().modify(|w| w.set_rngen(true));
    // The clock reaches the peripheral two cycles later (RCC, "Peripheral clock enable").
    let _ = rcc.ahb2enr().read();
    pac::RNG.cr().write(|w| w.set_rngen(true));
    // The first word after the start is to be discarded.
    let word = next().and_then(|_| next());
    pac::RNG.cr().write(|_| {});
    rcc.ahb2enr().modify(|w| w.set_rngen(false));
    word
}

/// Next word. RNG_SR reports a fault of the clock or of the noise source with CEIS and SEIS.
fn next() -> Option<u32> {
    let mut polls = (0..MAX_POLLS).map(|_| pac::RNG.sr().read());
    let status = polls.find(|status| status.drdy() || status.ceis() || status.seis())?;
    (!status.ceis() && !status.seis()).then(|| pac::RNG.dr().read())
}
