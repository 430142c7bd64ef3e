//! State of control that outlives a reset: without it a restart over the link would end a lock-out.

/// State of restart policy and panel that only a person or the loss of power ends.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct RetainedControl {
    /// Only a person at the panel can go on.
    pub locked_out: bool,
    /// Starts after trips that are used up.
    pub tries_used: u8,
    /// The panel was switched off and refuses the host.
    pub panel_off: bool,
    /// The keys are locked.
    pub key_locked: bool,
}

impl RetainedControl {
    const LOCKED_OUT: u8 = 1 << 7;
    const PANEL_OFF: u8 = 1 << 6;
    const KEY_LOCKED: u8 = 1 << 5;
    const TRIES: u8 = Self::KEY_LOCKED - 1;

    /// Encodes as a byte; all bits zero for the default.
    pub const fn to_byte(self) -> u8 {
        let mut byte = self.tries_used & Self::TRIES;
        if self.locked_out {
            byte |= Self::LOCKED_OUT;
        }
        if self.panel_off {
            byte |= Self::PANEL_OFF;
        }
        if self.key_locked {
            byte |= Self::KEY_LOCKED;
        }
        byte
    }

    /// Decodes what [`RetainedControl::to_byte`] gave.
    pub const fn from_byte(byte: u8) -> Self {
        Self {
            locked_out: byte & Self::LOCKED_OUT != 0,
            tries_used: byte & Self::TRIES,
            panel_off: byte & Self::PANEL_OFF != 0,
            key_locked: byte & Self::KEY_LOCKED != 0,
        }
    }
}
