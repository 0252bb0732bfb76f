"""A direction stays a direction: of unit length, whatever is added to it."""

import mitsuba as mi
import numpy as np
import pytest
from runs_for_tests import ran
from xml_for_tests import camera, paths

from isas_cli.config.schema import OptimizerConfig, UnknownConfig
from isas_cli.engine.optimiser import Stepper
from isas_cli.runtime.errors import InputError
from isas_cli.unknowns.direction import Direction
from isas_cli.unknowns.kind import Loaded
from isas_cli.unknowns.specs import parse
from isas_cli.unknowns.unknowns import Unknowns

KEY = "sky.sun_direction"
SUN = f"""<scene version="3.0.0">{paths(3)}{camera()}
  <emitter type="sunsky" id="sky"><float name="sky_scale" value="0"/>{{when}}</emitter>
  <shape type="sphere" id="ball"><float name="radius" value="0.6"/></shape>
  <shape type="rectangle"><transform name="to_world"><scale value="4"/><translate z="-1"/>
  </transform></shape></scene>"""
TOWARDS = '<vector name="sun_direction" x="0.8" y="-0.6" z="1.6"/>'
TRUTH = np.array([0.8, -0.6, 1.6]) / np.linalg.norm([0.8, -0.6, 1.6])


def params(when: str = TOWARDS) -> mi.SceneParameters:
    return mi.traverse(mi.load_string(SUN.format(when=when), optimize=False))


def direction(start) -> Unknowns:
    found = parse(params(), {KEY: UnknownConfig(start=start)}, True)
    return Unknowns(params(), found)


def test_its_length_is_no_unknown():
    unknowns = direction([0, 3, 4])
    assert unknowns[KEY].kind.role == "", "of a light, but its brightness is another's"
    assert np.allclose(unknowns[KEY].start, [0, 0.6, 0.8])
    unknowns.write(unknowns.values_of({KEY: np.float32([0, 30, 40])}))
    assert np.allclose(np.array(unknowns.params[KEY]).ravel(), [0, 0.6, 0.8])
    stepper = Stepper(unknowns, OptimizerConfig(lr=0.1))
    stepper.step(unknowns.values_of({KEY: np.float32([1, 0, -1])}), 0.0)
    value = np.array(stepper.values[KEY]).ravel()
    assert np.isclose(np.linalg.norm(value), 1) and value[0] < 0 < value[2]


def test_its_error_is_an_angle_and_no_end_of_the_sky_is_out_of_range():
    kind = Direction(KEY, Loaded(params()))
    assert np.allclose(kind.present, TRUTH) and kind.moves_geometry
    assert tuple(kind.range) == (-np.inf, np.inf)
    seen = np.ones(3, bool)
    assert np.isclose(kind.error(np.float32([2, 0, 0]), np.float32([0, 0, 1]), seen), np.pi / 2)
    # Where an arc cosine has no digits left.
    assert np.isclose(kind.error(np.float32([1, 1e-5, 0]), np.float32([1, 0, 0]), seen), 1e-5)


def test_no_direction_is_refused():
    with pytest.raises(InputError, match="of no length: give"):
        direction([0, 0, 0])


def test_a_sun_that_follows_from_the_date_is_not_offered():
    date = '<integer name="year" value="2024"/><float name="hour" value="10"/>'
    with pytest.raises(InputError, match="sun_direction' follows from other numbers of the file"):
        parse(params(date), {KEY: UnknownConfig(start=[0, 0, 1])}, True)


BLUR = '"blur": {"start": 0.1, "end": 0.01, "hold": 0.2}'


@pytest.fixture
def arguments(tmp_path) -> list[str]:
    (tmp_path / "sun.xml").write_text(SUN.format(when=TOWARDS))
    unknown = f'scene.unknowns={{"{KEY}": {{"start": [0, 0.3, 1], "lr": 0.03, {BLUR}}}}}'
    small = ["target.spp=64", "estimator.batch=4096", "evaluation.pixels=64", "frames.views=0"]
    return ["scene=file", f"scene.path={tmp_path / 'sun.xml'}", unknown, *small, "report=false"]


def test_path_replay_refuses_it_and_says_what_to_take(arguments, refused):
    more = ["sampler=uniform", "estimator=two_path"]
    refused(["run", *arguments, *more], "sampler=plateau", "finite_differences")


def test_the_sun_is_found_from_what_it_lights(arguments, tmp_path):
    more = ["sampler=finite_differences", "budget.iterations=120", "evaluation.count=2"]
    error = ran(tmp_path / "run", *arguments, *more).history["parameter_rmse"].to_numpy()
    assert error[0] > 0.5 and error[-1] < 0.02
