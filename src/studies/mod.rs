//! Studies: questions that are answered by many estimates. Plans cross masks, objects and settings to cells; a comparison scores masks on
//! the same test patches; a study of decoders has image quality beside information. Cells are stored in a folder as they come, so that an
//! interruption loses no finished cell.

mod comparison;
mod decoders;
mod drawing;
mod error;
mod image_quality;
mod machine;
mod markdown;
pub mod plans;
mod published;
mod rank;

pub(crate) use comparison::STUDY_RECORD;
pub use comparison::{
    RankCorrelation, Study, StudyCell, StudyDesign, StudyEvent, StudyKind, StudyObjects, StudyRecord, StudySettings,
    StudyStep, StudySummary, WithinPublished,
};
pub use decoders::{
    Correlation, DecoderStudy, DecoderStudyCell, DecoderStudyEvent, DecoderStudyRecord, DecoderStudySettings,
    SensorInformation,
};
pub use error::StudyError;
pub use machine::Machine;
pub use published::{Published, PublishedSet};
pub use rank::{pearson, spearman};
