"""Reads a recording with three independent readers and prints the result.

A line for each frame: its reader, and the bytes 8 to 187 of the pose frame (docs/stream.md) made of its fields.
A line for each pose: its reader, time, position, orientation and the diagonal of the covariance.
"""

import struct
import sys
from pathlib import Path

from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

FIELDS = "session config sequence sample_index time_ns solve_delay_ns send_delay_ns status clock_quality lock iterations"


def frame(reader, m):
    head = [getattr(m, name) for name in FIELDS.split()]
    tail = [*m.beam_offset, m.steering_residual]
    spots = [*m.spot_a, *m.spot_b, *m.spot_c, m.power_a, m.power_b, m.power_c, m.steering_x, m.steering_y]
    body = struct.pack("<IIQQqIIIHBB6d9f", *head, *m.position, *m.rotation, *m.sd_position, *m.sd_rotation, *tail)
    print("frame", reader, (body + struct.pack("<HH11f", m.averaged, m.lost, *spots)).hex())


def pose(reader, m):
    p, q = m.pose.pose.position, m.pose.pose.orientation
    assert m.header.frame_id == "trifacet"
    time_ns = m.header.stamp.sec * 1_000_000_000 + m.header.stamp.nanosec
    numbers = [p.x, p.y, p.z, q.x, q.y, q.z, q.w, *[m.pose.covariance[7 * i] for i in range(6)]]
    print("pose", reader, time_ns, *[repr(float(x)) for x in numbers])


def tell(reader, topic, message):
    if topic == "/trifacet/frame":
        frame(reader, message)
    elif topic == "/trifacet/pose":
        pose(reader, message)


path = Path(sys.argv[1])
with path.open("rb") as file:
    for _, channel, message, decoded in make_reader(
        file, decoder_factories=[DecoderFactory()], validate_crcs=True
    ).iter_decoded_messages():
        tell("mcap", channel.topic, decoded)

with Reader(path) as bag:
    types = get_typestore(Stores.EMPTY)
    for connection in bag.connections:
        types.register(get_types_from_msg(connection.msgdef.data, connection.msgtype))
    for connection, _, raw in bag.messages():
        tell("rosbags", connection.topic, types.deserialize_cdr(raw, connection.msgtype))
