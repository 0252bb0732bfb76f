"""From what a file or a program says of a scene to its objects: which was made from what, and names
that are the same in every process."""

from __future__ import annotations

import itertools

import mitsuba as mi

from ..unknowns import parameters

# What Mitsuba counts as no id: by these its writer refers to objects without one.
_UNNAMED = "_unnamed_"
# By the names of Mitsuba's classes, which exist only once there is a variant.
_KINDS = {
    "Emitter": "emitter",
    "Shape": "shape",
    "Sensor": "sensor",
    "BSDF": "bsdf",
    "Medium": "medium",
    "PhaseFunction": "phase",
    "Texture": "texture",
    "Volume": "volume",
    "Integrator": "integrator",
}


def instantiate(settings: mi.parser.ParserConfig, state: mi.parser.ParserState) -> tuple:
    """What the parsed ``state`` describes, and of each of its objects from which node it was made,
    its number by object. The scene's own things have the ids that ``state`` gives them, others are
    named as in ``name_all``. Nodes that nothing refers to are left out.

    Uses ``state`` up. Raises what Mitsuba raises for what cannot be made.
    """
    mi.parser.transform_all(settings, state)
    held = {
        (holder, name): number
        for holder, node in enumerate(state.nodes)
        for name, number in references(node.props).items()
    }
    made = mi.parser.instantiate(settings, state)
    made = made[0] if isinstance(made, (list, tuple)) else made
    origin = {made: 0}
    inner = {(holder, number) for (holder, _), number in held.items()}
    for (holder, name), number in held.items():
        for thing in _held(state.nodes[holder].props, name):
            # Some, such as 'd65', give what they hold for themselves.
            if (number, origin.get(thing)) not in inner:
                origin[thing] = number
            # A bitmap forgets its id.
            if holder == 0 and _nameless(thing):
                thing.set_id(state.nodes[number].props.id())
    if isinstance(made, mi.Scene):
        name_all(made)
    return made, origin


def in_floats(state: mi.parser.ParserState, every: bool = False) -> None:
    """Have bitmaps hold their files' numbers as they are, in single precision, where whole ones are
    not asked for, which have no derivative, or ``every`` one: by default Mitsuba keeps bytes and
    halves, and Adam steps a copy of halves."""
    for node in state.nodes:
        if node.props.plugin_name() != "bitmap" or not {"filename", "bitmap"} & set(node.props):
            continue
        if every or node.props.get("format", "auto") in ("auto", "fp16", "float16"):
            node.props["format"] = "variant"


def references(props: mi.Properties) -> dict[str, int]:
    """The numbers of the nodes that ``props`` refers to, by name; the rest is not read: Mitsuba
    refuses properties that nobody has read."""
    found = {}
    for name in props.keys():
        if props.type(name) == mi.Properties.Type.ResolvedReference:
            found[name] = props[name].index()
            props.mark_queried(name, False)
    return found


def _held(props: mi.Properties, name: str) -> list[mi.Object]:
    """The objects that stand where ``props`` referred to one node, which may have become several
    or, of a merged one, none."""
    if name in props:
        return [props[name]]
    found = []
    for number in itertools.count():
        if f"{name}_{number}" not in props:
            return found
        found.append(props[f"{name}_{number}"])


def name_all(scene: mi.Scene) -> None:
    """Give the scene's own things without an id one in its order: Mitsuba would call them by their
    address in memory, and keys and content hash would differ from run to run."""
    things = [thing for _, thing in parameters.held(scene)]
    taken = {thing.id() for thing in things}
    listed: dict[str, list] = {
        "emitter": scene.emitters(),
        "shape": scene.shapes(),
        "sensor": scene.sensors(),
    }
    for thing in things:
        kind = next(
            (name for type, name in _KINDS.items() if isinstance(thing, getattr(mi, type))),
            "object",
        )
        if thing not in (of_kind := listed.setdefault(kind, [])):
            of_kind.append(thing)
    for kind, of_kind in listed.items():
        for number, thing in enumerate(of_kind):
            if not _nameless(thing):
                continue
            name = f"{kind}_{number}"
            while name in taken:
                name += "_"
            taken.add(name)
            thing.set_id(name)


def _nameless(thing: mi.Object) -> bool:
    return not thing.id() or thing.id().startswith(_UNNAMED)
