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


# Inputs of seed 1 that ended in a traceback, or killed the process, once. (A record's own numbers
# differ between machines, and so does whether a damaged one can be taken.)
FOUND = {
    **dict.fromkeys((4426, 16600, 17536, 75730), "record"),
    **dict.fromkeys((34735, 76171), "mesh"),
    **dict.fromkeys((6446, 11854, 61374, 65310), "grid"),
    **dict.fromkeys((28647, 77075), "configuration"),
}


def test_what_was_found_ends_otherwise_now(tmp_path):
    sound = tmp_path / "files"
    fuzz.Reader(sound)
    for number, kind in FOUND.items():
        _, findings = fuzz.search(1, 1, sound, number, kind)
        assert not findings, findings
