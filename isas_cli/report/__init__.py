"""What a person looks at after a run: plots, picture sheets and one page, from its records alone.

Nothing here renders, so a report can be made anywhere and again at any time.
"""

from __future__ import annotations

from pathlib import Path

from .. import records
from . import frames, page, plots


def write(folder: Path) -> Path:
    """Makes plots/*.png and report.html in a run's folder and returns the path of report.html.

    A run that was interrupted, has no truth or lacks some frames gets a report without what is
    missing. Raises InputError when the folder holds no run (see `records.load`), IsasError when the
    disk refuses.
    """
    run = records.load(Path(folder))
    pictures = frames.write_sheets(run.folder)
    drawn = plots.write_plots(run)
    return page.write_page(run, pictures, drawn)
