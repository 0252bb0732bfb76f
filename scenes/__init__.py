"""Scene builders: each returns a Mitsuba scene dictionary that holds the true parameters.

A builder is `build(views, resolution, texture)`: the number of sensors, the width and height of
each film in pixels, and the width and height of the scene's textures in texels. Its dictionary
has one sensor `sensor_000`, `sensor_001`, ... for each view and an `integrator`, and is meant for
`mitsuba.load_dict(..., optimize=False)`. Builders are deterministic and import Mitsuba only when
called, after the variant is set. Lengths are in units of the main object's height; y points up.

Meshes in a dictionary are objects already: two scenes loaded from one dictionary would share
them and their materials, so build anew for another scene.
"""
