//! The cookie that holds a token for a browser's page, whose scripts cannot read it.

use crate::percent;
use axum::http::HeaderMap;
use axum::http::header::COOKIE;

/// Its name.
const NAME: &str = "ihd-token";

/// The header that sets it. `Strict`: no other site's page or link brings it along.
pub(crate) fn given(token: &str, tls: bool) -> String {
    format!("{NAME}={}; {}", encoded(token), attributes(tls))
}

/// The header that deletes it.
pub(crate) fn taken_back(tls: bool) -> String {
    format!("{NAME}=; Max-Age=0; {}", attributes(tls))
}

fn attributes(tls: bool) -> &'static str {
    if tls {
        "Path=/; HttpOnly; SameSite=Strict; Secure"
    } else {
        "Path=/; HttpOnly; SameSite=Strict"
    }
}

/// Every token in the cookies of a request; other servers of this machine, on other ports, may have set one of this name too.
pub(crate) fn tokens(headers: &HeaderMap) -> impl Iterator<Item = String> {
    let lists = headers.get_all(COOKIE).into_iter();
    lists
        .flat_map(|list| list.to_str().unwrap_or_default().split(';'))
        .filter_map(|pair| pair.trim().strip_prefix(NAME)?.strip_prefix('='))
        .filter(|value| !value.is_empty())
        .filter_map(decoded)
}

/// A token that somebody wrote himself may hold `;` and quotes, which a cookie must not.
fn encoded(token: &str) -> String {
    percent::encoded(token, b"-_.~")
}

fn decoded(value: &str) -> Option<String> {
    let mut parts = value.split('%');
    let mut bytes = parts.next()?.as_bytes().to_vec();
    for part in parts {
        let digits = part.get(..2)?;
        bytes.push(u8::from_str_radix(digits, 16).ok()?);
        bytes.extend(&part.as_bytes()[2..]);
    }
    String::from_utf8(bytes).ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(cookies: &[&str]) -> Vec<String> {
        let mut headers = HeaderMap::new();
        for cookie in cookies {
            headers.append(COOKIE, cookie.parse().unwrap());
        }
        tokens(&headers).collect()
    }

    #[test]
    fn a_token_comes_back_as_it_went() {
        let printable: String = (b'!'..=b'~').map(char::from).collect();
        for token in ["0123abc", "a;b,c\"d\\e=%41", &printable] {
            let header = given(token, true);
            let (pair, attributes) = header.split_once("; ").unwrap();
            assert_eq!(of(&[pair]), [token], "{header}");
            assert!(!pair[10..].contains([';', ',', '"', '\\', '=']), "{pair}");
            for word in ["HttpOnly", "SameSite=Strict", "Path=/", "Secure"] {
                assert!(attributes.split("; ").any(|a| a == word), "{header}");
            }
        }
        assert!(!given("x", false).contains("Secure"));
        assert!(taken_back(false).contains("Max-Age=0"));
    }

    #[test]
    fn cookies_of_others_are_left_alone() {
        assert_eq!(of(&["a=1; ihd-token=x; b=2"]), ["x"]);
        assert_eq!(of(&["ihd-token=x", "a=1;ihd-token=y"]), ["x", "y"]);
        for none in [
            "",
            "ihd-token",
            "ihd-token=",
            "ihd-tokens=x",
            "xihd-token=x",
        ] {
            assert_eq!(of(&[none]), [""; 0], "{none}");
        }
        for broken in [
            "ihd-token=%",
            "ihd-token=%4",
            "ihd-token=%zz",
            "ihd-token=%FF",
            "ihd-token=%4\u{e9}",
        ] {
            assert_eq!(of(&[broken]), [""; 0], "{broken}");
        }
    }
}
