"""Programs from their command lines: what they write, print and refuse."""

import contextlib
import gc
import json
import os
import platform
import runpy
import shutil
import signal
import subprocess
import sys
import time
import weakref
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import NamedTuple

import imageio_ffmpeg
import numpy as np
import pytest
import yaml

from manip.agents.policy import WEIGHTS, load_policy
from manip.agents.registry import algorithm_names
from manip.envs.external_task import external_names
from manip.envs.task_registry import task_names
from manip.errors import UserError
from manip.evaluation import episode_recording
from manip.evaluation import runners as evaluation
from manip.programs import cli, evaluate, main, render
from manip.robot_config import CONTROLLERS, ROBOTS
from manip.sim import gl
from manip.training.recipes import recipe_names

ROOT = Path(__file__).parents[1]

TINY = [
    *("--task", "Reach", "--algo", "ppo", "--steps", "64", "--num-envs", "4"),
    *("--eval-every", "64", "--eval-episodes", "1", "--agent.rollout-length", "8"),
    *("--agent.actor-hidden", "8", "--agent.critic-hidden", "8"),
]

LAUGHS = "task:\n- &a0 [ha]\n" + "".join(
    f"- &a{n} [{', '.join([f'*a{n - 1}'] * 9)}]\n" for n in range(1, 30)
)
"""YAML that is short, and huge when written out."""

CONTRACT = {
    *("task", "robot", "algo", "env", "fidelity", "episodes", "seed", "purpose"),
    *("env_steps_trained", "success", "return_mean", "milestones"),
    *("seconds", "versions"),
}
"""Keys that readers of eval.json rely on."""


class Result(NamedTuple):
    code: int
    out: str
    err: str


Manip = Callable[..., Result]


@pytest.fixture
def manip(monkeypatch, capfd, tmp_path: Path) -> Manip:
    """The command, in this process and an empty folder."""
    monkeypatch.chdir(tmp_path)

    def manip(*arguments: str) -> Result:
        monkeypatch.setattr(sys, "argv", ["manip", *arguments])
        capfd.readouterr()
        with pytest.raises(SystemExit) as leaving:
            main.main()
        return Result(int(leaving.value.code or 0), *capfd.readouterr())

    return manip


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a tiny run."""
    folder = tmp_path_factory.mktemp("tiny") / "run"
    assert cli.run(main._program("train"), [*TINY, "--out", str(folder)]) == 0
    return folder


def test_train_prints_the_policys_path(manip: Manip, tmp_path: Path) -> None:
    result = manip("train", *TINY, "--seed", "5")
    folder = Path("runs") / "Reach-ppo-5"
    assert result.code == 0
    assert result.err.splitlines()[-1] == f"trained policy: {folder / 'policy'}"
    assert "Traceback" not in result.err
    card = load_policy(tmp_path / folder).card
    assert (card.env_steps, card.seed) == (64, 5)
    recorded = yaml.safe_load((tmp_path / folder / "config.yaml").read_text())
    assert recorded["agent"]["actor_hidden"] == [8]
    assert manip("train", *TINY, "--seed", "5").code == 2


def test_a_recipe_sets_what_the_command_line_leaves_open(manip: Manip) -> None:
    given = yaml.safe_load((ROOT / "assets/recipes/reach-ppo.yaml").read_text())
    assert given["agent"]["action_scale"]
    assert manip("train", *TINY, "--out", "run").code == 0
    recorded = yaml.safe_load(Path("run/config.yaml").read_text())
    assert recorded["agent"]["action_scale"] == given["agent"]["action_scale"]
    assert recorded["horizon"] == given["horizon"]
    assert recorded["steps"] == 64


def evaluated(manip: Manip, run: Path, *options: str) -> dict:
    result = manip("evaluate", str(run), "--json", "new/eval.json", *options)
    assert result.code == 0, result.err
    assert "Reach · Panda · ppo" in result.out
    return json.loads(Path("new/eval.json").read_text())


def assert_contract(result: dict, env: str, episodes: int, seed: int) -> None:
    assert result.keys() >= CONTRACT
    assert (result["task"], result["robot"]) == ("Reach", "Panda")
    assert (result["algo"], result["env"]) == ("ppo", env)
    assert (result["episodes"], result["seed"]) == (episodes, seed)
    assert result["env_steps_trained"] == 64
    assert result["success"].keys() == {
        "success_once",
        "success_at_end",
        "success_held",
    }
    for rate in result["success"].values():
        assert rate.keys() == {"rate", "low", "high"}
        assert 0 <= rate["low"] <= rate["rate"] <= rate["high"] <= 1
    assert result["milestones"].keys() == {"near", "reach"}
    assert 0 < result["return_mean"] < 80
    assert result["seconds"] > 0
    assert {"manip-suite", "mujoco", "robosuite", "torch"} <= result["versions"].keys()


def test_native_evaluation_writes_the_contract_and_repeats_itself(manip, run) -> None:
    options = ("--env", "native", "--episodes", "3", "--seed", "7")
    first, second = (evaluated(manip, run, *options) for _ in range(2))
    assert_contract(first, "native", 3, 7)
    assert first["fidelity"] == "exact"
    for result in (first, second):
        del result["seconds"]
    assert first == second
    fast = evaluated(manip, run, *options, "--fidelity", "fast")
    assert fast["fidelity"] == "fast"
    assert fast["return_mean"] != first["return_mean"]


def test_stock_evaluation_writes_the_contract(manip, run, monkeypatch) -> None:
    monkeypatch.setattr(evaluation, "usable_cpus", lambda: 1)
    result = evaluated(manip, run, "--episodes", "2", "--seed", "3")
    assert_contract(result, "stock", 2, 3)
    assert result["fidelity"] == "exact"


@pytest.mark.slow
def test_stock_episodes_do_not_depend_on_the_workers(manip, run, monkeypatch) -> None:
    results = []
    for workers in (1, 2):
        monkeypatch.setattr(evaluation, "usable_cpus", lambda n=workers: n)
        results.append(evaluated(manip, run, "--episodes", "3"))
        del results[-1]["seconds"]
    assert results[0] == results[1]


def test_list_names_everything_there_is(manip: Manip) -> None:
    result = json.loads(manip("list", "--json").out)
    assert result["tasks"] == task_names() != []
    assert result["external_tasks"] == external_names() != []
    assert result["robots"] == list(ROBOTS)
    assert result["algorithms"] == algorithm_names()
    assert result["action_spaces"] == list(CONTROLLERS)
    assert result["recipes"] == recipe_names() != []
    assert isinstance(result["policies"], list)
    table = manip("list").out
    assert all(name in table for names in result.values() for name in names)


@pytest.mark.skipif(gl.find_backend() is None, reason=gl.INSTALL_HINT)
def test_render_shows_the_requested_steps(manip: Manip, run: Path) -> None:
    size = ("--width", "96", "--height", "64")
    result = manip("render", str(run), "--steps", "5", "--episodes", "2", *size)
    assert (result.code, result.out) == (0, "video.mp4\n")
    reader = imageio_ffmpeg.read_frames("video.mp4")
    shown = next(reader)
    assert (shown["size"], shown["fps"]) == ((96, 64), 20)
    assert len(list(reader)) == 2 * 5


@pytest.mark.slow
@pytest.mark.skipif(gl.find_backend() is None, reason=gl.INSTALL_HINT)
def test_render_shows_two_policies_side_by_side(manip: Manip, run: Path) -> None:
    size = ("--width", "96", "--height", "64", "--steps", "2", "--episodes", "1")
    result = manip("render", str(run), "--before", str(run), *size)
    assert (result.code, result.out) == (0, "video.mp4\n")
    reader = imageio_ffmpeg.read_frames("video.mp4")
    assert next(reader)["size"] == (192, 64)
    for frame in reader:
        shown = np.frombuffer(frame, np.uint8).reshape(64, 2, 96, 3)
        picture = shown[32:].astype(int)  # below the titles
        assert np.abs(picture[:, 0] - picture[:, 1]).mean() < 5  # coded by H.264


def test_report_writes_a_page(manip: Manip, run: Path) -> None:
    result = manip("report", str(run), "--episodes", "2")
    assert (result.code, result.out[:13]) == (0, "report.html (")
    page = Path("report.html").read_text(encoding="utf-8")
    assert "of 2 episodes end in success" in page
    assert "manip train --task Reach --algo ppo" in page
    assert f"manip report {run} --episodes 2" in page


@pytest.mark.parametrize("program", sorted(main.PROGRAMS))
def test_every_program_explains_itself(program: str, manip: Manip) -> None:
    result = manip(program, "--help")
    assert (result.code, result.err) == (0, "")
    assert f"usage: manip {program}" in result.out
    assert program in manip("--help").out


SCRIPTS = {path.stem: path for path in (ROOT / "scripts").glob("*.py")}


def test_every_program_is_a_script() -> None:
    assert set(main.PROGRAMS) <= set(SCRIPTS)


@pytest.mark.parametrize("script", sorted(SCRIPTS.values()), ids=sorted(SCRIPTS))
def test_every_script_explains_itself(script: Path, monkeypatch, capsys) -> None:
    monkeypatch.setattr(sys, "argv", [str(script), "--help"])
    monkeypatch.syspath_prepend(str(script.parent))  # as `python script` does
    with pytest.raises(SystemExit, match="0"):
        runpy.run_path(str(script), run_name="__main__")
    assert "usage:" in capsys.readouterr().out


def test_the_package_is_a_program_too(monkeypatch, capsys) -> None:
    monkeypatch.setattr(sys, "argv", ["manip"])
    with pytest.raises(SystemExit, match="0"):
        runpy.run_module("manip", run_name="__main__")
    assert "usage: manip PROGRAM" in capsys.readouterr().out


def test_a_later_program_keeps_no_garbage(manip: Manip) -> None:
    manip("list")
    cycle = UserError()
    cycle.itself = cycle
    reference = weakref.ref(cycle)
    del cycle
    manip("list")
    gc.collect()
    assert reference() is None


def refusal(result: Result) -> str:
    """The one line that a program leaves when it refuses."""
    assert result.code == 2, result
    assert result.out == ""
    (line,) = result.err.splitlines()
    assert line.startswith("manip: error: ")
    assert list(Path().iterdir()) == []
    return line


@pytest.mark.parametrize(
    ("command", "message"),
    [
        ("trian", "unknown program 'trian': did you mean 'train'? known programs: "),
        ("train --task Raech", "did you mean 'Reach'? known tasks: .*Lift.*Reach"),
        ("train --task no.module:Task", "cannot import task 'no.module:Task'"),
        ("train --task /tmp/press.py", "is a file: name its class as module:Class"),
        ("train --task json:dumps", "must be a class, not <function dumps"),
        ("train --algo ddqn", "unknown algorithm 'ddqn': did you mean 'dqn'.*sac"),
        ("train --robot panda", "did you mean 'Panda'? known robots: "),
        ("train --controller OSC", "controller must be one of .*'OSC_POSITION'"),
        ("train --fidelity coarse", "Expected one of ('exact', 'fast')"),
        ("train --reward sparse", "Expected one of ('shaped', 'stock')"),
        ("train --control-freq 30", "control_freq 30 is not supported: .*25, 50, 100"),
        ("train --steps many", "--steps: invalid literal for int.*'many'"),
        ("train --steps 0", "steps must be at least 1, not 0"),
        ("train --eval-every 0", "eval_every must be at least 1, not 0"),
        ("train --num-envs 0", "num_envs must be at least 1, not 0"),
        ("train --threads 0", "threads must be at least 1, not 0"),
        ("train --seed -1", "seed must be at least 0, not -1"),
        (
            "train --agent.learning-rate nan",
            "learning_rate must be at least 0, not nan",
        ),
        ("train --agent.actor-hidden -3", "actor_hidden must be at least 1, not -3"),
        ("train --algo ppo --num-envs 10000000000 --steps 1", "not enough memory"),
        ("train --lr 3", "did you mean --agent.learning-rate?"),
        ("train --stepz 3", "Unrecognized options: --stepz.*--steps INT"),
        ("train --agent.gama 1", "Unrecognized options: --agent.gama.*--agent.gamma"),
        ("train --algo ppo --agent.tau 1", "Unrecognized options: --agent.tau, 1"),
        (
            "train --agent.action-scale 1 1",
            "agent.action_scale has 2 numbers, but OSC_POSE",
        ),
        ("train Reach", "Unrecognized options: Reach"),
        ("train --out", "Missing value for argument '--out'"),
        ("train --wandb mine", "--wandb needs the package wandb: pip install wandb"),
        ("train --out /dev/null/x --steps 1", "Not a directory"),
        ("train --resume", "--resume needs --out with a run folder"),
        ("train --resume --out nowhere", "there is no nowhere/config.yaml"),
        ("evaluate", "Missing from manip evaluate: PATH"),
        ("evaluate nowhere", "nowhere holds no policy: .*is it a run folder"),
        ("evaluate RUN --env gazebo", "Expected one of ('native', 'stock', 'warp')"),
        ("evaluate RUN --episodes 0", "--episodes must be at least 1, not 0"),
        ("evaluate RUN --episodes 200000", "--episodes must be at most 100000"),
        ("evaluate RUN --json .", "--json . is a folder: name a file"),
        (
            "evaluate RUN --json /dev/null/x",
            "--json /dev/null/x: /dev/null is not",
        ),
        (f"evaluate RUN --episodes {10**20}", "--episodes must be at most 10000000000"),
        ("evaluate RUN --seed -1", "--seed must be at least 0, not -1"),
        ("render nowhere", "nowhere holds no policy"),
        ("render RUN --before Lift", "--before is a policy for Lift, and the other"),
        ("report", "name 1 to 20 runs, not 0"),
        ("report nowhere", "nowhere holds no policy"),
        ("report RUN --out page.pdf", "known file formats: .html"),
        ("report RUN --episodes 0", "--episodes must be at least 1, not 0"),
        ("render RUN --steps 0", "--steps must be at least 1, not 0"),
        ("render RUN --fps 0", "--fps must be from 0.01 to 1000, not 0"),
        ("render RUN --view 1 2", "--view must be four to six numbers"),
        ("render RUN --episode 1 --failures 1", "shows one episode"),
        ("render RUN --width 0", "--width must be at least 1, not 0"),
        ("render RUN --width 100000", "--width must be at most 4096"),
        ("render RUN --episodes 100000", "--episodes must be at most 1000"),
        ("render RUN --out film.avi", "known file formats: .mp4, .gif, .png"),
        ("render RUN --out /proc/film.mp4", "/proc is not writable"),
        ("results --readme .", "--readme . is a folder: name a file"),
        ("list --jsn", "Unrecognized options: --jsn.*--json"),
        ("doctor --jsn", "Unrecognized options: --jsn"),
    ],
)
def test_mistakes_are_one_line_and_leave_nothing(
    command: str, message: str, manip: Manip, run: Path
) -> None:
    arguments = [str(run) if a == "RUN" else a for a in command.split()]
    line = refusal(manip(*arguments))
    start = 0
    for piece in message.split(".*"):
        assert piece in line[start:], line
        start = line.index(piece, start)


@pytest.mark.skipif(gl.find_backend() is None, reason=gl.INSTALL_HINT)
def test_an_unknown_camera_is_refused_before_the_episodes(
    manip: Manip, run: Path, monkeypatch
) -> None:
    monkeypatch.setattr(render, "record", None)
    camera = manip("render", str(run), "--camera", "frontveiw")
    assert "did you mean 'frontview'? known cameras: workspace," in refusal(camera)


def test_without_a_display_there_is_no_window(manip, run, monkeypatch) -> None:
    for variable in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(variable, raising=False)
    monkeypatch.setattr(platform, "system", lambda: "Linux")
    assert "no display (DISPLAY is not set)" in refusal(manip("view", str(run)))
    monkeypatch.setenv("DISPLAY", ":99")
    assert "GLFW does not find a display" in refusal(manip("view", str(run)))


def with_card(run: Path, folder: Path, **changes: object) -> Path:
    """A copy of a run whose policy has another card."""
    shutil.copytree(run, folder)
    policy = load_policy(folder)
    replace(policy, card=replace(policy.card, **changes)).save(folder / "policy")
    return folder


def test_a_task_of_another_library_is_not_rendered(manip, run, monkeypatch) -> None:
    def visual_model(env_id: int) -> None:
        raise UserError("dm_control/reach is stepped by dm_control")

    other = SimpleNamespace(batch=SimpleNamespace(visual_model=visual_model))
    monkeypatch.setattr(episode_recording, "make_env", lambda *_: other)
    monkeypatch.setattr(render, "record", None)
    line = refusal(manip("render", str(run)))
    assert "dm_control/reach is stepped by dm_control" in line


def test_a_card_of_odd_text_is_refused_in_inert_text(manip, run, tmp_path) -> None:
    text = "[red]ppo[/red] [/nonsense] \x1b[2J\n"
    folder = with_card(run, tmp_path.parent / f"{tmp_path.name}-run", algo=text)
    for program in ("evaluate", "render"):
        line = refusal(manip(program, str(folder)))
        assert "[red]ppo[/red] [/nonsense]" in line
        assert "\x1b" not in line


def test_a_result_is_saved_before_it_is_printed(
    run, tmp_path: Path, monkeypatch
) -> None:
    monkeypatch.chdir(tmp_path)

    def fail(result: object) -> None:
        raise RuntimeError("a table that cannot be drawn")

    monkeypatch.setattr(evaluate, "table", fail)
    options = ["--env", "native", "--episodes", "1", "--json", "eval.json"]
    with pytest.raises(RuntimeError, match="cannot be drawn"):
        cli.run(evaluate.main, [str(run), *options])
    assert json.loads(Path("eval.json").read_text())["episodes"] == 1


def children(pid: int) -> set[int]:
    """Processes that descend from one."""
    parents = {}
    for stat in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError):
            fields = stat.read_text().rpartition(")")[2].split()
            parents[int(stat.parent.name)] = int(fields[1])
    descendants, fresh = set(), {pid}
    while fresh:
        fresh = {child for child, parent in parents.items() if parent in fresh}
        descendants |= fresh
    return descendants


def running(pid: int) -> bool:
    with contextlib.suppress(OSError):
        return "Z" not in Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2][:3]
    return False


WORKERS = """
import signal, sys
from manip.evaluation import runners
from manip.programs import cli, evaluate
runners.usable_cpus = lambda: 2
sys.exit(cli.run(evaluate.main, [*sys.argv[1:], "--episodes", "100000"]))
"""


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="needs /proc")
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGKILL])
def test_a_killed_evaluation_leaves_no_workers(run: Path, number: int) -> None:
    program = subprocess.Popen(
        [sys.executable, "-c", WORKERS, str(run)],
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        stderr=subprocess.DEVNULL,
    )
    workers: set[int] = set()
    deadline = time.monotonic() + 120
    while len(workers) < 3 and time.monotonic() < deadline:  # and resource tracker
        time.sleep(0.2)
        workers |= children(program.pid)
    program.send_signal(number)
    program.wait(30)
    while any(map(running, workers)) and time.monotonic() < deadline:
        time.sleep(0.2)
    assert len(workers) >= 2
    assert not any(map(running, workers))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{", "is damaged: "),
        ("just text", "is damaged: expected a mapping of options"),
        ("stepz: 3", "did you mean 'steps'"),
        ("steps: many", "steps must be a whole number, not 'many'"),
        ("task: [3]", "task must be text, not [3]"),
        (f"steps: 0x{'f' * 9000}", "steps must be a whole number, not a number too"),
        ("9" * 9000, "is damaged: Exceeds the limit"),
        ("[" * 9000, "is damaged: maximum recursion depth exceeded"),
        (LAUGHS, "anchors and aliases (&, *) are not allowed"),
        ("task: '..:x'", "cannot import task '..:x': TypeError: "),
    ],
)
def test_a_damaged_config_is_refused_when_resuming(
    text, message, manip, tmp_path
) -> None:
    folder = tmp_path.parent / f"{tmp_path.name}-run"
    folder.mkdir()
    (folder / "config.yaml").write_text(text)
    assert message in refusal(manip("train", "--resume", "--out", str(folder)))


def test_too_little_memory_is_one_line(capsys) -> None:
    def greedy(arguments: object) -> int:
        raise MemoryError("Unable to allocate 12. TiB")

    assert cli.run(greedy, []) == 2
    message = "manip: error: not enough memory: Unable to allocate 12. TiB\n"
    assert capsys.readouterr().err == message


def test_a_damaged_policy_is_refused(manip: Manip, run: Path, tmp_path: Path) -> None:
    folder = tmp_path.parent / f"{tmp_path.name}-run"
    shutil.copytree(run, folder)
    (folder / "policy" / WEIGHTS).write_bytes(b"{}")
    for program in ("evaluate", "render"):
        assert "is damaged or not a manip file" in refusal(manip(program, str(folder)))


def test_a_policy_of_another_observation_is_refused(manip, run, tmp_path) -> None:
    folder = tmp_path.parent / f"{tmp_path.name}-run"
    first, *rest = load_policy(run).card.observation
    with_card(run, folder, observation=[first | {"name": "wings"}, *rest])
    message = "manip: error: the policy was trained on another observation than "
    for program in ("evaluate --env native", "evaluate --env stock", "render"):
        result = manip(*program.split(), str(folder), "--episodes", "1")
        assert (result.code, result.out) == (2, "")
        assert result.err.strip().startswith(message)


def test_the_installed_command_refuses_as_programs_do(tmp_path: Path) -> None:
    command = Path(sys.executable).with_name("manip")
    done = subprocess.run(
        [str(command), "trian"], cwd=tmp_path, capture_output=True, text=True
    )
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.startswith("manip: error: unknown program 'trian'")
    assert done.stderr.count("\n") == 1
