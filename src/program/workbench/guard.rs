//! Access control. The server accepts only the browser that was given the address, from a page of this
//! server, under this server's own name.
//!
//! A foreign web page can make a browser send requests to 127.0.0.1. With a host name that resolves there
//! (DNS rebinding) it can even read the responses. Requests must therefore have this server's address as
//! Host, this server as Origin if an Origin is sent, and a random token. The token comes in the address once
//! and is a cookie afterwards.

use super::Shared;
use axum::body::Body;
use axum::extract::{Request, State};
use axum::http::{HeaderMap, HeaderValue, Method, StatusCode, header};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use std::sync::Arc;

/// Creates a token: 128 random bits from the system.
///
/// # Errors
///
/// The system has no random numbers.
pub fn token() -> Result<String, String> {
    let mut bytes = [0u8; 16];
    getrandom::fill(&mut bytes).map_err(|e| format!("no random numbers: {e}"))?;
    Ok(bytes.iter().map(|b| format!("{b:02x}")).collect())
}

/// Compares in constant time.
fn same(a: &str, b: &str) -> bool {
    a.len() == b.len() && a.bytes().zip(b.bytes()).fold(0, |d, (a, b)| d | (a ^ b)) == 0
}

fn text(headers: &HeaderMap, name: header::HeaderName) -> Option<&str> {
    headers.get(name)?.to_str().ok()
}

fn refuse(code: StatusCode, why: &'static str) -> Response {
    (code, [(header::CONTENT_TYPE, "text/plain; charset=utf-8")], why).into_response()
}

/// Sanitises a path of this server: a browser reads a path with two leading slashes as another server.
fn room(path: &str) -> String {
    let plain = path.chars().all(|c| c.is_ascii_alphanumeric() || matches!(c, '/' | '.' | '-' | '_'));
    if plain { format!("/{}", path.trim_start_matches('/')) } else { "/".into() }
}

/// Passes a request on, or responds with the reason of the refusal.
pub async fn guard(State(shared): State<Arc<Shared>>, request: Request<Body>, next: Next) -> Response {
    let headers = request.headers();
    let host = text(headers, header::HOST).unwrap_or_default().to_string();
    if !shared.hosts.contains(&host) {
        return refuse(
            StatusCode::MISDIRECTED_REQUEST,
            "This server does not answer to that name. Use the address that radcam printed.\n",
        );
    }
    let foreign = text(headers, header::ORIGIN).is_some_and(|o| o != format!("http://{host}"));
    let cross = headers.get("sec-fetch-site").is_some_and(|v| v == "cross-site" || v == "same-site");
    let given = request.uri().query().unwrap_or_default().split('&').find_map(|q| q.strip_prefix("token="));
    let told = given.is_some_and(|t| same(t, &shared.token));
    // A browser that opens the address from a file or another program reports a cross-site request.
    let opens = request.method() == Method::GET && told;
    if foreign || (cross && !opens) {
        return refuse(StatusCode::FORBIDDEN, "This server does not answer to other pages.\n");
    }
    let cookie = format!("radcam-{}=", shared.port);
    let cookies = text(headers, header::COOKIE).unwrap_or_default();
    let known = cookies.split("; ").filter_map(|c| c.strip_prefix(&cookie)).any(|t| same(t, &shared.token));
    if !known || given.is_some() {
        if !told {
            return refuse(
                StatusCode::FORBIDDEN,
                "Open the address that radcam workbench printed: it holds the token.\n",
            );
        }
        // Remove the token from the address, so that no history and no screenshot contains it.
        let cookie = format!("{cookie}{}; Path=/; HttpOnly; SameSite=Strict", shared.token);
        let room = room(request.uri().path());
        let mut answer = if cross {
            // A redirect would still count as cross-site and send no cookie.
            let text = format!(
                "<!doctype html><meta charset=\"utf-8\"><meta http-equiv=\"refresh\" content=\"0;url={room}\">"
            );
            let kind = HeaderValue::from_static("text/html; charset=utf-8");
            (StatusCode::OK, [(header::CONTENT_TYPE, kind)], text).into_response()
        } else {
            (StatusCode::SEE_OTHER, [(header::LOCATION, room)]).into_response()
        };
        let headers = answer.headers_mut();
        headers.insert(header::REFERRER_POLICY, HeaderValue::from_static("no-referrer"));
        headers.insert(header::CACHE_CONTROL, HeaderValue::from_static("no-store"));
        if let Ok(value) = HeaderValue::from_str(&cookie) {
            answer.headers_mut().insert(header::SET_COOKIE, value);
        }
        return answer;
    }
    let mut answer = next.run(request).await;
    let headers = answer.headers_mut();
    for (name, value) in [
        (
            "content-security-policy",
            "default-src 'none'; script-src 'self'; style-src 'self' 'unsafe-inline'; img-src 'self' data: blob:; connect-src 'self'; form-action 'self'; base-uri 'none'; frame-ancestors 'none'",
        ),
        ("x-content-type-options", "nosniff"),
        ("referrer-policy", "no-referrer"),
        ("cross-origin-resource-policy", "same-origin"),
    ] {
        headers.insert(name, HeaderValue::from_static(value));
    }
    headers.entry(header::CACHE_CONTROL).or_insert(HeaderValue::from_static("no-store"));
    answer
}
