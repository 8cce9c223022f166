//! Text and pictures as HTML wants them.

use crate::PipelineError;
use crate::stages::frames::rgb8;
use comgs_image::Image;

/// Colours follow the reader's light or dark setting.
pub(super) const STYLE: &str = "
:root{--ground:#fbfbfa;--panel:#fff;--text:#1c1c1e;--soft:#6b6b70;--line:#dcdcd8;--accent:#2a6fb0;--warn:#9a5b00}
@media (prefers-color-scheme:dark){:root{--ground:#141416;--panel:#1d1d20;--text:#ececee;--soft:#9a9aa2;
--line:#35353a;--accent:#6fb1ee;--warn:#e0a040}}
*{box-sizing:border-box}
body{margin:0 auto;max-width:1080px;padding:24px;background:var(--ground);color:var(--text);
font:16px/1.5 system-ui,sans-serif}
h1{font-size:1.8rem;margin:.2em 0}h2{font-size:1.2rem;margin:2em 0 .6em}h3{font-size:1rem;margin:1.4em 0 .4em}
.hint,footer,figcaption{color:var(--soft);font-size:.88rem}
.warnings{border-left:3px solid var(--warn);padding-left:16px}.warnings h2{color:var(--warn);margin-top:1em}
.compare{position:relative;margin:0;overflow:hidden;background:#000}
.compare img{position:absolute;inset:0;width:100%;height:100%;display:block}
.compare .before{clip-path:inset(0 calc(100% - var(--at)) 0 0)}
.compare .bar{position:absolute;top:0;bottom:0;left:var(--at);width:2px;margin-left:-1px;background:#fff;
box-shadow:0 0 4px #000;pointer-events:none}
.compare input{position:absolute;inset:0;width:100%;height:100%;margin:0;opacity:0;cursor:ew-resize}
.compare[hidden]{display:none}
.chooser{display:flex;flex-wrap:wrap;gap:8px;margin-top:12px}
.chooser button{padding:4px;border:1px solid var(--line);background:var(--panel);color:var(--text);cursor:pointer;
font:inherit;font-size:.8rem}
.chooser button.chosen{border-color:var(--accent);outline:1px solid var(--accent)}
.chooser img{display:block;width:96px;height:auto}
.wide figure{margin:0 0 16px}.wide img{width:100%;height:auto;image-rendering:auto;background:#000}
.scroll{overflow-x:auto}
table{border-collapse:collapse;font-variant-numeric:tabular-nums;font-size:.9rem}
th,td{padding:4px 12px;text-align:right;border-bottom:1px solid var(--line);white-space:nowrap}
th:first-child,td:first-child{text-align:left;padding-left:0}
.mean td{font-weight:600;border-bottom:0}
.times{width:100%}.bars{width:60%}.bars span{display:block;height:10px;background:var(--accent);min-width:1px}
pre{overflow-x:auto;background:var(--panel);border:1px solid var(--line);padding:12px;font-size:.82rem}
footer{margin-top:3em}
";

/// The slider and the choice of the frame.
pub(super) const SCRIPT: &str = "
const figures=[...document.querySelectorAll('.compare')],buttons=[...document.querySelectorAll('.chooser button')];
for(const f of figures){const r=f.querySelector('input');
r.addEventListener('input',()=>{for(const g of figures){g.style.setProperty('--at',r.value+'%');
g.querySelector('input').value=r.value}})}
buttons.forEach((b,i)=>b.addEventListener('click',()=>{figures.forEach((f,k)=>f.hidden=k!==i);
buttons.forEach((c,k)=>c.classList.toggle('chosen',k===i))}));
";

/// Text that cannot be taken for markup.
pub(super) fn escape(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '&' => out.push_str("&amp;"),
            '<' => out.push_str("&lt;"),
            '>' => out.push_str("&gt;"),
            '"' => out.push_str("&quot;"),
            '\'' => out.push_str("&#39;"),
            c => out.push(c),
        }
    }
    out
}

/// Standard base 64 with padding (RFC 4648 §4).
pub(crate) fn base64(bytes: &[u8]) -> String {
    const DIGITS: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let mut out = String::with_capacity(bytes.len().div_ceil(3) * 4);
    for chunk in bytes.chunks(3) {
        let word = chunk.iter().fold(0u32, |w, b| (w << 8) | u32::from(*b)) << (8 * (3 - chunk.len()));
        for k in 0..4 {
            let digit = (word >> (18 - 6 * k)) & 63;
            out.push(if k <= chunk.len() { char::from(DIGITS[digit as usize]) } else { '=' });
        }
    }
    out
}

fn encoded(
    image: &Image,
    kind: &str,
    encode: impl FnOnce(&mut Vec<u8>, &[u8]) -> image::ImageResult<()>,
) -> Result<String, PipelineError> {
    let mut bytes = Vec::new();
    encode(&mut bytes, &rgb8(image))
        .map_err(|e| PipelineError::Internal(format!("a picture of the report cannot be encoded: {e}")))?;
    Ok(format!("data:image/{kind};base64,{}", base64(&bytes)))
}

/// Linear radiance as an inlined sRGB JPEG.
pub(super) fn jpeg_data_url(image: &Image) -> Result<String, PipelineError> {
    let (width, height) = (image.width as u32, image.height as u32);
    encoded(image, "jpeg", |out, rgb| {
        image::codecs::jpeg::JpegEncoder::new_with_quality(out, 90).encode(
            rgb,
            width,
            height,
            image::ExtendedColorType::Rgb8,
        )
    })
}

/// One channel as an inlined grey PNG, stored as it is (a coverage of ½ is the code value 128).
pub(super) fn png_data_url(image: &Image) -> Result<String, PipelineError> {
    let codes: Vec<u8> = image.data.iter().map(|v| (v.clamp(0.0, 1.0) * 255.0 + 0.5) as u8).collect();
    let (width, height) = (image.width as u32, image.height as u32);
    encoded(image, "png", |out, _| {
        let encoder = image::codecs::png::PngEncoder::new(out);
        image::ImageEncoder::write_image(encoder, &codes, width, height, image::ExtendedColorType::L8)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Goal: the vectors of RFC 4648 §10.
    #[test]
    fn base64_vectors() {
        for (text, code) in [
            ("", ""),
            ("f", "Zg=="),
            ("fo", "Zm8="),
            ("foo", "Zm9v"),
            ("foob", "Zm9vYg=="),
            ("fooba", "Zm9vYmE="),
            ("foobar", "Zm9vYmFy"),
        ] {
            assert_eq!(base64(text.as_bytes()), code);
        }
        assert_eq!(base64(&[0xfb, 0xff]), "+/8=");
    }
}
