"""Poses and shapes from pictures that nothing of isas has made, with texture unknown."""

import _drawn_box as drawn_box
import numpy as np
import pytest
import trimesh
from runs_for_tests import QUIET, ran

from isas_cli import records
from isas_cli.cli.app import main
from isas_cli.scene.shape_error import Sampled, apart


def run(folder, *settings: str) -> records.Run:
    words = ["scene=photos", f"photos.path={folder}", "evaluation.count=2", *QUIET]
    return ran(folder / "run", *words, *settings)


@pytest.mark.parametrize("outline", ["alpha", "masks"])
def test_a_pose_by_its_outline(tmp_path, outline):
    """From 10 degrees and 12 % off. Seen: 0.03 degrees; 0.01 % with alpha, 0.09 % with masks that
    are white only where the box fills a whole pixel."""
    drawn_box.photographed(tmp_path, 8, outline)
    corners = drawn_box.turned_mesh(tmp_path / "box.obj", 10, 1.12)
    found = run(
        tmp_path,
        *(f"photos.mesh={tmp_path / 'box.obj'}", f"photos.environment={tmp_path / 'white.png'}"),
        *("photos.pose=true", "photos.background=black", "budget.iterations=300"),
        *("estimator.batch=1024", "estimator.edges=1024", "photos.texture=32"),
    )
    degrees, size, shift = drawn_box.off(found.parameters(), corners)
    print(f"{degrees:.3f} degrees, {size:.2%}, {shift:.4f}")
    assert degrees < 0.5 and abs(size) < 0.01 and shift < 0.01
    outlines, summary = "value/outlines/apart", found.summary
    assert summary["final"][outlines] < 0.1 * summary["start"][outlines]


def test_a_pose_by_edges_over_clutter(tmp_path):
    """From 5 degrees off, one picture, no mask."""
    drawn_box.photographed(tmp_path, 1, "none", scale=4)
    corners = drawn_box.turned_mesh(tmp_path / "box.obj", 5, 1.0, (1.0, 0.2, 0.5))
    found = run(
        tmp_path,
        *(f"photos.mesh={tmp_path / 'box.obj'}", f"photos.environment={tmp_path / 'white.png'}"),
        *("photos.pose=true", "photos.edges=true", "budget.iterations=300"),
        *("estimator.batch=1024", "estimator.edges=1024", "photos.texture=32"),
    )
    degrees, size, _ = drawn_box.off(found.parameters(), corners)
    print(f"{degrees:.3f} degrees, {size:.2%}")
    assert degrees < 1 and abs(size) < 0.02


def test_edges_that_nothing_follows_are_refused(tmp_path, capsys):
    drawn_box.photographed(tmp_path, 1, "none")
    drawn_box.turned_mesh(tmp_path / "box.obj", 0, 1.0)
    words = ["run", "scene=photos", f"photos.path={tmp_path}", "photos.edges=true"]
    words += [f"photos.mesh={tmp_path / 'box.obj'}", f"hydra.run.dir={tmp_path / 'run'}"]
    for more, told in (
        ("seed=1", "nothing that is unknown moves: photos.pose=true"),
        ("estimator=two_path", "edges are followed by estimator=silhouettes alone"),
    ):
        assert main([*words, more]) == 2
        assert told in " ".join(capsys.readouterr().err.split())


def test_a_box_from_nothing_but_pictures(tmp_path, quick):
    """Its hull first, then shape, colour and light in one command."""
    drawn_box.photographed(tmp_path, 8, "alpha")
    found = run(
        tmp_path,
        *("photos.voxels=24", "photos.texture=32", "budget.iterations=200"),
        *("estimator.batch=2048", "estimator.edges=1024"),
    )
    assert found.config["estimator"]["name"] == "silhouettes"
    truth = trimesh.creation.box(2 * drawn_box.HALF)
    truth = Sampled.of(np.asarray(truth.vertices), np.asarray(truth.faces))
    far = {}
    for name in ("start", "result"):
        mesh = trimesh.load(
            tmp_path / f"run/meshes/{name}_object.vertices.ply", process=False, maintain_order=True
        )
        far[name] = apart(Sampled.of(np.asarray(mesh.vertices), mesh.faces), truth)["chamfer"]
    print(far)
    assert far["result"] < 0.93 * far["start"] < 0.04
    assert found.history["image_rmse"].iloc[-1] < 0.6 * found.history["image_rmse"].iloc[0]
