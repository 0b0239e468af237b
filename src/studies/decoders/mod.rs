//! The study of decoders: does the information of a mask predict what a decoder makes of its measurements?
//!
//! For each set of objects and each layout there is one cell with the information of the whole sensor, and one for each decoder with the
//! image quality of its reconstructions, in the same light. Cells are stored as they come.

mod plot;
mod published;
mod record;
mod report;
mod run;
mod settings;

pub(super) use published::published_psnr_db;
pub use record::{Correlation, DecoderStudyCell, DecoderStudyRecord, SensorInformation};
pub use run::{DecoderStudy, DecoderStudyEvent};
pub use settings::DecoderStudySettings;
