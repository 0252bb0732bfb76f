"""What the census's numbers say: a verdict for every way, key and point, and one for every key.

A way is ``right`` where it agrees with the differences within 5 % and the standard errors would
have shown more; ``wrong`` where it is off by more than that and by more than four of them;
``never`` where it gives exactly 0 for what changes the picture; ``unsure`` between; ``-`` where the
key changes next to nothing there. What an error says stands for itself: ``refused``, ``fails``.
"""

from __future__ import annotations

import numpy as np
import pandas

OFF, SURE = 0.05, 4.0
NOTHING = 1e-3  # of the picture, over the whole range of the key
WAYS = ("prb", "path", "isas", "replayed")
# From what settles a key to what leaves it open.
_ORDER = ("never", "wrong", "fails", "refused", "right", "unsure", "-", "")


def read(path) -> pandas.DataFrame:
    """A table of a census. A scene is called ``null``, which pandas takes for none."""
    return pandas.read_csv(path, keep_default_na=False, na_values=[""])


def judged(table: pandas.DataFrame) -> pandas.DataFrame:
    """The table with a column ``verdict_<way>`` for each way."""
    columns = {f"verdict_{way}": table.apply(_of, axis=1, way=way) for way in WAYS}
    return table.assign(**columns)


def _of(row: pandas.Series, way: str) -> str:
    said = row.get(f"{way}_said")
    if isinstance(said, str) and said:
        return said if said == "moves" else "refused" if said.startswith("refused") else "fails"
    found, reference = row[way], row["reference"]
    if not np.isfinite(found) or not np.isfinite(reference):
        return ""
    error = float(np.hypot(row[f"{way}_error"], _doubt(row)))
    small = NOTHING * abs(row["picture"]) / row["span"]
    if abs(reference) < small and abs(found) < small:
        return "-"
    if found == 0 and abs(reference) > SURE * _doubt(row):
        return "never"
    apart = abs(found - reference)
    if apart > OFF * abs(reference) and apart > SURE * error:
        return "wrong"
    return (
        "right" if apart <= OFF * abs(reference) and 2 * error <= OFF * abs(reference) else "unsure"
    )


def _doubt(row: pandas.Series) -> float:
    """Standard error of the differences, and what their two steps differ by more than noise
    explains: the error of the next order is a part of that."""
    gap = 0.25 * abs(row["short"] - row["reference"])
    return float(np.hypot(row["reference_error"], min(gap, OFF * abs(row["reference"]))))


def worst(verdicts: pandas.Series) -> str:
    """Of one way at all points of a key."""
    found = set(verdicts.fillna(""))
    return next(word for word in (*_ORDER, "moves") if word in found) if found else ""


def of_keys(table: pandas.DataFrame) -> pandas.DataFrame:
    """A row for each scene and key: of all ways what they are at the generic value (``prb``, …) and
    at which ends that does not hold (``prb_ends``, …), and ``verdict``."""
    found = judged(table)
    rows = []
    for (scene, key), group in found.groupby(["scene", "key"], sort=False):
        row = {"scene": scene, "key": key} | {
            name: group[name].iloc[0] for name in ("plugin", "class", "word")
        }
        inside = group[group["point"] == "generic"]
        for way in WAYS:
            row[way] = worst(inside[f"verdict_{way}"])
            bad = group[group[f"verdict_{way}"].isin(_BAD) & (group["point"] != "generic")]
            row[f"{way}_ends"] = " ".join(dict.fromkeys(bad["point"]))
        rows.append(row | {"verdict": _verdict(row)})
    return pandas.DataFrame(rows)


_BAD = ("wrong", "never", "fails")


def _verdict(row: dict) -> str:
    own = {row["isas"], row["replayed"]}
    if "moves" in own:
        return "moves"
    for word, name in (
        ("refused", "refused"),
        ("never", "never differentiated (isas)"),
        ("wrong", "wrong (isas)"),
        ("fails", "fails (isas)"),
    ):
        if word in own:
            return name
    if row["isas"] not in ("right", "unsure"):
        return "no effect"
    if row["isas_ends"] or row["replayed_ends"]:
        return "right inside its range"
    if {row["prb"], row["path"]} & set(_BAD):
        return "right, wrong in Mitsuba"
    return row["isas"]


_WORST = (
    "never differentiated (isas)",
    "wrong (isas)",
    "fails (isas)",
    "refused",
    "moves",
    "right inside its range",
    "right, wrong in Mitsuba",
    "right",
    "unsure",
    "no effect",
)


# Where a derivative is wrong, in words, by class and parameter.
_TURNED = "not right where it turns parts of a surface away from the camera"
_CAUSES = {("BumpMap", "nested_texture"): _TURNED, ("NormalMap", "normalmap"): _TURNED}


def of_words(keys: pandas.DataFrame) -> pandas.DataFrame:
    """A row for each class and parameter: the worst verdict of its scenes, and where that is."""
    rows = []
    for (kind, word), group in keys.dropna(subset=["class"]).groupby(["class", "word"]):
        verdict = min(group["verdict"], key=_WORST.index)
        where = group[group["verdict"] == verdict]
        note = ""
        if verdict in _WORST[:4] and len(where) < len(group):
            note = "in " + ", ".join(dict.fromkeys(where["scene"]))
            note = f"{_CAUSES[kind, word]}: {note}" if (kind, word) in _CAUSES else note
        elif verdict == _WORST[5]:
            ends = set(" ".join(where["isas_ends"] + " " + where["replayed_ends"]).split())
            note = "not at its " + " and ".join(f"{end} end" for end in sorted(ends, reverse=True))
        plugin = next(iter(group["plugin"].dropna()), "")
        rows.append(
            {"class": kind, "plugin": plugin, "word": word, "verdict": verdict, "note": note}
        )
    return pandas.DataFrame(rows, columns=["class", "plugin", "word", "verdict", "note"])
