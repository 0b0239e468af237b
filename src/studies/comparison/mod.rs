//! Comparison of masks on the same test patches, which ends an optimizer run: one estimate for every cell of a table of objects, designs
//! and patches. Its file is `study.json`, as earlier versions wrote all studies into such files.

mod record;
mod run;
mod settings;
mod summary;
mod tables;

pub use record::{StudyCell, StudyRecord};
pub(crate) use run::RECORD as STUDY_RECORD;
pub use run::{Study, StudyEvent, StudyStep};
pub use settings::{StudyDesign, StudyKind, StudyObjects, StudySettings};
pub use summary::{RankCorrelation, StudySummary, WithinPublished};

#[cfg(test)]
mod tests;
