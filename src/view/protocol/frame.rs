//! Frames: pictures with a small header.

/// Version of the header.
const VERSION: u8 = 1;
/// Length of the header in bytes.
pub const HEADER: usize = 32;

/// How a frame is encoded.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Codec {
    /// Lossy.
    Jpeg = 0,
    /// Lossless.
    Png = 1,
}

/// What a frame is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FrameKind {
    /// The picture, to be acknowledged.
    Picture = 0,
    /// What the picture of the same number is compared with.
    Other = 1,
    /// A file that was requested; its number is that of the request.
    Still = 2,
    /// The dataset's image of the test view of this number, in its own size.
    Image = 3,
}

/// The header of a frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FrameInfo {
    /// What it is.
    pub kind: FrameKind,
    /// How it is encoded.
    pub codec: Codec,
    /// Number, to be acknowledged.
    pub number: u32,
    /// Revision of the document that it shows.
    pub revision: u64,
    /// Width and height.
    pub size: [u32; 2],
    /// Time that it shows.
    pub time: f64,
    /// Milliseconds to draw.
    pub render_ms: f32,
    /// Milliseconds to encode.
    pub encode_ms: f32,
}

impl FrameInfo {
    /// Returns the frame as it is sent: version, codec, kind, a zero byte, then in little-endian order number (u32),
    /// revision (u64), width and height (u16 each), time, drawing and encoding milliseconds (f32 each), and the
    /// picture.
    pub fn with(&self, picture: &[u8]) -> Vec<u8> {
        let mut out = Vec::with_capacity(HEADER + picture.len());
        out.extend([VERSION, self.codec as u8, self.kind as u8, 0]);
        out.extend(self.number.to_le_bytes());
        out.extend(self.revision.to_le_bytes());
        self.size.iter().for_each(|n| out.extend((*n as u16).to_le_bytes()));
        [self.time as f32, self.render_ms, self.encode_ms].iter().for_each(|v| out.extend(v.to_le_bytes()));
        out.extend(picture);
        out
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_frame_begins_with_its_header() {
        let info = FrameInfo {
            kind: FrameKind::Still,
            codec: Codec::Png,
            number: 9,
            revision: 2,
            size: [800, 600],
            time: 0.25,
            render_ms: 12.0,
            encode_ms: 3.0,
        };
        let frame = info.with(b"picture");
        let header: String = frame[..HEADER].iter().map(|byte| format!("{byte:02x}")).collect();
        // tests/view/page/frame.test.mjs reads the same bytes
        assert_eq!(header, "01010200090000000200000000000000200358020000803e0000404100004040");
        assert_eq!(&frame[HEADER..], b"picture");
    }
}
