//! Which pages may connect, and who may command.
//!
//! Three checks, each against another trick. *Host*: a name server that gives its own name this machine's address
//! (DNS rebinding) does not make its pages ours. *Origin*: pages of other sites may not open our WebSocket or send
//! commands. *Token*: whoever may look may not therefore command.

use std::net::IpAddr;

use axum::http::{HeaderMap, header};

/// Bytes of randomness in a token.
const TOKEN_BYTES: usize = 16;

/// What the page's server lets in.
#[derive(Clone, Debug)]
pub(crate) struct Access {
    token: String,
    names: Vec<String>,
}

impl Access {
    /// Lets in by IP address, as `localhost`, and by this machine's name.
    pub(crate) fn new(token: String) -> Self {
        let mut names = vec!["localhost".to_owned()];
        if let Ok(name) = std::fs::read_to_string("/proc/sys/kernel/hostname") {
            let name = name.trim().to_ascii_lowercase();
            names.push(format!("{name}.local"));
            names.push(name);
        }
        Self { token, names }
    }

    /// Whether the request names this machine.
    pub(crate) fn host_is_ours(&self, headers: &HeaderMap) -> bool {
        text(headers, header::HOST).is_some_and(|host| self.names_this_machine(host))
    }

    /// Whether the request comes from our own page, or from no page at all (a program).
    pub(crate) fn origin_is_ours(&self, headers: &HeaderMap) -> bool {
        let Some(origin) = headers.get(header::ORIGIN) else {
            return true;
        };
        let host = text(headers, header::HOST);
        origin
            .to_str()
            .ok()
            .and_then(|origin| origin.split_once("://"))
            .is_some_and(|(_, authority)| Some(authority) == host)
    }

    /// Whether the request carries the token.
    pub(crate) fn may_command(&self, headers: &HeaderMap) -> bool {
        text(headers, header::AUTHORIZATION)
            .and_then(|value| value.strip_prefix("Bearer "))
            .is_some_and(|given| same(given.as_bytes(), self.token.as_bytes()))
    }

    fn names_this_machine(&self, host: &str) -> bool {
        // "[::1]:8080", "127.0.0.1:8080", "gripper.local:8080"
        let name = match host.strip_prefix('[').and_then(|rest| rest.split_once(']')) {
            Some((address, _port)) => address,
            None => host.split_once(':').map_or(host, |(name, _port)| name),
        };
        name.parse::<IpAddr>().is_ok()
            || self
                .names
                .iter()
                .any(|known| known.eq_ignore_ascii_case(name))
    }
}

fn text(headers: &HeaderMap, name: header::HeaderName) -> Option<&str> {
    headers.get(name).and_then(|value| value.to_str().ok())
}

/// Compares in a time that does not tell where the difference is.
fn same(given: &[u8], wanted: &[u8]) -> bool {
    given.len() == wanted.len()
        && given
            .iter()
            .zip(wanted)
            .fold(0, |difference, (a, b)| difference | (a ^ b))
            == 0
}

/// A new token: 128 random bits in hex.
///
/// # Errors
/// The system has no randomness.
pub(crate) fn new_token() -> Result<String, getrandom::Error> {
    let mut bytes = [0; TOKEN_BYTES];
    getrandom::fill(&mut bytes)?;
    Ok(bytes.iter().map(|byte| format!("{byte:02x}")).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn headers(pairs: &[(header::HeaderName, &str)]) -> HeaderMap {
        pairs
            .iter()
            .map(|(name, value)| (name.clone(), value.parse().unwrap()))
            .collect()
    }

    #[test]
    fn a_name_that_points_here_is_not_ours() {
        let access = Access::new("t".to_owned());
        for (host, ours) in [
            ("127.0.0.1:8080", true),
            ("192.168.0.7", true),
            ("[::1]:8080", true),
            ("localhost:8080", true),
            ("evil.example:8080", false),
            ("localhost.evil.example", false),
            ("", false),
        ] {
            assert_eq!(
                access.host_is_ours(&headers(&[(header::HOST, host)])),
                ours,
                "{host}"
            );
        }
        assert!(!access.host_is_ours(&HeaderMap::new()));
    }

    #[test]
    fn a_page_of_another_origin_is_refused_and_a_program_is_not() {
        let access = Access::new("t".to_owned());
        let host = (header::HOST, "192.168.0.7:8080");
        let from = |origin| headers(&[host.clone(), (header::ORIGIN, origin)]);
        assert!(access.origin_is_ours(&from("http://192.168.0.7:8080")));
        assert!(access.origin_is_ours(&headers(std::slice::from_ref(&host))));
        for origin in ["http://192.168.0.7", "https://evil.example", "null", ""] {
            assert!(!access.origin_is_ours(&from(origin)), "{origin}");
        }
    }

    #[test]
    fn only_the_whole_token_commands() {
        let access = Access::new("0123456789abcdef".to_owned());
        let with = |value| access.may_command(&headers(&[(header::AUTHORIZATION, value)]));
        assert!(with("Bearer 0123456789abcdef"));
        for value in [
            "Bearer 0123456789abcdee",
            "Bearer ",
            "Bearer 0123456789abcdef0",
            "0123456789abcdef",
        ] {
            assert!(!with(value), "{value}");
        }
        assert!(!access.may_command(&HeaderMap::new()));
    }

    #[test]
    fn tokens_differ() {
        let (one, other) = (new_token().unwrap(), new_token().unwrap());
        assert!(one.len() == 32 && one != other);
    }
}
