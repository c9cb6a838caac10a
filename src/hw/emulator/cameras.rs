//! Cameras of the emulator: frames over a local socket, one thread a camera.

use crate::hw::camera::FrameSource;
use crate::hw::driver::step_back;
use crate::hw::socket_camera::{Header, REQUEST, decode_request};
use std::io::{ErrorKind, Read, Write};
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
    stream.set_write_timeout(Some(LOOK))?;
    loop {
        let mut request = [0; REQUEST];
        let mut length = 0;
        while length < REQUEST {
            match stream.read(&mut request[length..]) {
                Ok(0) => return Ok(()),
                Ok(n) => length += n,
                Err(e) if e.kind() == ErrorKind::WouldBlock => {}
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
        if !(write(&mut stream, &header.encode(), ends)? && write(&mut stream, &bytes, ends)?) {
            return Ok(());
        }
    }
}

/// Writes all bytes; `false` when it was to end before a client had read them.
fn write(stream: &mut UnixStream, mut bytes: &[u8], ends: &AtomicBool) -> std::io::Result<bool> {
    while !bytes.is_empty() {
        match stream.write(bytes) {
            Ok(0) => return Err(ErrorKind::WriteZero.into()),
            Ok(n) => bytes = &bytes[n..],
            Err(e) if matches!(e.kind(), ErrorKind::WouldBlock | ErrorKind::Interrupted) => {}
            Err(e) => return Err(e),
        }
        if ends.load(Ordering::Acquire) {
            return Ok(bytes.is_empty());
        }
    }
    Ok(true)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hw::camera::{Frame, NoFrame};
    use crate::hw::socket_camera::encode_request;
    use std::time::Instant;

    /// Frames that no socket's buffer holds.
    struct Large;

    impl FrameSource for Large {
        fn grab(&mut self, period: u64, _: f64) -> Result<Frame, NoFrame> {
            Ok(Frame { period, image: image::RgbImage::new(2000, 2000) })
        }
    }

    #[test]
    fn a_client_that_does_not_read_does_not_hold_up_the_end() {
        let path =
            std::env::temp_dir().join(format!("rubik-robot-deaf-{}.sock", std::process::id()));
        let server = CameraServer::start(&path, Box::new(Large)).unwrap();
        let mut client = UnixStream::connect(&path).unwrap();
        client.write_all(&encode_request(1, 0.01)).unwrap();
        // The first byte shows that the frame is under way.
        client.read_exact(&mut [0]).unwrap();

        let begun = Instant::now();
        let (tell, told) = std::sync::mpsc::channel();
        std::thread::spawn(move || {
            drop(server);
            tell.send(())
        });

        assert!(told.recv_timeout(Duration::from_secs(20)).is_ok(), "{:?}", begun.elapsed());
        assert!(!path.exists());
    }
}
