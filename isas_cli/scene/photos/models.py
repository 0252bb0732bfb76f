"""Camera models by the names that COLMAP and nerfstudio give them."""

from __future__ import annotations

from .lens import Lens

# Model → what its parameters are, in COLMAP's order; f is both fx and fy.
PARAMETERS = {
    "SIMPLE_PINHOLE": "f cx cy",
    "PINHOLE": "fx fy cx cy",
    "SIMPLE_RADIAL": "f cx cy k1",
    "RADIAL": "f cx cy k1 k2",
    "OPENCV": "fx fy cx cy k1 k2 p1 p2",
    "FULL_OPENCV": "fx fy cx cy k1 k2 p1 p2 k3 k4 k5 k6",
    "OPENCV_FISHEYE": "fx fy cx cy k1 k2 k3 k4",
    "SIMPLE_RADIAL_FISHEYE": "f cx cy k1",
    "RADIAL_FISHEYE": "f cx cy k1 k2",
    "SIMPLE_FISHEYE": "f cx cy",
    "FISHEYE": "fx fy cx cy",
    "THIN_PRISM_FISHEYE": "fx fy cx cy k1 k2 p1 p2 k3 k4 sx1 sy1",
    "RAD_TAN_THIN_PRISM_FISHEYE": "fx fy cx cy k1 k2 k3 k4 k5 k6 p2 p1 s1 s2 s3 s4",
    "FOV": "fx fy cx cy omega",
    "SIMPLE_DIVISION": "f cx cy k",
    "DIVISION": "fx fy cx cy k",
    "EUCM": "fx fy cx cy alpha beta",
}
WAY_OUT = "or take pictures without a lens, from colmap image_undistorter"


def lens(model: str, values: dict[str, float]) -> Lens:
    """The lens of a ``model`` of ``PARAMETERS``; a number that is missing from ``values`` is 0."""

    def of(*names: str) -> tuple[float, ...]:
        return tuple(values.get(name, 0.0) for name in names)

    tangential = of("p1", "p2")
    if model == "FULL_OPENCV":
        below = of("k4", "k5", "k6")
        return Lens((*of("k1", "k2", "k3"), 0.0), tangential, below if any(below) else ())
    if model == "RAD_TAN_THIN_PRISM_FISHEYE":
        radial = of(*(f"k{n}" for n in range(1, 7)))
        prism = of("s1", "s2", "s3", "s4")
        return Lens(radial, tangential, prism=prism, late=True, kind="fisheye")
    if model.endswith("FISHEYE"):
        sx, sy = of("sx1", "sy1")
        prism = (sx, 0.0, sy, 0.0)
        return Lens(of("k1", "k2", "k3", "k4"), tangential, prism=prism, kind="fisheye")
    if model == "FOV":
        return Lens(kind="fov", own=of("omega"))
    if model.endswith("DIVISION"):
        return Lens(kind="division", own=of("k"))
    if model == "EUCM":
        return Lens(kind="unified", own=of("alpha", "beta"))
    return Lens(of("k1", "k2", "k3", "k4"), tangential)
