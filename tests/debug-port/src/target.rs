//! Target behind a debug port.

/// An access that the bus answers with an error.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BusFault;

/// Reason for which a core is halted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stop {
    /// It was halted, or has made its step.
    Asked,
    /// It met a breakpoint.
    Breakpoint,
    /// It cannot go on: no code where it is.
    LockedUp,
}

/// Reachability of probe and target.
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
    /// [`BusFault`] where nothing answers.
    fn read(&mut self, address: u32, bytes: u32) -> Result<u32, BusFault>;

    /// Writes 1, 2 or 4 bytes, aligned.
    ///
    /// # Errors
    /// [`BusFault`] where nothing answers.
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

    /// Returns the reason for which the core is halted; `None` while it runs. Called before each access; the core may run meanwhile.
    fn stopped(&mut self) -> Option<Stop>;

    /// Returns its reachability.
    fn contact(&self) -> Contact;
}
