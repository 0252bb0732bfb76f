"""Nothing grows while a run goes on: kernels, recordings, variables, memory.

Counted over blocks of iterations after a first one that warms up. The short tests see a leak of one
variable, one kernel or one recording; Python's objects and the process's memory have a margin, so
that a slow leak of these is for the long tests. Memory is judged by its growth in a typical block:
an allocator may take tens of megabytes at once and never again, a leak goes on.
"""

import gc
import itertools
import mmap
import re
import sys
from statistics import median_low

import drjit as dr
import mitsuba as mi
import psutil
import pytest
from crosses import some
from poses_for_tests import blurred_problem
from samplers_for_tests import pixel_samplers
from scenes_for_tests import ROUGHNESS, TEXTURE, problem

from isas_cli import losses
from isas_cli.config.compose import compose, instantiate, translate
from isas_cli.config.schema import OptimizerConfig
from isas_cli.engine.evaluate import Evaluator
from isas_cli.engine.loop import Loop
from isas_cli.engine.optimiser import Stepper
from isas_cli.estimators.two_path import TwoPath
from isas_cli.filters.laplacian import Laplacian
from isas_cli.runtime.budget import Budget

BLOCK = 20  # iterations
# Allocators and Python's caches take their time to settle, which looks like growth.
BYTES, OBJECTS = 16 << 20, 10  # in all, and of Python's objects per iteration


@pytest.fixture(autouse=True, scope="module")
def frozen_again():
    """What ``recordings`` unfreezes, when the last test's objects are gone."""
    yield
    gc.collect()
    gc.freeze()


def loop(p, name: str) -> Loop:
    sampler = instantiate(compose(["scene=pottery", f"sampler={name}"]).sampler, "sampler")
    loss, batch = losses.L2(), 256
    looking_often(sampler)
    sampler = sampler.on(p, loss, batch)
    stepper = Stepper(p.unknowns, OptimizerConfig(), Laplacian(coarsest=2))
    evaluator = Evaluator(p, loss, 50, 2, 1)
    budget, estimator = Budget(iterations=10_000), TwoPath(p, loss, batch)
    made = Loop(p, sampler, stepper, evaluator, budget, estimator, 1, 1)
    made.rehearse()
    return made


def looking_often(sampler) -> None:
    """Settings are frozen, and not every sampler takes this one."""
    looking = getattr(sampler, "base", sampler)  # multiresolution looks through another
    if looking.refresh:
        object.__setattr__(looking, "refresh", BLOCK // 4)


def variables() -> int:
    """Variables that Dr.Jit keeps."""
    gc.collect()
    return len(re.findall(r"^ +\d+ ", dr.whos(as_string=True), re.MULTILINE))


def recordings() -> int:
    """Recordings of all frozen functions that there are."""
    gc.unfreeze()  # those of modules are asked for, too
    found = [o for o in gc.get_objects() if isinstance(o, dr.detail.FrozenFunction)]
    return sum(function.n_recordings for function in found)


def block(iterate, first: int, iterations: int) -> dict:
    """Iterations ``first`` …: numbers of kernels launched, by what ``iterate`` returns (the kind
    of iteration); kernels that were not in memory; and what there is at the end."""
    launched, new = {}, 0
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        for i in range(first, first + iterations):
            dr.kernel_history_clear()
            kind = iterate(i)
            dr.sync_thread()
            kernels = dr.kernel_history()
            launched.setdefault(kind, set()).add(len(kernels))
            new += sum(
                "cache_hit" in k and (not k["cache_hit"] or k["cache_disk"]) for k in kernels
            )
    size = psutil.Process().memory_info().rss
    return {
        "launched": launched,
        "new kernels": new,
        "recordings": recordings(),
        "variables": variables(),
        "objects": sys.getallocatedblocks(),
        "bytes": size,
    }


def growth(iterate, iterations: int = 3 * BLOCK, length: int = BLOCK) -> list[str]:
    """What grows between the blocks after the first."""
    starts = range(0, iterations + length, length)
    blocks = [block(iterate, start, length) for start in starts][1:]
    print(blocks)
    first, last = blocks[0], blocks[-1]
    grown = [name for name in ("recordings", "variables") if first[name] != last[name]]
    launched = {}
    for each in blocks:
        for kind, numbers in each["launched"].items():
            launched.setdefault(kind, set()).update(numbers)
    if any(len(numbers) > 1 for numbers in launched.values()):
        grown.append("launched")
    if any(each["new kernels"] for each in blocks):
        grown.append("new kernels")
    if last["objects"] - first["objects"] > OBJECTS * iterations:
        grown.append("objects")
    typical = median_low(b["bytes"] - a["bytes"] for a, b in itertools.pairwise(blocks))
    if typical * (len(blocks) - 1) > BYTES:
        grown.append("bytes")
    return grown


def iterations_of(name: str):
    """A loop, and what iterates it and says whether there was a look."""
    p = problem({TEXTURE: 0.5, ROUGHNESS: 0.6})
    running = loop(p, name)

    def iterate(i: int) -> bool:
        looks = running.sampler.settings.due(running.position.iteration)
        running._iterate()
        return looks

    return running, iterate


@pytest.mark.parametrize("name", some(pixel_samplers(), ("uniform", "preconditioned", "progress")))
def test_nothing_grows(name):
    running, iterate = iterations_of(name)
    assert growth(iterate) == []
    running.problem.unknowns.write(running.stepper.values)


@pytest.mark.slow
@pytest.mark.parametrize("name", pixel_samplers())
def test_nothing_grows_over_2000_iterations(name):
    running, iterate = iterations_of(name)
    assert growth(iterate, 2000, 100) == []
    running.problem.unknowns.write(running.stepper.values)


kept: list = []
frozen = dr.freeze(lambda x, i: x + i)


def literal(i: int) -> None:
    """A Python number per iteration: each compiles a kernel."""
    dr.eval(dr.arange(mi.Float, 77) * (i + 0.123))


def recorded(i: int) -> None:
    """A Python number handed to a frozen function: each is a recording."""
    frozen(dr.opaque(mi.Float, 1, 55), i)


def more_and_more(i: int) -> None:
    """A kernel more with every iteration."""
    for k in range(i):
        dr.eval(dr.arange(mi.Float, 33) * dr.opaque(mi.Float, k))


def one_kept(i: int) -> None:
    """A small array per iteration that nobody lets go of."""
    kept.append(dr.opaque(mi.Float, i))


def objects_kept(i: int) -> None:
    """Some Python objects per iteration."""
    kept.append([float(k) + i for k in range(50)])


def memory_kept(i: int) -> None:
    """Two megabytes per iteration that Python does not know of; fresh from the system, as memory
    that earlier tests gave back would hide it."""
    kept.append(mmap.mmap(-1, 2 << 20))
    kept[-1].write(b"x" * (2 << 20))


@pytest.mark.parametrize(
    "leak, seen",
    [
        (literal, {"new kernels"}),
        (recorded, {"recordings"}),
        (more_and_more, {"launched"}),
        (one_kept, {"variables"}),
        (objects_kept, {"objects"}),
        (memory_kept, {"bytes"}),
    ],
)
def test_growth_is_noticed(leak, seen):
    try:
        found = set(growth(leak, 2 * BLOCK))
    finally:
        kept.clear()
        frozen.clear()
    assert seen <= found


def test_a_seed_that_is_a_literal_is_noticed():
    """In the loop itself: the mistake that an estimator's seeds invite."""
    running, iterate = iterations_of("uniform")

    def careless(i: int) -> bool:
        rng = mi.PCG32(size=64, initstate=i)
        dr.eval(rng.next_float32())
        return iterate(i)

    assert "new kernels" in growth(careless)
    running.problem.unknowns.write(running.stepper.values)


@pytest.mark.parametrize(
    "settings",
    [
        ["sampler=plateau", "sampler.base=differences"],
        pytest.param(["sampler=mitsuba"], marks=pytest.mark.slow),
        pytest.param(["sampler=plateau", "sampler.smooth=loss"], marks=pytest.mark.slow),
        pytest.param(["sampler=finite_differences"], marks=pytest.mark.slow),
    ],
    ids=" ".join,
)
def test_nothing_grows_while_objects_move(settings):
    """The scene is updated several times a step, its acceleration structure built as often."""
    p = blurred_problem()
    cfg = compose(translate(["scene=cup", *settings, "estimator.batch=256"]))
    sampler, settings = (instantiate(cfg[name], name) for name in ("sampler", "estimator"))
    loss = losses.L2()
    looking_often(sampler)
    evaluator = Evaluator(p, loss, 50, 2, 1)
    estimator = settings.on(p, loss)
    looks = settings.looks(sampler, estimator.problem, loss)
    stepper, budget = Stepper(p.unknowns, OptimizerConfig()), Budget(iterations=10_000)
    running = Loop(p, looks, stepper, evaluator, budget, estimator, 1, 1)
    running.rehearse()

    def iterate(i: int) -> bool:
        looks = sampler.due(running.position.iteration)
        running._iterate()
        return looks

    assert growth(iterate) == []
    p.unknowns.write(running.stepper.values)
