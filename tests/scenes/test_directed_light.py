"""Lamps from what they light and shade: a far one's direction and power; a near one's place and
colour, beside a metal that shows it."""

import json

import pytest
from xml_for_tests import camera, paths

import isas_cli

SCENE = f"""<scene version="3.0.0">{paths(2)}
  LAMP
  <emitter type="constant"><rgb name="radiance" value="0.1"/></emitter>
  <bsdf type="diffuse" id="matt"><rgb name="reflectance" value="0.7"/></bsdf>
  <shape type="rectangle" id="floor"><transform name="to_world"><scale value="3"/>
    <rotate x="1" angle="-90"/></transform><ref id="matt"/></shape>
  <shape type="sphere" id="ball"><point name="center" x="0" y="0.6" z="0"/>
    <float name="radius" value="0.5"/>BALL</shape>
  {camera("0.5,4,4", 24, target="0,0.2,0", fov=45)}
</scene>"""
MATT = '<ref id="matt"/>'
METAL = """<bsdf type="principled"><rgb name="base_color" value="0.8, 0.6, 0.4"/>
  <float name="metallic" value="0.8"/><float name="roughness" value="0.4"/></bsdf>"""
FAR = """<emitter type="directional" id="sun"><vector name="direction" x="-0.5" y="-1" z="-0.3"/>
  <rgb name="irradiance" value="2, 1.5, 1"/></emitter>"""
NEAR = """<shape type="rectangle" id="lamp"><transform name="to_world"><scale value="0.4"/>
  <rotate x="1" angle="90"/><translate x="0.6" y="2.2" z="-0.5"/></transform>
  <emitter type="area"><rgb name="radiance" value="12, 9, 6"/></emitter></shape>"""
TURN, MOVE = {"kind": "rotation", "objects": ["sun"]}, {"kind": "translation", "objects": ["lamp"]}
ANGLE = {"lr": 1.5, "blur": {"start": 8.0, "end": 0.5, "hold": 0.2}}
PLACE = {"lr": 0.03, "blur": {"start": 0.3, "end": 0.02, "hold": 0.2}}
# By name: the scene's parts, its poses, its unknowns, how far each may end from the truth,
# and what may be left of the images' error.
LAMPS = {
    "far": (
        (FAR, MATT),
        {"sun.along": TURN | {"axis": [1, 0, 0]}, "sun.across": TURN | {"axis": [0, 0, 1]}},
        {
            "sun.along": ANGLE | {"start": 15.0},
            "sun.across": ANGLE | {"start": -20.0},
            "sun.irradiance.value": {
                "start": [1.0, 1.0, 1.0], "lr": 0.04, "blur": {"start": 0.1, "end": 0.02},
            },
        },
        (4, 4, 0.1),
        0.1,
    ),
    "near": (
        (NEAR, METAL),
        {"lamp.place": MOVE | {"directions": [[1, 0, 0], [0, 0, 1]]}},
        {
            "lamp.place": PLACE | {"start": [-0.9, 0.7]},
            "lamp.emitter.radiance.value": {
                "start": [5.0, 5.0, 5.0], "lr": 0.2, "blur": {"start": 0.5, "end": 0.1},
            },
            "ball.bsdf.metallic.value": {
                "start": 0.3, "lr": 0.02, "blur": {"start": 0.1, "end": 0.02},
            },
        },
        # From 1.92, 4.6, 0.5; seen 0.11, 1.47, 0.001: a lamp farther off and brighter looks alike.
        (0.2, 2.0, 0.1),
        0.25,  # seen: 0.16
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", LAMPS)
def test_a_lamps_place_and_power_are_found_together(name, tmp_path):
    (lamp, ball), poses, unknowns, within, left = LAMPS[name]
    (tmp_path / "scene.xml").write_text(SCENE.replace("LAMP", lamp).replace("BALL", ball))
    run = isas_cli.run(
        *("scene=file", f"scene.path={tmp_path / 'scene.xml'}", "sampler=plateau"),
        *(f"scene.poses={json.dumps(poses)}", f"scene.unknowns={json.dumps(unknowns)}"),
        *("budget.iterations=600", "estimator.batch=1024", "target.spp=64", "evaluation.spp=16"),
        *("optimizer.schedule=cosine", "optimizer.final=0.02", "frames.views=0", "report=false"),
        f"hydra.run.dir={tmp_path / 'run'}",
    )
    first, last = (run.history.iloc[row] for row in (0, -1))
    errors = {key: last[f"parameter_rmse/{key}"] for key in unknowns}
    print(errors, last["seconds"])
    for key, most in zip(unknowns, within):
        assert errors[key] < most, key
    assert last["image_rmse"] < left * first["image_rmse"]
