"""Checks that the tables of trifacet export at PATH agree bit by bit as CSV and Parquet."""

import struct
import sys

import pandas


def bits(x):
    return "nan" if x != x else struct.pack("<d", x)


def same(csv, parquet):
    assert list(csv.columns) == list(parquet.columns), (list(csv.columns), list(parquet.columns))
    assert len(csv) == len(parquet) > 1000, (len(csv), len(parquet))
    for name in parquet.columns:
        a, b = csv[name], parquet[name]
        if b.dtype == "float64":
            assert [bits(x) for x in a] == [bits(x) for x in b], name
        elif b.dtype in ("int64", "uint64"):
            assert list(a) == list(b), name
        else:
            assert list(a.fillna("")) == list(b), name


path = sys.argv[1]
for what in ("", ".samples"):
    csv = pandas.read_csv(path + what + ".csv", float_precision="round_trip", keep_default_na=True)
    same(csv, pandas.read_parquet(path + what + ".parquet"))

frames = pandas.read_parquet(path + ".parquet")
units = {"tx_m": 1e-3, "yaw_rad": 1e-3, "sd_tz_m": 1e-4, "power_a_w": 1e-2}
for name, most in units.items():
    known = frames[name].dropna()
    assert len(known) > 1000 and known.abs().max() < most, (name, known.abs().max())
assert frames["status"].str.contains("SOURCE_DOWN").any()
assert str(frames["time_ns"].dtype) == "int64" and frames["time_ns"].is_monotonic_increasing
samples = pandas.read_parquet(path + ".samples.parquet")
assert {"code_0", "u_a_m", "power_c_w", "psd_a", "steering_x_m", "commanded_y_m"} <= set(samples.columns)
assert set(samples["psd_a"]) == {"good", "low"}
