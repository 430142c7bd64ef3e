//! USB: the chip's peripheral, and what is at the other end of the cable.
