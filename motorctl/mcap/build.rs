//! Generates the messages of a recording, and the schema in each file, from `proto/`.

use prost::Message;
use std::env;
use std::path::Path;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    println!("cargo:rerun-if-changed=proto");
    let files = protox::compile(["motord.proto", "foxglove/Log.proto"], ["proto"])?;
    let out = env::var("OUT_DIR")?;
    std::fs::write(Path::new(&out).join("schema.bin"), files.encode_to_vec())?;
    prost_build::Config::new().compile_fds(files)?;
    Ok(())
}
