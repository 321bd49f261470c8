//! Extracts the chart library of the live page, plotly.js, and compresses it once for all browsers.

use std::error::Error;
use std::fs::File;
use std::io::Write;
use std::path::Path;

use flate2::Compression;
use flate2::write::GzEncoder;

fn main() -> Result<(), Box<dyn Error>> {
    println!("cargo::rerun-if-changed=build.rs");
    let sources = plotly::Plot::offline_js_sources();
    // The first of two scripts, each in its own element. The second renders formulas, which the charts do
    // not use.
    let script = sources
        .split_once("<script type=\"text/javascript\">")
        .and_then(|(_, rest)| rest.split_once("</script>"))
        .map(|(script, _)| script)
        .filter(|script| script.contains("plotly.js v"))
        .ok_or("the crate plotly no longer has plotly.js as its first script")?;
    let out = std::env::var("OUT_DIR")?;
    let mut gz = GzEncoder::new(File::create(Path::new(&out).join("plotly.js.gz"))?, Compression::best());
    gz.write_all(script.as_bytes())?;
    gz.finish()?;
    println!("cargo::rustc-env=TRIFACET_PLOTLY={:x}", script.len());
    Ok(())
}
