//! Files of estimates. Finished estimates outlive the window; the running one and those that wait resume in the next window.

use std::fs::File;
use std::path::PathBuf;
use std::sync::Arc;

use serde::{Deserialize, Serialize};

use crate::evaluation::measured::MeasuredOrder;
use crate::evaluation::progress::FitPoint;
use crate::evaluation::request::EstimateRequest;
use crate::formats::{DocumentFolder, DocumentKind, FormatError, Listed, create_folder, lock_folder};
use crate::forward::Design;
use crate::information::{Estimate, NUMBERS_VERSION};
use crate::optics::MASK_DOCUMENT_VERSION;
use crate::workbench::live::published::{Live, is_estimate_of};

/// An ordered estimate.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct EstimateOrder {
    /// The design at the time of the order.
    pub design: Arc<Design>,
    /// Its revision; revisions of earlier sessions are not used.
    #[serde(skip)]
    pub revision: u64,
    /// Request of the estimate.
    pub request: EstimateRequest,
    /// Images of a camera in place of the design's measurements; the design then gives only noise and seed.
    pub measured: Option<MeasuredOrder>,
}

impl EstimateOrder {
    /// Whether a checkpoint of this order applies to the other.
    fn is_same(&self, other: &Self) -> bool {
        self.design == other.design && self.measured == other.measured && self.request == other.request
    }

    /// The same order with absolute paths, for a program that is started in another folder.
    fn absolute(&self) -> Self {
        let design = Design { objects: self.design.objects.absolute(), ..Design::clone(&self.design) };
        let measured = self.measured.as_ref().map(MeasuredOrder::absolute);
        Self { design: Arc::new(design), measured, ..self.clone() }
    }

    /// Name of the order, for people.
    pub(crate) fn name(&self) -> String {
        let of = match &self.measured {
            Some(measured) => measured.source.to_string(),
            None => self.design.encoder.describe(),
        };
        format!("Estimate ({}) of {of}", self.request.model.estimator())
    }
}

/// A finished order with the curves of its fits.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct FinishedEstimate {
    /// Version of the program's numbers.
    program_version: String,
    /// The order.
    pub order: EstimateOrder,
    /// The result.
    pub estimate: Estimate,
    /// Curves of the fits, oldest first.
    pub curve: Vec<FitPoint>,
    /// Name of its file, if it has one.
    #[serde(skip)]
    file: Option<String>,
}

impl FinishedEstimate {
    /// A finished estimate by this version of the program.
    pub(crate) fn new(order: EstimateOrder, estimate: Estimate, mut curve: Vec<FitPoint>) -> Self {
        curve.retain(|point| point.bits.is_finite());
        Self { program_version: NUMBERS_VERSION.into(), order, estimate, curve, file: None }
    }

    /// Whether this version of the program would compute the same.
    pub fn is_of_this_version(&self) -> bool {
        self.program_version == NUMBERS_VERSION
    }

    /// Whether the estimate is of this design, in any revision, and of its objects as they were read last.
    pub fn is_of(&self, design: &Arc<Design>, live: &Live) -> bool {
        self.order.measured.is_none()
            && self.is_of_this_version()
            && is_estimate_of(&self.estimate, &self.order.design, design, live)
    }
}

/// Folder with a file for each finished estimate, the running order and the waiting ones.
#[derive(Clone, Debug)]
pub(crate) struct EstimateFolder {
    folder: PathBuf,
    /// Held so that no other program resumes the running order; none where another program holds it, and where a newer version wrote it.
    lock: Option<Arc<Option<File>>>,
}

/// The kinds of the files.
const FINISHED: DocumentKind = DocumentKind::unmarked_before("lenslet-studio/finished-estimate", "a finished estimate")
    .at_version(MASK_DOCUMENT_VERSION);
const PENDING: DocumentKind =
    DocumentKind::unmarked_before("lenslet-studio/pending-estimate", "an estimate in progress")
        .at_version(MASK_DOCUMENT_VERSION);
const WAITING_ORDERS: DocumentKind =
    DocumentKind::unmarked_before("lenslet-studio/waiting-estimates", "a list of waiting estimates")
        .at_version(MASK_DOCUMENT_VERSION);

/// The kind in the version that holds the masks of the orders.
fn written(kind: DocumentKind, orders: &[EstimateOrder]) -> DocumentKind {
    kind.at_version(orders.iter().map(|order| order.design.document_version()).max().unwrap_or(1))
}

/// The waiting orders, as their file holds them.
#[derive(Serialize)]
struct Waiting {
    entries: Vec<EstimateOrder>,
}

/// An order that was running when the last program ended.
pub(crate) struct InterruptedOrder {
    pub order: EstimateOrder,
    /// Why it is given up, if it is.
    pub given_up: Option<String>,
}

/// The running order, as its file holds it.
#[derive(Serialize, Deserialize)]
struct Pending {
    program_version: String,
    /// Number of successive programs that ended during the order without being closed.
    crashes: usize,
    order: EstimateOrder,
}

impl EstimateFolder {
    /// Most estimates that are read; older ones stay in their files.
    const MOST: usize = 100;
    /// Number of crashes after which an order is given up, because it may cause them.
    const MOST_CRASHES: usize = 3;

    /// Opens an existing folder.
    pub fn open(folder: PathBuf) -> Self {
        let lock = lock_folder(&folder).ok().map(Arc::new);
        let mut found = Self { folder, lock };
        if PENDING.is_newer(&found.pending().join(ORDER)) || WAITING_ORDERS.is_newer(&found.folder.join(WAITING)) {
            // The orders are left for the newer program that wrote them.
            found.lock = None;
        }
        found
    }

    /// Reads the newest finished estimates, oldest first. Unreadable files stay unchanged.
    pub fn read(&self) -> Vec<FinishedEstimate> {
        let is_deleted = |file: &PathBuf| file.extension().is_some_and(|ending| ending == DELETED);
        let entries = std::fs::read_dir(&self.folder).into_iter().flatten();
        let deleted = entries.filter_map(|entry| Some(entry.ok()?.path())).filter(is_deleted);
        for file in deleted.filter(|_| self.lock.is_some()) {
            // A file that cannot be removed goes the next time.
            let _ = std::fs::remove_file(file);
        }
        let documents = DocumentFolder { folder: self.folder.clone(), kind: FINISHED, most: Self::MOST };
        let found = documents.read(|estimate: &FinishedEstimate| estimate.order.design.check().is_ok());
        let found = found.map(|found| found.documents).unwrap_or_default();
        found.into_iter().map(|(file, estimate)| FinishedEstimate { file: Some(file), ..estimate }).collect()
    }

    /// Writes an estimate into a file of its own.
    ///
    /// # Errors
    /// Where the file cannot be written.
    pub fn keep(&self, estimate: &mut FinishedEstimate) -> Result<(), FormatError> {
        let name = DocumentFolder::new_name();
        written(FINISHED, std::slice::from_ref(&estimate.order)).write(&self.folder.join(&name), estimate)?;
        estimate.file = Some(name);
        Ok(())
    }

    /// Deletes the file of an estimate; it can be brought back until the folder is opened the next time.
    pub fn delete(&self, estimate: &FinishedEstimate) {
        if let Some((file, deleted)) = self.files_of(estimate) {
            // The file may already be gone.
            let _ = std::fs::rename(file, deleted);
        }
    }

    /// Restores the file of a deleted estimate.
    pub fn bring_back(&self, estimate: &FinishedEstimate) {
        if let Some((file, deleted)) = self.files_of(estimate) {
            // Without a file the estimate lasts as long as the window.
            let _ = std::fs::rename(deleted, file);
        }
    }

    /// The file of an estimate, and its name after deletion.
    fn files_of(&self, estimate: &FinishedEstimate) -> Option<(PathBuf, PathBuf)> {
        let file = self.folder.join(estimate.file.as_ref()?);
        let deleted = file.with_extension(DELETED);
        Some((file, deleted))
    }

    /// Whether the next session can resume the running order.
    pub fn keeps_orders(&self) -> bool {
        self.lock.is_some()
    }

    fn pending(&self) -> PathBuf {
        self.folder.join("pending")
    }

    /// Notes that an order is running. Returns its checkpoint file, where there can be one.
    pub fn begin(&self, order: &EstimateOrder) -> Option<PathBuf> {
        self.lock.as_ref()?;
        let order = order.absolute();
        let earlier = self.read_pending();
        if earlier.as_ref().is_some_and(|earlier| !earlier.order.is_same(&order)) {
            // The folder of another order that failed.
            self.end();
        }
        let folder = self.pending();
        create_folder(&folder).ok()?;
        let crashes = earlier.map_or(0, |pending| pending.crashes);
        self.write_pending(&Pending { program_version: NUMBERS_VERSION.into(), crashes, order })?;
        Some(folder.join(STATE))
    }

    fn read_pending(&self) -> Option<Pending> {
        PENDING.read(&self.pending().join(ORDER)).ok()
    }

    fn write_pending(&self, pending: &Pending) -> Option<()> {
        written(PENDING, std::slice::from_ref(&pending.order)).write(&self.pending().join(ORDER), pending).ok()
    }

    /// Notes the waiting orders.
    pub fn note_waiting(&self, orders: &[EstimateOrder]) {
        if self.lock.is_none() {
            return;
        }
        let file = self.folder.join(WAITING);
        // Orders that cannot be written last as long as the window.
        if orders.is_empty() {
            let _ = std::fs::remove_file(file);
        } else {
            let entries: Vec<EstimateOrder> = orders.iter().map(EstimateOrder::absolute).collect();
            let _ = written(WAITING_ORDERS, &entries).write(&file, &Waiting { entries });
        }
    }

    /// The waiting orders of the last session.
    pub fn waiting(&self) -> Vec<EstimateOrder> {
        let read = |_| WAITING_ORDERS.read::<Listed<EstimateOrder>>(&self.folder.join(WAITING)).ok();
        let orders = self.lock.as_ref().and_then(read).map(Listed::into_entries).unwrap_or_default();
        orders.into_iter().filter(|order| order.design.check().is_ok()).collect()
    }

    /// Notes that the running order is postponed, because the program is closed or a file is missing.
    pub fn leave(&self) {
        if let Some(pending) = self.lock.as_ref().and_then(|_| self.read_pending()) {
            // Otherwise it counts as a crash.
            self.write_pending(&Pending { crashes: 0, ..pending });
        }
    }

    /// Notes that no order is running.
    pub fn end(&self) {
        if self.lock.is_some() {
            // A folder that cannot be removed is replaced by the next order.
            let _ = std::fs::remove_dir_all(self.pending());
        }
    }

    /// The order that was running when the last program ended. Checkpoints of another version are of no use.
    pub fn interrupted(&self) -> Option<InterruptedOrder> {
        self.lock.as_ref()?;
        let Pending { program_version, crashes, order } = self.read_pending()?;
        let crashes = crashes + 1;
        let given_up = match order.design.check() {
            Err(error) => Some(error.to_string()),
            Ok(()) if crashes > Self::MOST_CRASHES => {
                Some(format!("the program has ended in the midst of it {crashes} times; start it again if you like"))
            }
            Ok(()) => None,
        };
        if given_up.is_some() || program_version != NUMBERS_VERSION {
            self.end();
        } else {
            self.write_pending(&Pending { program_version, crashes, order: order.clone() });
        }
        Some(InterruptedOrder { order, given_up })
    }
}

/// Files of the running order: the order, and its checkpoint.
const ORDER: &str = "order.json";
const STATE: &str = "state";
/// File of the waiting orders. Its ending differs from that of finished estimates.
const WAITING: &str = "waiting";
/// Ending of the files of estimates that were deleted.
const DELETED: &str = "deleted";
