"""Programs from their command lines: what they make, say and refuse."""

import json
import runpy
import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import imageio_ffmpeg
import pytest
import yaml

from manip.agents.policy import WEIGHTS, load_policy
from manip.agents.registry import algorithm_names
from manip.envs.backends.external_batch import external_names
from manip.envs.task_registry import task_names
from manip.evaluation import runners as evaluation
from manip.programs import cli, main
from manip.robot_config import CONTROLLERS, ROBOTS
from manip.sim import gl
from manip.training.config import recipe_names

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
    *("task", "robot", "algo", "env", "fidelity", "episodes", "seed"),
    *(
        "env_steps_trained",
        "success",
        "return_mean",
        "milestones",
        "seconds",
        "versions",
    ),
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


def test_train_says_where_the_policy_lies(manip: Manip, tmp_path: Path) -> None:
    found = manip("train", *TINY, "--seed", "5")
    folder = Path("runs") / "Reach-ppo-5"
    assert found.code == 0
    assert found.err.splitlines()[-1] == f"trained policy: {folder / 'policy'}"
    assert "Traceback" not in found.err
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


def judged(manip: Manip, run: Path, *options: str) -> dict:
    found = manip("evaluate", str(run), "--json", "new/eval.json", *options)
    assert found.code == 0, found.err
    assert "Reach · Panda · ppo" in found.out
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
    first, second = (judged(manip, run, *options) for _ in range(2))
    assert_contract(first, "native", 3, 7)
    assert first["fidelity"] == "exact"
    for result in (first, second):
        del result["seconds"]
    assert first == second
    fast = judged(manip, run, *options, "--fidelity", "fast")
    assert fast["fidelity"] == "fast"
    assert fast["return_mean"] != first["return_mean"]


def test_stock_evaluation_writes_the_contract(manip, run, monkeypatch) -> None:
    monkeypatch.setattr(evaluation, "usable_cpus", lambda: 1)
    result = judged(manip, run, "--episodes", "2", "--seed", "3")
    assert_contract(result, "stock", 2, 3)
    assert result["fidelity"] == "exact"


@pytest.mark.slow
def test_stock_episodes_do_not_depend_on_the_workers(manip, run, monkeypatch) -> None:
    results = []
    for workers in (1, 2):
        monkeypatch.setattr(evaluation, "usable_cpus", lambda n=workers: n)
        results.append(judged(manip, run, "--episodes", "3"))
        del results[-1]["seconds"]
    assert results[0] == results[1]


def test_list_names_everything_there_is(manip: Manip) -> None:
    found = json.loads(manip("list", "--json").out)
    assert found["tasks"] == task_names() != []
    assert found["external_tasks"] == external_names() != []
    assert found["robots"] == list(ROBOTS)
    assert found["algorithms"] == algorithm_names()
    assert found["action_spaces"] == list(CONTROLLERS)
    assert found["recipes"] == recipe_names() != []
    assert isinstance(found["policies"], list)
    table = manip("list").out
    assert all(name in table for names in found.values() for name in names)


@pytest.mark.skipif(gl.find_backend() is None, reason=gl.INSTALL_HINT)
def test_render_films_the_steps_asked_for(manip: Manip, run: Path) -> None:
    size = ("--width", "96", "--height", "64")
    found = manip("render", str(run), "--steps", "5", "--episodes", "2", *size)
    assert (found.code, found.out) == (0, "video.mp4\n")
    reader = imageio_ffmpeg.read_frames("video.mp4")
    shown = next(reader)
    assert (shown["size"], shown["fps"]) == ((96, 64), 20)
    assert len(list(reader)) == 2 * 5


@pytest.mark.parametrize("program", sorted(main.PROGRAMS))
def test_every_program_explains_itself(program: str, manip: Manip) -> None:
    found = manip(program, "--help")
    assert (found.code, found.err) == (0, "")
    assert f"usage: manip {program}" in found.out
    assert program in manip("--help").out


SCRIPTS = {path.stem: path for path in (ROOT / "scripts").glob("*.py")}


def test_every_program_is_a_script() -> None:
    assert set(main.PROGRAMS) <= set(SCRIPTS)


@pytest.mark.parametrize("script", sorted(SCRIPTS.values()), ids=sorted(SCRIPTS))
def test_every_script_explains_itself(script: Path, monkeypatch, capsys) -> None:
    monkeypatch.setattr(sys, "argv", [str(script), "--help"])
    with pytest.raises(SystemExit, match="0"):
        runpy.run_path(str(script), run_name="__main__")
    assert "usage:" in capsys.readouterr().out


def refusal(found: Result) -> str:
    """The one line that a program leaves when it refuses."""
    assert found.code == 2, found
    assert found.out == ""
    (line,) = found.err.splitlines()
    assert line.startswith("manip: error: ")
    assert list(Path().iterdir()) == []
    return line


@pytest.mark.parametrize(
    ("command", "told"),
    [
        ("trian", "unknown program 'trian': did you mean 'train'? known programs: "),
        ("train --task Raech", "did you mean 'Reach'? known tasks: .*Lift.*Reach"),
        ("train --task no.module:Task", "cannot import task 'no.module:Task'"),
        ("train --task json:dumps", "must be a subclass of manip.envs.Task"),
        ("train --algo ddqn", "unknown algorithm 'ddqn': did you mean 'dqn'.*sac"),
        ("train --robot panda", "did you mean 'Panda'? known robots: "),
        ("train --controller OSC", "Expected one of .*'OSC_POSITION'"),
        ("train --fidelity coarse", "Expected one of ('exact', 'fast')"),
        ("train --reward sparse", "Expected one of ('shaped', 'stock')"),
        ("train --control-freq 30", "30 Hz is not possible: .*10, 20, 25, 50, 100 Hz"),
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
        ("train --stepz 3", "Unrecognized options: --stepz.*--steps INT"),
        ("train --agent.gama 1", "Unrecognized options: --agent.gama.*--agent.gamma"),
        ("train --algo ppo --agent.tau 1", "Unrecognized options: --agent.tau, 1"),
        (
            "train --agent.action-scale 1 1",
            "agent.action_scale has 2 numbers, but OSC_POSE",
        ),
        ("train Reach", "Unrecognized options: Reach"),
        ("train --out", "Missing value for argument '--out'"),
        ("train --wandb mine", "--wandb needs a package that is not there"),
        ("train --out /dev/null/x --steps 1", "Not a directory"),
        ("train --resume", "--resume needs --out with a run folder"),
        ("train --resume --out nowhere", "there is no nowhere/config.yaml"),
        ("evaluate", "Missing from manip evaluate: PATH"),
        ("evaluate nowhere", "nowhere holds no policy .*is it a run folder"),
        ("evaluate RUN --env gazebo", "Expected one of ('stock', 'native')"),
        ("evaluate RUN --episodes 0", "--episodes must be at least 1, not 0"),
        (f"evaluate RUN --episodes {10**20}", "--episodes must be at most 10000000000"),
        ("evaluate RUN --seed -1", "--seed must be at least 0, not -1"),
        ("render nowhere", "nowhere holds no policy"),
        ("render RUN --steps 0", "--steps must be at least 1, not 0"),
        ("render RUN --width 0", "--width must be at least 1, not 0"),
        ("list --jsn", "Unrecognized options: --jsn.*--json"),
        ("doctor --jsn", "Unrecognized options: --jsn"),
    ],
)
def test_mistakes_are_one_line_and_leave_nothing(
    command: str, told: str, manip: Manip, run: Path
) -> None:
    arguments = [str(run) if a == "RUN" else a for a in command.split()]
    line = refusal(manip(*arguments))
    at = 0
    for piece in told.split(".*"):
        assert piece in line[at:], line
        at = line.index(piece, at)


@pytest.mark.skipif(gl.find_backend() is None, reason=gl.INSTALL_HINT)
def test_mistakes_about_pictures_name_what_exists(manip: Manip, run: Path) -> None:
    camera = manip("render", str(run), "--camera", "frontveiw", "--steps", "1")
    assert "did you mean 'frontview'? known cameras: workspace," in refusal(camera)
    kind = manip("render", str(run), "--out", "film.avi", "--steps", "1")
    assert "known animation formats: .mp4, .gif" in refusal(kind)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("{", "is damaged: "),
        ("just text", "is damaged: it holds no options"),
        ("stepz: 3", "did you mean 'steps'"),
        ("steps: many", "steps must be a whole number, not 'many'"),
        ("task: [3]", "task must be text, not [3]"),
        (f"steps: 0x{'f' * 9000}", "steps must be a whole number, not a number too"),
        ("9" * 9000, "is damaged: Exceeds the limit"),
        ("[" * 9000, "is damaged: maximum recursion depth exceeded"),
        (LAUGHS, "task must be text, not [['ha'], [["),
        ("task: '..:x'", "cannot import task '..:x': TypeError: "),
    ],
)
def test_a_damaged_config_is_told_when_resuming(text, told, manip, tmp_path) -> None:
    folder = tmp_path.parent / f"{tmp_path.name}-run"
    folder.mkdir()
    (folder / "config.yaml").write_text(text)
    assert told in refusal(manip("train", "--resume", "--out", str(folder)))


def test_too_little_memory_is_told(capsys) -> None:
    def greedy(arguments: object) -> int:
        raise MemoryError("Unable to allocate 12. TiB")

    assert cli.run(greedy, []) == 2
    told = "manip: error: not enough memory: Unable to allocate 12. TiB\n"
    assert capsys.readouterr().err == told


def test_a_damaged_policy_is_told(manip: Manip, run: Path, tmp_path: Path) -> None:
    folder = tmp_path.parent / f"{tmp_path.name}-run"
    shutil.copytree(run, folder)
    (folder / "policy" / WEIGHTS).write_bytes(b"{}")
    for program in ("evaluate", "render"):
        assert "is damaged or not a manip file" in refusal(manip(program, str(folder)))


def test_a_policy_of_another_observation_is_told(manip, run, tmp_path) -> None:
    folder = tmp_path.parent / f"{tmp_path.name}-run"
    shutil.copytree(run, folder)
    policy = load_policy(folder)
    first, second, *_ = policy.card.layout
    parts = policy.card.layout[first], policy.card.layout[second]
    swapped = policy.card.layout | dict(zip((second, first), parts, strict=True))
    replace(policy, card=replace(policy.card, layout=swapped)).save(folder / "policy")
    told = f"trained on another observation than Reach shows: {first}, {second} differ"
    for program in ("evaluate --env native", "evaluate --env stock", "render"):
        found = manip(*program.split(), str(folder), "--episodes", "1")
        assert (found.code, found.out) == (2, "")
        assert found.err.strip() == f"manip: error: the policy was {told}"


def test_the_installed_command_refuses_as_programs_do(tmp_path: Path) -> None:
    command = Path(sys.executable).with_name("manip")
    done = subprocess.run(
        [str(command), "trian"], cwd=tmp_path, capture_output=True, text=True
    )
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.startswith("manip: error: unknown program 'trian'")
    assert done.stderr.count("\n") == 1
