//! Lenslet Studio: the window, or one subcommand.

fn main() -> anyhow::Result<()> {
    Ok(lenslet_studio::studio::open_window(Default::default(), None, Default::default())?)
}
