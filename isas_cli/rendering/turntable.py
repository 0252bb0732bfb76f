"""Surfaces side by side on a turntable: an animation for a page."""

from __future__ import annotations

import io

import mitsuba as mi
import numpy as np

from ..unknowns.kind import Surface

_FRAMES, _SIDE, _SPP, _MILLISECONDS = 24, 200, 32, 100
_TILT, _FIELD = 25.0, 30.0  # degrees
_LIGHT, _SKY = 2.5, 0.35


def made(surfaces: dict[str, Surface]) -> bytes:
    """An animated WebP: each of ``surfaces`` in grey, and the one called "result" once more in the
    colours of its distances from the truth (viridis, dark for 0, bright from their 95th percentile
    on) where these are known. All turn once; the camera is the same."""
    import matplotlib
    from PIL import Image

    grey = np.array([0.6, 0.6, 0.6])
    columns = [(each, np.broadcast_to(grey, each.vertices.shape)) for each in surfaces.values()]
    result = surfaces["result"]
    if result.apart is not None:
        scaled = result.apart / max(float(np.quantile(result.apart, 0.95)), 1e-30)
        colours = matplotlib.colormaps["viridis"](np.minimum(scaled, 1))[:, :3]
        columns.append((result, colours**2.2))
    points = np.concatenate([each.vertices for each, _ in columns])
    low, high = points.min(axis=0), points.max(axis=0)
    middle, radius = (low + high) / 2, np.linalg.norm(high - low) / 2
    scenes = [_scene(each, colours, middle, radius) for each, colours in columns]
    frames = []
    for number in range(_FRAMES):
        sensor = _sensor(360.0 * number / _FRAMES, middle, radius)
        strip = [mi.render(each, sensor=sensor, spp=_SPP, seed=number) for each in scenes]
        pixels = mi.Bitmap(np.concatenate([np.array(each) for each in strip], axis=1))
        pixels = pixels.convert(mi.Bitmap.PixelFormat.RGB, mi.Struct.Type.UInt8, srgb_gamma=True)
        frames.append(Image.fromarray(np.array(pixels)))
    file = io.BytesIO()
    frames[0].save(
        file, "WEBP", save_all=True, append_images=frames[1:], duration=_MILLISECONDS, loop=0
    )
    return file.getvalue()


def _scene(surface: Surface, colours: np.ndarray, middle: np.ndarray, radius: float) -> mi.Scene:
    mesh = mi.Mesh(
        "surface",
        len(surface.vertices),
        len(surface.faces),
        has_vertex_normals=True,
        props=_props({"type": "mesh_attribute", "name": "vertex_color"}),
    )
    mesh.add_attribute("vertex_color", 3, np.ravel(colours).astype(np.float32))
    params = mi.traverse(mesh)
    params["vertex_positions"] = mi.Float(np.ravel(surface.vertices).astype(np.float32))
    params["faces"] = mi.UInt32(np.ravel(surface.faces).astype(np.uint32))
    params.update()
    mesh.recompute_vertex_normals()
    return mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "path", "max_depth": 2, "hide_emitters": False},
            "sky": {"type": "constant", "radiance": {"type": "rgb", "value": _SKY}},
            "lamp": {
                "type": "directional",
                "direction": [-0.5, -0.7, -0.5],
                "irradiance": {"type": "rgb", "value": _LIGHT},
            },
            "surface": mesh,
        }
    )


def _props(reflectance: dict) -> mi.Properties:
    props = mi.Properties()
    matt = {"type": "diffuse", "reflectance": reflectance}
    props["bsdf"] = mi.load_dict({"type": "twosided", "bsdf": matt})
    return props


def _sensor(azimuth: float, middle: np.ndarray, radius: float) -> mi.Sensor:
    a, e = np.radians(azimuth), np.radians(_TILT)
    direction = np.array([np.sin(a) * np.cos(e), np.sin(e), np.cos(a) * np.cos(e)])
    origin = middle + direction * 0.75 * radius / np.sin(np.radians(_FIELD / 2))
    place = mi.ScalarTransform4f().look_at(
        origin=origin.tolist(), target=middle.tolist(), up=[0, 1, 0]
    )
    film = {"type": "hdrfilm", "width": _SIDE, "height": _SIDE, "pixel_format": "rgb"}
    return mi.load_dict({"type": "perspective", "fov": _FIELD, "to_world": place, "film": film})
