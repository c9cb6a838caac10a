//! Access control of the page's server: which requests are refused, and why.
//!
//! A browser also runs pages of strangers, and other users and machines can reach the server.
//! Without these rules any of them could drive the robot.
//!
//! | request | rule | attack |
//! |---|---|---|
//! | foreign `Host`, on the loopback | refused | a stranger's host name leads to this address |
//! | another host in the request line | refused | the `Host` is right, but the other one counts |
//! | foreign `Origin` | refused | a page of another server sends commands |
//! | foreign `Sec-Fetch-Site` | refused, except to open the page | a page of another server asks |
//! | picture or WebSocket without the token | refused | another user or machine sends commands |
//! | feed without the token in its address | refused | another user or machine watches |
//!
//! The token is drawn at the start and printed in the fragment of the page's address, which a
//! browser sends to no server. The page's files are public and need no token. The page keeps the
//! token and sends it in the first message of its WebSocket and in the header [`TOKEN_HEADER`] of a
//! request for a picture. It is no cookie: a browser sends the cookies of a host to all its ports,
//! and thereby to the servers of other users.
//!
//! Other programs read the feed, which takes no commands. They cannot send a first message or a
//! header, so that its address has the token. It may come from a page of any server: that page has
//! the token by the person who typed it.
//!
//! A proxy for TLS and a tunnel have names and ports of their own. So a loopback name is admitted
//! with any port, and the name of a proxy is given as a [`HostName`].

use axum::http::{HeaderMap, HeaderName, Uri, header};
use std::fmt;
use std::io::Read;
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr, UdpSocket};
use std::str::FromStr;

/// Name of the header that carries the token of a request for a picture.
pub const TOKEN_HEADER: &str = "x-token";

/// Rules of access to one server.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Guard {
    /// Address at which the server listens.
    address: SocketAddr,
    /// Secret that pictures and web sockets need, as hexadecimal digits.
    token: String,
    /// Names of proxies that lead to the server.
    names: Vec<HostName>,
}

/// Reason why a request is refused.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum Refused {
    /// Request that names another server, or several.
    #[error(
        "refused: this server is not `{0}`: open the address that the program printed, or start \
         the program with `--host NAME` if a proxy leads here from that name"
    )]
    Host(String),
    /// Request with the `Origin` of a page of another server.
    #[error(
        "refused: a page from `{0}` may not command this robot: open the address that the program \
         printed, or start the program with `--host NAME` if a proxy leads here from that name"
    )]
    Origin(String),
    /// Request that the browser marks as made by a page of another site.
    #[error(
        "refused: a page of another site asked for this: open the address that the program printed \
         in a tab of its own"
    )]
    Site,
    /// Request with a missing or wrong token.
    #[error(
        "refused: the token is missing or wrong: open the address that the program printed at its \
         last start"
    )]
    Token,
}

/// Name by which browsers reach the page through a proxy, with the port if it is part of the name.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct HostName {
    name: String,
    port: Option<u16>,
}

/// A text that is no name of a host.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("`{0}` is not the name of a host: write NAME or NAME:PORT, without https:// and path")]
pub struct NoHostName(String);

impl FromStr for HostName {
    type Err = NoHostName;

    fn from_str(text: &str) -> Result<Self, NoHostName> {
        let (name, port) = parts(text).ok_or_else(|| NoHostName(short(text)))?;
        Ok(Self { name: name.to_ascii_lowercase(), port })
    }
}

impl fmt::Display for HostName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.name)?;
        self.port.map_or(Ok(()), |port| write!(f, ":{port}"))
    }
}

impl HostName {
    /// Checks whether a name and a port are those of this host. If this host name has no port, any
    /// port will do.
    fn is(&self, (name, port): (&str, Option<u16>)) -> bool {
        self.name.eq_ignore_ascii_case(name) && (self.port.is_none() || self.port == port)
    }
}

/// Path of the feed for other programs.
pub const FEED: &str = "/foxglove";
/// Number of random bytes in a token.
const TOKEN: usize = 16;
/// Header in which a browser says from which site a request comes.
const SITE: &str = "sec-fetch-site";
/// Header in which a browser says what a request is for.
const MODE: &str = "sec-fetch-mode";
/// Header in which a browser says where the answer goes.
const DESTINATION: &str = "sec-fetch-dest";

impl Guard {
    /// Makes the rules of a server at this address, which browsers reach by these names as well.
    ///
    /// # Errors
    /// The operating system gives no random numbers for a token.
    pub fn of(address: SocketAddr, names: Vec<HostName>) -> std::io::Result<Self> {
        let mut random = [0; TOKEN];
        std::fs::File::open("/dev/urandom")?.read_exact(&mut random)?;
        let token = u128::from_ne_bytes(random);
        Ok(Self { address, token: format!("{token:032x}"), names })
    }

    /// Returns the URL for a browser. If the server listens at all addresses, the URL has the
    /// address from which this machine speaks to others.
    #[must_use]
    pub fn url(&self) -> String {
        let mut host = self.address;
        if host.ip().is_unspecified() {
            host.set_ip(own_ip(host.is_ipv4()));
        }
        format!("http://{host}/#token={}", self.token)
    }

    /// Returns the address of the feed for other programs, including the token.
    #[must_use]
    pub fn feed_url(&self) -> String {
        let page = self.url();
        let host = page.trim_start_matches("http://").split('/').next().unwrap_or_default();
        format!("ws://{host}{FEED}?token={}", self.token)
    }

    /// Returns the URLs for browsers behind a proxy for TLS, one for each name.
    #[must_use]
    pub fn proxy_urls(&self) -> Vec<String> {
        self.names.iter().map(|name| format!("https://{name}/#token={}", self.token)).collect()
    }

    /// Returns the reason why a request is refused, or `None` if it passes. The token is not
    /// checked here.
    #[must_use]
    pub fn refuses(&self, headers: &HeaderMap, uri: &Uri) -> Option<Refused> {
        // Repeated headers are refused: a proxy may have checked the other one.
        let host = match only(headers, &header::HOST) {
            Ok(Some(host)) if self.is_own(host) => host,
            Ok(host) => return Some(Refused::Host(short(host.unwrap_or_default()))),
            Err(all) => return Some(Refused::Host(all)),
        };
        // A host in the request line has precedence over the header (RFC 9112, section 3.2.2).
        let named = uri.authority().map(axum::http::uri::Authority::as_str);
        if let Some(other) = named.filter(|named| !named.eq_ignore_ascii_case(host)) {
            return Some(Refused::Host(short(other)));
        }
        if uri.path() == FEED {
            let given = uri.query().and_then(|query| query.strip_prefix("token="));
            return (!given.is_some_and(|given| self.is_token(given))).then_some(Refused::Token);
        }
        // Browsers send an `Origin` with each WebSocket, the only way to send commands.
        match only(headers, &header::ORIGIN) {
            Ok(None) => {}
            Ok(Some(origin)) if self.is_own_origin(origin, host) => {}
            Ok(Some(origin)) => return Some(Refused::Origin(short(origin))),
            Err(all) => return Some(Refused::Origin(all)),
        }
        (!is_own_site(headers, uri)).then_some(Refused::Site)
    }

    /// Returns [`Refused::Token`] unless the headers of a request carry the token exactly once.
    #[must_use]
    pub fn refuses_token_of(&self, headers: &HeaderMap) -> Option<Refused> {
        let given = only(headers, &HeaderName::from_static(TOKEN_HEADER)).ok().flatten();
        (!given.is_some_and(|given| self.is_token(given))).then_some(Refused::Token)
    }

    /// Checks whether `given` is the token.
    #[must_use]
    pub fn is_token(&self, given: &str) -> bool {
        same(given.as_bytes(), self.token.as_bytes())
    }

    /// Checks whether `Host` names this server. If the server listens beyond the loopback, any name
    /// will do: a machine has many names, and a stranger's page does not have the token.
    fn is_own(&self, host: &str) -> bool {
        let Some(host) = parts(host) else { return false };
        let ip = host.0.trim_start_matches('[').trim_end_matches(']').parse::<IpAddr>();
        // Strangers cannot point names of the loopback elsewhere. The port is not compared, since a
        // tunnel has another port than the server.
        host.0.eq_ignore_ascii_case("localhost")
            || ip.is_ok_and(|ip| ip.is_loopback() || ip == self.address.ip())
            || !self.address.ip().is_loopback()
            || self.names.iter().any(|name| name.is(host))
    }

    /// Checks whether `Origin` is that of this server's own page: its host must be the `Host` of
    /// the request, or the name of a proxy, since a proxy may have replaced the `Host`.
    fn is_own_origin(&self, origin: &str, host: &str) -> bool {
        let name = origin.strip_prefix("https://").or_else(|| origin.strip_prefix("http://"));
        name.is_some_and(|name| {
            let by_proxy = |parts| self.names.iter().any(|known| known.is(parts));
            name.eq_ignore_ascii_case(host) || parts(name).is_some_and(by_proxy)
        })
    }
}

/// Checks whether a request comes from the page itself, from the person (who typed the address), or
/// from no browser. A link on another site may open the page, which shows nothing without the
/// token.
fn is_own_site(headers: &HeaderMap, uri: &Uri) -> bool {
    let is = |name, value: &str| headers.get(name).is_some_and(|v| v == value);
    let opens = uri.path() == "/" && is(MODE, "navigate") && is(DESTINATION, "document");
    let mut sites = headers.get_all(SITE).iter();
    opens || sites.all(|site| site == "same-origin" || site == "none")
}

/// Returns the value of the header `name`; `None` if there is no such header.
///
/// # Errors
/// The values as a text for the answer if there are several, or "?" if the value is no text.
fn only<'a>(headers: &'a HeaderMap, name: &HeaderName) -> Result<Option<&'a str>, String> {
    let all: Vec<_> = headers.get_all(name).iter().collect();
    match all[..] {
        [] => Ok(None),
        [one] => one.to_str().map(Some).map_err(|_| "?".to_owned()),
        _ => {
            let texts: Vec<_> = all.iter().map(|value| value.to_str().unwrap_or("?")).collect();
            Err(short(&texts.join(", ")))
        }
    }
}

/// Returns the first 80 characters of a text, for an answer.
fn short(text: &str) -> String {
    text.chars().take(80).collect()
}

/// Splits a host of a URL into name and port. Returns `None` if the text is no host. An IPv6
/// address stands in brackets.
fn parts(host: &str) -> Option<(&str, Option<u16>)> {
    let name_end = if host.starts_with('[') { host.find(']')? + 1 } else { 0 };
    let (name, port) = match host[name_end..].find(':') {
        Some(colon) => host.split_at(name_end + colon),
        None => (host, ""),
    };
    let port = match port.strip_prefix(':') {
        Some(digits) if digits.bytes().all(|b| b.is_ascii_digit()) => Some(digits.parse().ok()?),
        Some(_) => return None,
        None => None,
    };
    let is_part = |c: char| c.is_alphanumeric() || "-._".contains(c);
    let plain = match name.strip_prefix('[').and_then(|name| name.strip_suffix(']')) {
        Some(ip) => ip.parse::<Ipv6Addr>().is_ok(),
        None => !name.is_empty() && name.chars().all(is_part),
    };
    plain.then_some((name, port))
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
    // Connecting a UDP socket only selects the route, and with it the own address.
    let spoken = UdpSocket::bind((own, 0)).and_then(|socket| {
        socket.connect((others, 9))?;
        socket.local_addr()
    });
    let loopback: IpAddr = if v4 { Ipv4Addr::LOCALHOST.into() } else { Ipv6Addr::LOCALHOST.into() };
    spoken.map(|at| at.ip()).ok().filter(|ip| !ip.is_unspecified()).unwrap_or(loopback)
}

/// Compares two texts in a time that does not depend on the place of the first difference, so that
/// the time reveals no part of the token.
fn same(a: &[u8], b: &[u8]) -> bool {
    a.len() == b.len() && a.iter().zip(b).fold(0, |acc, (x, y)| acc | (x ^ y)) == 0
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns the rules of a server at this address with these names of proxies.
    fn guard(address: &str, names: &[&str]) -> Guard {
        let names = names.iter().map(|name| name.parse().unwrap()).collect();
        Guard::of(address.parse().unwrap(), names).unwrap()
    }

    /// Returns the reason why a request with these headers for `uri` is refused; `None` if it is
    /// admitted.
    fn asked(guard: &Guard, pairs: &[(&'static str, &str)], uri: &str) -> Option<Refused> {
        let mut headers = HeaderMap::new();
        for (name, value) in pairs {
            headers.append(HeaderName::from_static(name), value.parse().unwrap());
        }
        guard.refuses(&headers, &uri.parse().unwrap())
    }

    /// Behind a tunnel the browser's `Host` has another port than the server, or none if it is 80.
    #[test]
    fn own_page_is_admitted_by_every_loopback_name() {
        let guard = guard("127.0.0.1:8780", &[]);

        for host in [
            "127.0.0.1:8780",
            "localhost:8780",
            "LocalHost:8780",
            "localhost:9000",
            "127.0.0.1",
            "[::1]:9000",
            "localhost",
        ] {
            assert_eq!(asked(&guard, &[("host", host)], "/ws"), None, "{host}");
            for scheme in ["http", "https"] {
                let origin = format!("{scheme}://{host}");
                let own = [("host", host), ("origin", origin.as_str())];
                assert_eq!(asked(&guard, &own, "/ws"), None, "{origin}");
            }
        }
    }

    #[test]
    fn foreign_origins_and_hosts_are_refused() {
        let guard = guard("127.0.0.1:8780", &[]);
        let own = ("host", "127.0.0.1:8780");

        for origin in [
            "http://evil.example",
            "null",
            "http://127.0.0.1:8781",
            "https://127.0.0.1:8781",
            "http://localhost:8780",
            "http://127.0.0.1",
            "ftp://127.0.0.1:8780",
            "http://127.0.0.1:8780.evil.example",
            "",
        ] {
            let refused = asked(&guard, &[own, ("origin", origin)], "/ws");
            assert_eq!(refused, Some(Refused::Origin(origin.into())));
        }
        // A stranger's name that points to this address, and texts that are no host.
        for host in [
            "evil.example:8780",
            "localhost.evil.example",
            "localhost:8780.evil.example",
            "localhost:",
            "localhost:99999",
            "localhost@evil.example",
            "127.0.0.1, evil.example",
            "[::1",
            "[::1].evil.example",
            "192.0.2.7:8780",
            "",
        ] {
            let refused = asked(&guard, &[("host", host)], "/");
            assert_eq!(refused, Some(Refused::Host(host.into())));
        }
        assert!(matches!(asked(&guard, &[], "/"), Some(Refused::Host(_))));
    }

    /// The first of two headers is right, and the second may be the one that counts.
    #[test]
    fn repeated_headers_and_foreign_absolute_uris_are_refused() {
        let guard = guard("127.0.0.1:8780", &[]);
        let own = ("host", "127.0.0.1:8780");
        let origin = ("origin", "http://127.0.0.1:8780");

        for second in ["evil.example", "127.0.0.1:8780"] {
            let refused = asked(&guard, &[own, ("host", second)], "/");
            assert!(matches!(refused, Some(Refused::Host(_))), "{second}");
        }
        let refused = asked(&guard, &[own, origin, ("origin", "http://evil.example")], "/ws");
        assert!(matches!(refused, Some(Refused::Origin(_))), "{refused:?}");
        for uri in ["http://evil.example/ws", "http://x@127.0.0.1:8780/", "http://localhost:8780/"]
        {
            let refused = asked(&guard, &[own], uri);
            assert!(matches!(refused, Some(Refused::Host(_))), "{uri}");
        }
        assert_eq!(asked(&guard, &[own, origin], "http://127.0.0.1:8780/ws"), None);
    }

    /// A proxy for TLS keeps the browser's `Host` or replaces it by the address of this server.
    #[test]
    fn page_behind_named_proxy_is_admitted() {
        let guard = guard("127.0.0.1:8780", &["Robot.example", "[2001:db8::1]:8443"]);

        for (host, origin) in [
            ("robot.example", "https://robot.example"),
            ("robot.example", "https://robot.example:8443"),
            ("127.0.0.1:8780", "https://robot.example"),
            ("127.0.0.1:8780", "https://[2001:db8::1]:8443"),
        ] {
            assert_eq!(asked(&guard, &[("host", host), ("origin", origin)], "/ws"), None);
        }
        for (host, origin) in [
            ("127.0.0.1:8780", "https://robot.example.evil.example"),
            ("127.0.0.1:8780", "https://evil.example"),
            ("127.0.0.1:8780", "https://[2001:db8::1]"),
            ("evil.example", "https://robot.example"),
        ] {
            let refused = asked(&guard, &[("host", host), ("origin", origin)], "/ws");
            assert!(refused.is_some_and(|why| why.to_string().contains("--host")), "{origin}");
        }
        let urls = guard.proxy_urls();
        assert!(urls[0].starts_with("https://robot.example/#token="), "{urls:?}");
        assert!(urls[1].starts_with("https://[2001:db8::1]:8443/#token="), "{urls:?}");
        for text in ["", "https://robot.example", "robot.example/", "a b", "a:b", "[::1"] {
            let why = text.parse::<HostName>().unwrap_err().to_string();
            assert!(why.contains("write NAME"), "{why}");
        }
    }

    /// A plain GET of another site's page has no `Origin`, so `Sec-Fetch-Site` decides.
    #[test]
    fn requests_of_other_sites_are_refused() {
        let guard = guard("127.0.0.1:8780", &[]);
        let own = ("host", "127.0.0.1:8780");
        let opens = [("sec-fetch-mode", "navigate"), ("sec-fetch-dest", "document")];

        for site in ["cross-site", "same-site", "?"] {
            for uri in ["/camera/0", "/main.js", "/"] {
                let refused = asked(&guard, &[own, (SITE, site)], uri);
                assert_eq!(refused, Some(Refused::Site), "{site} {uri}");
            }
            // A link in another page opens the page, and nothing else.
            let link = [own, (SITE, site), opens[0], opens[1]];
            assert_eq!(asked(&guard, &link, "/"), None);
            assert_eq!(asked(&guard, &link, "/camera/0"), Some(Refused::Site));
            let framed = [own, (SITE, site), opens[0], ("sec-fetch-dest", "iframe")];
            let fetched = [own, (SITE, site), ("sec-fetch-mode", "no-cors"), opens[1]];
            for other in [framed, fetched] {
                assert_eq!(asked(&guard, &other, "/"), Some(Refused::Site));
            }
        }
        for site in ["same-origin", "none"] {
            assert_eq!(asked(&guard, &[own, (SITE, site)], "/camera/0"), None);
        }
        let both = [own, (SITE, "none"), (SITE, "cross-site")];
        assert_eq!(asked(&guard, &both, "/camera/0"), Some(Refused::Site));
    }

    #[test]
    fn token_is_required_at_every_address() {
        for address in ["127.0.0.1:8780", "192.0.2.7:8780"] {
            let guard = guard(address, &[]);
            let url = guard.url();
            let token = url.strip_prefix(&format!("http://{address}/#token=")).unwrap();
            let refused = |given: &[&str]| {
                let mut headers = HeaderMap::new();
                for given in given {
                    headers.append(TOKEN_HEADER, given.parse().unwrap());
                }
                guard.refuses_token_of(&headers)
            };

            assert_eq!(token.len(), 32);
            assert_eq!(refused(&[token]), None);
            // A part of the token does not suffice, and neither does a longer text.
            for wrong in ["", "0", &token[..31], &format!("{token}0")] {
                assert_eq!(refused(&[wrong]), Some(Refused::Token), "{wrong}");
                assert!(!guard.is_token(wrong), "{wrong}");
            }
            assert_eq!(refused(&[]), Some(Refused::Token));
            assert_eq!(refused(&[token, "0"]), Some(Refused::Token));
            let others = Guard::of(address.parse().unwrap(), Vec::new()).unwrap();
            assert!(!others.is_token(token), "another server's");
        }
    }

    /// Beyond the loopback a machine has many names.
    #[test]
    fn every_host_is_admitted_beyond_loopback() {
        let guard = guard("192.0.2.7:8780", &[]);
        let host = ("host", "robot.local:8780");

        assert_eq!(asked(&guard, &[host], "/"), None);
        let foreign = [host, ("origin", "http://evil.example")];
        assert!(matches!(asked(&guard, &foreign, "/ws"), Some(Refused::Origin(_))));
    }

    /// A server at all addresses prints an address that a person can type.
    #[test]
    fn unspecified_address_becomes_usable_url() {
        for everywhere in ["0.0.0.0:8780", "[::]:8780"] {
            let guard = guard(everywhere, &[]);
            let url = guard.url();
            let (host, token) =
                url.strip_prefix("http://").unwrap().split_once("/#token=").unwrap();

            let address: SocketAddr = host.parse().unwrap();
            assert!(!address.ip().is_unspecified() && address.port() == 8780, "{url}");
            assert!(guard.is_token(token));
        }
    }
}
