"""Decodes datagrams, each preceded by its length (u16), and prints every field, with floating-point numbers as bits."""

import json
import struct
import sys

from trifacet import Frame, FrameError


def bits(name, value):
    double = name in ("position", "rotation")
    if isinstance(value, tuple):
        return [bits(name, x) for x in value]
    if isinstance(value, float):
        return struct.unpack("<Q", struct.pack("<d", value))[0] if double else struct.unpack("<I", struct.pack("<f", value))[0]
    return value


data = sys.stdin.buffer.read()
while data:
    (length,) = struct.unpack_from("<H", data)
    datagram, data = data[2:2 + length], data[2 + length:]
    try:
        frame = Frame.decode(datagram)
        print(json.dumps({name: bits(name, value) for name, value in frame._asdict().items()}))
    except FrameError as error:
        print(json.dumps({"error": str(error)}))
