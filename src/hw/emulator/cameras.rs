//! Cameras of the emulator: frames over a local socket, one thread a camera.

use crate::hw::camera::FrameSource;
use crate::hw::driver::step_back;
use crate::hw::socket_camera::{Header, REQUEST, decode_request};
use std::io::{Read, Write};
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;

/// How often the thread looks whether it is to end.
const LOOK: Duration = Duration::from_millis(50);

/// A camera that is served; ends when it is dropped.
#[derive(Debug)]
pub struct CameraServer {
    path: PathBuf,
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl CameraServer {
    /// Serves frames at `path`, to one bridge after the other.
    ///
    /// # Errors
    /// What the operating system says.
    pub fn start(path: &Path, mut source: Box<dyn FrameSource>) -> std::io::Result<Self> {
        let listener = UnixListener::bind(path)?;
        listener.set_nonblocking(true)?;
        let stop = Arc::new(AtomicBool::new(false));
        let ends = Arc::clone(&stop);
        let thread = std::thread::Builder::new().name("camera".into()).spawn(move || {
            step_back();
            while !ends.load(Ordering::Acquire) {
                match listener.accept() {
                    Ok((stream, _)) => {
                        if let Err(error) = serve(stream, source.as_mut(), &ends) {
                            tracing::debug!(%error, "a camera's client left");
                        }
                    }
                    Err(_) => std::thread::sleep(LOOK),
                }
            }
        })?;
        Ok(Self { path: path.to_owned(), stop, thread: Some(thread) })
    }

    /// Where it is served.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }
}

impl Drop for CameraServer {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Release);
        if let Some(thread) = self.thread.take() {
            // Its own message has told of a panic.
            let _ = thread.join();
        }
        let _ = std::fs::remove_file(&self.path);
    }
}

fn serve(
    mut stream: UnixStream,
    source: &mut dyn FrameSource,
    ends: &AtomicBool,
) -> std::io::Result<()> {
    stream.set_nonblocking(false)?;
    stream.set_read_timeout(Some(LOOK))?;
    loop {
        let mut request = [0; REQUEST];
        let mut length = 0;
        while length < REQUEST {
            match stream.read(&mut request[length..]) {
                Ok(0) => return Ok(()),
                Ok(n) => length += n,
                Err(e) if e.kind() == std::io::ErrorKind::WouldBlock => {}
                Err(e) => return Err(e),
            }
            if ends.load(Ordering::Acquire) {
                return Ok(());
            }
        }
        let (period, exposure) = decode_request(&request);
        let (header, bytes) = match source.grab(period, exposure) {
            Ok(frame) => {
                let (width, height) = frame.image.dimensions();
                (Header { period: frame.period, width, height, length: 0 }, frame.image.into_raw())
            }
            Err(no) => {
                (Header { period, width: 0, height: 0, length: 0 }, no.to_string().into_bytes())
            }
        };
        let header = Header { length: bytes.len() as u64, ..header };
        stream.write_all(&header.encode())?;
        stream.write_all(&bytes)?;
    }
}
