"""Where a file's integrator and the one that replays its paths do not show the same."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

_DEEP = 32  # edges: longer paths add too little to tell
_VOLUMETRIC = "volpath", "volpathmis", "prbvolpath"


def warnings(scene: mi.Scene, integrator: mi.Integrator) -> list[str]:
    """That pictures of ``integrator`` are not those of the file's own, ``integrator.stands_for``;
    nothing for other scenes' integrators, and where they are alike.

    Mitsuba's ``path`` leaves what a camera sees through gaps alone out with the emitters that are
    hidden, ``prb`` does not. Volumetric ones count no edge where a path goes through a gap, which
    ``prb`` does; and ``prbvolpath`` ends a path one emitter later than ``volpath``, with the weight
    that it has beside a light sample which is not taken there. It also begins every path outside
    of media, whatever a sensor says of the one that it stands in. ``direct`` may take light samples
    alone.
    """
    kind, depth = getattr(integrator, "stands_for", None), integrator.max_depth
    if getattr(integrator, "blind", False):
        return [
            "integrator 'direct' of the file takes no samples of materials (bsdf_samples), and prb "
            "does: what mirrors show, and lights by themselves, differ from the file's images; "
            "with bsdf_samples of 1 or more they do not"
        ]
    own = "prbvolpath" if type(integrator).__name__ == "PRBVolpathIntegrator" else "prb"
    if kind in (None, own) or kind not in ("path", *_VOLUMETRIC):
        return []
    gaps = own == "prb" and any(map(_has_gaps, mi.traverse(scene).hierarchy))
    why, cure = [], []
    if gaps and integrator.hide_emitters:
        why.append("shows hidden emitters behind gaps")
        cure.append("without hide_emitters")
    if own == "prbvolpath" and any(each.get_medium() is not None for each in scene.sensors()):
        why.append("takes no notice of the medium in which a sensor stands")
        cure.append("with sensors outside of it")
    if kind != "path" and depth < _DEEP:
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


def _has_gaps(thing: mi.Object) -> bool:
    """Whether it is a material that lets some light through as if it were not there."""
    return isinstance(thing, mi.BSDF) and mi.has_flag(thing.flags(), mi.BSDFFlags.Null)
