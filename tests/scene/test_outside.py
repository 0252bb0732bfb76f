"""Renderers that isas knows nothing of: their pictures come through, and their blurred loss is
differentiated without bias."""

import sys
from types import SimpleNamespace

import numpy as np
import pytest
from problems_for_tests import built, configured

import isas_cli
from isas_cli import losses
from isas_cli.cli.app import main
from isas_cli.config.schema import ExternalConfig, SceneConfig
from isas_cli.rendering.pixels import PixelDistribution, Tiles
from isas_cli.rendering.renderer import Renderer
from isas_cli.runtime import images
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


def few(parameters):
    return 0


def broken(parameters, seed, view):
    return parameters["z"]


def plain(parameters, seed, view):
    return steps(parameters, 7, view)


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


@pytest.mark.parametrize("made", [export.write, export.result])
def test_its_result_is_no_scene(made, tmp_path):
    scene = SceneConfig(name="external")
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
