//! Seeds that are derived from the one seed of a design, a run or a fit: one stream for each purpose.

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Purpose of a derived seed.
///
/// The numbers of the streams are part of every reproducible number: they never change. Streams with one number belong to
/// different parents, so that no two purposes of one computation share a seed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SeedStream {
    /// Order in which imported measurements are split.
    MeasuredOrder,
    /// Patches that a model of one estimate is fitted to.
    TrainingPatches,
    /// Held-out objects of an optimizer run.
    HeldOutObjects,
    /// Noise of the patches of one draw.
    PatchNoise,
    /// Standard normal numbers of a reparameterised gradient.
    GradientNoise,
    /// Patches that an estimate is tested on.
    TestPatches,
    /// Patches that a density model of an optimizer run takes its data scale from.
    ScalePatches,
    /// Places of the held-out patches of an optimizer run.
    HeldOutPlaces,
    /// Weights and fits of the live estimate.
    LiveFit,
    /// Noise of the held-out patches of an optimizer run.
    HeldOutNoise,
    /// Patches of one causal fit, and those that validate it.
    CausalFit,
    /// Decoder of one estimate.
    Decoder,
    /// Noise of the measurements that the Tamura coefficient of a run is taken from.
    TamuraNoise,
    /// Test patches of the live estimate beyond the first ones.
    MoreTestPatches,
    /// Scenes of the lower bound of an optimizer run.
    RunLowerBound,
    /// Patches that the live estimate is fitted to.
    LivePatches,
    /// Scenes of the position gradients.
    PositionGradients,
    /// Dequantisation of the held-out patches of an optimizer run.
    Dequantisation,
    /// Scenes of the live lower bound by the decoder.
    LiveDecoder,
    /// Annealed importance sampling for the lower bound.
    AisLower,
    /// Annealed importance sampling for the upper bound.
    AisUpper,
    /// Scenes of the comparison of a mask with that before the last edit.
    EditComparison,
    /// Held-out objects of an evaluation of decoders.
    ReconstructionObjects,
    /// Noise of their measurements.
    ReconstructionNoise,
    /// Objects and noise that a prior or its uncertainty is computed from.
    ReconstructionPrior,
    /// Weights, objects and noise of a network that reconstructs.
    ReconstructionNetwork,
    /// Fresh noise of images of a camera at equal light.
    EqualLight,
    /// One batch of objects, by the index of its first one.
    Batch {
        /// Index of the first object.
        first: usize,
    },
    /// Noise of the patches of all batches.
    BatchNoise,
    /// One block of scenes of the position gradients.
    Block {
        /// Index of the block.
        index: usize,
    },
    /// One problem of the training data of pretrained weights.
    TrainingProblem {
        /// Index of the problem.
        number: u64,
    },
    /// A fit of an optimizer round.
    RoundFit {
        /// 0 for the fit of the round, 1 and 2 for those that check it.
        part: u64,
        /// Index of the round.
        round: usize,
    },
    /// The draws of one substep of an optimizer step.
    Step {
        /// Index of the substep.
        substep: usize,
        /// Steps of the mask so far.
        step: usize,
    },
    /// The relocation search at one step.
    Relocation {
        /// 0 for the candidates, 1 for the scenes that screen them, 2 for those that compare the best one.
        part: u64,
        /// Steps of the mask so far.
        step: usize,
    },
    /// The fit in the course of the round that begins at one step.
    OnlineFit {
        /// Steps of the mask so far.
        step: usize,
    },
}

impl SeedStream {
    /// The seed of this purpose.
    pub fn derive(self, seed: u64) -> u64 {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        random.set_stream(self.number());
        random.next_u64()
    }

    fn number(self) -> u64 {
        match self {
            Self::MeasuredOrder => 0,
            Self::TrainingPatches | Self::HeldOutObjects | Self::PatchNoise | Self::GradientNoise => 1,
            Self::TestPatches | Self::ScalePatches => 2,
            Self::HeldOutPlaces | Self::LiveFit => 3,
            Self::HeldOutNoise | Self::CausalFit | Self::Decoder => 4,
            Self::TamuraNoise | Self::MoreTestPatches => 5,
            Self::RunLowerBound | Self::LivePatches | Self::PositionGradients => 6,
            Self::Dequantisation | Self::LiveDecoder => 7,
            Self::AisLower => 8,
            Self::AisUpper => 9,
            Self::EditComparison => 10,
            Self::ReconstructionObjects => 11,
            Self::ReconstructionNoise => 12,
            Self::ReconstructionPrior => 13,
            Self::ReconstructionNetwork => 14,
            Self::EqualLight => 15,
            Self::Batch { first: index } | Self::Block { index } => index as u64,
            Self::TrainingProblem { number } => number,
            Self::BatchNoise => u64::MAX,
            Self::RoundFit { part, round } => 1 << 32 | part << 28 | round as u64,
            Self::Step { substep, step } => 1 << 33 | (substep as u64) << 40 | step as u64,
            Self::Relocation { part, step } => 1 << 34 | part << 28 | step as u64,
            Self::OnlineFit { step } => 1 << 35 | step as u64,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stream_numbers_stay() {
        for (stream, number) in [
            (SeedStream::RoundFit { part: 1, round: 3 }, (1 << 32) + (1 << 28) + 3),
            (SeedStream::Step { substep: 2, step: 5 }, (1 << 33) + (2 << 40) + 5),
            (SeedStream::Relocation { part: 2, step: 7 }, (1 << 34) + (2 << 28) + 7),
            (SeedStream::OnlineFit { step: 9 }, (1 << 35) + 9),
            (SeedStream::Batch { first: 12 }, 12),
        ] {
            assert_eq!(stream.number(), number);
        }
        assert_ne!(SeedStream::TestPatches.derive(1), SeedStream::TestPatches.derive(2));
        assert_ne!(SeedStream::TestPatches.derive(1), SeedStream::LiveFit.derive(1));
    }
}
