"""Renderers that isas knows nothing of: their pictures come through, and their blurred loss is
differentiated without bias."""

import itertools
import os
import shlex
import signal
import subprocess
import sys
import time
from types import SimpleNamespace

import numpy as np
import psutil
import pytest
from problems_for_tests import built, configured

import isas_cli
from isas_cli import losses, records
from isas_cli.cli import landscape
from isas_cli.cli.app import main
from isas_cli.config import searchpath
from isas_cli.config.schema import ExternalConfig, SceneConfig
from isas_cli.engine.loop import Loop
from isas_cli.rendering.pixels import PixelDistribution, Tiles
from isas_cli.rendering.renderer import Renderer
from isas_cli.runtime import images, streams
from isas_cli.runtime.errors import InputError
from isas_cli.scene import export, outside
from isas_cli.unknowns.kind import Loaded
from isas_cli.unknowns.outer import Outer

WIDTH, HEIGHT = 12, 8
FEW = ["frames.views=0", "report=false", "evaluation.count=2", "evaluation.pixels=96"]


def steps(parameters, seed, view):
    """A step at ``x`` and one at ``y``; noise by the seed, alike in all pixels."""
    x, y = (float(np.ravel(parameters[name])[0]) for name in "xy")
    across, down = (np.arange(WIDTH) + 0.5) / WIDTH, (np.arange(HEIGHT) + 0.5) / HEIGHT
    found = 1.0 * (across < x) + 0.5 * (down < y)[:, None] + 0.1 * view
    noise = 0.2 * np.random.default_rng([seed, view]).normal()
    return np.repeat(found[..., None] + noise, 3, axis=2)


def leaves(parameters, seed, view):
    sys.exit(3)


def whole(parameters, seed, view):
    return np.full((HEIGHT, WIDTH, 3), 128, np.uint8)


def hollow(p, s, v):
    found = np.zeros((HEIGHT, WIDTH, 3))
    found[2, 3, 1] = np.nan
    return found


def ragged(parameters, seed, view):
    return [[1.0], [1.0, 2.0]]


def few(parameters):
    return 0


def broken(parameters, seed, view):
    return parameters["z"]


def plain(parameters, seed, view):
    return steps(parameters, 7, view)


CALLS, FAILING = itertools.count(), []


def restless(parameters, seed, view):
    """Of a seed of its own."""
    return steps(parameters, next(CALLS), view)


def holed(parameters, seed, view):
    """With a pixel that is no number, but for the truth."""
    found = steps(parameters, seed, view)
    if abs(float(parameters["x"]) - 0.7) > 1e-3:
        found[2, 3, 1] = np.nan
    return found


def odd(parameters, seed, view):
    """With a pixel that is no number, by every other seed."""
    found = steps(parameters, seed, view)
    if seed % 2:
        found[2, 3] = np.nan
    return found


def picky(parameters, seed, view):
    if seed % 2:
        raise RuntimeError("no such seed")
    return steps(parameters, seed, view)


def moody(parameters, seed, view):
    if FAILING:
        raise RuntimeError("no licence")
    return steps(parameters, seed, view)


def renderer(**more):
    parameters = {"x": 0.7, "y": 0.6}
    settings = {"width": WIDTH, "height": HEIGHT, "parameters": parameters} | more
    return outside.Outside(ExternalConfig(**settings), unknown=("x",))


def shelled(folder, script, *words, **more):
    """By a shell's ``script``, whose $0 is a picture, $1 where it is to be, then ``words``."""
    picture = folder / "a.exr"
    images.write_exr(str(picture), np.full((HEIGHT, WIDTH, 3), 0.5), [*"RGB"], {})
    command = shlex.join(["sh", "-c", script, str(picture), "{out}", *words])
    return renderer(command=command, **more)


def turning(folder, *words):
    """Another picture each time, of two."""
    images.write_exr(str(folder / "other.exr"), np.zeros((HEIGHT, WIDTH, 3)), [*"RGB"], {})
    other = 'touch "$0.turn"; cp "$(dirname "$0")/other.exr" "$1"'
    return shelled(folder, f'if rm "$0.turn"; then cp "$0" "$1"; else {other}; fi', *words)


@pytest.fixture
def words(monkeypatch):
    monkeypatch.setenv("ISAS_ALLOW", __name__)
    unknown = '{"start": 0.3, "range": [0, 1], "lr": 0.02, "blur": {"start": 0.2, "end": 0.05}}'
    return [
        *("scene=external", f"external.function={__name__}.steps", f"external.width={WIDTH}"),
        *(f"external.height={HEIGHT}", 'external.parameters={"x": 0.7, "y": [0.6]}'),
        f'scene.unknowns={{"x": {unknown}, "y": {unknown}}}',
        *("external.views=2", "target.spp=4", "estimator.batch=512"),
    ]


def problem(*settings):
    return built(*FEW, *settings)


def test_its_pictures_come_through_pixel_by_pixel(words):
    made = problem(*words, "external.noisy=false")
    made.unknowns.write(made.unknowns.truths())
    truth = {"x": np.array(0.7), "y": np.array([0.6])}
    for view in (0, 1):
        np.testing.assert_allclose(made.target_image(view), steps(truth, 0, view), atol=1e-6)
        shown = Renderer(made).view(view, 1, lambda sample: 3)
        np.testing.assert_allclose(shown, steps(truth, 0, view), atol=1e-6)


def test_small_parameters_are_rounded_by_their_own_size():
    """Which a blur that is as narrow needs."""
    for value, scale in ((2e-6, 2e-6), (30.0, 1.0), (0.0, 1.0)):
        values = {"x": np.array(value, np.float32)}
        made = Outer("x", Loaded(None, outside=SimpleNamespace(values=values)))
        assert made.scale == pytest.approx(scale)


def test_targets_that_are_given_are_of_no_film(words, tmp_path):
    """Whose filter isas would have to doubt."""
    files = [str(tmp_path / f"{view}.exr") for view in (0, 1)]
    for file in files:
        images.write_exr(file, np.full((HEIGHT, WIDTH, 3), 0.5), [*"RGB"], {})
    made = problem(*words[:-2], words[-1], f"scene.targets=[{','.join(files)}]")
    assert not [each for each in made.warnings if "films' filter" in each]
    assert np.array_equal(made.target_image(1), images.read(files[1]))


def test_targets_are_as_clean_as_asked(words):
    made = problem(*words[:-2], words[-1], "target.noise=0.02")
    bright = np.array(made.targets).mean()
    assert np.sqrt(made.variance.mean()) / bright == pytest.approx(0.02, rel=0.5)
    truth = plain({"x": 0.7, "y": 0.6}, 0, 0) - 0.2 * np.random.default_rng([7, 0]).normal()
    assert np.abs(made.target_image(0) - truth).max() < 4 * 0.02 * bright


def test_targets_go_on_where_they_were_stopped(words, monkeypatch, tmp_path):
    monkeypatch.setenv("ISAS_CACHE_DIR", str(tmp_path))
    whole = problem(*words[:-2], words[-1], "target.noise=0.02")
    seeds = []

    def counted(self, view, seed, stop=5, plain=outside.Outside.picture):
        seeds.append(seed)
        if view == 0 and len(seeds) == stop:
            raise KeyboardInterrupt
        return plain(self, view, seed)

    again = [*words[:-2], words[-1], "target.noise=0.02", "target.seed=0"]
    for path in tmp_path.glob("target-*"):
        path.unlink()
    monkeypatch.setattr(outside.Outside, "picture", counted)
    with pytest.raises(KeyboardInterrupt):
        problem(*again)
    before = len(seeds)
    made = problem(*again)
    assert np.array_equal(np.array(made.targets), np.array(whole.targets))
    once = [seed for seed in seeds[:before] if seed]
    assert not {*once[:-1]} & {*seeds[before:]}, "what was rendered is not rendered again"


def test_targets_leave_out_pixels_that_are_no_numbers(words):
    made = problem(*words, "target.spp=16", f"external.function={__name__}.odd")
    seeds = [streams.seed(0, number, "target") >> 8 for number in range(16)]
    whole = [seed for seed in seeds if not seed % 2]
    lost = 2 * (16 - len(whole))
    assert f"{lost} of {16 * 2 * WIDTH * HEIGHT} target paths were not finite: left out" in (
        made.warnings
    )
    shown = [steps({"x": 0.7, "y": 0.6}, seed, 0)[2, 3] for seed in whole]
    np.testing.assert_allclose(made.target_image(0)[2, 3], np.mean(shown, axis=0), rtol=1e-4)
    assert np.isfinite(made.variance).all()


def test_seeds_are_below_2_to_the_24(words, monkeypatch, tmp_path):
    """Of targets as of all else."""
    monkeypatch.setenv("ISAS_CACHE_DIR", str(tmp_path))
    seeds = []

    def noted(self, view, seed, plain=outside.Outside.picture):
        seeds.append(seed)
        return plain(self, view, seed)

    monkeypatch.setattr(outside.Outside, "picture", noted)
    Renderer(problem(*words)).view(0, 4, lambda sample: 2**32 - 1 - sample)
    assert len(set(seeds)) == 1 + 4 + 4 and max(seeds) < 1 << 24


def test_a_renderer_that_does_not_repeat_goes_on(words, monkeypatch, tmp_path):
    folder = tmp_path / "run"
    words = [*FEW, *words, f"external.function={__name__}.restless", "budget.iterations=2"]
    assert main(["run", *words, f"hydra.run.dir={folder}"]) == 0
    assert main(["run", f"resume={folder}", "budget.iterations=3"]) == 0
    run, said = records.load(folder), "the same seed gives another picture"
    assert run.summary["iterations"] == 3
    assert len([line for line in run.summary["warnings"] if said in line]) == 1
    # Of parameters that may be of unlike units.
    assert run.history.parameter_rmse.iloc[0] == pytest.approx(1)
    assert run.parameter_rmse_is == "relative to the start"
    # A landscape asks for few of its pictures, where nothing else is said.
    asked = []

    def measured(problem, choices, seed, run, names, spp, phases):
        asked.append(spp)
        raise InputError("enough")

    monkeypatch.setattr(landscape, "_measured", measured)
    for more in ([], ["--spp", "5"]):
        assert main(["landscape", str(folder), *more]) == 2
    assert asked == [2, 5]


def test_one_that_repeats_is_said_nothing_of(words):
    assert not [line for line in problem(*words).warnings if "the same seed" in line]


def test_pixels_that_are_no_numbers_are_left_out_and_counted(words, tmp_path):
    run = isas_cli.run(
        *(*FEW, *words, f"external.function={__name__}.holed", "evaluation.pixels=192"),
        *("budget.iterations=2", f"hydra.run.dir={tmp_path / 'run'}"),
    )
    told = " ".join(run.summary["warnings"])
    assert "of evaluations and pictures were not finite: left out" in told
    assert "residuals of steps were not finite: left out" in told
    assert np.isfinite(run.history.image_rmse).all()
    assert all(np.isfinite(value).all() for value in run.parameters().values())


def test_in_a_race_a_renderer_that_fails_ends_its_contestant_alone(
    words, monkeypatch, tmp_path, capsys
):
    monkeypatch.setattr("isas_cli.cli.compare.main", lambda *_: 0)
    words = [*FEW, *words, f"external.function={__name__}.moody", "budget.iterations=4"]
    folder, iterate = tmp_path / "race", Loop._iterate
    runs = [folder / "uniform" / f"seed{seed}" for seed in (1, 2)]

    def iterated(self):
        FAILING[:] = [1] if self.seed == 2 and self.position.iteration == 2 else []
        try:
            iterate(self)
        finally:
            FAILING.clear()

    with monkeypatch.context() as patch:
        patch.setattr(Loop, "_iterate", iterated)
        seeds = "samplers=[uniform]", "seed=[1,2]"
        assert main(["race", *words, *seeds, f"hydra.run.dir={folder}"]) == 2
    told = " ".join(capsys.readouterr().err.split())
    assert "uniform seed 2: " in told and "no licence" in told and ", with x=" in told
    summaries = [records.load(each).summary for each in runs]
    assert summaries[0]["status"] == "done" and summaries[1] is None
    assert main(["race", f"resume={folder}"]) == 0
    assert [records.load(each).summary["iterations"] for each in runs] == [4, 4]


def test_a_call_that_fails_is_made_again_with_another_seed(monkeypatch):
    monkeypatch.setenv("ISAS_ALLOW", __name__)
    values = {"x": 0.7, "y": 0.6}
    made = renderer(function=f"{__name__}.picky")
    np.testing.assert_allclose(made.picture(0, 3), steps(values, 2, 0), atol=1e-6)
    told = r"raises KeyError\('z'\) \(.*\), with x=0\.7, y=0\.6$"
    with pytest.raises(outside.Failed, match=told):
        renderer(function=f"{__name__}.broken").picture(0, 3)


@pytest.mark.parametrize("smooth", ["image", "loss"])
def test_the_gradient_of_its_blurred_pictures_has_no_bias(words, smooth):
    """Against sums over the blur, with noise in the pictures, where the target is not met."""
    words = [*FEW, *words, f"estimator.smooth={smooth}"]
    made = built(*words)
    estimator = configured(*words)[0].estimator.on(made, losses.L2())
    values, drawn = made.unknowns.starts(), PixelDistribution.uniform(Tiles.over(made.views))
    rows = []
    for number in range(400):
        found = estimator.estimate(values, drawn, 5, number, 0.0)
        rows.append([float(np.array(found[name])[0]) for name in "xy"])
    σ, rng = 0.2, np.random.default_rng(1)
    τ = σ * rng.normal(size=(20_000, 2))
    target = np.array(made.targets).reshape(2, HEIGHT, WIDTH, 3)[..., 0]
    across, down = (np.arange(WIDTH) + 0.5) / WIDTH, (np.arange(HEIGHT) + 0.5) / HEIGHT
    at = np.clip(0.3 + τ, 0, 1)
    x = 1.0 * (across[None] < at[:, :1])[:, None, :]
    y = 0.5 * (down[None] < at[:, 1:])[:, :, None]
    shown = x + y
    exact = []
    for entry in range(2):
        slope = τ[:, entry] / σ**2
        if smooth == "image":
            mean = shown.mean(axis=0)
            changes = np.einsum("n,nhw->hw", slope, shown) / len(τ)
            residual = mean[None] + 0.1 * np.arange(2)[:, None, None] - target
            exact.append(2 * (residual * changes).mean())
        else:
            losses_ = sum(
                np.square(shown + 0.1 * view - target[view]).mean(axis=(1, 2)) for view in (0, 1)
            )
            exact.append((slope * (losses_ - losses_.mean())).mean() / 2)
    rows = np.array(rows)
    error = rows.std(axis=0) / np.sqrt(len(rows))
    print(rows.mean(axis=0) / exact, error / np.abs(exact))
    assert np.all(np.abs(rows.mean(axis=0) - exact) < 4 * error + 0.05 * np.abs(exact))


@pytest.mark.parametrize("smooth, asked", [("image", 6), ("loss", 12)])
def test_several_pictures_a_rendering_have_seeds_of_their_own(words, monkeypatch, smooth, asked):
    words = [*FEW, *words, f"estimator.smooth={smooth}", "estimator.spp=3", "external.views=1"]
    made, seeds = built(*words), set()

    def counted(self, view, seed, plain=outside.Outside.picture):
        seeds.add((seed, *(value.tobytes() for value in self.values.values())))
        return plain(self, view, seed)

    monkeypatch.setattr(outside.Outside, "picture", counted)
    estimator = configured(*words)[0].estimator.on(made, losses.L2())
    drawn = PixelDistribution.uniform(Tiles.over(made.views))
    found = estimator.estimate(made.unknowns.starts(), drawn, 5, 0, 0.0)
    assert np.isfinite([np.array(found[name])[0] for name in "xy"]).all()
    # Of both of a pair, and in image space of the two that the residual is from.
    residual = 2 * estimator._renderings.half if smooth == "image" else 0
    assert len(seeds) == asked + residual


def test_a_command_that_writes_an_exr(tmp_path, monkeypatch):
    """With a space and quotes in its words, as a shell would pass them."""
    monkeypatch.setenv("ISAS_ALLOW", sys.executable)
    script = tmp_path / "draw a bar.py"
    script.write_text(
        "import sys\nimport numpy as np\nimport OpenImageIO as oiio\n"
        "x, seed, out = float(sys.argv[1]), int(sys.argv[2]), sys.argv[3]\n"
        "picture = np.zeros((8, 12, 3), np.float32)\n"
        "picture[:, : int(x * 12)] = 1\n"
        "image = oiio.ImageOutput.create(out)\n"
        "image.open(out, oiio.ImageSpec(12, 8, 3, 'float'))\nimage.write_image(picture)\n"
    )
    command = f"{sys.executable} '{script}' {{x}} {{seed}} {{out}}"
    run = isas_cli.run(
        *("scene=external", f"external.command={command}", "external.noisy=false", *FEW),
        *("external.width=12", "external.height=8", "external.parameters={x: 0.75}"),
        'scene.unknowns={"x": {"start": 0.4, "range": [0, 1], "blur": {"start": 0.2, "end": 0.1}}}',
        *("budget.iterations=3", f"hydra.run.dir={tmp_path / 'run'}", "frames.views=1"),
    )
    assert run.history.parameter_rmse.iloc[0] == pytest.approx(0.35)
    assert np.isfinite(run.parameters()["x"]).all()
    shown = images.read(run.folder / "frames" / "target_v00.exr")
    assert (shown[:, :9] == 1).all() and (shown[:, 9:] == 0).all()


def test_colours_that_a_command_writes_and_cannot_be_heeded_are_said(tmp_path, monkeypatch):
    monkeypatch.setenv("ISAS_ALLOW", sys.executable)
    script = tmp_path / "draw.py"
    script.write_text(
        "import sys\nimport numpy as np\nimport OpenImageIO as oiio\n"
        "spec, out = oiio.ImageSpec(12, 8, 3, 'float'), sys.argv[1]\n"
        "odd = 0.5, 0.3, 0.3, 0.5, 0.2, 0.1, 0.3, 0.3\n"
        "spec.attribute('chromaticities', oiio.TypeDesc('float[8]'), odd)\n"
        "image = oiio.ImageOutput.create(out)\nimage.open(out, spec)\n"
        "image.write_image(np.full((8, 12, 3), 0.5, np.float32))\nimage.close()\n"
    )
    made = built(
        *("scene=external", f"external.command={sys.executable} {script} {{out}}", *FEW),
        *("external.parameters={x: 0.5}", "external.width=12", "external.height=8"),
        'scene.unknowns={"x": {"start": 0.4, "range": [0, 1], "blur": {"start": 0.2, "end": 0.1}}}',
    )
    (told,) = (line for line in made.warnings if "cannot be heeded" in line)
    assert "the primaries that it names of {out} cannot be heeded" in told


def test_a_command_gets_numbers_in_digits_and_those_that_are_known_as_they_are(
    tmp_path, monkeypatch
):
    monkeypatch.setenv("ISAS_ALLOW", "sh")
    script = 'echo "$2 $3 $4" > "$0.said"; cp "$0" "$1"'
    given = {"x": [-2.99e-5, 1e-7], "n": 64, "y": 42577478.518}
    shelled(tmp_path, script, "{x}", "{n}", "{y}", parameters=given).picture(0, 1)
    said = (tmp_path / "a.exr.said").read_text().split()
    assert said == ["-0.0000299,0.0000001", "64", "42577478.518"]


def test_where_a_command_lies_makes_no_other_problem(tmp_path, monkeypatch):
    monkeypatch.setenv("ISAS_ALLOW", "sh")
    told = []
    for name in "ab":
        (tmp_path / name).mkdir()
        told.append(shelled(tmp_path / name, 'cp "$0" "$1"').description())
    assert told[0] == told[1]
    assert told[0] != shelled(tmp_path / "a", 'cp  "$0" "$1"').description()


@pytest.mark.parametrize("pair", [("--s=a/x", "--s=b/x"), ("--gain=1/2", "--gain=3/2")])
def test_what_is_no_file_counts_as_it_is_written(tmp_path, monkeypatch, pair):
    """Also where no picture tells, as each is another one."""
    monkeypatch.setenv("ISAS_ALLOW", "sh")
    for restless in (False, True):
        one, other = (
            turning(tmp_path, word) if restless else shelled(tmp_path, 'cp "$0" "$1"', word)
            for word in pair
        )
        assert one.description() != other.description()
        assert bool(one.warnings) == restless


def test_where_no_picture_tells_a_file_is_one_by_its_folder(tmp_path, monkeypatch):
    monkeypatch.setenv("ISAS_ALLOW", "sh")
    told = []
    for name in "aba":
        (tmp_path / name).mkdir(exist_ok=True)
        told.append(turning(tmp_path / name).description())
    assert told[0] == told[2] != told[1]


def test_one_call_that_fails_makes_no_other_problem(monkeypatch):
    monkeypatch.setenv("ISAS_ALLOW", __name__)
    made = [renderer(function=f"{__name__}.moody") for _ in range(2)]
    call = made[0]._render

    def once(view, seed):
        FAILING[:] = [1] if not once.asked else []
        once.asked += 1
        try:
            return call(view, seed)
        finally:
            FAILING.clear()

    once.asked, made[0]._render = 0, once
    assert made[0].description() == made[1].description()
    assert made[0].warnings == []


@pytest.mark.parametrize("noisy", [False, True])
def test_that_there_is_noise_is_said_to_whom_has_denied_it(monkeypatch, noisy):
    monkeypatch.setenv("ISAS_ALLOW", __name__)
    made = renderer(function=f"{__name__}.restless", noisy=noisy)
    made.description()
    (told,) = made.warnings
    assert ("external.noisy=true" in told) is not noisy


def test_the_first_view_alone_is_asked_for_twice(monkeypatch):
    monkeypatch.setenv("ISAS_ALLOW", __name__)
    made, asked = renderer(function=f"{__name__}.steps", views=3), []
    call = made._render
    made._render = lambda view, seed: asked.append(view) or call(view, seed)
    made.description()
    assert sorted(asked) == [0, 0, 1, 2]


def test_a_command_is_not_given_what_is_typed(tmp_path, monkeypatch):
    monkeypatch.setenv("ISAS_ALLOW", "sh")
    made, kept, (read, write) = shelled(tmp_path, 'read x; cp "$0" "$1"'), os.dup(0), os.pipe()
    os.write(write, b"typed\n")
    os.close(write)
    os.dup2(read, 0)
    try:
        made.picture(0, 1)
    finally:
        os.dup2(kept, 0)
        os.close(kept)
    assert os.read(read, 9) == b"typed\n"
    os.close(read)


def lives(process: int) -> bool:
    try:
        return psutil.Process(process).status() != psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return False


def test_what_a_command_leaves_running_is_not_waited_for(tmp_path, monkeypatch):
    monkeypatch.setenv("ISAS_ALLOW", "sh")
    script = 'sleep 60 & echo $! > "$0.left"; cp "$0" "$1"'
    assert (shelled(tmp_path, script).picture(0, 1) == 0.5).all()
    left = int((tmp_path / "a.exr.left").read_text())
    assert lives(left)
    os.kill(left, signal.SIGKILL)


def test_ctrl_c_ends_what_a_command_has_started(tmp_path, monkeypatch):
    monkeypatch.setenv("ISAS_ALLOW", "sh")
    left, asked, end = tmp_path / "a.exr.left", [], time.monotonic() + 60

    def interrupted(self, timeout=None, wait=subprocess.Popen.wait):
        if asked:
            return wait(self, timeout)
        while not (left.exists() and left.read_text().strip()):
            assert time.monotonic() < end
            time.sleep(0.01)
        asked.append(timeout)
        raise KeyboardInterrupt

    monkeypatch.setattr(subprocess.Popen, "wait", interrupted)
    with pytest.raises(KeyboardInterrupt):
        shelled(tmp_path, 'sleep 300 & echo $! > "$0.left"; wait').picture(0, 1)
    while lives(int(left.read_text())):
        assert time.monotonic() < end
        time.sleep(0.01)


@pytest.mark.parametrize(
    "changes, told",
    [
        (["estimator=two_path"], "scene=external has none: take estimator=plateau"),
        (["sampler=mitsuba"], "scene=external has none"),
        (["estimator.gradient=renderer"], "scene=external has none"),
        (["external.function=null"], "scene=external needs a renderer"),
        (["external.command=draw"], "one of them"),
        (["external.function=null", "external.command=draw"], "is to say {out}"),
        (["external.function=os.system"], "set ISAS_ALLOW=os"),
        ([f"external.function={__name__}.broken"], "raises KeyError('z') ("),
        ([f"external.function={__name__}.leaves"], "raises SystemExit(3) ("),
        ([f"external.function={__name__}.whole"], "gives uint8: linear pixels as floats"),
        ([f"external.function={__name__}.hollow"], "gives [0.0, nan, 0.0] in row 2, column 3"),
        ([f"external.function={__name__}.ragged"], "raises ValueError("),
        ([f"external.function={__name__}.few"], "is called as render(parameters, seed, view)"),
        (["external.parameters={x: 1e60}"], "parameters.x=1e+60: a number"),
        (["external.parameters={x: 1, seed: 2}"], "parameters.seed: stands for something else"),
        (["external.width=13"], "gives (8, 12, 3), not (8, 13, 3)"),
        (["external.parameters={x: wide}"], "scene.external.parameters.x=wide: a number"),
        (['scene.unknowns={"z": {"start": 1}}'], "'z' is no differentiable parameter"),
        (["effects.max_depth=2"], "scene=external has pictures, and no paths"),
        (["external.heigth=8"], "did you mean"),
        (["scene.max_depth=3"], "scene.max_depth=3: scene=external has none"),
        (["scene.path=a.xml"], "scene=external has none"),
    ],
)
def test_what_cannot_be_is_one_line(words, tmp_path, capsys, changes, told):
    folder = tmp_path / "run"
    assert main(["run", *FEW, *words, *changes, f"hydra.run.dir={folder}"]) == 2
    said = capsys.readouterr().err.strip().splitlines()[-1]
    assert told in said and not folder.exists()


def test_a_command_that_fails_says_what_it_said(tmp_path, capsys, monkeypatch):
    command = f"{sys.executable} -c \"import sys; sys.exit('no licence')\" {{out}}"
    words = ["scene=external", f"external.command={command}", "external.parameters={x: 1}", *FEW]
    words += ['scene.unknowns={"x": {"start": 0.5, "blur": {"start": 0.2, "end": 0.1}}}']
    words += [f"hydra.run.dir={tmp_path / 'run'}"]
    assert main(["run", *words]) == 2
    assert f"would run a program: set ISAS_ALLOW={sys.executable}" in capsys.readouterr().err
    monkeypatch.setenv("ISAS_ALLOW", sys.executable)
    assert main(["run", *words]) == 2
    assert "ends with 1: no licence" in capsys.readouterr().err
    for command, told in (
        ("{x[0]} {out}", "{x[0]}: valid in it: {x}, {out}, {seed}"),
        ("-c \"import sys; print('no colour'); sys.exit(1)\" {out}", "ends with 1: no colour"),
        ("-c 'import pathlib, sys; pathlib.Path(sys.argv[1]).touch()' {out}", "writes no EXR"),
    ):
        words[1] = f"external.command={sys.executable} {command}"
        assert main(["run", *words]) == 2
        assert told in capsys.readouterr().err
    monkeypatch.setenv("ISAS_ALLOW", "/no/such")
    words[1] = "external.command=/no/such {out}"
    assert main(["run", *words]) == 2
    assert "/no/such: No such file" in capsys.readouterr().err


def test_what_can_be_unknown_is_listed(words, capsys):
    words = [word for word in words if not word.startswith("scene.unknowns")]
    assert main(["unknowns", *words]) == 0
    rows = [line.split() for line in capsys.readouterr().out.splitlines() if "renderer" in line]
    assert [row[0] for row in rows] == ["x", "y"] and all("plateau" in row for row in rows)


def test_a_scene_of_one_s_own_may_take_it_by_its_defaults(words, tmp_path, monkeypatch):
    (tmp_path / "scene").mkdir()
    (tmp_path / "scene/mine.yaml").write_text("defaults: [external, _self_]\nname: mine\n")
    monkeypatch.setenv(searchpath.VARIABLE, str(tmp_path))
    assert problem("scene=mine", *words[1:]).integrator.black_box


@pytest.mark.parametrize("made", [export.write, export.result])
def test_its_result_is_no_scene(made, tmp_path):
    scene = SceneConfig(name="mine", external=ExternalConfig(function="a.b"))
    folders = [tmp_path / "result"] if made is export.write else []
    with pytest.raises(InputError, match=r"no scene for Mitsuba: isas_cli.load\(DIR\)"):
        made(scene, {}, *folders)
    assert list(tmp_path.iterdir()) == []


def test_others_have_no_renderer_of_their_own(capsys):
    assert main(["run", "scene=pottery", "external.width=3"]) == 2
    assert "only scene=external has it" in capsys.readouterr().err


def test_few_pictures_are_kept(monkeypatch):
    asked = []
    monkeypatch.setenv("ISAS_ALLOW", "draw")
    made = outside.Outside(ExternalConfig(command="draw {out}", parameters={"x": 1}, width=2))
    made._render = lambda view, seed: asked.append(seed) or np.zeros((2, 2, 3))
    for seed in (1, 2, 1, *range(3, 3 + 2 * outside._KEPT), 1):
        made.picture(0, seed)
    assert asked.count(1) == 2 and asked.count(2) == 1
    assert len(made._pictures) <= outside._KEPT
    with pytest.raises(InputError, match="gives"):
        made._render = lambda view, seed: np.zeros(3)
        made.picture(0, 99)
