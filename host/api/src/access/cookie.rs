//! Cookie with the key of a browser session; scripts of the page cannot read it.

use axum::http::HeaderMap;
use axum::http::header::COOKIE;

/// Name of the cookie.
const NAME: &str = "ihd-session";

/// Returns the `Set-Cookie` value that sets it. `SameSite=Strict`: requests from other sites' pages do not carry it.
pub(crate) fn set_header(key: &str, tls: bool) -> String {
    format!("{NAME}={key}; {}", attributes(tls))
}

/// Returns the `Set-Cookie` value that deletes it.
pub(crate) fn delete_header(tls: bool) -> String {
    format!("{NAME}=; Max-Age=0; {}", attributes(tls))
}

fn attributes(tls: bool) -> &'static str {
    if tls {
        "Path=/; HttpOnly; SameSite=Strict; Secure"
    } else {
        "Path=/; HttpOnly; SameSite=Strict"
    }
}

/// Returns all session keys of a request. There may be several: servers on other ports of this machine share the cookie name.
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

    fn keys_of(cookies: &[&str]) -> Vec<String> {
        let mut headers = HeaderMap::new();
        for cookie in cookies {
            headers.append(COOKIE, cookie.parse().unwrap());
        }
        keys(&headers).map(str::to_owned).collect()
    }

    #[test]
    fn a_key_comes_back_as_it_went() {
        let header = set_header("0123abc", true);
        let (pair, attributes) = header.split_once("; ").unwrap();
        assert_eq!(keys_of(&[pair]), ["0123abc"], "{header}");
        for word in ["HttpOnly", "SameSite=Strict", "Path=/", "Secure"] {
            assert!(attributes.split("; ").any(|a| a == word), "{header}");
        }
        assert!(!set_header("x", false).contains("Secure"));
        assert!(delete_header(false).contains("Max-Age=0"));
    }

    #[test]
    fn cookies_of_others_are_left_alone() {
        assert_eq!(keys_of(&["a=1; ihd-session=x; b=2"]), ["x"]);
        assert_eq!(keys_of(&["ihd-session=x", "a=1;ihd-session=y"]), ["x", "y"]);
        for none in [
            "",
            "ihd-session",
            "ihd-session=",
            "ihd-sessions=x",
            "xihd-session=x",
        ] {
            assert_eq!(keys_of(&[none]), [""; 0], "{none}");
        }
    }
}
