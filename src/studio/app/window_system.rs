//! The window system: Wayland or X11.
//!
//! `WAYLAND_DISPLAY` may outlive its session. winit trusts the variable and makes one attempt per process. So the
//! compositor is queried first.

use std::io::{self, Read, Write};
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Time limit for the answer of a compositor.
const PATIENCE: Duration = Duration::from_secs(2);

/// The window system.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum WindowSystem {
    /// Wayland.
    Wayland,
    /// X11.
    X11,
    /// X11, because the Wayland display of this name does not answer.
    X11InPlaceOf(String),
}

impl WindowSystem {
    /// The window system of the environment.
    pub fn of_environment() -> Self {
        let named = |name: &str| std::env::var_os(name).filter(|value| !value.is_empty());
        let Some(wayland) = named("WAYLAND_DISPLAY").filter(|_| named("WAYLAND_SOCKET").is_none()) else {
            // A compositor can pass an open socket itself.
            return if named("WAYLAND_SOCKET").is_some() { Self::Wayland } else { Self::X11 };
        };
        let socket = socket_of(Path::new(&wayland), named("XDG_RUNTIME_DIR").map(PathBuf::from).as_deref());
        let answers = socket.is_some_and(|socket| answers(&socket, PATIENCE).is_ok());
        match (answers, named("DISPLAY")) {
            (false, Some(_)) => Self::X11InPlaceOf(wayland.to_string_lossy().into_owned()),
            _ => Self::Wayland,
        }
    }

    /// Makes winit use this window system.
    pub fn choose<T: 'static>(&self, builder: &mut winit::event_loop::EventLoopBuilder<T>) {
        use winit::platform::wayland::EventLoopBuilderExtWayland;
        use winit::platform::x11::EventLoopBuilderExtX11;
        match self {
            Self::Wayland => builder.with_wayland(),
            Self::X11 | Self::X11InPlaceOf(_) => builder.with_x11(),
        };
    }

    /// A message about the choice, if it is unexpected.
    pub fn notice(&self) -> Option<String> {
        match self {
            Self::X11InPlaceOf(name) => {
                Some(format!("Nothing answers at WAYLAND_DISPLAY ({name}); the window is on the X11 display instead."))
            }
            Self::Wayland | Self::X11 => None,
        }
    }
}

/// Socket of a Wayland display; `None` if the folder of the sockets is unknown.
fn socket_of(display: &Path, runtime: Option<&Path>) -> Option<PathBuf> {
    if display.is_absolute() { Some(display.to_owned()) } else { Some(runtime?.join(display)) }
}

/// Sends `wl_display.sync` to a compositor and waits for its answer.
fn answers(socket: &Path, patience: Duration) -> io::Result<()> {
    const DISPLAY: u32 = 1;
    const CALLBACK: u32 = 2;
    const BYTES: u32 = 12;
    let mut stream = UnixStream::connect(socket)?;
    stream.set_read_timeout(Some(patience))?;
    stream.set_write_timeout(Some(patience))?;
    // The request 0 of the display, whose argument is the new callback.
    let request = [DISPLAY, BYTES << 16, CALLBACK].map(u32::to_ne_bytes);
    stream.write_all(request.as_flattened())?;
    // Any event suffices: its object and its length.
    stream.read_exact(&mut [0; 8])
}

#[cfg(test)]
mod tests {
    use std::os::unix::net::UnixListener;

    use super::*;

    #[test]
    fn compositor_must_answer() {
        let folder = tempfile::tempdir().unwrap();
        let socket = folder.path().join("wayland-1");
        assert!(answers(&socket, PATIENCE).is_err(), "there is none");
        std::fs::write(&socket, b"").unwrap();
        assert!(answers(&socket, PATIENCE).is_err(), "it is no socket");
        std::fs::remove_file(&socket).unwrap();
        // A killed compositor leaves its socket.
        drop(UnixListener::bind(&socket).unwrap());
        assert!(socket.exists() && answers(&socket, PATIENCE).is_err());
        std::fs::remove_file(&socket).unwrap();

        let listener = UnixListener::bind(&socket).unwrap();
        assert!(answers(&socket, Duration::from_millis(1)).is_err(), "it is silent");
        let server = std::thread::Builder::new().name("compositor".into()).spawn(move || {
            // The first client has timed out.
            drop(listener.accept().unwrap());
            // The next client is disconnected, the last one gets an answer.
            drop(listener.accept().unwrap());
            let (mut stream, _) = listener.accept().unwrap();
            let mut request = [0; 12];
            stream.read_exact(&mut request).unwrap();
            stream.write_all([2_u32, 12 << 16, 0].map(u32::to_ne_bytes).as_flattened()).unwrap();
            request
        });
        assert!(answers(&socket, PATIENCE).is_err(), "it hangs up");
        assert!(answers(&socket, PATIENCE).is_ok());
        let request = server.unwrap().join().unwrap();
        assert_eq!(request, *[1_u32, 12 << 16, 2].map(u32::to_ne_bytes).as_flattened());
    }

    #[test]
    fn relative_display_lies_in_runtime_folder() {
        let runtime = Path::new("/run/user/7");
        assert_eq!(socket_of(Path::new("wayland-0"), Some(runtime)), Some(runtime.join("wayland-0")));
        assert_eq!(socket_of(Path::new("/tmp/w"), Some(runtime)), Some("/tmp/w".into()));
        assert_eq!(socket_of(Path::new("wayland-0"), None), None);
        assert!(WindowSystem::X11InPlaceOf("wayland-9".into()).notice().unwrap().contains("wayland-9"));
        assert_eq!(WindowSystem::X11.notice(), None);
    }
}
