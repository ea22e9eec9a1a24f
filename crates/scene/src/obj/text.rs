//! The line structure that OBJ and MTL share.

use std::borrow::Cow;

/// Logical lines with the number of their first physical line: any of LF, CR LF and CR ends a line, a backslash before
/// it joins the next one. Comments and blank lines are left out; bytes that are not UTF-8 are replaced.
pub(super) fn lines(bytes: &[u8]) -> impl Iterator<Item = (usize, Cow<'_, str>)> {
    let mut rest = bytes;
    let mut next_number = 1;
    std::iter::from_fn(move || {
        while !rest.is_empty() {
            let number = next_number;
            let mut line = physical(&mut rest);
            next_number += 1;
            let mut joined: Option<Vec<u8>> = None;
            while let Some(stem) = line.strip_suffix(b"\\").filter(|_| !rest.is_empty()) {
                let whole = joined.get_or_insert_default();
                whole.extend_from_slice(stem);
                whole.push(b' ');
                line = physical(&mut rest);
                next_number += 1;
            }
            let text = match joined {
                Some(mut whole) => {
                    whole.extend_from_slice(line);
                    Cow::Owned(String::from_utf8_lossy(&whole).into_owned())
                }
                None => String::from_utf8_lossy(line),
            };
            let trimmed = text.trim();
            if !trimmed.is_empty() && !trimmed.starts_with('#') {
                return Some((number, text));
            }
        }
        None
    })
}

/// Takes one physical line, without its end.
fn physical<'a>(rest: &mut &'a [u8]) -> &'a [u8] {
    let end = rest
        .iter()
        .position(|&b| b == b'\n' || b == b'\r')
        .unwrap_or(rest.len());
    let (line, tail) = rest.split_at(end);
    *rest = match tail {
        [b'\r', b'\n', after @ ..] | [_, after @ ..] => after,
        [] => tail,
    };
    line
}

/// A statement's keyword and the rest, trimmed.
pub(super) fn split(line: &str) -> (&str, &str) {
    let line = line.trim();
    match line.split_once(char::is_whitespace) {
        Some((key, rest)) => (key, rest.trim()),
        None => (line, ""),
    }
}

/// The numbers at the beginning of a text, up to the first that is none (a comment, say).
pub(super) fn numbers(text: &str) -> impl Iterator<Item = f32> + '_ {
    text.split_whitespace().map_while(|word| word.parse().ok())
}

/// Three numbers; one alone counts for all three, as MTL says.
pub(super) fn triple(text: &str) -> Option<[f32; 3]> {
    let mut n = numbers(text).filter(|x| x.is_finite());
    let x = n.next()?;
    Some(match (n.next(), n.next()) {
        (Some(y), Some(z)) => [x, y, z],
        _ => [x, x, x],
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn all_line_ends_and_continuations() {
        let text = b"a 1\r\nb \\\r\n 2\rc\n\n# no\nd\\\n\\\ne \\";
        let got: Vec<_> = lines(text).map(|(n, l)| (n, l.trim().to_owned())).collect();
        let want = [(1, "a 1"), (2, "b   2"), (4, "c"), (7, "d  e \\")];
        assert_eq!(got, want.map(|(n, l)| (n, l.to_owned())));
    }

    #[test]
    fn one_number_is_grey() {
        assert_eq!(triple("0.5"), Some([0.5; 3]));
        assert_eq!(triple("1 2 3 # c"), Some([1.0, 2.0, 3.0]));
        assert_eq!(triple("spectral x.rfl"), None);
    }
}
