"""A run of photographs whose file turned its poses: what renders is what the mesh's world has."""

import json

import numpy as np
import photo_sets
from photo_sets import POSES, Files
from test_photo_runs import problem

TURN = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0]])
BALL = "photos.sphere=[0.05,0.1,-0.2,0.4]"


def turned(folder) -> None:
    """The set, as nerfstudio writes it from COLMAP's."""
    file = folder / "transforms.json"
    content = json.loads(file.read_text())
    for frame in content["frames"]:
        pose = np.vstack([TURN, [0, 0, 0, 1]]) @ np.array(frame["transform_matrix"])
        frame["transform_matrix"] = pose.tolist()
    file.write_text(json.dumps({**content, "applied_transform": TURN.tolist()}))


def test_what_was_applied_is_undone_and_said(tmp_path):
    photo_sets.transforms(Files(tmp_path, POSES))
    straight = problem(f"photos.path={tmp_path}", BALL)
    turned(tmp_path)
    undone = problem(f"photos.path={tmp_path}", BALL)
    filled, again = np.array(straight.mask), np.array(undone.mask)
    assert 0.05 < filled.mean() < 0.5
    np.testing.assert_allclose(again, filled, atol=0.01)
    assert any("applied_transform undone" in each for each in undone.warnings)
    assert not any("applied_transform" in each for each in straight.warnings)
    # As the poses stand, the ball is elsewhere.
    stays = problem(f"photos.path={tmp_path}", BALL, "photos.world=file")
    assert np.abs(np.array(stays.mask) - filled).mean() > 0.02
    assert any("applied_transform stay" in each for each in stays.warnings)
