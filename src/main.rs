//! Lenslet Studio: the window, or one subcommand.

fn main() -> std::process::ExitCode {
    lenslet_studio::cli::run()
}
