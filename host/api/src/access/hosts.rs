//! Accepted values of the header `Host`: without this check, any web page could reach the server by DNS rebinding.

use std::net::IpAddr;

use axum::http::header::HOST;
use axum::http::request::Parts;

/// Accepted host names and addresses, in lower case, without port.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct AllowedHosts(Vec<String>);

impl AllowedHosts {
    /// Accepts the names of loopback, the address `listen` and `others`.
    pub fn new(listen: IpAddr, others: &[String]) -> Self {
        let mut names: Vec<String> = ["localhost", "127.0.0.1", "[::1]"].map(Into::into).into();
        if !listen.is_unspecified() {
            names.push(match listen {
                IpAddr::V4(ip) => ip.to_string(),
                IpAddr::V6(ip) => format!("[{ip}]"),
            });
        }
        names.extend(others.iter().map(|name| match name.parse() {
            Ok(IpAddr::V6(ip)) => format!("[{ip}]"),
            _ => name.to_ascii_lowercase(),
        }));
        Self(names)
    }

    /// Returns `true` if the request has exactly one `Host`, and it is accepted.
    pub fn allows(&self, request: &Parts) -> bool {
        let mut hosts = request.headers.get_all(HOST).iter();
        let (Some(host), None) = (hosts.next(), hosts.next()) else {
            return false;
        };
        // An absolute URI in the request line outranks the header.
        let target = request.uri.authority().map(|a| a.as_str());
        host.to_str().is_ok_and(|host| self.contains(host))
            && target.is_none_or(|t| self.contains(t))
    }

    fn contains(&self, host: &str) -> bool {
        let name = without_port(host).to_ascii_lowercase();
        self.0.contains(&name)
    }
}

/// Returns the host without port: `[::1]:80` → `[::1]`, `localhost:80` → `localhost`.
fn without_port(host: &str) -> &str {
    match host.rsplit_once(':') {
        Some((name, port)) if !port.ends_with(']') && port.bytes().all(|b| b.is_ascii_digit()) => {
            name
        }
        _ => host,
    }
}

#[cfg(test)]
mod tests {
    use axum::http::Request;

    use super::*;

    fn parts(hosts: &[&str], uri: &str) -> Parts {
        let mut request = Request::builder().uri(uri);
        for host in hosts {
            request = request.header("host", *host);
        }
        request.body(()).unwrap().into_parts().0
    }

    #[test]
    fn only_names_of_the_list_pass() {
        let others = ["Hob.Kitchen.lan".into(), "fd00::5".into()];
        let allowed = AllowedHosts::new([192, 168, 1, 5].into(), &others);
        for good in [
            "localhost",
            "LOCALHOST:8731",
            "127.0.0.1:8731",
            "[::1]:8731",
            "[::1]",
            "192.168.1.5",
            "hob.kitchen.lan:8731",
            "[fd00::5]:8731",
        ] {
            assert!(allowed.allows(&parts(&[good], "/")), "{good}");
        }
        for bad in [
            "",
            "evil.example",
            "localhost.evil.example",
            "evil.example:8731",
            "127.0.0.1.nip.io",
            "user@localhost",
            "localhost:80:80",
            "192.168.1.50",
            "0.0.0.0",
            "::1",
        ] {
            assert!(!allowed.allows(&parts(&[bad], "/")), "{bad}");
        }
    }

    #[test]
    fn no_host_two_hosts_and_a_foreign_request_line_do_not_pass() {
        let allowed = AllowedHosts::new([127, 0, 0, 1].into(), &[]);
        assert!(!allowed.allows(&parts(&[], "/")));
        assert!(!allowed.allows(&parts(&["localhost", "localhost"], "/")));
        assert!(!allowed.allows(&parts(&["localhost"], "http://evil.example/")));
        assert!(allowed.allows(&parts(&["localhost"], "http://localhost/")));
    }

    #[test]
    fn listening_everywhere_is_no_name() {
        let allowed = AllowedHosts::new([0, 0, 0, 0].into(), &[]);
        assert!(!allowed.allows(&parts(&["0.0.0.0"], "/")));
    }
}
