//! How the page looks, and that everybody can use it. The picture in the README is made by
//!
//! ```text
//! cargo test --test system portrait -- --ignored
//! ```

use std::collections::BTreeSet;
use std::path::Path;
use std::time::Duration;

use super::{DESK, FINE, daemon, page};
use crate::testkit::PATIENCE;

/// Everything fits into the width of the window: nothing is cut off, and nothing lies over anything else.
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

/// The least contrast of any text with what is behind it, with the text.
pub(crate) const CONTRAST: &str = "(() => {
    const light = (c) => {
        const [r, g, b] = c.match(/[\\d.]+/g).slice(0, 3).map((x) => x / 255).map((x) => (x <= 0.04045 ? x / 12.92 : ((x + 0.055) / 1.055) ** 2.4));
        return 0.2126 * r + 0.7152 * g + 0.0722 * b;
    };
    let worst = [99, ''];
    for (const e of document.querySelectorAll('h1, h2, p, th, td, dt, dd, li strong, li span, label, figcaption, summary, button, #verdict span')) {
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
fn two_themes_and_two_sizes_fit_and_can_be_read() {
    let (_daemon, _stream, at) = daemon(
        "twin.fault = [{ kind = \"psd-dark\", psd = 1, at_s = 2.0, for_s = 0.3 }]\n\
        monitor.control = true\nmonitor.token = \"0123456789abcdef\"\n",
    );
    let mut page = page(at);
    page.until("document.querySelectorAll('.strips canvas').length >= 6");
    page.until("document.querySelector('#faults').innerText.includes('over:')");
    page.until(FINE);
    page.until("document.querySelector('.strips .chart').chart?.data[0].length > 30"); // something in them, for the eye
    for (size, name) in [(DESK, "1280"), ([390, 844], "390")] {
        page.size(size);
        for scheme in ["light", "dark"] {
            page.scheme(scheme);
            // Charts are drawn when they are seen: once through the page.
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
#[ignore = "a command: it makes a picture for the documents"]
fn portrait() {
    let (_daemon, _stream, at) = daemon("");
    let mut page = page(at);
    page.size([1280, 1300]); // all charts are seen
    std::thread::sleep(Duration::from_secs(65)); // and full
    page.until(FINE);
    page.thumbnail(&Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/live-page.png"), 940);
    assert_eq!(page.complaints(), Vec::<String>::new());
}

#[test]
fn every_control_can_be_reached_by_keyboard_and_says_what_it_is() {
    let (_daemon, _stream, at) = daemon("monitor.control = true\nmonitor.token = \"0123456789abcdef\"\n");
    let mut page = page(at);
    page.until("!document.querySelector('#control').hidden");
    let wanted = page.eval(
        "[...document.querySelectorAll('select, input, button, summary')].filter((e) => e.offsetParent).length",
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
        assert_eq!((&at[2], &at[3]), (&true.into(), &true.into()), "without a name, or a focus to see: {at}");
        seen.insert(at[1].to_string());
    }
    // Of the radio buttons, one is reached with Tab and the others with arrows.
    assert_eq!(seen.len() + 4, wanted, "{seen:?}");
    page.eval("document.querySelector('#span input:checked').focus()");
    page.press("ArrowRight", 39);
    assert_eq!(page.eval("document.querySelector('#span input:checked').value"), "600");
    page.until(
        "(({ min, max }) => max - min === 600e3)(document.querySelector('#strips .chart').chart.scales.x)",
    );
}
