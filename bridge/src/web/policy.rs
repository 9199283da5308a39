//! The page itself, and the fields that keep a browser from mixing it with other sites.

use hyper::HeaderMap;
use hyper::header::{
    CACHE_CONTROL, CONTENT_SECURITY_POLICY, HeaderName, HeaderValue, REFERRER_POLICY, X_CONTENT_TYPE_OPTIONS,
    X_FRAME_OPTIONS,
};
use ring::digest::{SHA256, digest};

/// The page: one file without a reference to another.
pub(crate) const PAGE: &str = include_str!("page.html");

/// Returns the policy of the page: its own script and style, by their digests, and requests to the
/// bridge.
pub(crate) fn content_security_policy() -> String {
    let [script, style] = ["script", "style"].map(|tag| source(PAGE, tag));
    format!(
        "default-src 'none'; script-src {script}; style-src {style}; connect-src 'self'; img-src data:; \
         base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    )
}

/// Returns the source expression of the element `tag`.
fn source(page: &str, tag: &str) -> String {
    let text =
        page.split_once(&format!("<{tag}>")).and_then(|(_, rest)| rest.split_once(&format!("</{tag}>")));
    let text = text.map_or("", |(text, _)| text);
    format!("'sha256-{}'", base64(digest(&SHA256, text.as_bytes()).as_ref()))
}

fn base64(bytes: &[u8]) -> String {
    const LETTERS: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let mut text = String::new();
    for chunk in bytes.chunks(3) {
        let byte = |index: usize| u32::from(chunk.get(index).copied().unwrap_or(0));
        let bits = byte(0) << 16 | byte(1) << 8 | byte(2);
        for letter in 0..4 {
            let index = (bits >> (18 - 6 * letter)) & 63;
            text.push(if letter <= chunk.len() { char::from(LETTERS[index as usize]) } else { '=' });
        }
    }
    text
}

/// Adds the fields of every answer. `policy` is [`content_security_policy`].
pub(crate) fn protect(headers: &mut HeaderMap, policy: &HeaderValue) {
    let fixed = [
        (CACHE_CONTROL, "no-store"),
        (X_CONTENT_TYPE_OPTIONS, "nosniff"),
        (X_FRAME_OPTIONS, "DENY"),
        (REFERRER_POLICY, "no-referrer"),
        (HeaderName::from_static("cross-origin-opener-policy"), "same-origin"),
        (HeaderName::from_static("cross-origin-resource-policy"), "same-origin"),
    ];
    for (name, value) in fixed {
        headers.insert(name, HeaderValue::from_static(value));
    }
    headers.insert(CONTENT_SECURITY_POLICY, policy.clone());
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn base64_has_the_vectors_of_rfc_4648() {
        let texts = ["", "f", "fo", "foo", "foob", "fooba", "foobar"].map(|text| base64(text.as_bytes()));
        assert_eq!(texts, ["", "Zg==", "Zm8=", "Zm9v", "Zm9vYg==", "Zm9vYmE=", "Zm9vYmFy"]);
    }

    #[test]
    fn page_has_one_script_one_style_nothing_external() {
        for (tag, count) in [("<script>", 1), ("<style>", 1), ("<script ", 0), ("http:", 0), ("https:", 0)] {
            assert_eq!(PAGE.matches(tag).count(), count, "{tag}");
        }
        for word in [" src=", "innerHTML", "url(", "@import", " onclick", " style=", "eval("] {
            assert!(!PAGE.contains(word), "{word}");
        }
        assert_ne!(source(PAGE, "script"), source("", "script"));
        assert!(PAGE.len() <= 20_000, "{} bytes", PAGE.len());
    }

    #[test]
    fn every_answer_refuses_frames_and_sniffing() {
        let mut headers = HeaderMap::new();
        protect(&mut headers, &content_security_policy().parse().unwrap());
        assert_eq!(headers[X_FRAME_OPTIONS], "DENY");
        assert_eq!(headers[X_CONTENT_TYPE_OPTIONS], "nosniff");
        let policy = headers[CONTENT_SECURITY_POLICY].to_str().unwrap();
        assert!(policy.starts_with("default-src 'none'") && !policy.contains("unsafe"), "{policy}");
    }
}
