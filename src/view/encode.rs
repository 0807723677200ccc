//! Pictures on their way to a client, encoded where they are sent: the drawing thread begins the next one meanwhile.

use super::protocol::{Codec, FrameInfo};
use crate::export::images::encode_png;
use crate::run::RunError;
use image::RgbImage;
use jpeg_encoder::{ColorType, Encoder};
use std::time::Instant;

/// A picture that is to be sent.
#[derive(Clone, Debug)]
pub struct OutgoingPicture {
    info: FrameInfo,
    rgb: RgbImage,
    /// Quality of JPEG in percent; lossless if `None`.
    quality: Option<u8>,
}

impl OutgoingPicture {
    /// Makes a picture of `rgb`, to be encoded as JPEG of a quality in percent, or lossless. Codec and size of `info`
    /// follow from the two.
    pub fn new(info: FrameInfo, rgb: RgbImage, quality: Option<u8>) -> Self {
        let codec = if quality.is_some() { Codec::Jpeg } else { Codec::Png };
        let size = [rgb.width(), rgb.height()];
        Self { info: FrameInfo { codec, size, ..info }, rgb, quality }
    }

    /// Returns its header, without the time to encode it.
    pub fn info(&self) -> &FrameInfo {
        &self.info
    }

    /// Encodes it, and returns the header, with how long that took, and the file.
    ///
    /// # Errors
    /// If the encoder fails.
    pub fn encode(mut self) -> Result<(FrameInfo, Vec<u8>), RunError> {
        let started = Instant::now();
        let bytes = match self.quality {
            None => encode_png(&self.rgb).map_err(RunError::failure)?,
            Some(quality) => {
                let (width, height) = self.rgb.dimensions();
                let mut bytes = Vec::new();
                let encoder = Encoder::new(&mut bytes, quality);
                encoder
                    .encode(self.rgb.as_raw(), width as u16, height as u16, ColorType::Rgb)
                    .map_err(RunError::failure)?;
                bytes
            }
        };
        self.info.encode_ms = 1e3 * started.elapsed().as_secs_f32();
        Ok((self.info, bytes))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::view::protocol::FrameKind;

    #[test]
    fn a_lossless_picture_equals_the_file_and_a_jpeg_is_smaller() {
        let rgb = RgbImage::from_fn(64, 48, |x, y| image::Rgb([(3 * x) as u8, (5 * y) as u8, (x * y) as u8]));
        let (number, revision, time, render_ms, encode_ms) = (3, 1, 0.5, 2.0, 0.0);
        let (kind, codec, size) = (FrameKind::Picture, Codec::Png, [0; 2]);
        let info = FrameInfo { kind, codec, number, revision, size, time, render_ms, encode_ms };
        let (sent, png) = OutgoingPicture::new(info, rgb.clone(), None).encode().unwrap();
        assert_eq!((sent.codec, sent.size, sent.number), (Codec::Png, [64, 48], 3));
        assert_eq!(png, encode_png(&rgb).unwrap());
        let (sent, jpeg) = OutgoingPicture::new(info, rgb, Some(60)).encode().unwrap();
        assert_eq!((sent.codec, &jpeg[..2]), (Codec::Jpeg, &[0xff, 0xd8][..]));
        assert!(jpeg.len() < png.len());
    }
}
