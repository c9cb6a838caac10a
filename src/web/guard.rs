//! Access control of the page's server: which requests are refused, and why.
//!
//! A browser runs the pages of strangers, and without these rules any of them could drive the
//! robot.
//!
//! | request | rule | attack |
//! |---|---|---|
//! | foreign `Origin` | refused | a page of another server sends commands |
//! | foreign `Host`, on the loopback | refused | a foreign name is rebound to this address |
//! | no token, beyond the loopback | refused | another machine sends commands |
//!
//! The token is drawn at the start and printed as a part of the address. The page's files and its
//! WebSocket are requested without the query of that address, so the server answers it with a
//! cookie that carries the token.

use axum::http::{HeaderMap, Uri, header};
use std::io::Read;
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr, UdpSocket};

/// Rules of one server.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Guard {
    address: SocketAddr,
    token: Option<String>,
}

/// Reason why a request is refused.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum Refused {
    /// The request names another server.
    #[error("refused: this server is not `{0}`")]
    Host(String),
    /// The request comes from a page of another server.
    #[error("refused: a page from `{0}` may not command this robot")]
    Origin(String),
    /// The token is missing or wrong.
    #[error("refused: the token is missing or wrong; use the address that the program printed")]
    Token,
}

/// Number of random bytes in a token.
const TOKEN: usize = 16;
/// Name of the query's parameter.
const NAME: &str = "token";

impl Guard {
    /// Makes the rules of a server at this address.
    ///
    /// # Errors
    /// The operating system gives no random numbers for a token.
    pub fn of(address: SocketAddr) -> std::io::Result<Self> {
        if address.ip().is_loopback() {
            return Ok(Self { address, token: None });
        }
        let mut random = [0; TOKEN];
        std::fs::File::open("/dev/urandom")?.read_exact(&mut random)?;
        let token = u128::from_ne_bytes(random);
        Ok(Self { address, token: Some(format!("{token:032x}")) })
    }

    /// Returns the URL for a browser. A server that listens at all addresses is reached at the one
    /// from which this machine speaks to others.
    #[must_use]
    pub fn url(&self) -> String {
        let mut host = self.address;
        if host.ip().is_unspecified() {
            host.set_ip(own_ip(host.is_ipv4()));
        }
        match &self.token {
            Some(token) => format!("http://{host}/?{NAME}={token}"),
            None => format!("http://{host}/"),
        }
    }

    /// Returns the reason why a request is refused, or `None` if it passes.
    #[must_use]
    pub fn refuses(&self, headers: &HeaderMap, uri: &Uri) -> Option<Refused> {
        let text = |name| headers.get(name).and_then(|v| v.to_str().ok());
        let host = text(header::HOST).unwrap_or_default();
        if !self.is_own(host) {
            return Some(Refused::Host(host.chars().take(80).collect()));
        }
        // Browsers send an `Origin` with each WebSocket, the only way to send commands.
        if let Some(origin) = headers.get(header::ORIGIN) {
            let origin = origin.to_str().unwrap_or("?");
            // The page must come from this server, by the name of this request, over plain HTTP.
            if origin.strip_prefix("http://") != Some(host) {
                return Some(Refused::Origin(origin.chars().take(80).collect()));
            }
        }
        let token = self.token.as_ref()?;
        let kept = text(header::COOKIE).unwrap_or_default().split(';').map(str::trim);
        let right =
            asked(uri, token) || kept.into_iter().any(|pair| is(pair, &self.cookie_name(), token));
        (!right).then_some(Refused::Token)
    }

    /// Returns the cookie that answers a query with the right token. The browser sends it with all
    /// further requests.
    #[must_use]
    pub fn cookie(&self, uri: &Uri) -> Option<String> {
        let token = self.token.as_ref().filter(|token| asked(uri, token))?;
        // Scripts cannot read it, and requests from pages of other sites do not carry it.
        Some(format!("{}={token}; Path=/; HttpOnly; SameSite=Strict", self.cookie_name()))
    }

    /// Returns the name of the cookie. A browser shares cookies between all ports of a host, so
    /// each server of a machine needs a name of its own.
    fn cookie_name(&self) -> String {
        format!("rubik_robot_{}", self.address.port())
    }

    /// Returns the token, if one is needed.
    #[must_use]
    pub fn token(&self) -> Option<&str> {
        self.token.as_deref()
    }

    /// Returns whether `Host` names this server. Beyond the loopback any name will do: a machine
    /// has many, and the token protects the server.
    fn is_own(&self, host: &str) -> bool {
        if self.token.is_some() {
            return !host.is_empty();
        }
        let port = self.address.port();
        let own = ["127.0.0.1", "localhost", "[::1]"].map(|name| format!("{name}:{port}"));
        own.iter().any(|own| own.eq_ignore_ascii_case(host)) || self.address.to_string() == host
    }
}

/// Returns the address from which this machine would speak to others, or the loopback if it has no
/// network. It sends no packet; the destinations are addresses for documentation (RFC 5737, RFC
/// 3849).
fn own_ip(v4: bool) -> IpAddr {
    let (own, others): (IpAddr, IpAddr) = if v4 {
        (Ipv4Addr::UNSPECIFIED.into(), Ipv4Addr::new(192, 0, 2, 1).into())
    } else {
        (Ipv6Addr::UNSPECIFIED.into(), Ipv6Addr::new(0x2001, 0xdb8, 0, 0, 0, 0, 0, 1).into())
    };
    // To connect a UDP socket only selects the route and with it the own address.
    let spoken = UdpSocket::bind((own, 0)).and_then(|socket| {
        socket.connect((others, 9))?;
        socket.local_addr()
    });
    let loopback: IpAddr = if v4 { Ipv4Addr::LOCALHOST.into() } else { Ipv6Addr::LOCALHOST.into() };
    spoken.map(|at| at.ip()).ok().filter(|ip| !ip.is_unspecified()).unwrap_or(loopback)
}

/// Returns whether the query of a URL has the right token.
fn asked(uri: &Uri, token: &str) -> bool {
    uri.query().unwrap_or_default().split('&').any(|pair| is(pair, NAME, token))
}

/// Returns whether a pair of a query or a cookie header is `name=value`.
fn is(pair: &str, name: &str, value: &str) -> bool {
    let given = pair.strip_prefix(name).and_then(|rest| rest.strip_prefix('='));
    given.is_some_and(|given| same(given.as_bytes(), value.as_bytes()))
}

/// Compares two texts in a time that does not depend on the place of the first difference, so that
/// the time reveals no part of the token.
fn same(a: &[u8], b: &[u8]) -> bool {
    a.len() == b.len() && a.iter().zip(b).fold(0, |acc, (x, y)| acc | (x ^ y)) == 0
}

#[cfg(test)]
mod tests {
    use super::*;

    fn asked(guard: &Guard, pairs: &[(header::HeaderName, &str)], uri: &str) -> Option<Refused> {
        let mut headers = HeaderMap::new();
        for (name, value) in pairs {
            headers.insert(name.clone(), value.parse().unwrap());
        }
        guard.refuses(&headers, &uri.parse().unwrap())
    }

    #[test]
    fn own_page_is_admitted_by_every_loopback_name() {
        let guard = Guard::of("127.0.0.1:8780".parse().unwrap()).unwrap();

        for host in ["127.0.0.1:8780", "localhost:8780", "LocalHost:8780"] {
            assert_eq!(asked(&guard, &[(header::HOST, host)], "/ws"), None);
            let origin = format!("http://{host}");
            let own = [(header::HOST, host), (header::ORIGIN, origin.as_str())];
            assert_eq!(asked(&guard, &own, "/ws"), None);
        }
    }

    #[test]
    fn foreign_origins_and_hosts_are_refused() {
        let guard = Guard::of("127.0.0.1:8780".parse().unwrap()).unwrap();
        let own = (header::HOST, "127.0.0.1:8780");

        for origin in [
            "http://evil.example",
            "null",
            "http://127.0.0.1:8781",
            "https://127.0.0.1:8780",
            "http://127.0.0.1:8780.evil.example",
        ] {
            let refused = asked(&guard, &[own.clone(), (header::ORIGIN, origin)], "/ws");
            assert_eq!(refused, Some(Refused::Origin(origin.into())));
        }
        // A stranger's name that points to this address.
        for host in ["evil.example:8780", "127.0.0.1", "", "127.0.0.1:8781"] {
            assert!(matches!(asked(&guard, &[(header::HOST, host)], "/"), Some(Refused::Host(_))));
        }
        assert!(matches!(asked(&guard, &[], "/"), Some(Refused::Host(_))));
    }

    #[test]
    fn token_is_required_beyond_the_loopback() {
        let guard = Guard::of("192.0.2.7:8780".parse().unwrap()).unwrap();
        let token = guard.token().unwrap().to_owned();
        let host = (header::HOST, "robot.local:8780");

        assert_eq!(token.len(), 32);
        assert_eq!(asked(&guard, std::slice::from_ref(&host), "/"), Some(Refused::Token));
        assert_eq!(asked(&guard, std::slice::from_ref(&host), "/?token=0"), Some(Refused::Token));
        assert_eq!(
            asked(&guard, std::slice::from_ref(&host), &format!("/ws?a=1&token={token}")),
            None
        );
        // A part of the token does not suffice, and neither does a longer text.
        for wrong in [String::new(), token[..31].to_owned(), format!("{token}0")] {
            let uri = format!("/?token={wrong}");
            let refused = asked(&guard, std::slice::from_ref(&host), &uri);
            assert_eq!(refused, Some(Refused::Token), "{wrong}");
            assert_eq!(guard.cookie(&uri.parse().unwrap()), None, "{wrong}");
        }
        let given = guard.cookie(&format!("/?token={token}").parse().unwrap()).unwrap();
        assert!(given.ends_with("; Path=/; HttpOnly; SameSite=Strict"), "{given}");
        assert_eq!(guard.cookie(&"/?token=0".parse().unwrap()), None);
        assert_eq!(guard.cookie(&"/".parse().unwrap()), None);
        let cookie = format!("a=b; {}", given.split(';').next().unwrap());
        assert_eq!(asked(&guard, &[host.clone(), (header::COOKIE, &cookie)], "/ws"), None);
        let others = cookie.replace("8780", "8781");
        let refused = asked(&guard, &[host.clone(), (header::COOKIE, &others)], "/ws");
        assert_eq!(refused, Some(Refused::Token), "another server's");
        let foreign = [host, (header::ORIGIN, "http://evil.example"), (header::COOKIE, &cookie)];
        assert!(matches!(asked(&guard, &foreign, "/ws"), Some(Refused::Origin(_))));
        assert_eq!(guard.url(), format!("http://192.0.2.7:8780/?token={token}"));
        assert_ne!(Guard::of("192.0.2.7:8780".parse().unwrap()).unwrap(), guard);
    }

    /// A server at all addresses prints an address that a person can type.
    #[test]
    fn unspecified_address_becomes_usable_url() {
        for everywhere in ["0.0.0.0:8780", "[::]:8780"] {
            let guard = Guard::of(everywhere.parse().unwrap()).unwrap();
            let url = guard.url();
            let (host, token) =
                url.strip_prefix("http://").unwrap().split_once("/?token=").unwrap();

            let address: SocketAddr = host.parse().unwrap();
            assert!(!address.ip().is_unspecified() && address.port() == 8780, "{url}");
            assert_eq!(Some(token), guard.token());
        }
    }
}
