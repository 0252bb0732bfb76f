"""Runs on photographs that find what lies on a surface of known colour, and where it stands."""

import json

import numpy as np
import plates
import pytest
from PIL import Image

import isas_cli
from isas_cli.runtime import images

BRDF = "object.bsdf.brdf_0"
SIDE = 16
RUN = [
    *("scene=photos", "sampler=uniform", "effects=full", "scene.max_depth=2"),
    *("estimator.batch=16384", "evaluation.count=2", "frames.views=0", "frames.snapshots=0"),
    "report=false",
]


def paint(path, dark: bool) -> np.ndarray:
    """A picture of patches, dark where reflections are to show."""
    low, high = (0.02, 0.1) if dark else (0.1, 0.8)
    made = np.random.default_rng(5).uniform(low, high, (8, 8, 3)).astype(np.float32)
    images.write_exr(path, made, [*"RGB"], {})
    return made


@pytest.mark.slow
def test_a_pose_is_found_by_a_known_colour(tmp_path):
    """Of a plate that stands turned and shifted in its own plane and out of it."""
    true = {"type": "principled", "base_color": plates.laid(paint(tmp_path / "paint.exr", False))}
    turn, shift = 9.0, np.array([0.06, -0.04, 0.05])
    stands = plates.obj(tmp_path / "stands.obj", turn, shift)
    settings = plates.written(tmp_path, true | {"roughness": 0.5}, stands)
    mesh = plates.obj(tmp_path / "plate.obj")
    poses = {
        "turn": {"kind": "rotation", "objects": ["object"], "axis": [0, 0, 1]},
        "shift": {"kind": "translation", "objects": ["object"]},
    }
    unknowns = {"turn": {"start": 0.0, "lr": 0.5}, "shift": {"start": 0.0, "lr": 0.005}}
    run = isas_cli.run(
        *RUN,
        *settings,
        *(f"photos.mesh={mesh}", f"photos.texture={tmp_path / 'paint.exr'}"),
        *(f"scene.poses={json.dumps(poses)}", f"scene.unknowns={json.dumps(unknowns)}"),
        *("estimator=silhouettes", "budget.iterations=150", f"hydra.run.dir={tmp_path / 'run'}"),
    )
    found = run.parameters()
    print(found)
    # Seen: 9.008, and within 0.0002.
    assert abs(found["turn"] - turn) < 0.1
    np.testing.assert_allclose(found["shift"], shift, atol=0.002)


@pytest.mark.slow
def test_two_roughnesses_are_found_where_they_are(tmp_path):
    """The left half of a plate smooth, the right half rough; the picture's first row v = 1: smooth
    is a corner of the upper left too, so that nothing is right by symmetry."""
    row, column = np.mgrid[:SIDE, :SIDE]
    smooth = (column < SIDE // 2) ^ ((row < SIDE // 4) & (column < SIDE // 4))
    truth = np.where(smooth, 0.2, 0.6).astype(np.float32)[..., None]
    material = {"type": "principled", "roughness": plates.laid(truth)}
    material["base_color"] = plates.laid(paint(tmp_path / "paint.exr", True))
    mesh = plates.obj(tmp_path / "plate.obj")
    settings = plates.written(tmp_path, material, mesh)
    run = isas_cli.run(
        *RUN,
        *settings,
        *(f"photos.mesh={mesh}", f"photos.texture={tmp_path / 'paint.exr'}"),
        *("photos.roughness=map", f"photos.texels={SIDE}"),
        *("budget.iterations=250", f"hydra.run.dir={tmp_path / 'run'}"),
    )
    found = run.parameters()[f"{BRDF}.roughness.data"][..., 0]
    inside = np.zeros((SIDE, SIDE), bool)
    inside[1:-1, 1:-1] = True
    inside[:, SIDE // 2 - 1 : SIDE // 2 + 1] = False
    means = [float(found[inside & part].mean()) for part in (smooth, ~smooth)]
    print(means, np.corrcoef(found[inside], truth[..., 0][inside])[0, 1])
    # Seen: 0.22, 0.59, 0.95.
    assert abs(means[0] - 0.2) < 0.05 and abs(means[1] - 0.6) < 0.05
    assert np.corrcoef(found[inside], truth[..., 0][inside])[0, 1] > 0.85


@pytest.mark.slow
def test_a_bump_is_found(tmp_path):
    """By the directions of its slopes, off the middle, on a plate that is flat elsewhere."""
    row, column = (np.mgrid[:SIDE, :SIDE] + 0.5) / SIDE
    x, y = (column - 0.4) / 0.28, -(row - 0.35) / 0.28  # to the right, and up
    near = np.exp(-(x**2 + y**2))
    normals = np.stack([1.2 * x * near, 1.2 * y * near, np.ones_like(near)], axis=-1)
    normals /= np.linalg.norm(normals, axis=2, keepdims=True)
    material = {"type": "principled", "roughness": 0.3}
    material["base_color"] = plates.laid(paint(tmp_path / "paint.exr", False))
    bumped = {"type": "normalmap", "normalmap": plates.laid((normals + 1) / 2), "bsdf": material}
    mesh = plates.obj(tmp_path / "plate.obj")
    settings = plates.written(tmp_path, bumped, mesh, light=plates.coloured)
    run = isas_cli.run(
        *RUN,
        *settings,
        *(f"photos.mesh={mesh}", f"photos.texture={tmp_path / 'paint.exr'}"),
        *("photos.normals=map", "photos.roughness=true", f"photos.texels={SIDE}"),
        *("budget.iterations=500", f"hydra.run.dir={tmp_path / 'run'}"),
    )
    texels = run.parameters()[f"{BRDF}.normalmap.data"]
    # For other programs the numbers as they are, not through a colour's curve.
    with Image.open(tmp_path / f"run/frames/result_{BRDF}.normalmap.data.png") as shown:
        np.testing.assert_allclose(np.asarray(shown) / 255, texels, atol=0.003)
    found = 2 * texels - 1
    np.testing.assert_allclose(np.linalg.norm(found, axis=2), 1, atol=1e-4)
    inner = np.s_[1:-1, 1:-1]
    left = np.degrees(np.arccos(np.clip((found * normals).sum(2), -1, 1)))[inner]
    before = np.degrees(np.arccos(normals[..., 2]))[inner]
    print(np.sqrt(np.mean(left**2)), np.sqrt(np.mean(before**2)))
    told = [
        np.corrcoef(found[inner][..., k].ravel(), normals[inner][..., k].ravel()) for k in (0, 1)
    ]
    print([each[0, 1] for each in told], run.parameters()[f"{BRDF}.nested_bsdf.roughness.value"])
    # Seen: 6.2 of 17.4 degrees; 0.96, 0.95; 0.30.
    assert np.sqrt(np.mean(left**2)) < 0.5 * np.sqrt(np.mean(before**2))
    assert min(each[0, 1] for each in told) > 0.9


@pytest.mark.slow
def test_metal_is_found_where_it_is(tmp_path):
    """The left half of a plate, whose roughness is unknown too."""
    column = np.indices((SIDE, SIDE))[1]
    metal = column < SIDE // 2
    truth = np.where(metal, 0.9, 0.1).astype(np.float32)[..., None]
    material = {"type": "principled", "roughness": 0.5, "metallic": plates.laid(truth)}
    material["base_color"] = plates.laid(paint(tmp_path / "paint.exr", False))
    mesh = plates.obj(tmp_path / "plate.obj")
    settings = plates.written(tmp_path, material, mesh, light=plates.coloured)
    run = isas_cli.run(
        *RUN,
        *settings,
        *(f"photos.mesh={mesh}", f"photos.texture={tmp_path / 'paint.exr'}"),
        *("photos.metallic=map", "photos.roughness=true", f"photos.texels={SIDE}"),
        *("budget.iterations=400", f"hydra.run.dir={tmp_path / 'run'}"),
    )
    found = run.parameters()[f"{BRDF}.metallic.data"][1:-1, 1:-1, 0]
    inside = np.abs(column - SIDE / 2 + 0.5)[1:-1, 1:-1] > 1
    means = [float(found[part[1:-1, 1:-1] & inside].mean()) for part in (metal, ~metal)]
    rough = float(run.parameters()[f"{BRDF}.roughness.value"][0])
    print(means, rough)  # seen: 0.92, 0.10, 0.50
    np.testing.assert_allclose([*means, rough], [0.9, 0.1, 0.5], atol=0.06)
