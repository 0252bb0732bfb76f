"""Renders scenes by Mitsuba alone, without isas: a picture beside each file.

usage: _plain_mitsuba.py VARIANT SPP FILE…

Each FILE's picture is put into FILE.npy; of one that cannot be rendered, the reason into FILE.txt.
"""

from __future__ import annotations

import sys

import mitsuba as mi
import numpy as np


def main(variant: str, spp: int, paths: list[str]) -> None:
    mi.set_variant(variant)
    for path in paths:
        try:
            scene = mi.load_file(path, optimize=False)
            np.save(f"{path}.npy", np.array(mi.render(scene, spp=spp, seed=1)))
        except RuntimeError as error:
            with open(f"{path}.txt", "w", encoding="utf-8") as file:
                file.write(" ".join(str(error).split()))


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]), sys.argv[3:])
