"""The documentation site: the repository's own pages, and the API from its docstrings.

    make docs        # build/docs/index.html, which opens without a server

The sources lie where they are read on a code host, so the site's root is the repository's.
"""

import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))

project = "isas"
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.viewcode"]
root_doc = "README"
exclude_patterns = [
    *(".*", "build", "dist", "runs", "multirun", "outputs", "tests", "findings", "**/*.egg-info"),
    *("scenes/assets", "**/node_modules", "benchmarks/*.j2", "isas_cli/report"),
]
# What readers find first, in this order.
PAGES = {
    "Using it": ["scenes/README", "configs/README", "isas_cli/README", "examples/plugin/README"],
    "Measured": [
        "benchmarks/README",
        *(f"benchmarks/{name}" for name in ("adaptive_sampling", "plateau", "pbdr", "cost")),
        *(f"benchmarks/{name}" for name in ("effects", "filters", "shapes", "volumes")),
        *(f"benchmarks/{name}" for name in ("photographs", "derivatives", "exports")),
        *(f"benchmarks/results/{name}" for name in ("hard_cases", "chessboard")),
    ],
    "Reference": ["docs/api", "CHANGELOG", "CONTRIBUTING", "ATTRIBUTION"],
}

html_theme = "furo"
html_title = "isas"
html_copy_source = False
myst_heading_anchors = 4
autodoc_member_order = "bysource"
autodoc_typehints = "none"  # they stand in the signature's defaults and the docstrings
autodoc_class_signature = "separated"
suppress_warnings = ["myst.xref_missing"]  # links to scripts and tables, which are no pages


def _with_menu(app, name: str, source: list[str]) -> None:
    """The first page has the others in its menu, which would be of no use on a code host."""
    if name != root_doc:
        return
    for caption, pages in PAGES.items():
        listed = "\n".join(pages)
        source[0] += f"\n```{{toctree}}\n:hidden:\n:caption: {caption}\n\n{listed}\n```\n"


def _as_it_stands(app, what, name, obj, options, lines: list[str]) -> None:
    """Formulas and code in docstrings, which are set in from the text, keep their lines."""
    found: list[str] = []
    within = False
    for line in lines:
        set_in = line.startswith("    ")
        if set_in and not within and not (found and found[-1].strip()):
            found += ["::", ""]
        within = set_in or (within and not line.strip())
        found.append(line)
    lines[:] = found


def _with_index(app, error) -> None:
    """The site opens where one looks first."""
    if error is None and app.builder.name == "html":
        target = f'<meta http-equiv="refresh" content="0; url={root_doc}.html">\n'
        Path(app.outdir, "index.html").write_text(target, encoding="utf-8")


def setup(app) -> None:
    app.connect("source-read", _with_menu)
    app.connect("autodoc-process-docstring", _as_it_stands)
    app.connect("build-finished", _with_index)
