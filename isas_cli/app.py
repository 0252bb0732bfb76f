"""The command line: which command, and what its errors look like.

Nothing heavy is imported before a command is known: `isas --help` must answer at once.
"""

from __future__ import annotations

import argparse
import os
import sys
import traceback

from . import __version__, interrupt
from .errors import InputError, IsasError, nearest

_RUN_HELP = """\
usage: isas run scene=NAME [sampler=NAME] [loss=NAME] [size=NAME] [KEY=VALUE ...]

Recover a scene's unknown parameters from its images and leave a record of it.

  isas run scene=pottery sampler=ours                   one run, 60 billed seconds
  isas run scene=pottery sampler=balanced budget.seconds=20 seed=2
  isas run scene=jumpydumpy loss=relative_l2 size=tiny budget.iterations=50
  isas run scene=file scene.path=my.xml 'scene.unknowns={"jar.bsdf.base_color.data": {"start": 0}}'
  isas run scene=pottery hydra.run.dir=DIR              put the record into DIR
  isas run -m scene=pottery sampler=uniform,ours seed=1,2      one run each, in turn
  isas run scene=pottery --cfg job                      print the configuration and stop

Every setting of the printed configuration can be given as KEY=VALUE.
Status: 0 done, 2 bad configuration or input, 3 numerical failure, 130 interrupted."""


_SUMMARIES = {
    "run": "recover a scene's unknowns (isas run --help)",
    "scenes": "list the scenes, samplers and losses",
    "doctor": "say whether this machine can run it",
    "report": "write a run's plots and page anew",
}


class _Parser(argparse.ArgumentParser):
    """One line for a wrong argument, like for every other error."""

    def error(self, message: str):
        raise InputError(f"{message}; see {self.prog} --help")


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(
        prog="isas",
        description="Inverse rendering by gradient descent through a path tracer, "
        "and what its accuracy costs in time.",
    )
    parser.add_argument("--version", action="version", version=f"isas {__version__}")
    commands = parser.add_subparsers(dest="command", metavar="COMMAND")
    # `run` is listed for the help only: its arguments are Hydra's and are passed on unparsed.
    commands.add_parser("run", help=_SUMMARIES["run"], add_help=False)
    commands.add_parser("scenes", help=_SUMMARIES["scenes"])
    doctor = commands.add_parser("doctor", help=_SUMMARIES["doctor"])
    doctor.add_argument("--variant", default="auto", help="Mitsuba variant (default: auto)")
    report = commands.add_parser("report", help=_SUMMARIES["report"])
    report.add_argument("folder", help="a run's folder")
    return parser


def _dispatch(arguments: list[str]) -> int:
    command = arguments[0] if arguments else ""
    if command == "run":
        if {"-h", "--help"} & set(arguments[1:]):
            print(_RUN_HELP)
            return 0
        from .commands.run import main as run

        return run(arguments[1:])
    if command and not command.startswith("-") and command not in _SUMMARIES:
        raise InputError(f"{command}: no such command; {nearest(command, _SUMMARIES)}")
    parsed = _parser().parse_args(arguments)
    if parsed.command == "scenes":
        from .commands.scenes import main as scenes

        return scenes()
    if parsed.command == "doctor":
        from .doctor import report

        return report(parsed.variant)
    if parsed.command == "report":
        from pathlib import Path

        from .report import write

        print(write(Path(parsed.folder)))
        return 0
    _parser().print_help()
    return 0


def main(arguments: list[str] | None = None) -> int:
    """Entry point. Returns the exit status."""
    try:
        return _dispatch(sys.argv[1:] if arguments is None else arguments)
    except IsasError as error:
        print(f"isas: {' '.join(str(error).splitlines())}", file=sys.stderr)
        return error.status
    except KeyboardInterrupt:
        return _interrupted()
    except BrokenPipeError:
        return _deaf()
    except Exception:
        if interrupt.asked():  # it may come out as another exception
            return _interrupted()
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
