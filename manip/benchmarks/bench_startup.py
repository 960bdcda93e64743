"""Time from the start of a process to its first control step."""

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping
from functools import partial
from pathlib import Path

from manip.benchmarks.rounds import Candidate, Comparison, Settings
from manip.errors import UserError

ENGINE = """
import numpy as np
from manip.envs.task_registry import load_task
from manip.sim.batch_engine import BatchEngine
from manip.sim.scene import load_scene
task = load_task({task!r})
scene = load_scene(task.robosuite_name, task.sensors)
engine = BatchEngine(scene, {num_envs})
engine.step(np.zeros(({num_envs}, scene.layout.action_dim)))
"""
ENVIRONMENT = """
from manip.envs import TaskEnv, make_batch
env = TaskEnv(make_batch({task!r}, {num_envs}))
state = env.reset()
state["action"] = env.action_spec.zero()
env.step_and_maybe_reset(state)
"""
STOCK = """
import numpy as np
from manip.envs.task_registry import load_task
from manip.sim.robosuite_factory import make_stock
env = make_stock(load_task({task!r}).robosuite_name)
env.reset()
env.step(np.zeros(env.action_dim))
"""
IMPORT = "import manip.envs, manip.sim.batch_engine"
PROGRAMS = {
    "engine": ENGINE,
    "TorchRL environment": ENVIRONMENT,
    "stock robosuite": STOCK,
}
"""Programs that end with their first control step."""

MEDIANS = {
    "cold_first_step_s": "engine, cold",
    "warm_first_step_s": "engine, warm",
    "env_cold_first_step_s": "TorchRL environment, cold",
    "env_warm_first_step_s": "TorchRL environment, warm",
    "stock_cold_first_step_s": "stock robosuite, cold",
    "stock_warm_first_step_s": "stock robosuite, warm",
    "import_s": "import of the engine",
}
"""Figure -> candidate."""


def comparison(settings: Settings) -> Comparison:
    """Compare new processes with cold and warm caches of compiled code.

    A cold cache is empty, also for robosuite's own compiled functions.
    """
    caches = Path(tempfile.mkdtemp(prefix="manip-startup-"))
    candidates: dict[str, Candidate] = {}
    for name, code in PROGRAMS.items():
        program = code.format(task=settings.task, num_envs=settings.num_envs)
        cache = caches / name.replace(" ", "-")
        candidates[f"{name}, cold"] = partial(_cold, program)
        candidates[f"{name}, warm"] = partial(_warm, program, cache)
    candidates["import of the engine"] = partial(_seconds, IMPORT, caches / "engine")
    return Comparison(
        f"{settings.task}, {settings.num_envs} environments: from the start of the "
        "process to the first control step",
        candidates,
        medians=MEDIANS,
        unit="seconds",
        warm_up=False,
    )


def _cold(program: str) -> float:
    with tempfile.TemporaryDirectory(prefix="manip-startup-") as empty:
        return _seconds(program, Path(empty))


def _warm(program: str, cache: Path) -> float:
    if not cache.exists():
        _seconds(program, cache)
    return _seconds(program, cache)


def _seconds(program: str, cache: Path) -> float:
    """Wall time of a Python process that runs `program`, without its exit."""
    code = f"{program}\nimport time; print('done', time.time())"
    start = time.time()
    process = subprocess.run(
        [sys.executable, "-c", code],
        env=_environment(cache),
        capture_output=True,
        text=True,
        check=False,
    )
    last = process.stdout.splitlines()[-1:] or [""]
    if process.returncode or not last[0].startswith("done "):
        reason = "".join(process.stderr.strip().splitlines()[-1:])
        raise UserError(f"a process that measures start-up failed: {reason}")
    return float(last[0].removeprefix("done ")) - start


def _environment(cache: Path) -> Mapping[str, str]:
    return os.environ | {"NUMBA_CACHE_DIR": str(cache)}
