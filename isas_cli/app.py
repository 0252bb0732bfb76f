"""The command line: which command, and what its errors look like.

Nothing heavy is imported before a command is known: `isas --help` must answer at once.
"""

from __future__ import annotations

import argparse
import sys
import traceback

from . import __version__
from .errors import IsasError

_INTERRUPTED = 130

_RUN_HELP = """\
usage: isas run scene=NAME [sampler=NAME] [loss=NAME] [size=NAME] [KEY=VALUE ...]

Recover a scene's unknown parameters from its images and leave a record of it.

  isas run scene=pottery sampler=ours                   one run, 60 billed seconds
  isas run scene=pottery sampler=balanced budget.seconds=20 seed=2
  isas run scene=jumpydumpy loss=relative_l2 size=tiny budget.iterations=50
  isas run scene=file scene.path=my.xml 'scene.unknowns={"jar.bsdf.base_color.data": {"start": 0.5}}'
  isas run scene=pottery hydra.run.dir=DIR              put the record into DIR
  isas run scene=pottery --cfg job                      print the configuration and stop

Every setting of the printed configuration can be given as KEY=VALUE.
Status: 0 done, 2 bad configuration or input, 3 numerical failure, 130 interrupted."""


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="isas",
        description="Inverse rendering by gradient descent through a path tracer, "
        "and what its accuracy costs in time.",
    )
    parser.add_argument("--version", action="version", version=f"isas {__version__}")
    commands = parser.add_subparsers(dest="command", metavar="COMMAND")
    # `run` is listed for the help only: its arguments are Hydra's and are passed on unparsed.
    commands.add_parser("run", help="recover a scene's unknowns (isas run --help)", add_help=False)
    commands.add_parser("scenes", help="list the scenes, samplers and losses")
    doctor = commands.add_parser("doctor", help="say whether this machine can run it")
    doctor.add_argument("--variant", default="auto", help="Mitsuba variant (default: auto)")
    report = commands.add_parser("report", help="write a run's plots and page anew")
    report.add_argument("folder", help="a run's folder")
    return parser


def _dispatch(arguments: list[str]) -> int:
    if arguments[:1] == ["run"]:
        if {"-h", "--help"} & set(arguments[1:]):
            print(_RUN_HELP)
            return 0
        from .commands.run import main as run

        return run(arguments[1:])
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
        print(f"isas: {error}", file=sys.stderr)
        return error.status
    except KeyboardInterrupt:
        print("isas: interrupted", file=sys.stderr)
        return _INTERRUPTED
    except BrokenPipeError:
        return 1
    except Exception:
        traceback.print_exc()
        print("isas: this is a defect of isas: please report it with the lines above", file=sys.stderr)
        return 1
