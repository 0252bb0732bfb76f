"""Damaged and hostile input: see ``fuzz.py``, of which this is a small part."""

import fuzz


def test_no_input_ends_in_a_traceback_a_hang_or_a_file_elsewhere(tmp_path):
    sound = tmp_path / "files"
    fuzz.Reader(sound)
    outcomes, findings = fuzz.search(1000, 1, sound)
    print(outcomes)
    assert not findings, "\n".join(map(str, findings))
    for kind in fuzz.KINDS:
        # The sound inputs are taken, and damage is noticed.
        assert outcomes[kind, "refused"] > 20
    assert sum(outcomes.values()) == 1000


# Inputs of seed 1 that ended otherwise once.
FOUND = {
    4426: "record",
    16600: "record",
    17536: "record",
    28647: "configuration",
    34735: "mesh",
    75730: "record",
}


def test_what_was_found_is_refused_now(tmp_path):
    sound = tmp_path / "files"
    fuzz.Reader(sound)
    for number, kind in FOUND.items():
        outcomes, findings = fuzz.search(1, 1, sound, number)
        assert not findings, findings
        assert outcomes[kind, "refused"] == 1, outcomes
