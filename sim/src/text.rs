//! Values of files in messages, shortened so that a field of 100 MB is not repeated.

/// Maximum number of characters of a value that a message repeats.
const MAX_ECHO: usize = 80;

/// Shortens a value of a file for a message: at most 80 characters.
pub fn echo(value: &str) -> String {
    match value.char_indices().nth(MAX_ECHO) {
        None => value.into(),
        Some((end, _)) => format!("{}... ({} characters)", &value[..end], value.chars().count()),
    }
}

/// Shortens a parser's message of one sentence, which may repeat a value anywhere: a long one keeps its first
/// 50 and last 30 characters.
pub fn echo_message(message: &str) -> String {
    const LONG: usize = 120;
    let characters = message.chars().count();
    if characters <= LONG {
        return message.into();
    }
    let (start, end): (String, String) =
        (message.chars().take(50).collect(), message.chars().skip(characters - 30).collect());
    format!("{start}...{end}")
}

/// Shortens a parser's message of several lines, which may repeat lines of the file: at most 80 characters of
/// each.
pub fn echo_lines(message: &str) -> String {
    /// Maximum number of lines: the TOML parser repeats one line of the file.
    const MAX_LINES: usize = 12;
    message.trim_end().lines().take(MAX_LINES).map(echo).collect::<Vec<_>>().join("\n")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_are_repeated_in_part() {
        assert_eq!((echo("short"), echo_message("a: b")), ("short".into(), "a: b".into()));
        let long = echo(&"ä".repeat(1000));
        assert!(long.starts_with(&"ä".repeat(80)) && long.ends_with("... (1000 characters)"), "{long}");
        let said = echo_lines(&format!("TOML parse error\n  |\n1 | {}\n  | ^^", "x".repeat(10_000)));
        assert!(said.len() < 300 && said.contains("TOML parse error"), "{said}");
        let said =
            echo_message(&format!("unknown variant `{}`, expected `dark` or `flat`", "x".repeat(10_000)));
        assert!(said.len() < 100 && said.contains("unknown variant") && said.contains("`flat`"), "{said}");
    }
}
