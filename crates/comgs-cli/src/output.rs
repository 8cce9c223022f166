//! Results on standard output.
//!
//! A reader that has seen enough and closes the pipe (`comgs info x | head -1`) is no failure: what follows is dropped
//! quietly and the exit code stays what it would have been.

use std::io::{self, ErrorKind, Write};

/// Prints a line as `println!` does, without its panic when standard output is closed.
macro_rules! say {
    ($($argument:tt)*) => { $crate::output::write(format_args!("{}\n", format_args!($($argument)*))) };
}
pub(crate) use say;

/// Prints text as it is.
pub(crate) fn write(text: std::fmt::Arguments<'_>) {
    let mut out = io::stdout().lock();
    if let Err(error) = out.write_fmt(text).and_then(|()| out.flush())
        && error.kind() != ErrorKind::BrokenPipe
    {
        // Where standard output is a file on a full disk there is still standard error.
        let _ = writeln!(io::stderr(), "warning: the result could not be printed: {error}");
    }
}
