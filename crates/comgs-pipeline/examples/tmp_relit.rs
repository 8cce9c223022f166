use comgs_pipeline::{Context, stages::{eval::relit, relight}};
use comgs_inverse::{Visibility, Quality};
use std::path::Path;
fn main() {
    let a: Vec<String> = std::env::args().collect();
    let (asset, obj) = (Path::new(&a[1]), &a[2]);
    let p = "/work/shared/data/public";
    let base = relight::Config { quality: Quality::Draft, ..Default::default() };
    let ind = relight::Config { indirect: true, ..base.clone() };
    let rays: Vec<relight::Config> = [64, 128, 256, 512].map(|r| relight::Config { rays: Some(r), ..ind.clone() }).to_vec();
    for (name, c) in [
        ("draft", ind.clone()), ("balanced", rays[1].clone()), ("balanced direct", relight::Config {indirect:false, ..rays[1].clone()}), ("trace balanced", relight::Config {visibility: Visibility::Trace, ..rays[1].clone()}),
    ] {
        let t = std::time::Instant::now();
        let (s, r) = relit::evaluate(asset, Path::new(&format!("{p}/object/{obj}")), Path::new(&format!("{p}/object_relit/{obj}")), &c, &Context::silent()).unwrap();
        println!("{name}: {:.1} s", t.elapsed().as_secs_f64());
        for s in s.iter().filter(|s| s.name.starts_with("relit") ) { let t=&s.table; println!("   {:35} {:.2} {:.4} {:.4} mask {:.2}", s.name, t.mean("psnr_db").unwrap(), t.mean("ssim").unwrap(), t.mean("flip").unwrap(), t.mean("masked.psnr_db").unwrap()); }
        if name=="none" {println!("{r:?}");}
    }
}
