//! Images of linear Rec.709 radiance (f32, interleaved), transfer functions, and reading and writing of EXR,
//! HDR, PNG and JPEG. Everything inside comgs is linear; sRGB exists only at these file borders.

pub mod atomic;
pub mod image;
pub mod read;
pub mod transfer;
pub mod write;

pub use image::Image;
pub use read::{Encoding, Loaded, ReadError, read};
pub use write::{Layer, WriteError, encode_exr, write_exr, write_hdr, write_layers, write_png};
