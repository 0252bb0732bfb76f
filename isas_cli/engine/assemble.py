"""From a configured scene to a ``Problem``."""

from __future__ import annotations

import gc
import hashlib
import re
from collections.abc import Callable
from dataclasses import replace

import drjit as dr
import mitsuba as mi
import numpy as np

from ..config.schema import OptimizerConfig, SceneConfig, TargetConfig
from ..rendering import (
    black_box,
    coverage,
    integrators,
    light,
    picture_edges,
    targets,
    trial,
)
from ..rendering.black_box import Places
from ..runtime import backend
from ..runtime.errors import InputError
from ..scene import (
    built,
    flat,
    lenses,
    mesh_checks,
    outside,
    scene_file,
    sensor_checks,
    stand_ins,
    weights,
)
from ..scene.outside import Outside
from ..scene.photos import building, importing, noise, photographs
from ..scene.problem import Problem
from ..scene.views import Views
from ..unknowns import verdicts
from ..unknowns.optics import Lens
from ..unknowns.parameters import own, owner, read
from ..unknowns.ranges import only_emits
from ..unknowns.specs import check_stages, narrow_blurs, parse
from ..unknowns.unknowns import Unknown, Unknowns

# Of unknowns: the role of what is multiplied, how a factor's key ends, and how then the other's
# goes on: scales of lights, the slide of a spot, the weight of a material within others.
_FACTORS = (
    ("light", r"\.scale$", "."),
    ("light", r"\.intensity\.value$", ".texture."),
    ("colour", r"\.weight\.(value|data)$", ".bsdf_"),
)
# Of targets: what is too dark to have a colour, as a share of the mean; the difference of channels,
# as a share of their mean, that is one; and the share of the others that has.
_DARK, _COLOURED, _MANY = 0.2, 0.3, 0.05
# Of densities: by which those that are alike differ, and the share of a start that is many.
_ALIKE, _DENSE = 1e-6, 0.05


def bare(
    scene: SceneConfig, parsed: Callable[..., list[Unknown]] = parse
) -> tuple[Problem, photographs.Photographs | None, list[tuple[int, int]]]:
    """A problem with neither targets nor coverage; its photographs, where it has any; the sizes of
    all films, those of views held out too. ``parsed``: its unknowns, as ``specs.parse``."""
    # Earlier scenes that nobody uses: collected in the middle of a frozen kernel, they break it.
    gc.collect()
    taken = None if scene.photos.path is None else photographs.load(scene.photos)
    other = Outside(scene.external, scene.unknowns) if scene.outside else None
    loaded, integrator, description = _loaded(scene, taken, other)
    sensors = loaded.sensors()
    if not sensors:
        raise InputError(f"{where_of(scene)} has no sensor: add at least one camera")
    if not loaded.emitters():
        why = "without light all images are black"
        if only_emits(integrator):
            why = 'emission needs a sky: add <emitter type="constant">, of radiance 0 for none'
        raise InputError(f"{where_of(scene)} has no emitter: {why}")
    every = [tuple(int(x) for x in s.film().crop_size()) for s in sensors]
    sizes = every if taken is None else every[: len(taken.shown)]
    pixels = sum(width * height for width, height in sizes)
    if 3 * pixels >= 2**32 - 1:
        raise InputError(
            f"{pixels} pixels in all views together: their colours are indexed in 32 bits, so that "
            f"there may be {2**32 // 3} at most"
        )
    params = mi.traverse(loaded)
    content = _content_hash(loaded, integrator, params, description)
    views, of_views, wanted, poses = Views.of(sizes), None, scene.unknowns, scene.poses
    if taken is not None:
        poses = building.poses(taken, scene.poses)
        wanted = building.unknowns(taken, scene.unknowns, poses)
        of_views = building.of_views(taken, views, scene.unknowns)
    if other is not None:
        of_views = {"outside": other}
    truth_known = taken is None and scene.targets is None
    found = parsed(params, wanted, truth_known, poses, of_views)
    _pace(found)
    if taken is not None:
        for each in found:
            each.asked = each.key in scene.unknowns
        building.rates(found)
        building.stage(taken, wanted, found)
        check_stages(found)
    if taken is not None and len(taken.parts) > 1:
        for each in (each for each in found if each.kind.deforms):
            raise InputError(
                f"scene.unknowns: '{each.key}': {scene.photos.mesh} has several materials, a shape "
                f"each ({', '.join(taken.parts)}), which would part at their seams: "
                f"photos.materials=one makes one shape '{building.OBJECT}' of them"
            )
    written = {key for each in found for key in each.kind.writes}
    single = flat.reduce(mi.traverse(loaded), written)
    held = sorted(written & set(params.keys()))
    if other is not None:
        adapted = black_box.BlackBox(other)
    else:
        adapted = integrators.adapt(integrator, where_of(scene), loaded, held)
    lights_stay = not any(isinstance(owner(params, key), mi.Emitter) for key in written)
    light.prepare(loaded, adapted.cuts and adapted.samples_lights and lights_stay)
    together = [] if taken is None else building.together(taken, found)
    unknowns = Unknowns(mi.traverse(loaded), found, together)
    result = Problem(
        scene.name,
        loaded,
        adapted,
        Places.of(len(sizes)) if other else lenses.of(loaded, range(len(sizes)), written),
        sizes,
        views,
        unknowns,
        content,
        warnings=[
            *(taken.warnings if taken is not None else ()),
            *(other.warnings if other is not None else ()),
            *mesh_checks.check_scene(loaded, unknowns.textures),
            *_other_pictures(loaded, adapted),
            *narrow_blurs(found),
            *(line for each in found for line in (*each.kind.unheeded, *each.kind.warnings())),
            *_doubtful_starts(found),
            *_wrong(params, found),
            *_flat_densities(found, adapted),
            *_lifted(found),
            *_traded(unknowns, truth_known),
            *_products(unknowns),
            *(sensor_checks.doubts(loaded) if scene.path is not None else ()),
            *(building.traded(taken.settings, unknowns.keys) if taken is not None else ()),
        ],
        flat=single,
        freezes=other is None,
    )
    return result, taken, every


def _loaded(
    scene: SceneConfig, taken: photographs.Photographs | None, other: Outside | None
) -> tuple[mi.Scene, mi.Integrator, str]:
    """The scene, its integrator, and what tells it from others beside its parameters."""
    with backend.loading():
        if other is not None:
            loaded, description = built.load(outside.description(other)), other.description()
        elif scene.path is not None:
            return scene_file.load(scene.path, scene.max_depth)
        else:
            described = built.description(scene, taken)
            where = f"scene.builder={scene.builder}" if taken is None else where_of(scene)
            with scene_file.said(where):
                loaded = built.load(described)
            description = f"{scene.photos.up} {scene.photos.turn:g}"
            if taken is None:
                arguments = dict(scene.arguments)
                description = f"{scene.builder} {arguments} {built.told(described)}"
        return loaded, loaded.integrator(), description


def problem(
    scene: SceneConfig,
    target: TargetConfig,
    rendered: Callable[[int, int], None],
    phase: Callable[[str], None] = lambda name: None,
    check: Callable[[Problem], None] = lambda made: None,
) -> Problem:
    """Load the scene, check its unknowns, find out what is seen, get the targets.

    ``phase(name)`` is told when work of another kind begins ('load', 'targets', 'coverage').
    ``check(problem)`` may refuse what has neither targets nor coverage yet.
    """
    phase("load")
    result, taken, every = bare(scene)
    truth_known = taken is None and scene.targets is None
    check(result)
    if scene.weights is not None:  # masks, which they may depend on, are not read yet
        weights.of_views(scene.weights, [np.ones(1)] * len(result.film_sizes))
    # isas's own scenes hold nothing that cannot be frozen.
    if taken is None and result.freezes and not str(scene.builder).startswith("isas_cli.scenes."):
        trial.look(result, where_of(scene))
    if taken is not None:
        phase("targets")
        _take(taken, result, every)
    elif scene.targets is not None:
        phase("targets")
        result.set_targets(*targets.load(result, scene.targets, scene.masks))
        result.warnings += _greys(result) + _hidden(result)
    phase("coverage")
    # Not the run's own seed: runs are compared over the same entries.
    coverage.fill_in(result, target.seed)
    # Last, because this may take minutes: what can be refused without it has been.
    if truth_known:
        phase("targets")
        pixels, variance, digest = targets.render(result, target, rendered)
        result.set_targets(pixels, None, digest, variance)
    if scene.weights is not None:
        result.weigh(scene.weights)
    if taken is not None:
        _compare(result)
    backend.release()
    return result


def _take(taken: photographs.Photographs, problem: Problem, sizes: list) -> None:
    """Make the photographs the targets of ``problem``, and of its ``held_out`` views, which have
    the other sensors of the scene, of film ``sizes`` in all."""
    count, filled = len(taken.shown), not taken.settings.background
    problem.warnings += taken.capture.notes
    problem.names = tuple(each.camera.name for each in taken.shown)
    pictures, masks = ([getattr(p, n) for p in taken.shown] for n in ("image", "mask"))
    targets.given(problem, pictures, masks, filled)
    if taken.settings.background == importing.BLACK:
        problem.part = own(mi.Float, np.concatenate([p.part.ravel() for p in taken.shown]))
    if taken.settings.edges:
        problem.edges = picture_edges.of(pictures, [each.edged for each in taken.shown])
    problem.photographed = noise.of_all(taken.shown)
    problem.warnings += _untold(taken, problem.unknowns)
    if not taken.held:
        return
    held = replace(
        problem,
        part=None,
        edges=None,
        sensors=lenses.of(problem.scene, range(count, count + len(taken.held))),
        film_sizes=sizes[count:],
        views=replace(Views.of(sizes[count:]), given=building.given(taken.held)),
        names=tuple(each.camera.name for each in taken.held),
        warnings=[],
    )
    if (lens := problem.unknowns.of(Lens)) is not None:
        lens.kind.follow(held.views, building.glass(taken).of_views(count, len(sizes)))
    pictures, masks = ([getattr(p, n) for p in taken.held] for n in ("image", "mask"))
    try:
        targets.given(held, pictures, masks, filled)
    except InputError:
        problem.warnings.append("no view that is held out shows the object: none is foretold")
        return
    problem.warnings += held.warnings
    problem.held_out = held


def _compare(problem: Problem) -> None:
    """Tell the unknowns by how much each view counts, as it is weighed."""
    ends = np.cumsum([width * height for width, height in problem.film_sizes])[:-1]
    weights = np.array(problem.mask)
    if problem.part is not None:  # what is black beside the object tells nothing of exposures
        weights = weights * (np.array(problem.part) > 0)
    counts = np.array([part.sum() for part in np.split(weights, ends)])
    for unknown in problem.unknowns:
        unknown.kind.compare(counts)


def _pace(found: list[Unknown]) -> None:
    """Let shapes without a rate move by a share of their size, whatever the scene's unit is."""
    for each in (each for each in found if each.kind.deforms and each.lr is None):
        if (surface := each.kind.surface(each.kind.present, None)) is not None:
            size = np.linalg.norm(np.ptp(surface.vertices[surface.faces.ravel()], axis=0))
            each.speed = building.GROWTH / OptimizerConfig().lr * float(size)


def _untold(taken: photographs.Photographs, unknowns: Unknowns) -> list[str]:
    """Of shapes and poses that are unknown, what of the photographs does not tell them."""
    moving = [unknown for unknown in unknowns if unknown.kind.moves_geometry]
    if not moving or taken.settings.background == importing.BLACK:
        return []
    shapes = [unknown.key for unknown in moving if unknown.kind.deforms]
    filled, found = not taken.settings.background, []
    hidden = {"masked by its file", "transparent"}
    masked = any(each.lost.get(why) for each in taken.shown for why in hidden)
    if masked and not taken.settings.edges:
        return [
            f"'{moving[0].key}': pixels that masks hide or that are transparent do not count, so "
            "nothing tells its outline there: take photos.background=black, by which alpha or "
            "masks say where the object ends"
        ]
    if shapes and filled:
        found.append(
            f"'{shapes[0]}': with photos.background=false pixels that the start does not fill do "
            "not count, so nothing lets the shape grow: photos.background=true, but only where the "
            "scene shows what stands behind the object (photos.environment), else the shape "
            "follows that"
        )
    painted = [u.key for u in unknowns if u.kind.role == "colour" and u.start.ndim == 3]
    posed = [unknown.key for unknown in moving if not unknown.kind.deforms]
    if posed and painted and len(taken.shown) == 1 and not taken.settings.edges:
        found.append(
            f"'{posed[0]}' and '{painted[0]}' are unknown together, and from any pose some texture "
            "shows a single view: photos.edges=true follows edges in it; or take alpha or masks "
            "and photos.background=black, a texture that is known, or more views"
        )
    elif posed and not filled:
        found.append(
            f"'{posed[0]}': with photos.background=true what stands behind the object counts, and "
            "where the scene does not show it the object runs away to hide it: take "
            "photos.background=black where alpha or masks end the object, else "
            "photos.background=false, unless photos.environment shows it"
        )
    return found


def _hidden(problem: Problem) -> list[str]:
    """Of shapes and poses that are unknown, that masks of targets do not tell where they end."""
    unknowns, shapes = problem.unknowns, {shape.id() for shape in problem.scene.shapes()}
    moving = [
        key
        for key in unknowns.moving
        if any(written.rpartition(".")[0] in shapes for written in unknowns.written(key))
    ]
    if not moving or problem.mask is None or (np.array(problem.mask) > 0).all():
        return []
    return [
        f"'{moving[0]}': pixels that scene.masks hide do not count, so where its outline passes "
        "through such nothing tells it: let those beside it count, in targets black where the "
        "scene shows nothing behind it, or take scene=photos and photos.background=black"
    ]


def _greys(problem: Problem) -> list[str]:
    """Of colours that are one number, where targets have colours."""
    keys = [u.key for u in problem.unknowns if u.kind.role == "colour" and u.start.size == 1]
    if not keys:
        return []
    pixels = np.array(problem.targets, np.float32).reshape(-1, 3)
    if problem.mask is not None:
        pixels = pixels[np.array(problem.mask) > 0]
    bright = pixels[pixels.mean(axis=1) > _DARK * pixels.mean()]
    coloured = np.ptp(bright, axis=1) > _COLOURED * bright.mean(axis=1)
    if not len(bright) or coloured.mean() < _MANY:
        return []
    told = ", ".join(f"'{key}'" for key in keys)
    return [
        f"{told}: one number for all channels, a grey, and the targets have colours: give an <rgb> "
        "in the file where colours are to be found"
    ]


def _traded(unknowns: Unknowns, truth_known: bool) -> list[str]:
    """That lights and colours are unknown together, whose scale images hardly tell."""
    traded = unknowns.traded
    if not traded:
        return []
    told = "fix one, or let known surfaces tell"
    if truth_known and any(unknowns[key].start.ndim > 1 for key in traded):
        told = "value/…/scaled has errors after a factor a channel"
    light, colour = (
        ", ".join(f"'{key}'" for key in traded if unknowns[key].kind.role == role)
        for role in ("light", "colour")
    )
    return [f"light ({light}) and colour ({colour}) can trade brightness: {told}"]


def _products(unknowns: Unknowns) -> list[str]:
    """Factors that are unknown as well as what they multiply, whose product alone images tell."""
    found = []
    for role, factor, of in _FACTORS:
        keys = [u.key for u in unknowns if u.kind.role == role]
        for key in (u.key for u in unknowns):
            head = re.sub(factor, "", key)
            other = next((k for k in keys if k != key and k.startswith(head + of)), None)
            if head != key and other is not None:
                found.append(
                    f"'{key}' multiplies '{other}', and images tell their product alone, or little "
                    "more: leave one out"
                )
    return found


def _other_pictures(scene: mi.Scene, integrator: integrators.Integrator) -> list[str]:
    """Where a file's own integrator shows something else."""
    if isinstance(integrator, integrators.Medium):
        return stand_ins.within(scene)
    if integrator.black_box:
        return []
    told = stand_ins.warnings(scene, integrator.mitsuba)
    if "media" in integrator.simulates:
        return [*told, *stand_ins.of_media(scene)]
    filled = (each.id() for each in light.every_shape(scene) if each.is_medium_transition())
    if names := ", ".join(dict.fromkeys(filled)):
        told.append(
            f"{names}: what fills it is not simulated, as the scene's integrator follows no paths "
            'in media: take <integrator type="volpath"/>'
        )
    return told


def _flat_densities(found: list[Unknown], integrator: integrators.Integrator) -> list[str]:
    """Of densities much of whose start is as dense as its densest place, where Mitsuba follows
    paths in media: it learns by collisions that are none, of which it samples none there."""
    if isinstance(integrator, integrators.Medium):
        return []
    dense = [each for each in found if each.kind.hides and "sigma_t" in each.kind.words]
    flat = ((each.key, each.start >= (1 - _ALIKE) * each.start.max()) for each in dense)
    return [
        f"'{key}': {at.mean():.0%} of its start is as dense as its densest place, where Mitsuba's "
        "derivative by a density is wrong: start from values that differ, such as "
        "{uniform: [0.5, 1.5], seed: 1}"
        for key, at in flat
        if at.all() or at.sum() > max(1, _DENSE * at.size)
    ]


def _lifted(found: list[Unknown]) -> list[str]:
    """Of media whose truth lies below where values stay: it is rendered as it is lifted."""
    return [
        f"'{each.key}': {each.kind.lifted} of the scene's {each.start.size} numbers are below "
        f"{each.truth.min():.3g} and count as that, in targets too: a range that begins nearer to "
        "0 keeps them"
        for each in found
        if each.truth is not None and each.kind.words & {"sigma_t", "albedo"} and each.kind.lifted
    ]


def _doubtful_starts(found: list[Unknown]) -> list[str]:
    """Of unknowns that would not be trusted if they ended where they start; without the advice that
    is for ends."""
    doubts = ((each.key, each.kind.doubt(each.start)) for each in found)
    return [f"start of '{key}': {doubt.partition('; ')[0]}" for key, doubt in doubts if doubt]


def _wrong(params: mi.SceneParameters, found: list[Unknown]) -> list[str]:
    """Of unknowns by which the census of derivatives found wrong ones."""
    said = []
    for key in (each.key for each in found if each.kind.carried and each.key in params):
        what = verdicts.place(params, key)
        if verdicts.verdict(*what) in verdicts.WRONG:
            told = verdicts.note(*what)
            said.append(f"derivatives by '{key}' are not right everywhere: {told}")
    return said


def where_of(scene: SceneConfig) -> str:
    if scene.photos.path is not None:
        return f"photos.path={scene.photos.path}"
    return f"scene.path={scene.path}" if scene.path is not None else f"scene={scene.name}"


def _content_hash(
    scene: mi.Scene, integrator, params: mi.SceneParameters, description: str = ""
) -> str:
    """Hash of what a rendering depends on: the scene's description and all its arrays.

    ``description``: what the scene was made from. Mitsuba's own texts leave properties out, such
    as a bitmap's wrap mode or an integrator's hidden emitters.
    """
    hashed = hashlib.blake2b(digest_size=16)
    told = f"{scene}{integrator} {getattr(integrator, 'hide_emitters', None)}"
    # Objects that say nothing of themselves tell their address. Areas are sums, of which a GPU's
    # last bits differ from load to load.
    hashed.update(re.sub(r"\[0x[0-9a-f]+\]|surface_area = .*", "", told).encode())
    hashed.update(description.encode())
    for key in sorted(params.keys()):
        value = read(params, key)
        hashed.update(key.encode())
        if turn := _made(params, key):
            # Mitsuba's threads add these up in any order: last bits differ from load to load.
            hashed.update(f"made {turn}".encode())
        elif dr.is_array_v(value) and not dr.is_special_v(value):
            hashed.update(np.ascontiguousarray(np.array(value)).tobytes())
        elif hasattr(value, "matrix"):  # whose text has six digits
            hashed.update(np.array(value.matrix, np.float64).tobytes())
        else:
            hashed.update(str(value).encode())
    return hashed.hexdigest()


def _made(params: mi.SceneParameters, key: str) -> int:
    """``mesh_checks.made_normals`` of a mesh, where ``key`` is its normals; else 0."""
    shape, _, word = key.rpartition(".")
    words = [f"{shape}.{name}" for name in ("vertex_positions", "faces", "vertex_normals")]
    if word != "vertex_normals" or not all(each in params for each in words):
        return 0
    return mesh_checks.made_normals(*(np.array(params[each]).reshape(-1, 3) for each in words))
