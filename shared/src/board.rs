//! Values of the board that this build is for, from its file (boards/; `IHD_BOARD` names another one).

/// Pin of the controller.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Pin {
    /// Port, 0 for A.
    pub port: u8,
    /// Line of the port.
    pub line: u8,
}

include!(concat!(env!("OUT_DIR"), "/board.rs"));
