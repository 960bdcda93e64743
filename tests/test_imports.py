"""What importing manip leaves behind in its user's process."""

import os
import subprocess
import sys

import pytest

IMPORT_ALL = """
import logging, os
before = dict(os.environ), logging.getLogger("absl").filters.copy()
import manip.envs, manip.sim.external.dm_control_sim
from manip.sim.robosuite_factory import make_stock
variables, filters = before
changed = {k for k in os.environ if os.environ[k] != variables.get(k)}
changed |= variables.keys() - os.environ.keys()
print(sorted(changed - {"RL_LOGGING_LEVEL", "LD_LIBRARY_PATH"}))  # the latter by cv2
print(logging.getLogger("absl").filters == filters)
"""

LOGS = """
import logging
from manip.sim.robosuite_factory import make_stock, quiet_robosuite
make_stock("Lift")
log = logging.getLogger("robosuite_logs")
log.warning("first")
quiet_robosuite()
log.warning("second")
log.error("third")
"""


def in_python(code: str, **variables: str) -> subprocess.CompletedProcess[str]:
    inherited = {k: v for k, v in os.environ.items() if k != "MUJOCO_GL"}
    return subprocess.run(
        [sys.executable, "-c", code],
        env=inherited | variables,
        capture_output=True,
        text=True,
        check=False,
    )


@pytest.mark.parametrize(
    "variables", [{"MUJOCO_GL": "glfw"}, pytest.param({}, marks=pytest.mark.slow)]
)
def test_imports_change_no_variable_and_no_log(variables: dict) -> None:
    done = in_python(IMPORT_ALL, **variables)
    assert done.stdout.splitlines() == ["[]", "True"], done.stderr


def test_only_programs_silence_robosuite() -> None:
    done = in_python(LOGS)
    assert done.returncode == 0
    words = [w for w in ("first", "second", "third") if w in done.stderr]
    assert words == ["first", "third"]
    assert len(done.stderr.splitlines()) == 2  # nothing else was logged


def test_an_unknown_gl_backend_is_one_warning() -> None:
    code = """
import manip.envs, os
print(os.environ["MUJOCO_GL"])
"""
    done = in_python(code, MUJOCO_GL="garbage")
    assert (done.returncode, done.stdout) == (0, "garbage\n"), done.stderr
    assert done.stderr.count("UserWarning") == 1
    assert "MUJOCO_GL=garbage is not used" in done.stderr


def test_a_gpu_that_robosuite_refuses_is_one_line() -> None:
    code = """
from manip.errors import UserError
try:
    import manip.envs
except UserError as error:
    print(error)
"""
    done = in_python(code, CUDA_VISIBLE_DEVICES="1", MUJOCO_EGL_DEVICE_ID="7")
    (line,) = done.stdout.splitlines()
    assert "robosuite cannot be imported: MUJOCO_EGL_DEVICE_ID" in line
