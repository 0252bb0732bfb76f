"""The record of a run: whole files or none, numbers that survive, errors in one line."""

from __future__ import annotations

import errno
import json
import math
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas
import pytest
from disk import full_disk

from isas_cli import records
from isas_cli.runtime.errors import InputError, IsasError

ROW = {
    "iteration": np.int64(3),
    "seconds": 0.1 + 0.2,
    "paths": 3 * 2**40,
    "loss": np.float32(1e-7),
    "image_rmse": 1 / 3,
    "parameter_rmse": 0.25,
    "parameter_rmse/a.data": 0.5,
    "parameter_rmse/b.data": 2.0**-40,
    "gradient_norm": math.inf,
    "gradient_noise": 1e-20,
    "nonfinite": 2,
    "stage1_seconds": 0,
    "learning_rate": 0.02,
    "prior": 0.25,
}


def files_in(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


@pytest.mark.parametrize("failure", [KeyboardInterrupt, ValueError, MemoryError])
def test_a_failure_in_the_middle_of_a_write_leaves_the_old_file_whole(tmp_path, failure):
    path = tmp_path / "file.txt"
    records.write_atomically(path, lambda temporary: temporary.write_text("old"))

    def write_half(temporary: Path) -> None:
        temporary.write_text("ne")
        raise failure

    with pytest.raises(failure):
        records.write_atomically(path, write_half)
    assert path.read_text() == "old"
    assert files_in(tmp_path) == ["file.txt"]


def test_a_kill_in_the_middle_of_a_write_leaves_a_readable_run(tmp_path):
    writer = records.RunWriter(tmp_path)
    writer.manifest({})
    writer.evaluation(ROW)
    program = (
        "import os, signal, sys, pathlib\n"
        "from isas_cli.records import write_atomically\n"
        "def write(temporary):\n"
        "    temporary.write_text('half a row')\n"
        "    os.kill(os.getpid(), signal.SIGKILL)\n"
        "write_atomically(pathlib.Path(sys.argv[1]), write)\n"
    )
    subprocess.run([sys.executable, "-c", program, tmp_path / "history.csv"], check=False)
    assert any(name.endswith(".tmp") for name in files_in(tmp_path)), "was not killed in the write"
    run = records.load(tmp_path)
    assert len(run.history) == 1 and run.summary is None
    records.RunWriter(tmp_path, overwrite=True)
    assert files_in(tmp_path) == [".lock"]


def test_a_full_disk_is_one_line_that_names_the_file_and_keeps_the_earlier_version(tmp_path):
    writer = records.RunWriter(tmp_path)
    writer.manifest({"note": "first"})
    writer.checkpoint({"x": np.arange(3)}, {"iteration": 1})
    with full_disk(after_bytes=2000):
        with pytest.raises(IsasError) as of_manifest:
            writer.manifest({"note": "x" * 5000})
        with pytest.raises(IsasError) as of_checkpoint:
            writer.checkpoint({"x": np.arange(3000)}, {"iteration": 2})
    assert "manifest.json" in str(of_manifest.value) and "\n" not in str(of_manifest.value)
    assert "state.npz" in str(of_checkpoint.value)
    assert records.load(tmp_path).manifest["note"] == "first"
    arrays, state = records.load_checkpoint(tmp_path)
    assert arrays["x"].size == 3 and state == {"iteration": 1}
    assert not any(tmp_path.rglob("*.tmp"))


def test_history_reads_back_the_same_numbers_in_the_same_types(tmp_path):
    writer = records.RunWriter(tmp_path)
    writer.manifest({})
    writer.evaluation(ROW)
    writer.evaluation({**ROW, "iteration": 4, "gradient_norm": math.nan, "parameter_rmse": None})
    table = records.load(tmp_path).history
    assert list(table.columns) == list(ROW)
    whole = {"iteration", "paths", "nonfinite"}
    for name, value in ROW.items():
        assert table[name].dtype == ("int64" if name in whole else "float64"), name
        assert table[name][0] == value, name
    assert table["gradient_norm"].isna().tolist() == [False, True]
    assert table["parameter_rmse"].isna().tolist() == [False, True]
    assert records.load(tmp_path).keys == ["a.data", "b.data"]


def test_history_is_read_by_pandas_in_one_line_with_whole_numbers_whole(tmp_path):
    writer = records.RunWriter(tmp_path)
    writer.evaluation({k: v for k, v in ROW.items() if not k.startswith("parameter_rmse")})
    table = pandas.read_csv(tmp_path / "history.csv")
    assert table["paths"].dtype == "int64" and table["paths"][0] == 3 * 2**40
    assert table["image_rmse"][0] == pytest.approx(1 / 3, rel=1e-9)
    assert table["parameter_rmse"].isna().all()


def test_history_refuses_a_column_that_it_does_not_know_and_a_broken_count(tmp_path):
    writer = records.RunWriter(tmp_path)
    with pytest.raises(ValueError, match="imgae_rmse"):
        writer.evaluation({**ROW, "imgae_rmse": 1.0})
    with pytest.raises(TypeError):
        writer.evaluation({**ROW, "nonfinite": 0.5})
    assert not (tmp_path / "history.csv").exists()


def test_summary_and_manifest_are_strict_json_with_the_schema(tmp_path):
    writer = records.RunWriter(tmp_path)
    writer.config("scene:\n  name: pottery\nseed: 3\n")
    writer.manifest({"threads": np.int32(2), "views": (1, 2), "file": Path("a.exr")})
    writer.summary({"final": {"loss": np.float32(0.5), "parameter_rmse": math.nan}})

    def refuse(name):
        raise AssertionError(f"{name} is not JSON")

    text = (tmp_path / "summary.json").read_text()
    assert json.loads(text, parse_constant=refuse)["schema"] == records.SCHEMA_VERSION
    run = records.load(tmp_path)
    assert run.summary["final"] == {"loss": 0.5, "parameter_rmse": None}
    assert run.manifest["threads"] == 2 and run.manifest["views"] == [1, 2]
    assert run.config == {"scene": {"name": "pottery"}, "seed": 3}
    assert run.history.empty and "image_rmse" in run.history


def test_checkpoint_keeps_arrays_and_state_exactly(tmp_path):
    rng = np.random.default_rng(0)
    arrays = {
        "jar.bsdf/base color": rng.random((4, 5, 3)).astype(np.float32),
        "file": np.array(2**60, dtype=np.uint64),
        "empty": np.zeros((0, 3)),
    }
    state = {"seed": 2**70, "step": 7, "rate": 0.1, "names": ["a"], "done": False}
    writer = records.RunWriter(tmp_path)
    writer.checkpoint({}, {})
    writer.checkpoint(arrays, {**state, "step": np.int64(7)})
    read, read_state = records.load_checkpoint(tmp_path)
    assert read_state == state
    assert read.keys() == arrays.keys()
    for name, array in arrays.items():
        assert read[name].dtype == array.dtype and np.array_equal(read[name], array), name
    with pytest.raises(ValueError):
        writer.checkpoint({"x": np.array([None])}, {})
    assert records.load_checkpoint(tmp_path)[1] == state


@pytest.mark.parametrize("name", ["manifest.json", "summary.json"])
def test_another_schema_version_is_refused_by_name(tmp_path, name):
    writer = records.RunWriter(tmp_path)
    writer.manifest({})
    (tmp_path / name).write_text('{"schema": 99}')
    with pytest.raises(InputError, match=rf"{name}: schema version 99; this isas reads "):
        records.load(tmp_path)


def test_a_reopened_record_keeps_the_rows_up_to_its_checkpoint(tmp_path):
    writer = records.RunWriter(tmp_path)
    writer.manifest({})
    for iteration in (0, 4, 9):
        writer.evaluation({**ROW, "iteration": iteration, "parameter_rmse": None})
    writer.summary({"status": "interrupted"})
    pictures = [f"progress_v00_i{text}.exr" for text in ("00004", "00009", "00009 (1)", "00009a")]
    (tmp_path / "frames").mkdir()
    for name in pictures:
        (tmp_path / "frames" / name).touch()
    again = records.RunWriter.reopen(tmp_path, 4)
    pictures.remove("progress_v00_i00009.exr")
    assert files_in(tmp_path / "frames") == sorted(pictures), "others are a user's own"
    assert [row["iteration"] for row in again.rows] == [0, 4]
    assert "parameter_rmse" not in again.rows[0] and again.rows[0]["image_rmse"] == 1 / 3
    assert not (tmp_path / "summary.json").exists(), "the run has not ended"
    assert records.load(tmp_path).history["iteration"].tolist() == [0, 4], "at once"
    again.evaluation({**ROW, "iteration": 7})
    assert records.load(tmp_path).history["iteration"].tolist() == [0, 4, 7]


def test_a_folder_without_a_run_is_refused_in_one_line(tmp_path):
    with pytest.raises(InputError, match="no such run folder"):
        records.load(tmp_path / "nothing")
    with pytest.raises(InputError, match="holds no run"):
        records.load(tmp_path)
    with pytest.raises(InputError, match="holds no checkpoint"):
        records.load_checkpoint(tmp_path)


@pytest.mark.parametrize("name", ["manifest.json", "config.yaml", "history.csv"])
def test_a_damaged_file_is_one_line_that_names_it(tmp_path, name):
    writer = records.RunWriter(tmp_path)
    writer.manifest({})
    (tmp_path / name).write_text('{"a": [\nloss,paths\n1,2,3,4\nx,y: :')
    with pytest.raises(InputError, match=name) as error:
        records.load(tmp_path)
    assert "\n" not in str(error.value)


def test_what_is_nested_too_deeply_or_too_large_is_damaged(tmp_path):
    texts = ("manifest.json", "[" * 100_000), ("config.yaml", "[" * 2000)
    for name, text in (*texts, ("history.csv", f"iteration\n{2**70}\n")):
        folder = tmp_path / name.partition(".")[0]
        records.RunWriter(folder).manifest({})
        (folder / name).write_text(text)
        with pytest.raises(InputError, match=f"{name}: cannot be read") as error:
            records.load(folder)
        assert "\n" not in str(error.value)


def test_a_damaged_checkpoint_is_one_line_that_names_it(tmp_path):
    records.RunWriter(tmp_path).checkpoint({"x": np.ones(9)}, {})
    path = tmp_path / "checkpoint" / "state.npz"
    path.write_bytes(path.read_bytes()[:200])
    with pytest.raises(InputError, match="state.npz: damaged") as error:
        records.load_checkpoint(tmp_path)
    assert "\n" not in str(error.value)


def test_a_folder_that_holds_a_run_is_refused_unless_it_may_be_overwritten(tmp_path):
    first = records.RunWriter(tmp_path)
    first.manifest({})
    first.evaluation(ROW)
    first.frame("target_v00", np.ones((2, 2, 3)), ["R", "G", "B"], {})
    first.checkpoint({}, {})
    first.mesh("result_a.ply", b"mine")
    mine = ["frames/mine.exr", "frames/mine.txt", "meshes/jar.ply"]
    for name in mine:
        (tmp_path / name).write_text("keep")
    with pytest.raises(InputError, match="already holds a run"):
        records.RunWriter(tmp_path)
    assert (tmp_path / "history.csv").exists()
    records.RunWriter(tmp_path, overwrite=True)
    left = [path.relative_to(tmp_path).as_posix() for path in tmp_path.rglob("*") if path.is_file()]
    assert sorted(left) == [".lock", *mine]


@pytest.mark.parametrize("number", [errno.ENOSYS, errno.ENOLCK, errno.EOPNOTSUPP])
def test_a_disk_without_locks_holds_runs(tmp_path, monkeypatch, number):
    def none(*unused):
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr("fcntl.lockf", none)
    records.RunWriter(tmp_path).evaluation(ROW)
    assert len(records.RunWriter.reopen(tmp_path, 3).rows) == 1
    number = errno.EIO
    with pytest.raises(InputError, match="cannot be written"):
        records.RunWriter.reopen(tmp_path, 3)


def test_a_folder_that_cannot_be_written_is_one_line_with_the_way_out(tmp_path):
    (tmp_path / "file").write_text("")  # below a file nobody can write, root included
    with pytest.raises(InputError, match="hydra.run.dir=DIR") as error:
        records.RunWriter(tmp_path / "file" / "run")
    assert str(tmp_path / "file" / "run") in str(error.value)
    with pytest.raises(IsasError, match="cannot be written"):
        records.write_atomically(tmp_path / "file" / "a.txt", lambda path: path.write_text("x"))


def test_every_key_has_a_file_name_of_its_own_that_gives_it_back():
    keys = ["jar.bsdf.base_color.data", "a/b", "a_b", "a b", "ä%2F", "../up"]
    names = [records.safe_name(key) for key in keys]
    assert [records.key_of(name) for name in names] == keys
    assert len(set(names)) == len(keys) and not any("/" in name for name in names)


def test_letters_of_other_scripts_do_not_make_names_longer_than_files_have(tmp_path):
    key = f"{'白い陶器の花瓶' * 9}.bsdf.base_color.data"
    records.write_text(tmp_path / f"turntable_{records.safe_name(key)}.webp", "")
    (path,) = tmp_path.iterdir()
    assert records.key_of(path.stem.removeprefix("turntable_")) == key
    # Accents are quoted, which some systems join to the letter, or take off it.
    assert records.safe_name("e\u0301") == "e%CC%81" and records.safe_name("\u00e9") == "%C3%A9"


def test_a_record_is_not_read_where_another_has_taken_its_place(tmp_path):
    """Nor where it went on: its history would be of another length."""
    writer = records.RunWriter(tmp_path)
    writer.manifest({"seeds": {"run": 1}})
    writer.checkpoint({"value/a": np.zeros(2, np.float32)}, {"iteration": 0})
    run = records.load(tmp_path)
    writer.checkpoint({"value/a": np.ones(2, np.float32)}, {"iteration": 1})
    assert run.parameters()["a"].tolist() == [1, 1], "it goes on while it is read"
    for other in ({"seeds": {"run": 2}}, {"seeds": {"run": 1}, "resumed": [{"iteration": 1}]}):
        writer.manifest(other)
        for read in (run.parameters, lambda: run.frame("result_v00")):
            with pytest.raises(InputError, match="was written again since it was loaded"):
                read()
