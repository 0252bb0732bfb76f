"""Colour profiles of three curves and a matrix (ICC, version 2), and the light of their numbers."""

from __future__ import annotations

import struct

import numpy as np

from isas_cli.runtime.images import srgb_decode

P3 = (0.680, 0.320), (0.265, 0.690), (0.150, 0.060)
SRGB = (0.64, 0.33), (0.30, 0.60), (0.15, 0.06)
_WHITE, _D50 = (0.3127, 0.3290), np.array([0.9642, 1, 0.8249])
_BRADFORD = np.array(
    [[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296]]
)


def matrix(primaries) -> np.ndarray:
    """From light of these primaries to CIE XYZ, white D65."""
    columns = [np.array([x / y, 1, (1 - x - y) / y]) for x, y in (*primaries, _WHITE)]
    red_green_blue = np.stack(columns[:3], axis=1)
    return red_green_blue * np.linalg.solve(red_green_blue, columns[3])


def light(numbers: np.ndarray, primaries, curve=srgb_decode) -> np.ndarray:
    """Of Rec. 709's primaries, ``(…, 3)``."""
    return curve(numbers) @ (np.linalg.inv(matrix(SRGB)) @ matrix(primaries)).T


def profile(primaries, gamma: float | None = None, name: str = "test", space=b"RGB ") -> bytes:
    """``gamma``: of its curves, or None for sRGB's, as tables."""
    white = matrix(primaries) @ np.ones(3)
    adapt = np.diag((_BRADFORD @ _D50) / (_BRADFORD @ white))
    columns = (np.linalg.inv(_BRADFORD) @ adapt @ _BRADFORD @ matrix(primaries)).T
    fixed = lambda values: b"".join(struct.pack(">i", round(v * 65536)) for v in values)
    if gamma is None:
        table = np.rint(srgb_decode(np.linspace(0, 1, 1024)) * 65535).astype(">u2").tobytes()
        curve = b"curv\0\0\0\0" + struct.pack(">I", 1024) + table
    else:
        curve = b"curv\0\0\0\0" + struct.pack(">IH", 1, round(gamma * 256))
    text = name.encode() + b"\0"
    tags = {
        b"desc": b"desc\0\0\0\0" + struct.pack(">I", len(text)) + text + bytes(78),
        b"cprt": b"text\0\0\0\0none\0",
        b"wtpt": b"XYZ \0\0\0\0" + fixed(_D50),
        **{c + b"XYZ": b"XYZ \0\0\0\0" + fixed(v) for c, v in zip((b"r", b"g", b"b"), columns)},
        **dict.fromkeys((b"rTRC", b"gTRC", b"bTRC", b"kTRC"), curve),
    }
    begin, entries, data = 132 + 12 * len(tags), b"", b""
    for tag, content in tags.items():
        entries += tag + struct.pack(">II", begin + len(data), len(content))
        data += content + bytes(-len(content) % 4)
    head = struct.pack(
        ">I4sI4s4s4s", begin + len(data), b"none", 0x02400000, b"mntr", space, b"XYZ "
    )
    head += struct.pack(">6H", 2026, 1, 1, 0, 0, 0) + b"acsp" + bytes(28) + fixed(_D50)
    return head + bytes(128 - len(head)) + struct.pack(">I", len(tags)) + entries + data
