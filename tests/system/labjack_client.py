"""Reads and writes an emulated LabJack T7 with pymodbus, and reads its stream by the layout of the data sheet."""

import socket
import struct
import sys
import time

from pymodbus.client import ModbusTcpClient

registers_port, stream_port = map(int, sys.argv[1:])
client = ModbusTcpClient("127.0.0.1", port=registers_port)
assert client.connect()


def read(address, form):
    count = struct.calcsize(">" + form) // 2
    answer = client.read_holding_registers(address, count=count, device_id=1)
    assert not answer.isError(), answer
    return struct.unpack(">" + form, struct.pack(f">{count}H", *answer.registers))


def write(address, form, *values):
    data = struct.pack(">" + form, *values)
    words = struct.unpack(f">{len(data) // 2}H", data)
    return client.write_registers(address, list(words), device_id=1)


def written(address, form, *values):
    answer = write(address, form, *values)
    assert not answer.isError(), answer


assert read(60000, "f") == (7.0,)
assert read(60028, "I") == (470000000,)
assert read(55100, "I") == (0x00112233,)
assert write(55100, "I", 1).isError() and write(123, "H", 1).isError()

# The calibration: the four constants of the range of +-10 V.
written(61810, "I", 0x3C4000)
positive, negative, center, offset = read(61812, "ffff")
assert abs(positive + negative) < 1e-9 and 3.1e-4 < positive < 3.2e-4 and 33000 < center < 34000
# At 0 V the stage is at its end, and the beam misses facets: 2.5 V is the middle.
written(1000, "ff", 2.5, 2.5)
time.sleep(0.3)
sums = [read(2 * n, "f")[0] for n in (6, 3, 0)]
assert all(1 < volts < 10 for volts in sums), sums

# A stream of the three sums with the timer, at half the rate of the twin.
scan_list = [61520, 4899, 12, 6, 0]
written(4002, "f", 500.0)
written(4004, "I", len(scan_list))
written(4006, "I", 2 * len(scan_list))
written(4008, "f", 0.0)
written(4012, "I", 16384)
written(4016, "I", 1)
written(4018, "I", 0)
written(4100, f"{len(scan_list)}I", *scan_list)
stream = socket.create_connection(("127.0.0.1", stream_port)).makefile("rb")
written(4990, "I", 1)
assert read(4990, "I") == (1,) and read(4002, "f") == (500.0,)
assert write(4002, "f", 100.0).isError() and read(55000, "H") == (2605,)
ticks = []
for number in range(50):
    header = struct.unpack(">HHHBBBBHHH", stream.read(16))
    transaction, protocol, length, unit, function, kind, _, _, status, _ = header
    assert (transaction, protocol, unit, function, kind, status) == (number, 0, 1, 76, 16, 0), header
    samples = struct.unpack(">10H", stream.read(length - 10))
    for scan in (samples[:5], samples[5:]):
        ticks.append(scan[1] << 16 | scan[0])
        for code, volts in zip(scan[2:], sums):
            assert abs((code - center) * positive - volts) < 0.05, (code, volts)
for before, after in zip(ticks, ticks[1:]):
    assert abs((after - before) % 2**32 - 80000) <= 1, (before, after)

# Outputs are written while the stream runs, inputs are not read.
written(1000, "ff", 2.5, 3.75)
assert read(1000, "ff") == (2.5, 3.75)
assert client.read_holding_registers(0, count=2, device_id=1).isError()
written(4990, "I", 0)
assert read(4990, "I") == (0,)
print("understood")
