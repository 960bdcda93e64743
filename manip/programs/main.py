"""`manip NAME ...`: every program behind one command, loaded only when it is run."""

import gc
import importlib
import os
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from manip.errors import unknown
from manip.programs import cli
from manip.sim.robosuite_log import quiet_robosuite

PROGRAMS = {
    "train": "train a policy",
    "clips": "record clips of a policy, to be compared",
    "label": "compare pairs of clips on a page in the browser",
    "comparisons": "check, summarise and merge comparisons of clips",
    "reward": "learn a reward from comparisons, and show what it pays for",
    "evaluate": "measure a policy's success, in stock robosuite or natively",
    "export": "write a policy as ONNX, TorchScript or numpy arrays",
    "record": "record episodes as a LeRobot, robomimic or Minari data set",
    "render": "make a video of a policy",
    "view": "watch a policy in a window",
    "report": "write a page about runs, with 3-D replays of their episodes",
    "reproduce": "rerun shipped recipes and compare with their results",
    "results": "show the results of the shipped recipes",
    "replay": "repeat a control step whose numbers were not finite",
    "check": "check a task of your own before training",
    "certify": "compare a task on C, on MuJoCo Warp and in stock robosuite",
    "list": "list tasks, robots, algorithms, recipes, policies, tastes",
    "doctor": "check that this machine can run manip",
    "benchmark": "measure speed",
    "sweep": "train every combination of options and seeds",
    "aggregate": "compare the runs of sweeps, with intervals over seeds",
    "compare": "learning curves, options and success of runs side by side",
    "study": "compare algorithms and their options",
}
"""Program -> its purpose; each is the module of its name in `manip.programs`."""


def main() -> None:
    """Run the program that the command line names."""
    sys.exit(cli.run(_dispatch, sys.argv[1:]))


def run_script(name: str) -> None:
    """Run one program with the whole command line (for scripts/NAME.py)."""
    sys.exit(cli.run(lambda arguments: _program(name)(arguments), sys.argv[1:]))


def _dispatch(arguments: Sequence[str]) -> int:
    if not arguments or arguments[0] in ("-h", "--help"):
        print(_usage())
        return 0
    name, *rest = arguments
    if name not in PROGRAMS:
        raise unknown("program", name, PROGRAMS)
    return _program(name)(rest)


def _program(name: str) -> cli.Program:
    """Import a program; what is set for it, imports of manip never set."""
    # Children start as `python -c`, which would search the working directory for their
    # modules: those of manip, and those with which glfw looks for its library.
    os.environ["PYTHONSAFEPATH"] = "1"
    quiet_robosuite()
    with _no_garbage_collection():
        module = importlib.import_module(f"manip.programs.{name}")
    program: cli.Program = module.main
    return program


@contextmanager
def _no_garbage_collection() -> Iterator[None]:
    """Collect no garbage inside; leave the objects made inside out of later searches.

    Modules are hundreds of thousands of objects that stay. To search them for garbage
    would take a fifth of the time of their import. Only a process's first program does
    so: what earlier ones left may be garbage, which would then never be freed.
    """
    if gc.get_freeze_count():
        yield
        return
    gc.disable()
    try:
        yield
    finally:
        gc.freeze()
        gc.enable()


def _usage() -> str:
    lines = [f"  {name:11} {purpose}" for name, purpose in PROGRAMS.items()]
    return "\n".join(
        [
            "usage: manip PROGRAM [OPTIONS]",
            "",
            "Train 7-DoF arms on robosuite's own tasks, at native speed.",
            "",
            "programs:",
            *lines,
            "",
            "manip PROGRAM --help explains the options of each.",
        ]
    )


if __name__ == "__main__":
    main()
