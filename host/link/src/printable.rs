//! Text that came from a device, before anybody sees it.

use ihd_shared::wire::hello::ours;
use ihd_shared::wire::messages::Hello;

/// `text` without what a terminal would obey: control characters, and those that change the order of letters or
/// cannot be seen, become `\u{..}`. Whatever reaches a terminal, a log or a file from a device passes here.
pub fn printable(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for c in text.chars() {
        if matches!(c, '\'' | '"' | '\\') || c.escape_debug().len() == 1 {
            out.push(c);
        } else {
            out.extend(c.escape_unicode());
        }
    }
    out
}

/// A hello whose strings are [`printable`], cut where that makes them too long.
pub fn printable_hello(hello: Hello) -> Hello {
    let [build, board] = [&hello.build, &hello.board].map(|text| printable(text));
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
    fn what_a_terminal_would_obey_is_shown_instead() {
        let evil = "a\u{1b}[2Jb\r\n\u{9b}c\u{202e}d\u{200b}\u{7f}";
        let shown = printable(evil);
        assert_eq!(
            shown,
            "a\\u{1b}[2Jb\\u{d}\\u{a}\\u{9b}c\\u{202e}d\\u{200b}\\u{7f}"
        );
        assert!(!shown.chars().any(char::is_control));
    }

    #[test]
    fn ordinary_text_stays() {
        let text = "it's \"ihd\" 1.0 \\ 25 µH, 日本";
        assert_eq!(printable(text), text);
    }

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
