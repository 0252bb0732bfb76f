"""The configuration's schema, its composition by Hydra, and readable complaints about it."""

from __future__ import annotations

import importlib.resources
from dataclasses import dataclass, field
from typing import Any, Dict, List, Optional

from hydra.core.config_store import ConfigStore
from omegaconf import MISSING



@dataclass
class UnknownConfig:
    """One unknown: start value (number, list or image file), legal range, own learning rate."""

    start: Any = None
    range: Optional[List[float]] = None
    lr: Optional[float] = None


@dataclass
class SceneConfig:
    """Where the scene comes from and what in it is unknown."""

    name: str = MISSING
    description: str = ""
    builder: Optional[str] = None
    sizes: Dict[str, Any] = field(default_factory=dict)
    arguments: Dict[str, Any] = field(default_factory=dict)
    path: Optional[str] = None
    max_depth: Optional[int] = None
    targets: Optional[List[str]] = None
    masks: Optional[List[str]] = None
    unknowns: Dict[str, UnknownConfig] = field(default_factory=dict)


@dataclass
class TargetConfig:
    """Rendered targets: paths per pixel, and the seed of a stream of their own."""

    spp: int = 128
    seed: int = 0


@dataclass
class BudgetConfig:
    """When to stop: the first of those given. None of them: 60 billed seconds."""

    seconds: Optional[float] = None
    iterations: Optional[int] = None
    paths: Optional[float] = None


@dataclass
class OptimizerConfig:
    """Adam. ``schedule``: constant, cosine or exponential over the budget, down to ``final`` of
    ``lr``; ``mask_updates``: leave entries alone whose gradient is exactly zero."""

    lr: float = 0.02
    schedule: str = "exponential"
    final: float = 0.02
    beta_1: float = 0.9
    beta_2: float = 0.999
    mask_updates: bool = True


@dataclass
class EstimatorConfig:
    """Pixels drawn per step (two light paths each); ``freeze``: record kernels once."""

    batch: int = 65536
    freeze: bool = True


@dataclass
class EvaluationConfig:
    """Unbilled measuring: times over the run, pixels and paths per pixel each time."""

    count: int = 30
    pixels: int = 262144
    spp: int = 8


@dataclass
class FramesConfig:
    """Pictures at the end: how many views, paths per pixel."""

    views: int = 4
    spp: int = 64


@dataclass
class Config:
    """Everything of one run."""

    scene: SceneConfig = field(default_factory=SceneConfig)
    sampler: Dict[str, Any] = field(default_factory=dict)
    loss: Dict[str, Any] = field(default_factory=dict)
    size: str = "default"
    name: str = MISSING
    seed: int = 1
    variant: str = "auto"
    threads: int = 0
    overwrite: bool = False
    budget: BudgetConfig = field(default_factory=BudgetConfig)
    target: TargetConfig = field(default_factory=TargetConfig)
    optimizer: OptimizerConfig = field(default_factory=OptimizerConfig)
    estimator: EstimatorConfig = field(default_factory=EstimatorConfig)
    evaluation: EvaluationConfig = field(default_factory=EvaluationConfig)
    frames: FramesConfig = field(default_factory=FramesConfig)


def register() -> None:
    """Make the schema known to Hydra as ``schema``."""
    ConfigStore.instance().store(name="schema", node=Config)


def folder() -> str:
    """The folder of the configuration groups, in a checkout as in an installed wheel."""
    return str(importlib.resources.files("isas_cli.configs"))
