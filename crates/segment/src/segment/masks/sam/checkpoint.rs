//! Locates the weights file. Nothing is downloaded or read here.

use super::SamError;
use std::ffi::OsString;
use std::path::{Path, PathBuf};

/// Name of the weights file in the cache folder.
pub const FILE_NAME: &str = "mobile_sam.safetensors";
/// The published checkpoint that the weights are converted from.
pub const SOURCE: &str =
    "mobile_sam.pt (Apache-2.0, https://github.com/ChaoningZhang/MobileSAM, weights/mobile_sam.pt)";
/// The conversion as a shell command; needs the Python packages torch and safetensors.
pub const CONVERT: &str = "python -c \"import torch, safetensors.torch as s; \
    w = torch.load('mobile_sam.pt', map_location='cpu', weights_only=True); \
    s.save_file({k: v.float().contiguous() for k, v in w.items()}, 'mobile_sam.safetensors')\"";

/// The weights file: `explicit` if given, else `volseggs/mobile_sam.safetensors` in `$XDG_CACHE_HOME` or `~/.cache`.
///
/// # Errors
/// [`SamError::NoCheckpoint`] naming the places, if no such file exists.
pub fn locate(explicit: Option<&Path>) -> Result<PathBuf, SamError> {
    locate_in(explicit, std::env::var_os("XDG_CACHE_HOME"), std::env::var_os("HOME"))
}

fn locate_in(explicit: Option<&Path>, cache: Option<OsString>, home: Option<OsString>) -> Result<PathBuf, SamError> {
    let looked = match explicit {
        // an explicit path is not silently replaced by another
        Some(path) => vec![path.to_path_buf()],
        None => {
            // the XDG specification requires relative paths to be ignored
            let cache = cache.map(PathBuf::from).filter(|p| p.is_absolute());
            let folder = cache.or_else(|| home.filter(|h| !h.is_empty()).map(|h| Path::new(&h).join(".cache")));
            folder.into_iter().map(|f| f.join("volseggs").join(FILE_NAME)).collect()
        }
    };
    match looked.iter().find(|p| p.is_file()) {
        Some(path) => Ok(path.clone()),
        None => Err(SamError::NoCheckpoint { looked }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_cache_folder_is_looked_through() {
        let dir = tempfile::tempdir().unwrap();
        let home = dir.path().join("home");
        let xdg = dir.path().join("xdg");
        let find = |cache: Option<&Path>| locate_in(None, cache.map(Into::into), Some(home.clone().into()));
        let error = find(Some(&xdg)).unwrap_err().to_string();
        assert!(error.contains(&xdg.join("volseggs/mobile_sam.safetensors").display().to_string()), "{error}");
        for part in ["--sam-weights", "mobile_sam.pt", "Apache-2.0", "ChaoningZhang/MobileSAM", "save_file"] {
            assert!(error.contains(part), "{part}: {error}");
        }
        let place = |folder: &Path| {
            let folder = folder.join("volseggs");
            std::fs::create_dir_all(&folder).unwrap();
            std::fs::write(folder.join(FILE_NAME), b"").unwrap();
            folder.join(FILE_NAME)
        };
        let in_home = place(&home.join(".cache"));
        assert_eq!(find(None).unwrap(), in_home);
        assert_eq!(find(Some(Path::new("relative"))).unwrap(), in_home);
        assert!(find(Some(&xdg)).is_err());
        let in_xdg = place(&xdg);
        assert_eq!(find(Some(&xdg)).unwrap(), in_xdg);
    }

    #[test]
    fn a_path_asked_for_is_not_replaced() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("my.safetensors");
        let error = locate_in(Some(&path), None, None).unwrap_err();
        assert!(matches!(&error, SamError::NoCheckpoint { looked } if *looked == [path.clone()]), "{error}");
        // a folder of that name is no checkpoint
        assert!(locate_in(Some(dir.path()), None, None).is_err());
        std::fs::write(&path, b"").unwrap();
        assert_eq!(locate_in(Some(&path), None, None).unwrap(), path);
    }
}
