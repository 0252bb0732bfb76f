"""Earth2mars: two globes, one under glass, each starting with the other's texture.

The paper's scene (Fig. 8, EARTH2MARS): "two spheres under environmental lighting. Initialized with
the spheres having opposite textures as the target, we optimize the textures (specifying diffuse
albedo) of these spheres using 16 input images. Since one of the two spheres resides inside a glass
enclosure, the rendering variance of the two spheres differs greatly."; about 4 M pixels an image.

Ours: two globes with NASA's pictures of Earth and Mars, matt (principled BSDF of roughness 0.8), on
a plinth. Mars lies in a shell of glass. Path replay connects surfaces with light straight on, which
the shell blocks: Mars is lit only by those paths that happen to leave through the glass towards
bright sky.

What differs: the paper's textures, light and enclosure are not published, so ours are others. The
shell is a thin pane without refraction (`thindielectric`), as a principled lobe has no smooth
limit. The file of Mars has 512 x 256 texels: larger sizes are interpolated.

What was arranged: the sky. In one view of 96² pixels with 600 paths each, the variance of one
path's radiance, over the squared mean of all pixels of a globe, was 4 for Earth and 62 for Mars
under the CC0 map `sunset`, which has no dominant sun and is taken here. It was 2 and 119 under
`forest`, and 2 and 3,900 under `city`, whose sun gives a quarter of the light: in targets of 128
paths a pixel most of Mars would stand there without its sun. Under `sunset` too the targets of Mars
are noisy; more paths (`target.spp`) help.

Depth 5: camera, glass, globe, glass, light, or a surface more for Earth. Against depth 12 the
images lack 0.6 % of their light (1.6 % at depth 4); targets have the same depth.
"""

from __future__ import annotations

from typing import Any

from . import library
from .cameras import spiral
from .plinth import plinth

RADIUS, SHELL = 0.38, 0.46
EARTH_X, MARS_X = -0.45, 0.45
SKY = "hdri/sunset.exr"


def build(views: int, resolution: int, texture: int) -> dict[str, Any]:
    """The scene with the true textures; unknowns: `earth.bsdf.base_color.data` and
    `mars.bsdf.base_color.data`, (texture/2, texture, 3) each."""
    import mitsuba as mi

    height = max(1, texture // 2)
    # A hair above the plinth, which the shell would touch in one point.
    shell = mi.ScalarTransform4f().translate([MARS_X, SHELL + 1e-3, 0]).scale(SHELL)
    return {
        "type": "scene",
        "integrator": {"type": "prb", "max_depth": 5},
        "sky": library.environment(SKY),
        "earth": _globe("textures/earth.jpg", EARTH_X, RADIUS, texture, height),
        "mars": _globe("textures/mars.png", MARS_X, RADIUS + 0.01, texture, height),
        "shell": {"type": "sphere", "to_world": shell, "bsdf": {"type": "thindielectric"}},
        "plinth": plinth(1.0),
        **spiral(views, resolution, (0.0, 0.40, 0.0), 5.0, 22.5, (5.0, 40.0)),
    }


def _globe(relative: str, x: float, y: float, width: int, height: int) -> dict[str, Any]:
    import mitsuba as mi

    # The sphere's poles lie on its own z axis.
    to_world = mi.ScalarTransform4f().translate([x, y, 0]).rotate([0, 0, 1], 20)
    return {
        "type": "sphere",
        "to_world": to_world.rotate([1, 0, 0], -90).scale(RADIUS),
        "bsdf": {
            "type": "principled",
            "base_color": library.texture(library.picture(relative, width, height)),
            "roughness": 0.8,
        },
    }
