//! Checks the size claimed by the header of a PNG against its number of bytes. Nothing is decompressed here.

/// Maximum expansion of deflate: 258 bytes from 2 bits.
const MAX_EXPANSION: u64 = 1032;
/// Bytes of a PNG up to its size, bit depth and colour type: the signature and the start of its first chunk.
pub const START: usize = 26;

/// Rejects a PNG of more pixels than its `len` bytes can hold, before memory is allocated for them. `start` is its
/// beginning, [`START`] bytes or more; anything but a PNG passes, as its reader reports that.
///
/// # Errors
/// What the header claims.
pub fn check_claim(start: &[u8], len: u64) -> Result<(), String> {
    if start.len() < START || !start.starts_with(b"\x89PNG\r\n\x1a\n") || &start[12..16] != b"IHDR" {
        return Ok(());
    }
    let number = |at: usize| u32::from_be_bytes([start[at], start[at + 1], start[at + 2], start[at + 3]]);
    let (width, height) = (number(16), number(20));
    let channels = match start[25] {
        2 => 3,
        4 => 2,
        6 => 4,
        _ => 1,
    };
    let bits = u128::from(width) * u128::from(height) * u128::from(start[24].max(1)) * channels;
    if bits.div_ceil(8) <= u128::from(len.saturating_mul(MAX_EXPANSION)) {
        return Ok(());
    }
    Err(format!("damaged: its header says {width}x{height} pixels, more than its {len} bytes can hold"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::data::fixture::claims_to_be;

    #[test]
    fn a_header_that_claims_more_than_its_bytes_hold_is_refused() {
        let bytes = claims_to_be(60_000, 30_000).unwrap();
        let error = check_claim(&bytes, bytes.len() as u64).unwrap_err();
        assert!(error.contains("60000x30000"), "{error}");
        assert!(check_claim(&claims_to_be(u32::MAX, u32::MAX).unwrap(), u64::MAX).is_ok());
        assert!(check_claim(b"no PNG", 6).is_ok());
        // an image of one colour is as small as deflate can make it
        let mut plain = Vec::new();
        let image = image::RgbaImage::new(4000, 4000);
        image.write_to(&mut std::io::Cursor::new(&mut plain), image::ImageFormat::Png).unwrap();
        check_claim(&plain, plain.len() as u64).unwrap();
    }
}
