//! Studies: one estimate for every cell of a table of objects, designs and patches. Cells are stored in a folder as they come, so that an
//! interruption loses no finished cell.

mod decoders;
mod drawing;
mod error;
mod machine;
mod markdown;
pub mod plans;
mod published;
mod rank;
mod record;
mod run;
mod settings;
mod summary;
mod tables;

pub use decoders::{
    Correlation, DecoderStudy, DecoderStudyCell, DecoderStudyEvent, DecoderStudyRecord, DecoderStudySettings,
    SensorInformation,
};
pub use error::StudyError;
pub use machine::Machine;
pub use published::{Published, PublishedSet};
pub use rank::{pearson, spearman};
pub use record::{StudyCell, StudyRecord};
pub(crate) use run::RECORD as STUDY_RECORD;
pub use run::{Study, StudyEvent, StudyStep};
pub use settings::{StudyDesign, StudyKind, StudyObjects, StudySettings};
pub use summary::{RankCorrelation, StudySummary, WithinPublished};

#[cfg(test)]
mod tests;
