"""The comparison of every scene, small: it is told how long it takes, and goes on where it was."""

import sys

import pandas
import pytest
import reproduce

from isas_cli import records

SMALL = ["size=tiny", "estimator.batch=256", "target.spp=4", "evaluation.count=4"]
SMALL += ["evaluation.pixels=64", "frames.views=1", "frames.snapshots=0", "report=false"]


@pytest.fixture
def reproduced(tmp_path, monkeypatch, capfd):
    """Calls `reproduce.py` with one small scene: arguments → (status, stdout, stderr)."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(reproduce, "RESULTS", tmp_path / "results")
    monkeypatch.setattr(reproduce, "COMMON", [*SMALL, "threads=1"])
    monkeypatch.setattr(reproduce, "SAMPLERS", ("uniform", "relevant", "ours"))
    small = reproduce.Comparison(0.2, settings=(), rates=(0.01, 0.02))
    monkeypatch.setattr(reproduce, "SCENES", {"dodoco": small})
    monkeypatch.setattr(reproduce.pages, "write", lambda: None)

    def call(*arguments: str) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["reproduce.py", *arguments])
        with pytest.raises(SystemExit) as ended:
            reproduce.main()
        captured = capfd.readouterr()
        return ended.value.code, captured.out, captured.err

    return call


def test_a_scene_is_raced_at_every_rate_then_at_the_best(reproduced, tmp_path):
    status, out, err = reproduced("--seeds", "1", "2", "3")
    assert status == 0, err
    told = "scenes: 1, with 2 races of 12 runs: 0:00:02 billed, plus targets"
    assert out.startswith(told)
    assert "dodoco/rates: runs/reproduce/dodoco/rates" in err
    rates = pandas.read_csv("results/dodoco_rates.csv")
    assert len(rates) >= 6 and set(rates["seed"]) == {1}
    # Beyond where the best was at an end, up to three times.
    for _, own in rates.groupby("sampler"):
        best = own.loc[own["final"].idxmin(), "rate"]
        inside = own["rate"].min() < best < own["rate"].max()
        assert len(own) == 5 or (inside and len(own) < 5)
    kept = pandas.read_csv("results/reproduce.csv")
    assert kept["sampler"].tolist() == ["uniform", "relevant", "ours"]
    assert (kept["seeds"] == 2).all()
    assert {p.name for p in (tmp_path / "results").iterdir()} == {
        *("dodoco.csv", "dodoco_rates.csv", "reproduce.csv"),
        *("dodoco_errors.png", "dodoco_gallery.png"),
    }

    # Killed in the second race, whose table is made anew by another launcher.
    lost = next((tmp_path / "runs/reproduce/dodoco/seeds").rglob("summary.json"))
    lost.unlink()
    launcher = ["--launcher", "joblib", "n_jobs=2"]
    status, _, err = reproduced("--seeds", "1", "2", "3", *launcher)
    assert status == 0, err
    assert "dodoco/rates: skipped" in err and "dodoco/seeds: resumed" in err
    assert records.load(lost.parent).summary["status"] == "done"

    status, _, err = reproduced("--seconds", "9")
    assert "holds a race with other settings" in status and "--folder DIR" in status


def test_a_launcher_is_for_the_scenes_of_the_paper(reproduced):
    status, _, err = reproduced("plateau", "--launcher", "ray")
    assert status == 2 and err.endswith("error: --launcher: is for dodoco\n")
