//! Snapshots: designs that were put aside for comparison, with their numbers.

mod numbers;
mod table;

use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};

use ndarray::{Array2, Axis};
use serde::{Deserialize, Serialize};

use crate::evaluation::scene::Optics;
use crate::formats::{DocumentFolder, DocumentKind, FileContent, FormatError, create_folder};
use crate::forward::{Design, is_published_field, is_usual_placement};
use crate::information::NUMBERS_VERSION;
use crate::objects::ObjectSource;
use crate::optics::MASK_DOCUMENT_VERSION;
use crate::plural::counted;

pub use numbers::{Bits, LiveResults, SnapshotNumbers, SnapshotReconstruction};

/// Least time between two writings of changed numbers.
const WRITE_EVERY: Duration = Duration::from_secs(3);

/// What a file of a snapshot does not hold yet.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Change {
    None,
    /// Numbers, which keep improving.
    Numbers,
    /// The work of a person, which is written at once.
    Deed,
}

/// A design that was put aside.
#[derive(Clone)]
pub struct Snapshot {
    /// Identifies the snapshot, also among deleted ones.
    pub number: u64,
    /// Name for people.
    pub name: String,
    /// The design.
    pub design: Arc<Design>,
    /// Scene of its numbers: all that they depend on beside the mask. Designs with different scenes are not comparable.
    pub scene: String,
    /// Its revision, if it was open in this window; while it is open, its numbers keep improving.
    revision: Option<u64>,
    /// Name of its file.
    file: String,
    changed: Change,
    /// Whether its PSF was rendered for the snapshot.
    drawn: bool,
    /// Whether its measurement was requested.
    asked: bool,
    /// PSF and transfer function.
    pub optics: Option<Arc<Optics>>,
    /// The first of its live measurements, with noise, photons per pixel, shape (rows, cols); or why there is none.
    pub measurement: Option<Result<Array2<f32>, String>>,
    /// Its numbers.
    pub numbers: SnapshotNumbers,
}

/// Snapshots that were found in a folder.
pub struct FoundSnapshots {
    /// The newest ones.
    pub snapshots: Snapshots,
    /// Number of files that could not be read.
    pub unreadable: usize,
    /// Number of older ones that exceed the list.
    pub unlisted: usize,
}

/// Summary of objects, light, noise and seed of a design.
fn scene_of(design: &Design) -> String {
    let Design { objects, mean_photons, bias_photons, noise, seed, field, placement, .. } = design;
    let light = if objects.has_mean() { format!(", mean {}", counted(*mean_photons, "photon")) } else { String::new() };
    let size = if is_published_field(field) { String::new() } else { format!(", {} x {} px", field.0, field.1) };
    let placed = if is_usual_placement(placement) { String::new() } else { format!(", {placement}") };
    format!(
        "{objects}{size}{placed}{light}, background {}, {noise} noise, seed {seed}",
        counted(*bias_photons, "photon")
    )
}

impl Snapshot {
    /// The smallest of its upper bounds.
    pub fn upper(&self) -> Option<Bits> {
        let SnapshotNumbers { gaussian, ceiling, live, sampled, bracket, fitted, .. } = self.numbers;
        // The object-entropy bound uses no samples.
        let ceiling = ceiling.map(|bits| Bits { bits, interval_95: [bits; 2] });
        let gaussian = gaussian.filter(|_| self.gaussian_is_bound());
        let bracket = bracket.map(|bracket| bracket[1]);
        let known = [live.map(|live| live.0), gaussian, ceiling, sampled, bracket, fitted];
        known.into_iter().flatten().min_by(|one, other| one.bits.total_cmp(&other.bits))
    }

    /// Whether the Gaussian number is a bound. Numbers of earlier versions do not say so; files of images may hold whole images.
    pub fn gaussian_is_bound(&self) -> bool {
        let whole = matches!(self.design.objects, ObjectSource::Images(_) | ObjectSource::Stack(_));
        self.numbers.gaussian_is_bound.unwrap_or(!whole)
    }

    /// Whether its measurement is missing and was not requested yet.
    pub fn wants_measurement(&mut self) -> bool {
        let wants = self.measurement.is_none() && !self.asked;
        self.asked |= wants;
        wants
    }

    /// Clears the reason for a missing measurement, so that it is requested again.
    pub fn forget_failed_measurement(&mut self) {
        if self.measurement.take_if(|measured| measured.is_err()).is_some() {
            self.asked = false;
        }
    }

    fn take_up(&mut self, results: LiveResults<'_>) {
        let Some(revision) = self.revision else { return };
        let before = self.numbers.clone();
        self.sync_numbers(revision, results);
        if self.numbers != before {
            self.changed = self.changed.max(Change::Numbers);
        }
    }

    /// Renders the PSF of a snapshot of an earlier session, once. Returns whether there was anything to render. It takes milliseconds, or
    /// more for large images, so a frame should render one.
    pub fn draw(&mut self) -> bool {
        if self.drawn || self.optics.is_some() {
            return false;
        }
        self.drawn = true;
        let planes = if let ObjectSource::Volume { planes, .. } = self.design.objects { planes } else { 1 };
        // A design that cannot be rendered shows no image; opening it gives the reason.
        self.optics = Optics::of(&self.design, planes).ok().map(Arc::new);
        true
    }

    /// Sets another name.
    pub fn rename(&mut self, name: String) {
        if self.name != name {
            self.changed = Change::Deed;
        }
        self.name = name;
    }

    /// Notes that it is now the open design, of this revision.
    pub fn is_open_as(&mut self, revision: u64) {
        self.revision = Some(revision);
    }

    fn sync_numbers(&mut self, revision: u64, results: LiveResults<'_>) {
        let live = results.live;
        if let Some(optics) = live.optics.as_ref().filter(|optics| optics.revision == revision) {
            self.optics = Some(Arc::clone(&optics.value));
        }
        if let Some(scene) = live.scene.as_ref().filter(|scene| scene.revision == revision)
            && self.numbers.are_of(scene.value.set.fingerprint())
        {
            self.measurement = None;
        }
        if let Some(measurements) = live.measurements.as_ref().filter(|measured| measured.revision == revision)
            && self.measurement.is_none()
        {
            self.measurement = Some(Ok(measurements.value.noisy.index_axis(Axis(0), 0).to_owned()));
        }
        self.numbers.take_up((&self.design, revision), results);
    }
}

/// The kind of the files.
const SNAPSHOT: DocumentKind = DocumentKind::unmarked_before("lenslet-studio/snapshot", "a snapshot of a design")
    .at_version(MASK_DOCUMENT_VERSION);

/// A snapshot as its file holds it.
#[derive(Serialize, Deserialize)]
struct Kept {
    name: String,
    design: Arc<Design>,
    /// Version of the program's numbers.
    #[serde(default)]
    program_version: String,
    /// [`SnapshotNumbers`]; those of another version are left out, and are computed again when the design is opened.
    #[serde(flatten)]
    numbers: serde_json::Value,
}

/// All snapshots, oldest first.
#[derive(Default)]
pub struct Snapshots {
    /// The snapshots.
    pub entries: Vec<Snapshot>,
    last: u64,
    /// Files of deleted snapshots.
    deleted: Vec<String>,
    /// The snapshot that was deleted last, and its place.
    gone: Option<(usize, Snapshot)>,
    /// Time of the last writing of files.
    written: Option<Instant>,
}

/// Change of a file, by its name: its new content, or none where it is to be removed. The content is made outside the window's thread,
/// because masks that are images have millions of numbers.
pub type FileChange = (String, Option<FileContent>);

impl Snapshots {
    /// Most snapshots that are kept.
    const MOST: usize = 200;

    /// Adds a snapshot of the open design.
    ///
    /// # Errors
    /// One sentence where there are too many snapshots.
    pub fn keep(&mut self, design: &Arc<Design>, revision: u64, results: LiveResults<'_>) -> Result<(), String> {
        if self.entries.len() >= Self::MOST {
            return Err(format!("{} designs are put aside; delete some before you keep another", Self::MOST));
        }
        self.last += 1;
        let mut snapshot = Snapshot {
            number: self.last,
            name: format!("Design {}", self.last),
            design: Arc::clone(design),
            scene: scene_of(design),
            revision: Some(revision),
            file: DocumentFolder::new_name(),
            changed: Change::Deed,
            drawn: false,
            asked: false,
            optics: None,
            measurement: None,
            numbers: SnapshotNumbers::default(),
        };
        snapshot.take_up(results);
        self.entries.push(snapshot);
        Ok(())
    }

    /// Reads the newest snapshots of a folder, by this program or another.
    ///
    /// # Errors
    /// Where the folder cannot be created.
    pub fn read(folder: &Path) -> Result<FoundSnapshots, FormatError> {
        create_folder(folder)?;
        let documents = DocumentFolder { folder: folder.to_owned(), kind: SNAPSHOT, most: Self::MOST };
        let found = documents.read(|kept: &Kept| kept.design.check_entries().is_ok())?;
        let mut all = Self::default();
        for (file, Kept { name, design, program_version, numbers }) in found.documents {
            all.last += 1;
            let numbers = Some(numbers).filter(|_| program_version == NUMBERS_VERSION);
            let numbers = numbers.and_then(|numbers| serde_json::from_value(numbers).ok()).unwrap_or_default();
            all.entries.push(Snapshot {
                number: all.last,
                name,
                scene: scene_of(&design),
                design,
                revision: None,
                file,
                changed: Change::None,
                drawn: false,
                asked: false,
                optics: None,
                measurement: None,
                numbers,
            });
        }
        Ok(FoundSnapshots { snapshots: all, unreadable: found.unreadable, unlisted: found.unlisted })
    }

    /// Deletes a snapshot and its file; it can be [brought back](Snapshots::bring_back).
    pub fn delete(&mut self, number: u64) {
        let Some(place) = self.entries.iter().position(|snapshot| snapshot.number == number) else { return };
        let snapshot = self.entries.remove(place);
        self.deleted.push(snapshot.file.clone());
        self.gone = Some((place, snapshot));
    }

    /// Name of the snapshot that was deleted last and can be brought back.
    pub fn gone(&self) -> Option<&str> {
        self.gone.as_ref().filter(|_| self.entries.len() < Self::MOST).map(|(_, snapshot)| snapshot.name.as_str())
    }

    /// Restores the snapshot that was deleted last to its place.
    pub fn bring_back(&mut self) {
        let Some((place, mut snapshot)) = self.gone.take() else { return };
        self.deleted.retain(|file| *file != snapshot.file);
        snapshot.changed = Change::Deed;
        self.entries.insert(place.min(self.entries.len()), snapshot);
    }

    /// Time until changes have to be written; none where there are none. Changed numbers wait for the next writing, a few seconds after
    /// the last one.
    pub fn due(&self, now: Instant) -> Option<Duration> {
        let change = self.entries.iter().map(|snapshot| snapshot.changed).max().unwrap_or(Change::None);
        let paced = self.written.map_or(Duration::ZERO, |at| (at + WRITE_EVERY).saturating_duration_since(now));
        match change {
            _ if !self.deleted.is_empty() => Some(Duration::ZERO),
            Change::Deed => Some(Duration::ZERO),
            Change::Numbers => Some(paced),
            Change::None => None,
        }
    }

    /// Returns the file changes since the last call, where they are [due](Self::due) or `at_once`.
    pub fn changes(&mut self, now: Instant, at_once: bool) -> Vec<FileChange> {
        if !at_once && self.due(now) != Some(Duration::ZERO) {
            return Vec::new();
        }
        let mut changes: Vec<FileChange> =
            std::mem::take(&mut self.deleted).into_iter().map(|file| (file, None)).collect();
        for snapshot in self.entries.iter_mut().filter(|snapshot| snapshot.changed > Change::None) {
            snapshot.changed = Change::None;
            let (name, design, numbers) =
                (snapshot.name.clone(), Arc::clone(&snapshot.design), snapshot.numbers.clone());
            let text = move || {
                let numbers = serde_json::to_value(numbers).ok()?;
                let program_version = NUMBERS_VERSION.to_owned();
                let kind = SNAPSHOT.at_version(design.document_version());
                serde_json::to_vec(&kind.marked(&Kept { name, design, program_version, numbers })).ok()
            };
            changes.push((snapshot.file.clone(), Some(Box::new(text))));
        }
        if !changes.is_empty() {
            self.written = Some(now);
        }
        changes
    }

    /// Updates the numbers of snapshots that are still open.
    pub fn take_up(&mut self, results: LiveResults<'_>) {
        self.entries.iter_mut().for_each(|snapshot| snapshot.take_up(results));
    }

    /// The snapshot of this number.
    pub fn get(&self, number: u64) -> Option<&Snapshot> {
        self.entries.iter().find(|snapshot| snapshot.number == number)
    }

    /// The scenes of the snapshots, each once, in the order of the designs.
    pub fn scenes(&self) -> Vec<&str> {
        let mut scenes = Vec::new();
        for snapshot in &self.entries {
            if !scenes.contains(&snapshot.scene.as_str()) {
                scenes.push(snapshot.scene.as_str());
            }
        }
        scenes
    }

    /// Stores a requested measurement.
    pub fn set_measurement(&mut self, number: u64, measurement: Result<Array2<f32>, String>) {
        if let Some(snapshot) = self.entries.iter_mut().find(|snapshot| snapshot.number == number) {
            snapshot.measurement = Some(measurement);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn deeds_are_written_at_once_and_numbers_every_few_seconds() {
        let mut snapshots = Snapshots::default();
        let start = Instant::now();
        assert_eq!(snapshots.due(start), None);
        for count in 1..=2 {
            let (live, estimates, reconstructions) = Default::default();
            let results = LiveResults { live: &live, estimates: &estimates, reconstructions: &reconstructions };
            snapshots.keep(&Arc::new(Design::default()), 1, results).unwrap();
            assert_eq!((snapshots.changes(start, false).len(), snapshots.entries.len()), (1, count));
        }
        assert_eq!(snapshots.due(start), None);
        snapshots.entries[1].changed = Change::Numbers;
        let second = Duration::from_secs(1);
        assert_eq!(snapshots.due(start + second), WRITE_EVERY.checked_sub(second));
        assert!(snapshots.changes(start + second, false).is_empty());
        assert_eq!(snapshots.changes(start + WRITE_EVERY, false).len(), 1);
        snapshots.entries[0].rename("mine".into());
        assert_eq!(snapshots.changes(start + WRITE_EVERY, false).len(), 1);
        let number = snapshots.entries[0].number;
        snapshots.delete(number);
        let deleted = snapshots.changes(start + WRITE_EVERY, false);
        assert!(deleted.len() == 1 && deleted[0].1.is_none());
        snapshots.bring_back();
        snapshots.entries[1].changed = Change::Numbers;
        assert_eq!(snapshots.changes(start + WRITE_EVERY, false).len(), 2, "numbers go with it");
    }

    #[test]
    fn of_too_many_files_the_newest_are_listed() {
        let folder = tempfile::tempdir().unwrap();
        for number in 0..Snapshots::MOST + 3 {
            let kept = serde_json::json!({ "name": format!("Design {number}"), "design": Design::default() });
            let text = if number == 50 { "{".to_owned() } else { kept.to_string() };
            std::fs::write(folder.path().join(format!("{number:04}.json")), text).unwrap();
        }
        let FoundSnapshots { snapshots, unreadable, unlisted } = Snapshots::read(folder.path()).unwrap();
        assert_eq!((unreadable, unlisted), (1, 3), "one is broken, three are older");
        let names: Vec<&str> = snapshots.entries.iter().map(|kept| kept.name.as_str()).collect();
        assert_eq!((names.len(), names[0], names[names.len() - 1]), (Snapshots::MOST - 1, "Design 3", "Design 202"));
    }
}
