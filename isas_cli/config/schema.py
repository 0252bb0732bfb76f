"""The configuration's schema. Values out of range are refused here, before anything starts."""

from __future__ import annotations

import importlib.resources
import math
from dataclasses import dataclass, field, fields
from typing import Any, Dict, List, Optional

from hydra.core.config_store import ConfigStore
from omegaconf import MISSING, DictConfig, OmegaConf

from ..runtime.errors import InputError
from ..runtime.schedule import factor
from . import presets, searchpath
from .meanings import Role, at_least, setting
from .photographs import PhotosConfig

# Dr.Jit counts the lanes of a kernel in 32 bits.
MOST_LANES = 2**31
# Parameters of a lobe that `estimator.derivative_sampling` draws directions for.
ROUGHNESSES = ("roughness", "alpha")


def roughness_of(key: str) -> str | None:
    """Which of ROUGHNESSES an unknown is, by its key: 'roughness' of 'wall.bsdf.roughness.value',
    'alpha' of 'ball.bsdf.alpha'; None for others."""
    return next((word for word in key.split(".")[:-3:-1] if word in ROUGHNESSES), None)


# The scene's numbers are of single precision, and are squared.
_WIDEST = 1e15


@dataclass
class BlurConfig:
    """Width of the Gaussian that ``estimator=plateau`` blurs an unknown with, in the unknown's
    unit: ``start`` up to the share ``hold`` of the budget, then linearly to ``end``, which it is
    from the share ``until`` on: the blurred objective's minimum lies elsewhere than the sharp
    one's, and a learning rate that falls as fast as the width would not arrive. ``reach``: of a
    translation, how far from its middle a part is felt in the images, scene units (None:
    everywhere), for gradients from plain renderings; see ``estimators.locality``."""

    start: float = 0.0
    end: float = 0.0
    hold: float = 0.0
    until: float = 1.0
    reach: Optional[float] = None

    def __post_init__(self) -> None:
        for name in ("start", "end"):
            value = getattr(self, name)
            if not 0 < value <= _WIDEST:
                raise InputError(
                    f"blur.{name}={value}: must be above 0, in the unknown's unit, and at most "
                    f"{_WIDEST:g}"
                )
        if self.end > self.start:
            raise InputError(
                f"blur.end={self.end}: above start={self.start}, but the width falls over the "
                "budget; at most start"
            )
        if not 0 <= self.hold < 1:
            raise InputError(f"blur.hold={self.hold}: a share of the budget, in [0, 1)")
        if not self.hold < self.until <= 1:
            raise InputError(
                f"blur.until={self.until}: a share of the budget, above hold={self.hold}, at most 1"
            )
        if self.reach is not None and not 0 < self.reach < math.inf:
            raise InputError(f"blur.reach={self.reach}: must be above 0, in scene units")


@dataclass
class UnknownConfig:
    """One unknown: start value (number, list, image file, ``{of: other key}`` or ``{uniform: [low,
    high], seed: n}``), legal range, own learning rate, and the blur of ``estimator=plateau``;
    ``during``: the shares of the budget between which it moves, [from, to], or several such stages,
    [from, to, from, to]; outside it keeps its value (None: it always moves); ``schedule`` and
    ``final``: of its own rate, else as ``OptimizerConfig`` says; ``prior``: what the prior's
    weights are multiplied with for it; ``levels``: of a grid or a mesh's vertices, how many
    resolutions it passes through, each twice the last and for twice the time, or the shares of the
    budget at which it doubles."""

    start: Any = None
    # How fast, and within which bounds, an unknown may move is the method's affair.
    range: Optional[List[float]] = setting(None, Role.METHOD)
    lr: Optional[float] = setting(None, Role.METHOD)
    blur: Optional[BlurConfig] = setting(None, Role.METHOD)
    levels: Any = setting(1, Role.METHOD)
    during: Optional[List[float]] = setting(None, Role.METHOD)
    schedule: Optional[str] = setting(None, Role.METHOD)
    final: Optional[float] = setting(None, Role.METHOD)
    prior: float = setting(1.0, Role.METHOD)

    def __post_init__(self) -> None:
        schedule = "constant" if self.schedule is None else self.schedule
        factor(schedule, 1.0 if self.final is None else self.final, 1.0, "")
        if not 0 <= self.prior < math.inf:
            raise InputError(f"prior={self.prior}: a finite factor, at least 0")
        if self.during is not None:
            shares = [0.0, *self.during, 1.0]
            rising = all(a < b for a, b in zip(self.during, self.during[1:]))
            if len(shares) % 2 or len(shares) < 4 or not rising or sorted(shares) != shares:
                raise InputError(
                    f"during={list(self.during)}: shares of the budget, [from, to] or [from, to, "
                    "from, to, …], each larger than the one before, from 0 to 1"
                )


# Which kinds of pose there are, and which ones a setting is of.
_KINDS = ("rotation", "translation", "scale")
_POSE_KINDS = {
    "axis": ("rotation",),
    "origin": ("rotation", "scale"),
    "period": ("rotation",),
    "directions": ("translation",),
}


@dataclass
class PoseConfig:
    """A movement of ``objects`` (ids, or patterns of them), an unknown of a name of its own.

    ``kind``: rotation, by one angle in degrees about ``axis`` through ``origin``; translation, by
    one length, in scene units, along each of ``directions``, whatever their own lengths; or scale,
    about ``origin``, by one number of doublings: 1 is twice as large. ``at``: the value at which
    the scene stands as it was loaded (None: 0). ``parts``: a mesh is as many equal runs of
    vertices, each moved by itself (of several meshes: the first part of each alike, and so on).
    ``period``: the degrees after which a turned object looks the same, by which errors are counted.
    """

    kind: str = MISSING
    objects: List[str] = MISSING
    axis: List[float] = field(default_factory=lambda: [0.0, 1.0, 0.0])
    origin: List[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])
    # OmegaConf would take no whole number for a float inside lists of lists.
    directions: List[Any] = field(
        default_factory=lambda: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
    )
    at: Optional[List[float]] = None
    parts: int = 1
    period: float = 360.0

    def __post_init__(self) -> None:
        if not 0 < self.period <= 360:
            raise InputError(f"pose.period={self.period}: degrees, above 0, at most 360")
        if self.kind not in (MISSING, *_KINDS):
            raise InputError(f"pose.kind={self.kind}: valid: {', '.join(_KINDS)}")
        at_least(1, pose__parts=self.parts)
        usual = {f.name: f.default_factory for f in fields(self) if f.name in _POSE_KINDS}
        usual["period"] = lambda: 360.0
        for name, kinds in _POSE_KINDS.items():
            if self.kind not in (MISSING, *kinds) and getattr(self, name) != usual[name]():
                raise InputError(f"pose.{name}: a {self.kind} has no use for it; leave it out")
        for name in ("objects", "directions"):
            if not getattr(self, name):
                raise InputError(f"pose.{name}=[]: at least one")
        for name, vectors in (
            ("axis", [self.axis]),
            ("origin", [self.origin]),
            ("directions", self.directions),
        ):
            for vector in vectors:
                if not _is_vector(vector) or (name != "origin" and not any(vector)):
                    several = " (a list of such)" if name == "directions" else ""
                    raise InputError(f"pose.{name}: {vector} is no [x, y, z]{several}")


def _is_vector(value) -> bool:
    numbers = isinstance(value, (list, tuple)) and len(value) == 3
    return numbers and all(type(x) in (int, float) and math.isfinite(x) for x in value)


@dataclass
class ExternalConfig:
    """A renderer that is none of Mitsuba's (``scene.outside``): ``function``, such as
    ``module.render``, called as render(parameters, seed, view), gives linear pixels (H, W, 3); or
    ``command``, a command line that writes an EXR, with {out}, {seed}, {view} and each parameter's
    {NAME} in it. ``parameters``: name → number, or numbers: the truth, where targets are rendered.
    ``noisy``: whether another seed gives another picture; ``height``: None: as ``width``."""

    function: Optional[str] = None
    command: Optional[str] = None
    parameters: Dict[str, Any] = field(default_factory=dict)
    width: int = 128
    height: Optional[int] = None
    views: int = 1
    noisy: bool = True

    def __post_init__(self) -> None:
        at_least(1, scene__external__width=self.width, scene__external__views=self.views)
        if self.height is not None:
            at_least(1, scene__external__height=self.height)
        for name, value in self.parameters.items():
            numbers = value if isinstance(value, (list, tuple)) else [value]
            fine = [type(x) in (int, float) and abs(x) < 1e30 for x in numbers]
            if not (fine and all(fine)):
                raise InputError(f"scene.external.parameters.{name}={value}: a number, or a list")
            if name in ("out", "seed", "view", "width", "height"):
                raise InputError(f"scene.external.parameters.{name}: stands for something else")

    def check(self) -> None:
        """Raises InputError where it says too little, or too much."""
        if (self.function is None) == (self.command is None):
            raise InputError(
                "scene=external needs a renderer: give scene.external.function=MODULE.NAME, or "
                "scene.external.command='…', one of them"
            )
        if not self.parameters:
            raise InputError("scene=external: give scene.external.parameters={NAME: VALUE, …}")
        if self.command is not None and "{out}" not in self.command:
            raise InputError(
                f"scene.external.command={self.command}: is to say {{out}}, the EXR that it writes"
            )


@dataclass
class SceneConfig:
    """Where the scene comes from and what in it is unknown. ``weights``: of the views in the loss,
    see scene/weights.py; ``method``: what a run of it takes where nothing else is said, see
    config/method.py. Of ``poses`` and ``unknowns`` null goes before anything is done."""

    # Texts and menus; of the rest the content's hash tells the problem.
    name: str = setting(MISSING, Role.RECORD)
    description: str = setting("", Role.RECORD)
    builder: Optional[str] = None
    sizes: Dict[str, Any] = setting(dict, Role.RECORD)
    method: Optional[Dict[str, Any]] = setting(dict, Role.RECORD)
    arguments: Dict[str, Any] = field(default_factory=dict)
    path: Optional[str] = None
    max_depth: Optional[int] = None
    targets: Optional[List[str]] = None
    masks: Optional[List[str]] = None
    weights: Any = None
    photos: PhotosConfig = field(default_factory=PhotosConfig)
    external: ExternalConfig = field(default_factory=ExternalConfig)
    poses: Dict[str, Optional[PoseConfig]] = field(default_factory=dict)
    unknowns: Dict[str, Optional[UnknownConfig]] = field(default_factory=dict)

    @property
    def outside(self) -> bool:
        """Whether another renderer makes its pictures, whatever the scene is called."""
        return self.external.function is not None or self.external.command is not None

    def __post_init__(self) -> None:
        at_least(-1, scene__max_depth=self.max_depth)


# Of targets, where nothing is said: their first rendering stays a minute or two.
_NOISE = 0.03


@dataclass
class TargetConfig:
    """Rendered targets. ``noise``: the standard deviation of their pixels as a share of their mean
    brightness (``rendering.stratified.noise``; None: 0.03), or instead ``spp``: paths per pixel,
    in the mean. ``seed``: of a stream of their own."""

    noise: Optional[float] = None
    spp: Optional[int] = None
    seed: int = 0

    def __post_init__(self) -> None:
        if self.noise is not None and self.spp is not None:
            raise InputError(
                f"target.noise={self.noise} and target.spp={self.spp}: one of them says how well "
                "targets are rendered; null takes the other out"
            )
        if self.noise is not None and not 1e-4 <= self.noise < 1:
            raise InputError(
                f"target.noise={self.noise}: a share of the brightness, at least 1e-4, below 1"
            )
        if self.spp is not None:
            at_least(1, target__spp=self.spp)
        at_least(0, target__seed=self.seed)

    @property
    def wanted(self) -> Optional[float]:
        """The noise that is wanted, None where paths are counted."""
        return None if self.spp is not None else self.noise or _NOISE


_OF_RUNS = {"shared": True, "looped": True}


@dataclass
class BudgetConfig:
    """When to stop: the first of those given. None of them: 60 billed seconds. ``converged``: also
    where what is left of the images' error is the targets' noise (``engine.floor``)."""

    seconds: Optional[float] = setting(None, Role.METHOD, resumes=True, **_OF_RUNS)
    iterations: Optional[int] = setting(None, Role.METHOD, resumes=True, **_OF_RUNS)
    paths: Optional[float] = setting(None, Role.METHOD, resumes=True, **_OF_RUNS)
    converged: bool = setting(False, Role.METHOD, resumes=True, **_OF_RUNS)


@dataclass
class OptimizerConfig:
    """Adam. ``lr``: of unknowns without a rate of their own, of shapes times a tenth of their
    size; ``factor``: on all rates, those too;
    ``schedule``: constant, cosine or exponential over the budget, down to ``final`` of the rates
    (None: 0.02), or inverse, halved after ``half`` steps; None: inverse, but exponential for
    unknowns that move objects, or whose blur, levels or stages follow the budget, and for all where
    ``final`` is given;
    ``mask_updates``: leave entries alone whose gradient is exactly zero; ``filter``: what
    neighbouring entries of maps and grids do for each other, a choice of ``filters``."""

    lr: float = 0.02
    factor: float = 1.0
    schedule: Optional[str] = None
    final: Optional[float] = None
    half: float = 40.0
    beta_1: float = 0.9
    beta_2: float = 0.999
    mask_updates: bool = True
    # Measurements at a fixed point take no steps.
    filter: Dict[str, Any] = setting(dict, Role.METHOD, looped=True)

    def __post_init__(self) -> None:
        for name in ("lr", "factor"):
            if not (getattr(self, name) > 0 and math.isfinite(getattr(self, name))):
                raise InputError(
                    f"optimizer.{name}={getattr(self, name)}: must be a finite number above 0"
                )
        for name in ("beta_1", "beta_2"):
            if not 0 <= getattr(self, name) <= 0.999999:
                raise InputError(
                    f"optimizer.{name}={getattr(self, name)}: must lie in [0, 0.999999]: numbers "
                    "of 32 bits hardly tell what is nearer to 1 from it"
                )
        factor(*self.falling(), self.half)

    def falling(
        self, paced: bool = False, schedule: str | None = None, final: float | None = None
    ) -> tuple[str, float]:
        """How an unknown's rate falls, and to which share: of one with ``schedule`` and ``final``
        of its own, and ``paced`` by the budget."""
        final = self.final if final is None else final
        usual = "exponential" if paced or final is not None else "inverse"
        schedules = [each for each in (schedule, self.schedule, usual) if each is not None]
        return schedules[0], 0.02 if final is None else final


@dataclass
class EvaluationConfig:
    """Unbilled measuring: times over the run, pixels and paths per pixel each time."""

    count: int = 30
    pixels: int = 262144
    spp: int = 4

    def __post_init__(self) -> None:
        at_least(1, evaluation__count=self.count, evaluation__pixels=self.pixels)
        if self.spp < 2 or self.spp % 2:
            raise InputError(f"evaluation.spp={self.spp}: must be even and at least 2 (two halves)")


@dataclass
class FramesConfig:
    """Pictures at the end: how many views (0: no turntables either), paths per pixel;
    ``snapshots`` on the way, at most."""

    views: int = 4
    spp: int = setting(64, Role.RECORD, looped=True)
    snapshots: int = setting(12, Role.RECORD, looped=True)

    def __post_init__(self) -> None:
        at_least(0, frames__views=self.views, frames__snapshots=self.snapshots)
        at_least(1, frames__spp=self.spp)


@dataclass
class Config:
    """Everything of one run.

    ``size``: tiny, default or paper, which of the scene's sizes; ``seed``: of the run's random
    streams (targets have their own); ``report``: plots and page at the end (``isas report DIR``
    makes them later); ``profile``: measure afterwards where an iteration's time goes; ``tracker``:
    none or tensorboard, where else evaluations and snapshots go; ``variant``: Mitsuba's, auto takes
    cuda_ad_rgb where a GPU works, else llvm_ad_rgb; ``threads``: of the CPU, 0 for all;
    ``overwrite``: replace a run that already lies in the output folder; ``name``: what that is
    called below its scene's and sampler's.
    """

    scene: SceneConfig = setting(SceneConfig, Role.PROBLEM)
    sampler: Dict[str, Any] = setting(dict, Role.METHOD)
    estimator: Dict[str, Any] = setting(dict, Role.METHOD)
    loss: Dict[str, Any] = setting(dict, Role.METHOD)
    prior: Dict[str, Any] = setting(dict, Role.METHOD, looped=True)
    # Measurements at a fixed point have all effects.
    effects: Dict[str, Any] = setting(dict, Role.METHOD, looped=True)
    optimizer: OptimizerConfig = setting(OptimizerConfig, Role.METHOD)
    size: str = setting("default", Role.PROBLEM)
    target: TargetConfig = setting(TargetConfig, Role.PROBLEM)
    budget: BudgetConfig = setting(BudgetConfig, Role.METHOD, **_OF_RUNS)
    seed: int = setting(1, Role.SEED, shared=True)
    evaluation: EvaluationConfig = setting(EvaluationConfig, Role.RECORD, looped=True)
    frames: FramesConfig = setting(FramesConfig, Role.RECORD)
    report: bool = setting(True, Role.RECORD, looped=True)
    profile: bool = setting(False, Role.RECORD, resumes=True, looped=True)
    tracker: str = setting("none", Role.PLACE, resumes=True, **_OF_RUNS)
    name: str = setting(MISSING, Role.PLACE, shared=True)
    variant: str = setting("auto", Role.PLACE, shared=True)
    threads: int = setting(0, Role.PLACE, resumes=True, shared=True)
    overwrite: bool = setting(False, Role.PLACE, shared=True)

    def __post_init__(self) -> None:
        at_least(0, seed=self.seed, threads=self.threads)
        scene = self.scene
        # One's own, with external in its defaults, has another name.
        own = any(each is not None for each in (scene.builder, scene.path, scene.photos.path))
        given = scene.name != "file" and scene.external != ExternalConfig()
        external = scene.name == "external" or not own and (scene.outside or given)
        if scene.photos.path is not None:
            self._of_photographs()
        elif scene.name == "photos":
            raise InputError("scene=photos needs photographs: give photos.path=DIR")
        elif scene.photos != PhotosConfig():
            raise InputError(f"photos.…: only scene=photos has it, not scene={scene.name}")
        elif external:
            scene.external.check()
            for name in ("builder", "path", "max_depth"):
                if (value := getattr(scene, name)) is not None:
                    raise InputError(f"scene.{name}={value}: scene=external has none: leave it out")
        elif scene.builder is None and scene.path is None:
            raise InputError(f"scene={scene.name} needs a file: give scene.path=FILE.xml")
        if not external and scene.external != ExternalConfig():
            raise InputError(f"scene.external.…: only scene=external has it, not {scene.name}")
        if scene.builder is not None:
            if scene.path is not None:
                raise InputError(
                    f"scene.path={scene.path}: only scene=file has it, not scene={scene.name}"
                )
        if not scene.sizes and self.size != Config.size:
            raise InputError(
                f"size={self.size}: scene={scene.name} has no sizes: its films say how large it is"
            )
        presets.check(self.sampler.get("name"), self.estimator.get("name"))
        if scene.targets is None and scene.masks is not None:
            raise InputError("scene.masks needs scene.targets: rendered targets have no masks")
        if scene.targets is not None and self.target != TargetConfig():
            raise InputError("target.… is for rendered targets, but scene.targets are given")

    def _of_photographs(self) -> None:
        """Refuse what is another scene's."""
        for name in ("builder", "path", "targets", "masks"):
            if getattr(self.scene, name) is not None:
                raise InputError(
                    f"photos.path and scene.{name}: photographs or a scene, not both: take "
                    f"scene=photos, or leave photos.… out of scene={self.scene.name}"
                )
        if self.target != TargetConfig():
            raise InputError("target.… is for rendered targets, and these are photographs")


def typed(cfg: DictConfig) -> Config:
    """The configuration as objects, which check what they hold. Raises InputError, and OmegaConf's
    errors for what is missing."""
    for group in ("poses", "unknowns"):
        for key, entry in cfg.scene[group].items():
            if not OmegaConf.is_config(entry):
                raise InputError(f"scene.{group}['{key}']={entry}: no mapping of settings")
            for name in OmegaConf.missing_keys(entry):
                last = name.rpartition(".")[2]
                raise InputError(f"scene.{group}['{key}'].{last} is missing")
            try:
                OmegaConf.to_object(entry)
            except InputError as error:  # an object does not know whose it is
                raise InputError(f"scene.{group}['{key}']: {error}") from None
    return OmegaConf.to_object(cfg)


def register() -> None:
    """Make the schema known to Hydra as ``schema``, and where choices lie."""
    ConfigStore.instance().store(name="schema", node=Config)
    searchpath.register()


def folder() -> str:
    """The folder of the configuration groups, in a checkout as in an installed wheel."""
    return str(importlib.resources.files(searchpath.OWN))
