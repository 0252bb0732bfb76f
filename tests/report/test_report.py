"""The report of a synthetic run: everything that the records hold, nothing from elsewhere."""

from __future__ import annotations

import json
import math
from html.parser import HTMLParser
from pathlib import Path
from types import SimpleNamespace

import matplotlib
import numpy as np
import pytest
import synthetic_runs as synthetic
from matplotlib.figure import Figure
from runs_for_tests import gone, process

from isas_cli import report
from isas_cli.records import SCHEMA_VERSION, RunWriter, load, safe_name
from isas_cli.report import cells, figures, frames, inside, page, plots
from isas_cli.report.compare import page as compare_page
from isas_cli.runtime import images

KEYS = ("jar.bsdf.base_color.data", "jar.bsdf.roughness.data")
VOID = {"meta", "link", "img", "br", "hr", "input"}
FRAME_NAMES = ("target", "start", "result", "error", "density")


class Checker(HTMLParser):
    """Collects what the page refers to, its text, and tags that do not close in order."""

    def __init__(self, text: str):
        super().__init__(convert_charrefs=True)
        self.links: list[str] = []
        self.tags: list[str] = []
        self.text = ""
        self.open: list[str] = []
        self.feed(text)
        self.close()

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.links += [value for name, value in attrs if name in ("src", "href", "srcset")]
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.text += data


def measures(error: float, truth: bool) -> dict[str, float | None]:
    each = {f"parameter_rmse/{key}": error * (2 + i) for i, key in enumerate(KEYS)} if truth else {}
    own = {"loss": error**2, "image_rmse": error, "parameter_rmse": 2.3 * error if truth else None}
    return {**own, **each}


def evaluate(writer: RunWriter, count: int, truth: bool = True) -> None:
    for step in range(count):
        row = measures(0.3 * 0.8**step, truth)
        row.update(iteration=step * 10, seconds=step * 1.5, paths=step * 131072)
        row.update(gradient_norm=None if step == 0 else 1e-4 / step, nonfinite=step % 3)
        writer.evaluation({**row, "stage1_seconds": 0.1 * step, "learning_rate": 0.02})


def save_frames(writer: RunWriter, truth: bool = True, names: tuple[str, ...] = FRAME_NAMES):
    rng = np.random.default_rng(5)
    for view in range(2):
        for name in names:
            channels = ["Y"] if name == "density" else ["R", "G", "B"]
            image = rng.random((12, 16, len(channels)))
            writer.frame(f"{name}_v{view:02d}", image, channels, {"what": name, "view": view})
    for key in KEYS:
        for name in ("truth", "start", "result") if truth else ("start", "result"):
            writer.frame(f"{name}_{safe_name(key)}", rng.random((8, 8)), ["Y"], {"what": name})


def begin(folder: Path) -> RunWriter:
    writer = RunWriter(folder)
    writer.config("scene: {name: pottery}\nsampler: {name: ours}\nloss: l2\nseed: 7\n")
    writer.manifest({"command": "isas run scene=pottery <script>alert(1)</script>"})
    return writer


def summarise(writer: RunWriter, truth: bool = True, **changes) -> dict:
    summary = {
        **{"status": "done", "scene": "pottery", "sampler": "ours", "loss": "l2", "seed": 7},
        **{"iterations": 110, "paths": 1441792, "seconds_billed": 16.51},
        "seconds_by_phase": {"stage1": 1.11, "step": 14.3, "optimizer": 1.1},
        "seconds_unbilled": {"load": 0.52, "targets": 3.21, "evaluation": 2.6, "writing": 0.31},
        "start": measures(0.3, truth),
        "final": measures(0.0257, truth),
        "warnings": ["7 gradient entries & <b>more</b>"],
        **changes,
    }
    writer.summary(summary)
    return summary


def check(path: Path) -> Checker:
    """Parses the page and asserts that it is well formed and stands alone."""
    checker = Checker(path.read_text(encoding="utf-8"))
    assert checker.open == []
    assert "script" not in checker.tags and "link" not in checker.tags
    assert all(link.startswith("data:image/png;base64,") for link in checker.links)
    text = path.read_text(encoding="utf-8")
    assert "://" not in text and "url(" not in text and "@import" not in text
    return checker


def plot_names(folder: Path) -> set[str]:
    return {path.name for path in (folder / "plots").iterdir()}


def test_the_page_holds_the_numbers_the_pictures_and_nothing_from_outside(tmp_path):
    writer = begin(tmp_path)
    evaluate(writer, 12)
    save_frames(writer)
    summary = summarise(writer)
    path = report.write(tmp_path)
    assert path == tmp_path / "report.html"
    checker = check(path)
    for end in ("start", "final"):
        for name, value in summary[end].items():
            assert name in checker.text and f"{value:.4g}" in checker.text, (end, name)
    for phases in (summary["seconds_by_phase"], summary["seconds_unbilled"]):
        for phase, seconds in phases.items():
            assert phase in checker.text and f"{seconds:.4g}" in checker.text, phase
    assert "1,441,792" in checker.text and f"{1441792 / 16.51:,.0f}" in checker.text
    assert f"{0.0257 / 0.3:.4g}" in checker.text
    for words in ("pottery, ours", "done", "7 gradient entries & <b>more</b>", "<script>alert"):
        assert words in checker.text
    expected = {"errors.png", "unknowns.png", "training.png", "time.png", "sheet.png"}
    assert plot_names(tmp_path) == expected | {"textures.png"}
    assert len(checker.links) == 6
    assert not any(tmp_path.rglob("*.tmp"))


def test_a_report_can_be_made_again(tmp_path):
    writer = begin(tmp_path)
    evaluate(writer, 3)
    summarise(writer)
    first = report.write(tmp_path).read_text()
    assert report.write(tmp_path).read_text() == first


def test_what_a_user_has_set_for_plots_of_his_own_does_not_count(tmp_path):
    writer = begin(tmp_path)
    evaluate(writer, 3)
    summarise(writer)
    save_frames(writer)
    first = report.write(tmp_path).read_text()
    with matplotlib.rc_context({"text.usetex": True, "image.origin": "lower", "font.size": 20}):
        assert report.write(tmp_path).read_text() == first
        assert matplotlib.rcParams["text.usetex"]


def test_a_run_without_truth_shows_no_parameter_error(tmp_path):
    writer = begin(tmp_path)
    evaluate(writer, 4, truth=False)
    save_frames(writer, truth=False)
    summarise(writer, truth=False)
    checker = check(report.write(tmp_path))
    assert "truth is not known" in checker.text and "parameter_rmse" not in checker.text
    assert "unknowns.png" not in plot_names(tmp_path)


@pytest.mark.parametrize("count", [0, 1, 5])
def test_a_run_that_was_killed_is_reported_from_its_history(tmp_path, count):
    writer = begin(tmp_path)
    evaluate(writer, count)
    checker = check(report.write(tmp_path))
    assert "killed, or not yet at its end" in checker.text and "pottery, ours" in checker.text
    assert ("before its first evaluation" in checker.text) == (count == 0)
    if count == 5:
        assert f"{4 * 131072:,}" in checker.text and f"{0.3 * 0.8**4:.4g}" in checker.text


def test_a_run_that_goes_on_is_not_called_stopped(tmp_path):
    """On its own page, and on that of a comparison."""
    writer = begin(tmp_path)
    evaluate(writer, 2)
    said = (
        (process(), "still running, or"),
        (process(gone()), "stopped before it could end"),
    )
    for entry, told in (*said, (process(host="elsewhere"), "killed, or not yet at its end")):
        writer.manifest(entry)
        run = load(tmp_path)
        assert told in check(page.write_page(run, [], [])).text
        shown = compare_page._record(SimpleNamespace(label="ours"), run, tmp_path)
        assert told in shown["status"]


def test_a_job_whose_process_died_is_reported_from_its_history(tmp_path):
    evaluate(begin(tmp_path), 5)
    died = {
        "schema": SCHEMA_VERSION,
        "status": "failed",
        "error": "killed by signal 9",
        "killed": True,
    }
    (tmp_path / "summary.json").write_text(json.dumps(died))
    assert f"{0.3 * 0.8**4:.4g}" in check(report.write(tmp_path)).text


def test_a_numerical_failure_is_reported_with_its_non_finite_values(tmp_path):
    writer = begin(tmp_path)
    evaluate(writer, 2)
    last = {**measures(math.inf, True), "iteration": 20, "seconds": 3.0, "paths": 9, "nonfinite": 4}
    writer.evaluation({**last, "image_rmse": math.nan})
    save_frames(writer)
    bad = np.full((12, 16, 3), np.nan)
    writer.frame("result_v00", bad, ["R", "G", "B"], {})
    writer.frame("error_v00", bad, ["R", "G", "B"], {})
    summarise(writer, status="numerical failure", final=measures(math.nan, True))
    checker = check(report.write(tmp_path))
    assert "numerical failure" in checker.text and "–" in checker.text
    sheet = images.to_display(images.read(tmp_path / "plots" / "sheet.png"))
    magenta = (sheet == (255, 0, 255)).all(axis=2).mean()
    assert magenta > 0.1, "NaN pixels are not marked"


def test_missing_and_damaged_frames_leave_a_gap_and_no_error(tmp_path):
    writer = begin(tmp_path)
    evaluate(writer, 2)
    save_frames(writer, names=("target", "result"))
    (tmp_path / "frames" / "target_v01.exr").write_bytes(b"damaged")
    (tmp_path / "frames" / "other.exr").write_bytes(b"not a frame of ours")
    summarise(writer)
    check(report.write(tmp_path))
    assert {"sheet.png", "textures.png"} <= plot_names(tmp_path)


def test_large_and_thin_frames_are_reduced_by_their_mean(tmp_path):
    image = np.random.default_rng(3).random((1025, 2048, 3)).astype(np.float32)
    images.write_exr(tmp_path / "a.exr", image, ["R", "G", "B"], {})
    reduced = cells.read_reduced(tmp_path / "a.exr")
    assert reduced.shape == (256, 512, 3)
    assert reduced[1, 2] == pytest.approx(image[4:8, 8:12].mean(axis=(0, 1)), rel=1e-5)
    images.write_exr(tmp_path / "b.exr", image[:1], ["R", "G", "B"], {})
    assert cells.read_reduced(tmp_path / "b.exr").shape == (1, 512, 3)


def test_errors_are_taken_before_frames_are_reduced(tmp_path):
    """Of what alternates from pixel to pixel nothing is left in the means."""
    checks = np.indices((1024, 1024)).sum(axis=0)[..., None] % 2 * np.ones(3, np.float32)
    (tmp_path / "frames").mkdir()
    for name in ("start_v00", "held_result_v00", "result_jar", "start_jar"):
        images.write_exr(tmp_path / "frames" / f"{name}.exr", checks, ["R", "G", "B"], {})
    for name in ("target_v00", "held_target_v00", "truth_jar"):
        images.write_exr(tmp_path / "frames" / f"{name}.exr", 0.5 + 0 * checks, [*"RGB"], {})
    images.write_exr(tmp_path / "frames" / "held_weight_v00.exr", 0 * checks + 1, [*"RGB"], {})
    views, textures = frames.read(tmp_path, "00")
    found = [views["00"]["before"], textures["jar"]["before"], textures["jar"]["error"]]
    found.append(frames.held_out(tmp_path)["held out 0"]["error"])
    assert all(each.shape == (512, 512, 3) and each.min() == 0.5 == each.max() for each in found)


def test_the_exposure_brings_the_targets_99th_percentile_to_white():
    target = np.linspace(0, 8, 12 * 16 * 3).reshape(12, 16, 3)
    rows = {"view 0": {"target": target, "result": 100 * target}}
    exposure, words = cells.exposure(rows, ("target", "result"))
    assert exposure == pytest.approx(1 / np.percentile(target, 99))
    assert "99th percentile of the target" in words and f"{exposure:.3g}" in words
    assert cells.exposure({"view 0": {}}, ("target",))[0] == 1.0
    assert cells.exposure({"view 0": {"target": target * 0}}, ("target",))[0] == 1.0


@pytest.mark.parametrize(
    "values", [[0.3, 0.31], [1.0, 1e-9], [0.0, 0.0], [5.0], [np.nan, 2.0], [0.0, 0.2, 0.1]]
)
def test_error_axes_have_labels_for_any_range(values):
    axes = Figure().subplots()
    axes.plot(values)
    figures.log_values(axes, np.array(values))
    axes.figure.canvas.draw()
    low, high = axes.get_ylim()
    inside = [tick for tick in axes.get_yticks() if low <= tick <= high]
    assert len(inside) >= 2 or len(values) == 1


def test_curves_carry_the_history_and_their_units(tmp_path, monkeypatch):
    writer = begin(tmp_path)
    evaluate(writer, 6)
    summarise(writer)
    drawn: dict[str, Figure] = {}
    monkeypatch.setattr(plots, "save", lambda made, path: drawn.update({path.name: made}))
    run = load(tmp_path)
    plots.write_plots(run)
    upper, _, lower, paths = drawn["errors.png"].axes
    curve = next(line for line in upper.lines if len(line.get_xdata()) == 6)
    assert np.array_equal(curve.get_xdata(), run.history["seconds"])
    assert np.array_equal(curve.get_ydata(), run.history["image_rmse"])
    assert upper.get_yscale() == "log"
    assert lower.get_xlabel() == "billed seconds" and paths.get_xlabel() == "light paths"
    assert "unit" in lower.get_title("left") and "radiance" in upper.get_title("left")
    widths = sum(bar.get_width() for axes in drawn["time.png"].axes for bar in axes.patches)
    assert widths == pytest.approx(1.11 + 14.3 + 1.1 + 0.52 + 3.21 + 2.6 + 0.31)


def test_the_page_says_why_a_run_failed(tmp_path):
    run = synthetic.write(
        tmp_path, [0, 1], [1, 0.5], status="failed", summary={"error": "its process was killed"}
    )
    report.write(run)
    assert "failed: its process was killed" in (tmp_path / "report.html").read_text()


def test_methods_without_times_by_phase_have_no_row(tmp_path):
    whole = synthetic.run(tmp_path / "a", [0, 1], [1, 0.5], summary={"by": {"step": 2.0}})
    killed = synthetic.run(tmp_path / "b", [0, 1], [1, 0.5], status=None)
    assert list(inside.phases({"ours": [whole], "killed": [killed]}, "by").index) == ["ours"]


def test_numbers_are_shown_to_four_digits():
    shown = [page.number(x) for x in (None, math.nan, 0, 1234567, 0.123456, 60.0, 936853.2, 1e-9)]
    assert shown == ["–", "–", "0", "1,234,567", "0.1235", "60", "936,853", "1e-09"]


def test_a_chart_of_several_runs_says_that_it_has_medians():
    """Of one method, too."""
    runs = [SimpleNamespace(summary={"seconds_by_phase": {"step": s}}) for s in (1.0, 3.0)]
    for own, told in ((runs, True), (runs[:1], False)):
        ((panel, *_),) = inside.times({"a": own}).grid
        assert ("median over runs" in panel.title) == told
