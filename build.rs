//! Puts the page's chart library into the build: plotly.js, compressed once, as browsers take it.

use std::error::Error;
use std::fs::File;
use std::io::Write;
use std::path::Path;

use flate2::Compression;
use flate2::write::GzEncoder;

fn main() -> Result<(), Box<dyn Error>> {
    println!("cargo::rerun-if-changed=build.rs");
    let sources = plotly::Plot::offline_js_sources();
    // The first of two scripts, each in an element of its own; the other sets formulas, which no chart has.
    let script = sources
        .split_once("<script type=\"text/javascript\">")
        .and_then(|(_, rest)| rest.split_once("</script>"))
        .map(|(script, _)| script)
        .filter(|script| script.contains("plotly.js v"))
        .ok_or("the crate plotly no longer hands out plotly.js as its first script")?;
    let out = std::env::var("OUT_DIR")?;
    let mut gz = GzEncoder::new(File::create(Path::new(&out).join("plotly.js.gz"))?, Compression::best());
    gz.write_all(script.as_bytes())?;
    gz.finish()?;
    println!("cargo::rustc-env=TRIFACET_PLOTLY={:x}", script.len());
    Ok(())
}
