"""The PBDR paper's races: what contestants are, and what the page claims of their tables."""

import importlib

import _page_pbdr
import mitsuba as mi
import numpy as np
import pandas
import pbdr
import pytest

from isas_cli.config.compose import compose
from isas_cli.scene import phong  # noqa: F401  (registers it)


@pytest.mark.parametrize("scene", pbdr.SCENES)
def test_a_prior_that_knows_expects_the_scenes_mean_roughness(scene):
    cfg = compose([f"scene={scene}", "size=tiny"]).scene
    module, build = cfg.builder.rsplit(".", 1)
    made = getattr(importlib.import_module(module), build)(**cfg.arguments)
    values = mi.traverse(mi.load_dict(made, optimize=False))
    rough = [key for key in cfg.unknowns if key.split(".")[-2] in ("roughness", "alpha")]
    mean = np.mean([np.array(values[key]) for key in rough])
    known = pbdr.more(scene)[1]["prior, known"]["prior.expected"]
    assert known == pytest.approx(mean, abs=1e-4)


def test_of_shapes_each_part_is_left_out_alone():
    full, *others = (pbdr.shape_methods()[name] for name in (pbdr.FULL, *PARTS))
    kept = [{key for key in full if each.get(key) == full[key]} for each in others]
    assert kept == [set(full) - set(pbdr.SMOOTH), set(full) - set(pbdr.PRIOR)]


PARTS = "without smoothing", "without the prior"


def raced(**methods: float) -> pandas.DataFrame:
    """By method, whose RE, MPEA and CS are all the same number, of one seed."""
    ends = [f"{name}{end}" for name in ("re", "mpea", "cs") for end in ("", "_low", "_high")]
    return pandas.DataFrame({name: dict.fromkeys(ends, each) for name, each in methods.items()}).T


def test_parts_of_the_shapes_method_are_judged_once_they_are_raced():
    both = {_page_pbdr.FULL: 1.0, _page_pbdr.PLAIN: 3.0, _page_pbdr.STOCK: 9.0}

    def claims(scene: str, **more: float) -> dict[str, str]:
        found = _page_pbdr._claims({scene: raced(**both, **more)})
        return {each["claim"]: each["holds"] for each in found}

    usual = {"RE is lower than Mitsuba's": "yes", "MPEA is lower than Mitsuba's": "yes"}
    assert claims(_page_pbdr.SHAPE) == usual
    # Where nothing is to be smoothed.
    prior = {"without the prior RE rises", "without the prior convergence takes longer (CS)"}
    assert set(claims("room_joint")) == set(usual) | prior
    found = claims(_page_pbdr.SHAPE, **dict(zip(PARTS, (2.0, 0.5))))
    assert found["without smoothing RE rises"] == "yes"
    assert found["without the prior RE rises"] == "no, the other way round"
