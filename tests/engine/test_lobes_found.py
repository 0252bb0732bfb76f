"""Mirrors, glass and gaps found from pictures, by a run as it is typed."""

import json
from pathlib import Path

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from xml_for_tests import camera, paths

import isas_cli
from isas_cli.runtime import images

_SCENE = f"""<scene version="3.0.0">{paths("{depth}")}{camera(width=32)}<emitter type="constant"/>
<shape type="rectangle" id="back">
<transform name="to_world"><scale value="3"/><translate z="-2"/></transform>
<bsdf type="diffuse"><rgb name="reflectance" value="0.8"/></bsdf></shape>
<shape type="{{shape}}" id="ball">{{material}}</shape></scene>"""
_GREY = '<bsdf type="diffuse"><rgb name="reflectance" value="{0}"/></bsdf>'
_MASK = '<bsdf type="mask">{0}' + _GREY.format(0.05) + "</bsdf>"
_BLEND = '<bsdf type="blendbsdf">{0}' + _GREY.format(0.1) + '<bsdf type="conductor"/></bsdf>'
_NUMBER = '<float name="{0}" value="{1}"/>'
_TEXTURE = (
    '<texture type="bitmap" name="{0}"><string name="filename" value="map.exr"/>'
    '<string name="filter_type" value="nearest"/><boolean name="raw" value="true"/></texture>'
)
# Or the targets' noise would be where runs end.
_TOLD = "target.spp=1024"
# As leaves have it: there, or not.
_CUT_OUT = np.float32(np.indices((4, 4)).sum(0) % 2)[..., None]
_GRADED = np.random.default_rng(3).uniform(0.1, 0.9, (4, 4, 1)).astype(np.float32)


def found(folder: Path, material: str, key: str, *settings: str, depth=4, shape="sphere"):
    path = folder / "scene.xml"
    path.write_text(_SCENE.format(depth=depth, material=material, shape=shape))
    unknowns = json.dumps({f"ball.bsdf.{key}": {"start": 0.4}})
    run = isas_cli.run(
        *("scene=file", f"scene.path={path}", f"scene.unknowns={unknowns}", "report=false"),
        *("budget.iterations=150", "evaluation.count=2", "frames.views=0"),
        *("optimizer.lr=0.05", "optimizer.schedule=exponential", "estimator.batch=4096"),
        *("frames.snapshots=0", f"hydra.run.dir={folder / 'run'}", *settings),
    )
    return run.parameters()[f"ball.bsdf.{key}"], run


@pytest.mark.parametrize(
    "material, key, truth",
    [
        (_MASK.format(_NUMBER.format("opacity", 0.6)), "opacity.value", 0.6),
        (_BLEND.format(_NUMBER.format("weight", 0.7)), "weight.value", 0.7),
        (
            '<bsdf type="plastic"><rgb name="diffuse_reflectance" value="0.1"/></bsdf>',
            "diffuse_reflectance.value",
            0.1,
        ),
    ],
)
@pytest.mark.parametrize("depth", [4, -1])
def test_a_number_ends_at_the_truth(tmp_path, material, key, truth, depth):
    value, _ = found(tmp_path, material, key, _TOLD, depth=depth)
    assert np.abs(value - truth).max() < 0.01


@pytest.mark.parametrize("material, word", [(_MASK, "opacity"), (_BLEND, "weight")])
@pytest.mark.parametrize("texels", [_GRADED, _CUT_OUT], ids=["graded", "cut out"])
def test_a_texture_ends_at_the_truth(tmp_path, material, word, texels):
    images.write_exr(str(tmp_path / "map.exr"), texels, ["Y"], {})
    material = material.format(_TEXTURE.format(word))
    more = "estimator.batch=16384", "effects=full"
    _, run = found(tmp_path, material, f"{word}.data", _TOLD, *more, shape="rectangle")
    errors = run.history["parameter_rmse"]
    assert errors.iloc[-1] < 0.01, errors.tolist()


def test_where_no_value_fits_it_ends_at_the_least_loss(tmp_path):
    """Of pictures a third darker on one side, by a scan of the loss itself."""
    material = _BLEND.format(_NUMBER.format("weight", 0.7))
    path = tmp_path / "scene.xml"
    path.write_text(_SCENE.format(depth=4, material=material, shape="sphere"))
    scene = mi.load_file(str(path))
    params, key = mi.traverse(scene), "ball.bsdf.weight.value"

    def picture(weight: float, spp: int = 2048) -> np.ndarray:
        params[key] = mi.Float(weight)
        params.update()
        # Pixels are means over their squares, whatever the film's filter.
        film = mi.load_dict({"type": "hdrfilm", "width": 32, "height": 32, "pixel_format": "rgb",
                             "rfilter": {"type": "box"}})  # fmt: skip
        place = mi.ScalarTransform4f().look_at([0, 0, 4], [0, 0, 0], [0, 1, 0])
        sensor = mi.load_dict({"type": "perspective", "to_world": place, "film": film})
        with dr.suspend_grad():
            return np.array(mi.render(scene, sensor=sensor, spp=spp, seed=1))

    target = picture(0.7, 4096) * np.linspace(0.6, 1.1, 32)[None, :, None]
    images.write_exr(str(tmp_path / "target.exr"), target.astype(np.float32), [*"RGB"], {})
    weights = np.linspace(0.3, 0.8, 7)
    losses = [np.mean((picture(each) - target) ** 2) for each in weights]
    a, b, _ = np.polyfit(weights, losses, 2)
    least = -b / (2 * a)
    assert 0.02 < abs(least - 0.7) < 0.35  # or the truth would do
    value, _ = found(tmp_path, material, "weight.value", f"scene.targets=[{tmp_path}/target.exr]")
    assert np.abs(value - least).max() < 0.01, (value, least)
