"""The pages of results: they say what the tables say, and are those that are committed."""

import re

import _page_adaptive
import _page_effects
import _page_filters
import numpy as np
import pages
import pandas
import pytest
import settings

from isas_cli.config.compose import compose
from isas_cli.config.schema import OptimizerConfig

RENDERED = pages.rendered()
NUMBERS = re.compile(r"\b(nan|inf|np\.)")


@pytest.mark.parametrize("path", RENDERED, ids=lambda path: path.name)
def test_committed_pages_are_those_of_the_committed_tables(path):
    found = path.read_text(encoding="utf-8")
    assert found == RENDERED[path], f"{path}: run python benchmarks/pages.py"


@pytest.mark.parametrize("path", RENDERED, ids=lambda path: path.name)
def test_pages_hold_no_number_that_is_none(path):
    assert not NUMBERS.search(RENDERED[path])
    widths = set()
    for line in RENDERED[path].splitlines():
        if line.startswith("|"):
            widths.add(line.replace("\\|", "").count("|"))
            assert len(widths) == 1, line
        else:
            widths.clear()


def test_defaults_that_are_named_are_those_of_the_configuration():
    cfg = compose(["scene=pottery"])
    rates = OptimizerConfig()
    own = cfg.estimator.batch, rates.factor, *rates.falling(), rates.half, rates.beta_2
    assert own == _page_effects.DEFAULT
    usual = cfg.optimizer.filter.name, cfg.optimizer.filter.rate, rates.half
    assert usual == _page_filters.DEFAULT


def test_tables_with_a_day_are_not_said_to_be_of_an_earlier_engine():
    facts = pages.PAGES["cost"](pages.RESULTS)
    facts["day"] = dict.fromkeys(facts["day"], "2030-01-31")
    text = pages._environment().get_template("cost.md.j2").render(facts)
    assert "earlier engine" not in text and "filter=none" not in text


ROOT = pages.README.parent
FOLDERS = ("benchmarks", "configs", "isas_cli", "scenes")
PAGES = [pages.README, *sorted(page for name in FOLDERS for page in (ROOT / name).glob("*.md"))]


@pytest.mark.parametrize("path", PAGES, ids=lambda path: str(path.relative_to(ROOT)))
def test_links_and_pictures_are_there(path):
    targets = re.findall(r"\]\(([^)#]+)[^)]*\)", path.read_text(encoding="utf-8"))
    for target in targets:
        assert target.startswith("https://") or (path.parent / target).exists(), target


def test_the_readme_fits_on_two_screens():
    lines = pages.README.read_text(encoding="utf-8").splitlines()
    assert len(lines) <= 150
    assert max(map(len, lines)) <= 400


def raced(**samplers) -> pandas.DataFrame:
    """(median, low, high) of the parameter error, and the time to `uniform`'s."""
    columns = ["parameter_rmse", "parameter_rmse_low", "parameter_rmse_high", "time_to_uniform"]
    rows = pandas.DataFrame.from_dict(samplers, orient="index", columns=columns)
    return rows.assign(share_of_start=rows["parameter_rmse"] / 10, seconds=5.0)


def test_scenes_are_on_a_side_only_where_the_ranges_lie_apart():
    by = {
        "apart": raced(ours=(1, 0.9, 1.1, 0.5), uniform=(2, 1.9, 2.1, 1.0)),
        "level": raced(ours=(1, 0.9, 1.95, 0.5), uniform=(2, 1.9, 2.1, 1.0)),
        "worse": raced(ours=(3, 2.9, 3.1, np.inf), uniform=(2, 1.9, 2.1, 1.0)),
    }
    found = _page_adaptive.sides(by, "ours", "uniform", "parameter_rmse")
    assert found == {"below": ["apart"], "above": ["worse"]}
    assert [_page_adaptive.leads(by[s], "ours") for s in by] == [True, True, False]


def test_the_short_table_says_what_is_level_and_where_an_error_is_not_reached():
    ends = {"uniform": (2, 1.9, 2.1, 1.0), "ours": (3, 3, 3, np.inf)}
    by = {
        "soon": raced(progress=(1, 1, 1, 0.25), **ends),
        "never": raced(progress=(2.5, 2.2, 3, np.inf), **ends),
        "rises_relative": raced(progress=(1, 1, 1, 0.1), **ends),
        "level": raced(progress=(2.2, 2, 2.4, np.inf), **ends),
    }
    lines = _page_adaptive.short(by, turned=["rises_relative"])
    assert lines[2:] == [
        "| soon, 5 s | 20.0 % | 30.0 % | **10.0 %** | 0.25 |",
        "| never, 5 s | **20.0 %** | 30.0 % | 25.0 % | not reached |",
        "| rises, relative L2, 5 s | 20.0 % | 30.0 % | **10.0 %** | – |",
        "| level, 5 s | **20.0 %** | 30.0 % | **22.0 %** | not reached |",
    ]


def test_settings_and_draws_are_told_once_they_are_measured(tmp_path):
    names = "settings", "draws"
    facts = pages.PAGES["adaptive_sampling"](pages.RESULTS)
    render = pages._environment().get_template("adaptive_sampling.md.j2").render
    none = {name: getattr(_page_adaptive, name)(tmp_path / f"{name}.csv") for name in names}
    assert "settings.py" not in render(facts | none)
    # Median, least and most of the parameters' error; a time that is reached, and one that is not.
    raced = {"uniform": (2, 1.9, 2.1, np.nan), "ours": (1, 0.9, 1.1, 0.5)}
    raced |= {"ours, sampler.refresh=20": (1.2, 1, 1.3, np.inf)}
    rows = []
    for name, numbers in raced.items():
        columns = "parameter_rmse", "parameter_rmse_low", "parameter_rmse_high", "time"
        row = {"scene": "pottery", "method": name, "factor": 1.0, "beside": settings.beside(name)}
        row |= dict.fromkeys(("image_rmse", "image_rmse_low", "image_rmse_high"), 0.0)
        row |= {"seconds": 15.0, "seeds": 3, "iterations": 200, "paths": 1e5, "stage1_share": 0.1}
        rows.append(row | dict(zip(columns, numbers)))
    table = pandas.DataFrame(rows)
    table.to_csv(tmp_path / "settings.csv", index=False)
    tried = pandas.concat([table, table.assign(factor=2.0)])
    tried.to_csv(tmp_path / "settings_rates.csv", index=False)
    own = {"scene": "multires", "object": "bin", "pixels": 0.1, "ours": 0.5, "multiresolution": 0.4}
    pandas.DataFrame([own]).to_csv(tmp_path / "draws.csv", index=False)
    found = {name: getattr(_page_adaptive, name)(tmp_path / f"{name}.csv") for name in names}
    lines = render(facts | found).splitlines()
    assert "| multires | bin | 10.0 % | 50.0 % | 40.0 % |" in lines
    told = [line for line in lines if " | 100,000 | 10.0 % |" in line]
    ends = [line.split(" | 10.0 % | ")[1] for line in told]
    assert ends[0] == "– | – | – | – |"
    assert ends[1] == "`uniform` | less | level | 0.50 |"
    assert ends[2] == "`ours` | level | level | – |"
    assert told[1].startswith(r"| pottery | `ours` | 1\* | 1.0000 [0.9000, 1.1000] | below noise [")
    assert len({line.count("|") for line in told}) == 1


@pytest.mark.parametrize(
    ("names", "words"),
    [([], "none"), (["a"], "`a`"), (["a", "b"], "`a` and `b`"), ("abc", "`a`, `b` and `c`")],
)
def test_lists_in_words(names, words):
    assert pages.listed(names, "`" if names else "") == words


def test_spans_in_words():
    assert pages.span([0.5, 0.1, 0.3]) == "0.10 to 0.50"
    assert pages.span([0.101, 0.099], ".1f") == "0.1"
