"""The frames of a run: target, start, result, error and sampling density of some views."""

from __future__ import annotations

import mitsuba as mi
import numpy as np

from ..records import RunWriter, safe_name
from ..rendering import turntable
from ..rendering.renderer import Renderer
from ..runtime import images, streams
from ..scene.problem import Problem

_RGB = ["R", "G", "B"]
# Snapshots: about a million paths each, whatever the films' size.
_SNAPSHOT_SIDE, _SNAPSHOT_SPP = 256, 16
_FEW = 4


class Pictures:
    """Writes frames/*.exr for up to ``views`` views spread evenly over the problem's."""

    def __init__(
        self,
        problem: Problem,
        writer: RunWriter,
        views: int,
        spp: int,
        seed: int,
        tags: dict,
        renderer: Renderer | None = None,
    ):
        count = len(problem.film_sizes)
        chosen = np.linspace(0, count, min(views, count), endpoint=False)
        self.views = [int(v) for v in chosen]
        self.problem, self.writer, self.tags = problem, writer, tags
        # Of another renderer each path is a whole picture, which may take long.
        self.most = _FEW if problem.integrator.black_box else max(spp, _SNAPSHOT_SPP)
        self.spp, self.seed = min(spp, self.most), seed
        self.renderer = Renderer(problem, renderer)
        # One exposure for all pictures of a run, so that they can be compared.
        self.exposure = images.exposure_for([problem.target_image(v) for v in self.views])

    def _write(
        self,
        name: str,
        image: np.ndarray,
        channels: list[str],
        what: str,
        exposure: float | None = None,
        data: bool = False,
        **more,
    ) -> None:
        tags = {**self.tags, "what": what, **more}
        self.writer.frame(name, image, channels, tags, exposure, data)

    def values(self, kind: str, values: dict, iteration: int) -> None:
        """Every view at ``values``, and pictures of the unknowns. ``kind``: start or result."""
        self.problem.unknowns.write(values)
        for view in self.views:
            image = self.renderer.view(
                view, self.spp, lambda s, v=view: streams.seed(self.seed, (v << 16) + s, "frame")
            )
            tags = {"view": view, "iteration": iteration}
            self._write(f"{kind}_v{view:02d}", image, _RGB, kind, self.exposure, **tags)
            if kind == "result":
                error = np.abs(image - self.problem.target_image(view))
                error = np.where(self.problem.counting(view)[..., None], error, np.float32(0))
                self._write(f"error_v{view:02d}", error, _RGB, "|result - target|", **tags)
        arrays = self.problem.unknowns.arrays(values)
        self._unknowns(kind, arrays, iteration)
        if kind == "result" and self.views:
            self._turntables(arrays)

    def _turntables(self, arrays: dict[str, np.ndarray]) -> None:
        for unknown in self.problem.unknowns:
            shown = {"start": unknown.start, "result": arrays[unknown.key]}
            truth = unknown.truth if self.problem.truth_known else None
            if truth is not None:
                shown = {"truth": truth, **shown}
            surfaces = {what: unknown.kind.surface(each, truth) for what, each in shown.items()}
            if surfaces["result"] and all(np.isfinite(each).all() for each in shown.values()):
                content = turntable.made(surfaces)
                self.writer.mesh(f"turntable_{safe_name(unknown.key)}.webp", content)
            volumes = {what: unknown.kind.volume(each) for what, each in shown.items()}
            if volumes["result"] is not None and np.isfinite(volumes["result"]).all():
                content = turntable.of_volumes(volumes)
                self.writer.mesh(f"turning_{safe_name(unknown.key)}.webp", content)

    def snapshot(self, values: dict, iteration: int, seconds: float) -> np.ndarray:
        """The first view at ``values``, every n-th pixel of it, for an animation afterwards.

        Returns it, ``(H, W, 3) float32``, linear, at most 256 pixels a side. All snapshots use the
        same random numbers, so that only what is found moves.
        """
        self.problem.unknowns.write(values)
        width, height = self.problem.film_sizes[0]
        step = -(-max(width, height) // _SNAPSHOT_SIDE)
        # Of a thin film there is a row as well.
        rows, columns = (np.arange(min(step // 2, n - 1), n, step) for n in (height, width))
        pixel = mi.UInt32((rows[:, None] * width + columns).astype(np.uint32).ravel())
        mean = self.renderer.pixels(
            pixel, min(_SNAPSHOT_SPP, self.most), lambda s: streams.seed(self.seed, s, "snapshot")
        )
        image = np.array(mean).T.reshape(rows.size, columns.size, 3)
        tags = {"view": 0, "iteration": iteration, "seconds": seconds}
        self._write(f"progress_v00_i{iteration:06d}", image, _RGB, "snapshot", **tags)
        return image

    def targets(self) -> None:
        """Targets of the chosen views and pictures of what is true, where known."""
        for view in self.views:
            self._write(
                f"target_v{view:02d}",
                self.problem.target_image(view),
                _RGB,
                "target",
                self.exposure,
                view=view,
            )
        if self.problem.truth_known:
            self._unknowns("truth", {u.key: u.truth for u in self.problem.unknowns}, 0)

    def density(self, density: np.ndarray, iteration: int) -> None:
        """Pixel probability times number of pixels: 1 is uniform."""
        offset = 0
        for view, (width, height) in enumerate(self.problem.film_sizes):
            if view in self.views:
                image = density[offset : offset + width * height].reshape(height, width, 1)
                tags = {"view": view, "iteration": iteration}
                self._write(f"density_v{view:02d}", image, ["Y"], "p_j n", **tags)
            offset += width * height

    def _unknowns(self, what: str, arrays: dict[str, np.ndarray], iteration: int) -> None:
        for unknown in self.problem.unknowns:
            for extension, content in unknown.kind.files(arrays[unknown.key]).items():
                self.writer.mesh(f"{what}_{safe_name(unknown.key)}.{extension}", content)
            for name, picture in unknown.kind.pictures(arrays[unknown.key]).items():
                key = f"{unknown.key}.{name}" if name else unknown.key
                channels = _RGB if picture.shape[2] == 3 else ["Y"]
                tags = {"key": unknown.key, "iteration": iteration}
                tags["data"] = not unknown.kind.colours
                self._write(f"{what}_{safe_name(key)}", picture, channels, what, 1.0, **tags)
