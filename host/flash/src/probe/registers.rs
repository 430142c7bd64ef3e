//! Registers of the chip that a probe accesses (RM0440).

/// `DBGMCU_IDCODE`, 47.6.1.
pub const IDCODE: u32 = 0xE004_2000;
/// `DBGMCU_CR`, 47.6.2.
pub const DBGMCU_CR: u32 = 0xE004_2004;
/// DBG_SLEEP, DBG_STOP and DBG_STANDBY of that register: the bus answers while the core sleeps.
pub const DBG_WHILE_ASLEEP: u32 = 0b111;
/// Unique device id, 48.1.
pub const UNIQUE_ID: u32 = 0x1FFF_7590;
/// Flash size in KiB, 48.2: a half word.
pub const FLASH_SIZE: u32 = 0x1FFF_75E0;

/// `RCC_APB2ENR`, 7.4.17.
pub const APB2ENR: u32 = 0x4002_1060;
/// `HRTIM1EN` of that register.
pub const HRTIM1EN: u32 = 1 << 26;
/// `HRTIM_OENR`, 27.5.60: active outputs, bits 11:0.
pub const OENR: u32 = 0x4001_6B94;
/// `HRTIM_ODISR`, 27.5.61: ones switch outputs off, which are then low.
pub const ODISR: u32 = 0x4001_6B98;
/// Bits of the outputs.
pub const OUTPUTS: u32 = 0xFFF;

/// `FLASH_KEYR`, 3.7.3.
pub const KEYR: u32 = 0x4002_2008;
/// `FLASH_OPTKEYR`, 3.7.4.
pub const OPTKEYR: u32 = 0x4002_200C;
/// `FLASH_SR`, 3.7.5.
pub const SR: u32 = 0x4002_2010;
/// `FLASH_CR`, 3.7.6.
pub const CR: u32 = 0x4002_2014;
/// `FLASH_OPTR`, 3.7.8.
pub const OPTR: u32 = 0x4002_2020;
/// `FLASH_WRP1AR`, `FLASH_WRP1BR`, `FLASH_WRP2AR`, `FLASH_WRP2BR`.
pub const WRP: [u32; 4] = [0x4002_202C, 0x4002_2030, 0x4002_204C, 0x4002_2050];

/// Keys that unlock `FLASH_CR`.
pub const KEYS: [u32; 2] = [0x4567_0123, 0xCDEF_89AB];
/// Keys that unlock the option bytes.
pub const OPTION_KEYS: [u32; 2] = [0x0819_2A3B, 0x4C5D_6E7F];

/// `FLASH_SR`: busy.
pub const BSY: u32 = 1 << 16;
/// `FLASH_SR`: all errors, cleared by writing ones.
pub const ERRORS: u32 = 0xC3FA;
/// `FLASH_CR`: start writing the option bytes.
pub const OPTSTRT: u32 = 1 << 17;
/// `FLASH_CR`: load the option bytes, which resets the chip.
pub const OBL_LAUNCH: u32 = 1 << 27;

/// Names of the errors in a value of `FLASH_SR`.
pub fn errors_of(status: u32) -> String {
    let names = [
        (1, "OPERR"),
        (3, "PROGERR: not erased"),
        (4, "WRPERR: write-protected"),
        (5, "PGAERR"),
        (6, "SIZERR"),
        (7, "PGSERR"),
        (8, "MISSERR"),
        (9, "FASTERR"),
        (14, "RDERR"),
        (15, "OPTVERR"),
    ];
    let set = names.iter().filter(|(bit, _)| status & 1 << bit != 0);
    let set: Vec<_> = set.map(|(_, name)| *name).collect();
    match set.is_empty() {
        true => format!("FLASH_SR = {status:#010x}"),
        false => format!("{} (FLASH_SR = {status:#010x})", set.join(", ")),
    }
}
