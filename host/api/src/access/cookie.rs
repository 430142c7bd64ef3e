//! The cookie that holds the key of a browser's session, which the page's scripts cannot read.

use axum::http::HeaderMap;
use axum::http::header::COOKIE;

/// Its name.
const NAME: &str = "ihd-session";

/// The header that sets it. `Strict`: no other site's page or link brings it along.
pub(crate) fn given(key: &str, tls: bool) -> String {
    format!("{NAME}={key}; {}", attributes(tls))
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

/// Every key in the cookies of a request; other servers of this machine, on other ports, may have set one of this name too.
pub(crate) fn keys(headers: &HeaderMap) -> impl Iterator<Item = &str> {
    let lists = headers.get_all(COOKIE).into_iter();
    lists
        .flat_map(|list| list.to_str().unwrap_or_default().split(';'))
        .filter_map(|pair| pair.trim().strip_prefix(NAME)?.strip_prefix('='))
        .filter(|value| !value.is_empty())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(cookies: &[&str]) -> Vec<String> {
        let mut headers = HeaderMap::new();
        for cookie in cookies {
            headers.append(COOKIE, cookie.parse().unwrap());
        }
        keys(&headers).map(str::to_owned).collect()
    }

    #[test]
    fn a_key_comes_back_as_it_went() {
        let header = given("0123abc", true);
        let (pair, attributes) = header.split_once("; ").unwrap();
        assert_eq!(of(&[pair]), ["0123abc"], "{header}");
        for word in ["HttpOnly", "SameSite=Strict", "Path=/", "Secure"] {
            assert!(attributes.split("; ").any(|a| a == word), "{header}");
        }
        assert!(!given("x", false).contains("Secure"));
        assert!(taken_back(false).contains("Max-Age=0"));
    }

    #[test]
    fn cookies_of_others_are_left_alone() {
        assert_eq!(of(&["a=1; ihd-session=x; b=2"]), ["x"]);
        assert_eq!(of(&["ihd-session=x", "a=1;ihd-session=y"]), ["x", "y"]);
        for none in [
            "",
            "ihd-session",
            "ihd-session=",
            "ihd-sessions=x",
            "xihd-session=x",
        ] {
            assert_eq!(of(&[none]), [""; 0], "{none}");
        }
    }
}
