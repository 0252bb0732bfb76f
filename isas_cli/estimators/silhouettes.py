"""Gradients by shapes: paths of drawn pixels, and samples of silhouettes and of shadows' edges."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import ClassVar

import drjit as dr
import mitsuba as mi
import numpy as np

from ..rendering import rays
from ..rendering.border import Border
from ..rendering.contours import Contours
from ..rendering.light import shapes_with
from ..rendering.picture_edges import PictureEdges
from ..rendering.projective import Attached, check_lamps, sharp
from ..rendering.reflections import Reflections
from ..rendering.shadows import MOST_LAMPS, Shadows
from ..rendering.silhouettes import Silhouettes
from ..rendering.standing import meshes_of, others, surfaces, triangles
from ..runtime.errors import InputError
from ..scene.crossings import through
from ..scene.problem import Problem
from ..scene.topology import Topology
from ..unknowns import parameters
from .estimator import Estimator, Gradients, at_least_one
from .two_path import TwoPath

_CONTOUR = "edge", "edge_residual"
_EDGE = "edge", "edge_step", "edge_residual"
_REFLECTED = "reflected_edge", "reflected"
_BY_OUTLINE = Contours, PictureEdges
_ALIKE = 0.99  # cosine between normals of one place that is no hard edge
_SHADOW = "lamp", "shadow_edge", "shadow_residual"


@dataclass(frozen=True)
class Settings(Estimator):
    """``ByShape``. ``shadows``: none under a sky alone, whose shadows are soft: there they bring
    more noise than they tell, and none of very many lamps (where what stands still can shade what
    moves, as many again for its shadows); ``reflections``: as many again of meshes that stand
    still; ``outline``: by alpha or masks (``Contours``), by edges in the pictures
    (``PictureEdges``)."""

    name: ClassVar[str] = "silhouettes"
    # A shape's steps are spread over its mesh: no entry has moments of its own.
    gives: ClassVar[frozenset[str]] = frozenset(("forward", "backward"))
    plannable: ClassVar[bool] = False
    outlines: ClassVar[bool] = True

    batch: int = 16384
    edges: int = 4096
    adaptive: bool = True
    shadows: int | None = None
    reflections: int = 0
    lamps: int = 16
    paths: int = 4
    outline: float = 1.0
    freeze: bool = True

    def __post_init__(self) -> None:
        super().__post_init__()
        at_least_one(self, "edges", "paths", "lamps")
        if not 0 <= self.outline < math.inf:
            raise InputError(f"estimator.outline={self.outline}: a finite weight, at least 0")
        if self.shadows is not None and self.shadows < 0:
            raise InputError(f"estimator.shadows must be 0 or more, not {self.shadows}")
        if self.reflections < 0:
            raise InputError(f"estimator.reflections must be 0 or more, not {self.reflections}")

    def differentiated(self, problem: Problem) -> Problem:
        if "media" in problem.integrator.simulates:
            raise InputError(
                "estimator=silhouettes: what moves is followed by Mitsuba's projective integrators,"
                f" which simulate no media, and the scene's is {problem.integrator.name}"
            )
        check_lamps(problem, "estimator=silhouettes")
        return replace(problem, integrator=Attached(problem.integrator))

    def made(self, problem: Problem, loss) -> "ByShape":
        lamps = {shape.id() for shape in problem.scene.shapes() if shape.is_emitter()}
        told = []
        if moving := sorted(lamps & problem.unknowns.moved):
            told.append(
                f"estimator=silhouettes follows {', '.join(moving)}, which shines, by its own "
                "outline: what its light does on others as it moves has no derivative; "
                "sampler=plateau follows both"
            )
        if mirrors := sharp(problem):
            told.append(
                f"estimator=silhouettes: what {', '.join(mirrors)} mirrors, lets through or leaves "
                "out has no right derivative as it moves: give it a roughness, or take "
                "sampler=plateau"
            )
        told += _sunk(problem)
        if self.shadows is None and (count := len(problem.scene.emitters())) > MOST_LAMPS:
            told.append(
                f"estimator=silhouettes leaves out the edges of the shadows of {count} lamps: it "
                f"finds those of {MOST_LAMPS} at most"
            )
        if self.outline != Settings.outline and problem.part is problem.edges is None:
            told.append(
                f"estimator.outline={self.outline:g} has no effect: no alpha, mask or edge of a "
                "picture counts"
            )
        problem.warnings += [each for each in told if each not in problem.warnings]
        return ByShape(problem, loss, self)

    def shadowed(self, problem: Problem) -> int:
        """Samples of the edges of shadows a step."""
        if problem.integrator.max_depth < 2:
            return 0
        if self.shadows is not None:
            return self.shadows
        skies = 0 if problem.scene.environment() is None else 1
        return self.edges if skies < len(problem.scene.emitters()) <= MOST_LAMPS else 0

    def reflected(self, problem: Problem) -> int:
        """Samples a step of silhouettes that other surfaces show."""
        if self.reflections and problem.integrator.max_depth < 3:
            raise InputError(
                "estimator.reflections: paths by way of one surface have 3 edges, and here they "
                f"have at most {problem.integrator.max_depth}: take scene.max_depth=3 or more"
            )
        return self.reflections

    def derivatives(self, problem: Problem) -> str:
        count = self.shadowed(problem)
        told = f"{Attached.derivatives}, and {count or 'none'} a step of the edges of shadows"
        if self.reflected(problem):
            told += f", {self.reflections} of silhouettes that other surfaces show"
            if meshes_of(problem, mi.traverse(problem.scene)):
                told += " and as many of what stands still"
        if mirrors := shapes_with(problem.scene, "Delta"):
            told += f"; silhouettes that are seen by way of {', '.join(mirrors)} are left out"
        for found, what in ((problem.part, "alpha or masks"), (problem.edges, "edges in pictures")):
            if self.outline and found is not None:
                told += f"; outlines by {what}, of weight {self.outline:g}"
        return told


class ByShape(Gradients):
    """dℒ/dθ for unknowns that move meshes, beside others: the part at fixed visibility from
    ``batch`` drawn pixels (``TwoPath`` with paths that follow the surfaces, ``Attached``), the part
    of moving silhouettes from ``edges`` samples (``Silhouettes``) and that of the edges of shadows
    from ``shadows`` (``Shadows``), shared out over the meshes that move; as many more are drawn of
    the shadows that all other meshes together throw on these. No film is filled: a step costs what
    its samples cost, whatever the films' sizes.

    What shadows are followed: of moving meshes, on themselves, on each other and on what stands
    still; of what stands still (``standing.others``), on moving ones. In direct light, seen
    directly; the rest is the bias of ``Shadows``. Of silhouettes that other surfaces show, those by
    way of one, from ``reflections`` samples (``Reflections``), and as many again of meshes that
    stand still, as what moves shows them. Bias: that of all parts. Traced once and frozen, but for
    ``params.update()``.

    Where alpha or masks are known, their coverage term is added (``Contours``), and where edges in
    pictures count, theirs (``PictureEdges``). As long as nothing moves but shapes and poses, at the
    beginning of a budget, they follow these alone: what colours and lights would make of images is
    not known yet, and a step costs no light path.
    """

    def __init__(self, problem: Problem, loss, chosen: Settings):
        """``problem.integrator``: an ``Attached``. Raises InputError for what moves and is no mesh
        of smooth normals."""
        self.problem, self.freeze = problem, chosen.freeze
        self.inside = TwoPath(problem, loss, chosen.batch, chosen.freeze)
        meshes = _meshes(problem)
        # Where nothing moves there is no border to follow.
        shadows = chosen.shadowed(problem) if meshes else 0
        # By the key of its mesh's positions; those of what stands still are ``_still``.
        self.borders: list[tuple[str, tuple, Border]] = []
        self.undrawn, self.alone = 0.0, False

        def throws(key: str, topologies: dict[int, Topology], samples: int) -> None:
            each = max(1, samples), chosen.paths, chosen.lamps, chosen.freeze
            self.borders.append((key, _SHADOW, Shadows(problem, loss, topologies, *each)))

        reflections = chosen.reflected(problem) if meshes else 0
        for key, topologies in meshes.items():
            where = problem, loss, key.rpartition(".")[0], topologies
            edges = max(1, chosen.edges // len(meshes)), chosen.paths, chosen.adaptive
            self.borders.append((key, _EDGE, Silhouettes(*where, *edges, chosen.freeze)))
            given = problem, topologies, chosen.outline
            if chosen.outline and problem.part is not None:
                self.borders.append((key, _CONTOUR, Contours(*given, *edges, chosen.freeze)))
            if chosen.outline and problem.edges is not None:
                followed = PictureEdges(*given, edges[0], chosen.freeze)
                self.borders.append((key, _CONTOUR[:1], followed))
            if shadows:
                throws(key, topologies, shadows // len(meshes))
            if reflections:
                each = max(1, reflections // len(meshes)), chosen.paths, not shadows, chosen.freeze
                self.borders.append((key, _REFLECTED, Reflections(*where, *each)))
        if any(isinstance(each, _BY_OUTLINE) for _, _, each in self.borders):
            told = any(isinstance(each, Contours) for _, _, each in self.borders)
            self.undrawn = _geometry_alone(problem, told)
        self._still: dict[str, mi.Float] = {}
        if shadows and (found := others(problem)):
            self._still[""], topology = found
            throws("", {len(topology.place): topology}, shadows)
        params = mi.traverse(problem.scene)
        still = meshes_of(problem, params) if reflections else []
        for key in still:
            self._still[key] = parameters.own(mi.Float, np.array(params[key]))
            topology = Topology.of(*triangles(params, key))
            where = problem, loss, key.rpartition(".")[0], {len(topology.place): topology}
            each = max(1, reflections // len(still)), chosen.paths, not shadows, chosen.freeze
            self.borders.append((key, _REFLECTED, Reflections(*where, *each)))

    @property
    def stages(self) -> tuple[float, ...]:
        """Shares of the budget at which kernels differ, for a rehearsal."""
        return tuple(sorted({0.0, self.undrawn, *self.inside.stages}))

    @property
    def paths_per_step(self) -> int:
        """Light paths of the latest estimate; rays that only ask for coverage count as paths."""
        of = _BY_OUTLINE if self.alone else object
        borders = sum(each.paths_per_step for _, _, each in self.borders if isinstance(each, of))
        return borders + (0 if self.alone else self.inside.paths_per_step)

    @property
    def memory(self) -> list[mi.Float]:
        """What ``adaptive`` met so far: the state of one run, put back before its next step."""
        return [each for met in self._met() for each in met]

    @memory.setter
    def memory(self, arrays: list[mi.Float]) -> None:
        # Copies, as a frozen kernel changes what it is given.
        rest = iter(arrays)
        for met in self._met():
            met[:] = [mi.Float(next(rest)) for _ in met]

    def _met(self) -> list[list[mi.Float]]:
        return [b.met for _, _, b in self.borders if isinstance(b, (Silhouettes, Contours))]

    @property
    def nonfinite(self) -> int:
        """Paths so far whose residual was not finite."""
        return self.inside.nonfinite

    def estimate(self, values: dict, distribution, seed: int, iteration: int, spent: float) -> dict:
        """The gradient at ``values``, by key; up to the share ``undrawn`` of the budget, that of
        outlines alone."""
        unknowns, self.alone = self.problem.unknowns, spent < self.undrawn
        if self.alone:
            unknowns.attach(values)
            total = {key: dr.zeros(type(value), value.shape) for key, value in values.items()}
        else:
            total = self.inside.gradients(values, distribution, seed, iteration, spent)
        unknowns.taken()  # what follows begins anew
        for number, (key, purposes, border) in enumerate(self.borders):
            if self.alone and not isinstance(border, _BY_OUTLINE):
                continue
            if isinstance(border, PictureEdges):
                border.narrow(spent / self.undrawn if self.undrawn else 1.0)
            place = iteration * len(self.borders) + number
            seeds = rays.seeds(seed, place, *purposes)
            if not self.freeze:  # the backward pass has cleared the way to the leaves
                unknowns.attach(values)
            positions = self._still.get(key)
            border.accumulate(unknowns.params[key] if positions is None else positions, seeds)
            for name, gradient in unknowns.taken().items():
                if not unknowns[name].kind.aside:
                    total[name] += gradient
        return total


def _geometry_alone(problem: Problem, cameras: bool) -> float:
    """The share of the budget up to which nothing moves but shapes and poses, and, where outlines
    tell them, ``cameras``."""
    others = [u for u in problem.unknowns if not u.kind.moves_geometry]
    others = [u for u in others if not (cameras and u.kind.outlined)]
    return min((share for u in others for share in u.during[:1]), default=0.0)


def _sunk(problem: Problem) -> list[str]:
    """What is to be said of meshes that move and pass through others: the line where they meet is
    an edge of neither."""
    every, told = surfaces(problem, mi.traverse(problem.scene)), []
    for id in sorted(problem.unknowns.moved & every.keys()):
        own = every.pop(id)  # of two that move, once
        if met := [other for other, corners in every.items() if through(own, corners)]:
            told.append(
                f"estimator=silhouettes: '{id}' passes through {', '.join(met)}: the line where "
                "they meet moves with it and is not followed, so that gradients are biased; "
                "sampler=plateau follows it"
            )
    return told


def _check_sides(
    problem: Problem,
    params: mi.SceneParameters,
    key: str,
    topologies: dict[int, Topology],
    own: bool,
) -> None:
    """Raise InputError for a mesh that has an inside and whose silhouettes would be shaded as from
    there: Mitsuba turns normals to the side that winding and normals call the outer one. ``own``:
    its normals follow from its triangles."""
    id = key.rpartition(".")[0]
    points, faces = triangles(params, key)
    topology = topologies.get(len(points)) or Topology.of(points, faces)
    corners = points[faces].astype(np.float64)
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    side = topology.outward(points[topology.first])
    (shape,) = (each for each in problem.scene.shapes() if each.id() == id)
    normals = np.repeat(across[:, None], 3, axis=1)
    if not own:
        normals = np.array(params[f"{id}.vertex_normals"]).reshape(-1, 3)[faces]
    along = np.einsum("fk,fvk->f", across, normals).sum() * side
    if shape.has_flipped_normals():
        along = -along
    seen = mi.has_flag(shape.bsdf().flags(), mi.BSDFFlags.BackSide)
    if along < 0 and seen:
        raise InputError(
            f"'{id}' moves, and its normals point inwards: estimator=silhouettes would shade its "
            "silhouettes as seen from within; turn its faces and normals round in its file "
            "(flip_normals where only they are wrong), or take sampler=plateau"
        )
    if side < 0 and not own and _hard(normals, topology.faces):
        raise InputError(
            f"'{id}' moves, has hard edges, and its triangles turn the other way than its normals, "
            "as where to_world mirrors: estimator=silhouettes would shade its silhouettes by the "
            "hidden face; apply the mirroring in its file, or take sampler=plateau"
        )


def _hard(normals: np.ndarray, place: np.ndarray) -> bool:
    """Whether ``normals (F, 3, 3)`` at one ``place (F, 3)`` are not all alike."""
    flat, place = normals.reshape(-1, 3), place.ravel()
    first = np.zeros((place.max() + 1, 3))
    first[place] = flat
    return bool((np.einsum("nk,nk->n", flat, first[place]) < _ALIKE).any())


def _meshes(problem: Problem) -> dict[str, dict[int, Topology]]:
    """Of what moves, the key of its vertices' positions, and how its triangles hang together, by
    the number of vertices."""
    params, found, shaped = mi.traverse(problem.scene), {}, set()
    listed = {shape.id() for shape in problem.scene.shapes()}
    for name in problem.unknowns.moving:
        own = problem.unknowns[name].kind.topologies
        found |= own
        shaped |= own.keys()
        for key in problem.unknowns.written(name):
            id, _, word = key.rpartition(".")
            if word == "vertex_positions" and id not in listed:
                raise InputError(
                    f"scene.unknowns['{name}'] moves '{id}', which lies in a group: "
                    "estimator=silhouettes follows what the scene itself holds; take it out of the "
                    "group, or take sampler=plateau"
                )
        for key in problem.unknowns.written(name) if not own else ():
            id, _, word = key.rpartition(".")
            where = f"scene.unknowns['{name}'] moves '{id}'"
            if word.endswith("normals"):
                continue
            if not word.endswith("positions"):
                raise InputError(
                    f"{where}, which is no mesh: estimator=silhouettes follows meshes; take "
                    "sampler=plateau"
                )
            if not dr.width(params[f"{id}.{word.replace('positions', 'normals')}"]):
                raise InputError(
                    f"{where}, which has face normals: its shading steps from facet to facet, "
                    "which is not differentiated; give it smooth normals, or take sampler=plateau"
                )
            topology = Topology.of(*triangles(params, key))
            found.setdefault(key, {len(topology.place): topology})
            told = [f"mesh {id}: {flaw}" for flaw in topology.flaws()]
            problem.warnings += [each for each in told if each not in problem.warnings]
    for key in found:
        _check_sides(problem, params, key, found[key], key in shaped)
    return found
