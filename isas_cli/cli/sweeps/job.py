"""One job of a sweep: what its folder says, doing it, and recording how it failed."""

from __future__ import annotations

import contextlib
import traceback
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from omegaconf import DictConfig, OmegaConf

from ...config import paths
from ...engine.display import say
from ...records import files, load_checkpoint, manifest
from ...records.reader import read_json
from ...runtime import guests, interrupt, memory
from ...runtime.errors import InputError, IsasError, NumericalError
from .. import one
from . import fingerprint
from .outcome import Outcome, outcome, read_summary

# What a folder holds before the job begins.
NOTHING, DONE, FAILED, UNFINISHED, OTHER = "nothing", "done", "failed", "unfinished", "other"


@dataclass(frozen=True)
class Report:
    """How an attempt ended: exit status, error in one line, traceback of an unexpected one;
    ``killed``: its process died, which is all that is known."""

    status: int
    error: str = ""
    trace: str = ""
    resumed: bool = False
    killed: bool = False


@dataclass(frozen=True)
class Job:
    """What is planned: a name for messages, the settings that were typed or chosen, the run's
    folder and its resolved configuration."""

    label: str
    overrides: list[str]
    folder: Path
    cfg: DictConfig
    # Its stamp when it was planned.
    before: int | None = field(init=False, default=None, compare=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "before", self.stamp())

    @property
    def anew(self) -> bool:
        """Whether what is there is to be replaced: not what this very job, queued once more after
        its worker was lost, has begun itself."""
        return bool(self.cfg.overwrite) and self.stamp() == self.before

    def found(self) -> str:
        """What the folder holds: one of the names above. OTHER is a run with other settings."""
        if not (self.folder / "config.yaml").exists():
            return NOTHING
        if not fingerprint.same(self.cfg, self.folder):
            if (self.folder / "manifest.json").exists():
                return OTHER
            # A job that failed before there was a run, of which this may be the corrected one.
            return NOTHING if read_summary(self.folder) is None else FAILED
        summary = read_summary(self.folder) or {}
        status = summary.get("status")
        if status == "done" and summary.get("complete", True):
            return OTHER if self.elsewhere else DONE
        # "done" without the rest of its record: killed while its pictures were made. What failed
        # otherwise than by its numbers, such as on a full disk, goes on as well.
        stopped = status != NumericalError.ended
        checkpoint = (self.folder / "checkpoint" / "state.npz").exists()
        return UNFINISHED if stopped and checkpoint else FAILED

    @property
    def elsewhere(self) -> str | None:
        """A file's name that meant another file to the run that is there."""
        return paths.elsewhere(self.cfg, self._manifest().get("folder"))

    def _manifest(self) -> dict[str, Any]:
        try:
            return read_json(self.folder / "manifest.json")
        except InputError:
            return {}

    @property
    def written(self) -> bool:
        """Whether a process that lives writes the run that is there."""
        return manifest.alive(self._manifest())

    def doubt(self) -> str:
        """What speaks against taking the run that is there for done, as words to be appended."""
        then, now = self._manifest().get("guests") or {}, guests.installed()
        other = [name for name in now if then.get(name, now[name]) != now[name]]
        if other:
            return f"; but by another {', '.join(other)}: overwrite=true does it again"
        newer = paths.newer(self.cfg, self._manifest().get("started", ""))
        return f"; but newer than that is {newer}: overwrite=true does it again" if newer else ""

    def skipped(self) -> Outcome | None:
        """The outcome of a job that needs not be done again; else None."""
        if self.anew or self.found() != DONE:
            return None
        return outcome(self.label, self.folder, "skipped")

    def stamp(self) -> int | None:
        """Another one each time that an attempt opens the record, or goes on with it."""
        return stamp(self.folder)

    def go(self, threads: int | None) -> Report:
        """Do it in this process; ``threads``: see ``attempt``. Raises what a run raises."""
        from ...engine import experiment

        cfg = self.cfg.copy()
        cfg.threads = cfg.threads or threads or 0
        found = self.found()
        if found == UNFINISHED and not self.anew:
            try:
                # Also 0: as many as there are, whatever share of them a launcher gave before.
                changes = {"threads": cfg.threads}
                return Report(experiment.resume(self.folder, changes), resumed=True)
            except InputError as error:
                if _has_checkpoint(self.folder):  # nothing that was computed is thrown away
                    raise
                say(f"not resumed, begun anew: {error}")
        if found == OTHER and not cfg.overwrite:
            other = (
                f"whose {self.elsewhere} is another file" if self.elsewhere else "of other settings"
            )
            raise InputError(
                f"{self.folder} holds a run {other}: give another hydra.sweep.dir, or replace it "
                "with overwrite=true"
            )
        if found in (UNFINISHED, FAILED):
            cfg.overwrite = True
        return Report(one.run(cfg, str(self.folder)))

    def record_failure(self, report: Report, begun: bool) -> None:
        """Leave the error in the folder's summary.json, and a traceback in error.txt.

        ``begun``: the attempt had opened its record, whose own summary, where there is one, stays
        and gets the error. A failure of writing is not a second one: the table shows the error
        anyway.
        """
        cfg = self.cfg
        summary = {
            "status": "failed",
            "complete": False,
            "scene": cfg.scene.name,
            "sampler": cfg.sampler.name,
            "loss": cfg.loss.name,
            "seed": cfg.seed,
            **((read_summary(self.folder) or {}) if begun else {}),
            "overrides": self.overrides,
            "error": report.error,
            "process": manifest.process(),
        }
        if report.killed:
            summary["killed"] = True
        with contextlib.suppress(IsasError, OSError):
            if not (self.folder / "config.yaml").exists():
                text = OmegaConf.to_yaml(cfg, resolve=True)
                files.write_text(self.folder / "config.yaml", text)
            files.write_json(self.folder / "summary.json", summary)
            leave_trace(self.folder, report.trace)


def attempt(job: Job, command: list[str], threads: int | None) -> Report:
    """Do the job in this process. ``command``: what was typed; ``threads``: where the settings
    leave them open. Whatever goes wrong is in the report."""
    with one.argv(command), interrupt.prompt():
        try:
            return job.go(threads)
        except IsasError as error:
            return Report(error.status, " ".join(str(error).splitlines()))
        except KeyboardInterrupt:
            return Report(interrupt.STATUS)
        except BaseException as error:
            if interrupt.asked():  # it may come out as another exception
                return Report(interrupt.STATUS)
            if memory.exhausted(error):
                return Report(InputError.status, memory.EXHAUSTED)
            text = " ".join([f"{type(error).__name__}:", *str(error).split()]).rstrip(":")
            return Report(1, text, traceback.format_exc())


def _has_checkpoint(folder: Path) -> bool:
    """Whether there is one that this isas reads."""
    try:
        load_checkpoint(folder)
    except InputError:
        return False
    return True


def stamp(folder: Path) -> int | None:
    """Another one each time that a run opens its record in ``folder``, or goes on with it."""
    with contextlib.suppress(OSError):
        return (folder / "manifest.json").stat().st_mtime_ns
    return None


def leave_trace(folder: Path, text: str) -> None:
    """``text`` as the folder's error.txt; without one, no such file of an earlier attempt."""
    if text:
        files.write_text(folder / "error.txt", text)
    else:
        (folder / "error.txt").unlink(missing_ok=True)
