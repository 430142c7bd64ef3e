//! Check `certificate`: end of the daemon's TLS certificate.

use std::path::Path;

use ihd_api::tls::{RENEWAL_TIME, file_expires_s};
use ihd_doctor::Check;
use ihd_store::clock;

use crate::cli::configured;

const NAME: &str = "certificate";

/// Checks the certificate of a configuration; `None` if it has none, or cannot be read, which `store` reports.
pub(super) fn check(path: Option<&Path>) -> Option<Check> {
    let config = configured::config(path).ok()?;
    let (certificate, key) = configured::server_settings(&config).tls?.files();
    let file = certificate.display();
    if !certificate.exists() && config.tls.is_some_and(|tls| tls.certificate.is_none()) {
        return Some(Check::not_tested(
            NAME,
            format!("{file}: none yet; a daemon makes it"),
        ));
    }
    Some(match file_expires_s(&certificate) {
        Err(error) => Check::fail(NAME, error.to_string(), "Mend [tls] of the configuration"),
        Ok(None) => Check::pass(NAME, format!("{file} has no end")),
        Ok(Some(end_s)) => of_end(
            end_s,
            clock::of_the_machine()() / 1_000,
            &file.to_string(),
            &key,
        ),
    })
}

/// Checks the end of a certificate at a time, both in seconds since 1970.
fn of_end(end_s: i64, now_s: i64, file: &str, key: &Path) -> Check {
    let left_s = end_s - now_s;
    let end = clock::rfc3339(end_s.saturating_mul(1_000));
    let advice = || {
        let key = key.display();
        format!("Renew {file} and {key}: a running daemon reads them by itself")
    };
    if left_s < 0 {
        let finding = format!("{file} has expired on {end}: browsers refuse the page");
        Check::fail(NAME, finding, advice())
    } else if left_s < RENEWAL_TIME.as_secs().cast_signed() {
        Check::fail(NAME, format!("{file} ends on {end}"), advice())
    } else {
        Check::pass(NAME, format!("{file} ends on {end}"))
    }
}

#[cfg(test)]
mod tests {
    use ihd_doctor::CheckResult;

    use super::*;

    #[test]
    fn thirty_days_before_its_end_a_certificate_is_to_be_renewed() {
        let day = 86_400;
        for (left, verdict, word) in [
            (30 * day, CheckResult::Pass, "ends on"),
            (30 * day - 1, CheckResult::Fail, "ends on"),
            (-1, CheckResult::Fail, "has expired"),
        ] {
            let check = of_end(
                20_000 * day + left,
                20_000 * day,
                "c.pem",
                Path::new("k.pem"),
            );
            assert_eq!(check.verdict, verdict, "{check:?}");
            assert!(check.finding.contains(word), "{check:?}");
        }
    }
}
