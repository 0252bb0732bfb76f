"""Photographs of the glass, metal and plastic of `materials_joint`, by Mitsuba's `path` in
`scalar_rgb`: nothing of isas renders.

usage: _photographed_materials.py FOLDER

Writes FOLDER/000.exr, 001.exr, …, a picture a sensor: through a camera's curve, with the noise of
photons and of reading, in 8 bits, then developed by that curve and the exposure, both known, as of
a calibrated camera. In a process of its own, whose Mitsuba is the scalar one.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from _photographed_jar import taken

from isas_cli.runtime import backend, images

SCENE, PATHS = "materials_joint", 512
# Of a picture's brightest places, the share that may be white.
_WHITE = 0.001


def main(folder: Path) -> None:
    backend.start()
    import mitsuba as mi

    mi.set_variant("scalar_rgb")
    from isas_cli.scenes.materials_joint import build

    from isas_cli.config.compose import compose

    scene = build(**compose([f"scene={SCENE}"]).scene.arguments)
    scene["integrator"] = {**scene["integrator"], "type": "path"}
    loaded = mi.load_dict(scene)
    folder.mkdir(parents=True, exist_ok=True)
    seen = [
        np.array(mi.render(loaded, sensor=view, spp=PATHS, seed=view))[..., :3]
        for view in range(len(loaded.sensors()))
    ]
    # One exposure for all: an object is not to change its colour from view to view.
    exposure = 1 / np.quantile(np.concatenate([each.ravel() for each in seen]), 1 - _WHITE)
    rng = np.random.default_rng(0)
    for view, colour in enumerate(seen):
        alpha = np.ones((*colour.shape[:2], 1))
        encoded = taken(np.dstack([colour * exposure, alpha]), rng)[..., :3] / 255
        steep = ((encoded + 0.055) / 1.055) ** 2.4
        linear = np.where(encoded <= 0.04045, encoded / 12.92, steep) / exposure
        images.write_exr(folder / f"{view:03d}.exr", np.float32(linear), [*"RGB"], {})


if __name__ == "__main__":
    main(Path(sys.argv[1]))
