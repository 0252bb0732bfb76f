"""Where a file's integrator and the one that replays its paths do not show the same."""

from __future__ import annotations

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
    of media, whatever a sensor says of the one that it stands in.
    """
    kind, depth = getattr(integrator, "stands_for", None), integrator.max_depth
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


def _has_gaps(thing: mi.Object) -> bool:
    """Whether it is a material that lets some light through as if it were not there."""
    return isinstance(thing, mi.BSDF) and mi.has_flag(thing.flags(), mi.BSDFFlags.Null)
