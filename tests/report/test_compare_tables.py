"""The files of a comparison, their words and numbers, and the command."""

from __future__ import annotations

import errno
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pandas
import pytest
import synthetic_runs as synthetic

from isas_cli.cli import compare as command
from isas_cli.cli import one
from isas_cli.report import compare
from isas_cli.report.compare import tables
from isas_cli.runtime.errors import InputError, IsasError

FILES = {"accuracy_time.csv", "price_of_accuracy.csv", "methods.csv", "curves.csv"}


@pytest.fixture
def runs(tmp_path) -> Path:
    """uniform: two seeds, one of which gets nowhere; ours: one."""
    folder = tmp_path / "runs"
    synthetic.power_law(folder / "1", 2, sampler="uniform", seed=1)
    synthetic.power_law(folder / "2", 90, sampler="uniform", seed=2)
    synthetic.power_law(folder / "3", 1, seed=1)
    return folder


@pytest.fixture
def page(monkeypatch):
    """Instead of the page: a note of what it was made from."""
    written = []

    def write(comparison, output: Path) -> Path:
        assert FILES <= {path.name for path in output.iterdir()}, "tables come first"
        written.append((comparison, output))
        return output / "report.html"

    monkeypatch.setattr("isas_cli.report.compare.page.write", write)
    return written


def test_tables_say_in_words_what_no_number_says(runs, tmp_path):
    tables.write(compare.build([runs]), tmp_path)
    frame = pandas.read_csv(tmp_path / "accuracy_time.csv", dtype=str, keep_default_na=False)
    assert list(frame.columns) == compare.accuracy.COLUMNS
    assert not (frame == "").any().any(), "no blanks"
    frame = frame[frame["measure"] == "image_rmse"].set_index(["level", "method"])
    uniform, ours = frame.loc[("0.5", "uniform")], frame.loc[("0.5", "ours")]
    assert (uniform["reached"], uniform["seconds"]) == ("1", "not reached")
    assert float(uniform["seconds_low"]) == pytest.approx(8)
    assert uniform["seconds_high"] == "not reached"
    assert uniform["ratio"] == "neither reached"  # of itself to itself
    assert ours["ratio"] == "inf" and ours["ratio_low"] == "one run"
    assert float(ours["seconds"]) == pytest.approx(4) and ours["seconds_high"] == "one run"
    assert (frame.loc["0.0625", ["seconds", "paths"]] == "not reached").all().all()


def test_every_table_reads_back_as_the_numbers_it_was(runs, tmp_path):
    comparison = compare.build([runs])
    written = tables.write(comparison, tmp_path)
    assert {path.name for path in written} == FILES
    frames = (comparison.accuracy, comparison.price, comparison.summary, comparison.curves)
    for path, frame in zip(written, frames):
        assert len(frame), path
        read = compare.read_accuracy(path)
        pandas.testing.assert_frame_equal(read, frame, check_dtype=False, check_exact=True)


def test_curves_are_numbers_for_pandas_alone(runs, tmp_path):
    tables.write(compare.build([runs]), tmp_path)
    frame = pandas.read_csv(tmp_path / "curves.csv")
    assert all(frame[name].dtype != object for name in ("x", "median", "low", "high", "runs"))


@pytest.mark.parametrize("strings", [False, True])
def test_a_method_that_did_not_converge_says_so(tmp_path, strings):
    """``strings``: texts have a type of their own, as in pandas 3."""
    with pandas.option_context("future.infer_string", strings):
        synthetic.write(tmp_path / "run", [0, 1, 2], [1.0, 0.5, 0.1])
        tables.write(compare.build([tmp_path / "run"]), tmp_path)
        assert pandas.read_csv(tmp_path / "methods.csv")["CS"].tolist() == ["not converged"]
        assert compare.read_accuracy(tmp_path / "methods.csv")["CS"].tolist() == [np.inf]


@pytest.mark.parametrize("text", [None, "", "scene,seconds\na,never\n", "\0\1"])
def test_what_is_no_table_is_refused(tmp_path, text):
    path = tmp_path / "accuracy_time.csv"
    if text is not None:
        path.write_text(text)
    with pytest.raises(InputError, match="no table of isas compare") as error:
        compare.read_accuracy(path)
    assert "\n" not in str(error.value)


def test_only_its_own_files_are_touched(runs, tmp_path, page):
    output = tmp_path / "out"
    output.mkdir()
    for name in ("notes.txt", "methods.csv"):
        (output / name).write_text("mine")
    before = {path: path.read_bytes() for path in runs.rglob("*") if path.is_file()}
    assert compare.compare([runs], output, None) == output / "report.html"
    assert (output / "notes.txt").read_text() == "mine"
    assert {path.name for path in output.iterdir()} == FILES | {"notes.txt"}
    assert {path: path.read_bytes() for path in runs.rglob("*") if path.is_file()} == before


def test_the_page_gets_the_numbers_and_the_folder(runs, page):
    assert compare.compare([runs]) == runs / "comparison" / "report.html"
    ((comparison, output),) = page
    assert output == runs / "comparison"
    assert comparison.baseline == {"pottery": "uniform"}
    # And once more, with the comparison lying among the runs.
    compare.compare([runs])
    assert len(page[1][0].methods) == len(comparison.methods)


def test_several_folders_are_compared_in_the_one_they_lie_in(runs, tmp_path, page):
    compare.compare([runs / "1", runs / "1" / ".." / "3"])
    assert page[0][1] == runs / "comparison"
    with pytest.raises(InputError, match="--output DIR"):
        compare.output_of([Path("/etc"), runs], None)


def test_an_output_that_is_a_file_is_refused_before_anything_is_read(tmp_path, runs):
    (tmp_path / "taken").write_text("")
    with pytest.raises(InputError, match="is a file: give a folder"):
        compare.compare([runs], tmp_path / "taken")


def test_an_output_that_cannot_be_made_is_one_line(tmp_path, runs):
    (tmp_path / "taken").write_text("")
    with pytest.raises(IsasError, match="cannot be written"):
        compare.compare([runs], tmp_path / "taken" / "below")


def test_the_command_reads_nothing_where_it_cannot_write(runs, tmp_path, monkeypatch):
    def readonly(dir):
        raise OSError(errno.EROFS, "Read-only file system")

    monkeypatch.setattr(one, "tempfile", SimpleNamespace(TemporaryFile=readonly))
    monkeypatch.setattr(compare, "build", lambda *_: pytest.fail("was read"))
    for output in (None, tmp_path / "no" / "such"):
        there = runs if output is None else tmp_path
        told = f"folder {there}: Read-only file system; give another with --output DIR"
        with pytest.raises(InputError, match=told):
            command.main([runs], output)


def test_few_seeds_are_warned_of(runs):
    single, few = compare.build([runs]).warnings
    assert "one run have no intervals" in single
    assert "with 2 seeds" in few and "50 %" in few


def test_the_command_prints_a_table_warnings_and_where_the_page_is(runs, page, capsys):
    assert command.main([runs]) == 0
    printed, said = capsys.readouterr()
    assert printed.splitlines()[-1] == f"report: {runs / 'comparison' / 'report.html'}"
    words = " ".join(printed.split())
    for word in ("uniform", "ours", "s to 1/8", "not reached"):
        assert word in words
    assert "warning: with 2 seeds" in said


def test_the_short_table_shows_how_far_the_baseline_gets_and_anyone(tmp_path):
    """Power laws: scale s reaches 2^-k at s 4^k, within 100 s."""
    for seed in (1, 2):
        for sampler, scale in (("uniform", 1), ("ours", 0.01)):
            folder = tmp_path / sampler / str(seed)
            synthetic.power_law(folder, scale, sampler=sampler, seed=seed)
    table = command.short_table(compare.build([tmp_path]), "pottery", "uniform")
    cells = {column.header: list(column.cells) for column in table.columns}
    assert list(cells)[-3:] == ["s to 1/4", "s to 1/8", "s to 1/64"]
    assert cells["s to 1/8"] == ["64 (×1.00)", "0.64 (×100.00)"]
    assert cells["s to 1/64"] == ["not reached", "41"]


def test_the_short_table_has_no_powers_of_ten_for_seconds(tmp_path):
    synthetic.write(tmp_path / "1", [0, 1234, 2345], [1.0, 0.5, 0.4])
    table = command.short_table(compare.build([tmp_path]), "pottery", "ours")
    cells = {column.header: list(column.cells) for column in table.columns}
    assert cells["s to 1/2"] == ["1,234 (×1.00)"]


def test_the_short_table_of_runs_that_got_nowhere_says_so(tmp_path):
    synthetic.write(tmp_path / "1", range(3), [1.0, 0.9, 0.8])
    table = command.short_table(compare.build([tmp_path]), "pottery", "ours")
    cells = {column.header: list(column.cells) for column in table.columns}
    assert cells["s to 1/2"] == ["not reached"] and cells["final image"] == ["0.8 (80.0%)"]


def test_the_short_table_is_of_the_image_where_no_parameter_error_was_halved(tmp_path):
    synthetic.write(tmp_path / "1", range(3), [1.0, 0.5, 0.4], [1.0, 0.9, 0.8])
    table = command.short_table(compare.build([tmp_path]), "pottery", "ours")
    assert "image error" in table.title
    cells = {column.header: list(column.cells) for column in table.columns}
    assert cells["s to 1/2"] == ["1 (×1.00)"] and cells["final parameter"] == ["0.8 (80.0%)"]


def test_labels_with_brackets_are_printed_as_they_are(tmp_path, page, capsys):
    for value in ("[bold]", "[red]"):
        synthetic.power_law(tmp_path / value, sampler="u", settings={"a.b": value})
    command.main([tmp_path])
    assert {"a.b=[bold]", "a.b=[red]"} <= set(capsys.readouterr().out.split())
