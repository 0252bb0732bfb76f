"""Scenes of users' own: names, versions and paths that mean the same to every process."""

import subprocess
import sys
from pathlib import Path

import mitsuba as mi
import numpy as np
import pytest
from processes import isas

from isas_cli import records
from isas_cli.cli.app import main
from isas_cli.runtime import images
from isas_cli.scene import built, scene_file

pytestmark = pytest.mark.usefixtures("two_threads")

SIDES = '<integer name="width" value="8"/><integer name="height" value="8"/>'
FILM = f'<film type="hdrfilm">{SIDES}</film>'
PLACE = '<transform name="to_world"><lookat origin="0,0,4" target="0,0,0" up="0,1,0"/></transform>'
CAMERA = f'<sensor type="perspective">{PLACE}{FILM}</sensor>'
SKY = '<emitter type="constant"/>'
SHARED = f"""<scene version="3.0.0"><integrator type="path"/>{CAMERA}{SKY}
  <texture type="bitmap" id="paint"><string name="filename" value="paint.exr"/></texture>
  <texture type="checkerboard"/><bsdf type="plastic"/>
  <shape type="sphere" id="ball"><bsdf type="roughplastic">
    <ref id="paint" name="diffuse_reflectance"/><ref id="paint" name="specular_reflectance"/>
  </bsdf></shape></scene>"""
# Whose text is its address.
BATCH = SHARED.replace(CAMERA, f'<sensor type="batch"><sensor type="perspective"/>{FILM}</sensor>')


@pytest.fixture
def folder(tmp_path, rng):
    images.write_exr(tmp_path / "paint.exr", rng.random((4, 4, 3)), [*"RGB"], {})
    (tmp_path / "shared.xml").write_text(SHARED)
    return tmp_path


def load(path: Path, text: str):
    path.write_text(text)
    return scene_file.load(str(path), None)


TOLD = """
import sys
from isas_cli.runtime import backend
backend.start()
import mitsuba as mi
from isas_cli.engine import assemble
from isas_cli.scene import scene_file
for path in sys.argv[1:]:
    with backend.loading():
        scene, integrator, text = scene_file.load(path, None)
    params = mi.traverse(scene)
    print(path, assemble._content_hash(scene, integrator, params, text), *params.keys())
"""


def test_two_processes_call_everything_alike(folder):
    (folder / "batch.xml").write_text(BATCH)
    command = [sys.executable, "-c", TOLD, folder / "shared.xml", folder / "batch.xml"]
    first, second = (subprocess.run(command, capture_output=True, text=True) for _ in range(2))
    assert first.stdout == second.stdout != "", first.stderr
    assert "paint.data" in first.stdout and "object_" not in first.stdout


def test_what_has_no_id_is_called_by_its_order(folder):
    extra = '<bsdf type="diffuse" id="bsdf_1"/><bsdf type="diffuse" id="_unnamed_7"/></scene>'
    scene, *_ = load(folder / "it.xml", SHARED.replace("</scene>", extra))
    params = mi.traverse(scene)
    for key in ("paint.data", "texture_1.color0.value", "bsdf_0.diffuse_reflectance.value"):
        assert key in params
    # One of three, whose name another has already.
    assert "bsdf_1.reflectance.value" in params and "bsdf_2.reflectance.value" in params
    assert not [key for key in params.keys() if "object_" in key or "_unnamed_" in key]


def test_what_a_program_described_has_its_own_names():
    texels = {"type": "bitmap", "data": mi.TensorXf(np.full((2, 2, 3), 0.5, np.float32))}
    plastic = {"type": "plastic", "diffuse_reflectance": {"type": "ref", "id": "paint"}}
    scene = built.load(
        {"type": "scene", "paint": texels, "ball": {"type": "sphere", "bsdf": plastic}}
    )
    assert "paint.data" in mi.traverse(scene)


def test_a_property_that_no_plugin_reads_is_still_told(folder):
    text = SHARED.replace('<bsdf type="plastic"/>', '<bsdf type="plastic"><ref id="paint"/></bsdf>')
    with pytest.raises(Exception, match="unreferenced"):
        load(folder / "it.xml", text)


OLD = """<scene version="{version}"><integrator type="path">
  <integer name="{depth}" value="3"/><boolean name="{hide}" value="true"/></integrator>
  <sensor type="perspective"><float name="{near}" value="0.5"/><transform name="{place}">
    <lookat origin="0,0,4" target="0,0,0" up="0,1,0"/></transform></sensor>
  <emitter type="constant"/>
  <shape type="sphere" id="ball"><bsdf type="diffuse">
    <texture type="bitmap" name="{colour}"><string name="filename" value="paint.png"/>
      {tiles}</texture></bsdf></shape></scene>"""
CAMEL = {"depth": "maxDepth", "hide": "hideEmitters", "near": "nearClip", "place": "toWorld"}
SNAKE = {"depth": "max_depth", "hide": "hide_emitters", "near": "near_clip", "place": "to_world"}
TILES = '<float name="uscale" value="2"/><float name="voffset" value="0.5"/>'
TO_UV = '<transform name="to_uv"><translate y="0.5"/><scale x="2"/></transform>'


@pytest.mark.parametrize("version", ["0.5.0", "0.6.0"])
def test_an_older_file_means_what_mitsuba_makes_of_it(folder, rng, version):
    images.write_png(folder / "paint.png", rng.integers(0, 255, (4, 4, 3), dtype=np.uint8))
    old = OLD.format(version=version, colour="diffuseReflectance", tiles=TILES, **CAMEL)
    new = OLD.format(version="3.0.0", colour="reflectance", tiles=TO_UV, **SNAKE)
    (a, integrator, _), (b, *_) = (
        load(folder / f"{number}.xml", text) for number, text in enumerate((old, new))
    )
    assert integrator.max_depth == 3 and integrator.hide_emitters
    assert "ball.bsdf.reflectance.data" in mi.traverse(a)  # in floating point
    assert str(mi.traverse(a)) == str(mi.traverse(b))
    assert all(
        str(mi.traverse(a)[key]) == str(mi.traverse(b)[key]) for key in mi.traverse(a).keys()
    )
    # What Mitsuba renders from the file itself.
    whole = mi.load_file(str(folder / "0.xml"), optimize=False)
    pictures = [np.array(mi.render(each, spp=4, seed=1)) for each in (a, whole)]
    assert pictures[0].mean() > 0.01 and np.allclose(*pictures, atol=1e-3)


@pytest.mark.parametrize("version", ["2.0.0", "2.1.0"])
def test_a_file_of_mitsuba_2_is_one_of_mitsuba_3(folder, version):
    text = SHARED.replace('type="path"/>', 'type="path"><integer name="max_depth" value="3"/>')
    text = text.replace(f'="3"/>{CAMERA}', f'="3"/></integrator>{CAMERA}')
    scene, integrator, _ = load(folder / "it.xml", text.replace("3.0.0", version))
    assert integrator.max_depth == 3 and "paint.data" in mi.traverse(scene)


def test_a_run_goes_on_in_another_process_from_another_folder(folder, monkeypatch):
    """With a bitmap that two materials share, and paths that are relative to where it began."""
    images.write_exr(folder / "start.exr", np.full((4, 4, 3), 0.5), [*"RGB"], {})
    unknown = 'scene.unknowns={"paint.data": {"start": "start.exr"}}'
    small = ["estimator.batch=64", "evaluation.pixels=64", "target.spp=2", "frames.views=0"]
    begun = isas(
        folder,
        *("run", "scene=file", "scene.path=shared.xml", unknown, "sampler=uniform", *small),
        *("budget.iterations=2", "report=false", "hydra.run.dir=run"),
    )
    assert begun.returncode == 0, begun.stderr
    elsewhere = folder / "elsewhere"
    elsewhere.mkdir()
    resumed = isas(elsewhere, "run", f"resume={folder / 'run'}", "budget.iterations=4")
    assert resumed.returncode == 0, resumed.stderr
    run = records.load(folder / "run")
    assert run.keys == ["paint.data"] and run.history["iteration"].iloc[-1] == 4
    # A project that moves as a whole is found where it is then.
    assert run.config["scene"]["path"] == "shared.xml"
    (folder / "start.exr").unlink()
    monkeypatch.chdir(elsewhere)
    assert main(["export", "../run"]) == 0
    assert (folder / "run" / "result" / "paint.data.exr").exists()
