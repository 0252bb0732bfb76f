"""A process for each job of a sweep: when it dies, the sweep goes on.

Jobs share nothing that way, neither Dr.Jit's memory nor its number of threads nor the variant: each
runs as a single run would. What that costs, a second or two to begin, is not billed.
"""

from __future__ import annotations

import contextlib
import faulthandler
import math
import os
import pickle
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from multiprocessing.connection import wait

from ...runtime import interrupt
from ...runtime.errors import InputError
from .. import one
from .job import DONE, OTHER, UNFINISHED, Job, Report, attempt
from .outcome import Outcome, outcome

_POLL_SECONDS = 0.2
_EXIT_SECONDS = 30.0  # after its report; what takes longer hangs
_OF_TERMINALS = {signal.SIGINT, signal.SIGHUP}
_PROGRAM = """\
import pickle, sys
sys.path[:] = pickle.load(sys.stdin.buffer)
from isas_cli.cli.sweeps import worker
worker.main(int(sys.argv[1]))
"""


def run(
    job: Job, command: list[str], threads: int | None, quiet: bool, stop: Callable[[], bool]
) -> Report:
    """``attempt`` in a new process. ``quiet``: what it prints goes to log.txt in the job's folder.

    ``stop``: whether Ctrl-C came: it is passed on, so that the record is finished; when it raises,
    the process is killed.
    """
    source, sink = os.pipe()
    # Not multiprocessing: its processes take over the start method of whose worker this may be.
    with _blocked():
        process = subprocess.Popen(
            [sys.executable, "-c", _PROGRAM, str(sink)], stdin=subprocess.PIPE, pass_fds=[sink]
        )
    os.close(sink)
    told = False
    try:
        with contextlib.suppress(BrokenPipeError):  # it died: there will be no report
            for content in (sys.path, (job, command, threads, quiet)):
                process.stdin.write(pickle.dumps(content))
            process.stdin.flush()
        with os.fdopen(source, "rb") as reports:
            while not wait([reports], _POLL_SECONDS):
                if stop() and not told:
                    told = True
                    process.send_signal(signal.SIGINT)
            return _received(reports, process)
    finally:
        process.kill()
        process.wait()
        with contextlib.suppress(BrokenPipeError):
            process.stdin.close()


def supervise(
    job: Job, command: list[str], threads: int | None, quiet: bool, stop: Callable[[], bool]
) -> Outcome:
    """Do the job in a process of its own and record how it ended, also when that process dies.
    Command, threads, quiet and stop: see ``run``."""
    skipped = job.skipped()  # a twin may have done it, or an earlier attempt on a cluster
    if skipped:
        return skipped
    found, before = job.found(), job.stamp()
    report = run(job, command, threads, quiet, stop)
    if report.status == 0:
        status = "resumed" if report.resumed else "done"
    elif report.status == interrupt.STATUS:
        status = "interrupted"
        one.remove_empty(job.folder)
    else:
        status = "failed"
        # What is unfinished and was refused stays so: as a failure it would be begun anew. What
        # another sweep's process writes is that one's.
        begun = job.stamp() != before
        others = job.written or (report.status == InputError.status and job.found() == DONE)
        if (found not in (DONE, OTHER, UNFINISHED) or begun) and not others:
            job.record_failure(report, begun)
    return outcome(job.label, job.folder, status, report.status, report.error)


def _received(reports, process: subprocess.Popen) -> Report:
    """What the process says, or, when the pipe ends before that, how it died."""
    content = reports.read()
    try:
        code = process.wait(_EXIT_SECONDS)
    except subprocess.TimeoutExpired:
        code = 0
    if content:
        return pickle.loads(content)
    return Report(1, _cause(code), killed=True)


def main(sink: int) -> None:
    """The process's own side: ``sink`` is where the report goes, standard input brings the job."""
    # A process group of its own: the terminal's Ctrl-C goes to the parent, which passes it on.
    os.setpgid(0, 0)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # forgets one that came before
    # To the parent, too: of a cluster, that time is up; of a terminal, that it is gone.
    for number in (signal.SIGUSR1, signal.SIGUSR2, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, _OF_TERMINALS)
    signal.signal(signal.SIGINT, signal.default_int_handler)
    # A second signal is the parent's of one that all got; where at once is meant, it kills.
    interrupt.once_seconds = math.inf
    job, command, threads, quiet = pickle.load(sys.stdin.buffer)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    report = _logged(job) if quiet else None
    faulthandler.enable()
    report = report or attempt(job, command, threads)
    with os.fdopen(sink, "wb") as reports:
        reports.write(pickle.dumps(report))


def _logged(job: Job) -> Report | None:
    """Lets what is printed go to log.txt; a report where that cannot be."""
    try:
        job.folder.mkdir(parents=True, exist_ok=True)
        log = os.open(job.folder / "log.txt", os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o666)
    except OSError as error:
        return Report(InputError.status, f"{job.folder}: cannot be written: {error.strerror}")
    os.dup2(log, sys.stderr.fileno())
    return None


def _end_with_parent() -> None:
    """Nobody would know what an orphan does, and the next start of the sweep would meet it."""
    os.read(sys.stdin.fileno(), 1)  # the pipe ends when the parent does
    os.kill(os.getpid(), signal.SIGKILL)


def _cause(code: int) -> str:
    if code >= 0:
        return f"its process ended without a word (exit status {code})"
    name = signal.Signals(-code).name
    hint = " (out of memory?)" if name == "SIGKILL" else ""
    return f"its process was killed by {name}{hint}"


@contextlib.contextmanager
def _blocked() -> Iterator[None]:
    """Ctrl-C waits: a process that starts takes over what is blocked."""
    earlier = signal.pthread_sigmask(signal.SIG_BLOCK, _OF_TERMINALS)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, earlier)
