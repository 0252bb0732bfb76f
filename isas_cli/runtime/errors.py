"""The errors that a person sees, each with the exit status that the command ends with.

A message is one line: what is wrong, where, and what would be right. The command prints it
without a traceback; any other exception is a defect of isas and keeps its traceback.
"""

from __future__ import annotations

import difflib
import shlex
import sys
from collections.abc import Iterable


class IsasError(Exception):
    """Base of all errors that end the command with a line for the reader."""

    status = 1


class InputError(IsasError):
    """Bad configuration, input file or machine: status 2."""

    status = 2


class NumericalError(IsasError):
    """The optimisation cannot go on (the last good state is kept): status 3."""

    status = 3
    ended = "numerical failure"  # what a record says of how it ended


def nearest(name: str, valid: Iterable[str]) -> str:
    """Text that helps whoever typed `name` where one of `valid` was expected.

    Returns "did you mean 'ours'? valid: a, b, c", without the question when nothing is near.
    The valid names keep their order. The comparison ignores case.
    """
    names = list(valid)
    by_lower_case = {candidate.lower(): candidate for candidate in reversed(names)}
    matches = difflib.get_close_matches(name.lower(), by_lower_case, n=1, cutoff=0.5)
    listing = f"valid: {', '.join(names)}" if names else "there are none"
    if not matches:
        return listing
    return f"did you mean '{by_lower_case[matches[0]]}'? {listing}"


def installing(packages: str) -> str:
    """The command that brings ``packages`` to this Python: another's pip installs them elsewhere
    or, as Debian's, refuses to."""
    return f"{shlex.quote(sys.executable)} -m pip install {packages}"


def extra(name: str) -> str:
    """What brings an extra of isas, in words."""
    return installing(f"-c constraints.txt -e '.[{name}]'") + " in isas's source folder"
