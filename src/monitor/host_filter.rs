//! Refuses requests that are meant for other hosts.
//!
//! A page of another site, open in a browser on this machine, can send requests here. If its name resolves to
//! this address (DNS rebinding), it can also read the answers. The browser sends the name that the page used
//! in `Host`, and the site of the page in `Origin`: both must name this machine. Only a health check by
//! HTTP/1.0, which no browser sends, needs no `Host`.

use std::net::IpAddr;

use axum::http::uri::Authority;
use axum::http::{HeaderMap, HeaderName, Request, StatusCode, Uri, Version, header};

/// The pages that load balancers request by HTTP/1.0 without `Host`.
const HEALTH_PAGES: [&str; 2] = ["/healthz", "/readyz"];

/// The configured names of this machine.
#[derive(Clone, Debug)]
pub struct Hosts(Vec<String>);

impl Hosts {
    /// Accepts these names, `localhost`, and the address to which a request was sent.
    pub fn new(allowed: &[String]) -> Self {
        Self(allowed.to_vec())
    }

    /// The status and reason if a request to this address is refused. Repeated headers are refused, since
    /// different programs could use different ones.
    pub fn refusal<B>(&self, request: &Request<B>, own: IpAddr) -> Option<(StatusCode, String)> {
        let twice = |name: &HeaderName| request.headers().get_all(name).iter().nth(1).is_some();
        for (name, word) in [(header::HOST, "Host"), (header::ORIGIN, "Origin")] {
            if twice(&name) {
                return Some((StatusCode::BAD_REQUEST, format!("the request has more than one {word}\n")));
            }
        }
        self.foreign(request, own).map(|why| (StatusCode::FORBIDDEN, why))
    }

    fn foreign<B>(&self, request: &Request<B>, own: IpAddr) -> Option<String> {
        let headers = request.headers();
        match text(headers, header::HOST).and_then(|host| host.parse::<Authority>().ok()) {
            Some(host) if self.are(host.host(), own) => {}
            Some(host) => return Some(self.words("Host", host.host())),
            None if is_plain_health_check(request) => {}
            None => return Some("the request has no valid Host\n".into()),
        }
        // In "GET http://host/" the host in the request line takes precedence over `Host`.
        if let Some(host) = request.uri().host().filter(|host| !self.are(host, own)) {
            return Some(self.words("request line host", host));
        }
        if !headers.contains_key(header::ORIGIN) {
            return None;
        }
        let origin = text(headers, header::ORIGIN).unwrap_or_default();
        let site = origin.parse::<Uri>().ok();
        match site.as_ref().and_then(Uri::host) {
            Some(host) if self.are(host, own) => None,
            _ => Some(self.words("Origin", origin)),
        }
    }

    fn are(&self, host: &str, own: IpAddr) -> bool {
        let address = host.trim_start_matches('[').trim_end_matches(']').parse::<IpAddr>();
        match address {
            Ok(address) => address.to_canonical() == own.to_canonical(),
            Err(_) => {
                host.eq_ignore_ascii_case("localhost") || self.0.iter().any(|h| h.eq_ignore_ascii_case(host))
            }
        }
    }

    fn words(&self, header: &str, found: &str) -> String {
        let mut allowed = vec!["localhost", "the address that the request is sent to"];
        allowed.extend(self.0.iter().map(String::as_str));
        format!(
            "{header} {found:?} is not a name of this machine; allowed: {} (monitor.allowed_hosts)\n",
            allowed.join(", ")
        )
    }
}

/// Whether this is a health check by HTTP/1.0 without `Host`. A browser always sends `Host`.
fn is_plain_health_check<B>(request: &Request<B>) -> bool {
    let headers = request.headers();
    request.version() <= Version::HTTP_10
        && !headers.contains_key(header::HOST)
        && !headers.contains_key(header::ORIGIN)
        && HEALTH_PAGES.contains(&request.uri().path())
}

fn text(headers: &HeaderMap, name: HeaderName) -> Option<&str> {
    headers.get(name)?.to_str().ok()
}

/// Whether a request comes from this page, or from no page at all. Another server on this machine has
/// pages, too; and this one has none by https.
pub fn own_page(headers: &HeaderMap) -> bool {
    let text = |name: HeaderName| headers.get(name)?.to_str().ok();
    let Some(origin) = text(header::ORIGIN) else { return !headers.contains_key(header::ORIGIN) };
    let site = origin.strip_prefix("http://");
    site.zip(text(header::HOST)).is_some_and(|(site, host)| site.eq_ignore_ascii_case(host))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn refused(host: &str, origin: Option<&str>) -> bool {
        let mut headers = HeaderMap::new();
        headers.insert(header::HOST, host.parse().unwrap());
        if let Some(origin) = origin {
            headers.insert(header::ORIGIN, origin.parse().unwrap());
        }
        refusal(&Uri::from_static("/"), &headers).is_some()
    }

    fn request(to: &Uri, headers: &HeaderMap) -> Request<()> {
        let mut request = Request::new(());
        (*request.uri_mut(), *request.headers_mut()) = (to.clone(), headers.clone());
        request
    }

    fn refusal(to: &Uri, headers: &HeaderMap) -> Option<(StatusCode, String)> {
        Hosts::new(&["lab-pc".into()]).refusal(&request(to, headers), [192, 168, 1, 5].into())
    }

    #[test]
    fn a_request_must_name_one_host_consistently() {
        let mut headers = HeaderMap::from_iter([(header::HOST, "lab-pc".parse().unwrap())]);
        for good in ["/metrics", "http://lab-pc/metrics", "http://192.168.1.5:7360/"] {
            assert_eq!(refusal(&good.parse().unwrap(), &headers), None, "{good}");
        }
        let (code, why) = refusal(&"http://evil.example/metrics".parse().unwrap(), &headers).unwrap();
        assert!(code == StatusCode::FORBIDDEN && why.contains("evil.example"), "{why}");
        for name in [header::HOST, header::ORIGIN] {
            headers.insert(&name, "lab-pc".parse().unwrap());
            headers.append(&name, "evil.example".parse().unwrap());
            let (code, why) = refusal(&Uri::from_static("/"), &headers).unwrap();
            assert_eq!(code, StatusCode::BAD_REQUEST, "{why}");
            headers.insert(&name, "lab-pc".parse().unwrap());
        }
    }

    #[test]
    fn requests_to_other_names_are_refused() {
        for good in ["localhost", "localhost:7360", "192.168.1.5:7360", "LAB-PC", "lab-pc:80"] {
            assert!(!refused(good, None), "{good}");
        }
        for bad in
            ["evil.example", "localhost.evil.example", "192.168.1.6", "127.0.0.1", "[::1]:7360", "a b", ""]
        {
            assert!(refused(bad, None), "{bad}");
        }
        let v6 = |host: &str| {
            let headers = HeaderMap::from_iter([(header::HOST, host.parse().unwrap())]);
            let request = request(&Uri::from_static("/"), &headers);
            Hosts::new(&[]).refusal(&request, std::net::Ipv6Addr::LOCALHOST.into())
        };
        assert!(v6("[::1]:7360").is_none() && v6("[::2]:7360").is_some());
        assert!(refusal(&Uri::from_static("/"), &HeaderMap::new()).is_some());
    }

    #[test]
    fn pages_of_other_sites_are_refused() {
        for good in ["http://localhost:7360", "http://192.168.1.5:7360", "http://lab-pc"] {
            assert!(!refused("localhost", Some(good)), "{good}");
        }
        for bad in ["null", "http://evil.example", "https://localhost.evil.example", ""] {
            assert!(refused("localhost", Some(bad)), "{bad}");
        }
    }

    #[test]
    fn another_port_of_this_machine_is_another_site() {
        let from = |origin: Option<&str>| {
            let mut headers = HeaderMap::new();
            headers.insert(header::HOST, "localhost:7360".parse().unwrap());
            if let Some(origin) = origin {
                headers.insert(header::ORIGIN, origin.parse().unwrap());
            }
            own_page(&headers)
        };
        assert!(from(None) && from(Some("http://localhost:7360")) && from(Some("http://LOCALHOST:7360")));
        for bad in [
            "http://localhost:8080",
            "http://localhost",
            "null",
            "",
            "http://127.0.0.1:7360",
            "https://localhost:7360",
        ] {
            assert!(!from(Some(bad)), "{bad}");
        }
    }
}
