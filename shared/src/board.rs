//! Values of the board that this build is for, from its file (boards/; `IHD_BOARD` names another one).

include!(concat!(env!("OUT_DIR"), "/board.rs"));
