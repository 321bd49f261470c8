//! The layout and accessibility of the page. This command makes the picture of the README:
//!
//! ```text
//! cargo test --test system portrait -- --ignored
//! ```

use std::collections::BTreeSet;
use std::path::Path;
use std::time::Duration;

use super::{DESK, FINE, daemon, page};
use crate::testkit::PATIENCE;

/// The elements that exceed the width of the window, are cut off, or overlap; must be empty.
pub(crate) const MISFITS: &str = "(() => {
    const wide = document.documentElement.scrollWidth > innerWidth ? ['the page is too wide'] : [];
    const boxes = [...document.querySelectorAll('section:not([hidden])')].map((s) => [s.id, s.getBoundingClientRect()]);
    for (const [id, box] of boxes) {
        if (box.right > innerWidth + 1 || box.left < -1) wide.push(id + ' leaves the window');
        for (const [other, b] of boxes) {
            if (id < other && box.left < b.right - 1 && b.left < box.right - 1 && box.top < b.bottom - 1 && b.top < box.bottom - 1)
                wide.push(id + ' lies over ' + other);
        }
    }
    for (const e of document.querySelectorAll('td, dd, dt, figcaption, button, h2')) {
        if (e.offsetParent && e.scrollWidth > e.clientWidth + 1 && e.clientWidth > 0 && getComputedStyle(e).display !== 'inline')
            wide.push(e.tagName + ' ' + e.textContent + ' is cut off');
    }
    return wide;
})()";

/// The lowest contrast between a text and its background, and that text.
pub(crate) const CONTRAST: &str = "(() => {
    const light = (c) => {
        const [r, g, b] = c.match(/[\\d.]+/g).slice(0, 3).map((x) => x / 255).map((x) => (x <= 0.04045 ? x / 12.92 : ((x + 0.055) / 1.055) ** 2.4));
        return 0.2126 * r + 0.7152 * g + 0.0722 * b;
    };
    let worst = [99, ''];
    for (const e of document.querySelectorAll('h1, h2, p, th, td, dt, dd, li strong, li span, label, figcaption, summary, button, #headline span')) {
        if (!e.offsetParent || !e.textContent.trim()) continue;
        let behind = e;
        while (getComputedStyle(behind).backgroundColor === 'rgba(0, 0, 0, 0)' && behind.parentElement) behind = behind.parentElement;
        const [a, b] = [light(getComputedStyle(e).color), light(getComputedStyle(behind).backgroundColor)];
        const contrast = (Math.max(a, b) + 0.05) / (Math.min(a, b) + 0.05);
        if (contrast < worst[0]) worst = [contrast, e.textContent];
    }
    return worst;
})()";

#[test]
fn the_page_fits_and_is_readable_in_two_themes_and_two_sizes() {
    let (_daemon, _stream, at) = daemon(
        "twin.fault = [{ kind = \"psd-dark\", psd = 1, at_s = 2.0, for_s = 0.3 }]\n\
        monitor.control = true\nmonitor.token = \"0123456789abcdef\"\n",
    );
    let mut page = page(at);
    page.until("document.querySelectorAll('.strips canvas').length >= 6");
    page.until("document.querySelector('#faults').innerText.includes('ended:')");
    page.until(FINE);
    page.until("document.querySelector('.strips .chart').chart?.data[0].length > 30"); // some data for the pictures
    for (size, name) in [(DESK, "1280"), ([390, 844], "390")] {
        page.size(size);
        for scheme in ["light", "dark"] {
            page.scheme(scheme);
            // Charts are drawn only when visible: scroll through the page once.
            page.eval("(async () => { for (let y = 0; y < document.body.scrollHeight; y += 400) { scrollTo(0, y); await new Promise((go) => setTimeout(go, 700)); } scrollTo(0, 0); })()");
            page.until("document.querySelectorAll('.spectra canvas').length >= 2");
            page.drawn();
            page.picture(&Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("page-{name}-{scheme}.png")));
            let misfits = page.eval(MISFITS);
            assert_eq!(misfits, serde_json::json!([]), "{name} {scheme}");
            let worst = page.eval(CONTRAST);
            assert!(worst[0].as_f64().unwrap() >= 4.5, "{name} {scheme}: {worst}");
        }
    }
    assert_eq!(page.complaints(), Vec::<String>::new());
}

#[test]
#[ignore = "a command that makes a picture for the documents"]
fn portrait() {
    let (_daemon, _stream, at) = daemon("");
    let mut page = page(at);
    page.size([1280, 1300]); // all charts are visible
    std::thread::sleep(Duration::from_secs(65)); // and filled with data
    page.until(FINE);
    page.thumbnail(&Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/live-page.png"), 940);
    assert_eq!(page.complaints(), Vec::<String>::new());
}

#[test]
fn every_control_is_reachable_by_keyboard_and_has_a_name() {
    let (_daemon, _stream, at) = daemon("monitor.control = true\nmonitor.token = \"0123456789abcdef\"\n");
    let mut page = page(at);
    page.until("!document.querySelector('#control').hidden");
    let wanted = page.eval(
        "[...document.querySelectorAll('select, input, button, summary, ol')].filter((e) => e.offsetParent).length",
    );
    let wanted = wanted.as_u64().unwrap() as usize;
    let mut seen = BTreeSet::new();
    for _ in 0..PATIENCE.as_secs() {
        page.press("Tab", 9);
        let at = page.eval("(() => {
            const e = document.activeElement;
            const name = e.labels?.[0]?.textContent.trim() || e.getAttribute('aria-label') || e.textContent.trim();
            const ring = getComputedStyle(e).outlineStyle !== 'none';
            return [e.tagName, e.id || e.value || e.dataset.command || name.slice(0, 40), name.length > 0, ring];
        })()");
        if at[0] == "BODY" {
            break;
        }
        assert_eq!((&at[2], &at[3]), (&true.into(), &true.into()), "no name or no visible focus: {at}");
        seen.insert(at[1].to_string());
    }
    // Tab reaches one of the radio buttons, and the arrow keys reach the others.
    assert_eq!(seen.len() + 4, wanted, "{seen:?}");
    page.eval("document.querySelector('#span input:checked').focus()");
    page.press("ArrowRight", 39);
    assert_eq!(page.eval("document.querySelector('#span input:checked').value"), "600");
    page.until(
        "(([first, second]) => second - first >= 1000)(document.querySelector('#strips .chart').chart?.data[0] ?? [])",
    );
    // The axis begins with the first pose, not before it.
    page.until(
        "(({ min, max }) => max - min < 600e3)(document.querySelector('#strips .chart').chart?.scales.x ?? {})",
    );
}
