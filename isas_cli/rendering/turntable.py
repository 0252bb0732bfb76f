"""Surfaces, or volumes, side by side on a turntable: an animation for a page."""

from __future__ import annotations

import io

import mitsuba as mi
import numpy as np
from scipy import ndimage

from ..unknowns.kind import Surface

_FRAMES, _SIDE, _SPP, _MILLISECONDS = 24, 200, 16, 100
_TILT, _FIELD = 25.0, 30.0  # degrees
_LIGHT, _SKY = 2.5, 0.35


def made(surfaces: dict[str, Surface]) -> bytes:
    """An animated WebP: each of ``surfaces`` in grey, and the one called "result" once more in the
    colours of its distances from the truth (viridis, dark for 0, bright from their 95th percentile
    on) where these are known. All turn once; the camera is the same."""
    import matplotlib

    grey = np.array([0.6, 0.6, 0.6])
    columns = [(each, np.broadcast_to(grey, each.vertices.shape)) for each in surfaces.values()]
    result = surfaces["result"]
    if result.apart is not None:
        scaled = result.apart / max(float(np.quantile(result.apart, 0.95)), 1e-30)
        colours = matplotlib.colormaps["viridis"](np.minimum(scaled, 1))[:, :3]
        columns.append((result, colours**2.2))
    points = np.concatenate([each.vertices[each.faces.ravel()] for each, _ in columns])
    low, high = points.min(axis=0), points.max(axis=0)
    middle, radius = (low + high) / 2, np.linalg.norm(high - low) / 2
    scenes = [_scene(each, colours) for each, colours in columns]
    frames = []
    for number in range(_FRAMES):
        sensor = _sensor(360.0 * number / _FRAMES, middle, radius)
        strip = [mi.render(each, sensor=sensor, spp=_SPP, seed=number) for each in scenes]
        pixels = mi.Bitmap(np.concatenate([np.array(each) for each in strip], axis=1))
        pixels = pixels.convert(mi.Bitmap.PixelFormat.RGB, mi.Struct.Type.UInt8, srgb_gamma=True)
        frames.append(np.array(pixels))
    return _animated(frames)


def _animated(frames: list[np.ndarray]) -> bytes:
    from PIL import Image

    images, file = [Image.fromarray(frame) for frame in frames], io.BytesIO()
    images[0].save(
        file, "WEBP", save_all=True, append_images=images[1:], duration=_MILLISECONDS, loop=0
    )
    return file.getvalue()


def of_volumes(volumes: dict[str, np.ndarray]) -> bytes:
    """An animated WebP: of each of ``volumes (Z, Y, X)``, y up, the largest values along lines of
    sight, white for the largest of the truth's or, without it, of the result's, as all turn once
    about their middle."""
    from PIL import Image

    brightest = max(float(volumes.get("truth", volumes["result"]).max()), 1e-30)
    frames = []
    for number in range(_FRAMES):
        angle, strip = 360.0 * number / _FRAMES, []
        for each in volumes.values():
            # Shown whole from every side: what is outside of the grid is empty.
            turned = ndimage.rotate(each, angle, axes=(2, 0), order=1)
            shown = np.clip(turned.max(axis=0)[::-1] / brightest, 0, 1) ** (1 / 2.2)
            picture = Image.fromarray(np.uint8(255 * shown + 0.5))
            scale = _SIDE / max(np.hypot(*each.shape[::2]), each.shape[1])
            size = [max(1, round(scale * side)) for side in picture.size]
            frame = Image.new("L", (_SIDE, _SIDE))
            frame.paste(picture.resize(size), [(_SIDE - side) // 2 for side in size])
            strip.append(np.array(frame))
        frames.append(np.concatenate(strip, axis=1))
    return _animated(frames)


def _scene(surface: Surface, colours: np.ndarray) -> mi.Scene:
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
    own = {"film": film, "sampler": {"type": "multijitter", "sample_count": _SPP}}
    # Mitsuba's own planes suit scenes of about its unit.
    own |= {"near_clip": float(0.1 * radius), "far_clip": float(10 * radius)}
    return mi.load_dict({"type": "perspective", "fov": _FIELD, "to_world": place, **own})
