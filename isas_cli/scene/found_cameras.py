"""Cameras of photographs in a scene that is written, as they were found to stand and see."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
from scipy.spatial.transform import Rotation

from .views import Views


def put(state, views: Views, first: int = 0) -> list[str]:
    """Changes the sensors of a parsed scene from number ``first`` on; says what of ``views`` no
    sensor has."""
    told = []
    if views.lens is not None:
        lenses = np.array(views.lens, np.float64).reshape(-1, 4)
        for number, lens in enumerate(lenses):
            _see(_sensor(state, first + number), lens, views.sizes[number])
        if lenses[:, 3].any():
            bent = ", ".join(f"{each:.4g}" for each in lenses[:, 3])
            told.append(f"radial distortions are not in the file: k = {bent} of r (1 + k r²)")
    if views.motion is not None:
        motion = np.array(views.motion, np.float64).reshape(-1, 2, 3)
        for number, (turn, shift) in enumerate(motion):
            _stand(_sensor(state, first + number), turn, shift)
    numbers = dr.arange(mi.UInt32, views.count)
    factors = np.array(views.brightness(numbers) * dr.ones(mi.Color3f, views.count)).T.tolist()
    if any(factor != 1 for each in factors for factor in each):
        said = [each[:1] if len(set(each)) == 1 else each for each in factors]
        said = ", ".join("/".join(f"{e:.4g}" for e in each) for each in said)
        told.append(f"exposures are not in the file: multiply the views by {said}")
    return told


def _sensor(state, number: int):
    (found,) = (n.props for n in state.nodes if n.props.id() == f"sensor_{number:05d}")
    return found


def _see(sensor, lens: np.ndarray, size: tuple[int, int]) -> None:
    """``lens``: a view's of ``Views.lens``; ``size``: of its film."""
    longer, across, down, _ = lens
    half = np.tan(np.radians(sensor["fov"]) / 2)  # of the film's width, at distance 1
    sensor["fov"] = float(np.degrees(2 * np.arctan(half / (1 + longer))))
    for axis, off in (("x", across), ("y", down * size[0] / size[1])):
        name = f"principal_point_offset_{axis}"
        sensor[name] = float(sensor.get(name, 0.0) - off / (2 * half))


def _stand(sensor, turn: np.ndarray, shift: np.ndarray) -> None:
    """``turn``, ``shift``: a view's of ``Views.motion``."""
    stands = np.array(sensor["to_world"].matrix, np.float64).reshape(4, 4)
    stands[:3, :3] = Rotation.from_rotvec(turn).as_matrix() @ stands[:3, :3]
    stands[:3, 3] += shift
    sensor["to_world"] = mi.ScalarTransform4f(stands)
