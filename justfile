# Convenience only; every recipe is one plain cargo command.

# All pictures of the README, in out/demo
demo:
    cargo run --release -- demo

test:
    cargo test --release --workspace

check:
    .ci/run

# Speed tables of docs/cost-of-accuracy.md
bench:
    cargo run --release -p comgs-raster --example raster_speed
    cargo run --release -p comgs-trace --example rays_per_second

docs:
    cargo doc --workspace --no-deps --open
