"""A small scene for each of Mitsuba's plugins, as XML: what is on trial has the id ``thing``.

All stand in the same room: a wall behind, a square lamp at the side and light from everywhere, so
that the shape of a lobe counts as much as its size. Numbers lie inside their ranges, and each
parameter changes the picture. ``SCENES``: by name, a plugin's, or a plugin's, a hyphen, and what
stands beside it. The files that they name are written by ``_plugins.write``.
"""

from __future__ import annotations

# Edges of the longest path. Through media Mitsuba's integrators count them in different ways, which
# no longer tells where paths are long.
DEPTH, DEEP = 4, 12
SIDE = 16  # pixels of a picture, each way

FILM = (
    f'<film type="hdrfilm"><integer name="width" value="{SIDE}"/>'
    f'<integer name="height" value="{SIDE}"/><string name="pixel_format" value="rgb"/>'
    '<rfilter type="box"/></film>'
)
LOOK = '<transform name="to_world"><lookat origin="0,0,4" target="0,0,0" up="0,1,0"/></transform>'
LAMP = (
    '<shape type="rectangle" id="lamp"><transform name="to_world"><scale value="0.8"/>'
    '<lookat origin="2.5,2.5,3" target="0,0,0" up="0,1,0"/></transform>'
    '<emitter type="area"><rgb name="radiance" value="9,7,5"/></emitter></shape>'
)
SKY = '<emitter type="constant" id="sky"><rgb name="radiance" value="0.3,0.4,0.5"/></emitter>'
# Lights without extent: no direction that a BSDF draws meets them, which is where the noise of a
# derivative by a lobe's shape comes from.
POINTS = "".join(
    f'<emitter type="point"><point name="position" value="{place}"/>'
    f'<rgb name="intensity" value="{power}"/></emitter>'
    for place, power in (
        ("2,2.5,3", "30,25,20"),
        ("-2.5,0.5,2.5", "15,20,25"),
        ("0.5,-2.5,2", "20,15,15"),
        ("0.5,1.5,-1.5", "4,5,6"),
    )
)
_WALL = (
    '<shape type="rectangle" id="wall"><transform name="to_world"><scale value="3"/>'
    '<translate z="-2"/></transform>'
    '<bsdf type="diffuse"><rgb name="reflectance" value="0.7,0.4,0.2"/></bsdf></shape>'
)
MATTE = '<bsdf type="diffuse"><rgb name="reflectance" value="0.6,0.4,0.3"/></bsdf>'


def number(name: str, value: float) -> str:
    return f'<float name="{name}" value="{value}"/>'


def colour(name: str, value: str) -> str:
    return f'<rgb name="{name}" value="{value}"/>'


def bitmap(name: str, file: str = "t.exr") -> str:
    return (
        f'<texture type="bitmap" name="{name}"><string name="filename" value="{file}"/>'
        '<boolean name="raw" value="true"/></texture>'
    )


def sensor(kind: str = "perspective", more: str = number("fov", 40), film: str = FILM) -> str:
    return f'<sensor type="{kind}">{LOOK}{more}{film}</sensor>'


def room(*things: str, camera: str = "", integrator: str = "path", lights: str = LAMP + SKY):
    """The text of a scene."""
    depth = DEEP if integrator == "volpath" else DEPTH
    return (
        f'<scene version="3.0.0"><integrator type="{integrator}">'
        f'<integer name="max_depth" value="{depth}"/></integrator>'
        f"{camera or sensor()}{lights}{_WALL}{''.join(things)}</scene>\n"
    )


def ball(inside: str, kind: str = "sphere", more: str = "") -> str:
    return f'<shape type="{kind}" id="thing">{more}{inside}</shape>'


def bsdf(kind: str, *inside: str, name: str = "") -> str:
    named = f' name="{name}"' if name else ""
    return f'<bsdf type="{kind}"{named}>{"".join(inside)}</bsdf>'


def of(*parts: str) -> str:
    return room(ball(bsdf(*parts)))
