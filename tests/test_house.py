"""The rooms of isas_cli and who may know whom: imports run one way."""

import ast
import graphlib
import re
import subprocess
import sys
from pathlib import Path

import pytest

import isas_cli

ROOT = Path(isas_cli.__file__).parent
# From the ground up; rooms on one floor may know each other.
FLOORS = (
    ("runtime",),
    ("config",),
    ("records",),
    ("unknowns", "scene"),
    ("rendering",),
    ("losses", "samplers", "filters"),
    ("estimators",),
    ("effects",),
    ("report",),
    ("engine",),
    ("measure",),
    ("cli",),
)
LEVEL = {room: floor for floor, rooms in enumerate(FLOORS) for room in rooms}
INIT = "__init__.py"


def imported(path: Path) -> set[str]:
    """The rooms that a module's imports reach, those for annotations alone left out."""
    tree = ast.parse(path.read_text())
    for node in ast.walk(tree):
        if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING":
            node.body = []
    depth = len(path.relative_to(ROOT).parts)
    rooms = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.level == depth:
            names = [node.module] if node.module else [alias.name for alias in node.names]
            rooms |= {name.partition(".")[0] for name in names}
    return rooms & set(LEVEL)


def reached(path: Path) -> set[str]:
    """The modules that a module imports, also in functions and for annotations alone."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom) and node.level:
            place = path.parents[node.level - 1].joinpath(*(node.module or "").split("."))
            for inner in (place / alias.name for alias in node.names):
                files = [f for at in (inner, place) for f in (at.with_suffix(".py"), at / INIT)]
                found |= {str(f.relative_to(ROOT)) for f in [f for f in files if f.exists()][:1]}
    return found


def test_no_modules_know_each_other_in_a_circle():
    """But through the front door, by which whoever imports any of them comes in."""
    known = {str(path.relative_to(ROOT)): reached(path) - {INIT} for path in ROOT.rglob("*.py")}
    graphlib.TopologicalSorter({**known, INIT: ()}).prepare()  # or CycleError, which names them


def test_every_package_is_a_room():
    assert {p.parent.name for p in ROOT.glob("*/__init__.py")} - {"configs", "scenes"} == set(LEVEL)


@pytest.mark.parametrize("room", LEVEL)
def test_a_room_knows_nobody_above_it(room):
    for path in (ROOT / room).rglob("*.py"):
        above = {other for other in imported(path) if LEVEL[other] > LEVEL[room]}
        assert not above, f"{path.relative_to(ROOT)} imports from {', '.join(sorted(above))}"


@pytest.mark.parametrize("command", ["check", "format --check"])
def test_the_code_is_as_the_linter_wants_it(command):
    ruff = [sys.executable, "-m", "ruff", *command.split(), "--no-cache", "--quiet"]
    ruff += ["isas_cli", "scenes", "benchmarks", "tests", "examples", "docs"]
    done = subprocess.run(ruff, cwd=ROOT.parent, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr


def test_the_public_face_is_typed():
    """What parts of one's own derive from; which files: pyproject.toml."""
    command = [sys.executable, "-m", "mypy", "--no-error-summary"]
    done = subprocess.run(command, cwd=ROOT.parent, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr


def test_kernels_are_frozen_in_one_place():
    """What Dr.Jit cannot freeze is known there."""
    found = {
        str(path.relative_to(ROOT))
        for path in ROOT.rglob("*.py")
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.Attribute) and ast.unparse(node) == "dr.freeze"
    }
    assert found == {"rendering/kernels.py"}


def test_the_report_never_renders():
    for path in (ROOT / "report").rglob("*.py"):
        tree = ast.walk(ast.parse(path.read_text()))
        plain = [
            alias.name for node in tree if isinstance(node, ast.Import) for alias in node.names
        ]
        assert not {"mitsuba", "drjit"} & set(plain), path
        assert imported(path) <= {"runtime", "config", "records"}, path


FILE = ["scene=file", "scene.path=a.xml", 'scene.unknowns={"a.b": {"start": 0.3}}']
TYPED = "from isas_cli.cli.app import main; main({})".format
# What does without which modules: it answers at once, or runs where no renderer is.
UNIMPORTED = {
    "import isas_cli.runtime.backend, isas_cli.cli.doctor": "mitsuba drjit numpy",
    "import isas_cli.cli.watch": "mitsuba drjit OpenImageIO",
    "import isas_cli.scene.photos.photographs": "mitsuba drjit",
    "import isas_cli.report": "mitsuba drjit matplotlib.pyplot",
    "import isas_cli.report.compare": "mitsuba drjit",
    "import isas_cli.report.compare.page": "mitsuba drjit matplotlib.pyplot",
    TYPED([]): "mitsuba drjit numpy hydra rich matplotlib pandas",
    TYPED(["run", "--help"]): "mitsuba drjit",
    TYPED(["run", "scene=potery"]): "mitsuba drjit",
    TYPED(["run", *FILE, "sampler=uniform", "sampler.flor=1"]): "mitsuba drjit",
}


@pytest.mark.parametrize("code", UNIMPORTED)
def test_modules_stay_unimported(code, tmp_path):
    (tmp_path / "a.xml").write_text('<scene version="3.0.0"/>')
    code += f"\nimport sys; print({{*sys.modules}} & {{*{UNIMPORTED[code].split()}}})"
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True
    )
    assert done.stdout.splitlines()[-1:] == ["set()"], done.stdout + done.stderr


PAGES = sorted(
    path
    for folder in ("*.md", "docs/*.md", "configs/*.md", "scenes/*.md", "isas_cli/*.md")
    for path in ROOT.parent.glob(folder)
)
PAGES += sorted(ROOT.parent.glob("benchmarks/**/*.md")) + sorted(
    ROOT.parent.glob("examples/*/*.md")
)
LONGEST = 120  # words


@pytest.mark.parametrize("page", PAGES, ids=lambda path: str(path.relative_to(ROOT.parent)))
def test_no_paragraph_is_a_wall(page):
    text = re.sub(r"```.*?```", "", page.read_text(), flags=re.DOTALL)
    for paragraph in re.split(r"\n\s*\n|\n(?=[-*|] )|\n(?=\d+\. )", text):
        words = paragraph.split()
        assert paragraph.startswith("|") or len(words) <= LONGEST, " ".join(words[:12])
