//! State of control that outlives a reset: without it a restart over the link would end a lock-out.

/// State of restart policy and panel that only a person or the loss of power ends.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct RetainedControl {
    /// Only a person at the panel can go on.
    pub locked_out: bool,
    /// Starts after trips that are used up.
    pub tries_used: u8,
    /// The panel's level, which limits a host: 0 refuses it, [`RetainedControl::KEEP_WARM`] keeps warm. `None` if nobody has
    /// touched the panel.
    pub panel_level: Option<u8>,
    /// The keys are locked.
    pub key_locked: bool,
    /// Used share of the time without a touch of the panel, of 255.
    pub unattended: u8,
}

impl RetainedControl {
    const LOCKED_OUT: u8 = 1 << 7;
    const KEY_LOCKED: u8 = 1 << 5;
    const TRIES_MASK: u8 = Self::KEY_LOCKED - 1;
    /// Level of keeping warm: above every level of power.
    pub const KEEP_WARM: u8 = 10;

    /// Encodes as three bytes; all bits zero for the default.
    pub const fn to_bytes(self) -> [u8; 3] {
        let mut byte = self.tries_used & Self::TRIES_MASK;
        if self.locked_out {
            byte |= Self::LOCKED_OUT;
        }
        if self.key_locked {
            byte |= Self::KEY_LOCKED;
        }
        let panel = match self.panel_level {
            Some(level) => level + 1,
            None => 0,
        };
        [byte, self.unattended, panel]
    }

    /// Decodes what [`RetainedControl::to_bytes`] gave.
    pub const fn from_bytes([byte, unattended, panel]: [u8; 3]) -> Self {
        Self {
            locked_out: byte & Self::LOCKED_OUT != 0,
            tries_used: byte & Self::TRIES_MASK,
            panel_level: panel.checked_sub(1),
            key_locked: byte & Self::KEY_LOCKED != 0,
            unattended,
        }
    }
}
