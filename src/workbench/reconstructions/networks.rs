//! The trained networks of a session, and which of them serves a design.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use crate::reconstruction::{DecoderKind, DecoderScene, ImagingModel, TrainedNetwork};

/// Most networks of a session; the oldest one is dropped.
const MOST: usize = 16;

/// A trained network of a session.
#[derive(Clone, Debug)]
pub struct KnownNetwork {
    /// The network.
    pub network: Arc<TrainedNetwork>,
    /// Number of the document that it was trained or opened for.
    pub document: u64,
    /// File that it was read from or last written to.
    pub path: Option<PathBuf>,
}

impl KnownNetwork {
    /// Whether it is in no file and needs one.
    fn is_unsaved(&self) -> bool {
        self.path.is_none() && !self.network.is_linear()
    }
}

/// The trained networks of a session. Clones share them.
#[derive(Clone, Debug, Default)]
pub struct Networks {
    /// The newest last.
    entries: Arc<Vec<KnownNetwork>>,
    serial: u64,
}

/// Which network serves a design.
#[derive(Clone, Debug)]
pub enum NetworkFit {
    /// There is no network.
    Missing,
    /// The newest network was trained for another mask.
    OtherMask,
    /// The newest network was trained for other objects, or for another light or noise.
    OtherScene,
    /// This network.
    Current(Arc<TrainedNetwork>),
}

impl NetworkFit {
    /// The decoder of a reconstruction: the linear one where no network serves the design.
    pub fn decoder(&self) -> DecoderKind {
        if matches!(self, Self::Current(_)) { DecoderKind::Network } else { DecoderKind::Linear }
    }
}

impl Networks {
    /// Adds a network.
    pub fn add(&mut self, known: KnownNetwork) {
        let entries = Arc::make_mut(&mut self.entries);
        if entries.len() >= MOST {
            entries.remove(0);
        }
        entries.push(known);
        self.serial += 1;
    }

    /// Notes the file of a network.
    pub fn note_file(&mut self, network: &Arc<TrainedNetwork>, path: &Path) {
        for known in Arc::make_mut(&mut self.entries) {
            if Arc::ptr_eq(&known.network, network) {
                known.path = Some(path.to_path_buf());
            }
        }
    }

    /// Number that changes with every new network.
    pub fn serial(&self) -> u64 {
        self.serial
    }

    /// The newest network of a document.
    pub fn of_document(&self, document: u64) -> Option<&Arc<TrainedNetwork>> {
        self.entries.iter().rev().find(|known| known.document == document).map(|known| &known.network)
    }

    /// Whether a network is in no file. One that is the linear estimate needs none.
    pub fn has_unsaved(&self) -> bool {
        self.entries.iter().any(KnownNetwork::is_unsaved)
    }

    /// The newest network of a document that is in no file.
    pub fn unsaved_of(&self, document: u64) -> Option<&Arc<TrainedNetwork>> {
        let unsaved = |known: &&KnownNetwork| known.document == document && known.is_unsaved();
        self.entries.iter().rev().find(unsaved).map(|known| &known.network)
    }

    /// File of a network.
    pub fn file_of(&self, network: &Arc<TrainedNetwork>) -> Option<&Path> {
        self.entries.iter().find(|known| Arc::ptr_eq(&known.network, network))?.path.as_deref()
    }

    /// The newest network that was trained for this scene, and for this mask or any; otherwise what the newest one was trained for.
    pub fn fit(&self, scene: &DecoderScene, model: &ImagingModel) -> NetworkFit {
        let fits = self.entries.iter().rev().map(|known| {
            let training = &known.network.training;
            match (training.check_scene(scene), training.check_mask(model)) {
                (Err(_), _) => NetworkFit::OtherScene,
                (Ok(()), Err(_)) => NetworkFit::OtherMask,
                (Ok(()), Ok(())) => NetworkFit::Current(Arc::clone(&known.network)),
            }
        });
        let mut newest = None;
        for fit in fits {
            if matches!(fit, NetworkFit::Current(_)) {
                return fit;
            }
            newest.get_or_insert(fit);
        }
        newest.unwrap_or(NetworkFit::Missing)
    }
}
