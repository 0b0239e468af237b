//! Lenslet Studio: the window, or one subcommand.

/// The system's allocator keeps a heap for every thread that ever asked: within minutes of edits beside a run, twice what
/// the program needs. So do huge pages, which `no_thp` does not ask for.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

fn main() -> std::process::ExitCode {
    lenslet_studio::cli::run()
}
