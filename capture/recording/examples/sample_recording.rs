//! Writes a small recording with every topic, and prints what the check says about it:
//! `cargo run -p ft-recording --example sample_recording -- FILE [none]`.
#![allow(clippy::unwrap_used, reason = "a sample fails by panicking")]

use std::path::Path;

use ft_recording::check::check;
use ft_recording::writer::Compression;

#[path = "../tests/support/recordings.rs"]
mod recordings;

fn main() {
    let mut arguments = std::env::args().skip(1);
    let path = arguments.next().unwrap_or("sample.mcap".to_owned());
    let compression = if arguments.next().is_some() {
        Compression::None
    } else {
        Compression::Zstd
    };
    recordings::write_recording(Path::new(&path), compression, 2000);
    println!("{}", check(Path::new(&path)).unwrap());
}
