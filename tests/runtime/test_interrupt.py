"""Signals between steps and in the middle of one."""

import os
import signal
import subprocess
import sys
import time

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


def test_what_is_held_is_done_before_ctrl_c_counts():
    done = []
    with pytest.raises(KeyboardInterrupt), interrupt.prompt():
        with interrupt.held():
            signal.raise_signal(signal.SIGINT)
            done.append("first")
            done.append("second")
        done.append("never")
    assert done == ["first", "second"]
