//! Pretrains the decoder of lower bounds on beads and many masks.
//!
//! `cargo run --release --example pretrain_decoder OUT MINUTES [SEED] [START] [UNROLLED]`; with START, the fit resumes from that file
//! at a third of the learning rate. With more UNROLLED steps than it has, its last but one is repeated.

mod training_data;

use lenslet_studio::information::{
    Decoder, DecoderFit, DecoderPretrainProgress, DecoderPretrainStep, DecoderPretraining,
};
use training_data::{Arguments, WeightsFile, training_channel};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let Arguments { out, budget, seed, start, unrolled } = Arguments::from_env()?;
    let (mut decoder, rate) = match &start {
        Some(bytes) => {
            let start = Decoder::from_bytes(bytes)?;
            (start.deepened(unrolled.unwrap_or(start.unrolled()))?, DecoderFit::RATE_ON)
        }
        None => (Decoder::new(unrolled.unwrap_or(Decoder::UNROLLED), seed)?, DecoderFit::RATE),
    };
    let mut file = WeightsFile::new(&out);
    let on_step = &mut |step: &DecoderPretrainStep<'_>| {
        let DecoderPretrainProgress { steps, channels, saved_bits: bits, .. } = step.progress;
        let status = format!("{steps} steps, {channels} channels, information gain {bits:.4} bits per pixel");
        file.update(&status, &|| step.decoder().to_bytes())
    };
    let settings = DecoderPretraining { length: budget, seed, rate };
    let fitted = decoder.fit_generally(&|number| training_channel(seed, number), settings, on_step);
    file.finish(fitted, decoder.to_bytes())
}
