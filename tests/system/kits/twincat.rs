//! The TwinCAT kit: its type has the layout of the byte table of the stream, its constants are those of the
//! code, and the grammar of TwinCAT accepts every file. The tests need no PLC.

use trifacet_wire::Status;
use trifacet_wire::layout::{FIELDS, FRAME_SIZE};

use super::tools::{python_with_packages, read, root, succeeded};

/// The section of a TwinCAT file with this tag.
fn part(file: &str, tag: &str) -> String {
    let text = read(&format!("clients/twincat/{file}"));
    let (_, rest) =
        text.split_once(&format!("<{tag}><![CDATA[")).unwrap_or_else(|| panic!("{file} has no {tag}"));
    rest.split("]]>").next().unwrap().to_owned()
}

/// Statements without their comments.
fn without_comments(text: &str) -> String {
    text.lines().map(|line| line.split("//").next().unwrap()).collect::<Vec<_>>().join("\n")
}

/// "ARRAY[0..2] OF LREAL" as type and count.
fn element(text: &str) -> (String, u16) {
    let Some(array) = text.strip_prefix("ARRAY[0..") else { return (text.to_owned(), 1) };
    let (last, kind) = array.split_once("] OF ").unwrap();
    (kind.to_owned(), last.parse::<u16>().unwrap() + 1)
}

/// The stream type with the same bits as a type of Structured Text, and its size.
fn same(st: &str) -> (&'static str, u16) {
    match st {
        "BYTE" | "USINT" => ("u8", 1),
        "UINT" => ("u16", 2),
        "UDINT" | "DWORD" => ("u32", 4),
        "ULINT" => ("u64", 8),
        "LINT" => ("i64", 8),
        "REAL" => ("f32", 4),
        "LREAL" => ("f64", 8),
        other => panic!("{other} is not a type of the frame"),
    }
}

/// Name, offset, type and count of every field, in the layout of TwinCAT with pack_mode 1.
fn structure() -> Vec<(String, u16, &'static str, u16)> {
    let declaration = part("ST_TrifacetFrame.TcDUT", "Declaration");
    assert!(declaration.contains("{attribute 'pack_mode' := '1'}\nTYPE ST_TrifacetFrame :\nSTRUCT\n"));
    let body = declaration.split("STRUCT\n").nth(1).unwrap();
    let mut end = 0;
    without_comments(body.split("END_STRUCT").next().unwrap())
        .split(';')
        .filter_map(|statement| statement.split_once(':'))
        .map(|(name, kind)| {
            let (st, count) = element(kind.trim());
            let (kind, size) = same(&st);
            let offset = end;
            assert_eq!(offset % size, 0, "{name} is aligned, so its offset does not depend on packing");
            end += size * count;
            (name.trim().to_owned(), offset, kind, count)
        })
        .collect()
}

#[test]
fn the_structure_has_the_layout_of_the_code() {
    let coded: Vec<_> = FIELDS.iter().map(|f| (f.name.to_owned(), f.offset, f.kind, f.count)).collect();
    let structure = structure();
    assert_eq!(structure, coded);
    let (_, offset, kind, _) = structure.last().unwrap();
    assert_eq!((usize::from(*offset) + 4, *kind), (FRAME_SIZE, "u32"));
}

#[test]
fn the_structure_has_the_layout_of_the_document() {
    let document = read("docs/stream.md");
    let section = document.split("\n## ").find(|s| s.starts_with("The pose frame")).unwrap();
    let documented: Vec<_> = section
        .lines()
        .filter_map(|line| {
            let cells: Vec<_> = line.split('|').map(str::trim).collect();
            let offset = cells.get(1)?.parse::<u16>().ok()?;
            let (kind, count) = cells[2].split_once(" x ").unwrap_or((cells[2], "1"));
            Some((
                cells[3].trim_matches('`').to_owned(),
                offset,
                kind.to_owned(),
                count.parse::<u16>().unwrap(),
            ))
        })
        .collect();
    let structure: Vec<_> =
        structure().into_iter().map(|(n, o, kind, c)| (n, o, kind.to_owned(), c)).collect();
    assert_eq!(structure, documented);
}

#[test]
fn the_status_bits_are_those_of_the_code() {
    let declaration = part("TrifacetStatus.TcGVL", "Declaration");
    let bits: Vec<_> = without_comments(&declaration)
        .split(';')
        .filter_map(|statement| statement.split_once(" := 16#"))
        .map(|(left, hex)| {
            let (name, kind) = left.rsplit_once(':').unwrap();
            assert_eq!(kind.trim(), "DWORD");
            let name = name.split_whitespace().last().unwrap().to_owned();
            (name, u32::from_str_radix(hex, 16).unwrap())
        })
        .collect();
    let mask = ("UNUSABLE".to_owned(), Status::UNUSABLE.0);
    let coded = Status::NAMES.iter().map(|(bit, name)| ((*name).to_owned(), bit.0)).chain([mask]);
    assert_eq!(bits, coded.collect::<Vec<_>>());
}

/// Extracts the table from the file and computes the two steps of the file with it.
#[test]
fn the_crc_is_that_of_the_stream() {
    let declaration = part("F_TrifacetCrc32.TcPOU", "Declaration");
    let table: Vec<u32> =
        declaration.split("16#").skip(1).map(|hex| u32::from_str_radix(&hex[..8], 16).unwrap()).collect();
    assert_eq!(table.len(), 16);
    let step = "nCrc := SHR(nCrc, 4) XOR aTable[DWORD_TO_UDINT(nCrc AND 16#F)];";
    assert_eq!(part("F_TrifacetCrc32.TcPOU", "ST").matches(step).count(), 2);
    let bytes: Vec<u8> = (0..=255).collect();
    let crc = bytes.iter().fold(u32::MAX, |crc, byte| {
        let half = |crc: u32| crc >> 4 ^ table[crc as usize & 15];
        half(half(crc ^ u32::from(*byte)))
    });
    assert_eq!(!crc, crc32fast::hash(&bytes));
}

#[test]
fn every_file_is_valid_structured_text_of_twincat() {
    let mut count = 0;
    for entry in std::fs::read_dir(root("clients/twincat")).unwrap() {
        let path = entry.unwrap().path();
        let mut command = python_with_packages();
        command.args(["-m", "blark", "parse", "--summary"]).arg(&path);
        let output = succeeded(&mut command, &path.display().to_string());
        // Without the name in the output, the parser has not read the file.
        let name = path.file_stem().unwrap().to_str().unwrap();
        assert!(String::from_utf8_lossy(&output.stdout).contains(name), "{name} was not parsed");
        count += 1;
    }
    assert_eq!(count, 5);
}
