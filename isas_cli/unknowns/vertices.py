"""The vertices of a mesh: its shape."""

from __future__ import annotations

import re
from functools import cached_property
from pathlib import Path

import drjit as dr
import mitsuba as mi
import numpy as np
from scipy.spatial import cKDTree

from ..runtime.errors import InputError
from ..scene.crossings import crossing
from ..scene.mesh_checks import check_values
from ..scene.mesh_files import upwards
from ..scene.shape_error import MEASURES, Sampled, apart, enclosed
from ..scene.subdivision import coarser
from ..scene.topology import Topology, distinct
from .kind import Kind, Loaded, Surface
from .mesh import Halved, Mesh
from .parameters import like

# From this share of folded edges, or of triangles that pass through others, on a mesh is not what
# is looked for.
_FOLDED = 0.005
# Of the mesh's size: vertices as near as this are one that a file has twice.
_NEARLY = 1e-5
# Edges that have grown or shrunk by such a factor, in the mean, are not what is looked for either.
_STRETCHED = 10.0
_POSITIONS = "vertex_positions"
# The cosine of 20°, and a share of a mesh's vertices: a few may be where a surface has no normal.
_ALIKE, _FEW_TURNED = 0.94, 0.05
# Of a mesh's own: (vertex|face)_<name>, but for what is positions, normals or texture coordinates.
_ATTRIBUTE = re.compile(r"\.(vertex_(?!positions|normals|texcoords)|face_).*")


class Vertices(Kind):
    """Where the vertices of one mesh are, ``(V, 3)``, in the world; those at one place are one.

    Steps follow 'Large Steps in Inverse Rendering of Geometry' (Nicolet et al. 2021): their unknown
    is u = (I + λL)x, L the Laplacian of the mesh's graph, and Adam's steps by u become steps of x
    along (I + λL)⁻² ∂ℒ/∂x. Here x itself is the unknown and ``smoothed`` gives that direction,
    which Adam divides by one number for all vertices (AdamUniform): a rate is about the largest
    length that a vertex moves in a step. Only that number differs from the paper's.
    Normals are the area-weighted means of the faces around a vertex, seams included.

    A coarser version is the mesh whose triangles, each split into four, are this one's; while it is
    stepped, the scene has that mesh.
    """

    name = "vertices"
    moves_geometry = True
    deforms = True
    rewrites = True
    uniform = True
    doubtful = True
    undivided = (
        "one level: a mesh has a coarser one where it is closed, has no texture coordinates, seams "
        "or attributes, and where its triangles are quarters of that one's; leave it out"
    )

    @classmethod
    def keys(cls, loaded: Loaded) -> list[str]:
        return [f"{id}.vertices" for id in _meshes(loaded.params)]

    def __init__(self, key: str, loaded: Loaded):
        self.key, self.id = key, key.rpartition(".")[0]
        params = loaded.params
        self.positions, self.faces = f"{self.id}.{_POSITIONS}", f"{self.id}.faces"
        self.normals = f"{self.id}.vertex_normals"
        where = f"scene.unknowns['{key}']"
        if not dr.width(params[self.normals]):
            raise InputError(
                f"{where}: the mesh '{self.id}' has face normals: its shading steps from facet to "
                "facet, which is not differentiated; give it smooth normals (face_normals=false)"
            )
        given = np.array(params[self.normals], np.float64).reshape(-1, 3)
        self._given = given / np.maximum(np.linalg.norm(given, axis=1, keepdims=True), 1e-30)
        positions = np.array(params[self.positions]).reshape(-1, 3)
        faces = np.array(params[self.faces]).reshape(-1, 3).astype(np.int64)
        a, b, c = (positions[faces[:, corner]].astype(np.float64) for corner in range(3))
        if np.einsum("fk,fvk->", np.cross(b - a, c - a), self._given[faces]) < 0:
            raise InputError(
                f"{where}: the normals of the mesh '{self.id}' point the other way than its "
                "triangles turn, as where to_world mirrors, and a shape's normals follow from its "
                "triangles: turn these round in its file, or mirror it there"
            )
        self.topology = Topology.of(positions, faces)
        self.present = positions[self.topology.first].astype(np.float32)
        self.range, self.unit = (-np.inf, np.inf), "scene units"
        self.scale = float(np.abs(self.present).max())
        self._faces, self._latest, self._truth = faces, None, None
        self._crossed = b"", np.zeros(0, np.int64)
        self._elsewhere: list[str] = []
        coordinates = f"{self.id}.vertex_texcoords"
        self._texcoords = (
            np.array(params[coordinates]).reshape(-1, 2) if coordinates in params else np.zeros(0)
        )
        self._mesh = self._shown = Mesh(self.topology, faces)
        self._attributes = [
            k for k in params.keys() if _ATTRIBUTE.fullmatch(k.removeprefix(self.id))
        ]

    @property
    def writes(self) -> list[str]:
        return [self.positions, self.normals, *([self.faces] if self.levels > 1 else [])]

    @cached_property
    def _coarser(self) -> list[tuple[Mesh, Halved]]:
        """From the next to the coarsest: each mesh, and what leads from it to the one before."""
        found, faces, count = [], self.topology.faces, self.topology.count
        if len(self.topology.place) > count or len(self._texcoords) or self._attributes:
            return found
        while (before := coarser(faces, count)) is not None:
            faces, count = before.faces, len(before.kept)
            same = np.arange(count)
            mesh = Mesh(Topology(same, same, faces), faces)
            found.append((mesh, Halved(before)))
        return found

    @property
    def doublings(self) -> int:
        return len(self._coarser)

    @property
    def topologies(self) -> dict[str, dict[int, Topology]]:
        coarse = self._coarser[: self.levels - 1] if self.levels > 1 else []
        meshes = [self._mesh, *(mesh for mesh, _ in coarse)]
        return {self.positions: {len(each.topology.place): each.topology for each in meshes}}

    def _at(self, count: int) -> Mesh:
        """That of so many welded vertices."""
        if count == self.topology.count:
            return self._mesh
        return next(mesh for mesh, _ in self._coarser if mesh.topology.count == count)

    def shape(self, doublings: int) -> tuple[int, ...]:
        if doublings:
            return self._coarser[doublings - 1][0].topology.count, 3
        return self.present.shape

    def coarse(self, array: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
        for _, halved in self._coarser if array.shape != tuple(shape) else ():
            array = array[halved.kept]
            if array.shape == tuple(shape):
                break
        return array

    def fine(self, leaf: mi.TensorXf, shape: tuple[int, ...]) -> mi.TensorXf:
        if leaf.shape[0] == shape[0]:
            return leaf
        for mesh, halved in reversed(self._coarser):
            if leaf.shape[0] == mesh.topology.count < shape[0]:
                leaf = halved.finer(leaf)
        return leaf

    def value(self, array: np.ndarray) -> mi.TensorXf:
        return like(mi.TensorXf, array)

    def write(self, leaf: mi.TensorXf, written: dict) -> None:
        mesh = self._at(leaf.shape[0])
        written[self.positions], written[self.normals] = mesh.arrays(leaf)
        # Mitsuba looks for edges anew where faces are given, so only where they are others. What is
        # written here must reach the scene.
        if self._shown is not mesh:
            written[self.faces], self._shown = mesh.faces, mesh

    def smoothed(self, gradient: np.ndarray) -> np.ndarray:
        """(I + λL)⁻² times ``gradient (V, 3)``, at any level."""
        solve = self._at(len(gradient)).solve
        return solve(solve(gradient.astype(np.float64)))

    def start(self, spec: str, where: str) -> np.ndarray:
        """``sphere``: every vertex on a sphere about the mesh's middle, of its mean radius;
        ``smooth``: without detail; or a PLY or OBJ file with the same faces."""
        if spec == "sphere":
            used, faces = self.topology.used, self.topology.faces[distinct(self.topology.faces)]
            middle = self.present[used].mean(axis=0, dtype=np.float64)
            arms = self.present - middle
            lengths = np.linalg.norm(arms, axis=1, keepdims=True)
            found = middle + arms / np.maximum(lengths, 1e-12) * lengths[used].mean()
            a, b, c = (found[faces[:, corner]] for corner in range(3))
            outward = np.einsum("ij,ij->i", np.cross(b - a, c - a), a + b + c - 3 * middle)
            folded = int(np.sum(outward * np.sign(np.sum(outward)) <= 0))
            if folded:
                raise InputError(
                    f"{where}=sphere: seen from its middle '{self.id}' hides parts of itself, and "
                    f"{folded} of its {len(faces)} triangles would be folded over: take "
                    "start=smooth or a file"
                )
            return found.astype(np.float32)
        if spec == "smooth":
            found = self.present.astype(np.float64)
            for _ in range(5):
                found = self._mesh.solve(found)
            return found.astype(np.float32)
        return self._read(Path(spec), where)

    def _read(self, path: Path, where: str) -> np.ndarray:
        kind = path.suffix.lower().lstrip(".")
        if kind not in ("ply", "obj") or not path.is_file():
            raise InputError(f"{where}={path}: sphere, smooth, or a PLY or OBJ file that exists")
        import trimesh

        try:
            mesh = trimesh.load_mesh(path, process=False, maintain_order=True)
        except Exception as error:  # whatever its readers meet
            raise InputError(f"{where}={path}: {' '.join(str(error).split())}") from error
        read = np.asarray(getattr(mesh, "vertices", np.zeros((0, 3))))
        faces = np.asarray(getattr(mesh, "faces", np.zeros((0, 3), int)))
        check_values(read, np.zeros((0, 2)), faces, f"{where}={path}")
        found, used = self._matched(read, faces, f"{where}={path}"), self.topology.used
        if reason := _unlike(found[used], self.present[used]):
            self._elsewhere = [
                f"start of '{self.key}': {path} {reason} the mesh in the scene: its numbers "
                "are places in the world, after to_world"
            ]
        return found

    def _matched(self, read: np.ndarray, faces: np.ndarray, where: str) -> np.ndarray:
        """The mesh with the places ``read (n, 3)`` of a file, whose ``faces`` are its own: corner
        by corner, or by the vertices' numbers. Raises InputError, which begins with ``where``."""
        own, whole = self.topology.faces, len(self.topology.place)
        if faces.shape == own.shape:
            of = np.zeros(len(read), np.int64)
            of[faces] = own
            if np.array_equal(of[faces], own):
                # Mitsuba numbers an OBJ's vertices as its faces name them, others do not.
                found = self.present.copy()
                found[own] = read[faces]
                return found
        for count, place in ((whole, self.topology.place), (self.topology.count, None)):
            if len(read) != count:
                continue
            welded = faces if place is None else place[faces]
            if not np.array_equal(np.sort(welded), np.sort(own)):
                raise InputError(
                    f"{where} has as many vertices as the mesh '{self.id}', but other faces, or "
                    "the same in another order: the same are needed (of photographs, leave start "
                    "out to begin at photos.mesh)"
                )
            return (read if place is None else read[self.topology.first]).astype(np.float32)
        raise InputError(
            f"{where} has {len(read)} vertices, the mesh '{self.id}' {whole} "
            f"({self.topology.count} places): the same faces are needed"
        )

    def warnings(self) -> list[str]:
        found = self._elsewhere + self._turned()
        found += [f"mesh {self.id}: {flaw}" for flaw in self.topology.flaws()]
        twice = self._twice() if self.topology.edges.open else 0
        if twice:
            found.append(
                f"mesh {self.id}: {twice} of its {self.topology.count} vertices are within "
                f"{_NEARLY:g} of its size of another, and apart: weld them before it is exported"
            )
        crossed = len(self._crossing(self.present))
        if crossed:
            found.append(
                f"mesh {self.id}: {crossed} of its {len(self.topology.faces)} triangles pass "
                "through each other: images step there without an edge, and gradients are biased"
            )
        return found

    def _turned(self) -> list[str]:
        """That it is shaded otherwise than its file says: by the normals of its faces, weighed by
        their areas, not by their angles, as Mitsuba does where a file has none."""
        cosine = np.max(
            [
                np.einsum("vk,vk->v", own[self.topology.place], self._given)
                for own in _normals(self.present.astype(np.float64), self.topology.faces)
            ],
            axis=0,
        )
        off = np.count_nonzero(cosine < _ALIKE)
        if off <= _FEW_TURNED * len(cosine):
            return []
        return [
            f"mesh {self.id}: the normals of its file lie more than 20° beside those of the "
            f"surface at {off} of {len(cosine)} vertices: while its shape is unknown it is "
            "shaded by those of the surface, so that hard edges look round"
        ]

    def _twice(self) -> int:
        """How many vertices have another one that is nearly at their place."""
        points = self.present[self.topology.used]
        near, _ = cKDTree(points).query(points, k=2)
        return int(np.sum(near[:, 1] < _NEARLY * np.ptp(points, axis=0).max()))

    def _crossing(self, array: np.ndarray) -> np.ndarray:
        """``crossing``; the last is kept, as a doubt asks for it after an evaluation."""
        key = array.tobytes()
        if self._crossed[0] != key:
            self._crossed = key, crossing(array, self.topology.faces)
        return self._crossed[1]

    def refusal(self, array: np.ndarray) -> str | None:
        if np.ptp(array, axis=0).max() == 0:
            return "all vertices are at one place: take start=sphere, start=smooth or a file"
        return None

    def error(self, array: np.ndarray, truth: np.ndarray, seen: np.ndarray) -> float:
        """The chamfer distance (``shape_error.apart``)."""
        return self.numbers(array, truth)["chamfer"]

    def numbers(self, array: np.ndarray, truth: np.ndarray | None) -> dict[str, float]:
        """``shape_error.apart`` where there is a truth, ``folded``: ``Topology.folded``, and
        ``crossed``: the share of triangles that pass through others."""
        key = array.tobytes()
        if self._latest is None or self._latest[0] != key:
            found = {"folded": self.topology.folded(array)}
            if not np.isfinite(array).all():
                found |= dict.fromkeys((*MEASURES, "crossed"), float("nan"))
            else:
                found["crossed"] = len(self._crossing(array)) / len(self.topology.faces)
                if truth is not None:
                    found = apart(Sampled.of(array, self.topology.faces), self._true(truth)) | found
            self._latest = key, found
        return self._latest[1]

    def _true(self, truth: np.ndarray) -> Sampled:
        if self._truth is None:
            self._truth = Sampled.of(truth, self.topology.faces, 2)
        return self._truth

    def surface(self, array: np.ndarray, truth: np.ndarray | None) -> Surface:
        distances = None
        if truth is not None:
            distances, _ = self._true(truth).nearest(array.astype(np.float64))
        return Surface(array, self.topology.faces, distances)

    def doubt(self, array: np.ndarray) -> str | None:
        folded = self.topology.folded(array)
        if folded > _FOLDED:
            return (
                f"{folded:.1%} of the edges of '{self.id}' are folded: the mesh has crumpled; take "
                "a smaller rate"
            )
        longer = self._length(array) / self._length(self.present)
        if not 1 / _STRETCHED < longer < _STRETCHED:
            return f"the edges of '{self.id}' are {longer:.3g} times as long as in the scene"
        volumes = [enclosed(each[self.topology.faces]) for each in (array, self.present)]
        if not self.topology.edges.open and np.prod(volumes) < 0:
            return f"'{self.id}' is inside out: start from a mesh turned as the scene's is"
        crossed = len(self._crossing(array)) / len(self.topology.faces)
        if crossed > _FOLDED:
            return (
                f"{crossed:.1%} of the triangles of '{self.id}' pass through each other; take a "
                "smaller rate"
            )
        return None

    def _length(self, array: np.ndarray) -> float:
        """Of the edges, the mean."""
        ends = array[self.topology.edges.ends].astype(np.float64)
        return float(np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1).mean())

    def files(self, array: np.ndarray) -> dict[str, bytes]:
        """PLY of the welded mesh, and OBJ with the file's own vertices and texture coordinates, v
        upwards as in such files."""
        import trimesh

        welded = trimesh.Trimesh(array, self.topology.faces, process=False)
        visual = None
        if len(self._texcoords):
            visual = trimesh.visual.TextureVisuals(uv=upwards(self._texcoords))
        whole = trimesh.Trimesh(
            array[self.topology.place], self._faces, visual=visual, process=False
        )
        text = whole.export(file_type="obj", write_texture=False)
        return {"ply": welded.export(file_type="ply"), "obj": text.encode()}


def _unlike(one: np.ndarray, other: np.ndarray) -> str:
    """How the box around the points ``one (N, 3)`` is unlike that around the ``other``, in words
    that go on to it; or nothing."""
    low, high, least, most = one.min(axis=0), one.max(axis=0), other.min(axis=0), other.max(axis=0)
    if (low > most).any() or (high < least).any():
        return "lies beside"
    larger = np.linalg.norm(high - low) / max(np.linalg.norm(most - least), 1e-30)
    return "" if 0.5 <= larger <= 2 else f"is {larger:.3g} times as large as"


def _meshes(params: mi.SceneParameters) -> list[str]:
    """Ids of the shapes that are meshes."""
    words = [key.rpartition(".") for key in params.keys()]
    ids = [id for id, _, word in words if word == _POSITIONS]
    return [id for id in ids if f"{id}.faces" in params]


def _normals(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Unit normals of welded vertices: of the faces by their areas, and by their angles."""
    corners = [vertices[faces[:, k]] for k in range(3)]
    across = np.cross(corners[1] - corners[0], corners[2] - corners[0])
    unit = across / np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-30)
    sums = np.zeros((2, *vertices.shape))
    for k in range(3):
        a, b = (corners[(k + n) % 3] - corners[k] for n in (1, 2))
        lengths = np.maximum(np.linalg.norm(a, axis=1) * np.linalg.norm(b, axis=1), 1e-30)
        angle = np.arccos(np.clip(np.einsum("fk,fk->f", a, b) / lengths, -1, 1))
        np.add.at(sums[0], faces[:, k], across)
        np.add.at(sums[1], faces[:, k], angle[:, None] * unit)
    first, second = sums / np.maximum(np.linalg.norm(sums, axis=2, keepdims=True), 1e-30)
    return first, second
