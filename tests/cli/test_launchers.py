"""Launchers and sweepers that extras bring, run for real; skipped where they are not installed."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import flaky_scene
import psutil
import pytest
from omegaconf import OmegaConf
from test_sweep import TINY, folders, summary, table, textures

from isas_cli import records

pytestmark = pytest.mark.slow

# What the cluster's commands would do, on this machine: jobs run at once, each in the background.
_SBATCH = """\
import os, re, subprocess, sys
script = open(sys.argv[-1]).read()
array = re.search(r"--array=0-(\\d+)%", script)
open("asked.txt", "w").write(script)
for task in range(int(array[1]) + 1 if array else 1):
    of_array = {"SLURM_ARRAY_JOB_ID": "77", "SLURM_ARRAY_TASK_ID": str(task)} if array else {}
    environment = {
        **os.environ,
        **of_array,
        "SLURM_JOB_ID": f"{77 + task}",
        "SLURM_JOB_NUM_NODES": "1",
        "SLURM_NTASKS": "1",
        "SLURM_NODEID": "0",
        "SLURM_PROCID": "0",
        "SLURM_LOCALID": "0",
        "SLURM_JOB_NODELIST": "here",
    }
    log = open(f"job_{task}.txt", "w")
    job = subprocess.Popen(["bash", "-c", script], env=environment, stdout=log, stderr=log)
    open(f"pid_77_{task}" if array else "pid_77", "w").write(str(job.pid))
print("Submitted batch job 77")
"""
_SRUN = """\
import os, sys
command = sys.argv[sys.argv.index(next(a for a in sys.argv if a.endswith("python"))) :]
os.execv(command[0], command)
"""
_SCONTROL = """\
import subprocess
script = "sleep 1;" + open("asked.txt").read()
log = open("requeued.txt", "w")
job = subprocess.Popen(["bash", "-c", script], stdout=log, stderr=log, start_new_session=True)
open("pid_77", "w").write(str(job.pid))
"""
_SACCT = """\
import glob
print("JobID|State|NodeList")
for path in glob.glob("pid_*"):
    try:
        state = open(f"/proc/{open(path).read()}/stat").read().rpartition(")")[2].split()[0]
    except OSError:
        state = "gone"
    print(f"{path[4:]}|{'COMPLETED' if state in ('gone', 'Z') else 'RUNNING'}|here")
"""


def run(folder: Path, *arguments: str, path: str = "") -> tuple[int, str]:
    """`isas run -m` in a process of its own → (status, stderr)."""
    tests = str(Path(__file__).parents[1] / "support")
    environment = dict(os.environ, PYTHONPATH=tests, PATH=f"{path}{os.environ['PATH']}")
    command = [sys.executable, "-m", "isas_cli", "run", *TINY, "-m", *arguments]
    done = subprocess.run(command, cwd=folder, env=environment, text=True, capture_output=True)
    print(done.stdout, done.stderr)
    return done.returncode, done.stderr


def needs(package: str, extra: str) -> None:
    pytest.importorskip(package, reason=f"pip install '.[{extra}]'")


def check_jobs(folder: Path, monkeypatch, *arguments: str, threads: int, path: str = "") -> None:
    """One job is done, one is refused, one is killed; a second start repeats only the latter."""
    refused, killed = flaky_scene.REFUSED, flaky_scene.KILLED
    status, err = run(folder, *arguments, textures(refused, 8, killed), path=path)
    assert status == 2
    assert list(table(err).values()) == ["failed", "done", "failed"]
    assert "UserWarning" not in err and "Traceback" not in err
    monkeypatch.chdir(folder)
    places = folders()
    assert summary(places[refused])["error"] == "this scene is refused"
    assert "SIGKILL" in summary(places[killed])["error"]
    done = records.load(places[8])
    assert done.summary["status"] == "done" and done.config["threads"] == threads
    assert done.manifest["command"][:2] == ["isas", "run"]
    status, err = run(folder, *arguments, textures(8, killed), path=path)
    assert status == 1
    assert list(table(err).values()) == ["skipped", "failed"]


def test_ray(tmp_path, monkeypatch):
    needs("ray", "ray")
    arguments = ["hydra/launcher=ray", "hydra.launcher.ray.init.num_cpus=2"]
    check_jobs(tmp_path, monkeypatch, *arguments, threads=1)


def test_submitit_local(tmp_path, monkeypatch):
    needs("submitit", "slurm")
    check_jobs(tmp_path, monkeypatch, "hydra/launcher=submitit_local", threads=1)


@pytest.fixture
def cluster(tmp_path) -> Path:
    """A folder of programs that stand for SLURM's."""
    needs("submitit", "slurm")
    programs = tmp_path / "bin"
    programs.mkdir()
    texts = {"sbatch": _SBATCH, "srun": _SRUN, "sacct": _SACCT, "scontrol": _SCONTROL}
    for name, text in texts.items():
        (programs / name).write_text(f"#!{sys.executable}\n{text}")
        (programs / name).chmod(0o755)
    return programs


def test_submitit_slurm(tmp_path, monkeypatch, cluster):
    arguments = ["hydra/launcher=submitit_slurm", "hydra.launcher.partition=short"]
    arguments += ["hydra.launcher.cpus_per_task=2"]
    check_jobs(tmp_path, monkeypatch, *arguments, threads=2, path=f"{cluster}:")
    asked = (tmp_path / "asked.txt").read_text()
    for option in ("--partition=short", "--cpus-per-task=2", "--time=60", "--mem=16GB"):
        assert option in asked


@pytest.mark.parametrize("warned", [False, True])
def test_a_job_that_slurm_preempts_is_queued_again_and_resumed(tmp_path, cluster, warned):
    """``warned``: SIGTERM comes first, as on a partition that gives jobs time to end."""
    environment = dict(os.environ, PATH=f"{cluster}:{os.environ['PATH']}")
    settings = [o for o in TINY if not o.startswith(("budget", "scene.builder"))]
    command = [sys.executable, "-m", "isas_cli", "run", *settings, "budget.seconds=5"]
    command += ["-m", "hydra/launcher=submitit_slurm", "hydra.launcher.cpus_per_task=2"]
    sweep = subprocess.Popen(
        command, cwd=tmp_path, env=environment, text=True, stderr=subprocess.PIPE
    )
    while not list(tmp_path.glob("runs/dodoco/uniform/*/history.csv")):
        assert sweep.poll() is None, sweep.stderr.read()
        time.sleep(0.05)
    job = psutil.Process(int((tmp_path / "pid_77").read_text()))
    for process in [job, *job.children(recursive=True)]:
        if "submitit.core._submit" in process.cmdline():
            if warned:
                process.send_signal(signal.SIGTERM)
                # Its worker ends before it waits.
                while process.children():
                    assert sweep.poll() is None, sweep.stderr.read()
                    time.sleep(0.05)
            process.send_signal(signal.SIGUSR2)
    _, err = sweep.communicate()
    assert sweep.returncode == 0 and list(table(err).values()) == ["resumed"], err
    assert (tmp_path / "requeued.txt").exists()


def test_slurm_without_a_cluster_is_refused_in_one_line(tmp_path):
    needs("submitit", "slurm")
    status, err = run(tmp_path, "hydra/launcher=submitit_slurm", "seed=1,2")
    assert status == 2
    assert err.splitlines()[-1].startswith("isas: submitit cannot launch the jobs: ")
    assert "Traceback" not in err


def test_optuna_finds_the_better_learning_rate(tmp_path, monkeypatch):
    needs("optuna", "optuna")
    search = ["hydra/sweeper=optuna", "hydra.sweeper.n_trials=3", "budget.iterations=10"]
    status, err = run(tmp_path, *search)
    assert status == 0 and list(table(err).values()) == ["done"] * 3
    monkeypatch.chdir(tmp_path)
    runs = [records.load(path.parent) for path in Path("runs").rglob("manifest.json")]
    rates = {r.config["optimizer"]["factor"]: r.summary["final"]["parameter_rmse"] for r in runs}
    assert len(rates) == 3 and all(0.05 <= rate <= 5 for rate in rates)
    best = min(rates, key=rates.get)
    assert err.splitlines()[-1].startswith(
        f"best: optimizer.factor={best}: {rates[best]:.4g}: runs/"
    )
    found = OmegaConf.load("runs/dodoco/uniform/optimization_results.yaml")
    assert found.best_params["optimizer.factor"] == best and found.best_value == rates[best]

    # Another start proposes the same, takes what is done and goes on from there.
    search[1] = "hydra.sweeper.n_trials=4"
    status, err = run(tmp_path, *search)
    assert status == 0 and list(table(err).values()) == ["skipped"] * 3 + ["done"]


def test_optuna_goes_on_after_a_failed_trial(tmp_path):
    needs("optuna", "optuna")
    sizes = f"choice({flaky_scene.REFUSED},8)"
    search = ["hydra/sweeper=optuna", "hydra.sweeper.n_trials=5", "optimizer.factor=1"]
    status, err = run(tmp_path, *search, f"scene.arguments.texture={sizes}")
    assert status == 2
    assert set(table(err).values()) == {"failed", "done"}
    assert "\nbest: scene.arguments.texture=8: " in err

    search[-1] = "hydra.sweeper.n_trials=2"
    status, err = run(
        tmp_path,
        *search,
        f"+hydra.sweeper.params.scene.arguments.texture=choice({flaky_scene.REFUSED})",
    )
    assert status == 2


def test_trials_side_by_side(tmp_path):
    needs("optuna", "optuna")
    search = ["hydra/sweeper=optuna", "hydra.sweeper.n_trials=4", "hydra.sweeper.n_jobs=2"]
    status, err = run(tmp_path, *search, "hydra/launcher=joblib", "hydra.launcher.n_jobs=2")
    assert status == 0 and list(table(err).values()) == ["done"] * 4
    runs = Path(tmp_path, "runs").rglob("summary.json")
    assert {json.loads(path.read_text())["status"] for path in runs} == {"done"}
