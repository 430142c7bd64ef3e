"""Reads a capture with public packages only, in both ways of docs/captures.md, and compares the two.

    pip install mcap mcap-ros2-support numpy zstandard
    python tests/read_capture.py tests/fixtures/captures/*.mcap
"""

import json
import sys

import numpy as np
from mcap.reader import make_reader
from mcap_ros2.reader import read_ros2_messages


def by_layout(path):
    """Voltage, current and frequency steps by the documented layout."""
    v, i, steps = [], [], []
    with open(path, "rb") as file:
        reader = make_reader(file)
        assert reader.get_header().profile == "ihd-capture 1"
        for schema, channel, message in reader.iter_messages(topics=["/samples", "/f_sw"]):
            if channel.topic == "/f_sw":
                steps.append(json.loads(message.data)["f_sw_hz"])
            elif schema.name == "ihd/msg/Samples":
                _, _, v_unit, i_unit = np.frombuffer(message.data, "<f8", 4, 4)
                n = int.from_bytes(message.data[36:40], "little")
                pairs = np.frombuffer(message.data, "<i2", n, 40).reshape(-1, 2)
                v.append(pairs[:, 0] * v_unit)
                i.append(pairs[:, 1] * i_unit)
    return np.concatenate(v), np.concatenate(i), steps


def by_schema(path):
    """The same by the schema in the file, and the truth."""
    v, i, truth = [], [], []
    for message in read_ros2_messages(path, topics=["/samples", "/truth"]):
        m = message.ros_msg
        if message.channel.topic == "/truth":
            truth.append((m.t_s, m.r_ohm[0], m.l_h[0], m.i_a))
        else:
            pairs = np.array(m.vi).reshape(-1, 2)
            v.append(pairs[:, 0] * m.volt_per_code)
            i.append(pairs[:, 1] * m.ampere_per_code)
    return np.concatenate(v), np.concatenate(i), np.array(truth)


for path in sys.argv[1:]:
    v, i, steps = by_layout(path)
    v_again, i_again, truth = by_schema(path)
    assert np.array_equal(v, v_again) and np.array_equal(i, i_again), path
    # P / I_rms^2 and R differ by the harmonics only, so this ties samples and truth together.
    r_ohm = np.mean(v * i) / np.mean(i**2)
    print(f"{path}: {len(v)} pairs, f_sw {steps} Hz, P/I^2 {r_ohm:.3f} ohm, "
          f"truth {truth[:, 1].min():.3f} to {truth[:, 1].max():.3f} ohm in {len(truth)} periods")
