//! Stdout that takes a closed pipe as success: `rubik-robot keys | head -1` ends quietly.

use std::io::{self, BufWriter, ErrorKind, Write};

/// Lines of results.
#[derive(Debug)]
pub struct Output<W: Write = io::Stdout> {
    to: BufWriter<W>,
    closed: bool,
}

impl Output {
    /// The process's stdout.
    #[must_use]
    pub fn stdout() -> Self {
        Self::new(io::stdout())
    }
}

impl<W: Write> Output<W> {
    /// Writes to `to`.
    pub fn new(to: W) -> Self {
        Self { to: BufWriter::new(to), closed: false }
    }

    /// Writes a line.
    ///
    /// # Errors
    /// Whatever the device says, but not that nobody reads any more.
    pub fn line(&mut self, text: &str) -> anyhow::Result<()> {
        let written = writeln!(self.to, "{text}");
        self.take(written)
    }

    /// Writes text as it is.
    ///
    /// # Errors
    /// As [`Output::line`].
    pub fn text(&mut self, text: &str) -> anyhow::Result<()> {
        let written = self.to.write_all(text.as_bytes());
        self.take(written)
    }

    /// Lets something write by itself.
    ///
    /// # Errors
    /// As [`Output::line`].
    pub fn write(
        &mut self,
        writer: impl FnOnce(&mut BufWriter<W>) -> io::Result<()>,
    ) -> anyhow::Result<()> {
        let written = writer(&mut self.to);
        self.take(written)
    }

    /// Hands over what is buffered.
    ///
    /// # Errors
    /// As [`Output::line`].
    pub fn flush(&mut self) -> anyhow::Result<()> {
        let flushed = if self.closed { Ok(()) } else { self.to.flush() };
        self.take(flushed)
    }

    /// Whether nobody reads any more.
    #[must_use]
    pub fn is_closed(&self) -> bool {
        self.closed
    }

    fn take(&mut self, result: io::Result<()>) -> anyhow::Result<()> {
        match result {
            Err(error) if error.kind() == ErrorKind::BrokenPipe => {
                self.closed = true;
                Ok(())
            }
            other => Ok(other?),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    struct Broken;
    impl Write for Broken {
        fn write(&mut self, _: &[u8]) -> io::Result<usize> {
            Err(ErrorKind::BrokenPipe.into())
        }
        fn flush(&mut self) -> io::Result<()> {
            Err(ErrorKind::BrokenPipe.into())
        }
    }

    #[test]
    fn a_closed_pipe_is_no_error() {
        let mut output = Output::new(Broken);

        output.line("text").unwrap();
        output.flush().unwrap();

        assert!(output.is_closed());
    }
}
