//! Animated PNG files from a sequence of frames.

use std::error::Error;
use std::io;
use std::path::{Path, PathBuf};

use png::ColorType;

use super::images::encoder;
use crate::files::{AtomicFile, ReplaceError};

/// Why an animation cannot be written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum AnimationError {
    /// The file system failed.
    #[error("{path}: {source}")]
    Io {
        /// The file.
        path: PathBuf,
        /// The error of the system.
        source: io::Error,
    },
    /// The PNG encoder refused.
    #[error("{path}: {source}")]
    Encode {
        /// The file.
        path: PathBuf,
        /// The error of the encoder.
        source: png::EncodingError,
    },
    /// There are no frames, more than a file can hold, or the rate is outside 1 to 65535.
    #[error("an animation of {frames} frames at {fps} frames per second cannot be written")]
    Timing {
        /// Number of frames.
        frames: usize,
        /// Frames per second.
        fps: u16,
    },
    /// A frame has another size.
    #[error("frame {index} holds {got} bytes, expected {expected}; render all frames at one size")]
    Size {
        /// The frame, from 0.
        index: usize,
        /// Its bytes.
        got: usize,
        /// Bytes of a frame of this size.
        expected: u64,
    },
    /// Something else is at the path.
    #[error(transparent)]
    Replace(#[from] ReplaceError),
    /// A frame could not be produced.
    #[error("frame {index}: {source}")]
    Frame {
        /// The frame, from 0.
        index: usize,
        /// The error of its producer.
        source: Box<dyn Error + Send + Sync>,
    },
}

/// Writes frames `[height, width]` of this `color`, 8 bits per channel, whose production can fail, as an APNG that repeats
/// forever.
///
/// Only one frame is held at a time, and the file appears only when all are in it. It carries [`crate::files::MARK`].
///
/// # Errors
/// Any variant of [`AnimationError`], [`AnimationError::Frame`] for a failed frame; no file is then written.
pub fn try_write_apng<I, F, E>(
    path: &Path,
    frames: I,
    (width, height): (u32, u32),
    color: ColorType,
    fps: u16,
) -> Result<(), AnimationError>
where
    I: IntoIterator<Item = Result<F, E>, IntoIter: ExactSizeIterator>,
    F: AsRef<[u8]>,
    E: Into<Box<dyn Error + Send + Sync>>,
{
    let io_error = |source| AnimationError::Io { path: path.to_path_buf(), source };
    let encode_error = |source| AnimationError::Encode { path: path.to_path_buf(), source };
    let frames = frames.into_iter();
    let count = match u32::try_from(frames.len()) {
        Ok(count) if count > 0 && fps > 0 => count,
        _ => {
            return Err(AnimationError::Timing { frames: frames.len(), fps });
        }
    };
    let mut file = AtomicFile::create_named(path)?;
    let mut encoder = encoder(&mut file, width, height, color).map_err(encode_error)?;
    encoder.set_animated(count, 0).map_err(encode_error)?;
    encoder.set_frame_delay(1, fps).map_err(encode_error)?;
    let mut writer = encoder.write_header().map_err(encode_error)?;
    let expected = u64::from(width) * u64::from(height) * color.samples() as u64;
    for (index, frame) in frames.enumerate() {
        let frame = frame.map_err(|error| AnimationError::Frame { index, source: error.into() })?;
        let bytes = frame.as_ref();
        if bytes.len() as u64 != expected {
            return Err(AnimationError::Size { index, got: bytes.len(), expected });
        }
        writer.write_image_data(bytes).map_err(encode_error)?;
    }
    writer.finish().map_err(encode_error)?;
    file.commit().map_err(io_error)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs::File;
    use std::io::BufReader;

    fn write_apng<I, F>(path: &Path, frames: I, width: u32, height: u32, fps: u16) -> Result<(), AnimationError>
    where
        I: IntoIterator<Item = F, IntoIter: ExactSizeIterator>,
        F: AsRef<[u8]>,
    {
        let frames = frames.into_iter().map(Ok::<F, io::Error>);
        try_write_apng(path, frames, (width, height), ColorType::Rgb, fps)
    }

    #[test]
    fn the_frames_decode_in_order_with_their_delay() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.png");
        let frame = |i: u8| (0..4 * 3 * 3).map(|b| b * 5 + i).collect::<Vec<u8>>();
        write_apng(&path, (0..3).map(frame), 4, 3, 25).unwrap();
        crate::files::check_file(&path).unwrap();
        let decoder = png::Decoder::new(BufReader::new(File::open(&path).unwrap()));
        let mut reader = decoder.read_info().unwrap();
        assert_eq!(reader.info().animation_control().unwrap().num_frames, 3);
        for i in 0..3 {
            let mut out = vec![0; 36];
            reader.next_frame(&mut out).unwrap();
            assert_eq!(out, frame(i));
            let control = reader.info().frame_control().unwrap();
            assert_eq!((control.delay_num, control.delay_den), (1, 25));
        }
    }

    #[test]
    fn a_wrong_or_failed_frame_leaves_no_file() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.png");
        let frames = [vec![0; 12], vec![0; 11]];
        let error = write_apng(&path, frames, 2, 2, 10).unwrap_err();
        assert!(error.to_string().contains("frame 1 holds 11 bytes"));
        let frames = [Ok(vec![0; 12]), Err("no camera")];
        let error = try_write_apng(&path, frames, (2, 2), ColorType::Rgb, 10).unwrap_err();
        assert_eq!(error.to_string(), "frame 1: no camera");
        assert!(write_apng(&path, [[0; 12]; 0], 2, 2, 10).is_err());
        assert!(write_apng(&path, [[0; 12]], 2, 2, 0).is_err());
        assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 0);
    }
}
