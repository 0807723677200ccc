//! Measures how deeply tables and lists of a TOML text are nested before it is parsed: the parser limits dotted keys
//! and values separately but not together, and its result is traversed recursively.

/// Maximum depth that is accepted; the configuration needs 4.
const MAX_DEPTH: usize = 64;

/// Rejects a text whose tables and lists are nested too deeply. Whether it is valid TOML is not checked.
///
/// # Errors
/// The line, and what is wrong.
pub(crate) fn check_toml(text: &str) -> Result<(), String> {
    let bytes = text.as_bytes();
    // levels added by each open bracket, their sum, levels of the last header, of the current key, of the key before
    // `=`
    let (mut open, mut within, mut header, mut dots, mut key) = (Vec::new(), 0, 0, 0, 0);
    let (mut in_header, mut line, mut at) = (false, 1, 0);
    while at < bytes.len() {
        match bytes[at] {
            b'#' => {
                at += bytes[at..].iter().position(|b| *b == b'\n').unwrap_or(bytes.len() - at);
                continue;
            }
            b'"' | b'\'' => {
                let end = end_of_string(bytes, at);
                line += bytes[at..end].iter().filter(|b| **b == b'\n').count();
                at = end;
                continue;
            }
            b'.' => dots += 1,
            b'=' => (key, dots) = (dots + 1, 0),
            b'[' | b'{' => {
                if open.is_empty() && key == 0 {
                    (in_header, header) = (true, 0);
                }
                let levels = if in_header { 0 } else { key.max(1) };
                open.push(levels);
                within += levels;
                (key, dots) = (0, 0);
            }
            b']' | b'}' => {
                within -= open.pop().unwrap_or(0);
                if in_header {
                    header = header.max(dots + 1);
                    in_header = !open.is_empty();
                }
                (key, dots) = (0, 0);
            }
            b',' => (key, dots) = (0, 0),
            b'\n' => {
                line += 1;
                (key, dots) = (0, 0);
            }
            _ => {}
        }
        if header + within + dots + key > MAX_DEPTH {
            return Err(format!("line {line}: more than {MAX_DEPTH} nested tables and lists; use fewer"));
        }
        at += 1;
    }
    Ok(())
}

/// The position after the string that begins at `start`; a line break also ends a single-line string.
fn end_of_string(bytes: &[u8], start: usize) -> usize {
    let quote = bytes[start];
    let long = bytes[start..].starts_with(&[quote; 3]);
    let mut at = start + if long { 3 } else { 1 };
    while at < bytes.len() {
        match bytes[at] {
            b'\\' if quote == b'"' => at += 1,
            b'\n' if !long => return at,
            b if b == quote && !long => return at + 1,
            // up to two quotes before the closing three are part of the text
            b if b == quote && bytes[at..].starts_with(&[quote; 3]) => {
                let more = bytes[at + 3..].iter().take(2).take_while(|b| **b == quote).count();
                return at + 3 + more;
            }
            _ => {}
        }
        at += 1;
    }
    bytes.len()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn depth_adds_up_headers_keys_and_values() {
        let key = |levels: usize| vec!["a"; levels].join(".");
        let deep = [
            format!("{} = 1", key(100_000)),
            format!("[{}]\nb = 1", key(100)),
            format!("[{}]\n{} = 1", key(40), key(40)),
            format!("[[x]]\na = {}", "[".repeat(100_000)),
            format!("a = [\"\"\"x\"\"\"\"\", '''x'''', {}", "[".repeat(70)),
            format!("{}b = 1{}", format!("{} = {{", key(30)).repeat(3), "}".repeat(3)),
            format!("a = [\n{}", "{ \"x\" . 'y' = ".repeat(40)),
        ];
        for text in deep {
            let error = check_toml(&text).unwrap_err();
            assert!(error.contains("more than 64"), "{error}");
        }
        assert!(check_toml(&format!("a = 1\n{} = 1", key(99))).unwrap_err().starts_with("line 2:"));
    }

    #[test]
    fn dots_and_brackets_in_text_do_not_count() {
        let many = "[.".repeat(200);
        let fine = format!(
            "# {many}\na = \"{many}\\\"{many}\"\nb = '{many}'\nc = \"\"\"\n{many}\n\"\"\" # {many}\nd = [{}]\n[x.y]\n{}",
            "1.5, ".repeat(300),
            "k.l = { m = [[0.5]] }\n".repeat(200)
        );
        check_toml(&fine).unwrap();
        for (_, text) in crate::method::presets() {
            check_toml(text).unwrap();
        }
        // rejecting invalid TOML is left to the parser
        for text in ["]]}}\n]", "\"", "'''", "\"\\", "a = \"x\n[", "\u{e9} = '"] {
            check_toml(text).unwrap();
        }
    }
}
