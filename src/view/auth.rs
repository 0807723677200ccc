//! Access control: a secret token in the first address, a cookie from then on, and requests that name this server as
//! their host and, where pages send it, as their origin.
//!
//! The token keeps other users of the machine out. Checking `Host` stops a foreign page that points its own name at
//! this address (DNS rebinding); checking `Origin` stops one that opens a websocket to it, which sends the cookie
//! along.

use sha2::{Digest, Sha256};
use std::net::IpAddr;
use subtle::ConstantTimeEq;

/// Length of the token in bytes.
const BYTES: usize = 16;

/// The secret of one server.
#[derive(Clone)]
pub struct AccessToken(String);

impl AccessToken {
    /// Makes a new token from the system's random numbers.
    ///
    /// # Errors
    /// If the system gives none.
    pub fn new() -> std::io::Result<Self> {
        let mut bytes = [0; BYTES];
        getrandom::fill(&mut bytes).map_err(|e| std::io::Error::other(e.to_string()))?;
        Ok(Self(bytes.iter().map(|b| format!("{b:02x}")).collect()))
    }

    /// Returns the token in hexadecimal digits.
    pub fn text(&self) -> &str {
        &self.0
    }

    /// Whether `given` is the token; the time that this takes reveals nothing about the digits.
    pub fn is(&self, given: &str) -> bool {
        bool::from(self.0.as_bytes().ct_eq(given.as_bytes()))
    }
}

/// Hides the token, which would no longer be secret in a log.
impl std::fmt::Debug for AccessToken {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("Token(..)")
    }
}

/// The rules of one server.
#[derive(Clone, Debug)]
pub struct Guard {
    token: AccessToken,
    /// Name of the cookie: one per server, even if ssh forwards several from the same port, as browsers do not
    /// distinguish cookies of two ports.
    cookie: String,
    /// Names under which the server may be reached, in addition to those of the machine itself.
    hosts: Vec<String>,
}

impl Guard {
    /// Makes the rules of a server, also reachable as any of `hosts` (names or addresses, without ports).
    pub fn new(token: AccessToken, hosts: Vec<String>) -> Self {
        let digest = Sha256::digest(token.text());
        let cookie = digest.iter().take(4).fold("volseggs-".to_owned(), |name, byte| format!("{name}{byte:02x}"));
        Self { token, cookie, hosts }
    }

    /// Whether `Host` names this server: the loopback, or one of the allowed names. The port does not matter, as ssh
    /// may have changed it.
    pub fn allows_host(&self, host: Option<&str>) -> bool {
        let Some(name) = host.and_then(name_of) else { return false };
        let loopback =
            name.eq_ignore_ascii_case("localhost") || name.parse::<IpAddr>().is_ok_and(|ip| ip.is_loopback());
        loopback || self.hosts.iter().any(|h| h.eq_ignore_ascii_case(name))
    }

    /// Whether the request comes from a page of this server: its origin is `http://` or `https://` and the `Host` of
    /// the request, port included.
    pub fn allows_origin(&self, origin: Option<&str>, host: Option<&str>) -> bool {
        let (Some(origin), Some(host)) = (origin, host) else { return false };
        let of = origin.strip_prefix("http://").or_else(|| origin.strip_prefix("https://"));
        of.is_some_and(|of| of.eq_ignore_ascii_case(host))
    }

    /// Whether the token is right.
    pub fn allows_token(&self, token: &str) -> bool {
        self.token.is(token)
    }

    /// Whether the `Cookie` header holds the token.
    pub fn allows_cookie(&self, header: Option<&str>) -> bool {
        let of_ours = |part: &str| {
            let (name, value) = part.trim().split_once('=')?;
            (name == self.cookie).then(|| self.token.is(value))
        };
        header.is_some_and(|all| all.split(';').filter_map(of_ours).any(|right| right))
    }

    /// Returns the `Set-Cookie` header for a client that gave the token.
    pub fn set_cookie(&self) -> String {
        format!("{}={}; HttpOnly; SameSite=Strict; Path=/", self.cookie, self.token.text())
    }
}

/// The name or address of a `Host` header, without the port and the brackets of IPv6.
pub(super) fn name_of(host: &str) -> Option<&str> {
    if let Some(rest) = host.strip_prefix('[') {
        let (address, port) = rest.split_once(']')?;
        return (port.is_empty() || port.strip_prefix(':').is_some_and(is_port)).then_some(address);
    }
    match host.split_once(':') {
        None => Some(host),
        Some((name, port)) => is_port(port).then_some(name),
    }
}

fn is_port(text: &str) -> bool {
    text.parse::<u16>().is_ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn guard() -> Guard {
        Guard::new(AccessToken("00112233445566778899aabbccddeeff".into()), vec!["node7".into()])
    }

    #[test]
    fn tokens_are_long_and_never_the_same() {
        let [a, b] = [AccessToken::new().unwrap(), AccessToken::new().unwrap()];
        assert!(a.text().len() == 32 && a.text() != b.text());
        assert!(a.is(a.text()) && !a.is(b.text()) && !a.is("") && !a.is(&a.text()[..31]));
        assert_eq!(format!("{a:?}"), "Token(..)");
    }

    #[test]
    fn only_this_machine_and_names_that_were_allowed_are_hosts() {
        for good in ["localhost", "localhost:9000", "127.0.0.1:8137", "127.1.2.3", "[::1]:8137", "[::1]", "NODE7:80"] {
            assert!(guard().allows_host(Some(good)), "{good}");
        }
        let bad =
            ["evil.example", "127.0.0.1.evil.example", "localhost.evil:80", "[::1", "localhost:x", "10.0.0.1", ""];
        for bad in bad {
            assert!(!guard().allows_host(Some(bad)), "{bad}");
        }
        assert!(!guard().allows_host(None));
    }

    #[test]
    fn only_pages_of_this_server_may_open_sockets() {
        let allows = |origin, host| guard().allows_origin(origin, host);
        assert!(allows(Some("http://localhost:9000"), Some("localhost:9000")));
        for origin in
            ["http://localhost:9001", "http://evil.example", "null", "localhost:9000", "file://localhost:9000"]
        {
            assert!(!allows(Some(origin), Some("localhost:9000")), "{origin}");
        }
        assert!(!allows(None, Some("localhost:9000")) && !allows(Some("http://localhost"), None));
    }

    #[test]
    fn the_cookie_of_this_server_alone_holds_the_token() {
        let right = guard().set_cookie();
        let pair = right.split(';').next().unwrap();
        assert!(right.contains("HttpOnly") && right.contains("SameSite=Strict"));
        assert!(guard().allows_cookie(Some(pair)) && guard().allows_cookie(Some(&format!("a=b; {pair}; c=d"))));
        let name = pair.split('=').next().unwrap();
        for wrong in ["", name, &format!("{name}=0"), "volseggs-1=00112233445566778899aabbccddeeff", "=;=;"] {
            assert!(!guard().allows_cookie(Some(wrong)), "{wrong}");
        }
        let other = Guard::new(AccessToken("f".repeat(32)), Vec::new()).set_cookie();
        assert_ne!(other.split('=').next().unwrap(), name, "the cookies of two servers do not replace each other");
        assert!(!guard().allows_cookie(None));
    }
}
