//! Where results are kept that many runs can use.

use std::path::PathBuf;

/// What `--cache` says.
pub fn parse(text: &str) -> Result<Cache, String> {
    match text {
        "" => Err("an empty name: give a folder, or off".into()),
        "off" => Ok(Cache(None)),
        folder => Ok(Cache(Some(folder.into()))),
    }
}

/// A folder, or nowhere.
#[derive(Debug, Clone)]
pub struct Cache(pub Option<PathBuf>);

/// The folder `occlude` in the place that the system has for such files; `None` if it has none.
pub fn default_folder() -> Option<PathBuf> {
    let variable = |name: &str| {
        let value = PathBuf::from(std::env::var_os(name)?);
        value.is_absolute().then_some(value)
    };
    let base = if cfg!(windows) {
        variable("LOCALAPPDATA")
    } else if cfg!(target_vendor = "apple") {
        variable("HOME").map(|home| home.join("Library/Caches"))
    } else {
        variable("XDG_CACHE_HOME").or_else(|| variable("HOME").map(|home| home.join(".cache")))
    };
    base.map(|base| base.join("occlude"))
}
