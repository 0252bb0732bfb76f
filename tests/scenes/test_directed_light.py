"""A lamp that is infinitely far: its direction and its power from what it lights and shades."""

import json

import isas_cli

SCENE = """<scene version="3.0.0">
  <integrator type="path"><integer name="max_depth" value="2"/></integrator>
  <emitter type="directional" id="sun"><vector name="direction" x="-0.5" y="-1" z="-0.3"/>
    <rgb name="irradiance" value="2, 1.5, 1"/></emitter>
  <emitter type="constant"><rgb name="radiance" value="0.1"/></emitter>
  <bsdf type="diffuse" id="matt"><rgb name="reflectance" value="0.7"/></bsdf>
  <shape type="rectangle" id="floor"><transform name="to_world"><scale value="3"/>
    <rotate x="1" angle="-90"/></transform><ref id="matt"/></shape>
  <shape type="sphere" id="ball"><point name="center" x="0" y="0.6" z="0"/>
    <float name="radius" value="0.5"/><ref id="matt"/></shape>
  <sensor type="perspective"><float name="fov" value="45"/>
    <transform name="to_world"><lookat origin="0.5,4,4" target="0,0.2,0" up="0,1,0"/></transform>
    <film type="hdrfilm"><integer name="width" value="24"/><integer name="height" value="24"/>
    </film></sensor>
</scene>"""
TURN = {"kind": "rotation", "objects": ["sun"]}


def test_direction_and_power_are_found_together(tmp_path):
    (tmp_path / "scene.xml").write_text(SCENE)
    poses = {"sun.along": TURN | {"axis": [1, 0, 0]}, "sun.across": TURN | {"axis": [0, 0, 1]}}
    blur = {"start": 8.0, "end": 0.5, "hold": 0.2}
    unknowns = {
        "sun.along": {"start": 15.0, "lr": 1.5, "blur": blur},
        "sun.across": {"start": -20.0, "lr": 1.5, "blur": blur},
        "sun.irradiance.value": {
            "start": [1.0, 1.0, 1.0],
            "lr": 0.04,
            "blur": {"start": 0.1, "end": 0.02},
        },
    }
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
    assert errors["sun.along"] < 4 and errors["sun.across"] < 4, "degrees"
    assert errors["sun.irradiance.value"] < 0.1
    assert last["image_rmse"] < 0.1 * first["image_rmse"]
