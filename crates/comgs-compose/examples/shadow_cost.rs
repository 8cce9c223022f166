//! Seconds and error of every way to a shadow, on one composition.
//!
//! `cargo run --release -p comgs-compose --example shadow_cost -- SCENE.ply OBJECT.ply COMPOSITION_DIR [VIEWS]`
fn main() {}
