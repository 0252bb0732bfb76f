"""`isas unknowns`: what a scene offers, and who sees it."""

import io
import json
from pathlib import Path

import numpy as np
import pytest
import trimesh
from processes import isas
from rich.console import Console
from xml_for_tests import camera

from isas_cli.cli import unknowns
from isas_cli.cli.app import main
from isas_cli.engine import offers
from isas_cli.engine.offers import Offer, Offers
from isas_cli.runtime import images
from isas_cli.unknowns import verdicts

# A lit floor that the first view sees alone, a lamp that both see, a ball that none does.
XML = """<scene version="3.0.0">
  <integrator type="path"><integer name="max_depth" value="{depth}"/></integrator>
  <emitter type="constant" id="sky"><rgb name="radiance" value="0.8"/></emitter>
  <shape type="rectangle" id="floor"><bsdf type="principled">
    <rgb name="base_color" value="0.5"/><float name="roughness" value="0.4"/></bsdf></shape>
  <shape type="rectangle" id="wall"><transform name="to_world"><scale value="9"/>
    <translate z="-4"/></transform><bsdf type="diffuse"/></shape>
  <shape type="sphere" id="ball"><point name="center" x="0" y="0" z="200"/>
    <bsdf type="diffuse"><rgb name="reflectance" value="0.3"/></bsdf></shape>
  <shape type="ply" id="box"><string name="filename" value="box.ply"/>
    <boolean name="face_normals" value="true"/><transform 
    name="to_world"><translate z="-300"/></transform></shape>
  {sensors}
</scene>"""


@pytest.fixture
def scene(tmp_path, monkeypatch):
    """Writes my.xml into the working folder, with views from in front and from behind."""
    monkeypatch.chdir(tmp_path)
    trimesh.creation.box().export(tmp_path / "box.ply")

    def write(places=(3, -3), depth: int = 3) -> None:
        sensors = "".join(camera(f"0,0,{z}", 8, 6) for z in places)
        (tmp_path / "my.xml").write_text(XML.format(depth=depth, sensors=sensors))

    write()
    return write


def listed(capsys, *arguments: str) -> dict[str, dict]:
    assert main(["unknowns", *arguments, "--json"]) == 0
    return {row["key"]: row for row in json.loads(capsys.readouterr().out)}


def test_a_process_of_its_own_prints_a_row_a_key(scene):
    done = isas(Path(), "unknowns", "my.xml")
    assert done.returncode == 0 and done.stderr == ""
    rows = [line for line in done.stdout.splitlines() if "floor.bsdf.base_color.value" in line]
    told = ["floor.bsdf.base_color.value", "value", "3", "0", "to", "1", "two_path"]
    assert rows[0].split()[:7] == told
    verdict = verdicts.verdict("principled", "base_color")
    assert " ".join(rows[0].split()).endswith(verdict)
    assert "scene.poses can move: " in done.stdout


def test_a_file_may_have_any_name(scene, capsys):
    Path("my.xml").rename("depth=3.xml")
    assert "floor.bsdf.base_color.value" in listed(capsys, "depth=3.xml")


def test_keys_are_printed_as_they_are_spelt(scene):
    """Brackets are no markup; and a long one leaves the other columns their place."""
    ids = "Wood [dark]", "mat-[/b]" + "x" * 60
    offers = [Offer(f"{name}.value", "value", (3,), 0, 1, "", "two_path", [0]) for name in ids]
    offers[1].refused, offers[0].note = "[red] is none", "see [dark]"
    for terminal in (True, False):
        text = io.StringIO()
        console = Console(file=text, width=80, force_terminal=terminal, color_system=None)
        unknowns.show(Offers(offers, 1, [ids[0]]), console)
        for told in (*ids, "kind", "two_path", "none: [red] is none", "see [dark]"):
            assert told in text.getvalue()


def test_the_censuss_verdicts_and_notes_are_told(scene, capsys, monkeypatch):
    table = {("Principled", "roughness"): ("right inside its range", "start above 0.03")}
    monkeypatch.setattr(verdicts, "_table", lambda: table)
    found = listed(capsys, "my.xml")
    rough = found["floor.bsdf.roughness.value"]
    assert (rough["verdict"], rough["note"]) == ("right inside its range", "start above 0.03")
    assert found["floor.bsdf.base_color.value"]["verdict"] == verdicts.UNKNOWN
    assert main(["unknowns", "my.xml"]) == 0
    assert "floor.bsdf.roughness.value: start above 0.03" in capsys.readouterr().out


def test_who_sees_what(scene, capsys):
    found = listed(capsys, "my.xml")
    assert found["sky.radiance.value"]["views"] == [0, 1]
    assert 0 in found["floor.bsdf.roughness.value"]["views"]
    assert found["ball.bsdf.reflectance.value"]["views"] == []
    assert found["ball.bsdf.reflectance.value"]["shape"] == [3]
    sky = found["sky.radiance.value"]
    assert (sky["low"], sky["high"], sky["unit"]) == (0, None, "radiance")
    # With the settings of the scene: nothing but lights.
    found = listed(capsys, "my.xml", "scene.max_depth=1")
    assert found["sky.radiance.value"]["views"] == [1]  # a wall fills the other
    assert found["floor.bsdf.roughness.value"]["views"] == []


def test_what_a_dark_lamp_will_light_is_seen(scene, capsys):
    dark = Path("my.xml").read_text().replace('value="0.8"', 'value="0"')
    Path("my.xml").write_text(dark)
    assert 0 in listed(capsys, "my.xml")["floor.bsdf.roughness.value"]["views"]


def test_what_replayed_paths_do_not_carry_says_who_takes_it(scene, capsys):
    poses = '{"turn": {"kind": "rotation", "objects": ["floor"]}}'
    found = listed(capsys, "my.xml", f"scene.poses={poses}")
    assert (found["turn"]["estimator"], found["turn"]["views"]) == ("plateau", None)
    assert (found["turn"]["unit"], found["turn"]["shape"]) == ("degrees", [1])
    # A mesh of facets: why it cannot be is told, and the others are listed still.
    assert "face normals" in found["box.vertices"]["refused"]


WAVES = '<texture type="bitmap"><string name="filename" value="waves.exr"/></texture>'
MATERIALS = """<emitter type="constant" id="sky"/>
  <shape type="rectangle" id="maps"><bsdf type="bumpmap">{waves}
    <bsdf type="twosided"><bsdf type="plastic"/></bsdf></bsdf></shape>
  <shape type="sphere" id="mirror"><bsdf type="conductor"/></shape>
  <shape type="sphere" id="air"><point name="center" value="3,0,0"/>
    <bsdf type="mask"><bsdf type="null"/></bsdf></shape>"""


def of_materials(hidden: bool = False, waves: str = WAVES) -> None:
    integrator = f"""<integrator type="path">
      <boolean name="hide_emitters" value="{str(hidden).lower()}"/></integrator>"""
    images.write_exr("waves.exr", np.eye(4, dtype=np.float32)[..., None], ["Y"], {})
    things = MATERIALS.format(waves=waves) + camera("0,0,3", 8, 6)
    Path("my.xml").write_text(f'<scene version="3.0.0">{integrator}{things}</scene>')


MIRROR = "mirror.bsdf.specular_reflectance.value"
UNDER = "maps.bsdf.nested_bsdf.brdf_0.diffuse_reflectance.value"


def test_one_material_that_is_refused_hides_no_other_key(scene, capsys):
    of_materials()
    found = listed(capsys, "my.xml")
    assert "twosided is under a bump or normal map" in found[UNDER]["refused"]
    assert not found[MIRROR]["refused"] and found[MIRROR]["views"] == [0]
    assert not found["sky.radiance.value"]["refused"]
    assert main(["unknowns", "my.xml"]) == 0
    assert "none: of a material with mirrors" in " ".join(capsys.readouterr().out.split())


def run_of(key: str) -> list[str]:
    unknowns = json.dumps({key: {"start": 0.4}})
    settings = "scene=file", "scene.path=my.xml", f"scene.unknowns={unknowns}"
    return ["run", *settings, "budget.iterations=1", "report=false"]


@pytest.mark.parametrize("hidden, key", [(True, MIRROR), (False, UNDER)])
def test_what_a_run_refuses_the_list_refuses_for_the_same_reason(
    scene, capfd, refused, hidden, key
):
    of_materials(hidden)
    told = listed(capfd, "my.xml")[key]["refused"]
    assert told and f"'{key}': {told}" in refused(run_of(key))


def test_the_opacity_of_what_lets_all_light_through_is_none(scene, capfd, refused):
    of_materials()
    assert "air.bsdf.opacity.value" not in listed(capfd, "my.xml")
    refused(run_of("air.bsdf.opacity.value"), "it changes nothing")


def test_a_texture_that_shows_one_row_or_column_is_listed(scene, capsys):
    """As Blender's mapping by an axis of no size has it."""
    images.write_exr("paint.exr", np.full((4, 4, 3), 0.5, np.float32), [*"RGB"], {})
    floor = """<shape type="rectangle" id="floor"><bsdf type="diffuse">
      <texture type="bitmap" name="reflectance"><string name="filename" value="paint.exr"/>
      <transform name="to_uv"><scale x="0" y="1"/></transform></texture></bsdf></shape>"""
    things = f'<integrator type="path"/><emitter type="constant"/>{floor}{camera("0,0,3", 8, 6)}'
    Path("my.xml").write_text(f'<scene version="3.0.0">{things}</scene>')
    found = listed(capsys, "my.xml")["floor.bsdf.reflectance.data"]
    assert found["views"] == [0] and not found["refused"]


def test_what_glows_does_not_ask_how_it_would_scatter(scene, capsys):
    medium = """<medium type="homogeneous" name="interior"><float name="sigma_t" value="0.5"/>
      <rgb name="albedo" value="0.3"/><phase type="hg"><float name="g" value="0.3"/></phase>
      </medium>"""
    box = f'<shape type="cube" id="box"><bsdf type="null"/>{medium}</shape>'
    things = f'<integrator type="emission"/><emitter type="constant"/>{box}{camera("0,0,5", 8, 6)}'
    Path("my.xml").write_text(f'<scene version="3.0.0">{things}</scene>')
    found = listed(capsys, "my.xml")
    assert found["box.interior_medium.sigma_t.value.value"]["views"] == [0]
    assert found["box.interior_medium.phase_function.g"]["views"] == []


def test_what_glows_says_why_its_extinction_is_no_unknown(scene, capsys):
    medium = """<medium type="homogeneous" name="interior"><rgb name="sigma_t" value="0.5"/>
      <rgb name="albedo" value="0.3"/></medium>"""
    box = f'<shape type="cube" id="box"><bsdf type="null"/>{medium}</shape>'
    things = f'<integrator type="emission"/><emitter type="constant"/>{box}{camera("0,0,5", 8, 6)}'
    Path("my.xml").write_text(f'<scene version="3.0.0">{things}</scene>')
    found = listed(capsys, "my.xml")
    assert "one number" in found["box.interior_medium.sigma_t.value.value"]["refused"]
    assert found["box.interior_medium.albedo.value.value"]["views"] == [0]


def test_what_mitsuba_cannot_trace_is_said_in_one_line(scene, refused):
    of_materials(waves='<texture type="checkerboard"/>')
    refused(["unknowns", "my.xml"], "scene.path=my.xml: Mitsuba cannot trace")


def test_a_full_memory_is_no_fault_of_the_scenes(scene, refused, monkeypatch):
    def full(problem):
        raise RuntimeError("jit_malloc(): out of memory!")

    monkeypatch.setattr(offers.onlookers, "of", full)
    refused(["unknowns", "my.xml"], "memory is full")


def test_scenes_of_isas_are_listed_too(capsys):
    found = listed(capsys, "scene=kirby", "size=tiny")
    vertices = found["figure.vertices"]
    assert vertices["chosen"] and vertices["estimator"] == "silhouettes"
    assert len(vertices["shape"]) == 2 and not found["figure.bsdf.reflectance.value"]["chosen"]
    found = listed(capsys, "scene=pottery", "size=tiny")
    assert found["jar.bsdf.base_color.data"]["views"] == [0, 1]


@pytest.mark.parametrize(
    "arguments, told",
    [
        (["nowhere.xml"], "scene.path=nowhere.xml: no such file"),
        (["my.xml", "other.xml"], "other.xml: one file is enough"),
        (["my.xml", "scene.max_dept=3"], "did you mean 'scene.max_depth'?"),
        (["my.xml", "--jsn"], "--jsn: no such flag"),
        ([], "scene=NAME"),
        (["scene=potery"], "did you mean 'pottery'?"),
    ],
)
def test_what_cannot_be_listed_is_refused_in_one_line(scene, refused, arguments, told):
    refused(["unknowns", *arguments], told)


def test_help(capsys):
    assert main(["unknowns", "--help"]) == 0
    assert "usage: isas unknowns FILE.xml" in capsys.readouterr().out
