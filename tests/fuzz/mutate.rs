//! Damage: makes broken files of valid ones, the same for the same random numbers.

use volseggs::rng::Rng;

/// Numbers that readers trip over, as text.
const NUMBERS: &[&str] = &[
    "0",
    "-0",
    "1",
    "-1",
    "2",
    "3",
    "7",
    "16",
    "255",
    "256",
    "65535",
    "65536",
    "1000000",
    "16777217",
    "2147483647",
    "2147483648",
    "-2147483648",
    "4294967295",
    "4294967296",
    "9007199254740993",
    "9223372036854775807",
    "-9223372036854775808",
    "18446744073709551615",
    "18446744073709551616",
    "340282366920938463463374607431768211456",
    "0.5",
    "0.1",
    "1e-7",
    "1e9",
    "1e18",
    "1e19",
    "1e30",
    "3.5e38",
    "1e300",
    "1.7976931348623157e308",
    "1e999",
    "-1e999",
    "5e-324",
    "NaN",
    "nan",
    "inf",
    "-inf",
    "Infinity",
    "null",
    "true",
    "\"\"",
    "[]",
    "{}",
    "00",
    "+1",
    "1_0",
    "0x10",
    "1.",
    ".5",
    "1e",
    "--1",
];

/// Pieces of text that may occur in any format.
const TEXTS: &[&str] = &[
    "",
    " ",
    "\n",
    "\n\n",
    "\r\n",
    "\t",
    "\0",
    "\"",
    "'",
    "\\",
    "\\u0000",
    "\\ud800",
    ",",
    ":",
    "=",
    "#",
    ".",
    "..",
    "/",
    "../",
    "\u{feff}",
    "\u{e9}",
    "\u{1f980}",
    "\u{202e}",
    "%",
    "%n",
    "{}",
    "[]",
    "()",
    "null",
    "None",
    "true",
    "false",
];

/// Opening delimiters that may be nested.
const OPENINGS: &[&str] = &["[", "{\"a\":", "(", "<a>", "{a=", "[[", "a.", "-", "\"", "\\", "<!--", "&", "x=["];

/// Integers of binary headers.
const WORDS: &[u64] = &[
    0,
    1,
    2,
    0x7f,
    0x80,
    0xff,
    0x7fff,
    0x8000,
    0xffff,
    0x10000,
    0x7fff_ffff,
    0x8000_0000,
    0xffff_ffff,
    0x1_0000_0000,
    0x7fff_ffff_ffff_ffff,
    0x8000_0000_0000_0000,
    0xffff_ffff_ffff_ffff,
];

/// Returns a damaged file of `corpus`, of at most `longest` bytes; `tokens` are pieces of text with a meaning in the
/// format.
pub fn damaged(rng: &mut Rng, corpus: &[Vec<u8>], tokens: &[&str], longest: usize) -> Vec<u8> {
    let mut bytes = pick(rng, corpus).clone();
    let rounds = match rng.below(8) {
        0..=3 => 1,
        4 | 5 => 2,
        6 => 4,
        _ => 1 + rng.below(16),
    };
    for _ in 0..rounds {
        once(rng, &mut bytes, corpus, tokens);
        bytes.truncate(longest);
    }
    bytes
}

fn pick<'a, T>(rng: &mut Rng, list: &'a [T]) -> &'a T {
    &list[rng.below(list.len())]
}

fn once(rng: &mut Rng, bytes: &mut Vec<u8>, corpus: &[Vec<u8>], tokens: &[&str]) {
    let n = bytes.len();
    let at = rng.below(n + 1);
    match rng.below(20) {
        0 if n > 0 => bytes[at.min(n - 1)] ^= 1 << rng.below(8),
        1 if n > 0 => bytes[at.min(n - 1)] = rng.next_u32() as u8,
        2 => put(bytes, at, 0, pick(rng, TEXTS).as_bytes()),
        3 | 4 if !tokens.is_empty() => {
            let over = if rng.below(2) == 0 { 0 } else { word_at(bytes, at).len() };
            let from = if over > 0 { word_at(bytes, at).start } else { at };
            put(bytes, from, over, pick(rng, tokens).as_bytes());
        }
        5..=8 => {
            let run = number_from(bytes, at);
            put(bytes, run.start, run.len(), pick(rng, NUMBERS).as_bytes());
        }
        9 => {
            let (from, len) = block(rng, n);
            let copy = bytes[from..from + len].to_vec();
            put(bytes, at, 0, &copy);
        }
        10 => {
            let (from, len) = block(rng, n);
            bytes.drain(from..from + len);
        }
        11 => bytes.truncate(at),
        12 => {
            let other = pick(rng, corpus);
            let from = rng.below(other.len() + 1);
            bytes.truncate(at);
            bytes.extend_from_slice(&other[from..]);
        }
        13 | 14 => integer(rng, bytes, at),
        15 => {
            let times = [1, 2, 20, 90, 140, 400][rng.below(6)];
            put(bytes, at, 0, pick(rng, OPENINGS).repeat(times).as_bytes());
        }
        16 => put(bytes, at, 0, &vec![b"a 0.\xff"[rng.below(5)]; 1 + rng.below(3000)]),
        17 => lines(rng, bytes),
        18 => {
            // one word replaced by another, both from the corpus
            let other = pick(rng, corpus);
            let word = word_at(other, rng.below(other.len() + 1));
            let place = word_at(bytes, at);
            let word = other[word].to_vec();
            put(bytes, place.start, place.len(), &word);
        }
        _ => {
            let junk: Vec<u8> = (0..1 + rng.below(9)).map(|_| rng.next_u32() as u8).collect();
            put(bytes, at, 0, &junk);
        }
    }
}

/// Replaces `over` bytes at `at` by `new`.
fn put(bytes: &mut Vec<u8>, at: usize, over: usize, new: &[u8]) {
    bytes.splice(at..at + over, new.iter().copied());
}

fn block(rng: &mut Rng, n: usize) -> (usize, usize) {
    let from = rng.below(n + 1);
    let max_len = if rng.below(2) == 0 { 16 } else { n };
    (from, rng.below((n - from).min(max_len) + 1))
}

/// Returns the next number in the text from `at` on, empty at the end.
fn number_from(bytes: &[u8], at: usize) -> std::ops::Range<usize> {
    let digit = |b: &u8| b.is_ascii_digit();
    let start = bytes[at..].iter().position(digit).map_or(bytes.len(), |i| at + i);
    let part = |b: &u8| b.is_ascii_digit() || matches!(b, b'.' | b'e' | b'E' | b'-' | b'+');
    let end = bytes[start..].iter().position(|b| !part(b)).map_or(bytes.len(), |i| start + i);
    start..end
}

/// Returns the word around `at`.
fn word_at(bytes: &[u8], at: usize) -> std::ops::Range<usize> {
    let part = |b: &u8| b.is_ascii_alphanumeric() || matches!(b, b'_' | b'.' | b'-');
    let start = bytes[..at].iter().rposition(|b| !part(b)).map_or(0, |i| i + 1);
    let end = bytes[at..].iter().position(|b| !part(b)).map_or(bytes.len(), |i| at + i);
    start..end
}

/// Overwrites an integer of 1, 2, 4 or 8 bytes in either byte order.
fn integer(rng: &mut Rng, bytes: &mut [u8], at: usize) {
    let width = 1 << rng.below(4);
    let Some(place) = bytes.get_mut(at..at + width) else { return };
    let word = *pick(rng, WORDS);
    if rng.below(2) == 0 {
        place.copy_from_slice(&word.to_le_bytes()[..width]);
    } else {
        place.copy_from_slice(&word.to_be_bytes()[8 - width..]);
    }
}

/// Duplicates, removes or swaps lines.
fn lines(rng: &mut Rng, bytes: &mut Vec<u8>) {
    let mut lines: Vec<&[u8]> = bytes.split_inclusive(|b| *b == b'\n').collect();
    if lines.is_empty() {
        return;
    }
    let (a, b) = (rng.below(lines.len()), rng.below(lines.len()));
    match rng.below(3) {
        0 => lines.swap(a, b),
        1 => {
            lines.remove(a);
        }
        _ => lines.insert(a, lines[b]),
    }
    *bytes = lines.concat();
}
