//! Output to a terminal. Names of devices, files and fields are untrusted: they may contain sequences that
//! move the cursor or change printed text.

use std::fmt::Arguments;

/// Escapes control characters as `\u001b`, as in JSON; line ends and tabs stay.
pub fn escaped(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for c in text.chars() {
        // Bidirectional control characters can make a line read as another one.
        let hides = matches!(c, '\u{202a}'..='\u{202e}' | '\u{2066}'..='\u{2069}');
        if (c.is_control() && !matches!(c, '\n' | '\t')) || hides {
            out += &format!("\\u{:04x}", u32::from(c));
        } else {
            out.push(c);
        }
    }
    out
}

/// Prints to standard output.
pub fn out(text: Arguments<'_>) {
    std::print!("{}", escaped(&text.to_string()));
}

/// Prints to standard error.
pub fn err(text: Arguments<'_>) {
    std::eprint!("{}", escaped(&text.to_string()));
}

#[cfg(test)]
mod tests {
    use super::escaped;

    #[test]
    fn control_characters_are_written_out() {
        assert_eq!(escaped("a\n\tb µ"), "a\n\tb µ");
        assert_eq!(escaped("\x1b[2J\x07\r\u{9b}\u{202e}"), "\\u001b[2J\\u0007\\u000d\\u009b\\u202e");
    }
}
