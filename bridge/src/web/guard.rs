//! The rules of requests: a pure function of a request's head and the configuration.
//!
//! A page of another site can let a browser send requests here, and can direct its own name to this
//! computer (DNS rebinding). The browser names that site in `Origin`, or its name in `Host`.

use crate::config::Web;
use crate::web::token::Tokens;
use hyper::header::{
    AUTHORIZATION, CONTENT_LENGTH, HOST, HeaderName, HeaderValue, ORIGIN, TRANSFER_ENCODING,
};
use hyper::http::request::Parts;
use hyper::http::uri::Authority;
use hyper::{HeaderMap, Method, StatusCode};
use std::net::IpAddr;

/// Limit on a request's body, which is not read.
const BODY_MAX: u64 = 1024;
/// The relation of the page that sends a request to this site, by the browser.
const FETCH_SITE: HeaderName = HeaderName::from_static("sec-fetch-site");
/// The address that a reverse proxy names.
const FORWARDED_FOR: HeaderName = HeaderName::from_static("x-forwarded-for");

/// The target of a request.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Route {
    Page,
    State,
    Events,
    Stop,
}

/// The reason why a request is refused.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Denial {
    /// The host is not named exactly once, or is none of this computer.
    Host,
    /// A page of another site sent the request.
    Origin,
    Path,
    /// The path has another method, which is named.
    Method(&'static str),
    BodyTooLarge,
    Token,
}

impl Denial {
    pub(crate) fn status(self) -> StatusCode {
        match self {
            Self::Host | Self::Origin => StatusCode::FORBIDDEN,
            Self::Path => StatusCode::NOT_FOUND,
            Self::Method(_) => StatusCode::METHOD_NOT_ALLOWED,
            Self::BodyTooLarge => StatusCode::PAYLOAD_TOO_LARGE,
            Self::Token => StatusCode::UNAUTHORIZED,
        }
    }

    /// Returns a sentence that says what to do.
    pub(crate) fn sentence(self) -> &'static str {
        match self {
            Self::Host => {
                "This host name is not served. Use http://127.0.0.1 with the port, or add the name to web.names."
            }
            Self::Origin => "A page of another site sent this request. Open the page of the bridge itself.",
            Self::Path => "The page is at /.",
            Self::Method("POST") => "Only POST stops the robot.",
            Self::Method(_) => "Only GET is known here.",
            Self::BodyTooLarge => "The request needs no body.",
            Self::Token => "A token of web.token-file is needed: Authorization: Bearer TOKEN.",
        }
    }
}

/// A request that is served.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Admitted {
    pub(crate) route: Route,
    /// The person whose token it has.
    pub(crate) person: Option<String>,
    /// The address that the reverse proxy names.
    pub(crate) forwarded_for: Option<IpAddr>,
}

/// The rules of one configuration.
pub(crate) struct Guard {
    /// Lower case, with a port.
    hosts: Vec<String>,
    origins: Vec<String>,
    tokens: Option<Tokens>,
    behind_proxy: bool,
}

impl Guard {
    pub(crate) fn new(web: &Web, tokens: Option<Tokens>) -> Self {
        let direct = if web.has_tls() { "https" } else { "http" };
        let mut known: Vec<(&str, String)> = Vec::new();
        let own = (!web.address.is_unspecified()).then(|| in_brackets(web.address));
        for host in ["localhost", "127.0.0.1", "[::1]"].into_iter().map(str::to_owned).chain(own) {
            known.push((direct, format!("{host}:{}", web.port)));
        }
        for name in &web.names {
            let name = name.to_ascii_lowercase();
            let scheme = if web.behind_proxy { "https" } else { direct };
            match port_of(&name) {
                Some(_) => known.push((scheme, name)),
                None => {
                    known.push((scheme, format!("{name}:{}", web.port)));
                    if web.behind_proxy {
                        known.push((scheme, format!("{name}:443")));
                    }
                }
            }
        }
        let origins = known.iter().map(|(scheme, host)| format!("{scheme}://{host}")).collect();
        let hosts = known.into_iter().map(|(_, host)| host).collect();
        Self { hosts, origins, tokens, behind_proxy: web.behind_proxy }
    }

    /// Checks a request. The order tells a sender without a token nothing but what every answer of
    /// HTTP tells.
    pub(crate) fn check(&self, head: &Parts) -> Result<Admitted, Denial> {
        self.check_host(head)?;
        let route = route(head)?;
        self.check_origin(&head.headers, route)?;
        check_body(&head.headers)?;
        let person = match (&self.tokens, route) {
            (Some(tokens), Route::State | Route::Events | Route::Stop) => {
                let person = bearer(&head.headers).and_then(|secret| tokens.person(secret));
                Some(person.ok_or(Denial::Token)?.to_owned())
            }
            _ => None,
        };
        Ok(Admitted { route, person, forwarded_for: self.forwarded_for(&head.headers) })
    }

    fn check_host(&self, head: &Parts) -> Result<(), Denial> {
        let host = only(&head.headers, &HOST).ok().flatten().ok_or(Denial::Host)?;
        let is_known = |host: &str| self.is_host(host);
        let named = host.to_str().is_ok_and(is_known);
        // A request to a proxy names the host a second time.
        let target = head.uri.authority().is_none_or(|target| is_known(target.as_str()));
        if named && target { Ok(()) } else { Err(Denial::Host) }
    }

    fn is_host(&self, host: &str) -> bool {
        if host.contains('@') || host.parse::<Authority>().is_err() {
            return false;
        }
        let host = host.to_ascii_lowercase();
        match port_of(&host) {
            Some(_) => self.hosts.contains(&host),
            // Browsers leave out the port of the scheme.
            None => [80, 443].iter().any(|port| self.hosts.contains(&format!("{host}:{port}"))),
        }
    }

    /// Browsers name the origin in every POST. A request without is from another program.
    fn check_origin(&self, headers: &HeaderMap, route: Route) -> Result<(), Denial> {
        if let Some(origin) = only(headers, &ORIGIN)? {
            let is_known = origin.to_str().is_ok_and(|origin| self.is_origin(origin));
            is_known.then_some(()).ok_or(Denial::Origin)?;
        }
        // A link on another site may open the page. It may not read a state, or stop.
        if route != Route::Page
            && let Some(site) = only(headers, &FETCH_SITE)?
            && !["same-origin", "none"].iter().any(|known| site == *known)
        {
            return Err(Denial::Origin);
        }
        Ok(())
    }

    fn is_origin(&self, origin: &str) -> bool {
        let origin = origin.to_ascii_lowercase();
        let Some((scheme, host)) = origin.split_once("://") else { return false };
        let port = match (port_of(host), scheme) {
            (Some(_), _) => String::new(),
            (None, "https") => ":443".to_owned(),
            (None, _) => ":80".to_owned(),
        };
        self.origins.contains(&format!("{scheme}://{host}{port}"))
    }

    /// The proxy appends the address of its client: what stands before is the client's text.
    fn forwarded_for(&self, headers: &HeaderMap) -> Option<IpAddr> {
        let last = headers.get_all(FORWARDED_FOR).iter().next_back().filter(|_| self.behind_proxy)?;
        last.to_str().ok()?.rsplit(',').next()?.trim().parse().ok()
    }
}

fn in_brackets(address: IpAddr) -> String {
    match address {
        IpAddr::V4(address) => address.to_string(),
        IpAddr::V6(address) => format!("[{address}]"),
    }
}

/// Returns the port of a host with one.
fn port_of(host: &str) -> Option<u16> {
    let (name, port) = host.rsplit_once(':')?;
    let is_name = !name.contains(':') || name.ends_with(']');
    port.parse().ok().filter(|_| is_name)
}

/// Returns the value of a field that may be given once.
fn only<'a>(headers: &'a HeaderMap, name: &HeaderName) -> Result<Option<&'a HeaderValue>, Denial> {
    let mut values = headers.get_all(name).iter();
    match (values.next(), values.next()) {
        (value, None) => Ok(value),
        _ => Err(Denial::Origin),
    }
}

fn route(head: &Parts) -> Result<Route, Denial> {
    let (route, method) = match head.uri.path() {
        "/" => (Route::Page, Method::GET),
        "/api/state" => (Route::State, Method::GET),
        "/api/events" => (Route::Events, Method::GET),
        "/api/stop" => (Route::Stop, Method::POST),
        _ => return Err(Denial::Path),
    };
    match head.method == method {
        true => Ok(route),
        false => Err(Denial::Method(if method == Method::POST { "POST" } else { "GET" })),
    }
}

fn check_body(headers: &HeaderMap) -> Result<(), Denial> {
    let length =
        headers.get(CONTENT_LENGTH).map(|length| length.to_str().ok().and_then(|text| text.parse().ok()));
    match length {
        _ if headers.contains_key(TRANSFER_ENCODING) => Err(Denial::BodyTooLarge),
        Some(length) if length.is_none_or(|length: u64| length > BODY_MAX) => Err(Denial::BodyTooLarge),
        _ => Ok(()),
    }
}

fn bearer(headers: &HeaderMap) -> Option<&[u8]> {
    let value = only(headers, &AUTHORIZATION).ok()??.as_bytes();
    let (scheme, secret) = value.split_at_checked(7)?;
    scheme.eq_ignore_ascii_case(b"bearer ").then_some(secret)
}

#[cfg(test)]
mod tests {
    use super::*;
    use hyper::Request;

    const SECRET: &str = "0123456789abcdef";

    fn guard(text: &str) -> Guard {
        let web: Web = toml::from_str(text).unwrap();
        let tokens = web.token_file.as_ref().map(|_| Tokens::parse(&format!("anna {SECRET}")).unwrap());
        Guard::new(&web, tokens)
    }

    fn outcome(guard: &Guard, line: &str, fields: &[(&str, &str)]) -> Result<Admitted, Denial> {
        let (method, target) = line.split_once(' ').unwrap();
        let request = Request::builder().method(method).uri(target);
        let request = fields.iter().fold(request, |request, (name, value)| request.header(*name, *value));
        guard.check(&request.body(()).unwrap().into_parts().0)
    }

    fn of_host(guard: &Guard, host: &str) -> Result<Admitted, Denial> {
        outcome(guard, "GET /", &[("host", host)])
    }

    fn of_origin(guard: &Guard, host: &str, origin: &str) -> Result<Admitted, Denial> {
        outcome(guard, "POST /api/stop", &[("host", host), ("origin", origin)])
    }

    #[test]
    fn only_names_of_this_computer_are_served() {
        let local = guard("");
        for host in ["localhost:8642", "127.0.0.1:8642", "[::1]:8642", "LOCALHOST:8642"] {
            assert!(of_host(&local, host).is_ok(), "{host}");
        }
        for host in [
            "localhost",
            "localhost:80",
            "127.0.0.1:8643",
            "evil.example:8642",
            "",
            "a@localhost:8642",
            "::1",
        ] {
            assert_eq!(of_host(&local, host), Err(Denial::Host), "{host}");
        }
    }

    #[test]
    fn request_names_exactly_one_host() {
        let local = guard("");
        assert_eq!(outcome(&local, "GET /", &[]), Err(Denial::Host));
        let both = [("host", "localhost:8642"), ("host", "localhost:8642")];
        assert_eq!(outcome(&local, "GET /", &both), Err(Denial::Host));
        let proxied = outcome(&local, "GET http://evil.example/", &both[..1]);
        assert_eq!(proxied, Err(Denial::Host));
    }

    #[test]
    fn names_hold_for_the_configured_port() {
        let named = guard("names = [\"robot.local\", \"proxy.example:9000\"]\ntoken-file = \"t\"");
        assert!(of_host(&named, "robot.local:8642").is_ok());
        assert!(of_host(&named, "proxy.example:9000").is_ok());
        assert_eq!(of_host(&named, "robot.local:9000"), Err(Denial::Host));
        assert_eq!(of_host(&named, "robot.local"), Err(Denial::Host));
    }

    #[test]
    fn proxy_adds_the_port_of_https() {
        let proxied = guard("names = [\"robot.example\"]\ntoken-file = \"t\"\nbehind-proxy = true");
        assert!(of_host(&proxied, "robot.example").is_ok());
        assert_eq!(of_origin(&proxied, "127.0.0.1:8642", "https://robot.example"), Err(Denial::Token));
        assert_eq!(of_origin(&proxied, "robot.example", "http://robot.example"), Err(Denial::Origin));
    }

    #[test]
    fn page_of_other_site_stops_nothing() {
        let local = guard("");
        let host = "127.0.0.1:8642";
        assert!(of_origin(&local, host, "http://127.0.0.1:8642").is_ok());
        for origin in [
            "http://evil.example",
            "https://127.0.0.1:8642",
            "http://127.0.0.1",
            "http://127.0.0.1:8643",
            "null",
            "",
            "http://127.0.0.1:8642.evil.example",
            "http://127.0.0.1:8642@evil.example",
        ] {
            assert_eq!(of_origin(&local, host, origin), Err(Denial::Origin), "{origin}");
        }
    }

    #[test]
    fn cross_site_request_without_origin_is_refused() {
        let local = guard("");
        let with =
            |line, site| outcome(&local, line, &[("host", "localhost:8642"), ("sec-fetch-site", site)]);
        assert_eq!(with("GET /api/state", "cross-site"), Err(Denial::Origin));
        assert_eq!(with("GET /api/events", "same-site"), Err(Denial::Origin));
        assert!(with("GET /api/state", "same-origin").is_ok());
        assert!(with("GET /", "cross-site").is_ok(), "a link may open the page");
    }

    #[test]
    fn each_path_has_one_method() {
        let local = guard("");
        let of = |line| outcome(&local, line, &[("host", "localhost:8642")]).map(|admitted| admitted.route);
        assert_eq!(of("GET /"), Ok(Route::Page));
        assert_eq!(of("POST /api/stop?x=1"), Ok(Route::Stop));
        assert_eq!(of("GET /api/stop"), Err(Denial::Method("POST")));
        assert_eq!(of("OPTIONS /api/stop"), Err(Denial::Method("POST")));
        assert_eq!(of("POST /api/state"), Err(Denial::Method("GET")));
        assert_eq!(of("GET /api/enable"), Err(Denial::Path));
    }

    #[test]
    fn token_is_needed_for_everything_but_the_page() {
        let guard = guard("token-file = \"t\"");
        let host = ("host", "127.0.0.1:8642");
        for line in ["GET /api/state", "GET /api/events", "POST /api/stop"] {
            assert_eq!(outcome(&guard, line, &[host]), Err(Denial::Token));
            for wrong in ["Bearer ", "Bearer 0123456789abcdeX", "Basic 0123456789abcdef", "Bearer", SECRET] {
                assert_eq!(outcome(&guard, line, &[host, ("authorization", wrong)]), Err(Denial::Token));
            }
            let bearer = format!("Bearer {SECRET}");
            let admitted = outcome(&guard, line, &[host, ("authorization", &bearer)]).unwrap();
            assert_eq!(admitted.person.as_deref(), Some("anna"));
            let twice = [host, ("authorization", &bearer), ("authorization", &bearer)];
            assert_eq!(outcome(&guard, line, &twice), Err(Denial::Token));
        }
        assert_eq!(outcome(&guard, "GET /", &[host]).unwrap().person, None);
    }

    #[test]
    fn large_or_endless_body_is_refused() {
        let local = guard("");
        let with = |name, value| {
            outcome(&local, "POST /api/stop", &[("host", "localhost:8642"), (name, value)]).map(|_| ())
        };
        assert_eq!(with("content-length", "1024"), Ok(()));
        assert_eq!(with("content-length", "1025"), Err(Denial::BodyTooLarge));
        assert_eq!(with("content-length", "99999999999999999999"), Err(Denial::BodyTooLarge));
        assert_eq!(with("transfer-encoding", "chunked"), Err(Denial::BodyTooLarge));
    }

    #[test]
    fn only_the_proxy_names_the_address() {
        let fields = [("host", "127.0.0.1:8642"), ("x-forwarded-for", "6.6.6.6, 192.168.1.7")];
        let proxied = guard("behind-proxy = true");
        let address = outcome(&proxied, "GET /", &fields).unwrap().forwarded_for;
        assert_eq!(address, "192.168.1.7".parse().ok());
        assert_eq!(outcome(&guard(""), "GET /", &fields).unwrap().forwarded_for, None);
    }
}
