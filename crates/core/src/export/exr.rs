//! OpenEXR pictures of single precision: scan lines, uncompressed, so that the format needs no library.

use crate::files::MARK;

/// The type FLOAT of a channel.
const FLOAT: i32 = 2;

/// Encodes channels of `width` x `height` pixels, `[H, W]` each, as an OpenEXR file with a `comment`. Readers find
/// channels by name, such as `Z`, and list them by it.
pub fn encode([width, height]: [usize; 2], channels: &[(&str, Vec<f32>)], comment: &str) -> Vec<u8> {
    // the format requires this order
    let mut channels: Vec<&(&str, Vec<f32>)> = channels.iter().collect();
    channels.sort_by_key(|(name, _)| *name);
    let mut file = vec![0x76, 0x2f, 0x31, 0x01, 2, 0, 0, 0];
    let mut list = Vec::new();
    for (name, _) in &channels {
        list.extend(name.bytes().chain([0]));
        list.extend(FLOAT.to_le_bytes());
        // perceptually linear: no, and three bytes reserved; then the sampling along x and y
        list.extend([0; 4]);
        list.extend([1i32, 1].map(i32::to_le_bytes).concat());
    }
    list.push(0);
    // sides are below 2^31, as are those of every picture
    let window = [0, 0, width as i32 - 1, height as i32 - 1].map(i32::to_le_bytes).concat();
    let one = 1f32.to_le_bytes();
    for (name, kind, value) in [
        ("channels", "chlist", &list[..]),
        ("comments", "string", format!("{MARK}: {comment}").as_bytes()),
        ("compression", "compression", &[0]),
        ("dataWindow", "box2i", &window),
        ("displayWindow", "box2i", &window),
        ("lineOrder", "lineOrder", &[0]),
        ("pixelAspectRatio", "float", &one),
        ("screenWindowCenter", "v2f", &[0; 8]),
        ("screenWindowWidth", "float", &one),
    ] {
        file.extend(name.bytes().chain([0]).chain(kind.bytes()).chain([0]));
        file.extend((value.len() as i32).to_le_bytes());
        file.extend(value);
    }
    file.push(0);
    let line = 4 * width * channels.len();
    let first = file.len() + 8 * height;
    for y in 0..height {
        file.extend(((first + y * (8 + line)) as u64).to_le_bytes());
    }
    for y in 0..height {
        file.extend((y as i32).to_le_bytes());
        file.extend((line as i32).to_le_bytes());
        for (_, values) in &channels {
            file.extend(values[y * width..][..width].iter().flat_map(|v| v.to_le_bytes()));
        }
    }
    file
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The bytes of a row, found through the table of offsets, which follows the header's end.
    fn row(file: &[u8], y: usize, bytes: usize) -> &[u8] {
        let end = b"screenWindowWidth\0float\0";
        let table = file.windows(end.len()).position(|w| w == end).unwrap() + end.len() + 4 + 4 + 1;
        let at = u64::from_le_bytes(file[table + 8 * y..][..8].try_into().unwrap()) as usize;
        let (head, row) = file[at..][..8 + bytes].split_at(8);
        assert_eq!(head, [y as i32, bytes as i32].map(i32::to_le_bytes).concat());
        row
    }

    #[test]
    fn rows_are_where_the_table_says_and_channels_in_the_order_of_their_names() {
        let file = encode([3, 2], &[("Z", vec![0.5; 6]), ("A", (0..6).map(|v| v as f32).collect())], "depth");
        let floats =
            |bytes: &[u8]| bytes.chunks(4).map(|b| f32::from_le_bytes(b.try_into().unwrap())).collect::<Vec<_>>();
        assert_eq!(floats(row(&file, 0, 24)), [0.0, 1.0, 2.0, 0.5, 0.5, 0.5]);
        assert_eq!(floats(row(&file, 1, 24)), [3.0, 4.0, 5.0, 0.5, 0.5, 0.5]);
        assert!(file[..200].windows(MARK.len()).any(|w| w == MARK.as_bytes()));
    }
}
