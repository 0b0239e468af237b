//! A folder with one file per document of one kind. The newest documents are listed.

use std::path::PathBuf;
use std::time::{SystemTime, UNIX_EPOCH};

use serde::de::DeserializeOwned;

use super::{DocumentKind, FormatError};

/// Extension of the files.
const ENDING: &str = "json";

/// The folder.
#[derive(Clone, Debug)]
pub struct DocumentFolder {
    /// Path of the folder.
    pub folder: PathBuf,
    /// Kind of the documents.
    pub kind: DocumentKind,
    /// Largest number of listed documents. Older ones stay in their files.
    pub most: usize,
}

/// Documents found in the folder.
#[derive(Debug)]
pub struct FoundDocuments<T> {
    /// The newest documents with the names of their files, oldest first.
    pub documents: Vec<(String, T)>,
    /// Number of unreadable files, which stay as they are.
    pub unreadable: usize,
    /// Number of files older than the listed ones.
    pub unlisted: usize,
}

impl DocumentFolder {
    /// Name of a new file. The order of names is the order of creation.
    pub fn new_name() -> String {
        let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        format!("{:024}-{}.{ENDING}", now.as_nanos(), std::process::id())
    }

    /// Reads the newest documents. Documents that `is_usable` refuses count as unreadable.
    ///
    /// # Errors
    /// Where the folder cannot be read.
    pub fn read<T: DeserializeOwned>(&self, is_usable: impl Fn(&T) -> bool) -> Result<FoundDocuments<T>, FormatError> {
        let entries = std::fs::read_dir(&self.folder).map_err(|error| FormatError::from_read(&self.folder, error))?;
        let mut files: Vec<PathBuf> = entries.filter_map(|entry| Some(entry.ok()?.path())).collect();
        files.retain(|file| file.extension().is_some_and(|ending| ending == ENDING));
        files.sort();
        let unlisted = files.len().saturating_sub(self.most);
        let listed = &files[unlisted..];
        let read = |path: &PathBuf| {
            let document = self.kind.read(path).ok().filter(&is_usable)?;
            Some((path.file_name()?.to_string_lossy().into_owned(), document))
        };
        let documents: Vec<(String, T)> = listed.iter().filter_map(read).collect();
        Ok(FoundDocuments { unreadable: listed.len() - documents.len(), documents, unlisted })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(serde::Deserialize)]
    struct Numbered {
        value: usize,
    }

    #[test]
    fn the_newest_are_listed_oldest_first_and_others_are_counted() {
        let folder = tempfile::tempdir().unwrap();
        let kind = DocumentKind::unmarked_before("lenslet-studio/test", "a test");
        let all = DocumentFolder { folder: folder.path().to_path_buf(), kind, most: 4 };
        let names: Vec<String> = (0..6).map(|_| DocumentFolder::new_name()).collect();
        assert!(names.is_sorted());
        for (index, name) in names.iter().enumerate() {
            kind.write(&folder.path().join(name), &std::collections::BTreeMap::from([("value", index)])).unwrap();
        }
        std::fs::write(folder.path().join(&names[3]), b"{").unwrap();
        std::fs::write(folder.path().join("other.deleted"), b"{}").unwrap();
        let found = all.read(|found: &Numbered| found.value != 4).unwrap();
        let values: Vec<usize> = found.documents.iter().map(|(_, found)| found.value).collect();
        assert_eq!((values, found.unreadable, found.unlisted), (vec![2, 5], 2, 2));
        assert_eq!(found.documents[0].0, names[2]);
        assert!(DocumentFolder { folder: folder.path().join("none"), ..all }.read(|_: &Numbered| true).is_err());
    }
}
