"""Meshes that become finer on the way: where the coarser ones come from, and what a run does."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
import trimesh
from isas_cli.scenes import kirby
from isas_cli.scenes.icosphere import icosphere
from scipy.spatial import cKDTree
from shapes_for_tests import KEY, agrees, egg, estimates, problem

from isas_cli import losses
from isas_cli.config import schema
from isas_cli.config.compose import compose
from isas_cli.config.schema import OptimizerConfig
from isas_cli.engine.evaluate import Evaluator
from isas_cli.engine.loop import Hooks, Loop
from isas_cli.engine.optimiser import Stepper
from isas_cli.estimators.silhouettes import Settings
from isas_cli.rendering.pixels import PixelDistribution, Tiles
from isas_cli.rendering.renderer import Renderer
from isas_cli.runtime.budget import Budget
from isas_cli.runtime.errors import InputError
from isas_cli.samplers.balanced import Balanced
from isas_cli.samplers.joint import Joint
from isas_cli.samplers.ours import Ours
from isas_cli.samplers.uniform import Uniform
from isas_cli.scene import export
from isas_cli.scene.subdivision import coarser


def shuffled(level: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """A sphere whose vertices, and triangles with their corners, come in any order."""
    vertices, faces = icosphere(level)
    order = rng.permutation(len(vertices))
    faces = rng.permutation(np.argsort(order)[faces])
    turns = rng.integers(0, 3, len(faces))
    return vertices[order], np.stack([np.roll(f, k) for f, k in zip(faces, turns)])


def test_a_mesh_that_was_split_is_put_together_again(rng):
    vertices, faces = shuffled(3, rng)
    for level in (2, 1, 0):
        found = coarser(faces, len(vertices))
        before = vertices[found.kept]
        assert len(before) == 10 * 4**level + 2 and len(found.faces) == 20 * 4**level
        middles = before[found.parents].mean(axis=1)
        middles /= np.linalg.norm(middles, axis=1, keepdims=True)
        np.testing.assert_allclose(middles, vertices, atol=1e-6)
        mesh = trimesh.Trimesh(before, found.faces, process=False)
        assert mesh.is_watertight and mesh.volume > 0
        vertices, faces = before, found.faces
    assert coarser(faces, len(vertices)) is None


def test_two_pieces_that_were_split_are_put_together_again(rng):
    (small, some), (large, more) = shuffled(1, rng), shuffled(2, rng)
    vertices = np.concatenate([small, 3 + large])
    found = coarser(np.concatenate([some, more + len(small)]), len(vertices))
    assert len(found.kept) == 12 + 42 and len(found.faces) == 20 + 80
    middles = vertices[found.kept][found.parents].mean(axis=1)
    assert np.abs(middles - vertices).max() < 0.15


def test_others_are_not():
    vertices, faces = icosphere(2)
    count = len(vertices)
    assert coarser(faces[1:], count) is None, "open"
    assert coarser(np.concatenate([faces[:1, ::-1], faces[1:]]), count) is None, "turned around"
    side = np.arange(8)
    a, b = (each.ravel() for each in np.meshgrid(side, side))
    right, up = (a + 1) % 8 + 8 * b, a + 8 * ((b + 1) % 8)
    both, here = (a + 1) % 8 + 8 * ((b + 1) % 8), a + 8 * b
    torus = np.concatenate([np.stack([here, right, both], 1), np.stack([here, both, up], 1)])
    assert (np.bincount(torus.ravel()) == 6).all()
    assert coarser(torus, 64) is None, "regular throughout"
    a, b, c = faces[0]
    three = [[a, b, count], [b, c, count], [c, a, count]]
    assert coarser(np.concatenate([three, faces[1:]]), count + 1) is None, "split in one place"


def rays(count: int = 4096) -> mi.Ray3f:
    random = np.random.default_rng(2)
    to, at = random.uniform(-0.8, 0.8, (3, count)), random.normal(size=(3, count))
    origin = mi.Point3f(3 * at / np.linalg.norm(at, axis=0))
    return mi.Ray3f(origin, dr.normalize(mi.Point3f(to) - origin))


def test_the_scene_has_the_mesh_of_the_level():
    p = problem(views=1, side=8, levels=3)
    kind, sizes, seen = p.unknowns[KEY].kind, [], []
    (by_count,) = kind.topologies.values()
    assert kind.doublings == 3 and [*by_count] == [642, 162, 42]
    for level in (2, 0, 1, 2):
        coarse = p.unknowns.starts(p.unknowns.shapes(level))
        for values in (coarse, p.unknowns.values_of(p.unknowns.arrays(coarse))):
            p.unknowns.write(values)
            params = mi.traverse(p.scene)
            sizes.append([dr.width(params[f"figure.{x}"]) for x in ("vertex_positions", "faces")])
            found = p.scene.ray_intersect(rays())
            seen.append(np.array(dr.select(found.is_valid(), found.t, 0)))
        # The same surface by more triangles, but for rays along an edge.
        assert np.mean(np.abs(seen[-1] - seen[-2]) < 1e-4) > 0.999
    assert sizes[::2] == [
        [3 * v, 3 * f] for v, f in ((642, 1280), (42, 80), (162, 320), (642, 1280))
    ]
    assert (seen[0] > 0).mean() > 0.3
    np.testing.assert_array_equal(seen[0], seen[-1])
    assert np.abs(seen[2] - seen[0]).max() > 0.05, "a coarse sphere is another surface"


def test_gradients_by_a_coarse_mesh_are_those_of_a_scene_that_has_it():
    p, own = problem(levels=2), problem(level=2)
    own.set_targets(mi.Float(p.targets), None, "those of the finer truth")
    kind = p.unknowns[KEY].kind
    x = kind.coarse(egg(p), kind.shape(1))
    assert x.shape == own.unknowns[KEY].truth.shape
    _, place = cKDTree(x).query(egg(own))
    found = estimates(p, 24, batch=1 << 15, at=x)
    expected = estimates(own, 24, batch=1 << 15, at=x[place])
    assert all([agrees(found[name], expected[name], 0.01) for name in expected])
    # The same images, by a kernel that has seen the whole mesh.
    renderer, images = Renderer(p), []
    for each, at in ((p, egg(p)), (p, x), (own, x[place])):
        each.unknowns.write(each.unknowns.values_of({KEY: at.astype(np.float32)}))
        by = renderer if each is p else Renderer(own)
        images.append(by.range(0, p.views.total, 16, lambda i: i))
    assert np.abs(images[1] - images[2]).mean() < 1e-4 < np.abs(images[1] - images[0]).mean()


def test_two_that_take_turns_are_each_at_their_own_level():
    p = problem(views=2, side=16, levels=2)
    chosen, loss = Settings(batch=1024, edges=512, adaptive=False), losses.L2()
    estimator, evaluator = chosen.on(p, loss), Evaluator(p, loss, 512, 2, 1)
    drawn = Uniform().on(p, loss, 1024).distribution(None)
    sides = [p.unknowns.starts(p.unknowns.shapes(level)) for level in (0, 1, 0, 1)]
    told = []
    for values in sides:
        gradient = estimator.estimate(values, drawn, 1, 0, 0.0)[KEY]
        told.append((np.array(gradient), evaluator(values)["image_rmse"]))
    p.unknowns.write(p.unknowns.starts())
    for (first, error), (again, same) in zip(told[:2], told[2:]):
        np.testing.assert_allclose(again, first, atol=1e-5 * np.abs(first).max())
        assert error == pytest.approx(same, rel=1e-5)
    assert [len(gradient) for gradient, _ in told] == [162, 642, 162, 642]


def steps(p, freeze: bool) -> list[np.ndarray]:
    chosen = Settings(batch=2048, edges=1024, shadows=512, freeze=freeze)
    estimator = chosen.on(p, losses.L2())
    uniform = PixelDistribution.uniform(Tiles.over(p.views))
    stepper, found = Stepper(p.unknowns, OptimizerConfig(lr=0.02)), []
    for iteration in range(9):
        if iteration % 3 == 0 and iteration:
            before = p.unknowns.arrays(stepper.values)
            stepper.refine(iteration // 3)
            np.testing.assert_allclose(
                p.unknowns.arrays(stepper.values)[KEY], before[KEY], atol=1e-6
            )
        gradients = estimator.estimate(stepper.values, uniform, 1, iteration, 0.0)
        stepper.step(gradients, 0.0)
        found.append(p.unknowns.arrays(stepper.values)[KEY])
    p.unknowns.write(stepper.values)
    return found


def test_frozen_kernels_follow_the_levels():
    lamp = {
        "lamp": {"type": "point", "position": [2, 3, 2], "intensity": {"type": "rgb", "value": 9}}
    }
    found = [np.stack(steps(problem(levels=3, **lamp), freeze)) for freeze in (True, False)]
    assert (np.abs(np.diff(found[1], axis=0)).max(axis=(1, 2)) > 1e-3).all()
    np.testing.assert_allclose(*found, atol=1e-3)


@pytest.mark.parametrize("kind", [Ours, Joint, Balanced])
def test_samplers_look_at_each_level_as_it_is(kind):
    p, loss, found = problem(levels=3), losses.L2(), []
    on = Settings().differentiated(p)
    for freeze in (True, False):
        sampler = kind().on(on, loss, 2048, freeze)
        for level in (0, 1, 2, 0):
            values = p.unknowns.starts(p.unknowns.shapes(level))
            found.append(np.array(sampler.look(values, 1, 0)))
    p.unknowns.write(p.unknowns.starts())
    scale = max(each.max() for each in found)
    np.testing.assert_allclose(found[:4], found[4:], atol=1e-3 * scale)
    assert np.abs(found[1] - found[0]).max() > 0.01 * scale


def test_a_run_passes_through_its_levels_and_ends_nearer():
    p, loss = problem(views=4, levels=2), losses.L2()
    chosen = Settings(batch=2048, edges=1024)
    estimator, sampler = chosen.on(p, loss), Uniform().on(p, loss, 2048)
    stepper = Stepper(p.unknowns, OptimizerConfig(lr=0.03))
    evaluator = Evaluator(p, loss, 1000, 4, 1)
    loop = Loop(p, sampler, stepper, evaluator, Budget(iterations=150), estimator, 1, 3)
    loop.rehearse()
    rows, counts = [], []
    hooks = Hooks(
        evaluated=rows.append,
        stepped=lambda l, spent: counts.append(l.stepper.values[KEY].shape[0]),
    )
    assert loop.run(hooks) == "done"
    p.unknowns.write(stepper.values)
    assert counts == [162] * 50 + [642] * 100
    assert rows[-1]["parameter_rmse"] < 0.7 * rows[0]["parameter_rmse"]


def test_a_mesh_without_a_coarser_one_is_refused():
    with pytest.raises(InputError, match="has at most 4 levels, the coarsest of .12, 3."):
        problem(views=1, side=8, levels=5)
    with pytest.raises(InputError, match="has one level: a mesh has a coarser one where"):
        problem(views=1, side=8, levels=2, seams=True)
    for attribute, size in (("vertex_colour", 3), ("face_number", 1)):
        shape = kirby.build(1, 8, 2)["figure"]
        count = shape.vertex_count() if attribute.startswith("vertex") else shape.face_count()
        shape.add_attribute(attribute, size, [0.5] * size * count)
        with pytest.raises(InputError, match="has one level: a mesh has a coarser one where"):
            problem(views=1, side=8, levels=2, figure=shape)


def test_a_run_that_was_stopped_early_is_exported_whole(tmp_path):
    scene = schema.typed(compose(["scene=kirby", "size=tiny", "scene.sizes.tiny.levels=2"])).scene
    whole = problem(views=1, side=8, level=2, levels=2).unknowns
    coarse = {k: np.array(v) for k, v in whole.starts(whole.shapes(0)).items()}
    assert coarse[KEY].shape == (42, 3)
    path, _ = export.write(scene, coarse, tmp_path)
    assert len(trimesh.load(path.parent / "figure.ply", process=False).vertices) == 162
