//! The report in a browser.

use std::path::Path;

use super::done;
use crate::testkit::Browser;

/// Every chart must contain pixels in the colour of its first line.
const CHARTS: &str = "(() => {
    const color = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim().match(/[0-9a-f]{2}/g).map((x) => parseInt(x, 16));
    return [...document.querySelectorAll('.chart')].every((chart) => {
        const drawn = chart.querySelector('canvas');
        if (!drawn) return false;
        const copy = new OffscreenCanvas(drawn.width, drawn.height).getContext('2d', { willReadFrequently: true });
        copy.drawImage(drawn, 0, 0);
        const wanted = color(['allan', 'course'].includes(chart.dataset.kind) ? '--line-1' : '--mean');
        const { data } = copy.getImageData(0, 0, drawn.width, drawn.height);
        for (let i = 0; i < data.length; i += 4)
            if (data[i + 3] === 255 && wanted.every((c, k) => Math.abs(data[i + k] - c) < 2)) return true;
        return false;
    });
})()";

#[test]
fn the_report_is_self_contained_and_fits_desktops_phones_and_paper() {
    let (_folder, out) = done(&["--seed", "2", "--rest", "4"]);
    let mut page = Browser::open(&format!("file://{}", out.join("report.html").display()), [1280, 900]);
    page.until("document.body?.dataset.drawn === 'yes'");
    // Two charts for each of six axes, the bound, two Allan charts, two time series.
    assert_eq!(page.eval("document.querySelectorAll('.chart').length"), 17);
    let pictures = Path::new(env!("CARGO_TARGET_TMPDIR"));
    for size in [[1280, 900], [390, 844]] {
        page.size(size);
        for scheme in ["light", "dark"] {
            page.scheme(scheme);
            page.until(CHARTS);
            page.drawn();
            page.picture(&pictures.join(format!("experiment-{}-{scheme}.png", size[0])));
            let whole =
                "[...document.querySelectorAll('.scroll')].every((t) => t.scrollWidth <= t.clientWidth)";
            assert!(size[0] < 1000 || page.eval(whole) == true, "a table is cut off");
            assert_eq!(
                page.eval("document.documentElement.scrollWidth <= innerWidth"),
                true,
                "{size:?} {scheme}"
            );
            let text = page.eval("document.body.innerText").as_str().unwrap().to_owned();
            assert!(!text.contains("NaN") && !text.contains("{{") && !text.contains("undefined"), "{text}");
        }
    }
    // The printed report has the light theme and the width of a page.
    page.eval("dispatchEvent(new Event('beforeprint'))");
    assert_eq!(page.eval("document.documentElement.dataset.theme"), "light");
    page.until(
        "[...document.querySelectorAll('.pair canvas')].every((s) => s.getBoundingClientRect().width <= 340)",
    );
    assert_eq!(page.complaints(), Vec::<String>::new());
    let asked = page.requests();
    assert!(
        asked.iter().skip(1).all(|url| url.starts_with("data:")) && asked[0].starts_with("file:///"),
        "{asked:?}"
    );
    readme(&mut page, &pictures.join("experiment-figure.png"));
}

/// The figure of the README: only the first pair of charts.
fn readme(page: &mut Browser, to: &Path) {
    page.eval("dispatchEvent(new Event('afterprint'))");
    page.eval("document.body.replaceChildren(document.querySelector('.pair'))");
    page.scheme("light");
    page.size([900, 600]);
    let height = page.eval("Math.ceil(document.querySelector('.pair').getBoundingClientRect().bottom) + 4");
    page.size([900, height.as_u64().unwrap() as u32]);
    page.until("[...document.querySelectorAll('canvas')].every((s) => s.getBoundingClientRect().right <= innerWidth)");
    page.drawn();
    page.picture(to);
}
