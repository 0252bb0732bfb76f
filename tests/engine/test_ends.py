"""What is said of results at an end of their range, and of derivatives that are not right."""

from types import SimpleNamespace

import numpy as np
import pytest
import volumes_for_tests
from problems_for_tests import built
from runs_for_tests import QUIET, ran
from scenes_for_tests import ROUGHNESS, TEXTURE, dictionary, without_targets
from xml_for_tests import camera, paths

from isas_cli.config.schema import OptimizerConfig, PoseConfig, UnknownConfig
from isas_cli.engine import assemble, ends
from isas_cli.engine.optimiser import Stepper
from isas_cli.runtime import images

KEY = "ball.bsdf.brdf_0.weight.value"
BLEND = f"""<scene version="3.0.0">{paths(4)}{camera("0,1.2,4", fov=45)}<emitter type="constant"/>
<shape type="sphere" id="ball"><bsdf type="twosided"><bsdf type="blendbsdf">
<float name="weight" value="0.4"/><bsdf type="conductor"/>
<bsdf type="diffuse"><rgb name="reflectance" value="0.2,0.5,0.3"/></bsdf></bsdf></bsdf></shape>
</scene>"""


def problem(start: float, truth: float = 0.4):
    description = dictionary()
    description["wall"]["bsdf"]["roughness"] = truth
    return without_targets(description, {ROUGHNESS: UnknownConfig(start=start)})


def said(p, value: float) -> list[str]:
    like = p.unknowns[ROUGHNESS].start
    array = np.full_like(like, value)
    return ends.reached(p.unknowns, p.unknowns.values_of({ROUGHNESS: array}))


def test_an_end_is_named_and_whether_it_was_the_start():
    p = problem(0.5)
    low, high = p.unknowns[ROUGHNESS].low, p.unknowns[ROUGHNESS].high
    assert said(p, 0.3) == []
    (text,) = said(p, high)
    assert "ended at the high end" in text and ROUGHNESS in text and "began" not in text
    (text,) = said(p, low)
    assert "ended at the low end" in text
    (text,) = said(problem(high), high)
    assert "where it began" in text


def test_a_truth_at_the_end_is_no_news():
    p = problem(0.5, truth=1.0)
    assert p.unknowns[ROUGHNESS].high == pytest.approx(1.0) and said(p, 1.0) == []


def test_a_dim_light_is_not_at_the_end_of_its_range():
    """Which lies at 0: numbers of 1e-6 do not, where the light began as small."""
    sky = "sky.radiance.value"
    description = dictionary()
    description["sky"]["radiance"] = 1e-6
    p = without_targets(description, {sky: UnknownConfig(start=5e-7)})

    def said(value: float) -> list[str]:
        array = np.full_like(p.unknowns[sky].start, value)
        return ends.reached(p.unknowns, p.unknowns.values_of({sky: array}))

    (text,) = said(p.unknowns[sky].low)
    assert "ended at the low end" in text
    p.unknowns[sky].truth = None
    assert said(1.5e-6) == []


def test_texels_are_not_counted():
    p = without_targets(dictionary(), {TEXTURE: 0.5})
    black = np.zeros_like(p.unknowns[TEXTURE].start)
    assert ends.reached(p.unknowns, p.unknowns.values_of({TEXTURE: black})) == []


@pytest.mark.parametrize("bright, seen, told", [(1, 4, 0), (1, 2, 1), (4, 4, 1), (2, 0, 0)])
def test_many_texels_as_bright_as_can_be_are_said(bright, seen, told):
    """Of four rows, of those that views see; in one channel, as of a red object."""
    p = without_targets(dictionary(), {TEXTURE: 0.5})
    unknown = p.unknowns[TEXTURE]
    unknown.seen[:] = False
    unknown.seen[:seen] = True
    found = np.full_like(unknown.start, 0.5)
    found[:bright, :3, 0] = unknown.high
    lines = ends.reached(p.unknowns, p.unknowns.values_of({TEXTURE: found}))
    assert len(lines) == told
    if told:
        share = 0.75 * min(bright, seen) / seen
        assert f"'{TEXTURE}': {share:.0%} of its texels that views see" in lines[0]
    # Neither a truth nor a start that is so bright is news.
    for name in ("start", "truth"):
        before = getattr(unknown, name)
        setattr(unknown, name, found)
        assert ends.reached(p.unknowns, p.unknowns.values_of({TEXTURE: found})) == []
        setattr(unknown, name, before)


def test_a_run_says_that_it_did_not_leave_its_start(tmp_path, capsys):
    file = tmp_path / "blend.xml"
    file.write_text(BLEND)
    run = ["scene=file", f"scene.path={file}", f"scene.unknowns={{{KEY}: {{start: 1.0}}}}"]
    run += ["optimizer.lr=1e-9", "target.spp=4", "budget.iterations=2", "effects=full"]
    (note,) = ran(tmp_path / "run", *run, *QUIET, "estimator.batch=256").summary["notes"]
    assert note.startswith(f"'{KEY}' ended at the high end of its range, 1, where it began")
    assert note in capsys.readouterr().err.replace("\n", " ")


def test_settings_without_effect_are_said(tmp_path):
    file = tmp_path / "blend.xml"
    file.write_text(BLEND)
    unknown = "{start: 0.7, schedule: inverse, final: 0.1, blur: {start: 0.1, end: 0.01}}"
    run = ["scene=file", f"scene.path={file}", f"scene.unknowns={{{KEY}: {unknown}}}"]
    run += ["target.spp=4", "budget.iterations=2", "optimizer.filter=gaussian"]
    run += ["optimizer.schedule=cosine", "optimizer.final=0.3"]
    run += ["optimizer.filter.width=0.1", "effects.tolerance=0.1", "effects.finish=0.3", *QUIET]
    run += ["estimator.batch=256"]
    notes = ran(tmp_path / "run", *run).summary["notes"]
    assert any(note.startswith("optimizer.filter=gaussian has no effect") for note in notes)
    assert any(note.startswith("effects.tolerance=0.1 has no effect") for note in notes)
    assert any(note.startswith(f"'{KEY}': its blur has no effect") for note in notes)
    assert any(note.startswith("effects.finish=0.3 has no effect") for note in notes)
    assert any(note.startswith("optimizer.schedule=cosine has no effect: every") for note in notes)
    assert any(note.startswith("optimizer.final=0.3 has no effect: rates fall") for note in notes)
    assert any(note.startswith(f"'{KEY}': its final=0.1 has no effect") for note in notes)


def test_a_factor_of_what_is_unknown_is_said():
    def told(**roles: str) -> list[str]:
        names = {
            key.replace("_", ".").replace("bsdf.", "bsdf_"): role for key, role in roles.items()
        }
        return assemble._products(
            [SimpleNamespace(key=k, kind=SimpleNamespace(role=role)) for k, role in names.items()]
        )

    assert told(sky_data="light", lamp_scale="light") == []
    assert told(bumps_scale="", bumps_nested_reflectance="colour") == [], "a bump map's height"
    (scale,) = told(sky_data="light", sky_scale="light")
    assert scale.startswith("'sky.scale' multiplies 'sky.data', and images tell their product")
    (slide,) = told(spot_intensity_value="light", spot_texture_data="light")
    assert "'spot.intensity.value' multiplies 'spot.texture.data'" in slide
    assert told(spot_intensity_value="light", lamp_texture_data="light") == []
    (mixed,) = told(rust_weight_value="", rust_bsdf_1_reflectance_value="colour")
    assert "'rust.weight.value' multiplies 'rust.bsdf_1.reflectance.value'" in mixed
    assert told(rust_weight_value="", rust_bsdf_1_alpha_value="") == []


LAMP = f"""<scene version="3.0.0">{paths(3)}{camera()}
  <emitter type="constant" id="sky"><rgb name="radiance" value="6"/></emitter>
  <shape type="sphere" id="ball"/></scene>"""


def test_what_is_still_on_its_way_is_said(tmp_path):
    """Nine times its start away, at the default rate; and at one that takes it there."""
    file = tmp_path / "lamp.xml"
    file.write_text(LAMP)
    run = ["scene=file", f"scene.path={file}", "target.spp=4", "estimator.batch=256", *QUIET]
    run += ["budget.iterations=120", "effects=full", "optimizer.filter=none"]

    def told(start: float, lr: float) -> list[str]:
        unknown = f"scene.unknowns={{sky.radiance.value: {{start: {start}, lr: {lr}}}}}"
        made = ran(tmp_path / f"run-{start}-{lr}", *run, unknown)
        return [each for each in made.summary["warnings"] if "still on its way" in each]

    (slow,) = told(0.7, 0.002)
    assert slow.startswith("'sky.radiance.value' moved by ") and "give it a larger lr" in slow
    assert told(5.5, 0.1) == [] == told(6.0, 0.02)


def test_images_that_came_no_nearer_are_said():
    def told(before: float, after: float, steps: int = 100) -> int:
        return len(ends.stuck({"image_rmse": before}, {"image_rmse": after}, steps))

    assert told(0.06, 0.06) == told(0.06, 0.08) == 1
    assert told(0.06, 0.05) == told(0.0, 0.0) == told(0.0, 0.01) == told(0.06, 0.06, 10) == 0


@pytest.mark.parametrize("lr, count", [(0.5, 1), (5.0, 0)])
def test_a_turn_that_crawls_is_said(lr, count):
    """Of more than half a period it may have been the shorter way round that was gone."""
    turn = PoseConfig(kind="rotation", objects=["wall"])
    p = without_targets(dictionary(), {"turn": UnknownConfig(start=10.0)}, {"turn": turn})
    stepper = Stepper(p.unknowns, OptimizerConfig(lr=lr, schedule="constant"))
    for _ in range(60):
        stepper.step({"turn": type(stepper.values["turn"])(1.0)}, 0.0)
    assert len(ends.underway(stepper)) == count


GREY = f"""<scene version="3.0.0">{paths(2)}{camera()}<emitter type="constant"/>
  <shape type="rectangle" id="wall"><bsdf type="diffuse"><float name="reflectance" value="0.3"/>
  </bsdf></shape></scene>"""


@pytest.mark.parametrize("colour, count", [((0.8, 0.4, 0.1), 1), ((0.4, 0.4, 0.4), 0)])
def test_a_grey_where_targets_have_colours_is_said(tmp_path, colour, count):
    """One number for three channels."""
    (tmp_path / "wall.xml").write_text(GREY)
    picture = np.broadcast_to(np.float32(colour), (16, 16, 3))
    images.write_exr(tmp_path / "a.exr", np.ascontiguousarray(picture), [*"RGB"], {})
    run = ["scene=file", f"scene.path={tmp_path / 'wall.xml'}", "estimator.batch=256"]
    run += [f"scene.targets=[{tmp_path / 'a.exr'}]", "effects=full"]
    found = built(*run, "scene.unknowns={wall.bsdf.reflectance.value: {start: 0.5}}")
    told = [each for each in found.warnings if "one number for all channels" in each]
    assert len(told) == count


REFLECTANCE = "wall.bsdf.reflectance.value"


@pytest.mark.parametrize(
    "key, hidden, count", [("move", True, 1), ("move", False, 0), (REFLECTANCE, True, 0)]
)
def test_an_outline_that_masks_hide_is_said(tmp_path, key, hidden, count):
    (tmp_path / "wall.xml").write_text(GREY)
    images.write_exr(tmp_path / "a.exr", np.full((16, 16, 3), 0.4, np.float32), [*"RGB"], {})
    mask = np.full((16, 16, 1), 255, np.uint8)
    mask[:, :4] = 0 if hidden else 255
    images.write_png(tmp_path / "mask.png", mask)
    run = ["scene=file", f"scene.path={tmp_path / 'wall.xml'}", "estimator.batch=256"]
    run += [f"scene.targets=[{tmp_path / 'a.exr'}]", f"scene.masks=[{tmp_path / 'mask.png'}]"]
    run.append(f"scene.unknowns={{{key}: {{start: 0.5}}}}")
    if key == "move":
        pose = "{kind: translation, objects: [wall], directions: [[1, 0, 0]]}"
        run[-1] = "scene.unknowns={move: {start: 0.1, blur: {start: 0.1, end: 0.01}}}"
        run += [f"scene.poses={{move: {pose}}}", "sampler=plateau"]
    told = [each for each in built(*run).warnings if "through such nothing tells it" in each]
    assert len(told) == count and all(each.startswith("'move': ") for each in told)


def test_what_becomes_finer_is_not_asked_how_it_moved():
    """A grid of few numbers at the end of a run, of another shape than at its first step."""
    p = volumes_for_tests.problem(np.ones((1, 1, 16)), 0.5, levels=2)
    stepper = Stepper(p.unknowns, OptimizerConfig())
    stepper.step(dict(stepper.values), 0.0)
    stepper.refine(1)
    assert volumes_for_tests.DENSITY not in stepper.begun and ends.underway(stepper) == []


def test_nobody_is_on_the_way_three_steps_after_a_resume():
    p = problem(0.5)
    stepper = Stepper(p.unknowns, OptimizerConfig())
    stepper.steps = 300  # as restored
    for _ in range(3):
        stepper.step({ROUGHNESS: type(stepper.values[ROUGHNESS])(1.0)}, 0.0)
    assert stepper.begun and ends.underway(stepper) == []
