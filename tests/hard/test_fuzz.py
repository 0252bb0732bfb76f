"""Damaged and hostile input: see ``fuzz.py``, of which this is a small part."""

import fuzz
import pytest


@pytest.fixture(scope="module")
def sound(tmp_path_factory):
    folder = tmp_path_factory.mktemp("sound") / "files"
    fuzz.Reader(folder)
    return folder


def test_no_input_ends_in_a_traceback_a_hang_or_a_file_elsewhere(sound):
    outcomes, findings = fuzz.search(fuzz.inputs(600), 1, sound)
    print(outcomes)
    assert not findings, "\n".join(map(str, findings))
    for kind in fuzz.KINDS:
        # The sound inputs are taken, and damage is noticed.
        assert outcomes[kind, "refused"] > 10 and outcomes[kind, "taken"] > 0
    assert sum(outcomes.values()) == 600


# Inputs of seed 1 that ended in a traceback, or killed the process, once. (Records hold times and
# folders, so that their damage is another one each time: what was found in them is asked for in
# tests/records/test_records.py and tests/engine/test_resume.py.)
FOUND = {
    **dict.fromkeys((34735, 76171), "mesh"),
    **dict.fromkeys((6446, 11854, 61374, 65310), "grid"),
    **dict.fromkeys((28647, 77075), "configuration"),
}


def test_what_was_found_ends_otherwise_now(sound):
    outcomes, findings = fuzz.search([*FOUND.items()], 1, sound)
    assert not findings, findings
    assert sum(outcomes.values()) == len(FOUND)
