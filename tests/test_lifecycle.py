"""Locks and signals of a run."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from training_runs import (
    ROLLOUT,
    contents,
    copy_of,
    finished,
    new_trainer,
    state_of,
    tiny,
)

from manip.errors import UserError
from manip.programs import cli, train
from manip.training.lifecycle import SignalHandler
from manip.training.run_logs import read_metrics


def test_a_run_folder_is_for_one_process_at_a_time(tmp_path: Path) -> None:
    config = copy_of(finished("ppo"), tmp_path / "run")
    before = contents(config.folder)
    holder = subprocess.Popen(
        [sys.executable, "-c", HOLD, config.folder], stdout=subprocess.PIPE, text=True
    )
    assert holder.stdout.readline() == "locked\n"
    message = (
        f"is in use by process {holder.pid} on .*: wait until it ends, stop it, or"
    )
    with pytest.raises(UserError, match=message):
        new_trainer(replace(config, resume=True)).run()
    holder.kill()
    holder.wait()
    assert contents(config.folder).keys() == before.keys()
    assert new_trainer(replace(config, resume=True)).run()


HOLD = """
import sys, time
from pathlib import Path
from manip.training.lifecycle import locked
with locked(Path(sys.argv[1])):
    print("locked", flush=True)
    time.sleep(60)
"""


@pytest.fixture(params=[signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def signal_number(request) -> Iterator[signal.Signals]:
    """A signal with its default handler; background jobs may ignore it."""
    before = signal.signal(request.param, signal.SIG_DFL)
    yield request.param
    signal.signal(request.param, before)


def test_a_signal_ends_the_run_after_its_update(signal_number, tmp_path, capfd) -> None:
    trainer = new_trainer(tiny("ppo", tmp_path / "run"))
    update = trainer.parts.agent.update

    def interrupted(batch: Any) -> dict[str, float]:
        signal.raise_signal(signal_number)
        return update(batch)

    trainer.parts.agent.update = interrupted
    assert not trainer.run()
    assert "repeat to quit at once" in capfd.readouterr().err
    assert signal.getsignal(signal_number) == signal.SIG_DFL
    assert state_of(trainer.folder)["progress"]["env_steps"] == ROLLOUT["ppo"]


def test_an_ignored_signal_stays_ignored() -> None:
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        with SignalHandler(lambda: pytest.fail("handled")):
            signal.raise_signal(signal.SIGHUP)
        assert signal.getsignal(signal.SIGHUP) == signal.SIG_IGN
    finally:
        signal.signal(signal.SIGHUP, before)


def wait_for_metrics(path: Path, process: subprocess.Popen[str]) -> None:
    for _ in range(1200):
        if len(read_metrics(path)) > 1 or process.poll() is not None:
            return
        time.sleep(0.1)


@pytest.mark.slow
def test_sigterm_saves_and_exits_with_3_and_the_run_resumes(tmp_path: Path) -> None:
    out = tmp_path / "run"
    options = "--task Reach --algo ppo --num-envs 4 --eval-every 64 --eval-episodes 1"
    agent = "--agent.rollout-length 8 --agent.epochs 1 --agent.action-scale"
    command = [sys.executable, "-m", "manip.programs.main", "train", "--out", str(out)]
    process = subprocess.Popen(
        [*command, *options.split(), *agent.split()],
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ | {"OMP_NUM_THREADS": "1"},
    )
    wait_for_metrics(out / "metrics.csv", process)
    process.send_signal(signal.SIGTERM)
    _, printed = process.communicate(timeout=60)
    assert process.returncode == 3, printed
    assert "stopped at step" in printed
    assert f"--resume --out {out}" in " ".join(printed.split())
    done = state_of(out)["progress"]["env_steps"]
    more = ["--resume", "--out", str(out), "--steps", str(done + 64)]
    assert cli.run(train.main, more) == 0
    steps = [int(row["env_steps"]) for row in read_metrics(out / "metrics.csv")]
    assert steps == sorted(set(steps))
    assert steps[-1] == state_of(out)["progress"]["env_steps"] >= done + 64
