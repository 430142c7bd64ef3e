//! Cleaning of the strings in a device's hello.

use ihd_shared::wire::hello::ours;
use ihd_shared::wire::messages::Hello;
use ihd_signal::printable;

/// Replaces the strings of a hello by their [`printable()`] form, cut to the length that the message allows.
pub fn printable_hello(hello: Hello) -> Hello {
    let [build, board] = [&hello.build, &hello.board].map(|text| printable(text).to_string());
    let Hello { build, board, .. } = ours(hello.role, 0, 0, &build, &board);
    Hello {
        build,
        board,
        ..hello
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_hello_is_cut_rather_than_refused() {
        let hello = ours(1, 0, 7, "x\u{7}", &"\u{1b}".repeat(30));
        let hello = printable_hello(hello);
        assert_eq!(hello.build, "x\\u{7}");
        assert_eq!(hello.board.len(), 32);
        assert_eq!(hello.boot_id, 7);
        assert!(!hello.board.chars().any(char::is_control));
    }
}
