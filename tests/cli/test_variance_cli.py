"""`isas variance` from the command line: what it leaves, what it refuses, Ctrl-C."""

import contextlib
import csv
import io
import json
import os
import signal
from pathlib import Path

import numpy as np
import pytest
import yaml
from processes import started, until
from samplers_for_tests import pixel_samplers
from scenes_for_tests import TEXTURE, problem
from xml_for_tests import camera, paths

from isas_cli.cli import app
from isas_cli.cli import variance as command
from isas_cli.measure.variance import table
from isas_cli.measure.variance.run import point
from isas_cli.runtime import images
from isas_cli.runtime.errors import InputError
from isas_cli.unknowns.parameters import as_numpy

SMALL = ["variance", "scene=dodoco", "size=tiny", "estimator.batch=256", "target.spp=4"]


def read(folder: Path) -> list[dict]:
    with open(folder / "variance.csv", encoding="utf-8") as file:
        return list(csv.DictReader(file))


@pytest.fixture(scope="module")
def made(tmp_path_factory) -> tuple[Path, str]:
    """A small measurement and what it said on standard output."""
    folder = tmp_path_factory.mktemp("variance") / "made"
    arguments = [*SMALL, "contestants=[{sampler:ours,sampler.floor:0.1},{sampler:gradient}]"]
    arguments += ["repeats=24", "best=8", "at=0.5", f"hydra.run.dir={folder}"]
    out, told = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(told):
        status = app.main(arguments)
    assert status == 0, told.getvalue()
    assert "ours floor=0.1" in told.getvalue()
    return folder, out.getvalue()


def test_a_measurement_leaves_its_table_plot_and_maps(made):
    folder, out = made
    assert out == f"variance: {folder}\n"
    found = read(folder)
    assert tuple(found[0]) == table.COLUMNS
    assert [row["sampler"] for row in found] == [
        "uniform",
        "gradient",
        "ours floor=0.1",
        "best pmf",
    ]
    assert {row["repeats"] for row in found} == {"24"} and {row["batch"] for row in found} == {
        "256"
    }
    for name in ("variance.png", "variance.svg", "densities_v00.png"):
        assert (folder / name).stat().st_size > 5000
    for name in ("uniform", "gradient", "ours_floor=0.1", "best_pmf"):
        density = images.read(folder / f"density_{name}_v00.exr")
        assert density.shape == (32, 32, 3) and density.mean() == pytest.approx(1, rel=1e-4)
        assert (folder / f"density_{name}_v00.png").is_file()
        low = {"ours_floor=0.1": 0.1, "gradient": 0.05, "best_pmf": 0.01, "uniform": 0.9999}[name]
        assert density.min() >= 0.999 * low
    config = yaml.safe_load((folder / "config.yaml").read_text())
    assert config["samplers"]["ours floor=0.1"]["floor"] == 0.1
    assert (config["at"], config["repeats"], config["best"]) == (0.5, 24, 8)
    manifest = json.loads((folder / "manifest.json").read_text())
    assert manifest["command"][:2] == ["isas", "variance"] and manifest["variance"]["at"] == 0.5


def test_columns_agree_with_each_other(made):
    rows = {row["sampler"]: row for row in read(made[0])}
    number = {
        name: {k: float(v or "nan") for k, v in row.items() if k != "sampler"}
        for name, row in rows.items()
    }
    uniform, gradient = number["uniform"], number["gradient"]
    for row in number.values():
        assert row["ratio_to_uniform"] == pytest.approx(row["variance"] / uniform["variance"])
        assert row["ratio_to_gradient"] == pytest.approx(row["variance"] / gradient["variance"])
        assert row["variance_low"] <= row["variance"] <= row["variance_high"]
        assert (
            row["ratio_to_uniform_low"] <= row["ratio_to_uniform"] <= row["ratio_to_uniform_high"]
        )
        price = row["variance"] * row["seconds_per_estimate"]
        own = uniform["variance"] * uniform["seconds_per_estimate"]
        assert row["efficiency"] == pytest.approx(own / price)
        share = row["looks_per_estimate"] * row["seconds_look"]
        assert row["seconds_per_estimate"] == pytest.approx(row["seconds_step"] + share)
        assert row["nonfinite"] == 0
    assert uniform["looks_per_estimate"] == 0 and gradient["looks_per_estimate"] == 1 / 50
    assert gradient["paths_per_estimate"] > uniform["paths_per_estimate"] == 512
    best = number["best pmf"]
    assert best["variance_iid_bound"] < best["variance_iid"] and best["ratio_to_best"] == 1
    assert np.isnan(uniform["bias_z"]) and not np.isnan(gradient["bias_z"])


def test_a_measurement_is_replaced_only_when_asked(made, capsys):
    folder = made[0]
    before = (folder / "variance.csv").read_text()
    again = [*SMALL, "samplers=[uniform]", "repeats=2", "best=0", f"hydra.run.dir={folder}"]
    assert app.main(again) == 2
    assert "overwrite=true" in capsys.readouterr().err
    assert (folder / "variance.csv").read_text() == before
    copy = folder.parent / "copy"
    copy.mkdir()
    for name in ("manifest.json", "density_ours_v00.exr"):
        (copy / name).write_text("old")
    again[-1] = f"hydra.run.dir={copy}"
    assert app.main([*again, "overwrite=true"]) == 0
    assert not (copy / "density_ours_v00.exr").exists()
    found = read(copy)
    assert [row["sampler"] for row in found] == ["uniform", "gradient"]
    assert found[0]["variance_low"] == found[0]["variance_iid"] == "", "one round, no best pmf"
    assert found[0]["repeats"] == "2" and float(found[0]["variance"]) > 0


def test_all_samplers_are_the_default_and_the_references_come_first():
    cfgs = command._configurations({}, ["scene=dodoco"])
    assert sorted(cfgs) == sorted({*pixel_samplers(), "differences"}), "one cannot be measured"
    assert list(cfgs)[:2] == ["uniform", "gradient"]
    cfgs = command._configurations({"samplers": "[ours,uniform]"}, ["scene=dodoco"])
    assert list(cfgs) == ["uniform", "gradient", "ours"]


@pytest.mark.parametrize(
    "arguments, words",
    [
        (["samplers=[uniform,urs]"], "did you mean 'ours'"),
        (["samplers=[ours,ours]"], "given twice"),
        (["repeats=1"], "repeats=1: a whole number, at least 2"),
        (["repeats=many"], "repeats=many: a whole number"),
        (["best=-1"], "best=-1: a whole number"),
        (["at=1.5"], "at=1.5: a number from 0"),
        (["at=nan"], "at=nan: a number from 0"),
        (["sampler=ours"], "samplers=[A,B]"),
        (["sampler.floor=0.1"], "samplers=[A,B]"),
        (["budget.seconds=3"], "no use for it"),
        (["prior=smoothness"], "no use for it"),
        (["+evaluation.count=3"], "no use for it"),
        (["frames.spp=3"], "no use for it"),
        (["report=false"], "no use for it"),
        (["loss=structure"], "what single pixels contribute"),
        (["optimizer.lt=1"], "did you mean 'optimizer.lr'"),
        (["contestants=[{sampler:ours,estimator.batch:9}]"], "give it once, as KEY=VALUE"),
        (["contestants=[{sampler.floor:0.1}]"], "each needs its sampler"),
        (["contestants=[{sampler:ours,sampler.flor:0.1}]"], "did you mean 'sampler.floor'"),
        (["contestants=[{sampler:ours,sampler.floor:2}]"], "sampler.floor=2"),
        (["contestants=[{"], "cannot be read"),
        (["repeats=8", "repeats=9"], "given twice"),
        (["seed=[1,2]"], "seed"),
        (["--fast"], "no such flag"),
        (["hydra.run.dir="], "hydra.run.dir is empty"),
    ],
)
def test_bad_requests_are_one_line_and_leave_nothing(arguments, words, refused):
    refused(["variance", "scene=dodoco", *arguments], words)


def test_help_names_every_setting_of_its_own(capsys):
    assert app.main(["variance", "--help"]) == 0
    text = capsys.readouterr().out
    assert all(word in text for word in ("samplers=", "contestants=", "repeats", "at ", "best"))


def test_the_point_lies_between_start_and_truth():
    p = problem({TEXTURE: 0.5})
    unknown = next(iter(p.unknowns))
    assert np.array_equal(as_numpy(point(p, 0.0)[TEXTURE]), unknown.start)
    assert np.allclose(as_numpy(point(p, 1.0)[TEXTURE]), unknown.truth, atol=1e-6)
    middle = as_numpy(point(p, 0.5)[TEXTURE])
    assert np.allclose(middle, (unknown.start + unknown.truth) / 2, atol=1e-6)
    unknown.truth = None
    assert as_numpy(point(p, 0.0)[TEXTURE]).shape == unknown.start.shape
    with pytest.raises(InputError, match="at=0.5: the truth is not known"):
        point(p, 0.5)


def test_what_is_finished_stays_after_ctrl_c(tmp_path):
    folder = tmp_path / "cut"
    command = [*SMALL, "samplers=[uniform]", "best=0", "repeats=1000000", f"hydra.run.dir={folder}"]
    process = started(tmp_path, *command, env={**os.environ, "PYTHONUNBUFFERED": "1"})
    path = folder / "variance.csv"
    until(process, lambda: path.exists() and int(read(folder)[0]["repeats"]) > 20)
    process.send_signal(signal.SIGINT)
    out, errors = process.communicate(timeout=100)
    assert process.returncode == 130, errors
    found = read(folder)
    repeats = int(found[0]["repeats"])
    assert repeats % 16 == 0 and 20 < repeats < 1_000_000, "whole rounds"
    assert [row["sampler"] for row in found] == ["uniform", "gradient"]
    assert found[1]["ratio_to_uniform_high"] != ""
    assert out == f"variance: {folder}\n" and (folder / "densities_v00.png").is_file()
    assert not list(folder.glob(".*.tmp"))


def test_what_is_found_by_differences_is_refused(isas):
    """Path replay's own derivative by it is another one than a run follows."""
    floor = f"""<scene version="3.0.0">{paths(3)}{camera()}
    <shape type="rectangle" id="wall"><bsdf type="roughplastic"><float name="alpha" value="0.2"/>
    </bsdf></shape><emitter type="constant"/></scene>"""
    Path("wall.xml").write_text(floor)
    unknown = 'scene.unknowns={"wall.bsdf.alpha": {"start": 0.4}}'
    words = "scene=file", "scene.path=wall.xml", unknown, "target.spp=4"
    status, _, err = isas("variance", *words)
    assert status == 2 and "isas: scene.unknowns: 'wall.bsdf.alpha' is found by differences" in err
