//! What a person does with the data of the page: freeze, save, show on a wall.

use std::path::Path;

use super::{daemon, page};

const SAMPLE: &str = "Number(document.querySelector('#pose').dataset.sample)";

#[test]
fn a_frozen_page_keeps_its_values_says_so_and_continues_without_a_gap() {
    let (_daemon, mut stream, at) = daemon("");
    let mut page = page(at);
    page.until("document.querySelector('.strips .chart').chart?.data[0].length > 10");
    page.eval("document.querySelector('#freeze').click()");
    page.until("document.querySelector('#badges').innerText.includes('FROZEN at ')");
    let frozen = page.eval(SAMPLE).as_u64().unwrap();
    stream.until("two seconds later", |frame| frame.sample_index > frozen + 2000);
    assert_eq!(page.eval(SAMPLE), frozen);
    page.eval("document.querySelector('#freeze').click()");
    page.until(&format!("{SAMPLE} > {frozen} + 2000"));
    page.until("!document.querySelector('#badges').innerText.includes('FROZEN')");
    // The history fills the charts: all intervals follow each other.
    page.until(
        "(([first, ...rest]) => { const x = document.querySelector('.strips .chart').chart.data; \
         return x[0].length > 30 && !x[1].slice(-20).includes(null); })([0])",
    );
    assert_eq!(page.complaints(), Vec::<String>::new());
}

#[test]
fn the_data_of_the_charts_are_saved_as_a_table_and_as_a_picture() {
    let (_daemon, _stream, at) = daemon("");
    let mut page = page(at);
    page.until("[...document.querySelectorAll('.strips .chart')].every((e) => e.chart?.data[0].length > 10)");
    page.eval(
        "window.saved = []; URL.createObjectURL = (blob) => { \
         blob.arrayBuffer().then((bytes) => saved.push([blob.type, bytes.byteLength, new TextDecoder().decode(bytes)])); return '#'; };",
    );
    page.eval("document.querySelector('#csv').click()");
    page.eval("document.querySelector('#png').click()");
    page.until("saved.length === 2");
    let table = page.eval("saved.find(([type]) => type === 'text/csv')[2]");
    let lines: Vec<_> = table.as_str().unwrap().lines().collect();
    assert!(lines[0].starts_with("# trifacet, session "), "{}", lines[0]);
    let names: Vec<_> = lines[1].split(',').collect();
    assert_eq!((names.len(), names[0], names[2]), (20, "time_utc", "tx_m_min"));
    let row: Vec<_> = lines[5].split(',').collect();
    let [min, max, mean] = [2, 3, 4].map(|i| row[i].parse::<f64>().unwrap());
    assert!(row[0].ends_with('Z') && min <= mean && mean <= max, "{row:?}");
    let picture = page.eval("saved.find(([type]) => type === 'image/png')[1]");
    assert!(picture.as_u64().unwrap() > 10_000, "{picture}");
    assert_eq!(page.complaints(), Vec::<String>::new());
}

#[test]
fn on_a_wall_the_digits_fill_the_screen() {
    let (_daemon, _stream, at) = daemon("");
    let mut page = page(at);
    let digits = "document.querySelector('td.now').getBoundingClientRect().height / innerHeight";
    page.size([3840, 2160]);
    page.until("document.querySelector('.strips canvas')?.getBoundingClientRect().right > 1000");
    page.picture(&Path::new(env!("CARGO_TARGET_TMPDIR")).join("page-3840.png"));
    let empty = page.eval(digits).as_f64().unwrap();
    page.eval("document.querySelector('#wall').click()");
    page.until(&format!("{digits} > 0.08"));
    assert!(empty < 0.05, "{empty}");
    page.until("document.documentElement.scrollHeight <= innerHeight && document.documentElement.scrollWidth <= innerWidth");
    page.picture(&Path::new(env!("CARGO_TARGET_TMPDIR")).join("wall-3840.png"));
    // The browser remembers it.
    page.eval("location.reload()");
    page.until("document.body?.classList.contains('wall') === true");
    for size in [[1280, 900], [390, 844]] {
        page.size(size);
        page.until("document.documentElement.scrollWidth <= innerWidth");
        page.picture(&Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("wall-{}.png", size[0])));
    }
}
