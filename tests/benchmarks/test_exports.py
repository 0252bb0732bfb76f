"""The census of exports: what is committed, and how a row is judged."""

from pathlib import Path

import _page_exports
import exports
import numpy as np
import pytest
from _plugin_scenes import SCENES


def test_every_plugins_scene_is_in_the_table_and_no_file_shows_something_else():
    rows = _page_exports.read(exports.TABLE)
    assert set(rows["scene"]) == set(SCENES)
    assert not set(rows["verdict"]) & {"differs", "not rendered", "its process ended"}
    # Pictures that change tell something.
    assert (rows["changed"] > 10 * exports.SAME).sum() > len(rows) / 2


@pytest.mark.parametrize("error, verdict", [(0.0, "same"), (2 * exports.SAME, "differs")])
def test_a_picture_is_judged_by_its_difference(tmp_path, error, verdict):
    wanted = np.full((2, 2, 3), 0.5)
    np.save(tmp_path / "wanted.npy", wanted)
    np.save(tmp_path / "scene.xml.npy", wanted * (1 + error))
    row = {"folder": str(tmp_path), "written": str(tmp_path / "scene.xml")}
    assert exports.judged(row)["verdict"] == verdict


def test_what_mitsuba_says_of_a_file_is_kept(tmp_path):
    Path(tmp_path / "scene.xml.txt").write_text(f"{tmp_path}/scene.xml: no such plugin")
    row = {"folder": str(tmp_path), "written": str(tmp_path / "scene.xml")}
    found = exports.judged(row)
    assert found["verdict"] == "not rendered" and found["told"] == "/scene.xml: no such plugin"
    assert exports.judged({"refused": "why"})["told"] == "why"
