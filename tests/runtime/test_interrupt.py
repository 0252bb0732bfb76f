"""Signals between steps and in the middle of one."""

import os
import signal
import subprocess
import sys
import time

import psutil
import pytest

from isas_cli.runtime import interrupt

_LOOP = """
import time
from isas_cli.runtime import interrupt

billed = 0.0
with interrupt.graceful() as stop:
    print("begun", flush=True)
    while not stop():
        before = time.perf_counter()
        time.sleep(0.2)
        billed += time.perf_counter() - before
print(billed)
"""


def test_a_suspended_run_is_not_billed():
    begun = time.perf_counter()
    loop = subprocess.Popen([sys.executable, "-c", _LOOP], stdout=subprocess.PIPE, text=True)
    assert loop.stdout.readline() == "begun\n"
    loop.send_signal(signal.SIGTSTP)
    _, status = os.waitpid(loop.pid, os.WUNTRACED)
    assert os.WIFSTOPPED(status)
    time.sleep(2)
    loop.send_signal(signal.SIGCONT)
    time.sleep(0.5)
    loop.send_signal(signal.SIGINT)
    billed = float(loop.communicate()[0])
    assert 0 < billed < time.perf_counter() - begun - 2


def test_a_run_that_is_to_go_on_before_its_step_ends_is_not_suspended():
    """Both signals come within one call that lets no handler in, as a kernel does."""
    code = _LOOP.replace("time.sleep(0.2)", "sum(range(3 * 10**7))")
    loop = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
    assert loop.stdout.readline() == "begun\n"
    for number in (signal.SIGTSTP, signal.SIGCONT):
        time.sleep(0.1)
        loop.send_signal(number)
    time.sleep(2)
    loop.send_signal(signal.SIGINT)
    try:
        assert float(loop.communicate(timeout=30)[0]) > 0
    finally:
        loop.kill()


@pytest.mark.parametrize("before", ["SIG_DFL", "SIG_IGN"])
def test_a_run_whose_terminal_is_gone_ends_but_under_nohup(before):
    code = f"import signal; signal.signal(signal.SIGHUP, signal.{before})\n{_LOOP}"
    loop = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
    assert loop.stdout.readline() == "begun\n"
    loop.send_signal(signal.SIGHUP)
    try:
        if before == "SIG_IGN":
            with pytest.raises(subprocess.TimeoutExpired):
                loop.wait(1)
            loop.send_signal(signal.SIGINT)
        assert float(loop.communicate(timeout=30)[0]) >= 0 and loop.returncode == 0
    finally:
        loop.kill()


def test_a_signal_that_comes_twice_at_once_is_one(monkeypatch):
    """To all processes of a job, and passed on by their parent."""
    monkeypatch.setattr(interrupt, "_asked", False)
    with interrupt.graceful() as stop:
        signal.raise_signal(signal.SIGTERM)
        signal.raise_signal(signal.SIGINT)
        assert stop()
        monkeypatch.setattr(interrupt, "once_seconds", 0.0)
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)


_PARENT = """
import subprocess, sys, time
from isas_cli.runtime import interrupt

with interrupt.graceful() as stop:
    begun = subprocess.Popen([sys.executable, "-c", sys.argv[1]], stdout=subprocess.PIPE)
    begun.stdout.readline()
    print(begun.pid, flush=True)
    while not stop():
        time.sleep(0.1)
begun.kill()
"""
# Whose steps are short, and long.
_JOBS = (
    "import os, time; os.setpgid(0, 0); print('job', flush=True); time.sleep(60)",
    """
import os, time
from isas_cli.runtime import interrupt
os.setpgid(0, 0)
with interrupt.graceful() as stop:
    print("job", flush=True)
    while not stop():
        time.sleep(2)
""",
)


@pytest.mark.parametrize("job", _JOBS)
def test_jobs_are_suspended_with_their_sweep_and_go_on_with_it(job):
    """Also one that is in the middle of a step while its sweep goes on already."""
    command = [sys.executable, "-c", _PARENT, job]
    parent = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    process = psutil.Process(int(parent.stdout.readline()))

    def comes_to(stopped: bool) -> bool:
        for _ in range(100):
            if (process.status() == psutil.STATUS_STOPPED) is stopped:
                return True
            time.sleep(0.05)
        return False

    parent.send_signal(signal.SIGTSTP)
    _, status = os.waitpid(parent.pid, os.WUNTRACED)
    assert os.WIFSTOPPED(status)
    if job == _JOBS[0]:
        assert comes_to(stopped=True)
    parent.send_signal(signal.SIGCONT)
    time.sleep(3)
    assert comes_to(stopped=False)
    parent.send_signal(signal.SIGINT)
    assert parent.wait(30) == 0


def test_what_is_held_is_done_before_ctrl_c_counts():
    done = []
    with pytest.raises(KeyboardInterrupt), interrupt.prompt():
        with interrupt.held():
            signal.raise_signal(signal.SIGINT)
            done.append("first")
            done.append("second")
        done.append("never")
    assert done == ["first", "second"]


def test_ctrl_c_that_comes_out_as_another_exception_is_itself():
    """As of a callback of Dr.Jit's; what no signal made stays what it is."""
    with pytest.raises(KeyboardInterrupt), interrupt.prompt():
        try:
            signal.raise_signal(signal.SIGINT)
        except KeyboardInterrupt:
            raise RuntimeError("from a callback") from None
    with pytest.raises(RuntimeError, match="its own"), interrupt.prompt():
        raise RuntimeError("its own")


def test_handlers_that_are_not_of_python_stay(monkeypatch):
    """As in a program that Python is embedded in: they could not be put back."""
    put = []
    known = {signal.SIGINT: signal.default_int_handler, signal.SIGTERM: None}
    monkeypatch.setattr(signal, "getsignal", known.get)
    monkeypatch.setattr(signal, "signal", lambda number, _: put.append(number))
    with interrupt.held():
        pass
    monkeypatch.undo()
    assert put == [signal.SIGINT] * 2
