"""Parts of scene files."""


def paths(depth: int | str) -> str:
    """The integrator of paths of so many edges at most."""
    return f'<integrator type="path"><integer name="max_depth" value="{depth}"/></integrator>'


def camera(
    origin: str = "0,0,4", width: int = 16, height: int = 0, target="0,0,0", fov=0, film: str = ""
) -> str:
    """``height``: as ``width`` unless given; ``fov``: Mitsuba's unless given; ``film``: what its
    film has besides."""
    seen = f'<float name="fov" value="{fov}"/>' if fov else ""
    return f"""<sensor type="perspective">{seen}<transform name="to_world">
  <lookat origin="{origin}" target="{target}" up="0,1,0"/></transform><film type="hdrfilm">
  <integer name="width" value="{width}"/><integer name="height" value="{height or width}"/>
  {film}</film></sensor>"""
