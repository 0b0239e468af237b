//! Studies: questions that are answered by many estimates. Plans cross masks, objects, settings and decoders to cells; a comparison scores
//! masks on the same test patches. Cells are stored in a folder as they come, so that an interruption loses no finished cell.

mod comparison;
mod drawing;
mod error;
mod image_quality;
mod machine;
mod markdown;
pub mod plans;
mod published;
mod published_psnr;
mod rank;

pub(crate) use comparison::STUDY_RECORD;
pub use comparison::{
    RankCorrelation, Study, StudyCell, StudyDesign, StudyEvent, StudyKind, StudyObjects, StudyRecord, StudySettings,
    StudyStep, StudySummary, WithinPublished,
};
pub use error::StudyError;
pub use machine::Machine;
pub use published::{Published, PublishedSet};
pub use rank::{pearson, spearman};
