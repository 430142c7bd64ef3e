//! Rust source with its comments and literals blanked out, so that a search finds code and nothing else.

/// `text` with every comment, string and character literal replaced by spaces; line breaks stay where they are.
pub fn code_only(text: &str) -> String {
    let mut code = String::with_capacity(text.len());
    let mut rest = text;
    let mut after_word = false;
    while let Some(first) = rest.chars().next() {
        if let Some(length) = not_code(rest, after_word) {
            let (literal, tail) = rest.split_at(length);
            code.extend(literal.chars().map(|c| if c == '\n' { c } else { ' ' }));
            rest = tail;
            after_word = false;
        } else {
            code.push(first);
            rest = &rest[first.len_utf8()..];
            after_word = is_word(first);
        }
    }
    code
}

/// Whether `c` can stand in an identifier.
pub fn is_word(c: char) -> bool {
    c == '_' || c.is_alphanumeric()
}

/// The length of the comment or literal at the start of `rest`, if there is one.
fn not_code(rest: &str, after_word: bool) -> Option<usize> {
    if rest.starts_with("//") {
        Some(rest.find('\n').unwrap_or(rest.len()))
    } else if rest.starts_with("/*") {
        Some(block_comment(rest))
    } else if rest.starts_with('\'') {
        character(rest)
    } else if let Some(inside) = rest.strip_prefix('"') {
        Some(1 + quoted(inside))
    } else if after_word {
        // The r of `r"…"` begins a literal, the r at the end of a name does not.
        None
    } else {
        raw_string(rest)
    }
}

/// Block comments nest.
fn block_comment(rest: &str) -> usize {
    let mut depth = 0_u32;
    let mut at = 0;
    while let Some(step) = rest[at..].find(['/', '*']) {
        at += step;
        if rest[at..].starts_with("/*") {
            depth += 1;
            at += 2;
        } else if rest[at..].starts_with("*/") {
            depth -= 1;
            at += 2;
            if depth == 0 {
                return at;
            }
        } else {
            at += 1;
        }
    }
    rest.len()
}

/// Up to and with the closing quote of a string whose opening quote is behind us.
fn quoted(rest: &str) -> usize {
    let mut escaped = false;
    for (at, c) in rest.char_indices() {
        match c {
            _ if escaped => escaped = false,
            '\\' => escaped = true,
            '"' => return at + 1,
            _ => {}
        }
    }
    rest.len()
}

/// `'x'` or `'\n'`; a lifetime is code.
fn character(rest: &str) -> Option<usize> {
    let mut inside = rest.char_indices().skip(1);
    let (_, first) = inside.next()?;
    if first == '\\' {
        let (_, _escaped) = inside.next()?;
        let (end, _) = inside.find(|(_, c)| *c == '\'')?;
        return Some(end + 1);
    }
    let (end, closing) = inside.next()?;
    (closing == '\'').then_some(end + 1)
}

/// `r"…"`, `r#"…"#`, `br"…"`, `cr"…"`.
fn raw_string(rest: &str) -> Option<usize> {
    let body = ["r", "br", "cr"]
        .iter()
        .find_map(|prefix| rest.strip_prefix(prefix))?;
    let hashes = body.len() - body.trim_start_matches('#').len();
    let text = body[hashes..].strip_prefix('"')?;
    let closing = format!("\"{}", "#".repeat(hashes));
    let start = rest.len() - text.len();
    let end = text.find(&closing).map(|at| start + at + closing.len());
    Some(end.unwrap_or(rest.len()))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn words(text: &str) -> Vec<String> {
        let code = code_only(text);
        assert_eq!(code.lines().count(), text.lines().count(), "{text}");
        code.split_whitespace().map(str::to_owned).collect()
    }

    #[test]
    fn comments_go() {
        assert_eq!(words("a // b\nc /// d\n//! e"), ["a", "c"]);
        assert_eq!(words("a /* b /* c */ d\n */ e /* open"), ["a", "e"]);
    }

    #[test]
    fn strings_go() {
        assert_eq!(words(r#"a "b \" c" d b"e" "#), ["a", "d", "b"]);
        assert_eq!(words("a r#\"b \" c\"# d br\"e\\\" f"), ["a", "d", "f"]);
    }

    #[test]
    fn characters_go_and_lifetimes_stay() {
        assert_eq!(words("a '\"' b '\\'' c '\\u{41}' d"), ["a", "b", "c", "d"]);
        assert_eq!(words("&'a str"), ["&'a", "str"]);
    }

    #[test]
    fn names_that_end_in_r_are_no_raw_strings() {
        assert_eq!(
            words("for r#type in pr\"b\""),
            ["for", "r#type", "in", "pr"]
        );
    }
}
