"""Hard cases as runs: a small scene that provokes something, and what must hold at its end.

A case is a scene file, its unknowns and what is close enough; every run of it must end with numbers
that are finite and within their ranges, with a loss no larger than at the start, and with every
value that was not finite counted. To add one, add a line to ``CASES``, here or in another
``hard_*.py`` beside this file.
"""

from __future__ import annotations

import importlib
import json
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import trimesh

import isas_cli
from isas_cli.records import Run
from isas_cli.runtime import images

REFLECTANCE = "thing.bsdf.reflectance.value"
SKY = '<emitter type="constant" id="sky"><rgb name="radiance" value="1"/></emitter>'
MAP = """<emitter type="envmap" id="sky"><string name="filename" value="sky.exr"/></emitter>"""
GREY = '<bsdf type="diffuse"><rgb name="reflectance" value="0.5"/></bsdf>'
BALL = '<shape type="sphere" id="thing"><float name="radius" value="0.8"/>{bsdf}</shape>'
PATHS = '<integrator type="path"><integer name="max_depth" value="{depth}"/></integrator>'
SCENE = """<scene version="3.0.0">
  {integrator}
  <sensor type="perspective" id="camera">
    <float name="fov" value="30"/>
    <transform name="to_world"><lookat origin="{origin}" target="0,0,0" up="0,1,0"/></transform>
    <film type="hdrfilm">
      <integer name="width" value="{side}"/><integer name="height" value="{side}"/>
      <rfilter type="box"/>
    </film>
  </sensor>
  {emitter}{shapes}
</scene>"""
# The cheapest run that finds a number: what is hard is the case.
SETTINGS = [
    *("scene=file", "sampler=uniform", "estimator.batch=1024", "budget.iterations=120"),
    *("optimizer.lr=0.05", "optimizer.schedule=exponential"),
    *("target.spp=256", "evaluation.pixels=256", "evaluation.spp=16"),
    *("evaluation.count=4", "frames.views=0", "frames.snapshots=0", "report=false", "effects=full"),
]


@dataclass(frozen=True)
class Case:
    """``provokes``: what is hard about it; ``unknowns``: as in scene.unknowns; ``within``: the
    largest final parameter error, in the unknowns' own unit; ``below``: other columns of the
    history, each with a bound of its end; ``sky``: pixels of an environment map,
    ``(H, W, 3)``; ``bumps``: of a normal map, ``(H, W, 3)``; ``side``: of the film, pixels;
    ``poses``: as in scene.poses; ``warns``: what it warns of, of two with | between either;
    ``sure``: whether it does on every machine (where a mesh crumples by chance, rounding decides);
    ``settings``: beyond SETTINGS; ``meshes``: vertices and faces by the name of a PLY file, which
    ``{folder}`` in a start stands before; ``files``: others, by name; ``integrator``: the file's;
    ``estimator``: settings that another sampler brings instead. The figures seen:
    benchmarks/results/hard_cases.md."""

    name: str
    provokes: str
    unknowns: dict
    within: float
    emitter: str = SKY
    shapes: str = BALL
    bsdf: str = GREY
    origin: str = "0,0,4"
    depth: int = 3
    sky: np.ndarray | None = None
    bumps: np.ndarray | None = None
    side: int = 16
    poses: dict = field(default_factory=dict)
    warns: str = ""
    below: dict[str, float] = field(default_factory=dict)
    sure: bool = True
    settings: tuple[str, ...] = field(default=())
    meshes: dict[str, tuple] = field(default_factory=dict)
    files: dict[str, bytes] = field(default_factory=dict)
    integrator: str = PATHS
    estimator: tuple[str, ...] = ()

    def run(self, folder: Path, *settings: str) -> Run:
        """Runs it in ``folder``, with ``settings`` beyond its own."""
        folder.mkdir(parents=True, exist_ok=True)
        for name, pixels in (("sky.exr", self.sky), ("bumps.exr", self.bumps)):
            if pixels is not None:
                images.write_exr(folder / name, pixels.astype(np.float32), [*"RGB"], {})
        for name, (vertices, faces) in self.meshes.items():
            trimesh.Trimesh(vertices, faces, process=False).export(folder / name)
        for name, content in self.files.items():
            (folder / name).write_bytes(content)
        shapes = self.shapes.format(bsdf=self.bsdf)
        places = {"origin": self.origin, "side": self.side}
        places["integrator"] = self.integrator.format(depth=self.depth)
        text = SCENE.format(emitter=self.emitter, shapes=shapes, **places)
        (folder / "scene.xml").write_text(text)
        own = [f"scene.path={folder / 'scene.xml'}", f"hydra.run.dir={folder / 'run'}"]
        unknowns = json.dumps(self.unknowns).replace("{folder}", str(folder))
        own.append(f"scene.unknowns={unknowns}")
        if not any(each.startswith("sampler=") for each in settings):
            own += self.estimator
        own += [f"scene.poses={json.dumps(self.poses)}"] if self.poses else []
        return isas_cli.run(*SETTINGS, *own, *self.settings, *settings)


def everywhere() -> list[Case]:
    """All cases, of this file and of the others of its kind."""
    names = sorted(path.stem for path in Path(__file__).parent.glob("hard_*.py"))
    modules = [importlib.import_module(name) for name in names]
    return [case for module in modules for case in getattr(module, "CASES", [])]


def _sky(value: float = 1.0, **texels: float) -> np.ndarray:
    """A map of one value, with others at some texels: ``bright=1e6``."""
    sky = np.full((16, 32, 3), value)
    for row, texel in enumerate(texels.values()):
        sky[4, 6 + 4 * row] = texel
    return sky


def _principled(**values) -> str:
    numbers = "".join(f'<float name="{k}" value="{v}"/>' for k, v in values.items())
    return f'<bsdf type="principled"><rgb name="base_color" value="0.5"/>{numbers}</bsdf>'


def start(key: str, value: float, **more) -> dict:
    return {key: {"start": value, **more}}


def _steep(side: int = 8) -> np.ndarray:
    """A normal map whose normals lean over by 80 degrees, each away from its neighbours'."""
    row, column = np.mgrid[:side, :side]
    away = np.radians(80) * (1 - 2 * ((row + column) % 2))
    normals = np.stack([np.sin(away), 0 * away, np.cos(away)], axis=-1)
    return (normals + 1) / 2


def _waves(degrees: float, side: int = 8) -> np.ndarray:
    """A normal map whose normals lean this way and that, up to so much."""
    row, column = np.mgrid[:side, :side]
    x = np.radians(degrees) * np.sin(1.3 * column + 0.7 * row)
    y = np.radians(degrees) * np.cos(0.8 * column - 1.1 * row)
    normals = [np.sin(x), np.sin(y) * np.cos(x), np.cos(x) * np.cos(y)]
    return (np.stack(normals, axis=-1) + 1) / 2


def _coloured() -> np.ndarray:
    """A map of one colour from above, another from the right, another from ahead."""
    row, column = np.mgrid[:16, :32] / np.array([16, 32])[:, None, None]
    ahead = np.abs(column - 0.5) < 0.25
    lit = [2 * (row < 0.5), 1.5 * (column > 0.5), 1.5 * ahead]
    return np.stack(lit, axis=-1) + 0.2


WALL = """<shape type="rectangle" id="thing"><transform name="to_world"><scale value="0.9"/>
  </transform>{bsdf}</shape>"""
BUMPED = f"""<bsdf type="normalmap"><texture type="bitmap" name="normalmap">
  <boolean name="raw" value="true"/><string name="filename" value="bumps.exr"/>
  <string name="filter_type" value="nearest"/></texture>{GREY}</bsdf>"""
GREY_FROM = start(REFLECTANCE, 0.2)
BASE_FROM = start("thing.bsdf.base_color.value", 0.2)
FLOOR = """<shape type="rectangle" id="thing"><transform name="to_world">
  <scale value="4"/><rotate x="1" angle="-90"/></transform>{bsdf}</shape>"""

PLATE = """<shape type="rectangle" id="thing"><transform name="to_world">
  <scale x="0.5" y="0.15"/><translate x="0.4"/></transform>{bsdf}</shape>"""
BLURRED = ("sampler=plateau", "estimator.batch=512", "estimator.spp=4", "optimizer.schedule=cosine")


def _turn(degrees: float, **blur) -> dict:
    return start("turn", degrees, lr=2.0, blur=blur)


CASES = [
    Case("plain", "nothing: what the others are measured against", GREY_FROM, 0.01),
    Case(
        *("one-texel sun", "a texel of 1e6 among ones", GREY_FROM, 0.01),
        emitter=MAP,
        sky=_sky(bright=1e6),
    ),
    Case(
        *("Inf texel", "a light without bound", GREY_FROM, 0.02),
        emitter=MAP,
        sky=_sky(bright=np.inf),
        warns="not finite",
    ),
    Case(
        *("negative texels", "light below zero", GREY_FROM, 0.02),
        emitter=MAP,
        sky=_sky(one=-0.5, two=-1.0),
    ),
    Case(
        *("dim", "radiances of 1e-6, losses of 1e-12", GREY_FROM, 0.01),
        emitter=SKY.replace('value="1"', 'value="1e-6"'),
    ),
    Case(
        *("dazzling", "radiances of 1e6, losses of 1e12", GREY_FROM, 0.01),
        emitter=SKY.replace('value="1"', 'value="1e6"'),
    ),
    Case(
        *("light goes out", "a sky that is black in truth"),
        start("sky.radiance.value", 0.5),
        *(0.01,),
        emitter=SKY.replace('value="1"', 'value="0"')
        + '<emitter type="point"><point name="position" x="2" y="2" z="3"/>'
        + '<rgb name="intensity" value="10"/></emitter>',
    ),
    Case(
        "white",
        "base colour 1, the end of its range",
        BASE_FROM,
        0.02,
        bsdf=_principled().replace('"0.5"', '"1"'),
    ),
    Case(
        "black",
        "base colour 0, the end of its range",
        BASE_FROM,
        0.02,
        bsdf=_principled().replace('"0.5"', '"0"'),
    ),
    Case(
        "polished",
        "roughness 0.001, below what is legal",
        BASE_FROM,
        0.03,
        bsdf=_principled(roughness=0.001),
    ),
    Case("rough", "roughness 1", BASE_FROM, 0.02, bsdf=_principled(roughness=1)),
    Case(
        "metal",
        "metallic 1: no diffuse lobe",
        BASE_FROM,
        0.03,
        bsdf=_principled(metallic=1, roughness=0.5),
    ),
    Case(
        "no lobes",
        "clearcoat and sheen of 0",
        BASE_FROM,
        0.02,
        bsdf=_principled(clearcoat=0, sheen=0),
    ),
    Case(
        *("grazing", "a floor seen at one degree", GREY_FROM, 0.02),
        shapes=FLOOR,
        origin="0,0.07,4",
    ),
    Case(
        *(
            "inside out",
            "a two-sided ball with its normals inwards",
            {"thing.bsdf.brdf_0.reflectance.value": {"start": 0.2}},
            0.01,
        ),
        shapes=BALL.replace("{bsdf}", '<boolean name="flip_normals" value="true"/>{bsdf}'),
        bsdf=f'<bsdf type="twosided">{GREY}</bsdf>',
    ),
    Case(
        *(
            "index near 1",
            "glass that hardly refracts, before what is unknown",
            GREY_FROM,
            0.03,
        ),
        shapes=BALL + '<shape type="sphere" id="shell"><bsdf type="dielectric">'
        '<float name="int_ior" value="1.0001"/><float name="ext_ior" value="1"/></bsdf></shape>',
        depth=8,
    ),
    Case(
        *("fireflies", "a lamp seen by a diffuse ball through glass only", GREY_FROM, 0.15),
        emitter='<shape type="sphere"><point name="center" x="3" y="3" z="3"/>'
        '<float name="radius" value="1.5"/><emitter type="area"><rgb name="radiance" value="20"/>'
        "</emitter></shape>",
        shapes=BALL + '<shape type="sphere" id="shell"><bsdf type="dielectric"/></shape>',
        depth=8,
        # Of the truth itself: of fewer paths the targets' own fireflies decide.
        settings=("loss=relative_l2", "estimator.batch=4096", "target.spp=4096"),
    ),
    Case(
        "rate 100",
        "steps a hundred ranges long",
        GREY_FROM,
        0.15,  # its steps cross the whole range and enlarge any rounding: 0.004 to 0.06 seen
        settings=("optimizer.lr=100",),
    ),
    Case(
        "memory of Adam",
        "β₂ = 0.999999",
        GREY_FROM,
        0.01,
        settings=("optimizer.beta_2=0.999999",),
    ),
    Case(
        *("one pixel", "a view of 1 × 1", GREY_FROM, 0.02),
        side=1,
        settings=("evaluation.spp=64", "target.spp=4096"),
    ),
    Case(
        *("solved", "residuals that are noise alone, to a sampler that looks at them"),
        start(REFLECTANCE, 0.5),
        *(0.02,),
        settings=("sampler=progress",),
    ),
    Case(
        *("looks without end", "a look before every step", GREY_FROM, 0.02),
        settings=("sampler=ours", "sampler.refresh=1"),
    ),
    Case(
        *("mirror in truth", "a roughness whose truth is the lowest that is legal"),
        start("thing.bsdf.roughness.value", 0.5),
        *(0.05,),
        bsdf=_principled(roughness=0.03, metallic=1),
        emitter=MAP,
        sky=_sky(one=100, two=100),
        settings=("estimator.batch=4096",),
    ),
    Case(
        *("all metal", "metallic at its end, from far away"),
        start("thing.bsdf.metallic.value", 0.2),
        *(0.1,),
        bsdf=_principled(roughness=0.5, metallic=1),
        emitter=MAP,
        sky=_sky(one=100, two=100),
        settings=("estimator.batch=4096",),
    ),
    Case(
        *("across 180°", "an angle of 175° from one of -175°", _turn(-175.0, start=10, end=1), 2),
        shapes=PLATE,
        poses={"turn": {"kind": "rotation", "objects": ["thing"], "axis": [0, 0, 1], "at": [175]}},
        settings=BLURRED,
    ),
    Case(
        *("a blur of nearly nothing", "σ of 1e-6 degrees, differences of rounding's size"),
        _turn(3.0, start=5, end=1e-6),
        *(1.0,),
        shapes=PLATE,
        poses={"turn": {"kind": "rotation", "objects": ["thing"], "axis": [0, 0, 1]}},
        warns="single precision resolves no less",
        settings=BLURRED,
    ),
    Case(
        *("unlike units", "an angle of some degrees beside a shift of some thousandths"),
        _turn(20.0, start=10, end=1)
        | start("shift", 5e-3, lr=4e-4, blur={"start": 3e-3, "end": 4e-4}),
        *(0.2,),
        shapes=PLATE,
        poses={
            "turn": {"kind": "rotation", "objects": ["thing"], "axis": [0, 0, 1]},
            "shift": {
                "kind": "translation",
                "objects": ["thing"],
                "directions": [[0, 100, 0]],
            },
        },
        settings=BLURRED,
    ),
    Case(
        *("differences across 180°", "the same by finite differences, as wide as the blur"),
        *(_turn(-175.0, start=10, end=1), 2),
        shapes=PLATE,
        poses={"turn": {"kind": "rotation", "objects": ["thing"], "axis": [0, 0, 1], "at": [175]}},
        settings=("sampler=finite_differences", *BLURRED[1:]),
    ),
    Case(
        *("a map goes out", "an environment map that is black in truth, but for one faint texel"),
        *(start("sky.data", 0.5), 0.05),
        emitter=MAP,
        sky=_sky(0.0, one=1e-3),
        settings=("optimizer.lr=0.03", "estimator.batch=4096"),
    ),
    Case(
        *("brightness to trade", "a light and a colour, of which images tell the product alone"),
        *({"sky.radiance.value": {"start": 0.5}, REFLECTANCE: {"start": 0.2}}, 1.0),
        shapes=FLOOR,
        origin="0,3,2",
        warns="can trade brightness",
    ),
    Case(
        *("maps to trade", "a sky's map and a texture, of which images tell products alone"),
        *({"sky.data": {"start": 0.5}, "thing.bsdf.reflectance.data": {"start": 0.2}}, 0.75),
        emitter=MAP,
        sky=_coloured(),
        shapes=FLOOR,
        bsdf='<bsdf type="diffuse"><texture type="bitmap" name="reflectance">'
        '<boolean name="raw" value="true"/><string name="filename" value="bumps.exr"/>'
        "</texture></bsdf>",
        bumps=0.1 + 0.6 * _waves(80),
        origin="0,3,2",
        warns="can trade brightness",
        below={"value/thing.bsdf.reflectance.data/scaled": 0.1},  # 0.16 at the start
        settings=("estimator.batch=4096",),
    ),
    Case(
        *("a speck", "one pixel tells of the unknown, the residuals of all others are 0"),
        *(GREY_FROM, 0.05),
        shapes=BALL.replace('"0.8"', '"0.06"'),
        warns="the sampling density is not to be trusted",
        settings=("sampler=ours", "estimator.batch=4096"),
    ),
    Case(
        *("steep bumps", "a normal map whose normals lean by 80°, the other way at each texel"),
        *(start("thing.bsdf.nested_bsdf.reflectance.value", 0.2), 0.02),
        bsdf=BUMPED,
        bumps=_steep(),
    ),
    Case(
        *("bumps to find", "a normal map is unknown, which one view tells of by the sky's colours"),
        *(start("thing.bsdf.normalmap.data", [0.5, 0.5, 1.0], range=[0, 1]), 0.07),
        emitter=MAP,
        sky=_coloured(),
        shapes=WALL,
        bsdf=BUMPED,
        bumps=_waves(25),
        warns="not right everywhere",
        settings=("optimizer.lr=0.02", "estimator.batch=4096"),
    ),
    Case(
        *("no metal", "metallic 0, the other end of its range"),
        *(start("thing.bsdf.metallic.value", 0.5), 0.1),
        bsdf=_principled(roughness=0.5, metallic=0),
        emitter=MAP,
        sky=_sky(one=100, two=100),
        settings=("estimator.batch=4096",),
    ),
    Case(
        *("mirror by derivatives", "a lobe drawn for its derivative, down to the least roughness"),
        *(start("thing.bsdf.roughness.value", 0.5), 0.05),
        bsdf=_principled(roughness=0.03, metallic=1),
        emitter=MAP,
        sky=_sky(one=100, two=100),
        settings=("estimator.batch=4096", "estimator.derivative_sampling=true"),
    ),
    Case(
        *("a chequer", "a texture of texels at both ends of their range, each beside the other"),
        *(start("thing.bsdf.base_color.data", 0.5), 0.05),
        bsdf='<bsdf type="principled"><texture type="bitmap" name="base_color">'
        '<boolean name="raw" value="true"/><string name="filename" value="bumps.exr"/>'
        '<string name="filter_type" value="nearest"/></texture></bsdf>',
        shapes='<shape type="rectangle" id="thing">{bsdf}</shape>',
        bumps=np.broadcast_to((np.indices((8, 8)).sum(0) % 2)[..., None], (8, 8, 3)),
        settings=("sampler=progress", "estimator.batch=4096"),
    ),
    Case(
        *("hardly a step", "a rate of 1e-12: nothing moves, and nothing else happens"),
        *(GREY_FROM, 0.301),
        settings=("optimizer.lr=1e-12",),
        warns="image_rmse did not fall",
    ),
    Case(
        *("phong", "three numbers of one lobe at once, which can stand for each other"),
        {f"thing.bsdf.{x}.value": {"start": 0.5} for x in ("diffuse", "specular", "roughness")},
        *(0.1,),
        bsdf='<bsdf type="phong"><rgb name="diffuse" value="0.2, 0.3, 0.1"/>'
        '<rgb name="specular" value="0.4"/><float name="roughness" value="0.25"/></bsdf>',
        emitter=MAP,
        sky=_sky(0.2, one=50, two=50),
        settings=("estimator.batch=4096",),
    ),
]
