//! Database addresses without their secrets.

/// Returns an address for display: without password and without parameters.
pub fn shown(url: &str) -> String {
    let Some((kind, rest)) = url.split_once("://") else { return url.into() };
    let rest = rest.split(['?', '#']).next().unwrap_or_default();
    // A password may hold an unescaped @ or slash: the host follows the last @.
    let (user, host) = match rest.rsplit_once('@') {
        Some((user, host)) => (user.split(':').next().unwrap_or_default(), host),
        None => ("", rest),
    };
    let user = if user.is_empty() { String::new() } else { format!("{user}@") };
    format!("{kind}://{user}{host}")
}

/// Returns true for an address with a password.
pub fn has_password(url: &str) -> bool {
    let Some((_, rest)) = url.split_once("://") else { return false };
    let (place, parameters) = rest.split_once('?').unwrap_or((rest, ""));
    let named = |p: &str| p.split('=').next().is_some_and(|name| name.to_lowercase().contains("password"));
    place.rsplit_once('@').is_some_and(|(user, _)| user.contains(':'))
        || rest.rsplit_once('@').is_some_and(|(user, _)| user.contains(':'))
        || parameters.split('&').any(named)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_password_is_not_shown() {
        for (url, said) in [
            ("postgres://me:secret@host/db", "postgres://me@host/db"),
            ("postgres://me:se@cret/x@host:5432/db", "postgres://me@host:5432/db"),
            ("postgres://:secret@host/db", "postgres://host/db"),
            ("postgres://host/db?user=me&password=secret", "postgres://host/db"),
            ("postgres://me@host/db?sslpassword=secret", "postgres://me@host/db"),
        ] {
            assert_eq!(shown(url), said);
            assert!(has_password(url), "{url}");
        }
        for url in ["sqlite:/a/b.db?mode=rwc", "history.db", "postgres://me@host/db?sslmode=require"] {
            assert!(!has_password(url), "{url}");
        }
        assert_eq!(shown("sqlite:/a/b.db?mode=rwc"), "sqlite:/a/b.db?mode=rwc");
    }
}
