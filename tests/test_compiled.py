"""Compiled code on disk."""

import subprocess
import sys
from pathlib import Path

import manip.compiled

HELPER = """
from manip.compiled import kernel
@kernel
def answer():
    return {}
"""
CALLER = """
from manip.compiled import jit
from manip.helper import answer
@jit
def ask():
    return answer()
print(ask(), sum(ask.stats.cache_hits.values()))
"""


def told(folder: Path, answer: int) -> list[int]:
    """What the caller says, and how often it was found on disk, in a new process."""
    package = folder / "manip"
    package.mkdir(exist_ok=True)
    files = {"__init__": "", "helper": HELPER.format(answer), "caller": CALLER}
    files["compiled"] = Path(manip.compiled.__file__).read_text()
    for name, text in files.items():
        path = package / f"{name}.py"
        if not path.exists() or path.read_text() != text:
            path.write_text(text)
    ran = [sys.executable, "-m", "manip.caller"]
    done = subprocess.run(ran, cwd=folder, capture_output=True, text=True, check=True)
    return [int(word) for word in done.stdout.split()]


def test_a_change_of_what_a_compiled_function_calls_is_seen(tmp_path) -> None:
    assert told(tmp_path, 1) == [1, 0]
    assert told(tmp_path, 1) == [1, 1]
    assert told(tmp_path, 22) == [22, 0]
