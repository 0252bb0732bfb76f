"""The command line: which command, and what its errors look like.

Nothing heavy is imported before a command is known: `isas --help` must answer at once.
"""

from __future__ import annotations

import argparse
import importlib
import os
import sys
import traceback
from pathlib import Path

from .. import __version__
from ..config import searchpath
from ..runtime import interrupt, memory
from ..runtime.errors import InputError, IsasError, nearest

_RUN_HELP = """\
usage: isas run scene=NAME [sampler=NAME] [loss=NAME] [size=NAME] [KEY=VALUE ...]

Recover a scene's unknown parameters from its images and leave a record of it.

  isas run scene=cup                                    one run, by what the scene takes by itself
  isas run scene=pottery sampler=ours                   one run, 60 billed seconds
  isas run scene=pottery sampler=balanced budget.seconds=20 seed=2
  isas run scene=jumpydumpy loss=relative_l2 size=tiny budget.iterations=50
  isas run scene=file scene.path=my.xml 'scene.unknowns={"jar.bsdf.base_color.data": {"start": 0}}'
  isas run scene=pottery hydra.run.dir=DIR              put the record into DIR
  isas run resume=DIR [budget.seconds=120]              go on with a run that ended early
  isas run -m scene=pottery sampler=uniform,ours seed=1,2      one run each, in turn
  isas run scene=pottery --cfg job                      print the configuration and stop
  isas run --config-dir DIR scene=MINE loss=MINE        with choices of your own, DIR/loss/MINE.yaml

Every setting of the printed configuration can be given as KEY=VALUE. ~scene.unknowns.KEY takes an
unknown of the scene's out, ~scene.unknowns all, ~scene.method what the scene takes by itself.
Status: 0 done, 2 bad configuration or input, 3 numerical failure, 130 interrupted."""

_RACE_HELP = """\
usage: isas race scene=NAME samplers=[A,B,…] [seed=[1,2,…]] [KEY=VALUE ...]
       isas race scene=NAME contestants=[{KEY:VALUE,…},{…}] [seed=[1,2,…]] [KEY=VALUE ...]
       isas race scene=A,B [seed=1,2,…] samplers=… [hydra/launcher=NAME] [KEY=A,B ...]
       isas race resume=DIR [budget.seconds=…] [hydra/launcher=NAME]

Let several configurations take turns in one process until each has had the same billed budget,
and compare them. Scene, targets and compiled kernels are shared; a drift of the machine falls on
all alike. Each contestant and seed leaves an ordinary run folder below the race's.

  isas race scene=pottery 'samplers=[uniform,gradient,ours]' budget.seconds=60 'seed=[1,2,3]'
  isas race scene=pottery 'contestants=[{sampler:ours,optimizer.lr:0.01},{sampler:uniform}]'
  isas race scene=pottery 'samplers=[uniform,ours]' hydra.run.dir=DIR slice=0.5
  isas race scene=pottery,bowl seed=1,2,3 samplers=uniform,ours       six races, and one comparison
  isas race scene=pottery,bowl seed=1,2,3 samplers=uniform,ours hydra/launcher=ray

Several values of a setting are several races, every value with every other. Each is held whole, on
one machine; a launcher says on which, as in a sweep. seed=1,2 makes two races, seed=[1,2] one.
They go to runs/races-TIME, or hydra.run.dir=DIR, as <scene>/seed<k>. The same command again, with
its hydra.run.dir, or resume=DIR skips what is done and goes on with what was stopped or lost.

slice is a turn's length in billed seconds (default 1). Everything else is as in isas run --help.
Status: 0 done, 2 bad configuration or input, 3 numerical failure of one, 130 interrupted."""

_VARIANCE_HELP = """\
usage: isas variance scene=NAME [samplers=[A,B,…]] [repeats=1024] [at=0] [best=256] [KEY=VALUE ...]
       isas variance scene=NAME contestants=[{sampler:NAME,sampler.KEY:VALUE,…},{…}] [...]

Estimate the loss gradient at a fixed point again and again with each sampler, equally many pixels
each (estimator.batch), and compare variance, time and efficiency. Nothing is optimised.

  isas variance scene=dodoco                            all samplers, and the best pmf
  isas variance scene=dodoco 'samplers=[uniform,gradient,ours]' at=0.8 estimator.batch=4096
  isas variance scene=dodoco 'contestants=[{sampler:ours,sampler.stage1.average:0.8}]'

repeats  estimates with each sampler; every 16 of them, or a 64th where that is less, get a new look
at       where: 0 the start values, 1 the truth. At the start the images are wrong, and residuals
         say where; at the truth they are noise, and a sampler has nothing to go by but noise.
         An order found at one end need not hold at the other.
best     paths per pixel that measure each pixel's share of the variance, for the best pmf that
         there can be; 0 leaves it out
uniform and gradient are always measured: ratios refer to them. Everything else is as in
isas run --help; what belongs to a run (budget, effects, evaluation, …) is refused.
Status: 0 done, 2 bad configuration or input, 130 interrupted."""

_EFFECTS_HELP = """\
usage: isas effects scene=NAME [KEY=VALUE ...]

Say which light transport a run would simulate, and why: what a probe of at most 3 seconds, and 5 %
of budget.seconds, measures of the images, of the gradient and of the time, with 95 % bounds; checks
of what is met take up to half as long again. Nothing is optimised.

  isas effects scene=pottery
  isas effects scene=earth effects.tolerance=0.02
  isas effects scene=bowl effects.max_depth=2

Settings: effects=auto (default), effects=full, effects.max_depth, effects.derivative_depth,
effects.light_samples, effects.directions, effects.roulette, effects.caustics, effects.tolerance,
effects.derivative_tolerance, effects.finish, effects.probe.
Everything else is as in isas run --help.
Status: 0 done, 2 bad configuration or input, 130 interrupted."""

_UNKNOWNS_HELP = """\
usage: isas unknowns FILE.xml [KEY=VALUE ...] [--json]
       isas unknowns scene=NAME [KEY=VALUE ...] [--json]

List what a scene offers to be found: a row for each key that scene.unknowns takes, with its kind,
its shape, the range that it is kept in where none is given, which estimator takes it, and which
views see it, numbered from 0, with the values that the scene has. Nothing is optimised.

  isas unknowns my.xml
  isas unknowns my.xml scene.max_depth=3
  isas unknowns scene=room_joint size=tiny --json

estimator: two_path stands for all that differentiate paths, silhouettes for what follows shapes,
plateau for what compares renderings. Of what they move it is not asked which views see it.
derivative: what the census of derivatives (benchmarks/derivatives.md) found of such a parameter.
--json prints a list of objects instead of a table, views as a list of numbers.
Status: 0 done, 2 bad configuration or input, 130 interrupted."""

_PHOTOS_HELP = """\
usage: isas photos DIR [photos.mesh=FILE] [photos.KEY=VALUE ...] [output=FILE.png]

Look at photographs with known cameras before a run spends anything on them: a table of the views,
a contact sheet with the object's outline over each, how far known points lie off, and warnings.
Nothing is rendered.

  isas photos my_photos photos.mesh=mug.obj             transforms.json, COLMAP, cameras.json …
  isas photos head                                      a set that comes with isas
  isas run scene=photos photos.path=my_photos photos.mesh=mug.obj      the run that follows

On the sheet the outline is green, known points are red crosses, those found in the picture blue
circles; what does not count is darkened. Settings: scenes/README.md.
Status: 0 done, 2 bad configuration or input."""

# Commands whose arguments are Hydra's, passed on as they are, and their helps.
_UNPARSED = {
    "run": _RUN_HELP,
    "race": _RACE_HELP,
    "variance": _VARIANCE_HELP,
    "effects": _EFFECTS_HELP,
    "unknowns": _UNKNOWNS_HELP,
    "photos": _PHOTOS_HELP,
}
_SUMMARIES = {
    "run": "recover a scene's unknowns (isas run --help)",
    "race": "let configurations take turns at equal time (isas race --help)",
    "variance": "how noisy the gradient is with each sampler (isas variance --help)",
    "effects": "which light transport a run would simulate (isas effects --help)",
    "unknowns": "what a scene offers to be found (isas unknowns --help)",
    "photos": "look at photographs, cameras and mesh before a run (isas photos --help)",
    "compare": "tables, plots and a page over finished runs",
    "watch": "show how a run is going on",
    "scenes": "list the scenes, samplers and losses",
    "doctor": "say whether this machine can run it",
    "replay": "one iteration of a run again: what is not finite in it, and where",
    "landscape": "the loss along a run's unknowns, hard and blurred, and the way it took",
    "report": "write a run's plots and page anew",
    "export": "write a run's result as a scene that Mitsuba renders by itself, and as glTF",
    "relight": "score a run's result on pictures of other places and lights",
}


class _Parser(argparse.ArgumentParser):
    """One line for a wrong argument, like for every other error."""

    def error(self, message: str):
        raise InputError(f"{message}; see {self.prog} --help")


def _path(text: str) -> Path:
    return Path(os.path.expanduser(text))  # a shell does so in some places only


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(
        prog="isas",
        description="Inverse rendering by gradient descent through a path tracer, "
        "and what its accuracy costs in time.",
    )
    parser.add_argument("--version", action="version", version=f"isas {__version__}")
    commands = parser.add_subparsers(dest="command", metavar="COMMAND")
    for command in _UNPARSED:  # here for the list of commands only
        commands.add_parser(command, help=_SUMMARIES[command], add_help=False)
    compare = commands.add_parser("compare", help=_SUMMARIES["compare"])
    compare.add_argument(
        "folders", type=_path, nargs="+", metavar="DIR", help="runs, or folders of runs"
    )
    compare.add_argument(
        "--output",
        type=_path,
        metavar="DIR",
        help="where to (default: DIR/comparison; of several, in the folder that holds them all)",
    )
    compare.add_argument(
        "--baseline", metavar="METHOD", help="what others are set against (default: uniform)"
    )
    watch = commands.add_parser("watch", help=_SUMMARIES["watch"])
    watch.add_argument(
        "folder", type=_path, metavar="DIR", help="a run's folder, or one of several runs"
    )
    watch.add_argument("--once", action="store_true", help="show the present state and leave")
    commands.add_parser("scenes", help=_SUMMARIES["scenes"])
    doctor = commands.add_parser("doctor", help=_SUMMARIES["doctor"])
    doctor.add_argument("--variant", default="auto", help="Mitsuba variant (default: auto)")
    replay = commands.add_parser("replay", help=_SUMMARIES["replay"])
    replay.add_argument("folder", type=_path, metavar="DIR", help="a run's folder")
    replay.add_argument(
        "iteration", nargs="?", metavar="iteration=N", help="which (default: the checkpoint's last)"
    )
    landscape = commands.add_parser("landscape", help=_SUMMARIES["landscape"])
    landscape.add_argument("folder", type=_path, metavar="DIR", help="a run's folder")
    landscape.add_argument(
        "--along", nargs="+", metavar="KEY", help="one or two numbers (default: all, if no more)"
    )
    landscape.add_argument(
        "--spp", type=int, help="paths a pixel and point, twice (default: 32; scene=external: 2)"
    )
    report = commands.add_parser("report", help=_SUMMARIES["report"])
    report.add_argument("folder", type=_path, help="a run's folder")
    export = commands.add_parser("export", help=_SUMMARIES["export"])
    export.add_argument("folder", type=_path, help="a run's folder")
    export.add_argument("--output", type=_path, help="where to (default: FOLDER/result)")
    relight = commands.add_parser("relight", help=_SUMMARIES["relight"])
    relight.add_argument("folder", type=_path, metavar="DIR", help="a run's folder")
    relight.add_argument(
        "pictures",
        type=_path,
        metavar="SET",
        help="a folder of photographs with cameras, or their file in it",
    )
    relight.add_argument(
        "--light",
        type=_path,
        help="an environment in place of the scene's lights, or a folder with one called as each "
        "view (default: the scene's own lights)",
    )
    relight.add_argument(
        "--up",
        help="the world's axis that is its up, such as z, or --up=-z; or camera: its middle lies "
        "straight ahead of each view's camera (default: the run's photos.up)",
    )
    relight.add_argument(
        "--turn",
        type=float,
        help="degrees that it is turned about that axis by (default: the run's photos.turn)",
    )
    relight.add_argument("--width", type=int, help="pixels of renderings (default: the pictures')")
    relight.add_argument("--spp", type=int, default=256, help="paths a pixel (default: 256)")
    relight.add_argument("--output", type=_path, help="where to (default: DIR/relit)")
    return parser


def _dispatch(arguments: list[str]) -> int:
    command = arguments[0] if arguments else ""
    if command in _UNPARSED:
        if {"-h", "--help"} & set(arguments[1:]):
            print(_UNPARSED[command])
            return 0
        return importlib.import_module(f".{command}", __package__).main(arguments[1:])
    if command and not command.startswith("-") and command not in _SUMMARIES:
        raise InputError(f"{command}: no such command; {nearest(command, _SUMMARIES)}")
    given = vars(_parser().parse_args(arguments))
    if (command := given.pop("command")) is not None:
        return importlib.import_module(f".{command}", __package__).main(**given)
    _parser().print_help()
    return 0


def main(arguments: list[str] | None = None) -> int:
    """Entry point. Returns the exit status."""
    try:
        with searchpath.asked(sys.argv[1:] if arguments is None else arguments) as rest:
            return _dispatch(rest)
    except IsasError as error:
        print(f"isas: {' '.join(str(error).splitlines())}", file=sys.stderr)
        return error.status
    except KeyboardInterrupt:
        return _interrupted()
    except BrokenPipeError:
        return _deaf()
    except Exception as error:
        if memory.exhausted(error):
            print(f"isas: {memory.EXHAUSTED}", file=sys.stderr)
            return InputError.status
        traceback.print_exc()
        what = "this is a defect of isas: please report it with the lines above"
        print(f"isas: {what}", file=sys.stderr)
        return 1


def _interrupted() -> int:
    print("isas: interrupted", file=sys.stderr)
    return interrupt.STATUS


def _deaf() -> int:
    """Whoever read the output has gone: say nothing more, also not while Python ends."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    return 1
