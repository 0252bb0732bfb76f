"""scene=file: a user's own Mitsuba XML, with rendered targets and with pictures."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pandas
import pytest
from problems_for_tests import built
from runs_for_tests import ran
from xml_for_tests import camera

from isas_cli import records
from isas_cli.cli.app import main
from isas_cli.rendering import integrators, targets
from isas_cli.runtime import backend, images
from isas_cli.runtime.errors import InputError
from isas_cli.scene import built as described
from isas_cli.scene import scene_file
from isas_cli.unknowns.parameters import owner

KEY = "paint.brdf_0.base_color.data"
FEW = ["scene=file", "frames.spp=4", "target.spp=16", "estimator.batch=2048"]

SENSORS = camera("0.5,2,2.5", 24, 16, fov=45, film='<rfilter type="gaussian"/>')
SENSORS += camera("-1.5,2,1.5", 16, 20, fov=40)
EMITTER = '<emitter type="constant"><rgb name="radiance" value="0.8"/></emitter>'


def xml(
    integrator: str = "path",
    emitter: str = EMITTER,
    sensors: str = SENSORS,
    picture: str = "textures/floor.png",
    extra: str = "",
) -> str:
    """A floor whose two-sided material is named and referred to, and a ball that no view sees."""
    return f"""<scene version="3.0.0">
  <default name="rough" value="0.4"/>
  <integrator type="{integrator}"/>
  {emitter}
  <bsdf type="twosided" id="paint"><bsdf type="principled">
    <texture type="bitmap" name="base_color"><string name="filename" value="{picture}"/></texture>
    <float name="roughness" value="$rough"/></bsdf></bsdf>
  <shape type="rectangle" id="floor"><transform name="to_world"><rotate x="1" angle="-90"/>
    </transform><ref id="paint"/></shape>
  <shape type="sphere" id="ball"><point name="center" x="0" y="0" z="200"/>
    <bsdf type="diffuse"><rgb name="reflectance" value="0.3"/></bsdf></shape>
  {extra}{sensors}
</scene>"""


@pytest.fixture
def folder(tmp_path, monkeypatch, rng):
    """The working folder: own/scene.xml with its texture beside it."""
    (tmp_path / "own" / "textures").mkdir(parents=True)
    floor = (rng.random((8, 8, 3)) * 150 + 80).astype(np.uint8)
    images.write_png(tmp_path / "own" / "textures" / "floor.png", floor)
    (tmp_path / "own" / "scene.xml").write_text(xml())
    monkeypatch.chdir(tmp_path)
    return tmp_path


def unknowns(key: str = KEY, start="0.5", more: str = "") -> str:
    return f'scene.unknowns={{"{key}": {{"start": {start}{more}}}}}'


def run(*arguments: str) -> int:
    return main(["run", *FEW, *arguments])


POSE = '{"ball.x": {"kind": "translation", "objects": ["ball"], "directions": [[1, 0, 0]]}}'
TURN = '{"ball.x": {"kind": "rotation", "objects": ["ball"], "axis": [0, 1, 0]}}'
BLUR = ', "blur": {"start": 0.3, "end": 0.02, "hold": 0.2}'
PLATEAU = ["sampler=plateau", "budget.iterations=200", "target.spp=256", "frames.views=0"]
PLATEAU += ["scene.path=own/scene.xml", "hydra.run.dir=r", "optimizer.lr=0.05", "report=false"]
# Where the sampler is not what a test is about.
PLAIN = ["sampler=uniform", "effects=full", "report=false"]


def test_an_object_is_moved_to_where_the_file_has_it(folder, capsys):
    """A pose of one's own naming; the record follows its value, and the landscape shows the way."""
    near = xml().replace('z="200"/>', 'z="0"/><float name="radius" value="0.4"/>')
    (folder / "own" / "scene.xml").write_text(near)
    arguments = [*PLATEAU, f"scene.poses={POSE}", unknowns("ball.x", "0.5", BLUR)]
    assert run(*arguments) == 0, capsys.readouterr().err
    history = records.load(folder / "r").history
    assert history["parameter_rmse"].iloc[-1] < 0.1 * history["parameter_rmse"].iloc[0]
    moved = history["value/ball.x"].to_numpy()
    assert moved[0] == 0.5 and np.allclose(np.abs(moved), history["parameter_rmse"])
    capsys.readouterr()
    assert main(["landscape", "r", "--spp", "4"]) == 0, capsys.readouterr().err
    assert capsys.readouterr().out.strip() == "r/plots/landscape.png"
    drawn = pandas.read_csv(folder / "r" / "landscape.csv")
    assert abs(drawn["ball.x"][drawn["hard"].idxmin()]) < 0.1
    blurred = drawn.filter(like="blurred").iloc[:, 0]
    assert drawn["ball.x"].is_monotonic_increasing and blurred.min() > drawn["hard"].min()
    assert main(["landscape", "r", "--along", "bal.x"]) == 2
    assert "did you mean 'ball.x'" in capsys.readouterr().err
    (folder / "own" / "scene.xml").write_text(near.replace('value="0.4"', 'value="0.3"'))
    assert main(["landscape", "r"]) == 2
    assert "r: its scene has changed since" in capsys.readouterr().err
    again = ["overwrite=true", "budget.iterations=1", "scene.path=own/scene.xml", unknowns()]
    assert run(*again, *PLAIN, "hydra.run.dir=r") == 0
    assert not (folder / "r" / "landscape.csv").exists()  # of the run before


@pytest.mark.parametrize(
    "settings, words",
    [
        (["sampler=uniform"], "'ball.x' moves objects"),
        (["sampler=differences"], "sampler=differences looks at blurred renderings"),
        (["estimator.batch=1048576", "sampler.residual_spp=4098"], "estimator.residual_spp=4098"),
    ],
)
def test_what_sampler_and_scene_cannot_do_is_said_before_targets(
    folder, refused, monkeypatch, settings, words
):
    def slow(*arguments):
        raise AssertionError("targets are rendered")

    monkeypatch.setattr(targets, "render", slow)
    given = [f"scene.poses={POSE}", unknowns("ball.x", "0.5", BLUR), *settings]
    if not settings[0].startswith("sampler="):
        given.append("sampler=plateau")
    refused(["run", *FEW, *PLATEAU[1:], *given], words)


def test_a_slip_in_the_name_of_a_pose_is_told_as_one(folder, refused):
    told = "'bal.x' is no differentiable parameter; did you mean 'ball.x'"
    refused(["run", *FEW, *PLATEAU, f"scene.poses={POSE}", unknowns("bal.x", "0.5")], told)


@pytest.mark.parametrize(
    "pose, blur, words",
    [
        (POSE.replace('["ball"]', '["bal"]'), BLUR, "did you mean 'ball'"),
        (POSE.replace("kind", "knd"), BLUR, "scene.poses['ball.x'].knd: no such entry"),
        (
            POSE.replace("translation", "slide"),
            BLUR,
            "scene.poses['ball.x']: pose.kind=slide: valid",
        ),
        (
            POSE.replace('"kind": "translation", ', ""),
            BLUR,
            "scene.poses['ball.x'].kind is missing",
        ),
        (POSE.replace('"objects": ["ball"], ', ""), BLUR, "['ball.x'].objects is missing"),
        (POSE.replace('["ball"]', "[]"), BLUR, "['ball.x']: pose.objects=[]: at least one"),
        (
            POSE.replace("[[1, 0, 0]]", "[1, 0, 0]"),
            BLUR,
            "scene.poses['ball.x']: pose.directions: 1",
        ),
        (POSE.replace("[[1, 0, 0]]", '[[0, "a", 1]]'), BLUR, "pose.directions: [0, 'a', 1] is no"),
        (
            TURN.replace("[0, 1, 0]", '[0, "a", 1]'),
            BLUR,
            "scene.poses['ball.x'].axis[1]: Value 'a'",
        ),
        (
            POSE,
            ', "blur": {"strat": 1}',
            "['ball.x'].blur.strat: no such entry; did you mean 'start'",
        ),
        (POSE, ', "blur": {"start": "wide"}', "scene.unknowns['ball.x'].blur.start: "),
        (POSE, ', "blur": 0.5', "scene.unknowns['ball.x'].blur=0.5: give {start: "),
        (POSE, ', "blur": {"start": 1e300, "end": 1}', "blur.start=1e+300: must be above 0"),
        (POSE, "", "['ball.x'] has no blur"),
        (POSE, ', "blur": {"start": 0.3, "end": 0}', "scene.unknowns['ball.x']: blur.end=0"),
        (POSE, ', "blur": {"start": 0.3}', "blur.end=0"),
        (POSE, ', "blur": {"start": 0.3, "end": 0.1, "hold": 0.5, "until": 0.5}', "blur.until=0.5"),
    ],
)
def test_poses_that_make_no_sense_are_refused(folder, refused, pose, blur, words):
    given = f"scene.poses={pose}", unknowns("ball.x", "0.5", blur)
    refused(["run", *FEW, *PLATEAU, *given], words)


def test_the_files_values_are_the_truth_and_are_recovered(folder):
    arguments = ("scene.path=own/scene.xml", unknowns(), "budget.iterations=60")
    recorded = ran(folder / "r", *FEW, *arguments, *PLAIN)
    assert recorded.keys == [KEY]
    error = recorded.history["parameter_rmse"].to_numpy()
    assert error[-1] < 0.5 * error[0]
    assert recorded.manifest["views"] == [[24, 16], [16, 20]]
    floor = images.read("own/textures/floor.png")
    truth = images.read(next((folder / "r" / "frames").glob("truth_*.exr")))
    assert np.allclose(truth, floor, atol=1e-3)


def test_pictures_as_targets(folder):
    """Targets rendered with one seed and saved as EXR and PNG: the truth matches them, up to the
    noise of the target and the steps of 8 bits, and a run has no parameter error."""
    first = ("scene.path=own/scene.xml", unknowns(), "target.spp=256", "budget.iterations=1")
    rendered = ran(folder / "rendered", *FEW, *first, *PLAIN)
    frames = rendered.folder / "frames"
    images.write_exr("a.exr", images.read(frames / "target_v00.exr"), ["R", "G", "B"], {})
    images.write_png("b.png", images.to_display(images.read(frames / "target_v01.exr")))
    images.write_png("white.png", np.full((16, 24, 1), 255, np.uint8))
    half = np.full((20, 16, 1), 255, np.uint8)
    half[:, 8:] = 0
    images.write_png("half.png", half)

    given = ("scene.path=own/scene.xml", "scene.targets=[a.exr,b.png]", "estimator.batch=2048")
    arguments = ["scene=file", *given, "frames.spp=4", "evaluation.spp=256"]
    arguments += ['scene.unknowns={"%s": {}}' % KEY, "optimizer.lr=1e-6", "budget.iterations=1"]
    recorded = ran(folder / "at_truth", *arguments, *PLAIN)
    assert recorded.keys == []
    assert "parameter_rmse" not in recorded.summary["final"]
    # 8 bits: a step is at most 1/255 · 2.4 · 1.055 ≈ 0.01, its error a third of half of it.
    assert recorded.history["image_rmse"].iloc[0] < 0.01
    start = rendered.history["image_rmse"].iloc[0]
    assert recorded.history["image_rmse"].iloc[0] < 0.1 * start
    assert main(["report", "at_truth"]) == 0

    arguments.append("scene.masks=[white.png,half.png]")
    masked = ran(folder / "masked", *arguments)
    assert masked.summary["status"] == "done"
    # What is masked out has no error, whatever the target has there.
    error = images.read("masked/frames/error_v01.exr")
    assert (error[:, 8:] == 0).all() and error[:, :8].max() > 0
    spoilt = images.to_display(images.read(frames / "target_v01.exr"))
    spoilt[:, 8:] = 255
    images.write_png("b.png", spoilt)
    again = ran(folder / "spoilt", *arguments)
    both = [each.history["image_rmse"] for each in (masked, again)]
    np.testing.assert_allclose(*both, rtol=1e-6)


def test_keys_do_not_change_from_load_to_load(folder):
    keys = [list(mi.traverse(scene_file.load("own/scene.xml", None)[0]).keys()) for _ in range(2)]
    assert keys[0] == keys[1]
    assert "emitter_0.radiance.value" in keys[0]


def test_the_depth_is_the_files_unless_given(folder):
    nested = '<integrator type="path"><integer name="max_depth" value="3"/></integrator>'
    text = xml().replace('<integrator type="path"/>', nested)
    (folder / "own" / "deep.xml").write_text(text)
    assert "max_depth = 3" in str(scene_file.load("own/deep.xml", None)[1])
    assert "max_depth = 5" in str(scene_file.load("own/deep.xml", 5)[1])


ANY = 2**32 - 1  # edges


@pytest.mark.parametrize(
    "kind, depth",
    [
        ("direct", 2),
        ("direct_projective", 2),
        ("prb", 6),
        ("prb_projective", 6),
        ("path", 2**32 - 1),
    ],
)
def test_what_the_file_leaves_open_is_as_mitsuba_has_it(folder, kind, depth):
    (folder / "own" / "it.xml").write_text(xml(integrator=kind))
    assert scene_file.load("own/it.xml", None)[1].max_depth == depth


def integrator(kind: str, inside: str = "") -> str:
    channels = '<string name="aovs" value="dd:depth"/>' if kind == "aov" else ""
    return f'<integrator type="{kind}">{channels}{inside}</integrator>'


PATH = '<integrator type="path"><integer name="max_depth" value="5"/></integrator>'


@pytest.mark.parametrize(
    "around",
    [
        integrator("aov", PATH),
        integrator("moment", PATH),
        integrator("stokes", PATH),
        integrator("moment", integrator("aov", PATH)),
    ],
)
def test_of_integrators_around_a_path_integrator_that_alone_counts(folder, around):
    text = xml().replace('<integrator type="path"/>', around)
    (folder / "own" / "around.xml").write_text(text)
    found = scene_file.load("own/around.xml", None)[1]
    assert (type(found).__name__, found.max_depth) == ("PRBIntegrator", 5)


FOG = '<medium type="homogeneous" id="fog"><float name="sigma_t" value="0.1"/></medium>'


@pytest.mark.parametrize("kind", ["volpath", "volpathmis", "prbvolpath"])
def test_a_volumetric_integrator_is_one_where_there_is_a_medium(folder, kind):
    """Anywhere: what surrounds a camera is in no shape."""
    for text, found in (
        (xml(integrator=kind), "PRBIntegrator"),
        (xml(integrator=kind, extra=FOG), "PRBVolpathIntegrator"),
    ):
        (folder / "own" / "it.xml").write_text(text)
        assert type(scene_file.load("own/it.xml", 4)[1]).__name__ == found


SUN = """<emitter type="sunsky"><transform name="to_world">
  <rotate x="{0}" y="{0}" angle="30"/><scale z="-1"/></transform></emitter>"""


def test_a_sky_may_turn_and_mirror(folder):
    (folder / "own" / "it.xml").write_text(xml(emitter=SUN.format("0.7071")))
    assert scene_file.load("own/it.xml", None)[0].environment() is not None


BAD_FILES = {
    "broken": (xml()[:300], ["cannot load", "own/bad.xml"]),
    "empty": ("", ["cannot load"]),
    "no scene": ('<bsdf version="3.0.0" type="diffuse"/>', ["no <scene>"]),
    "no texture": (xml(picture="nowhere.png"), ["nowhere.png", "line"]),
    "no sensor": (xml(sensors=""), ["own/bad.xml", "sensor"]),
    "no emitter": (xml(emitter=""), ["own/bad.xml", "emitter"]),
    "no sky": (xml(integrator="emission", emitter=""), ["emission needs a sky", "of radiance 0"]),
    "light tracer": (xml(integrator="ptracer"), ["ptracer", "valid: path"]),
    "plugin": (xml(extra='<shape type="sfere"/>'), ["sfere", "line"]),
    "a sky that moves": (xml(emitter='<emitter type="timed_sunsky"/>'), ["take sunsky"]),
    "a light that no path finds": (
        xml(extra='<shape type="sphere"><emitter type="directionalarea"/></shape>'),
        ["directionalarea", "take it out"],
    ),
    "a sky that is stretched": (xml(emitter=SUN.format("1")), ["sunsky", "stretches", "length 1"]),
    "no path": (
        xml().replace('<integrator type="path"/>', integrator("aov")),
        ["'aov' holds 0 integrators"],
    ),
    "two paths": (
        xml().replace('<integrator type="path"/>', integrator("aov", PATH + PATH)),
        ["'aov' holds 2 integrators"],
    ),
    "property": (xml(extra='<bsdf type="diffuse"><float name="rgh" value="1"/></bsdf>'), ["rgh"]),
    "reference": (xml(extra='<shape type="sphere"><ref id="nope"/></shape>'), ["nope"]),
    "parameter": (xml().replace("$rough", "$ruff"), ["$ruff"]),
    "nothing to recover": (f'<scene version="3.0.0">{SENSORS}{EMITTER}</scene>', ["unknowns"]),
}


@pytest.mark.parametrize("name", BAD_FILES)
def test_bad_files_are_refused_in_one_line(folder, refused, name):
    text, parts = BAD_FILES[name]
    (folder / "own" / "bad.xml").write_text(text)
    refused(["run", *FEW, "scene.path=own/bad.xml", unknowns()], *parts)


def test_a_scene_of_python_is_told_how_to_become_xml(folder, refused):
    (folder / "own" / "it.py").write_text("scene = {}")
    refused(["run", *FEW, "scene.path=own/it.py", unknowns()], "own/it.py", "parser.write_file")


@pytest.mark.parametrize("name", ["it.glb", "it.PLY"])
def test_a_mesh_is_no_scene(folder, refused, name):
    (folder / "own" / name).write_text("")
    refused(["run", *FEW, f"scene.path=own/{name}", unknowns()], f"own/{name}", "photos.mesh=FILE")


def test_files_that_are_not_there_are_refused(folder, refused):
    refused(["run", *FEW, "scene.path=nowhere.xml", unknowns()], "nowhere.xml")
    refused(["run", *FEW, "scene.path=own", unknowns()], "scene.path=own")


BAD_UNKNOWNS = {
    "none": ("", [KEY]),
    "misspelt": (unknowns(KEY.replace("color", "colour")), [f"did you mean '{KEY}'?", "emitter_0"]),
    "moves": (unknowns("floor.to_world"), ["moves geometry", KEY]),
    "hidden": (unknowns("ball.bsdf.reflectance.value"), ["no view sees it"]),
    "above": (unknowns(start="1.5"), ["[0, 1]"]),
    "range": (unknowns(more=', "range": [1, 0]'), ["low < high"]),
    "rate": (unknowns(more=', "lr": 0'), ["lr=0.0"]),
    "stage": (unknowns(more=', "during": [0.5, 0.2]'), ["during=[0.5, 0.2]", "each larger"]),
    "stages": (unknowns(more=', "during": [0, 0.2, 0.4]'), ["during=[0.0, 0.2, 0.4]", "to, …]"]),
    "schedule": (unknowns(more=', "schedule": "cosin"'), ["schedule=cosin", "cosine"]),
    "final": (unknowns(more=', "final": 2'), ["final=2.0", "(0, 1]"]),
    "prior": (unknowns(more=', "prior": -1'), ["prior=-1.0", "at least 0"]),
    "a gap": (unknowns(more=', "during": [0.5, 1]'), ["the share 0 ", "no unknown moves"]),
    "shape": (unknowns(start="[1, 2]"), ["(8, 8, 3)"]),
    "kind": (unknowns(start="true"), ["start=True"]),
    "no start": (unknowns(start="null"), ["has no start"]),
    "no file": (unknowns(start='"nowhere.png"'), ["nowhere.png"]),
}


@pytest.mark.parametrize("name", BAD_UNKNOWNS)
def test_bad_unknowns_are_refused_in_one_line(folder, refused, name):
    given, parts = BAD_UNKNOWNS[name]
    refused(["run", *FEW, *filter(None, ["scene.path=own/scene.xml", given])], *parts)


@pytest.mark.parametrize(
    "targets, masks, parts",
    [
        ("a.png", "", ["1 file for 2 sensors"]),
        ("a.png,nowhere.png", "", ["nowhere.png"]),
        ("a.png,own/scene.xml", "", ["own/scene.xml"]),
        ("b.png,a.png", "", ["target b.png", "16×20", "24×16"]),
        ("a.png,b.png", "b.png,a.png", ["mask b.png", "16×20", "24×16"]),
        ("a.png,b.png", "a.png", ["scene.masks", "1 file for 2 sensors"]),
        ("a.png,b.png", "black.png,black2.png", ["every pixel"]),
    ],
)
def test_bad_targets_are_refused_in_one_line(folder, refused, targets, masks, parts):
    for name, shape, value in (
        ("a.png", (16, 24, 3), 99),
        ("b.png", (20, 16, 3), 99),
        ("black.png", (16, 24, 1), 0),
        ("black2.png", (20, 16, 1), 0),
    ):
        images.write_png(name, np.full(shape, value, np.uint8))
    given = ["scene.path=own/scene.xml", unknowns(), f"scene.targets=[{targets}]"]
    given += [f"scene.masks=[{masks}]"] if masks else []
    refused(["run", *FEW, *given, "target.spp=null"], *parts)


@pytest.mark.parametrize("said, works", [("auto", True), ("fp16", True), ("uint8", False)])
def test_a_bitmap_whose_format_is_said(folder, refused, said, works):
    file = folder / "own/scene.xml"
    text, line = file.read_text(), f'<string name="format" value="{said}"/>'
    begins = text.index(">", text.index('type="bitmap"')) + 1
    file.write_text(text[:begins] + line + text[begins:])
    command = [*FEW, *PLAIN, "scene.path=own/scene.xml", unknowns(), "budget.iterations=2"]
    if works:
        assert run(*command) == 0
        params = mi.traverse(scene_file.load("own/scene.xml", None)[0])
        assert type(params[KEY]) is mi.TensorXf
    else:
        refused(["run", *command], "holds whole numbers", "take the format of this bitmap out")


def test_the_largest_value_of_a_grid_follows_it(folder):
    """And not what the file says, beyond which Mitsuba samples distances wrongly."""
    mi.VolumeGrid(np.full((2, 2, 2), 0.5, np.float32)).write("own/grid.vol")
    smoke = """<shape type="cube" id="box"><medium type="heterogeneous" name="interior">
      <volume name="sigma_t" type="gridvolume"><string name="filename" value="grid.vol"/>
      <float name="max_value" value="1"/></volume></medium><bsdf type="null"/></shape>"""
    (folder / "own" / "it.xml").write_text(xml(integrator="volpath", extra=smoke))
    params = mi.traverse(scene_file.load("own/it.xml", None)[0])
    (key,) = (key for key in params.keys() if key.endswith("sigma_t.data"))
    params[key] = mi.TensorXf(np.full((2, 2, 2, 1), 3.0, np.float32))
    params.update()
    medium = owner(params, key)
    while not isinstance(medium, mi.Medium):
        medium = params.hierarchy[medium][0]
    assert medium.get_majorant(dr.zeros(mi.MediumInteraction3f), True).x[0] == pytest.approx(3)


def test_a_film_of_one_row_has_snapshots(folder):
    """Of 512 pixels every other one is shown, and the only row."""
    (folder / "own" / "it.xml").write_text(xml(sensors=camera("0.5,2,2.5", 512, 1, fov=45)))
    more = ["budget.iterations=2", "frames.snapshots=2", "report=false", "effects=full"]
    run = ran("r", *FEW, "scene.path=own/it.xml", unknowns(), *more, "sampler=uniform")
    assert images.read(run.folder / "frames/progress_v00_i000000.exr").shape == (1, 256, 3)


def test_an_integrator_with_a_property_that_it_has_not_is_refused(folder):
    text = xml().replace(
        '<integrator type="path"/>',
        '<integrator type="path"><integer name="max_dept" value="3"/></integrator>',
    )
    (folder / "own" / "scene.xml").write_text(text)
    with pytest.raises(InputError, match="max_dept"):
        scene_file.load("own/scene.xml", None)


def test_what_only_emits_needs_a_medium(folder):
    (folder / "own" / "scene.xml").write_text(xml(integrator="emission"))
    _, integrator, _ = scene_file.load("own/scene.xml", None)
    with pytest.raises(InputError, match="the integrator emission is for one medium"):
        integrators.adapt(integrator)


def test_files_beside_a_link_are_its_own(folder, rng):
    (folder / "variant/textures").mkdir(parents=True)
    (folder / "variant/scene.xml").symlink_to(folder / "own/scene.xml")
    white = np.full((8, 8, 3), 255, np.uint8)
    images.write_png(folder / "variant/textures/floor.png", white)
    loaded, *_ = scene_file.load("variant/scene.xml", None)
    assert np.array(mi.traverse(loaded)[KEY]).min() > 0.99
    (folder / "variant/textures/floor.png").unlink()
    loaded, *_ = scene_file.load("variant/scene.xml", None)  # then those beside the file
    assert np.array(mi.traverse(loaded)[KEY]).min() < 0.99


def test_files_beside_an_earlier_scene_are_not_taken(folder):
    scene_file.load("own/scene.xml", None)
    (folder / "other").mkdir()
    (folder / "other/scene.xml").write_text(xml())
    with pytest.raises(InputError, match="scene.path=other/scene.xml: Mitsuba cannot load it"):
        scene_file.load("other/scene.xml", None)


GROUP = """<shape type="shapegroup" id="clouds"><shape type="cube" id="cloud"><bsdf type="null"/>
  <medium type="heterogeneous" name="interior">
  <volume type="gridvolume" name="sigma_t"><string name="filename" value="grid.vol"/></volume>
  <volume type="constvolume" name="albedo"><rgb name="value" value="0.9"/></volume></medium>
  </shape></shape>
  <shape type="instance" id="one"><ref id="clouds"/></shape>"""


def test_media_in_groups_are_simulated_as_they_are(folder, rng):
    grid = rng.uniform(0.1, 0.9, (2, 3, 4, 1)).astype(np.float32)
    mi.VolumeGrid(grid).write(str(folder / "own" / "grid.vol"))
    (folder / "own" / "scene.xml").write_text(xml(integrator="volpath", extra=GROUP))
    loaded, integrator, _ = scene_file.load("own/scene.xml", None)
    assert integrator.handle_null_scattering and integrator.use_nee
    own = mi.load_dict({"type": "volpath"})
    shown, wanted = (np.array(mi.render(loaded, integrator=i, spp=256)) for i in (integrator, own))
    assert shown.mean() == pytest.approx(wanted.mean(), rel=0.01)


def test_targets_of_another_filter_and_of_a_whole_film_are_told(folder):
    """Pixels are means over their squares, and a crop is a part of its film."""
    images.write_exr(folder / "a.exr", np.full((16, 24, 3), 0.5, np.float32), [*"RGB"], {})
    images.write_exr(folder / "b.exr", np.full((20, 16, 3), 0.5, np.float32), [*"RGB"], {})
    words = ["scene=file", "scene.path=own/scene.xml", unknowns(), "scene.targets=[a.exr,b.exr]"]
    found = built(*words).warnings
    assert any("filter is GaussianFilter" in each for each in found), found
    window = SENSORS.replace(
        '<integer name="height" value="16"/>',
        '<integer name="height" value="16"/><integer name="crop_width" value="10"/>'
        '<integer name="crop_height" value="8"/><integer name="crop_offset_x" value="5"/>'
        '<integer name="crop_offset_y" value="2"/>',
    )
    assert window != SENSORS
    (folder / "own" / "scene.xml").write_text(xml(sensors=window))
    with pytest.raises(InputError, match="a window of 10×8: cut that out, from 5, 2 on"):
        built(*words)


def test_a_measured_material_is_known_by_what_its_file_holds(tmp_path):
    """Mitsuba's parameters do not tell it, and kept targets go by what does."""
    file, node, found = tmp_path / "metal.bsdf", mi.parser.SceneNode(), []
    node.props = mi.Properties("measured")
    node.props["filename"] = str(file)
    for content in (b"one", b"two", b"one"):
        file.write_bytes(content)
        found.append(scene_file._contents(node))
    assert found[0] == found[2] != found[1]


@pytest.mark.parametrize("name, kind", [("bytes.png", np.uint8), ("halves.exr", np.float16)])
def test_bitmaps_of_builders_hold_floats(tmp_path, name, kind):
    """Bytes have no derivative, and of halves Adam would step a copy."""
    with backend.loading():
        mi.Bitmap(np.full((2, 3, 3), 1, kind)).write(str(tmp_path / name))
        picture = {"type": "bitmap", "filename": str(tmp_path / name), "raw": True}
        ball = {"type": "sphere", "bsdf": {"type": "diffuse", "reflectance": picture}}
        params = mi.traverse(described.load({"type": "scene", "ball": ball}))
    assert type(params["ball.bsdf.reflectance.data"]) is mi.TensorXf
