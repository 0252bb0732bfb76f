"""What pages tell to type: each line is composed, so that no page keeps a setting that has gone."""

import re
import shlex
from collections.abc import Iterator
from itertools import product
from pathlib import Path

import pytest
from omegaconf import DictConfig, OmegaConf

from isas_cli.cli.sweeps import race, races, sweep
from isas_cli.config import presets, searchpath
from isas_cli.config.compose import compose, translate

ROOT = Path(__file__).parents[2]
FOLDERS = (".", "configs", "scenes", "isas_cli", "benchmarks", "examples/*")
PAGES = [page for folder in FOLDERS for page in sorted(ROOT.glob(f"{folder}/README.md"))]
FENCED = re.compile(r"```(\w*)\n(.*?)```", re.DOTALL)
# The example's sampler and loss.
GUEST = ROOT / "examples/plugin/isas_example/configs"
# Words that stand for others. Of several seeds the first is enough; files are not opened.
MEANT = {
    r"scene=NAME": "scene=pottery",
    r"hydra/launcher=NAME": "hydra/launcher=joblib",
    r"seed=\[?(\d+).*": r"seed=\1",
}
# Left out: flags, some with a value, and what anybody may add.
FLAGS, ELSE = ("--cfg", "--config-dir"), "…"


def lines(page: Path) -> Iterator[list[str]]:
    """The words of each `isas run` and `isas race` of a page, but for those that go on with what is
    there: these compose nothing."""
    text = page.read_text(encoding="utf-8")
    blocks = [block for language, block in FENCED.findall(text) if not language]
    for block in blocks + re.findall(r"`(isas r(?:un|ace) [^`]+)`", FENCED.sub("", text)):
        left = iter(block.replace("\\\n", " ").splitlines())
        for line in left:
            while (words := split(line)) is None:
                line += f"\n{next(left)}"
            resumes = any(word.startswith("resume=") for word in words)
            if words[:2] in (["isas", "run"], ["isas", "race"]) and not resumes:
                yield words[1:]


def split(line: str) -> list[str] | None:
    """As a shell does; None where a quotation goes on in the next line."""
    try:
        return shlex.split(line, comments=True)
    except ValueError:
        return None


def completed(words: list[str]) -> list[str]:
    """The settings of a line, with those that it leaves to the reader."""
    left, found = iter(words), []
    for word in left:
        if word in FLAGS:
            next(left)
        elif not word.startswith("-") and word != ELSE:
            for pattern, meant in MEANT.items():
                word = re.sub(f"^{pattern}$", meant, word)
            found.append(word)
    chosen = any(word.startswith("scene=") for word in found)
    return found if chosen else ["scene=pottery", *found]


LINES = {" ".join(words): words for page in PAGES for words in lines(page)}


def test_lines_are_found():
    assert len(LINES) > 30 and {words[0] for words in LINES.values()} == {"run", "race"}


@pytest.mark.parametrize("line", LINES)
def test_a_line_of_a_page_composes(line, monkeypatch):
    monkeypatch.setenv(searchpath.VARIABLE, str(GUEST))
    command, *words = LINES[line]
    typed = completed(words)
    if command == "race":
        own, overrides = race.options_of(typed)
        launcher = [word for word in typed if word.startswith("hydra/launcher")]
        if launcher:
            compose(["scene=pottery", *launcher], hydra=True)
        for _, each in races.expanded(own, overrides) or [("", typed)]:
            mine, shared = race.options_of([word for word in each if word not in launcher])
            race.planned({**own, **mine}, shared)
    elif "-m" in words:
        for own in product(*map(sweep.choices, sweep.parsed(translate(typed)))):
            compose(list(own), hydra=True)
    else:
        compose(translate(typed), hydra=True)


GROUPS = ("sampler", "estimator", "prior", "effects")
NAMED = "|".join((*GROUPS, *("optimizer budget target evaluation frames photos external".split())))
FILES = (".py", ".csv", ".txt")


def within(node: DictConfig, prefix: str) -> set[str]:
    """The names of all settings in ``node``, whole."""
    found = set()
    for key in node:
        found.add(f"{prefix}.{key}".lstrip("."))
        if isinstance(inner := node._get_node(key), DictConfig) and not inner._is_none():
            found |= within(inner, f"{prefix}.{key}".lstrip("."))
    return found


@pytest.fixture(scope="module")
def settings() -> set[str]:
    """Of all choices, as they are typed."""
    cfg = compose(["scene=pottery", "sampler=multiresolution"])  # which has another in it
    found = within(cfg, "") | within(cfg.scene, "") | {*presets._OF_ESTIMATORS}
    for group in (*GROUPS, "filter"):
        prefix = "optimizer.filter" if group == "filter" else group
        for file in searchpath.files(group).values():
            found |= within(OmegaConf.load(str(file)), prefix)
    return found


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_settings_that_a_page_names_are_there(page, settings):
    text = page.read_text(encoding="utf-8")
    named = {name.rstrip(".") for name in re.findall(rf"`((?:{NAMED})\.[\w.]+)", text)}
    assert {name for name in named if not name.endswith(FILES)} <= settings
