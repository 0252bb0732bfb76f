"""Plots, sheets and the animation of a comparison show its numbers, and nothing else."""

from __future__ import annotations

import base64
import io
import math
import xml.etree.ElementTree
from dataclasses import replace
from pathlib import Path

import matplotlib
import numpy as np
import pandas
import pictured_runs as pictured
import pytest
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure
from PIL import Image

from isas_cli.report import inside, interactive, static
from isas_cli.report.chart import Axis, Chart, Panel, Points, Rule, Style, log_axis
from isas_cli.report.compare import (
    Comparison,
    animation,
    build,
    charts,
    content,
    facts,
    plots,
    sheet,
    slides,
    styles,
    typical,
)
from isas_cli.report.compare.gather import by_scene
from isas_cli.report.figures import COLOURS, save
from isas_cli.runtime import images


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    return pictured.two_scenes(tmp_path_factory.mktemp("runs"))


@pytest.fixture(scope="module")
def comparison(folder) -> Comparison:
    return build([folder])


def every_chart(comparison: Comparison, scene: str = "pottery") -> dict[str, Chart]:
    methods, own = by_scene(comparison.methods)[scene], styles.styles(comparison)
    made = charts.of_costs(comparison, scene, methods, own) + charts.of_insides(methods, own)
    assert all(chart.title and chart.note for chart in made)
    return {chart.name: chart for chart in made}


def drawn(name: str, comparison: Comparison, scene: str = "pottery") -> Figure:
    return static.draw(every_chart(comparison, scene)[name])


def lines(axes, colour: str) -> list:
    return [line for line in axes.lines if to_rgba(line.get_color()) == to_rgba(colour)]


def test_every_plot_is_a_png_and_an_svg_and_the_same_when_made_again(comparison, tmp_path):
    made = []
    for scene in ("dodoco", "pottery"):
        made += plots.write_plots(
            scene, list(every_chart(comparison, scene).values()), tmp_path / "first"
        )
    names = [path.stem for path in made if path.stem.startswith("pottery")]
    kinds = ["errors", "speedup", "price", "time", "training"]
    assert names == [f"pottery_{kind}" for kind in kinds]
    for path in made:
        assert Image.open(path).size[0] > 900
        text = path.with_suffix(".svg").read_text()
        assert xml.etree.ElementTree.fromstring(text).tag.endswith("svg")
    chart = every_chart(comparison, "dodoco")["errors"]
    plots.write_plots("dodoco", [chart], tmp_path / "second")
    again = list((tmp_path / "second").iterdir())
    assert len(again) == 2
    for path in again:
        assert path.read_bytes() == (tmp_path / "first" / path.name).read_bytes(), path.name


def test_a_method_has_one_style_in_all_scenes_and_no_two_share_one(comparison):
    own = styles.styles(comparison)
    assert list(own) == ["uniform", "ours", "gradient"]
    assert [style.colour for style in own.values()] == list(COLOURS[:3])
    many = [styles._style(index) for index in range(4 * 13)]
    assert len({(style.colour, style.kind) for style in many}) == len(many)
    named = {str(number): style for number, style in enumerate(many)}
    assert styles.repeated(named) == []
    (warning,) = styles.repeated(named | {"one more": many[0]})
    assert warning == "53 methods: after 52 their colours and dashes begin again"
    for drawer in (static._LINES, static._HATCHES, interactive._DASHES, interactive._PATTERNS):
        assert len(set(drawer)) == styles._KINDS


@pytest.mark.filterwarnings("error")  # of a layout that cannot be
def test_a_rule_without_a_place_on_a_logarithmic_axis_is_left_out(tmp_path):
    """A start whose error is 0."""
    values = np.array([0, 1.5e-9, 1.5e-9, 0])
    marks = [Points("a", np.arange(4.0), values), Rule(0.0, "start"), Rule(1.5e-9, "here")]
    panel = Panel(Axis("x"), log_axis("y", values), marks)
    assert panel.placed == [marks[0], marks[2]]
    linear = Panel(Axis("x"), Axis("y"), marks)
    assert linear.placed == marks
    chart = Chart("c", "", "", [[panel]], {"a": Style("#000000")})
    save(static.draw(chart), tmp_path / "c.png")
    assert len(interactive.draw(chart).layout.annotations) == 1


@pytest.mark.parametrize("name", ["errors", "speedup", "price", "time", "training"])
def test_the_page_and_the_picture_of_a_chart_show_the_same(comparison, name):
    chart = every_chart(comparison)[name]
    figure, canvas = interactive.draw(chart), static.draw(chart)
    wide = len(chart.grid[0])
    columns = range(1 if chart.alternatives else wide)
    order = [axes for column in columns for axes in canvas.axes[column::wide]]
    for row, axes in enumerate(order, start=1):
        end = "" if row == 1 else str(row)
        for which in "xy":
            own = figure.layout[f"{which}axis{end}"]
            limits = np.array(getattr(axes, f"get_{which}lim")())
            assert own.type == getattr(axes, f"get_{which}scale")()
            if own.range is not None:
                assert own.range == pytest.approx(np.log10(limits) if own.type == "log" else limits)
        traces = [
            t
            for t in figure.data
            if t.yaxis == f"y{end}" and t["fill" if t.type == "scatter" else "type"] != "toself"
        ]
        on_page = [v for t in traces if t.type == "scatter" for v in t.y if v is not None]
        curves = [line for line in axes.lines if line.get_transform() == axes.transData]
        in_picture = np.concatenate([[], *(line.get_ydata() for line in curves)])
        assert sorted(on_page) == pytest.approx(sorted(in_picture[np.isfinite(in_picture)]), 1e-4)
        bars = [t for t in traces if t.type == "bar"]
        on_page = [v for t in bars for v in (t.x if t.orientation == "h" else t.y) if v != 1e-6]
        in_picture = [b.get_width() if name == "time" else b.get_height() for b in axes.patches]
        assert on_page == pytest.approx(in_picture, rel=1e-4)


def test_curves_carry_the_medians_and_break_where_a_run_ends(comparison):
    figure = drawn("errors", comparison)
    assert [axes.get_xscale() + axes.get_yscale() for axes in figure.axes] == ["loglog"] * 4
    panels = [(m, c) for m in ("parameter_rmse", "image_rmse") for c in ("seconds", "paths")]
    for axes, (measure, cost) in zip(figure.axes, panels):
        for label, own in styles.styles(comparison).items():
            rows = content.rows(
                comparison.curves, scene="pottery", method=label, measure=measure, axis=cost
            ).sort_values("x")
            curves = [line for line in lines(axes, own.colour) if len(line.get_xdata())]
            assert len(curves) == (2 if label == "gradient" else 1)
            x, y = np.concatenate([c.get_xydata() for c in curves]).T
            assert np.array_equal(x, rows["x"]) and np.array_equal(y, rows["median"])
            low = min(path.vertices[:, 1].min() for b in axes.collections for path in b.get_paths())
            assert low <= rows["low"].min()
    x, y = np.log(lines(figure.axes[0], "#666666")[0].get_data())
    assert (y[1] - y[0]) / (x[1] - x[0]) == pytest.approx(-0.5)


def test_bars_are_the_ratios_and_words_stand_where_there_is_none(comparison):
    upper = drawn("speedup", comparison).axes[0]
    words = []
    for label in ("ours", "gradient"):
        colour = to_rgba(styles.styles(comparison)[label].colour)
        levels = content.levels(comparison, "pottery", "parameter_rmse")
        rows = content.rows(
            comparison.accuracy, scene="pottery", measure="parameter_rmse", method=label
        ).set_index("level")["ratio"][levels]
        heights = [bar.get_height() + 1 for bar in upper.patches if bar.get_facecolor() == colour]
        assert heights == pytest.approx([r for r in rows if math.isfinite(r) and r > 0])
        own = [t.get_text() for t in upper.texts if to_rgba(t.get_color()) == colour]
        assert len(own) + len(heights) == len(levels)
        assert own.count("baseline: not reached") == sum(math.isinf(r) for r in rows)
        words += own
    assert {"not reached", "baseline: not reached"} == set(words)


def test_the_price_is_drawn_with_its_slopes(comparison):
    figure = drawn("price", comparison)
    left, right = figure.axes[:2]
    own = styles.styles(comparison)["uniform"].colour
    rows = content.price(comparison, "pottery", "parameter_rmse", "uniform")
    (curve,) = [line for line in lines(left, own) if line.get_marker() == "o"]
    reached = rows["seconds"][np.isfinite(rows["seconds"])]
    seconds = curve.get_ydata()
    assert seconds[np.isfinite(seconds)] == pytest.approx(list(reached))
    (crosses,) = [line for line in lines(left, own) if line.get_marker() == "x"]
    assert len(crosses.get_xdata()) == np.isinf(rows["seconds"]).sum() > 0
    dots = [line.get_xdata()[0] for line in right.lines if line.get_marker() == "o"]
    labels = [method.label for method in by_scene(comparison.methods)["pottery"]]
    slopes = [
        content.price(comparison, "pottery", "parameter_rmse", label).iloc[0]["slope_seconds"]
        for label in labels
    ]
    assert dots == pytest.approx(slopes)
    assert any(list(line.get_xdata()) == [-0.5, -0.5] for line in right.lines)


def test_time_and_what_the_optimiser_saw(comparison):
    billed, unbilled = drawn("time", comparison).axes
    assert sum(bar.get_width() for bar in billed.patches) == pytest.approx(3 * 10.0)
    assert sum(bar.get_width() for bar in unbilled.patches) == pytest.approx(3 * 3.5)
    names = {text.get_text() for text in billed.figure.legends[0].get_texts()}
    assert names >= {f"{phase} (not billed)" for phase in pictured.UNBILLED}
    assert [text.get_text() for text in billed.get_yticklabels()] == [
        f"{label}, 10 s" for label in ("uniform", "gradient", "ours")
    ]
    norm, noise, nonfinite = drawn("training", comparison).axes
    assert [len(axes.lines) for axes in (norm, noise, nonfinite)] == [9, 9, 9]
    longest = max(norm.lines, key=lambda line: len(line.get_xdata()))
    assert list(longest.get_ydata()) == pytest.approx([0.1 / row for row in range(1, 6)])
    assert max(line.get_ydata().max() for line in nonfinite.lines) == 3


def test_gradient_noise_is_shown_from_the_second_iteration_on(comparison):
    run = comparison.methods[0].runs[0]
    rows = run.history.assign(iteration=range(len(run.history)))
    runs = [replace(run, history=rows)]
    ((seconds, norm),) = inside.histories(runs, "gradient_norm")
    ((late, noise),) = inside.histories(runs, "gradient_noise")
    assert len(norm) == len(rows) - 1 and len(noise) == len(rows) - 2
    assert np.array_equal(late, seconds[1:])


def test_of_very_many_rows_some_are_drawn_with_the_last(comparison):
    run = comparison.methods[0].runs[0]
    rows = pandas.DataFrame({"iteration": range(2, 20_002), "seconds": range(20_000)}) * 1.0
    ((seconds, loss),) = inside.histories([replace(run, history=rows.assign(loss=1.0))], "loss")
    assert 500 <= len(loss) < 1000 and seconds[-1] == 19_999
    assert np.all(np.diff(seconds) > 0)


def test_one_run_has_no_speed_up_and_photographs_no_parameter_error(tmp_path):
    pictured.write(tmp_path / "a", [1.0, 0.4, 0.2], truth=False, pictures=False)
    alone = build([tmp_path])
    assert list(every_chart(alone)) == ["errors", "price", "time", "training"]
    assert content.measures(alone, "pottery") == ["image_rmse"]
    methods = by_scene(alone.methods)["pottery"]
    assert sheet.write_sheets(methods, styles.styles(alone), tmp_path) == []
    assert slides.groups(methods)[0] == []
    assert animation.write_animation(methods, styles.styles(alone), tmp_path) is None
    assert facts.effects(methods) == []


def test_the_typical_run_has_the_median_final_error_and_failures_come_last(tmp_path):
    ends = {1: 0.3, 2: math.inf, 3: 0.1, 4: 0.2}
    for seed, end in ends.items():
        pictured.write(tmp_path / str(seed), [1.0, 0.5, end], seed=seed, pictures=False)
    (method,) = build([tmp_path]).methods
    assert typical.final_error(typical.typical_run(method)) == ("parameter_rmse", 0.4)
    assert "ours seed 4" in typical.words([method]) and "median" in typical.words([method])


@pytest.mark.parametrize("scene", ["pottery", "dodoco"])
def test_the_sheet_has_one_colour_scale_for_all_methods(comparison, scene, tmp_path, monkeypatch):
    kept: dict[str, Figure] = {}
    monkeypatch.setattr(sheet, "save", lambda made, path: kept.update({path.name: made}))
    methods = by_scene(comparison.methods)[scene]
    made = sheet.write_sheets(methods, styles.styles(comparison), tmp_path)
    names = [f"{scene}_sheet.png", f"{scene}_textures.png"]
    assert [picture.path.name for picture in made] == names
    seed = 2 if scene == "pottery" else 1
    assert f"ours seed {seed}" in made[0].caption and "magenta" in made[0].caption
    cells = [axes.images[0].get_array() for axes in kept[names[0]].axes if axes.images]
    # target, start and results; errors of the start and of the results; densities
    count = len(methods)
    pictures, errors = cells[: 2 + count], cells[2 + count : 3 + 2 * count]
    densities = cells[3 + 2 * count :]
    for cell, level in zip(pictures, (0.5, 0.1)):
        expected = images.to_display(np.full((1, 1, 3), level), 1 / 0.5)
        assert np.array_equal(cell[0, 0], expected[0, 0])
    found = [typical.typical_run(m).history["image_rmse"].iloc[-1] for m in methods]
    # Constant maps: the 99th percentile of those of the methods is the largest of them.
    shares = np.minimum(np.array([0.4, *found]) / max(found), 1)
    colours = matplotlib.colormaps["magma"](shares, bytes=True)[:, :3]
    for cell, colour in zip(errors, colours):
        assert np.abs(cell[3, 3].astype(int) - colour).max() <= 1
    assert len({tuple(cell[3, 3]) for cell in errors[1:]}) == count
    assert len(densities) == count and all(np.array_equal(densities[0], d) for d in densities)
    bars = [axes.get_xlabel() for axes in kept[names[0]].axes if axes.get_xlabel()]
    assert bars == ["mean absolute difference of channels", "probability relative to uniform"]


def test_a_picture_that_was_not_saved_leaves_a_gap(comparison, folder, tmp_path):
    methods = by_scene(comparison.methods)["dodoco"]
    assert "dodoco_sheet.png" in [
        p.path.name for p in sheet.write_sheets(methods, styles.styles(comparison), tmp_path)
    ]
    groups, reason = slides.groups(methods)
    titles = [group.title for group in groups]
    assert titles[:2] == ["View 0, start against result", "View 0, target against result"]
    assert "start against result" in titles[2], "without a truth the start stands in"
    assert "exposure" in reason
    assert all(len(group.slides) == 2 for group in groups)


def test_of_very_many_methods_the_first_are_pictured(comparison, tmp_path, monkeypatch):
    monkeypatch.setattr(typical, "_PICTURED", 2)
    methods = by_scene(comparison.methods)["pottery"]
    told = " The first 2 of 3 methods."
    groups, exposure = slides.groups(methods)
    assert exposure.endswith(f".{told}")
    assert [[slide.method for slide in group.slides] for group in groups] == (
        [["uniform", "gradient"]] * len(groups)
    )
    own = styles.styles(comparison)
    pictures = sheet.write_sheets(methods, own, tmp_path)
    pictures.append(animation.write_animation(methods, own, tmp_path))
    for picture in pictures:
        assert told in picture.caption and "ours seed" not in picture.caption
    monkeypatch.undo()
    assert "first" not in slides.groups(methods)[1]


def frames_of(path: Path) -> list[tuple[np.ndarray, int]]:
    """The pictures of an animation and how long each stands, in milliseconds."""
    shown = Image.open(path)
    made = []
    for index in range(shown.n_frames):
        shown.seek(index)
        made.append((np.asarray(shown.convert("RGB")).copy(), shown.info["duration"]))
    return made


def test_the_animation_shows_each_methods_latest_snapshot_at_equal_time(tmp_path):
    # Rows at 0, 1, 2, 4 and 8 s; the second method evaluates at half the pace.
    quick = {0: 0.1, 1: 0.2, 4: 0.5}
    slow = {0: 0.1, 2: 0.35}
    error = [1.0, 0.8, 0.6, 0.4, 0.2]
    pictured.write(tmp_path / "q", error, snapshots=quick, sampler="ours")
    twice = [0, 2, 4, 8, 16]
    pictured.write(tmp_path / "s", error, seconds=twice, snapshots=slow, sampler="uniform")
    comparison = build([tmp_path])
    made = animation.write_animation(comparison.methods, styles.styles(comparison), tmp_path)
    assert made.path.name == "pottery_optimisation.webp"
    assert made.path.stat().st_size < 3e6
    shown = frames_of(made.path)
    # 0 s, then a snapshot of ours at 1 s, of uniform at 4 s, of ours at 8 s
    assert len(shown) == 4
    assert [wait for _, wait in shown[:-1]] == [150, 150, 150] and shown[-1][1] > 1000
    expected = [(0.1, 0.1), (0.1, 0.2), (0.35, 0.2), (0.35, 0.5)]
    side = shown[0][0].shape[1] // 3
    for (picture, _), levels in zip(shown, expected):
        for place, level in enumerate((0.5, *levels)):
            pixel = picture[60, place * side + side // 2].astype(int)
            wanted = images.to_display(np.full((1, 1, 3), level), 2.0)[0, 0].astype(int)
            assert np.abs(pixel - wanted).max() <= 6, (place, level)


def test_a_long_animation_is_thinned_and_stays_small(tmp_path, rng):
    error = [1.0] + [0.9**row for row in range(1, 90)]
    seconds = [float(row) for row in range(90)]
    pictured.write(tmp_path / "a", error, seconds=seconds, snapshots={0: 0.1})
    for row in range(1, 90):
        noise = rng.random((300, 300, 3))
        stamp = {"iteration": 10 * row, "seconds": float(row)}
        name = f"a/frames/progress_v00_i{10 * row:06d}.exr"
        images.write_exr(tmp_path / name, noise, ["R", "G", "B"], stamp)
    comparison = build([tmp_path])
    made = animation.write_animation(comparison.methods, styles.styles(comparison), tmp_path)
    assert len(frames_of(made.path)) == 60
    assert made.path.stat().st_size < 3e6


def test_snapshots_without_a_time_and_damaged_ones_are_left_out(tmp_path):
    pictured.write(tmp_path / "a", [1.0, 0.5, 0.2], snapshots={0: 0.1, 2: 0.4})
    pictured.grey(tmp_path / "a/frames/progress_v00_i000015.exr", 0.3)
    (tmp_path / "a/frames/progress_v00_i000017.exr").write_bytes(b"damaged")
    comparison = build([tmp_path])
    made = animation.write_animation(comparison.methods, styles.styles(comparison), tmp_path)
    assert len(frames_of(made.path)) == 2


def test_slides_are_small_and_keep_their_pixels():
    for size, side in ((12, 192), (300, 300), (1600, 512)):
        image = np.random.default_rng(7).integers(0, 255, (size, size, 3)).astype(np.uint8)
        kind, _, text = slides.data_address(image).partition(",")
        assert kind == "data:image/webp;base64"
        shown = Image.open(io.BytesIO(base64.b64decode(text)))
        assert shown.size == (side, side)
        if size == 12:
            assert np.array_equal(np.asarray(shown.convert("RGB"))[8::16, 8::16], image)


def test_wide_sheets_still_go_into_the_page(tmp_path):
    """A WebP has at most 16,383 pixels a side."""
    Image.new("RGB", (17000, 20), "white").save(tmp_path / "wide.png")
    assert slides.file_address(tmp_path / "wide.png").startswith("data:image/webp")
