//! The causal density model behind the live and the full estimate: a tighter upper bound than the published one, in less
//! time.

mod best;
mod conditioning;
mod estimate;
mod first;
mod fit;
mod five_taps;
mod follow;
mod gradient;
mod head;
mod keep;
mod knots;
mod levels;
mod model;
mod network;
mod over;
mod predictor;
mod refit;
mod shape;
mod start;
mod stream;

pub use conditioning::Moments;
pub use estimate::{
    CausalRequest, causal_estimate, causal_model, information_map, information_map_unless, score, score_while,
};
pub use first::{FirstFitProgress, FirstScene, FirstWeights, OnFirstFit};
pub use fit::{CausalFit, FitLength};
pub use model::{CausalModel, check_causal_patch};
pub use over::information_over;
pub use refit::CausalRefit;
pub use shape::CausalShape;
pub use start::{Beginning, CausalStart};
pub use stream::{PatchBatch, PatchStream};
