"""A scene for each of Mitsuba's emitters, textures, media, sensors and shapes."""

from __future__ import annotations

from _plugin_bsdfs import BSDFS, METAL
from _plugin_room import (
    FILM,
    LAMP,
    LOOK,
    MATTE,
    SIDE,
    SKY,
    ball,
    bitmap,
    bsdf,
    colour,
    number,
    of,
    room,
    sensor,
)

_AT = '<transform name="to_world"><lookat origin="1,2,4" target="0,0,0" up="0,1,0"/></transform>'
_BALL = ball(MATTE).replace('id="thing"', 'id="ball"')
_GROUND = '<transform name="to_world"><rotate x="1" angle="-90"/></transform>'  # Mitsuba's up is z


def _panel(emitter: str) -> str:
    return (
        '<shape type="rectangle" id="thing"><transform name="to_world"><scale value="0.8"/>'
        '<lookat origin="-2,2,2.5" target="0,0,0" up="0,1,0"/></transform>'
        f"{emitter}</shape>"
    )


def _lit(*emitter: str, lights: str = SKY) -> str:
    """A ball and a wall, lit by the emitter on trial."""
    kind, *inside = emitter
    return room(
        f'<emitter type="{kind}" id="thing">{"".join(inside)}</emitter>', _BALL, lights=lights
    )


def _from_panel(kind: str, radiance: str) -> str:
    return room(_panel(f'<emitter type="{kind}">{radiance}</emitter>'), _BALL, lights=SKY)


EMITTERS = {
    "area": _from_panel("area", colour("radiance", "9,7,5")),
    "area-textured": _from_panel("area", bitmap("radiance")),
    "directionalarea": _from_panel("directionalarea", colour("radiance", "3,2.5,2")),
    "constant": _lit("constant", colour("radiance", "0.7,0.9,1.1"), lights=LAMP),
    "directional": _lit("directional", _AT, colour("irradiance", "3,2.5,2")),
    "envmap": _lit(
        "envmap",
        '<string name="filename" value="e.exr"/>',
        number("scale", 1.5),
        lights=LAMP,
    ),
    "point": _lit(
        "point", '<point name="position" x="1" y="2" z="3"/>', colour("intensity", "30,25,20")
    ),
    "projector": _lit(
        "projector", _AT, bitmap("irradiance"), number("scale", 40), number("fov", 30)
    ),
    "spot": _lit("spot", _AT, colour("intensity", "90,70,50"), number("cutoff_angle", 25)),
    "spot-textured": _lit(
        "spot", _AT, colour("intensity", "90,70,50"), bitmap("texture"), number("cutoff_angle", 25)
    ),
    "sunsky": _lit(
        "sunsky",
        '<vector name="sun_direction" x="0.4" y="0.6" z="0.6"/>',
        number("turbidity", 4),
        colour("albedo", "0.3,0.4,0.2"),
        _GROUND,
        lights=LAMP,
    ),
    "sunsky-sky": _lit(
        "sunsky",
        '<vector name="sun_direction" x="0.4" y="0.6" z="0.6"/>',
        number("sun_scale", 0),
        _GROUND,
        lights=LAMP,
    ),
    "sunsky-date": _lit("sunsky", _GROUND, lights=LAMP),
    "timed_sunsky": _lit(
        "timed_sunsky",
        '<integer name="start_year" value="2025"/>',
        '<integer name="end_year" value="2026"/>',
        number("window_start_time", 10),
        number("window_end_time", 14),
        number("turbidity", 4),
        _GROUND,
        lights=LAMP,
    ),
}


def _painted(texture: str, more: str = "", kind: str = "sphere") -> str:
    return room(ball(bsdf("diffuse", texture), kind, more))


def _attribute(name: str, file: str = "") -> str:
    """A mesh whose reflectance is an attribute of its own."""
    texture = (
        '<texture type="mesh_attribute" name="reflectance">'
        f'<string name="name" value="{name}"/></texture>'
    )
    return _painted(texture, f'<string name="filename" value="{file or name}.ply"/>', "ply")


_WARP = '<transform name="to_uv"><scale x="3" y="2"/></transform>'
TEXTURES = {
    "bitmap": _painted(bitmap("reflectance")),
    "bitmap-grey": _painted(bitmap("reflectance", "g.exr")),
    "bitmap-nearest": _painted(
        '<texture type="bitmap" name="reflectance"><string name="filename" value="t.exr"/>'
        '<string name="filter_type" value="nearest"/><string name="wrap_mode" value="clamp"/>'
        f"{_WARP}</texture>"
    ),
    "bitmap-shared": room(
        '<texture type="bitmap" id="shared"><string name="filename" value="t.exr"/></texture>',
        ball(
            bsdf(
                "roughplastic",
                '<ref id="shared" name="diffuse_reflectance"/>',
                '<ref id="shared" name="specular_reflectance"/>',
            )
        ),
    ),
    "checkerboard": _painted(
        '<texture type="checkerboard" name="reflectance">'
        f"{colour('color0', '0.2,0.3,0.4')}{colour('color1', '0.7,0.6,0.5')}{_WARP}</texture>"
    ),
    "checkerboard-nested": _painted(
        f'<texture type="checkerboard" name="reflectance">{bitmap("color0")}'
        f"{colour('color1', '0.7,0.6,0.5')}{_WARP}</texture>"
    ),
    "mesh_attribute": _attribute("vertex_color"),
    "mesh_attribute-face": _attribute("face_color"),
    "mesh_attribute-four": _attribute("vertex_color", "vertex_alpha"),
    "mesh_attribute-grey": _attribute("vertex_grey"),
    "volume": _painted(
        '<texture type="volume" name="reflectance"><volume type="gridvolume" name="volume">'
        '<string name="filename" value="rgb.vol"/><transform name="to_world">'
        '<scale value="2"/><translate x="-1" y="-1" z="-1"/></transform></volume></texture>'
    ),
    "uniform": _painted(
        '<spectrum type="uniform" name="reflectance"><float name="value" value="0.6"/></spectrum>'
    ),
    "rawconstant": of(
        "roughconductor",
        METAL,
        '<texture type="rawconstant" name="alpha"><float name="value" value="0.3"/></texture>',
    ),
    "srgb": _painted(
        '<spectrum type="srgb" name="reflectance"><rgb name="color" value="0.6,0.4,0.3"/>'
        "</spectrum>"
    ),
    "d65": _from_panel(
        "area",
        '<spectrum type="d65" name="radiance"><float name="scale" value="5"/></spectrum>',
    ),
}

_TURN = '<transform name="to_world"><scale value="2"/><translate x="-1" y="-1" z="-1"/></transform>'


def _grid(name: str, file: str) -> str:
    return (
        f'<volume type="gridvolume" name="{name}"><string name="filename" value="{file}"/>'
        f"{_TURN}</volume>"
    )


def _fog(kind: str = "homogeneous", density: str = "", albedo: str = "", phase: str = "") -> str:
    """A ball of a medium, with a phase function."""
    inside = (density or number("sigma_t", 1)) + (albedo or colour("albedo", "0.8,0.7,0.6"))
    medium = f'<medium type="{kind}" name="interior">{inside}{phase}</medium>'
    return room(ball(bsdf("null") + medium), integrator="volpath")


def _phase(kind: str, inside: str = "") -> str:
    return f'<phase type="{kind}">{inside}</phase>'


_HG = _phase("hg", number("g", 0.5))
MEDIA = {
    "homogeneous": _fog(phase=_phase("isotropic")),
    "homogeneous-rgb": _fog(
        density=colour("sigma_t", "0.3,0.5,0.7") + number("scale", 2), phase=_HG
    ),
    "heterogeneous": _fog("heterogeneous", _grid("sigma_t", "d.vol"), phase=_phase("isotropic")),
    "heterogeneous-albedo": _fog(
        "heterogeneous", _grid("sigma_t", "d.vol"), _grid("albedo", "rgb.vol"), _phase("isotropic")
    ),
    "isotropic": _fog(phase=_phase("isotropic")),
    "hg": _fog(phase=_HG),
    "rayleigh": _fog(phase=_phase("rayleigh")),
    "tabphase": _fog(
        phase=_phase("tabphase", '<string name="values" value="0.5, 1.0, 1.5, 2.0, 3.0"/>')
    ),
    "blendphase": _fog(
        phase=_phase("blendphase", number("weight", 0.4) + _phase("isotropic") + _HG)
    ),
    "sggx": _fog(
        "heterogeneous", _grid("sigma_t", "d.vol"), phase=_phase("sggx", _grid("S", "s.vol"))
    ),
    "constvolume": _fog(
        "heterogeneous",
        '<volume type="constvolume" name="sigma_t"><float name="value" value="1"/>'
        f"{_TURN}</volume>",
        '<volume type="constvolume" name="albedo"><rgb name="value" value="0.8,0.7,0.6"/></volume>',
        _phase("isotropic"),
    ),
    "gridvolume": _fog("heterogeneous", _grid("sigma_t", "d.vol"), _grid("albedo", "rgb.vol"), _HG),
}


def _seen(kind: str, more: str = "", film: str = FILM, look: str = LOOK) -> str:
    """The usual ball before a sensor."""
    return room(ball(MATTE), camera=f'<sensor type="{kind}">{look}{more}{film}</sensor>')


_ONE = FILM.replace(f'value="{SIDE}"', 'value="1"')
_WIDE = FILM.replace(f'"width" value="{SIDE}"', f'"width" value="{2 * SIDE}"')
_FROM = (
    '<transform name="to_world"><scale x="1.5" y="1.5"/>'
    '<lookat origin="0,0,4" target="0,0,0" up="0,1,0"/></transform>'
)
SENSORS = {
    "perspective": _seen("perspective", number("fov", 40)),
    "thinlens": _seen(
        "thinlens", number("fov", 40) + number("aperture_radius", 0.2) + number("focus_distance", 3)
    ),
    "orthographic": _seen("orthographic", look=_FROM),
    "batch": _seen(
        "batch",
        sensor(film="").replace("<sensor ", '<sensor name="left" ')
        + sensor(more=number("fov", 60), film="").replace("<sensor ", '<sensor name="right" '),
        _WIDE,
        look="",
    ),
    "distant": _seen("distant", '<point name="target" x="0" y="0" z="0"/>', _ONE),
    "radiancemeter": _seen("radiancemeter", film=_ONE),
    "irradiancemeter": room(
        ball(MATTE + f'<sensor type="irradiancemeter">{_ONE}</sensor>'), camera=" "
    ),
}

_FILE = '<string name="filename" value="{}"/>'
_SMALL = '<transform name="to_world"><scale value="0.7"/></transform>'
SHAPES = {
    "sphere": room(ball(MATTE)),
    "rectangle": room(ball(MATTE, "rectangle")),
    "disk": room(ball(MATTE, "disk")),
    "cube": room(ball(MATTE, "cube", _SMALL)),
    "cylinder": room(ball(MATTE, "cylinder", _SMALL)),
    "bsplinecurve": room(ball(MATTE, "bsplinecurve", _FILE.format("curve.txt"))),
    "linearcurve": room(ball(MATTE, "linearcurve", _FILE.format("curve.txt"))),
    "obj": room(ball(MATTE, "obj", _FILE.format("ball.obj"))),
    "ply": room(ball(MATTE, "ply", _FILE.format("ball.ply"))),
    "serialized": room(ball(MATTE, "serialized", _FILE.format("ball.serialized"))),
    "sdfgrid": room(ball(MATTE, "sdfgrid", _FILE.format("sdf.vol") + _TURN)),
    "ellipsoids": room(ball(MATTE, "ellipsoids", _FILE.format("ellipsoids.ply"))),
    "ellipsoidsmesh": room(ball(MATTE, "ellipsoidsmesh", _FILE.format("ellipsoids.ply"))),
    "merge": room(
        '<shape type="merge" id="thing">'
        + "".join(
            f'<shape type="ply">{_FILE.format("ball.ply")}<transform name="to_world">'
            f'<scale value="0.5"/><translate x="{x}"/></transform>{MATTE}</shape>'
            for x in (-0.6, 0.6)
        )
        + "</shape>"
    ),
    "shapegroup": room(
        f'<shape type="shapegroup" id="group">{ball(MATTE, "ply", _FILE.format("ball.ply"))}'
        "</shape>",
        f'<shape type="instance"><ref id="group"/>{_SMALL}</shape>',
    ),
}
SHAPES["instance"] = SHAPES["shapegroup"]

SCENES: dict[str, str] = BSDFS | EMITTERS | TEXTURES | MEDIA | SENSORS | SHAPES
