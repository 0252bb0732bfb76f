"""A small problem with a moving object, for the tests of plateau-reduced gradients."""

from __future__ import annotations

import mitsuba as mi
from isas_cli.scenes import stage
from scenes_for_tests import render_targets, without_targets

from isas_cli.config.schema import BlurConfig, PoseConfig, UnknownConfig

PLACE, COLOUR, RADIANCE = "ball.x", "ball.bsdf.reflectance.value", "ball.emitter.radiance.value"
# Where the gradient is taken: both slopes of both objectives are well off 0.
AT = (-0.2, 0.42)
SIGMA = (0.35, 0.14)
TRUTH = (0.2, 0.7)


def description() -> dict:
    """A ball of one grey before a grey wall, lit from the side: its shadow moves too."""
    to = mi.ScalarTransform4f
    return {
        "type": "scene",
        "integrator": {"type": "prb", "max_depth": 3},
        "sky": {"type": "constant", "radiance": 0.5},
        "lamp": {
            "type": "rectangle",
            "to_world": to().look_at(origin=[-2, 2, 2.5], target=[0, 0, 0], up=[0, 1, 0]),
            "emitter": {"type": "area", "radiance": 4.0},
        },
        "wall": {
            "type": "rectangle",
            "to_world": to().translate([0, 0, -0.6]).scale(3),
            "bsdf": {"type": "diffuse", "reflectance": 0.3},
        },
        "ball": {
            "type": "sphere",
            "center": [TRUTH[0], 0, 0],
            "radius": 0.35,
            "bsdf": {
                "type": "diffuse",
                "reflectance": {"type": "uniform", "value": TRUTH[1]},
            },
        },
        "sensor_000": stage.camera([0, 0, 3], (0, 0, 0), 35.0, 8),
    }


def glowing() -> dict:
    """The ball alone, as a light: its silhouette is seen by the camera and by nothing else."""
    scene = description()
    del scene["wall"], scene["lamp"]
    scene["integrator"] = {"type": "prb", "max_depth": 1}
    scene["ball"] |= {
        "bsdf": {"type": "diffuse", "reflectance": 0.0},
        "emitter": {"type": "area", "radiance": {"type": "uniform", "value": TRUTH[1]}},
    }
    return scene


def blurred_problem(
    at=AT, widths=SIGMA, glows: bool = False, blind: bool | str = False, point: bool = False
):
    """The problem at ``at``, (place, grey or radiance); targets are the truth, rendered well.
    ``blind``: with a camera more, before the other (or where it is "last" after it), that looks
    away. ``point``: by the light of a
    point alone."""
    poses = {
        PLACE: PoseConfig(
            kind="translation", objects=["ball"], directions=[[1, 0, 0]], at=[TRUTH[0]]
        )
    }
    blurs = [BlurConfig(start=width, end=width) for width in widths]
    unknowns = {
        PLACE: UnknownConfig(start=at[0], blur=blurs[0]),
        RADIANCE if glows else COLOUR: UnknownConfig(start=at[1], range=[0.0, 1.0], blur=blurs[1]),
    }
    scene = glowing() if glows else description()
    if point:
        del scene["sky"]
        scene["lamp"] = {"type": "point", "position": [-2.0, 2.0, 2.5], "intensity": 16.0}
    if blind:
        both = [stage.camera([0, 0, 3], (0, 0, 6), 35.0, 8), scene["sensor_000"]]
        scene["sensor_000"], scene["sensor_001"] = both[::-1] if blind == "last" else both
    p = without_targets(scene, unknowns, poses)
    render_targets(p, 256)
    return p
