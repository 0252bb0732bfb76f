"""From numbers of the census of derivatives to verdicts."""

import numpy as np
import pandas
import pytest
from _derivative_verdicts import judged, of_keys, of_words

BASE = {
    **{"scene": "mask", "key": "thing.bsdf.opacity.value", "plugin": "mask", "class": "MaskBSDF"},
    **{"word": "opacity", "point": "generic", "span": 1.0, "picture": 0.2},
    **{"reference": 0.1, "short": 0.1, "reference_error": 0.0005},
}


def row(isas: float, error: float = 0.0005, said: str = "", **changed) -> dict:
    ways = {way: 0.1 for way in ("prb", "path", "replayed")} | {"isas": isas}
    errors = {f"{way}_error": 0.0005 for way in ways} | {"isas_error": error}
    return BASE | ways | errors | {"isas_said": said} | changed


@pytest.mark.parametrize(
    ("isas", "error", "said", "verdict"),
    [
        (0.1, 0.0005, "", "right"),
        (0.104, 0.0005, "", "right"),
        (0.12, 0.0005, "", "wrong"),
        (0.12, 0.01, "", "unsure"),
        (0.1, 0.01, "", "unsure"),
        (0.0, 0.0, "", "never"),
        (np.nan, np.nan, "refused: take differences", "refused"),
        (np.nan, np.nan, "RuntimeError: …", "fails"),
        (np.nan, np.nan, "moves", "moves"),
    ],
)
def test_a_way_is_judged_by_its_distance_and_its_noise(isas, error, said, verdict):
    found = judged(pandas.DataFrame([row(isas, error, said)]))
    assert found["verdict_isas"].item() == verdict


def test_what_changes_next_to_nothing_is_not_judged():
    small = row(0.0, 0.0, reference=1e-5, short=1e-5, reference_error=1e-6)
    assert judged(pandas.DataFrame([small]))["verdict_isas"].item() == "-"


def test_steps_that_disagree_are_doubted():
    found = judged(pandas.DataFrame([row(0.112, 0.0005, short=0.115)]))
    assert found["verdict_isas"].item() == "unsure"


def keyed(*rows: dict) -> dict:
    return of_keys(pandas.DataFrame(rows)).iloc[0].to_dict()


def test_ends_are_told_beside_the_generic_value():
    found = keyed(row(0.1), row(0.0, 0.0, point="low"), row(0.1, point="high"))
    assert (found["isas"], found["isas_ends"]) == ("right", "low")
    assert found["verdict"] == "right inside its range"


def test_the_worst_of_both_sums_counts():
    assert keyed(row(0.1), row(0.2))["verdict"] == "wrong (isas)"


def test_mitsubas_faults_are_told_where_isas_has_none():
    assert keyed(row(0.1, prb=0.3))["verdict"] == "right, wrong in Mitsuba"
    assert keyed(row(0.1))["verdict"] == "right"


def test_a_parameter_has_the_worst_verdict_of_its_scenes():
    beside = row(0.3, scene="mask-mirror", plugin=None)
    words = of_words(of_keys(pandas.DataFrame([row(0.1), beside])))
    (only,) = words.to_dict("records")
    assert only == {
        "class": "MaskBSDF",
        "plugin": "mask",
        "word": "opacity",
        "verdict": "wrong (isas)",
        "note": "in mask-mirror",
    }
