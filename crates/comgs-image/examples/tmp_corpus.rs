//! Temporary.
use comgs_image::{Image, Layer, write_exr, write_hdr, write_layers, write_png};
use std::path::Path;
fn main() {
    let out = std::env::args().nth(1).unwrap();
    let p = |n: &str| Path::new(&out).join(n);
    let im = |c: usize| Image::from_data(6, 5, c, (0..6 * 5 * c).map(|i| (i * 37 % 101) as f32 / 90.0).collect());
    write_png(&p("grey8.png"), &im(1)).unwrap();
    write_png(&p("rgba8.png"), &im(4)).unwrap();
    write_exr(&p("rgb_half.exr"), &im(3)).unwrap();
    write_hdr(&p("rgbe.hdr"), &im(3)).unwrap();
    let (a, b) = (im(3), im(1));
    write_layers(&p("layers.exr"), &[
        Layer { name: "beauty", channels: &["R", "G", "B"], image: &a, full_float: false },
        Layer { name: "depth", channels: &["Z"], image: &b, full_float: true },
    ]).unwrap();
    let rgb: Vec<u8> = (0..16 * 12 * 3).map(|i| (i * 7 % 251) as u8).collect();
    let mut bytes = Vec::new();
    image::codecs::jpeg::JpegEncoder::new_with_quality(&mut bytes, 60)
        .encode(&rgb, 16, 12, image::ExtendedColorType::Rgb8).unwrap();
    std::fs::write(p("rgb.jpg"), bytes).unwrap();
    let deep: Vec<u16> = (0..6 * 5 * 3).map(|i| (i * 7919 % 65521) as u16).collect();
    let buf: image::ImageBuffer<image::Rgb<u16>, _> = image::ImageBuffer::from_raw(6, 5, deep).unwrap();
    buf.save(p("rgb16.png")).unwrap();
    let _ = exr::prelude::Compression::PIZ;
    use exr::prelude::*;
    for (name, c) in [("piz.exr", Compression::PIZ), ("rle.exr", Compression::RLE), ("b44.exr", Compression::B44)] {
        let layer = exr::prelude::Layer::new((20, 18), LayerAttributes::default(),
            Encoding { compression: c, ..Encoding::default() },
            SpecificChannels::rgb(|Vec2(x, y): Vec2<usize>| (f16::from_f32(x as f32 * 0.1), f16::from_f32(y as f32), f16::from_f32(0.5))));
        exr::prelude::Image::from_layer(layer).write().to_file(p(name)).unwrap();
    }
}
