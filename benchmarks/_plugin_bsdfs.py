"""A scene for each BSDF of Mitsuba's, alone and beside other lobes."""

from __future__ import annotations

from _plugin_room import MATTE, POINTS, ball, bitmap, bsdf, colour, number, of, room

# Beside gaps and other lobes: darker than what is seen through and in them.
_DARK = bsdf("diffuse", colour("reflectance", "0.1,0.15,0.2"))
_MIRROR = bsdf("conductor", colour("specular_reflectance", "0.9,0.8,0.7"))
_GLASS = bsdf("dielectric", number("int_ior", 1.5))
_ROUGH = bsdf("roughconductor", number("alpha", 0.3))
_BESIDE = {
    "diffuse": bsdf("diffuse", colour("reflectance", "0.2,0.5,0.8")),
    "mirror": _MIRROR,
    "glass": _GLASS,
    "thin": bsdf("thindielectric", number("int_ior", 1.5)),
    "null": bsdf("null"),
    "rough": _ROUGH,
    "plastic": bsdf("plastic", colour("diffuse_reflectance", "0.2,0.5,0.8")),
}
METAL = colour("eta", "0.4,0.6,1.2") + colour("k", "3,2.4,2")
_PRINCIPLED = {
    "base_color": "0.6,0.4,0.3",
    "roughness": 0.4,
    "anisotropic": 0.4,
    "metallic": 0.3,
    "spec_tint": 0.4,
    "sheen": 0.5,
    "sheen_tint": 0.4,
    "flatness": 0.3,
}


def _principled(kind: str = "principled", **changed) -> str:
    """With all parameters named: those that are not in the file are none."""
    values = _PRINCIPLED | changed
    inside = [
        colour(word, value) if isinstance(value, str) else number(word, value)
        for word, value in values.items()
        if value is not None
    ]
    return bsdf(kind, *inside)


_OPAQUE = {"clearcoat": 0.5, "clearcoat_gloss": 0.4, "specular": 0.6}
_THIN = {"metallic": None, "spec_trans": 0.4, "diff_trans": 0.8, "eta": 1.4}


def _under_points(inside: str, kind: str = "rectangle", more: str = "") -> str:
    return room(ball(inside, kind, more), lights=POINTS)


_CURVE = "bsplinecurve", '<string name="filename" value="curve.txt"/>'

BSDFS = {
    "diffuse": of("diffuse", colour("reflectance", "0.6,0.4,0.3")),
    "conductor": of("conductor", METAL, colour("specular_reflectance", "0.9,0.7,0.5")),
    "conductor-material": of("conductor", '<string name="material" value="Au"/>'),
    "roughconductor": of(
        "roughconductor",
        METAL,
        colour("specular_reflectance", "0.9,0.7,0.5"),
        number("alpha", 0.3),
    ),
    "roughconductor-material": of(
        "roughconductor", '<string name="material" value="Au"/>', number("alpha", 0.3)
    ),
    "roughconductor-anisotropic": of(
        "roughconductor", METAL, number("alpha_u", 0.4), number("alpha_v", 0.15)
    ),
    "roughconductor-points": _under_points(
        bsdf("roughconductor", METAL, number("alpha_u", 0.4), number("alpha_v", 0.15))
    ),
    "roughconductor-textured": of("roughconductor", METAL, bitmap("alpha", "g.exr")),
    "roughconductor-ggx": of(
        "roughconductor", '<string name="distribution" value="ggx"/>', METAL, number("alpha", 0.3)
    ),
    "dielectric": of(
        "dielectric",
        number("int_ior", 1.5),
        colour("specular_reflectance", "0.9,0.8,0.7"),
        colour("specular_transmittance", "0.7,0.8,0.9"),
    ),
    "thindielectric": of(
        "thindielectric",
        number("int_ior", 1.5),
        colour("specular_reflectance", "0.9,0.8,0.7"),
        colour("specular_transmittance", "0.7,0.8,0.9"),
    ),
    "roughdielectric": of(
        "roughdielectric",
        number("int_ior", 1.5),
        number("alpha", 0.3),
        colour("specular_reflectance", "0.9,0.8,0.7"),
        colour("specular_transmittance", "0.7,0.8,0.9"),
    ),
    "roughdielectric-anisotropic": of(
        "roughdielectric", number("int_ior", 1.5), number("alpha_u", 0.4), number("alpha_v", 0.15)
    ),
    "plastic": of(
        "plastic",
        colour("diffuse_reflectance", "0.6,0.4,0.3"),
        colour("specular_reflectance", "0.9,0.8,0.7"),
    ),
    "plastic-nonlinear": of(
        "plastic",
        '<boolean name="nonlinear" value="true"/>',
        colour("diffuse_reflectance", "0.6,0.4,0.3"),
        colour("specular_reflectance", "0.9,0.8,0.7"),
    ),
    "plastic-textured": of("plastic", bitmap("diffuse_reflectance")),
    "roughplastic": of(
        "roughplastic",
        number("alpha", 0.3),
        colour("diffuse_reflectance", "0.6,0.4,0.3"),
        colour("specular_reflectance", "0.9,0.8,0.7"),
    ),
    "roughplastic-nonlinear": of(
        "roughplastic",
        '<boolean name="nonlinear" value="true"/>',
        number("alpha", 0.15),
        colour("diffuse_reflectance", "0.6,0.4,0.3"),
    ),
    "pplastic": of(
        "pplastic",
        number("alpha", 0.3),
        colour("diffuse_reflectance", "0.6,0.4,0.3"),
        colour("specular_reflectance", "0.9,0.8,0.7"),
    ),
    "principled": room(ball(_principled(**_OPAQUE))),
    "principled-glass": room(
        ball(_principled(**_OPAQUE, spec_trans=0.5, sheen=None, sheen_tint=None, flatness=None))
    ),
    "principled-eta": room(ball(_principled(eta=1.4, metallic=0.1, spec_trans=0.6))),
    "principled-bare": room(ball(bsdf("principled", colour("base_color", "0.6,0.4,0.3")))),
    "principled-points": _under_points(_principled(**_OPAQUE, anisotropic=0.7)),
    "principledthin-points": _under_points(_principled("principledthin", **_THIN, anisotropic=0.7)),
    "principledthin": room(ball(_principled("principledthin", **_THIN))),
    "mask": of("mask", number("opacity", 0.6), _DARK),
    **{
        f"mask-{name}": of("mask", number("opacity", 0.6), other)
        for name, other in _BESIDE.items()
        if name not in ("diffuse", "null")
    },
    "mask-textured": of("mask", bitmap("opacity", "g.exr"), _DARK),
    "blendbsdf": of("blendbsdf", number("weight", 0.4), _DARK, _BESIDE["diffuse"]),
    **{
        f"blendbsdf-{name}": of("blendbsdf", number("weight", 0.4), _DARK, other)
        for name, other in _BESIDE.items()
        if name != "diffuse"
    },
    "blendbsdf-mirrors": of("blendbsdf", number("weight", 0.4), _MIRROR, _GLASS),
    "blendbsdf-textured": of(
        "blendbsdf", bitmap("weight", "g.exr"), bsdf("diffuse", bitmap("reflectance")), _MIRROR
    ),
    "blendbsdf-nested": of(
        "blendbsdf",
        number("weight", 0.4),
        bsdf("mask", number("opacity", 0.7), _DARK),
        bsdf(
            "blendbsdf",
            number("weight", 0.3),
            bsdf("conductor", METAL),
            bsdf("roughconductor", METAL, number("alpha", 0.3)),
        ),
    ),
    "twosided": of("twosided", MATTE),
    "twosided-plastic": of("twosided", _BESIDE["plastic"]),
    "twosided-blend": of(
        "twosided", bsdf("blendbsdf", number("weight", 0.4), _DARK, bsdf("conductor", METAL))
    ),
    "twosided-both": room(ball(bsdf("twosided", MATTE, _BESIDE["plastic"]), "rectangle")),
    "bumpmap": of("bumpmap", bitmap("arbitrary", "b.exr"), number("scale", 0.3), _ROUGH),
    # Facets that all face the camera, and some that turn away from it.
    "bumpmap-points": _under_points(
        bsdf("bumpmap", bitmap("arbitrary", "b.exr"), number("scale", 0.3), MATTE)
    ),
    "bumpmap-steep": _under_points(
        bsdf("bumpmap", bitmap("arbitrary", "b.exr"), number("scale", 0.3), MATTE), "sphere"
    ),
    "bumpmap-mirror": of("bumpmap", bitmap("arbitrary", "b.exr"), number("scale", 0.3), _MIRROR),
    "normalmap": of("normalmap", bitmap("normalmap", "n.exr"), _ROUGH),
    "normalmap-points": _under_points(bsdf("normalmap", bitmap("normalmap", "n.exr"), MATTE)),
    "normalmap-steep": _under_points(
        bsdf("normalmap", bitmap("normalmap", "steep.exr"), MATTE), "sphere"
    ),
    "normalmap-mirror": of("normalmap", bitmap("normalmap", "n.exr"), _MIRROR),
    "null": of("null"),
    "hair": room(
        ball(
            bsdf("hair", number("eumelanin", 0.3), number("pheomelanin", 0.2)),
            *_CURVE,
        )
    ),
    "hair-sigma": room(
        ball(
            bsdf("hair", colour("sigma_a", "0.3,0.5,0.9")),
            *_CURVE,
        )
    ),
    "hair-points": _under_points(
        bsdf("hair", number("eumelanin", 0.3), number("pheomelanin", 0.2)), *_CURVE
    ),
    "measured": of("measured", '<string name="filename" value="lobe.bsdf"/>'),
    "circular": of("circular", colour("transmittance", "0.7,0.8,0.9")),
    "polarizer": of("polarizer", number("theta", 20), colour("transmittance", "0.7,0.8,0.9")),
    "retarder": of(
        "retarder", number("theta", 20), number("delta", 60), colour("transmittance", "0.7,0.8,0.9")
    ),
}
