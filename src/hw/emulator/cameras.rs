//! Cameras of the emulator, which serve frames over local sockets, with one thread per camera.
//!
//! - in: requests with a period and an exposure
//! - out: a header and the frame; or a header with the width 0, and the reason in words

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

/// Time after which a waiting thread checks again whether it must end.
const LOOK: Duration = Duration::from_millis(50);

/// A camera that is served until this value is dropped.
#[derive(Debug)]
pub struct CameraServer {
    path: PathBuf,
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl CameraServer {
    /// Starts a thread that serves the frames of `source` on a local socket at `path`, to one
    /// client after another.
    ///
    /// # Errors
    /// Returns the error of the operating system.
    pub fn start(path: &Path, mut source: Box<dyn FrameSource>) -> std::io::Result<Self> {
        let listener = UnixListener::bind(path)?;
        listener.set_nonblocking(true)?;
        let stop = Arc::new(AtomicBool::new(false));
        let ends = Arc::clone(&stop);
        let thread = std::thread::Builder::new().name("camera".into()).spawn(move || {
            // Drawing pictures must not delay the serial lines on the same processor.
            step_back();
            while !ends.load(Ordering::Acquire) {
                match listener.accept() {
                    Ok((stream, _)) => {
                        if let Err(error) = serve(stream, source.as_mut(), &ends) {
                            tracing::debug!(%error, "a client of a camera disconnected");
                        }
                    }
                    // Without a client, and after any error of the socket, the thread tries again
                    // later.
                    Err(_) => std::thread::sleep(LOOK),
                }
            }
        })?;
        Ok(Self { path: path.to_owned(), stop, thread: Some(thread) })
    }

    /// Returns the path of the socket.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }
}

impl Drop for CameraServer {
    /// Ends the thread, waits for its end and removes the socket.
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Release);
        if let Some(thread) = self.thread.take() {
            // A panic of the thread has already printed its own message.
            let _ = thread.join();
        }
        let _ = std::fs::remove_file(&self.path);
    }
}

/// Answers the requests of one client with frames until the client disconnects or `ends` is set.
fn serve(
    mut stream: UnixStream,
    source: &mut dyn FrameSource,
    ends: &AtomicBool,
) -> std::io::Result<()> {
    stream.set_nonblocking(false)?;
    // Timeouts let the thread check `ends` while a client neither asks nor reads.
    stream.set_read_timeout(Some(LOOK))?;
    stream.set_write_timeout(Some(LOOK))?;
    loop {
        let mut request = [0; REQUEST];
        // A stream has no message boundaries, so a request may come in parts.
        let mut length = 0;
        while length < REQUEST {
            match stream.read(&mut request[length..]) {
                Ok(0) => return Ok(()),
                Ok(n) => length += n,
                Err(e) if e.kind() == ErrorKind::WouldBlock => {}
                Err(e) => return Err(e),
            }
            // A client that stays silent must not keep the thread from ending.
            if ends.load(Ordering::Acquire) {
                return Ok(());
            }
        }
        let (period, exposure) = decode_request(&request);
        // A header with the width 0 announces the reason why there is no frame.
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

/// Writes all bytes to the client. Returns `false` if `ends` was set before all were written.
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

    /// A source of frames that fit into no buffer of a socket.
    struct Large;

    impl FrameSource for Large {
        fn grab(&mut self, period: u64, _: f64) -> Result<Frame, NoFrame> {
            Ok(Frame { period, image: image::RgbImage::new(2000, 2000) })
        }
    }

    /// The server would otherwise wait for ever in a write to a client that does not read.
    #[test]
    fn unread_frame_does_not_block_camera_server_shutdown() {
        let path =
            std::env::temp_dir().join(format!("rubik-robot-deaf-{}.sock", std::process::id()));
        let server = CameraServer::start(&path, Box::new(Large)).unwrap();
        let mut client = UnixStream::connect(&path).unwrap();
        client.write_all(&encode_request(1, 0.01)).unwrap();
        // The first byte shows that the server is sending the frame.
        client.read_exact(&mut [0]).unwrap();

        let begun = Instant::now();
        let (done, ended) = std::sync::mpsc::channel();
        std::thread::spawn(move || {
            drop(server);
            done.send(())
        });

        assert!(ended.recv_timeout(Duration::from_secs(20)).is_ok(), "{:?}", begun.elapsed());
        assert!(!path.exists());
    }
}
