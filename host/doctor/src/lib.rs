//! What is wrong with a board, and with the machine it is plugged into.
