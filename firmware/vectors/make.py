#!/usr/bin/env python3
"""Writes the test vectors of the board protocol, from docs/board-protocol.md and nothing else.

Needs no package. Run it in this folder after a change of the protocol.
"""

import json
import struct
import zlib

TYPES = {
    "identify": 0x01, "start": 0x02, "stop": 0x03, "steer": 0x04, "identity": 0x81, "reply": 0x82, "ack": 0x83,
    "scan": 0x84, "error": 0x85, "long_scan": 0x86,
}


def i24(value):
    return struct.pack("<i", value)[:3]


def checked(message):
    return message + struct.pack("<I", zlib.crc32(message))


def stuffed(message):
    return b"".join(bytes([len(part) + 1]) + part for part in message.split(b"\0")) + b"\0"


def frame(message):
    return stuffed(checked(message))


def message(kind, **f):
    """The message of this type with these fields, without checksum."""
    head = bytes([TYPES[kind], 1])
    if kind == "identify":
        return head + bytes([f["minor"]] if f.get("minor") else [])
    if kind == "start":
        return head + struct.pack("<Iii", f["rate"], *f["park"]) + bytes([f["minor"]] if f.get("minor") else [])
    if kind == "stop":
        return head
    if kind == "steer":
        return head + struct.pack("<IiiHB", f["id"], *f["codes"], f["lease"], f["on_expiry"])
    if kind == "reply":
        return head + struct.pack("<BBI", f["request"], f["result"], f["rate"])
    if kind == "ack":
        return head + struct.pack("<IB", f["id"], f["result"])
    if kind == "error":
        return head + bytes([f["reason"], f["type"]])
    if kind == "scan":
        body = struct.pack("<IIB", f["sequence"], f["tick"], f["status"])
        return head + body + b"".join(map(i24, f["codes"]))
    if kind == "long_scan":
        tick = struct.pack("<Q" if f["status"] & 16 else "<I", f["tick"])
        body = struct.pack("<IBI", f["sequence"], f["status"], f["applied"]) + tick
        return head + body + b"".join(map(i24, f["codes"]))
    name = f["name"].encode()
    body = struct.pack("<IBBIIIBB", f["tick_hz"], f["converter_bits"], f["output_bits"], f["range"], f["slowest"],
                       f["fastest"], f["flags"], len(f["channels"]))
    body += b"".join(struct.pack("<BI", role, skew) for role, skew in f["channels"])
    body += bytes([len(name)]) + name
    if "minor" in f:
        body += struct.pack("<BBIB", f["minor"], f["tick_bits"], f["boot_id"], len(f["units"]))
        for unit in f["units"]:
            body += struct.pack("<BBib", unit["channel"], unit["unit"], unit["scale"], unit["exponent"])
            body += i24(unit["zero"])
    return head + body


def damaged(name, line, section="Frames"):
    return {"name": name, "section": section, "line": line.hex(), "messages": ["damaged"]}


def frames():
    stop = frame(message("stop"))
    whole = message("steer", id=42, codes=[1000, -2000], lease=200, on_expiry=1)
    wrong_crc = stuffed(whole + struct.pack("<I", zlib.crc32(whole) ^ 1))
    longest, too_long = bytes([0x7F, 1]) + bytes(range(244)), bytes([0x7F, 1]) + bytes(range(245))
    good = {"section": "Frames"}
    return [
        {"name": "one frame", **good, "line": frame(whole).hex(), "messages": [whole.hex()]},
        {"name": "two frames", **good, "line": (stop + frame(whole)).hex(),
         "messages": [message("stop").hex(), whole.hex()]},
        {"name": "empty frames", **good, "line": (b"\0\0" + stop + b"\0").hex(), "messages": [message("stop").hex()]},
        {"name": "an incomplete frame is no frame yet", **good, "line": stop[:-1].hex(), "messages": []},
        {"name": "longest message", **good, "line": frame(longest).hex(), "messages": [longest.hex()]},
        damaged("a message of 251 bytes", frame(too_long)),
        damaged("wrong checksum", wrong_crc),
        damaged("a byte is missing", frame(whole)[:3] + frame(whole)[4:]),
        damaged("the encoding points beyond the frame", b"\x09\x01\x00"),
        damaged("only a checksum", stuffed(struct.pack("<I", zlib.crc32(b"")))),
        {"name": "synchronisation after a lost byte", **good, "line": (frame(whole)[2:] + stop).hex(),
         "messages": ["damaged", message("stop").hex()]},
    ]


def requests():
    def good(name, kind, **fields):
        return {"name": name, "minor": fields.pop("board", 1), "message": message(kind, **fields).hex(),
                "request": {"type": kind, **fields}}

    def bad(name, raw, reason, minor=1):
        return {"name": name, "minor": minor, "message": raw.hex(), "error": reason}

    steer = message("steer", id=1, codes=[0, 0], lease=1, on_expiry=0)
    start = {"rate": 1_000_000, "park": [6554, -6554]}
    return [
        good("IDENTIFY of version 1.0", "identify", minor=0),
        good("IDENTIFY of version 1.0 to a board of version 1.0", "identify", minor=0, board=0),
        good("IDENTIFY of version 1.1", "identify", minor=1),
        good("IDENTIFY of a later version", "identify", minor=9),
        good("START of version 1.0", "start", **start, minor=0),
        good("START of version 1.1", "start", **start, minor=1),
        good("STOP", "stop"),
        good("STEER, park", "steer", id=0xFFFFFFFF, codes=[-32768, 32767], lease=65535, on_expiry=1),
        good("STEER, hold", "steer", id=0, codes=[-(1 << 31), (1 << 31) - 1], lease=0, on_expiry=0),
        bad("IDENTIFY of version 1.1 to a board of version 1.0", message("identify", minor=1), 4, 0),
        bad("START of version 1.1 to a board of version 1.0", message("start", **start, minor=1), 4, 0),
        bad("START with scans of a later version", message("start", **start, minor=2), 5),
        bad("unknown type 5", bytes([5, 1]), 2),
        bad("unknown type 0x7f", bytes([0x7F, 1, 9]), 2),
        bad("another major version", bytes([1, 2]), 3),
        bad("another version has precedence over an unknown type", bytes([0x7F, 2]), 3),
        bad("STOP with a body", message("stop") + b"\0", 4),
        bad("STEER without its last byte", steer[:-1], 4),
        bad("STEER with a byte too much", steer + b"\0", 4),
        bad("on_expiry 2", steer[:-1] + b"\2", 5),
        bad("a wrong length has precedence over a wrong value", steer[:-1] + b"\2\0", 4),
    ]


CODES = [1, -1, 131071, -131072, 65536, 40000, 256, -256, 40001, 12345, -12345]


def identity_fields(more):
    channels = [[0x10 * (k % 3 + 1) + k // 3, 4000 * k] for k in range(9)] + [[0, 36000]]
    fields = {"tick_hz": 1_000_000, "converter_bits": 18, "output_bits": 16, "range": 10_000, "slowest": 1000,
              "fastest": 20_000_000, "flags": 0, "channels": channels, "name": "Vector board"}
    if not more:
        return fields
    unit = {"channel": 9, "unit": 3, "scale": 7629, "exponent": -6, "zero": 6554}
    return {**fields, "flags": 2, "minor": 1, "tick_bits": 64, "boot_id": 0xC0DE5EED, "units": [unit]}


def answers():
    def one(title, kind, **fields):
        return {"name": title, "type": kind, "fields": fields, "frame": frame(message(kind, **fields)).hex()}

    all_channels = [(-1) ** k * 524287 * k for k in range(16)]
    return [
        one("IDENTITY of version 1.0", "identity", **identity_fields(False)),
        one("IDENTITY of version 1.0 of a board that speaks 1.1", "identity", **{**identity_fields(False), "flags": 3}),
        one("IDENTITY of version 1.1", "identity", **identity_fields(True)),
        one("START is done", "reply", request=2, result=0, rate=999_001),
        one("START is refused: rate", "reply", request=2, result=1, rate=0),
        one("START is refused: parking position", "reply", request=2, result=2, rate=1_000_000),
        one("STOP is done", "reply", request=3, result=0, rate=0),
        one("ACK, accepted", "ack", id=42, result=0),
        one("ACK, out of range", "ack", id=0xFFFFFFFF, result=1),
        one("ACK, not started", "ack", id=0, result=2),
        one("ERROR, corrupted frame", "error", reason=1, type=0),
        one("ERROR, unknown type", "error", reason=2, type=0x7F),
        one("ERROR, version", "error", reason=3, type=1),
        one("ERROR, length", "error", reason=4, type=4),
        one("ERROR, value", "error", reason=5, type=4),
        one("SCAN", "scan", sequence=258, tick=4294967295, status=5, codes=CODES),
        one("SCAN after the lease has expired", "scan", sequence=259, tick=999, status=2, codes=CODES),
        one("SCAN of sixteen channels", "scan", sequence=0xFFFFFFFF, tick=0, status=0, codes=all_channels),
        one("LONG_SCAN before any command", "long_scan", sequence=0, status=0, applied=0, tick=7, codes=CODES),
        one("LONG_SCAN with an applied command", "long_scan", sequence=1, status=8, applied=42, tick=1007, codes=CODES),
        one("LONG_SCAN, tick of 64 bits", "long_scan", sequence=2, status=24, applied=0xFFFFFFFF,
            tick=(1 << 64) - 1, codes=CODES),
        one("LONG_SCAN of sixteen channels", "long_scan", sequence=3, status=31, applied=1, tick=1 << 40,
            codes=all_channels),
    ]


def host():
    """What a host must find in what a board sends, at 1 MHz and 1 kHz with nine channels."""
    codes = list(range(9))

    def scan(sequence, tick, status=0):
        return frame(message("scan", sequence=sequence, tick=tick, status=status, codes=codes))

    def case(name, lines, **expected):
        none = {"scans": 0, "lost": 0, "repeated": 0, "late": 0, "corrupted": 0, "unknown": 0, "board_errors": 0,
                "overruns": 0, "leases_expired": 0, "clock_faults": 0}
        return {"name": name, "lines": [line.hex() for line in lines], "expected": {**none, **expected}}

    many = [scan(k, 1000 * k) for k in range(20)]
    bad = bytearray(many[7])
    bad[12] ^= 0x40
    wrap = [scan(k, (4294960000 + 1000 * k) % (1 << 32)) for k in range(20)]
    back = [scan(k, 1000 * k - (1500 if k == 12 else 0)) for k in range(20)]
    expired = [scan(k, 1000 * k, 2 if k >= 10 else 0) for k in range(20)]
    return [
        case("healthy scans", many, scans=20),
        case("full buffer: scans 5 to 8 were omitted", many[:5] + many[9:], scans=16, lost=4),
        case("a frame with a wrong byte", many[:7] + [bytes(bad)] + many[8:], scans=19, lost=1, corrupted=1),
        case("a repeated frame", many[:5] + many[4:], scans=20, repeated=1),
        case("two frames in the wrong order", many[:5] + [many[6], many[5]] + many[7:], scans=19, lost=1, late=1),
        case("the tick wraps at 2^32", wrap, scans=20),
        case("a single tick is earlier than the one before", back, scans=20, clock_faults=1),
        case("the lease expires", expired, scans=20, leases_expired=1),
        case("the converter was read too late", many[:5] + [scan(5, 5000, 4)] + many[6:], scans=20, overruns=1),
        case("another number of channels", many[:5] + [frame(message("scan", sequence=5, tick=5000, status=0, codes=[0] * 8))]
             + many[6:], scans=19, lost=1, unknown=1),
        case("a message of unknown type", many[:5] + [frame(bytes([0x99, 1]))] + many[5:], scans=20, unknown=1),
        case("an ERROR of the board", many[:5] + [frame(message("error", reason=1, type=0))] + many[5:], scans=20,
             board_errors=1),
    ]


def conversations():
    """Requests to a board with outputs of 16 bits that samples at 1 kHz only."""
    start = frame(message("start", rate=1_000_000, park=[300, -300], minor=0))
    started = frame(message("reply", request=2, result=0, rate=1_000_000))
    stop = frame(message("stop"))

    def steer(number, codes=(100, -200), lease=50, on_expiry=0):
        return frame(message("steer", id=number, codes=codes, lease=lease, on_expiry=on_expiry))

    def ack(number, result=0):
        return frame(message("ack", id=number, result=result))

    def error(reason, kind):
        return frame(message("error", reason=reason, type=kind))

    def step(at_ms, line, answers=(), outputs=(0, 0), expired=False):
        return {"at_ms": at_ms, "receive": line.hex(), "answers": b"".join(answers).hex(), "outputs": list(outputs),
                "lease_expired": expired}

    there, park = (100, -200), (300, -300)
    wrong_crc = stuffed(message("stop") + b"\1\2\3\4")
    look = b"\0"
    return [
        {"name": "before START", "steps": [
            step(1, stop, [frame(message("reply", request=3, result=0, rate=0))]),
            step(2, steer(1), [ack(1, 2)]),
            step(3, steer(2, codes=(40_000, 0)), [ack(2, 2)])]},
        {"name": "commands in order", "steps": [
            step(1, start, [started]),
            step(2, steer(7) + steer(8, (5, 6)), [ack(7), ack(8)], (5, 6)),
            step(3, stop, [frame(message("reply", request=3, result=0, rate=0))], (5, 6)),
            step(4, steer(9), [ack(9, 2)], (5, 6))]},
        {"name": "the lease expires, hold", "steps": [
            step(1, start + steer(1), [started, ack(1)], there),
            step(45, look, [], there),
            step(60, look, [], there, True),
            step(61, steer(2), [ack(2)], there)]},
        {"name": "the lease expires, park", "steps": [
            step(1, start + steer(1, on_expiry=1), [started, ack(1)], there),
            step(40, steer(2, on_expiry=1), [ack(2)], there),
            step(80, look, [], there),
            step(100, look, [], park, True)]},
        {"name": "a lease continues after STOP and after START with another parking position", "steps": [
            step(1, start + steer(1, on_expiry=1), [started, ack(1)], there),
            step(10, stop, [frame(message("reply", request=3, result=0, rate=0))], there),
            step(20, frame(message("start", rate=1_000_000, park=[-7, 7], minor=0)), [started], there),
            step(60, look, [], (-7, 7), True)]},
        {"name": "numbers out of range change nothing", "steps": [
            step(1, frame(message("start", rate=999_000, park=[0, 0], minor=0)),
                 [frame(message("reply", request=2, result=1, rate=0))]),
            step(2, frame(message("start", rate=1_000_000, park=[0, 32_768], minor=0)),
                 [frame(message("reply", request=2, result=2, rate=0))]),
            step(3, start + steer(1, on_expiry=1), [started, ack(1)], there),
            step(20, steer(2, codes=(-32_769, 0)), [ack(2, 1)], there),
            step(30, steer(3, lease=0), [ack(3, 1)], there),
            step(35, frame(message("start", rate=0, park=[0, 0], minor=0)),
                 [frame(message("reply", request=2, result=1, rate=1_000_000))], there),
            step(60, look, [], park, True)]},
        {"name": "messages that are not understood change nothing", "steps": [
            step(1, start + steer(1), [started, ack(1)], there),
            step(2, wrong_crc, [error(1, 0)], there),
            step(3, frame(bytes([5, 1])) + frame(bytes([0x7F, 1, 2, 3])), [error(2, 5), error(2, 0x7F)], there),
            step(4, frame(bytes([4, 2])), [error(3, 4)], there),
            step(5, frame(message("stop") + b"\0"), [error(4, 3)], there),
            step(6, frame(message("steer", id=2, codes=[0, 0], lease=50, on_expiry=2)), [error(5, 4)], there),
            step(7, b"\x11\x22\x33\0" + steer(3), [error(1, 0), ack(3)], there)]},
        {"name": "an echo of the own answers is dropped", "steps": [
            step(1, start, [started]),
            step(2, started + error(2, 5) + frame(bytes([0xFF, 1])) + frame(bytes([0x81, 2])), [])]},
        {"name": "minor versions", "steps": [
            step(1, frame(message("start", rate=1_000_000, park=[0, 0], minor=1)), [started]),
            step(2, frame(message("start", rate=1_000_000, park=[0, 0], minor=2)), [error(5, 2)])]},
        {"name": "a board of version 1.0", "minor": 0, "steps": [
            step(1, frame(message("identify", minor=1)), [error(4, 1)]),
            step(2, frame(message("start", rate=1_000_000, park=[0, 0], minor=1)), [error(4, 2)]),
            step(3, start, [started])]},
        {"name": "full transmit buffer", "scans": 5000,
         "meaning": "after START the board takes this number of scans while nothing is read, then a STEER arrives. "
                    "What is read then: whole SCANs, numbered from 0 without a gap, fewer than taken; then the ACK. "
                    "The next scan has the number 5000.",
         "start": start.hex(), "steer": steer(1).hex(), "ack": ack(1).hex()},
    ]


for file in (frames, requests, answers, host, conversations):
    with open(f"{file.__name__}.json", "w", encoding="utf-8") as out:
        json.dump(file(), out, indent=1)
        out.write("\n")
