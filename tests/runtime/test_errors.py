"""Exit statuses, the hint that follows a mistyped name, and how packages are installed."""

import shlex
import sys

import pytest

from isas_cli.runtime.errors import InputError, IsasError, NumericalError, extra, nearest


def test_each_error_has_the_status_of_the_design():
    assert (IsasError.status, InputError.status, NumericalError.status) == (1, 2, 3)
    assert issubclass(InputError, IsasError) and issubclass(NumericalError, IsasError)


@pytest.mark.parametrize(
    ("typed", "meant"),
    [("our", "ours"), ("OURS", "ours"), ("unifrom", "uniform"), ("balance", "balanced")],
)
def test_nearest_names_what_was_meant_and_all_that_is_valid(typed, meant):
    valid = ["uniform", "ours", "balanced"]
    expected = f"did you mean '{meant}'? valid: uniform, ours, balanced"
    assert nearest(typed, valid) == expected


def test_nearest_does_not_guess_wildly():
    assert nearest("zzz", ["uniform", "ours"]) == "valid: uniform, ours"


def test_nearest_takes_any_iterable_even_an_empty_one():
    assert nearest("our", iter(["ours"])) == "did you mean 'ours'? valid: ours"
    assert nearest("our", []) == "there are none"


def test_nearest_gives_names_in_their_own_case():
    assert nearest("l2", ["L2", "relative_L2"]).startswith("did you mean 'L2'?")


def test_an_extra_is_installed_where_this_python_looks(monkeypatch):
    """Whatever its folder is called, and without another version of what is installed."""
    monkeypatch.setattr(sys, "executable", "/my code/.venv/bin/python")
    command, told = extra("ray").rsplit(" in ", 1)
    python, *others = shlex.split(command)
    assert python == sys.executable and told == "isas's source folder"
    assert others == ["-m", "pip", "install", "-c", "constraints.txt", "-e", ".[ray]"]
