"""The page of a comparison in a real browser without a network, and the words on it."""

from __future__ import annotations

import hashlib
import math
import re
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas
import pictured_runs as pictured
import pytest
from browser import browser, console_errors, requested, resize, screenshot
from PIL import Image
from selenium.webdriver import ActionChains, Chrome, Keys
from selenium.webdriver.common.by import By
from selenium.webdriver.remote.webelement import WebElement
from selenium.webdriver.support.ui import WebDriverWait

from isas_cli.report.compare import build, facts, page

ROOT = Path(__file__).resolve().parents[2]
VENDOR = ROOT / "isas_cli/report/compare/vendor"
NASTY = "<script>document.title = 'taken over'</script> & more"


@pytest.fixture(scope="module")
def report(tmp_path_factory) -> Path:
    """A page of two scenes, one of them with a truth and several runs of each method; without the
    files of plots/, which it does not show and which have tests of their own."""
    folder = tmp_path_factory.mktemp("comparison")
    comparison = build([pictured.two_scenes(folder / "runs")])
    comparison = replace(comparison, warnings=[*comparison.warnings, NASTY])
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(page.plots, "write_plots", lambda *_: [])
        return page.write(comparison, folder / "out")


@pytest.fixture(scope="module")
def started():
    with browser() as opened:
        yield opened


@pytest.fixture
def opened(started: Chrome, report: Path) -> Chrome:
    """The page, freshly loaded; afterwards its console must be clean."""
    resize(started, 1280, 900)
    started.get(report.as_uri())
    console_errors(started)
    yield started
    assert console_errors(started) == []


def until(opened: Chrome, done) -> None:
    WebDriverWait(opened, 10, poll_frequency=0.05).until(done)


def traces(opened: Chrome, plot: str) -> dict[str, set]:
    """How the traces of each legend group are shown."""
    program = (
        "return document.getElementById(arguments[0]).data.map(t => [t.legendgroup, t.visible])"
    )
    shown: dict[str, set] = {}
    for group, visible in opened.execute_script(program, plot):
        shown.setdefault(group, set()).add(visible)
    return shown


def legend_entry(opened: Chrome, plot: str, label: str) -> WebElement:
    for entry in opened.find_elements(By.CSS_SELECTOR, f"#{plot} .legend .traces"):
        if entry.text == label:
            return entry.find_element(By.CSS_SELECTOR, ".legendtoggle")
    raise AssertionError(f"{label} is not in the legend of {plot}")


def show(opened: Chrome, element: WebElement) -> WebElement:
    opened.execute_script("arguments[0].scrollIntoView({block: 'center'})", element)
    return element


def first_column(table: WebElement) -> list[str]:
    cells = table.find_elements(By.CSS_SELECTOR, "tbody td:first-child")
    return [cell.get_attribute("data-sort") for cell in cells]


def test_it_opens_from_a_file_without_errors_and_asks_the_network_for_nothing(started, report):
    requested(started), console_errors(started)
    started.get(report.as_uri())
    until(started, lambda d: d.execute_script("return document.readyState") == "complete")
    plots = started.find_elements(By.CSS_SELECTOR, ".plotly-graph-div .main-svg")
    assert len(plots) >= 9
    loaded = "return [...document.images].map(i => i.complete && i.naturalWidth > 0)"
    until(started, lambda d: all(d.execute_script(loaded)))
    assert len(started.execute_script(loaded)) > 12
    assert console_errors(started) == []
    assert set(requested(started)) == {report.as_uri()}
    assert started.title == "dodoco, pottery: what accuracy costs in time"
    assert NASTY in started.find_element(By.ID, "warnings").text
    buttons = started.find_elements(By.CSS_SELECTOR, ".modebar-btn")
    titles = {button.get_attribute("data-title").lower() for button in buttons}
    assert "zoom" in titles and not any("share" in title for title in titles), "sends it away"


def test_the_test_would_notice_an_error_and_a_request(started, tmp_path):
    broken = tmp_path / "broken.html"
    broken.write_text("<script>nowhere()</script><img src='http://example.invalid/a.png'>")
    requested(started), console_errors(started)
    started.get(broken.as_uri())
    until(started, lambda d: d.execute_script("return document.readyState") == "complete")
    assert any("nowhere" in message for message in console_errors(started))
    assert "http://example.invalid/a.png" in requested(started)


def test_a_table_sorts_by_the_heading_that_is_clicked(opened):
    table = opened.find_element(By.CSS_SELECTOR, "#scene1 table.accuracy")
    assert first_column(table) == ["uniform", "gradient", "ours"]
    half = show(opened, table.find_element(By.XPATH, ".//th[text()='1/2']"))
    half.click()
    until(opened, lambda d: first_column(table)[0] == "ours")
    times = [
        float(cell.get_attribute("data-sort").replace("Infinity", "inf"))
        for cell in table.find_elements(By.CSS_SELECTOR, "tbody td:nth-child(2)")
    ]
    assert times == sorted(times) and math.isinf(times[-1]), "what was not reached comes last"
    assert half.get_attribute("aria-sort") == "ascending"
    half.click()
    until(opened, lambda d: first_column(table) == ["gradient", "uniform", "ours"])
    show(opened, table.find_element(By.XPATH, ".//th[text()='method']")).send_keys(Keys.ENTER)
    until(opened, lambda d: first_column(table) == ["gradient", "ours", "uniform"])


def test_the_best_of_a_column_is_told_by_more_than_its_colour(opened):
    best = opened.find_elements(By.CSS_SELECTOR, "table.accuracy td.best")
    starred = opened.find_elements(By.CSS_SELECTOR, "span[title='the soonest median']")
    assert len(best) == len(starred) > 0
    assert all("★" in cell.text for cell in best)


def test_a_slider_follows_the_mouse_and_the_keys(opened):
    slider = show(opened, opened.find_element(By.CSS_SELECTOR, "img-comparison-slider"))
    exposed = lambda: opened.execute_script("return arguments[0].value", slider)
    assert exposed() == 50
    width = slider.size["width"]
    drag = ActionChains(opened, duration=50).move_to_element(slider).click_and_hold()
    drag.move_by_offset(int(0.3 * width), 0).release().perform()
    assert exposed() == pytest.approx(80, abs=2)
    inner = slider.shadow_root.find_element(By.ID, "first").get_attribute("style")
    hidden = float(re.search(r"--exposure: ([\d.]+)%", inner).group(1))
    assert hidden == pytest.approx(20, abs=2)
    before = exposed()
    ActionChains(opened).key_down(Keys.ARROW_LEFT).pause(0.3).key_up(Keys.ARROW_LEFT).perform()
    assert exposed() < before - 2


def test_a_method_is_hidden_in_all_panels_by_a_click_on_its_legend_entry(opened):
    plot = "scene1plot0"
    assert set(traces(opened, plot)) == {"uniform", "ours", "gradient", "slope −1/2"}
    entry = legend_entry(opened, plot, "ours")
    show(opened, opened.find_element(By.CSS_SELECTOR, f"#{plot} .legend"))
    ActionChains(opened).move_to_element(entry).click().perform()
    until(opened, lambda d: traces(d, plot)["ours"] == {"legendonly"})
    assert traces(opened, plot)["uniform"] == {None}
    ActionChains(opened).move_to_element(legend_entry(opened, plot, "ours")).click().perform()
    until(opened, lambda d: traces(d, plot)["ours"] == {True})


def test_a_plot_zooms_and_its_axis_turns_from_seconds_to_paths(opened):
    plot = opened.find_element(By.ID, "scene1plot0")
    show(opened, plot.find_element(By.CSS_SELECTOR, ".nsewdrag"))
    span = lambda: opened.execute_script("return arguments[0].layout.xaxis.range", plot)
    title = lambda: opened.execute_script("return arguments[0].layout.xaxis2.title.text", plot)
    start = span()
    area = plot.find_element(By.CSS_SELECTOR, ".nsewdrag")
    drag = ActionChains(opened, duration=50).move_to_element(area).click_and_hold()
    drag.move_by_offset(120, 60).release().perform()
    until(opened, lambda d: span()[1] - span()[0] < 0.5 * (start[1] - start[0]))
    assert title() == "billed seconds"
    buttons = plot.find_elements(By.CSS_SELECTOR, ".updatemenu-button")
    show(opened, next(button for button in buttons if button.text == "light paths")).click()
    until(opened, lambda d: title() == "light paths")
    # A thousand paths a second: the axis shows the same span, three powers of ten higher.
    assert span() == pytest.approx([edge + 3 for edge in start], abs=0.05)


@pytest.mark.parametrize("width", [1280, 420])
def test_nothing_sticks_out_at_the_side_and_the_page_is_not_blank(opened, report, tmp_path, width):
    resize(opened, width, 900)
    opened.get(report.as_uri())
    inner = "return [document.documentElement.scrollWidth, document.documentElement.scrollHeight]"
    wide, high = opened.execute_script(inner)
    assert wide <= width
    resize(opened, width, min(high, 12000))
    shot = np.asarray(Image.open(screenshot(opened, tmp_path / "page.png")).convert("RGB"))
    for part in np.array_split(shot, 6):
        assert (part != 255).any(axis=2).mean() > 0.005, "an empty stretch"


def test_one_run_of_photographs_makes_a_page_too(started, tmp_path):
    run = tmp_path / "only"
    pictured.write(
        run, [1.0, math.nan, 0.4], truth=False, pictures=False, manifest={"effects": None}
    )
    path = page.write(build([run]), tmp_path / "out")
    assert len(list((tmp_path / "out/plots").glob("*.svg"))) == 4
    console_errors(started)
    started.get(path.as_uri())
    text = started.find_element(By.TAG_NAME, "body").text
    assert "1 run of 1 method on pottery" in text
    assert "image error" in text and "parameter error" not in text
    assert "no animation" in text
    for title in ("Speed-up over the baseline", "Pictures", "What was simulated"):
        assert title not in text
    assert console_errors(started) == []


def test_plots_of_an_earlier_comparison_go_and_nothing_else(tmp_path):
    kept = tmp_path / "out/plots"
    kept.mkdir(parents=True)
    earlier = {"all_arrivals.svg", "all_profiles.png", "old_sheet.png", "old_optimisation.webp"}
    others = {"all_arrivals.txt", "my_errors.png", "notes.png"}
    (kept / ".made").write_text("\n".join(Path(name).stem for name in earlier))
    for name in earlier | others:
        (kept / name).write_text("")
    for sampler in ("ours", "uniform"):
        pictured.write(tmp_path / sampler, [1.0, 0.5, 0.4], snapshots={2: 0.4}, sampler=sampler)
    page.write(build([tmp_path / "ours", tmp_path / "uniform"]), tmp_path / "out")
    found = {path.name for path in kept.iterdir()}
    assert others <= found and not found & earlier
    charts = {f"pottery_{name}.svg" for name in ("errors", "speedup", "price", "time", "training")}
    assert charts | {"pottery_sheet.png", "pottery_optimisation.webp"} <= found
    made = {Path(name).stem for name in found - others - {".made"}}
    assert made == set((kept / ".made").read_text().split())


def test_effects_integrator_and_path_depth_are_shown_where_they_are_recorded(tmp_path):
    plan = {"caustics": "left out", "evidence": {"energy": 0.01}}
    told = {"manifest": {"effects": plan, "integrator": "prb"}, "settings": {"scene.max_depth": 8}}
    for sampler in ("ours", "uniform"):
        pictured.write(tmp_path / sampler, [1.0, 0.4], pictures=False, sampler=sampler, **told)
    ((labels, facts_told),) = facts.effects(build([tmp_path]).methods)
    assert labels == ["uniform", "ours"]
    assert facts_told["integrator"] == "prb" and facts_told["longest path"] == "8 segments"
    assert "left out" in facts_told["plan of effects"]


def test_numbers_and_intervals_in_words():
    values = [math.nan, math.inf, 0.0, 12.0, 0.12345, 999.4, 999.6, 1234.5, 26214400, -0.214, 1e-9]
    assert [facts.number(value) for value in values] == [
        *("not known", "infinite", "0", "12", "0.123", "999", "1,000", "1,234", "26,214,400"),
        *("−0.214", "1e−09"),
    ]
    row = pandas.Series({"seconds_low": 1.5, "seconds_high": math.inf, "runs": 3})
    assert facts.interval(row, "seconds", " s") == "[1.5, not reached]"
    row = pandas.Series({"seconds_low": 1.5, "seconds_high": 2.0})
    assert facts.interval(row, "seconds", " s") == "[1.5, 2] s"
    row = pandas.Series({"ratio_low": math.nan, "ratio_high": math.nan})
    assert facts.interval(row, "ratio") == ""
    words = [facts.times(value) for value in (1.3, 0.0, math.inf, math.nan)]
    assert words == ["1.3×", "not reached", "baseline: not reached", "not known"]


def test_the_headline_table_holds_seconds_interval_and_ratio(tmp_path):
    comparison = build([pictured.two_scenes(tmp_path)])
    methods = [m for m in comparison.methods if m.scene == "pottery"]
    parameters, image = facts.accuracy(comparison, "pottery", methods)
    assert parameters.title == "parameter error, 2 at the start"
    rows = dict(parameters.rows)
    quarter = [heading.text for heading in parameters.headings].index("1/4")
    ours = rows["ours"][quarter]
    expected = comparison.accuracy.query(
        "scene == 'pottery' and measure == 'parameter_rmse' and level == 0.25 and method == 'ours'"
    ).iloc[0]
    assert float(ours.sort) == expected["seconds"] and ours.best
    assert ours.text == f"{expected['seconds']:.3g} s"
    assert ours.below[0].startswith(f"[{expected['seconds_low']:.3g}, ")
    assert f"{expected['ratio']:.3g}×" in ours.below[-1]
    assert rows["gradient"][quarter] == facts.Cell("Infinity", "not reached", ("0 of 3 runs",))
    (alone,) = facts.accuracy(
        comparison, "dodoco", [m for m in comparison.methods if m.scene == "dodoco"]
    )
    assert dict(alone.rows)["uniform"][0].below == ("one run",)
    (line, _) = facts.headlines(comparison, "pottery", methods)
    assert line.startswith("Soonest to 1/") and "ours in" in line and "uniform" in line


def test_what_is_vendored_is_as_published_and_can_stand_in_a_page():
    listed = dict(
        re.findall(r"`([\w.-]+)` \(([0-9a-f]{64})\)", (ROOT / "ATTRIBUTION.md").read_text())
    )
    code = [path for path in VENDOR.rglob("*") if path.suffix in (".js", ".css")]
    assert {path.name for path in code} == set(listed)
    for path in code:
        assert hashlib.sha256(path.read_bytes()).hexdigest() == listed[path.name], path.name
        assert "</script" not in path.read_text().lower(), path.name
        assert "</style" not in path.read_text().lower(), path.name
        assert (path.parent / "LICENSE").is_file()
        assert path.parent.name.rsplit("-", 1)[1] in (ROOT / "ATTRIBUTION.md").read_text()


def test_without_a_browser_tests_skip_or_where_one_is_required_fail(monkeypatch):
    monkeypatch.setattr(shutil, "which", lambda name: None)
    monkeypatch.delenv("ISAS_REQUIRE_BROWSER", raising=False)
    with pytest.raises(pytest.skip.Exception, match="chromium-driver"), browser():
        pass
    monkeypatch.setenv("ISAS_REQUIRE_BROWSER", "1")
    with pytest.raises(pytest.fail.Exception, match="chromium-driver"), browser():
        pass
