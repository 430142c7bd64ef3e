//! Writes `host/map/src/gap_table.bin`: `cargo run --release -p ihd-map --example gap_table`.

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/src/gap_table.bin");
    std::fs::write(path, ihd_map::gap_table::compute()?)?;
    println!("{path}");
    Ok(())
}
