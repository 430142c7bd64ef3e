//! State of control that outlives a reset: without it a restart over the link would end a lock-out.

use crate::limits::HIGHEST_LEVEL;

/// Setting of the panel.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum PanelSetting {
    /// Nobody has touched the panel.
    #[default]
    Untouched,
    /// Level of power, 1 to 9; 0 is a person's off, which alone refuses the host.
    Level(u8),
    /// Keeps warm what stands on the glass.
    KeepWarm,
}

impl PanelSetting {
    /// A person's off.
    pub const OFF: Self = Self::Level(0);
    /// Byte of [`PanelSetting::KeepWarm`]: above that of every level.
    const KEEP_WARM: u8 = 11;

    const fn to_byte(self) -> u8 {
        match self {
            Self::Untouched => 0,
            Self::Level(level) => level + 1,
            Self::KeepWarm => Self::KEEP_WARM,
        }
    }

    /// Decodes a byte; one that no setting has is a person's off.
    const fn from_byte(byte: u8) -> Self {
        match byte {
            0 => Self::Untouched,
            1..Self::KEEP_WARM => Self::Level(byte - 1),
            Self::KEEP_WARM => Self::KeepWarm,
            _ => Self::OFF,
        }
    }
}

// Level 0 has byte 1.
const _: () = assert!(HIGHEST_LEVEL + 1 < PanelSetting::KEEP_WARM);

/// State of restart policy and panel that only a person or the loss of power ends.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct RetainedControl {
    /// Only a person at the panel can go on.
    pub locked_out: bool,
    /// Starts after trips that are used up.
    pub tries_used: u8,
    /// The panel's setting, which limits a host.
    pub panel: PanelSetting,
    /// The keys are locked.
    pub key_locked: bool,
    /// Used share of the time without a touch of the panel, of 255.
    pub unattended: u8,
}

impl RetainedControl {
    const LOCKED_OUT: u8 = 1 << 7;
    const KEY_LOCKED: u8 = 1 << 5;
    const TRIES_MASK: u8 = Self::KEY_LOCKED - 1;

    /// Encodes as three bytes; all bits zero for the default.
    pub const fn to_bytes(self) -> [u8; 3] {
        let mut byte = self.tries_used & Self::TRIES_MASK;
        if self.locked_out {
            byte |= Self::LOCKED_OUT;
        }
        if self.key_locked {
            byte |= Self::KEY_LOCKED;
        }
        [byte, self.unattended, self.panel.to_byte()]
    }

    /// Decodes what [`RetainedControl::to_bytes`] gave.
    pub const fn from_bytes([byte, unattended, panel]: [u8; 3]) -> Self {
        Self {
            locked_out: byte & Self::LOCKED_OUT != 0,
            tries_used: byte & Self::TRIES_MASK,
            panel: PanelSetting::from_byte(panel),
            key_locked: byte & Self::KEY_LOCKED != 0,
            unattended,
        }
    }
}
