"""Hard cases of shapes: see ``hard_cases``."""

from __future__ import annotations

import numpy as np
import trimesh
from hard_cases import Case, start
from isas_cli.scenes.icosphere import icosphere

SHAPES = (
    *("estimator=silhouettes", "estimator.edges=1024", "estimator.shadows=1024"),
    *("estimator.batch=1024",),
)
BALL_OF_TRIANGLES = 0.8 * icosphere(3)[0], icosphere(3)[1]


def _shape(
    name: str,
    provokes: str,
    within: float,
    truth: tuple,
    begins,
    warns: str = "",
    sure: bool = True,
    rate: float = 0.02,
) -> Case:
    """A mesh, and where its vertices start."""
    vertices, faces = truth
    mesh = '<shape type="ply" id="thing"><string name="filename" value="thing.ply"/>{bsdf}</shape>'
    return Case(
        *(name, provokes, start("thing.vertices", "{folder}/start.ply", lr=rate), within),
        shapes=mesh,
        warns=warns,
        sure=sure,
        settings=("optimizer.schedule=cosine",),
        meshes={"thing.ply": truth, "start.ply": (np.asarray(begins), faces)},
        estimator=SHAPES,
    )


def _ball(**moved) -> np.ndarray:
    """The ball's vertices: ``times`` their size, ``along`` a way, ``rough`` by so much."""
    vertices = BALL_OF_TRIANGLES[0] * moved.get("times", 1.0) + moved.get("along", 0.0)
    return vertices + moved.get("rough", 0.0) * np.random.default_rng(1).normal(size=vertices.shape)


def _spike(reach: float) -> np.ndarray:
    """The ball, its cap pulled out to ``reach`` along z."""
    vertices = BALL_OF_TRIANGLES[0].copy()
    vertices[vertices[:, 2] > 0.79, 2] = reach
    return vertices


def _slivers() -> tuple[np.ndarray, np.ndarray]:
    vertices, faces = BALL_OF_TRIANGLES
    stretched = vertices * [1, 1, 8]
    return 0.8 * stretched / np.linalg.norm(stretched, axis=1, keepdims=True), faces


def _box(low: list[float], high: list[float]) -> tuple[np.ndarray, np.ndarray]:
    box = trimesh.creation.box(bounds=[low, high]).subdivide().subdivide()
    return np.array(box.vertices), np.array(box.faces)


def _grown(box: tuple[np.ndarray, np.ndarray], times: float) -> np.ndarray:
    middle = box[0].mean(axis=0)
    return middle + times * (box[0] - middle)


END_ON, THIN = _box([0, 0, -0.4], [0.8, 0.8, 0.4]), _box([-0.01, -0.4, -0.4], [0.01, 0.4, 0.4])


CASES = [
    # One view tells nothing of their depth: what counts is that they stay sound.
    _shape(
        *("a ball", "nothing: what the shapes are measured against", 0.25),
        *(BALL_OF_TRIANGLES, _ball(times=0.6)),
    ),
    _shape(
        *("slivers", "triangles a hundred times as long as wide", 0.3),
        *(_slivers(), 0.6 * _slivers()[0]),
        warns="a smaller rate",
        sure=False,
    ),
    _shape(
        *("folded", "faces that lie on each other at the start", 0.3),
        *(BALL_OF_TRIANGLES, _ball(rough=0.06)),
        warns="folded",
    ),
    _shape(
        *("out of view", "half of the mesh begins outside of the image", 0.4),
        *(BALL_OF_TRIANGLES, _ball(along=np.array([1.1, 0, 0]))),
    ),
    _shape(
        *("before the lens", "a spike that ends close to the camera", 0.5),
        *(BALL_OF_TRIANGLES, _spike(3.5)),
        warns="a smaller rate",
        sure=False,
    ),
    _shape(
        *("turned inside out", "a start that is the truth mirrored in its middle", 0.15),
        *(BALL_OF_TRIANGLES, _ball(times=-0.9)),
        warns="inside out",
    ),
    _shape(
        *("edge end on", "an edge that the camera sees as a point", 0.1),
        *(END_ON, _grown(END_ON, 0.8)),
        warns="a smaller rate",
        sure=False,
    ),
    _shape(
        *("two in a pixel", "both silhouettes of a plate within one pixel", 0.3),
        *(THIN, THIN[0] + [0.3, 0, 0]),
        warns="folded|lies beside the mesh",
    ),
    _shape(
        *("a shape's rate of 100", "steps a hundred times the size of the shape", 1e3),
        *(BALL_OF_TRIANGLES, _ball(times=0.6)),
        warns="folded|image_rmse did not fall",
        rate=100.0,
    ),
]
