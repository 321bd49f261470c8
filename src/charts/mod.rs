//! The charts of the live page and of the experiment's report: uPlot, and what both add to it.

/// uPlot, which defines `uPlot`. Its licence travels with every copy.
pub const UPLOT: &str =
    concat!("/*\n", include_str!("uplot/LICENSE"), "*/\n", include_str!("uplot/uPlot.iife.min.js"));

/// The style of uPlot and of [`PLOT`].
pub const STYLE: &str = concat!(include_str!("uplot/uPlot.min.css"), "\n", include_str!("plot.css"));

/// A module over uPlot: axes, lines with holes, marks, bars, and the values at the pointer.
pub const PLOT: &str = include_str!("plot.js");

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_embedded_library_has_the_stated_version_and_licence_and_closes_no_element() {
        let readme = include_str!("uplot/README.md");
        assert!(readme.contains("1.6.32") && UPLOT.contains("uPlot (v1.6.32)"));
        assert!(
            UPLOT.contains("Copyright (c) 2022 Leon Sorokin")
                && UPLOT.contains("Permission is hereby granted")
        );
        for text in [UPLOT, PLOT, STYLE] {
            assert!(!text.contains("</"));
        }
    }
}
