use comgs_probe::*; use comgs_trace::*; use comgs_scene::*; use comgs_raster::*; use comgs_geom::Rng; use glam::*; use rayon::prelude::*; use std::time::Instant;
fn main(){
 let a:Vec<String>=std::env::args().collect();
 let cloud=comgs_surfel::ply::read_surfels(std::path::Path::new(&a[1])).unwrap().0;
 let cap=Capture::open(&a[2],Split::Train).unwrap();
 println!("{} surfels {} views sh {}", cloud.len(), cap.views.len(), cloud.sh_degree);
 let t=Instant::now();
 let views:Vec<DepthView>=cap.views.iter().map(|v|{ let c=v.camera.resized(400,400); let f=render(&cloud,&c,Planes::GEOMETRY,&RasterConfig::default()); DepthView{depth:f.unbiased_depth(0.5),normal:f.normal.unwrap(),camera:c} }).collect();
 println!("gbuffers {:?}", t.elapsed());
 for (stride,n) in [(4usize,16usize),(2,16),(4,59)] { for fc in [FusionConfig{stride,neighbours:n,..FusionConfig::default()}] {
 let t=Instant::now(); let (p,r)=fuse(&views,&fc).unwrap(); println!("fuse stride {stride} n {n} {:?} points {} {:?}", t.elapsed(), p.positions.len(), r); } }
 let (points,_)=fuse(&views,&FusionConfig::default()).unwrap();
 let (lo,hi)=points.positions.iter().fold((Vec3::INFINITY,Vec3::NEG_INFINITY),|(l,h),p|(l.min(*p),h.max(*p))); let size=(hi-lo).max_element(); println!("size {size} {lo} {hi}");
 let tracer=Tracer::new(&cloud,&TraceConfig::default()).unwrap();
 let mut rng=Rng::new(1);
 let pick:Vec<usize>=(0..1500).map(|_|rng.below(points.positions.len())).collect();
 let dirs:Vec<Vec<Vec3>>=pick.iter().map(|&i|(0..64).map(|_|{ let d=Vec3::new(rng.normal(),rng.normal(),rng.normal()).normalize(); if d.dot(points.normals[i])<0.0 {-d} else {d}}).collect()).collect();
 // traced truth from a lifted origin
 let lift=std::env::args().nth(3).and_then(|s|s.parse().ok()).unwrap_or(0.005f32);
 let truth:Vec<Vec<[f32;4]>>=pick.par_iter().zip(&dirs).map(|(&i,ds)|{ let o=points.positions[i]+lift*size*points.normals[i]; ds.iter().map(|&d|{let h=tracer.radiance(o,d,0.0,f32::INFINITY); [h.radiance.x,h.radiance.y,h.radiance.z,h.alpha]}).collect()}).collect();
 let m:f32=truth.iter().flatten().map(|t|t[3]).sum::<f32>()/(1500.0*64.0); println!("mean truth O {m}");
 for count in [1000,5000] { for res in [16] { for offset in [0.0,0.01,0.02] {
  let cfg=ProbeConfig{count,resolution:res,offset,..ProbeConfig::default()};
  let t=Instant::now(); let mut set=place(&points,&cfg,size).unwrap(); let tp=t.elapsed();
  let rays=1; let t=Instant::now(); bake(&tracer,&mut set,rays,BakeObserver::silent()).unwrap(); let tb=t.elapsed();
  let index=set.index(&cfg);
  print!("count {count} offset {offset} spacing {:.4} place {tp:?} bake {tb:?} |", set.spacing/size);
  let base=LookupConfig::new(&set,&cfg);
  for (name,lc) in [("none",LookupConfig{visibility:VisibilityWeight::None,..base.clone()}),("cheb",base.clone()),("bias.5",LookupConfig{normal_bias:0.5*set.spacing,..base.clone()}),("bias0",LookupConfig{normal_bias:0.0,..base.clone()}),("dev.3",LookupConfig{min_deviation:0.3*set.spacing,..base.clone()}),("K4",LookupConfig{neighbours:4,..base.clone()}),("K16",LookupConfig{neighbours:16,..base.clone()})] {
   let e:Vec<[f64;4]>=pick.par_iter().zip(&dirs).zip(&truth).map(|((&i,ds),tr)|{ let n=index.query(points.positions[i],points.normals[i],&set,&lc); let mut e=[0.0f64;4]; let mut ao=[0.0f64;2]; for (d,t) in ds.iter().zip(tr) { let v=set.lookup(&n,*d); let c=f64::from(d.dot(points.normals[i])); e[0]+=f64::from((v[3]-t[3]).abs())/64.0; e[1]+=f64::from((v[0]-t[0]).abs()+(v[1]-t[1]).abs()+(v[2]-t[2]).abs())/192.0; ao[0]+=c*f64::from(v[3])/64.0*2.0; ao[1]+=c*f64::from(t[3])/64.0*2.0; } e[2]=(ao[0]-ao[1]).abs(); e[3]=n.count as f64; e }).collect();
   let s=|c:usize|e.iter().map(|e|e[c]).sum::<f64>()/e.len() as f64;
   print!(" {name} O {:.4} L {:.4} AO {:.4}", s(0),s(1),s(2));
  }
  println!();
 }}}
}
