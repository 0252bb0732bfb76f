"""Pictures that a file's integrator shows otherwise than what replays it: measured, and said."""

import re

import mitsuba as mi
import numpy as np
import pytest
from xml_for_tests import camera

from isas_cli.config.schema import SceneConfig, UnknownConfig
from isas_cli.engine import assemble
from isas_cli.runtime import backend

INTEGRATOR = """<integrator type="{kind}"><integer name="max_depth" value="{depth}"/>
  <boolean name="hide_emitters" value="{hidden}"/></integrator>"""
RGB = '<string name="pixel_format" value="rgb"/>'
XML = f"""<scene version="3.0.0">{{integrator}}{camera("0,1,4", 12, 10, film=RGB)}
  <emitter type="constant"/>
  <shape type="rectangle"><transform name="to_world"><scale value="2"/><rotate x="1" angle="-90"/>
    <translate y="-1"/></transform><bsdf type="diffuse"/></shape>{{more}}</scene>"""
GAP = """<shape type="rectangle"><transform name="to_world"><translate z="1"/></transform>
  <bsdf type="mask"><float name="opacity" value="0.4"/><bsdf type="diffuse"/></bsdf></shape>"""
FOG = """<shape type="sphere"><bsdf type="null"/><medium type="homogeneous" name="interior">
  <float name="sigma_t" value="1"/></medium></shape>"""
HAIR = '<shape type="sphere"><bsdf type="hair"/></shape>'
GLASS = FOG.replace('type="null"', 'type="roughdielectric"')


def loaded(folder, more: str, kind: str, depth: int, hidden=False, **settings):
    """The problem, and what the file's own integrator shows in the mean, and what replays it."""
    integrator = INTEGRATOR.format(kind=kind, depth=depth, hidden=str(hidden).lower())
    if kind.startswith("direct"):  # whose paths have one length
        integrator = re.sub(r'<integer name="max_depth"[^>]*/>', "", integrator)
    path = folder / "scene.xml"
    path.write_text(XML.format(integrator=integrator, more=more))
    unknowns = {"emitter_0.radiance.value": UnknownConfig(start=1.0)}
    config = SceneConfig(name="file", path=str(path), unknowns=unknowns, **settings)
    made = assemble.bare(config)[0]
    given = {"type": kind, "hide_emitters": hidden}
    if not kind.startswith("direct"):
        given["max_depth"] = settings.get("max_depth", depth)
    means = []
    with backend.loading():
        own = mi.load_dict(given)
    for each in (own, made.integrator.mitsuba):
        seeds = [mi.render(made.scene, integrator=each, seed=s, spp=128) for s in range(4)]
        means.append([float(np.mean(np.array(image))) for image in seeds])
    return made.warnings, np.array(means)


@pytest.mark.parametrize(
    "kind, more", [("volpath", FOG), ("volpathmis", GLASS)], ids=["fog", "glass"]
)
@pytest.mark.parametrize("depth", [2, 3])
def test_few_edges_beside_media(tmp_path, kind, more, depth):
    (told,), (own, other) = loaded(tmp_path, more, kind, depth)
    assert f"replayed by prbvolpath, which adds some light by paths of more than {depth}" in told
    assert other.mean() - own.mean() > 4 * (own.std() + other.std()) / 2
    # As the warning advises.
    told, (own, other) = loaded(tmp_path, more, kind, depth, max_depth=-1)
    assert told == [] and abs(other.mean() / own.mean() - 1) < 0.01


@pytest.mark.parametrize("kind, count", [("volpath", 1), ("volpathmis", 1), ("prbvolpath", 0)])
def test_a_sensor_in_a_medium(tmp_path, monkeypatch, kind, count):
    """In fog that is as large as the scene, and as the sensor's own medium."""
    fog = FOG.replace('"sphere">', '"sphere"><float name="radius" value="9"/>')
    fog = fog.replace("<medium", '<medium id="air"').replace(
        'value="1"/></medium', 'value="0.2"/></medium'
    )
    monkeypatch.setitem(globals(), "XML", XML.replace("<film", '<ref id="air"/><film'))
    told, (own, other) = loaded(tmp_path, fog, kind, 60)
    assert len(told) == count and all("medium in which a sensor stands" in each for each in told)
    assert (abs(other.mean() / own.mean() - 1) > 0.05) == bool(count)


@pytest.mark.parametrize("kind", ["path", "direct"])
def test_a_medium_that_the_integrator_ignores(tmp_path, kind):
    (told,), _ = loaded(tmp_path, FOG, kind, 4)
    assert "what fills it is not simulated" in told and 'take <integrator type="volpath"/>' in told


def test_a_box_of_fog_that_is_inside_out(tmp_path):
    box = '"cube"><boolean name="flip_normals" value="{}"/><transform name="to_world">'
    box = FOG.replace('"sphere">', box + '<scale z="-1"/></transform>')
    (told,), _ = loaded(tmp_path, box.format("false"), "volpath", 60)
    assert "its normals point inwards" in told and "flip_normals the other way" in told
    assert loaded(tmp_path, box.format("true"), "volpath", 60)[0] == []


def test_boxes_of_fog_that_share_a_face(tmp_path):
    def found(x: float) -> list[str]:
        box = '"cube" id="{}"><transform name="to_world"><scale value="0.4"/><translate x="{}"/>'
        box = FOG.replace('"sphere">', box + "</transform>")
        return loaded(tmp_path, box.format("a", -x) + box.format("b", x), "volpath", 60)[0]

    (told,) = found(0.4)
    assert "shapes a and b share a face: a path" in told and "leave a gap" in told
    assert found(0.41) == []


@pytest.mark.parametrize("angle, pairs", [(90, 3), (45, 0)])
def test_a_row_of_boxes_of_fog_is_said_once_and_of_turned_ones_nothing(tmp_path, angle, pairs):
    """Boxes around boxes that were turned by 45 degrees share faces where these share none."""
    side, text = 0.2 * (1 if angle == 90 else 2**0.5), ""
    for number in range(4):
        box = f'"cube" id="b{number}"><transform name="to_world"><scale value="0.2"/>'
        box += f'<rotate z="1" angle="{angle}"/><translate x="{2 * side * (number - 1.5)}"/>'
        text += FOG.replace('"sphere">', f"{box}</transform>")
    found = loaded(tmp_path, text, "volpath", 60)[0]
    if not pairs:
        assert found == []
        return
    (told,) = found
    assert "shapes b0 and b1 share a face, the first of 3 pairs: a path" in told


def test_few_edges_and_gaps(tmp_path):
    (told,), (own, other) = loaded(tmp_path, GAP, "volpath", 2)
    assert "replayed by prb, which counts gaps among the 2 edges of a path" in told
    assert own.mean() / other.mean() > 1.05
    told, (own, other) = loaded(tmp_path, GAP, "volpath", 2, max_depth=-1)
    assert told == [] and abs(other.mean() / own.mean() - 1) < 0.01


def test_hidden_emitters_behind_gaps(tmp_path):
    (told,), (own, other) = loaded(tmp_path, GAP, "path", 4, hidden=True)
    assert "which shows hidden emitters behind gaps" in told and "without hide_emitters" in told
    assert other.mean() / own.mean() > 1.05
    told, (own, other) = loaded(tmp_path, GAP, "path", 4)
    assert told == [] and abs(other.mean() / own.mean() - 1) < 0.01


@pytest.mark.parametrize(
    "more, kind, depth, hidden",
    [
        (FOG, "prbvolpath", 3, False),
        (GAP, "prb", 3, True),
        (GAP, "direct", 2, True),
        (HAIR, "path", 4, True),
        ("", "volpath", 2, False),
        ("", "path", 3, True),
        (FOG, "volpath", 60, False),
    ],
)
def test_nothing_is_said_where_pictures_are_alike(tmp_path, more, kind, depth, hidden):
    told, (own, other) = loaded(tmp_path, more, kind, depth, hidden)
    assert told == [] and abs(other.mean() / own.mean() - 1) < 0.02


def test_prbvolpath_without_a_medium(tmp_path):
    (told,), (own, other) = loaded(tmp_path, "", "prbvolpath", 2)
    assert "replayed by prb, which adds no light by paths of more than 2 edges" in told
    assert own.mean() > other.mean()


MIRROR = """<shape type="sphere"><bsdf type="conductor"/></shape>"""


def test_a_direct_integrator_without_samples_of_materials(tmp_path, monkeypatch):
    """A mirror is black to it."""
    own = INTEGRATOR.replace("/></integrator>", "/>").rstrip()
    own += '<integer name="bsdf_samples" value="0"/><integer name="emitter_samples" value="4"/>'
    monkeypatch.setitem(globals(), "INTEGRATOR", f"{own}</integrator>")
    (told,), _ = loaded(tmp_path, MIRROR, "direct", 2)
    assert "takes no samples of materials (bsdf_samples)" in told


LAMP = """<shape type="sphere"><point name="center" x="0" y="-0.6" z="0"/>
  <float name="radius" value="0.4"/><emitter type="area"/>
  <bsdf type="diffuse"><rgb name="reflectance" value="0"/></bsdf></shape>"""
POINT = """<emitter type="point"><point name="position" x="0" y="1" z="0"/>
  <rgb name="intensity" value="20"/></emitter>"""


@pytest.mark.parametrize("kind", ["prb_projective", "direct_projective"])
def test_hidden_lamps_of_projective_integrators(tmp_path, kind):
    """They stay where a camera sees them, shining or dark."""
    (told,), (own, other) = loaded(tmp_path, LAMP, kind, 2, hidden=True)
    assert f"'{kind}' of the file is replayed by prb, which looks through hidden lamps" in told
    assert told.endswith("without hide_emitters they do not")
    assert abs(other.mean() / own.mean() - 1) > 0.02
    for more, hidden in ((LAMP, False), (GAP, True)):
        told, (own, other) = loaded(tmp_path, more, kind, 2, hidden=hidden)
        assert told == [] and abs(other.mean() / own.mean() - 1) < 0.02


def test_lights_that_chance_does_not_find(tmp_path, monkeypatch):
    (told,), (own, other) = loaded(tmp_path, POINT, "prb_basic", 2)
    assert "takes no samples of lights" in told and "with integrator 'prb' they" in told
    assert other.mean() / own.mean() > 1.05
    assert loaded(tmp_path, LAMP, "prb_basic", 2)[0] == []
    none = '<integer name="emitter_samples" value="0"/></integrator>'
    monkeypatch.setitem(globals(), "INTEGRATOR", INTEGRATOR.replace("</integrator>", none))
    (told,), _ = loaded(tmp_path, POINT, "direct", 2)
    assert "'direct' of the file takes no samples of lights" in told and "of 1 or more" in told
    assert loaded(tmp_path, LAMP, "direct", 2)[0] == []


def test_a_camera_in_a_medium_alone_that_it_does_not_name(tmp_path, monkeypatch):
    """isas's own paths begin within it, Mitsuba's outside."""
    fog = FOG.replace('"sphere">', '"sphere"><float name="radius" value="9"/>')
    alone = f"""<scene version="3.0.0">{{integrator}}{camera("0,1,4", 12, 10, film=RGB)}
      <emitter type="constant"/>{{more}}</scene>"""
    monkeypatch.setitem(globals(), "XML", alone)
    (told,), _ = loaded(tmp_path, fog, "volpath", 60)
    assert "stands within the medium, and does not name it" in told
    assert loaded(tmp_path, FOG, "volpath", 60)[0] == []
