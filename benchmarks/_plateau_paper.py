"""PRDPT's table 1, squared errors at the end of its runs, beside ours."""

from __future__ import annotations

# As printed: the image's and the parameters' of each column. GONE: our copy's text lacks it. †: of
# notes on the paper, where our copy lacks it.
GONE, NONE = "unreadable", "–"
TABLE = {
    "cup": {
        "SoftRas": ("3.66e-1", "2.72e-2"),
        "Mitsuba": ("5.49e-3", "0.75e-1"),
        "∂κP": ("4.92e-6", "4.18e-7"),
        "κ∂P": ("4.75e-4", "2.77e-1"),
    },
    "shadows": {
        "SoftRas": ("1.64e-3", "1.42e-1"),
        "Mitsuba": ("1.64e-3", "5.06"),
        "∂κP": ("1.74e-5", "1.81e-3"),
        "κ∂P": ("5.12e-4", "1.28"),
    },
    "occlusion": {"SoftRas": ("5.33e-2", GONE), "∂κP": ("2.34e-4†", "3.29e-3")},
    "global_illumination": {"SoftRas": (NONE, GONE), "∂κP": ("5.07e-5†", "8.71e-4")},
    "sort": {"SoftRas": ("1.85e-2", GONE), "∂κP": ("3.81e-3†", "4.19e-1")},
    "caustic": {
        "SoftRas": (NONE, NONE),
        "Mitsuba": ("3.12e-1", "8.50"),
        "∂κP": ("1.89e-5", "9.76e-5"),
        "κ∂P": ("2.42e-1", "4.03"),
    },
}
# Seconds an iteration, by Mitsuba's derivative and by ∂κP, of the same notes.
SECONDS = {
    "cup": (1.12, 0.10),
    "shadows": (0.64, 0.04),
    "occlusion": (0.37, 0.09),
    "global_illumination": (0.44, 0.15),
    "sort": (2.88, 2.23),
    "caustic": (1.02, 0.08),
}
OURS = {"SoftRas": None, "Mitsuba": "mitsuba", "∂κP": "plateau", "κ∂P": "plateau_renderer"}
# The follow-up's angle is 20° θ: its squares of θ are ours of degrees over 400.
ANGLE = 20.0
UNITS = {
    "cup": "(20°)²",
    "global_illumination": "squares of lengths, degrees, reflectances",
    "sort": "length², at a place of its colour",
}


def beside(by: dict[str, dict]) -> list[dict]:
    """A row per task and column of the table; ``by``: task → method → its row of medians."""
    rows = []
    for task, ours in by.items():
        for column, method in OURS.items():
            image, parameters = TABLE[task].get(column, (GONE, GONE))
            row = {"task": f"{task}, {UNITS.get(task, 'length²')}", "column": column}
            row |= {"image": image, "parameters": parameters, "ours": ours.get(method)}
            row["times"] = SECONDS[task][0] / SECONDS[task][1] if column == "Mitsuba" else None
            if own := row["ours"]:
                # A cube at the place of another of its colour is not wrong.
                which = "sorted_mse" if task == "sort" else "parameter_mse"
                row["error"] = own[which] / (ANGLE**2 if task == "cup" else 1)
            rows.append(row)
    return rows
