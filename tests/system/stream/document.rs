//! `docs/stream.md` agrees with the code: its tables are the same, and its example decodes and encodes to
//! the same bytes.

use trifacet::client::PoseFrame;
use trifacet::grade::remedy;
use trifacet_wire::byte_order::big_endian;
use trifacet_wire::layout::FIELDS;
use trifacet_wire::stream::{ClientCommand, Decoder, SubscriptionRequest};
use trifacet_wire::{LockState, Status};

const DOCUMENT: &str = include_str!("../../../docs/stream.md");

/// The cells of the table rows under a heading, without the header of the table.
fn table(heading: &str) -> Vec<Vec<String>> {
    let section = DOCUMENT.split("\n## ").find(|s| s.starts_with(heading)).expect(heading);
    let rows = section.lines().filter(|l| l.starts_with('|'));
    rows.skip(2)
        .map(|row| row.trim_matches('|').split('|').map(|cell| cell.trim().replace('`', "")).collect())
        .collect()
}

/// The bytes of the hex dump that begins with this text.
fn dump(start: &str) -> Vec<u8> {
    let at = DOCUMENT.find(&format!("```text\n{start}")).expect("the dump") + "```text\n".len();
    let end = DOCUMENT[at..].find("```").expect("its end");
    DOCUMENT[at..at + end].split_whitespace().map(|b| u8::from_str_radix(b, 16).unwrap()).collect()
}

#[test]
fn the_byte_table_agrees_with_the_code() {
    let documented: Vec<_> = table("The pose frame").into_iter().map(|row| row[..4].to_vec()).collect();
    let coded: Vec<_> = FIELDS
        .iter()
        .map(|f| {
            let kind = if f.count == 1 { f.kind.to_owned() } else { format!("{} x {}", f.kind, f.count) };
            vec![f.offset.to_string(), kind, f.name.to_owned(), f.unit.to_owned()]
        })
        .collect();
    assert_eq!(documented, coded);
}

#[test]
fn every_status_bit_and_lock_state_is_documented() {
    let documented: Vec<_> =
        table("Status bits").into_iter().map(|row| (row[0].clone(), row[1].clone())).collect();
    let coded: Vec<_> = Status::NAMES
        .iter()
        .map(|(bit, name)| (bit.0.trailing_zeros().to_string(), (*name).to_owned()))
        .collect();
    assert_eq!(documented, coded);
    let documented: Vec<_> =
        table("Lock states").into_iter().map(|row| (row[0].clone(), row[1].clone())).collect();
    let coded: Vec<_> =
        LockState::ALL.iter().map(|l| ((*l as u8).to_string(), l.name().to_owned())).collect();
    assert_eq!(documented, coded);
}

/// A cell without the addresses of its links: `[text](address)` becomes `text`.
fn without_links(cell: &str) -> String {
    let Some((before, rest)) = cell.split_once("](") else { return cell.to_owned() };
    let (before, text) = before.rsplit_once('[').expect("the beginning of the link");
    let (_, after) = rest.split_once(')').expect("the end of the address");
    format!("{before}{text}{}", without_links(after))
}

#[test]
fn the_remedies_of_status_bits_are_those_of_the_document() {
    let rows = table("Status bits");
    let mut last = String::new();
    for (row, (bit, name)) in rows.iter().zip(Status::NAMES) {
        let documented = match without_links(&row[4]).as_str() {
            "likewise" => last.clone(),
            text => text.to_owned(),
        };
        last.clone_from(&documented);
        let shown = remedy(*bit);
        // The document may continue with details.
        let needed = *bit != Status::POSE_VALID && !documented.is_empty();
        assert_eq!(needed, !shown.is_empty(), "{name}");
        assert!(documented.contains(shown), "{name}: {documented:?}, {shown:?}");
    }
}

#[test]
fn the_example_decodes_to_the_described_values_and_encodes_to_the_same_bytes() {
    let bytes = dump("54 46 50 31 01 01 c0");
    let frame = PoseFrame::decode(&bytes).unwrap();
    let expected = PoseFrame {
        session: 0x1234_5678,
        config: 0x9abc_def0,
        sequence: 1000,
        sample_index: 1002,
        time_ns: 1_795_262_400_123_456_789,
        solve_delay_ns: 85_000,
        send_delay_ns: 93_000,
        status: Status::POSE_VALID | Status::SAMPLE_GAP | Status::UNCALIBRATED | Status::SIMULATED,
        clock_quality: 18,
        lock: LockState::Locked,
        iterations: 2,
        pose: [12.5e-6, -8e-6, 20e-6, 30e-6, -45e-6, 60e-6],
        systematic: None,
        deviations: [0.99e-6, 0.99e-6, 0.63e-6, 1.77e-6, 1.77e-6, 2.5e-6],
        beam_offset: [0.25e-6, -0.5e-6],
        steering_residual: f32::NAN,
        averaged: 1,
        lost: 2,
        spots: [8e-6, 15e-6, -20e-6, 31e-6, 9e-6, 27e-6],
        powers: [266.7e-6, 266.5e-6, 266.8e-6],
        steering: [12.75e-6, -8.5e-6],
    };
    assert_eq!(frame.encode().to_vec(), bytes);
    let turned = dump("54 46 50 31 01 01 00 c0");
    assert_eq!(big_endian(&frame.encode()).to_vec(), turned, "{}", hex(&big_endian(&frame.encode())));
    assert_eq!(PoseFrame::decode_either(&turned).unwrap().encode().to_vec(), bytes);
    assert_eq!(expected.encode().to_vec(), bytes, "{}", hex(&expected.encode()));
}

/// The cells of the table rows that follow a line, as in `table`.
fn first_words(after: &str) -> Vec<String> {
    let rest = &DOCUMENT[DOCUMENT.find(after).expect(after)..];
    let rows = rest.lines().skip_while(|l| !l.starts_with('|')).skip(2).take_while(|l| l.starts_with('|'));
    rows.map(|row| row.split('`').nth(1).unwrap_or_default().to_owned()).collect()
}

#[test]
fn all_commands_are_documented_and_all_documented_commands_are_valid() {
    let commands = first_words("## TCP: lines");
    assert_eq!(commands[1..6], ["pose?", "status?", "descriptor?", "help", "bye"]);
    for command in &commands[1..6] {
        ClientCommand::parse(command.as_bytes()).unwrap();
    }
    let options = first_words("Options of `stream`");
    for option in ["format", "divider", "rate_hz", "fields", "held", "events"] {
        assert!(
            options.iter().any(|o| o.starts_with(&format!("{option}="))),
            "{options:?} do not contain {option}"
        );
        assert!(ClientCommand::help().contains(&format!("{option}=")));
    }
    assert_eq!(options.len(), 6);
    // The examples of subscriptions are valid too.
    let asks = DOCUMENT.lines().filter_map(|l| l.strip_prefix("> ")).filter(|l| l.contains("subscribe "));
    assert_eq!(
        asks.filter(|ask| matches!(SubscriptionRequest::parse(ask.as_bytes()), Some(Ok(_)))).count(),
        3
    );
}

#[test]
fn the_masks_for_controllers_agree_with_the_bits() {
    let page = include_str!("../../../docs/plc.md");
    let mut bits = 0;
    for line in page.lines().filter_map(|l| {
        l.trim_start_matches("required =").trim().trim_start_matches("+ ").strip_prefix("16#")
    }) {
        let mut words = line.split_whitespace();
        let number = u32::from_str_radix(&words.next().unwrap().replace('_', ""), 16).unwrap();
        let name = words.next().unwrap();
        assert_eq!(Status(number).names().collect::<Vec<_>>(), [name]);
        bits |= number & !1;
    }
    let mask = format!("16#{:04X}_{:04X}", bits >> 16, bits & 0xffff);
    assert_eq!(page.matches(&mask).count(), 3, "{mask}");
}

#[test]
fn the_example_of_a_message_decodes() {
    let bytes = dump("54 46 45 31");
    let mut decoder = Decoder::default();
    decoder.push(&bytes);
    let message = decoder.next_message().unwrap().unwrap();
    assert!(format!("{message:?}").contains("busy"), "{message:?}");
    assert_eq!(decoder.skipped(), 0);
}

fn hex(bytes: &[u8]) -> String {
    let lines = bytes.chunks(16).map(|l| l.iter().map(|b| format!("{b:02x}")).collect::<Vec<_>>().join(" "));
    lines.collect::<Vec<_>>().join("\n")
}
