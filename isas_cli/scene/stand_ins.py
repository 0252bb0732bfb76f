"""Where a file's integrator and the one that replays its paths do not show the same."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from ..unknowns import routes

_DEEP = 32  # edges: longer paths add too little to tell
_VOLUMETRIC = "volpath", "volpathmis", "prbvolpath"
_PROJECTIVE = "prb_projective", "direct_projective"
_GAP = 1e-5  # of a box: less is none


def warnings(scene: mi.Scene, integrator: mi.Integrator) -> list[str]:
    """That pictures of ``integrator`` are not those of the file's own, ``integrator.stands_for``;
    nothing for other scenes' integrators, and where they are alike.

    Mitsuba's ``path`` leaves what a camera sees through gaps alone out with the emitters that are
    hidden, ``prb`` does not. Volumetric ones count no edge where a path goes through a gap, which
    ``prb`` does; and ``prbvolpath`` ends a path one emitter later than ``volpath``, with the weight
    that it has beside a light sample which is not taken there. It also begins every path outside
    of media, whatever a sensor says of the one that it stands in. ``direct`` may take light samples
    alone, or none, as ``prb_basic`` takes none. Projective ones keep hidden lamps where a camera
    sees them, shining or dark, and ``prb`` looks through.
    """
    kind, depth = getattr(integrator, "stands_for", None), integrator.max_depth
    if getattr(integrator, "blind", False):
        return [
            "integrator 'direct' of the file takes no samples of materials (bsdf_samples), and prb "
            "does: what mirrors show, and lights by themselves, differ from the file's images; "
            "with bsdf_samples of 1 or more they do not"
        ]
    if getattr(integrator, "unlit", False) and _has_lights(scene, mi.EmitterFlags.Delta):
        cure = "integrator 'prb'" if kind == "prb_basic" else "emitter_samples of 1 or more"
        return [
            f"integrator '{kind}' of the file takes no samples of lights, and prb does: point, "
            "spot, directional and projector lights do not show in the file's images, and do here; "
            f"with {cure} they show in both"
        ]
    own = "prbvolpath" if type(integrator).__name__ == "PRBVolpathIntegrator" else "prb"
    if kind in (None, own) or kind not in ("path", *_VOLUMETRIC, *_PROJECTIVE):
        return []
    gaps = own == "prb" and any(map(_has_gaps, mi.traverse(scene).hierarchy))
    why, cure = [], []
    if kind in _PROJECTIVE:
        if integrator.hide_emitters and _has_lights(scene, mi.EmitterFlags.Surface):
            why.append("looks through hidden lamps that a camera sees")
            cure.append("without hide_emitters")
    elif gaps and integrator.hide_emitters:
        why.append("shows hidden emitters behind gaps")
        cure.append("without hide_emitters")
    if own == "prbvolpath" and any(each.get_medium() is not None for each in scene.sensors()):
        why.append("takes no notice of the medium in which a sensor stands")
        cure.append("with sensors outside of it")
    if kind in _VOLUMETRIC and depth < _DEEP:
        if own == "prbvolpath":
            why.append(f"adds some light by paths of more than {depth} edges")
        elif gaps:
            why.append(f"counts gaps among the {depth} edges of a path")
        elif kind == "prbvolpath":
            why.append(f"adds no light by paths of more than {depth} edges")
        if len(why) > len(cure):
            cure.append("with scene.max_depth=-1")
    if not why:
        return []
    return [
        f"integrator '{kind}' of the file is replayed by {own}, which {' and '.join(why)}: "
        f"images differ from the file's; {' and '.join(cure)} they do not"
    ]


def within(scene: mi.Scene) -> list[str]:
    """Of a medium alone, in which paths begin where a camera stands, whatever a sensor says."""
    found = []
    for number, sensor in enumerate(scene.sensors()):
        middle = mi.Point2f(0.5)
        ray, _ = sensor.sample_ray_differential(0.0, 0.5, middle, middle)
        si = scene.ray_intersect(mi.Ray3f(ray))
        if sensor.get_medium() is None and dr.any(si.is_valid() & (dr.dot(si.n, ray.d) > 0)):
            found.append(
                f"sensor {sensor.id() or number} stands within the medium, and does not name it: "
                "Mitsuba itself begins paths outside of it, and shows another picture; give the "
                "sensor a <ref> to the medium"
            )
    return found


def of_media(scene: mi.Scene) -> list[str]:
    """Of media that Mitsuba shows otherwise than the shapes around them look."""
    shells = [shape for shape in scene.shapes() if shape.interior_medium() is not None]
    found = [
        f"shape {shell.id()}: its normals point inwards, so that its interior medium is outside of "
        "it to Mitsuba, and no cloud shows: set flip_normals the other way, or let to_world mirror "
        "nothing"
        for shell in shells
        if shell.class_name() in ("Cube", "Sphere") and inside_out(scene, shell)
    ]
    pairs = _joined([shell for shell in shells if shell.class_name() == "Cube"])
    if pairs:
        (one, other), several = pairs[0], f", the first of {len(pairs)} pairs" * (len(pairs) > 1)
        found.append(
            f"shapes {one} and {other} share a face{several}: a path that leaves the medium of the "
            "one may step over the boundary of the other, whose medium is then missing: leave a "
            "gap between them"
        )
    return found


def _joined(cubes: list[mi.Shape]) -> list[tuple[str, str]]:
    """The ids of two that share a face: of boxes along the axes, as others may merely be near."""
    ids, ends = [], []
    for cube in cubes:
        places = np.array(mi.traverse(cube)["vertex_positions"], float).reshape(-1, 3)
        low, high = places.min(axis=0), places.max(axis=0)
        if np.minimum(places - low, high - places).max() <= _GAP * (high - low).max():
            ids.append(cube.id())
            ends.append((low, high))
    low, high = np.reshape(ends, (-1, 2, 3)).swapaxes(0, 1)
    common = np.minimum(high[:, None], high) - np.maximum(low[:, None], low)
    gap = _GAP * (high - low).max(axis=1)[:, None, None]
    share = ((abs(common) <= gap).sum(axis=2) == 1) & ((common > gap).sum(axis=2) == 2)
    return [(ids[one], ids[other]) for one, other in np.argwhere(np.triu(share, 1))]


def inside_out(scene: mi.Scene, shell: mi.Shape) -> bool:
    """Whether the normals of a convex ``shell`` point inwards, by which Mitsuba tells on what side
    its interior medium is: as those of a cube do that ``to_world`` mirrors. Evaluates."""
    ray = mi.Ray3f(mi.Point3f(shell.bbox().center()), dr.normalize(mi.Vector3f(0.3, 0.5, 0.8)))
    si = scene.ray_intersect(ray)
    return bool(dr.any((si.shape == mi.ShapePtr(shell)) & (dr.dot(si.n, ray.d) < 0)))


def _has_lights(scene: mi.Scene, flag: mi.EmitterFlags) -> bool:
    return any(mi.has_flag(each.flags(), flag) for each in scene.emitters())


def _has_gaps(thing: mi.Object) -> bool:
    """Whether it is a material that lets some light through as if it were not there."""
    return isinstance(thing, mi.BSDF) and mi.has_flag(routes.flags(thing), mi.BSDFFlags.Null)
