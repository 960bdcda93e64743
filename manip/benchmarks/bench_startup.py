"""How long from the start of a process to its first control step."""

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping
from pathlib import Path

from manip.benchmarks.contest import Contest, Contestant, Settings
from manip.errors import UserError

ENGINE = """
import numpy as np
from manip.envs.task_registry import load_task
from manip.sim.batch_engine import BatchEngine
from manip.sim.scene import load_scene
task = load_task({task!r})
scene = load_scene(task.robosuite_name, task.sensors)
engine = BatchEngine(scene, {worlds})
engine.step(np.zeros(({worlds}, scene.layout.action_dim)))
"""
ENVIRONMENT = """
from manip.envs import TaskEnv, make_batch
env = TaskEnv(make_batch({task!r}, {worlds}))
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
"""Programs that end with their first control step; the last only imports."""


def contest(settings: Settings) -> Contest:
    """Fresh processes; cold: nothing compiled is kept from before, robosuite's too."""
    kept = Path(tempfile.mkdtemp(prefix="manip-startup-"))
    contestants: dict[str, Contestant] = {}
    for name, code in {
        "engine": ENGINE,
        "TorchRL environment": ENVIRONMENT,
        "stock robosuite": STOCK,
    }.items():
        program = code.format(task=settings.task, worlds=settings.worlds)
        cache = kept / name.replace(" ", "-")
        contestants[f"{name}, cold"] = lambda p=program: _cold(p)  # type: ignore[misc]
        contestants[f"{name}, warm"] = lambda p=program, c=cache: _warm(p, c)  # type: ignore[misc]
    contestants["import of the engine"] = lambda: _seconds(IMPORT, kept / "engine")
    return Contest(
        f"{settings.task}, {settings.worlds} worlds: start of the process to the first "
        "control step",
        contestants,
        medians={
            "cold_first_step_s": "engine, cold",
            "warm_first_step_s": "engine, warm",
            "env_cold_first_step_s": "TorchRL environment, cold",
            "env_warm_first_step_s": "TorchRL environment, warm",
            "stock_cold_first_step_s": "stock robosuite, cold",
            "stock_warm_first_step_s": "stock robosuite, warm",
            "import_s": "import of the engine",
        },
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
    began = time.time()
    done = subprocess.run(
        [sys.executable, "-c", code],
        env=_environment(cache),
        capture_output=True,
        text=True,
        check=False,
    )
    last = done.stdout.splitlines()[-1:] or [""]
    if done.returncode or not last[0].startswith("done "):
        why = done.stderr.strip().splitlines()[-1:]
        raise UserError(f"a start failed: {''.join(why)}")
    return float(last[0].removeprefix("done ")) - began


def _environment(cache: Path) -> Mapping[str, str]:
    return os.environ | {"NUMBA_CACHE_DIR": str(cache)}
