//! Files that loaders read: within a memory limit, and never outside of the scene's folder.

use crate::SceneError;
use std::path::{Path, PathBuf};

/// Counts what loading will allocate against the user's limit, before it is allocated.
#[derive(Debug)]
pub(crate) struct Budget {
    /// The scene's file, for errors.
    path: PathBuf,
    limit: Option<u64>,
    used: u64,
}

impl Budget {
    pub fn new(path: &Path, limit: Option<u64>) -> Self {
        Self {
            path: path.to_path_buf(),
            limit,
            used: 0,
        }
    }

    /// Takes note that `bytes` more are about to be allocated.
    pub fn reserve(&mut self, bytes: u64) -> Result<(), SceneError> {
        self.used = self.used.saturating_add(bytes);
        match self.limit {
            Some(limit) if self.used > limit => Err(SceneError::Memory {
                path: self.path.clone(),
                needed: self.used,
                limit,
            }),
            _ => Ok(()),
        }
    }

    /// Bytes that may still be allocated; `None` without a limit.
    pub fn left(&self) -> Option<u64> {
        self.limit.map(|limit| limit.saturating_sub(self.used))
    }
}

/// The bytes of a file, taken from the budget first.
pub(crate) fn read_file(path: &Path, budget: &mut Budget) -> Result<Vec<u8>, SceneError> {
    let error = |source| SceneError::Read {
        path: path.to_path_buf(),
        source,
    };
    let facts = std::fs::metadata(path).map_err(error)?;
    if !facts.is_file() {
        return Err(error(std::io::Error::other("not a file")));
    }
    budget.reserve(facts.len())?;
    std::fs::read(path).map_err(error)
}

/// Whether a relative path, its parts separated by `/`, leads out of the folder that it starts in at any of its parts.
pub(crate) fn leaves_folder(relative: &str) -> bool {
    let mut depth = 0i64;
    relative.split('/').any(|part| {
        depth += match part {
            ".." => -1,
            "." | "" => 0,
            _ => 1,
        };
        depth < 0
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn folders_are_not_left() {
        for inside in ["a", "a/b", "./a", "a//b", "a/../b", "a/b/../../c", ""] {
            assert!(!leaves_folder(inside), "{inside}");
        }
        for outside in ["..", "../a", "a/../../b", "./..", "a/../..", "a/../../a/b"] {
            assert!(leaves_folder(outside), "{outside}");
        }
    }

    #[test]
    fn budgets_refuse_what_is_over_the_limit() {
        let mut budget = Budget::new(Path::new("x"), Some(10));
        assert!(budget.reserve(10).is_ok() && budget.left() == Some(0));
        assert!(budget.reserve(u64::MAX).is_err() && budget.left() == Some(0));
        let mut free = Budget::new(Path::new("x"), None);
        assert!(free.reserve(u64::MAX).is_ok() && free.left().is_none());
    }
}
