"""The figures of the image-space sampling paper as claims, each beside what was measured here."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import _overview
import _ranges
import pandas

_NEAR_START = 0.9  # share of the start's error above which a run has hardly left it
_CONVERGED = 0.1
_NEAR_BEST = 2  # times the best pmf's variance that are little beside what others have


class NotMeasured(Exception):
    """Something that a claim is judged by has not been measured."""


@dataclass(frozen=True)
class Claim:
    """``figure``: or section. ``found(results)``: our measurement and whether the claim holds, both
    in words; raises NotMeasured."""

    figure: str
    says: str
    found: Callable[[Path], tuple[str, str]]


def _table(results: Path, name: str) -> pandas.DataFrame:
    try:
        return pandas.read_csv(results / f"{name}.csv")
    except FileNotFoundError as error:
        raise NotMeasured(f"{name}: not run yet") from error


def _row(results: Path, scene: str, sampler: str) -> pandas.Series:
    table = _table(results, scene)
    rows = table[table["sampler"] == sampler]
    if rows.empty:
        raise NotMeasured(f"{scene}: no run of `{sampler}`")
    return rows.iloc[0]


def _range(row: pandas.Series, measure: str = "parameter_rmse") -> str:
    low, high = row[f"{measure}_low"], row[f"{measure}_high"]
    median = f"{row[measure]:.4f}" if row[measure] else _overview.BELOW
    return f"{median} [{low:.4f}, {high:.4f}]"


def _verdict(ours: pandas.Series, rival: pandas.Series, measure: str = "parameter_rmse") -> str:
    """yes, no or level: whether the seeds' ranges lie apart."""
    words = {_ranges.BELOW: "yes", _ranges.ABOVE: "no", _ranges.LEVEL: "level (ranges overlap)"}
    return words[_ranges.apart(ours, rival, measure)]


def _better(scene: str, *rivals: str) -> Callable[[Path], tuple[str, str]]:
    """`ours` ends with less error of parameters, and of the image, than each of ``rivals``."""

    def found(results: Path) -> tuple[str, str]:
        parts = [_compared(results, scene, rivals, "parameter_rmse", "parameters")]
        if "image_rmse_low" in _table(results, scene):
            parts.append(_compared(results, scene, rivals, "image_rmse", "image"))
        words, verdicts = zip(*parts)
        return f"{scene}: " + "; ".join(words), "; ".join(verdicts)

    return found


def _compared(
    results: Path, scene: str, rivals: tuple[str, ...], measure: str, what: str
) -> tuple[str, str]:
    """One measure's numbers and verdicts."""
    ours = _row(results, scene, "ours")
    words, verdicts = [f"`ours` {_range(ours, measure)}"], []
    for name in rivals:
        rival = _row(results, scene, name)
        words.append(f"`{name}` {_range(rival, measure)}")
        verdicts.append(f"`{name}` {_verdict(ours, rival, measure)}")
    table = _table(results, scene)
    best = table.loc[table[measure].idxmin()]
    told = f"`{best['sampler']}` {best[measure]:.4f}" if best[measure] else "cannot be told"
    words.append(f"best: {told}")
    return f"{what}: " + ", ".join(words), f"{what}: " + ", ".join(verdicts)


def _variance(results: Path) -> tuple[str, str]:
    ratio, low, high = _of_variance(results).loc["ours", _ends("ratio_to_gradient")]
    words = f"dodoco: variance of `ours` over that of \\|∂ℒ\\|: {ratio:.2f} [{low:.3f}, {high:.3f}]"
    return words, "yes" if high < 1 / 3 else "no" if low > 1 / 3 else "level"


def _levels(results: Path) -> tuple[str, str]:
    with_, without = (_row(results, "multires", s) for s in ("multiresolution", "ours"))
    ends = ("_low", "_high")
    keys = [k for k in with_.index if k.startswith("parameter_rmse/") and not k.endswith(ends)]
    words = [
        f"{k.split('/')[1].split('.')[0]} {_range(with_, k)} with, {_range(without, k)} without"
        for k in keys
    ]
    texture = [k for k in keys if k.endswith(".data")]
    if not texture:
        raise NotMeasured("multires: no error of the texture by itself")
    return "multires: " + "; ".join(words), _verdict(with_, without, texture[0])


def _small_budget(results: Path) -> tuple[str, str]:
    uniform, ours = (_row(results, "trashcan", s) for s in ("uniform", "ours"))
    words = (
        f"trashcan, share of the start's error left: `uniform` {uniform['share_of_start']:.3f}, "
        f"`ours` {ours['share_of_start']:.3f}"
    )
    stuck, there = uniform["share_of_start"] > _NEAR_START, ours["share_of_start"] < _CONVERGED
    if not there and _ranges.apart(ours, uniform, "parameter_rmse") == _ranges.LEVEL:
        return words, "cannot be told: where either ends is chance, their ranges overlap"
    if stuck and there:
        return words, "yes"
    parts = ["`ours` converges" if there else "`ours` does not converge"]
    parts.append("`uniform` is stuck" if stuck else "`uniform` is not stuck")
    return words, "in part: " + ", ".join(parts) if stuck or there else "no: " + ", ".join(parts)


def _caustic(results: Path) -> tuple[str, str]:
    table = _table(results, "caustic")
    own = table[table["scene"] == "caustic_failure"].set_index("looks")["distance"]
    words = ", ".join(f"{n}: {own[n]:.2f}" for n in own.index[:-1:2])
    words = f"caustic_failure: share of draws sent elsewhere, by paths a cell: {words}"
    # What isas warns of, see isas_cli/samplers/reliability.py.
    return words, "yes" if own.iloc[0] > 0.4 else "no"


def _listed(table: str, measures: Sequence[str], scene: str, *rivals: str) -> Callable:
    """`ours` ends with less of each of ``measures`` than each of ``rivals``, by a table of many
    scenes; once more where outlines are drawn by length, on both sides."""

    def found(results: Path) -> tuple[str, str]:
        own = _table(results, table)
        own = own[own["scene"] == scene]
        if own.empty:
            raise NotMeasured(f"{scene}: not run yet")
        own = _ranges.marked(own, _table(results, f"{table}_rates"))
        own = own.set_index(own["method"].str.removeprefix("silhouettes, "))
        told = []
        for measure in measures:
            for way in [w for w in ("", ", by length") if f"ours{w}" in own.index]:
                rows = {name: own.loc[name + way] for name in ("ours", *rivals)}
                words = [f"`{n}`{row['mark']} {_range(row, measure)}" for n, row in rows.items()]
                ours = rows.pop("ours")
                verdicts = [f"`{n}` {_verdict(ours, row, measure)}" for n, row in rows.items()]
                what = measure.removesuffix("_rmse").replace("parameter", "parameters") + way
                told.append((f"{what}: {', '.join(words)}", f"{what}: {', '.join(verdicts)}"))
        words, verdicts = zip(*told)
        return f"{scene}: " + "; ".join(words), "; ".join(verdicts)

    return found


def _told(measured: str, verdict: str) -> Callable[[Path], tuple[str, str]]:
    """Of a claim that no table of ours judges."""
    return lambda results: (measured, verdict)


def _densities(results: Path) -> tuple[str, str]:
    ratio, low, high = _of_variance(results).loc["ours", _ends("ratio_to_best")]
    words = f"dodoco: variance of `ours` over the best pmf's: {ratio:.2f} [{low:.2f}, {high:.2f}]"
    words += "; raw and denoised: [pictures](#what-one-look-finds-figures-2-and-5), "
    words += "[raced](#settings-of-ours-one-by-one)"
    return words, "yes" if high < _NEAR_BEST else "no" if low > _NEAR_BEST else "level"


def _drawn(results: Path) -> tuple[str, str]:
    """Of what goes to an object with an unknown texture or colour, the bin's share."""
    table = _table(results, "draws").query("scene == 'multires' and object != 'all else'")
    shares = table.set_index("object")[["multiresolution", "ours"]]
    with_it, without = shares.loc["bin"] / shares.sum()
    words = f"multires, one look: of the draws on bin and cake the bin has {without:.0%} without"
    more = with_it < 0.9 * without
    return f"{words}, {with_it:.0%} with", "yes" if more else "most do, but with it as well"


def _differential(results: Path) -> tuple[str, str]:
    table = _table(results, "derivative_sampling").set_index("roughness")
    words = ", ".join(f"{row['loss_variance']:.1f} ({at:g})" for at, row in table.iterrows())
    words = f"trashcan: variance of ∂ℒ/∂roughness, BSDF's over theirs, by roughness: {words}"
    level = [f"{at:g}" for at in table.index[table["loss_low"] <= 1]]
    return words, f"yes, but for roughness {', '.join(level)}" if level else "yes"


def _unbiased(results: Path) -> tuple[str, str]:
    table = _of_variance(results).dropna(subset=["bias_p"])
    z, p = table["bias_z"], table["bias_p"]
    words = f"dodoco: means of {len(z)} densities against uniform pixels': z {z.min():.1f} to "
    # Several tests at once.
    return f"{words}{z.max():.1f}", "yes: no bias seen" if p.min() * len(p) > 0.05 else "no"


def _refreshed(results: Path) -> tuple[str, str]:
    share = _table(results, "stage1_share").set_index("sampler").loc["ours", "share"]
    every = 1 / _of_variance(results).loc["ours", "looks_per_estimate"]
    words = f"looks of `ours`, every {every:.0f} steps: {100 * share.min():.1f} to "
    words += f"{100 * share.max():.1f} % of a run's time ([cost.md](cost.md#stage-1))"
    return words, "yes at that interval; 20: [below](#settings-of-ours-one-by-one)"


def _paths(results: Path) -> tuple[str, str]:
    table = _table(results, "gpu_race")
    rows = table[table["size"] == "default"].set_index("method")
    ours, uniform = rows.loc["ours"], rows.loc["uniform"]
    each = f"{ours['paths'] / ours['iteration'] / 1000:.0f}K paths a step"
    words = f"{ours['scene']} on a card, {each}: `ours` {_range(ours)}, `uniform` {_range(uniform)}"
    return words, f"parameters: {_verdict(ours, uniform)}; others here have fewer paths"


def _squares(results: Path) -> tuple[str, str]:
    table = _of_variance(results)
    steps = (table["seconds_look"] / table["seconds_step"]).loc[["ours", "gradient"]]
    words = "dodoco: a look of `ours` takes as long as {:.1f} steps, of |∂ℒ| {:.1f}".format(*steps)
    return words.replace("|", "\\|"), (
        "cannot be told: random signs in one pass forwards stand for the paper's traversal, and "
        "memory was not measured apart"
    )


def _memory(results: Path) -> tuple[str, str]:
    table = _table(results, "memory")
    first, last = table.iloc[0], table.iloc[-1]
    words = f"earth: {first['host_mb']:.0f} MB at {first['pixels'] / 2**20:.0f} million pixels, "
    words += f"{last['host_mb']:.0f} at {last['pixels'] / 2**20:.0f} ([cost.md](cost.md#memory))"
    return words, "cannot be told: not on a card, nor beside a loop that renders all pixels"


def _ends(measure: str) -> list[str]:
    return [measure, f"{measure}_low", f"{measure}_high"]


def _of_variance(results: Path) -> pandas.DataFrame:
    return _table(results, "variance_dodoco").set_index("sampler")


_volume = partial(_listed, "volumes", ("parameter_rmse", "image_rmse"))
_shape = partial(_listed, "shapes", ("chamfer",))

CLAIMS = [
    Claim("1", "three albedos at once: faster than uniform", _better("catcake", "uniform")),
    Claim("2", "few samples at low resolution, denoised, are enough for the density", _densities),
    Claim("3", "gradient variance less than a third of \\|∂ℒ\\|'s", _variance),
    Claim("4", "better than uniform with L2", _better("jumpydumpy", "uniform")),
    Claim("4", "and with relative L2", _better("jumpydumpy_relative", "uniform")),
    Claim("5", "with the multi-resolution scheme the texture converges faster", _levels),
    Claim(
        "5",
        "because without it most samples go to the bin",
        _drawn,
    ),
    Claim("6", "small budget: uniform is stuck at the start, `ours` converges", _small_budget),
    Claim("6", "directions drawn for the derivative (Belhe et al.) lower the noise", _differential),
    Claim("7", "where paths hardly find the light, the density is unreliable", _caustic),
    Claim("8", "better than uniform and \\|∂ℒ\\|", _better("dodoco", "uniform", "gradient")),
    Claim("8", "better than uniform and \\|∂ℒ\\|", _better("pottery", "uniform", "gradient")),
    Claim("8", "better than uniform and \\|∂ℒ\\|", _better("earth2mars", "uniform", "gradient")),
    Claim("8", "better than uniform and \\|∂ℒ\\|", _volume("smoke", "uniform", "gradient")),
    Claim("9", "better than uniform", _better("dodoco_a", "uniform")),
    Claim("9", "better than uniform", _better("earth", "uniform")),
    Claim("9", "better than uniform", _better("bowl", "uniform")),
    Claim("9", "better than uniform", _volume("lego", "uniform")),
    Claim("9", "better than uniform", _shape("dodoco_b", "uniform")),
    Claim("9", "better than uniform", _shape("kirby", "uniform")),
    Claim(
        "9",
        "shapes at 30,000 vertices, lego's grid at 256³",
        _told("`ours` raced with 10,242 vertices and 32³", "cannot be told: not raced, memory"),
    ),
    Claim("abstract", "few pixels a step save video memory", _memory),
    Claim(
        "Eq. 9",
        "with residuals taken as known, less is gained than by Eq. 12",
        _told(
            "no sampler of Eq. 9; with constant derivatives it is Eq. 5, `gradient`: figures 3, 8",
            "cannot be told",
        ),
    ),
    Claim("§4.1", "a density that is only estimated leaves the gradient unbiased", _unbiased),
    Claim("§4.1", "a new density every 20 steps costs little", _refreshed),
    Claim("§4.3", "squared derivatives are summed in one pass, with little memory", _squares),
    Claim("§5", "better with some 100K paths a step", _paths),
    Claim(
        "§5.2",
        "grids whose density reaches 0",
        _told(
            "ours stay above a floor: sample matching, for derivatives at 0, is not built",
            "cannot be told",
        ),
    ),
    Claim(
        "§6",
        "losses of more than a pixel are future work",
        _told(
            "`loss=structure` (SSIM's terms): its gradient is that of all windows, by a test",
            "done for SSIM; LPIPS cannot be told: its weights are not at hand",
        ),
    ),
]


def lines(results: Path) -> list[str]:
    """The table, from the CSV files at hand."""
    made = ["| where | the paper's claim | our measurement | holds |", "|---|---|---|---|"]
    for claim in CLAIMS:
        try:
            words, verdict = claim.found(results)
        except NotMeasured as missing:
            words, verdict = str(missing), "–"
        made.append(f"| {claim.figure} | {claim.says} | {words} | {verdict} |")
    return made
