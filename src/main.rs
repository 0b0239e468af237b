//! Lenslet Studio: the window, or one subcommand.

/// Allocator of the program. The allocator of the system keeps a heap per thread: twice the memory within minutes of edits
/// during a run. Huge pages cost as much; `no_thp` avoids them.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

fn main() -> std::process::ExitCode {
    lenslet_studio::cli::run()
}
