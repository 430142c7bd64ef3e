//! What hangs behind a debug port.

/// An access that the bus answers with an error.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BusFault;

/// Why a core stands still.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stop {
    /// It was halted, or has made its step.
    Asked,
    /// It met a breakpoint.
    Breakpoint,
    /// It cannot go on: no code where it is.
    LockedUp,
}

/// Whether probe and target can be reached.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Contact {
    /// They can.
    Good,
    /// The target has no power.
    NoPower,
    /// The probe was pulled out.
    NoProbe,
}

/// A core with its memory. Registers are numbered as by `DCRSR`: 0 to 15, 16 for xPSR, 17 and 18 for the stack pointers.
pub trait Target: Send {
    /// Reads 1, 2 or 4 bytes, aligned.
    ///
    /// # Errors
    /// Where nothing answers.
    fn read(&mut self, address: u32, bytes: u32) -> Result<u32, BusFault>;

    /// Writes 1, 2 or 4 bytes, aligned.
    ///
    /// # Errors
    /// Where nothing answers.
    fn write(&mut self, address: u32, bytes: u32, value: u32) -> Result<(), BusFault>;

    /// A register of the core, which stands still.
    fn register(&mut self, number: u32) -> u32;

    /// Sets one.
    fn set_register(&mut self, number: u32, value: u32);

    /// Stops the core.
    fn halt(&mut self);

    /// Lets it run.
    fn run(&mut self);

    /// One instruction.
    fn step(&mut self);

    /// Resets core and peripherals; the core runs then.
    fn reset(&mut self);

    /// Why the core stands still; `None` while it runs. Asked before each access, it may let the core go on meanwhile.
    fn stopped(&mut self) -> Option<Stop>;

    /// Whether it can be reached.
    fn contact(&self) -> Contact;
}
