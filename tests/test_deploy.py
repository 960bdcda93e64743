"""Policies outside manip: formulas, exported files, the runner, the numpy program."""

import io
import json
import subprocess
import sys
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest
import torch
from test_policy import make_policy

from manip.agents import exports
from manip.agents.exports import SUFFIXES, examples, export_policy
from manip.agents.image_actor import ImageActor
from manip.agents.image_encoder import EncoderSizes
from manip.agents.networks import Actor, BinnedActor
from manip.agents.policy import CARD, Policy, load_policy, shipped_policies
from manip.agents.policy_card import read_card
from manip.cameras import CameraConfig
from manip.deploy import __main__ as deploy
from manip.deploy.exported_policy import open_policy
from manip.deploy.formulas import LONGEST, evaluate, parse_formula
from manip.deploy.runner import Runner, _image, rotation_of
from manip.envs.backends.native_batch import NativeBatch
from manip.envs.interface import interface_of
from manip.envs.task_registry import load_task
from manip.envs.traced import Traced
from manip.errors import UserError
from manip.programs import cli, export

ROOT = Path(__file__).parents[1]

FORBIDDEN = ("torch", "mujoco", "robosuite", "numba", "tensordict", "scipy")


def policy_of_kind(kind: str) -> Policy:
    """A small policy whose network has the form of an algorithm's."""
    policy = make_policy()
    card = policy.card
    if kind == "sac":
        return policy
    if kind == "ppo":
        actor = Actor(6, 3, card.hidden, False, True, (1.0, 0.5, 0.25))
        actor.norm.update(5 + 3 * torch.randn(100, 6))
        return Policy(replace(card, squash=False), actor)
    binned = BinnedActor(6, 3, card.hidden, 5, (1.0, 0.5, 0.25))
    return Policy(replace(card, squash=False, normalise=False, bins=5), binned)


@pytest.fixture(scope="module")
def numpy_program() -> dict:
    source = (ROOT / "docs/numpy_policy/act.py").read_text()
    assert "manip" not in source
    names: dict = {"__name__": "act"}
    exec(source, names)
    return names


@pytest.mark.parametrize("kind", ["sac", "ppo", "dqn"])
def test_the_numpy_program_gives_the_actions(kind, numpy_program, tmp_path) -> None:
    policy = policy_of_kind(kind)
    policy.save(tmp_path)
    x = 5 + 3 * torch.randn(50, 6)
    expected = policy.actor.double().decide(x.double()).detach().numpy()
    actions = numpy_program["act"](tmp_path, x.double().numpy())
    assert np.abs(actions - expected).max() < 1e-9
    assert np.ptp(actions, 0).min() > 1e-3


@pytest.mark.parametrize("kind", ["sac", "ppo", "dqn"])
@pytest.mark.parametrize("form", ["onnx", "torchscript", "numpy"])
def test_an_exported_file_acts_as_the_policy(form, kind, tmp_path) -> None:
    if form == "onnx":
        pytest.importorskip("onnx")
        pytest.importorskip("onnxruntime")
    policy = policy_of_kind(kind)
    path = tmp_path / f"policy{SUFFIXES[form]}"
    assert export_policy(policy, form, path) <= exports.TOLERANCE[form]
    if form == "torchscript":
        extra = {"manip.json": ""}
        torch.jit.load(path, _extra_files=extra)
        card = json.loads(extra["manip.json"])
    else:
        card, act = open_policy(str(path))
        one, many = (examples(policy, n)[0].numpy() for n in (1, 9))
        assert act(one).shape == (1, 3)
        assert act(many).shape == (9, 3)
    assert card == json.loads(json.dumps(policy.described))


def test_a_policy_with_cameras_is_exported(tmp_path: Path) -> None:
    pytest.importorskip("onnx")
    pytest.importorskip("onnxruntime")
    part = CameraConfig(("front",), 16, "exact", 1).parts[0]
    arm = make_policy().card.observation[:1]
    card = replace(
        make_policy().card,
        normalise=False,
        observation=[*arm, part._asdict() | {"shape": [*part.shape]}],
        image_channels=[4],
        image_features=8,
    )
    actor = ImageActor(EncoderSizes((part.shape,), (4,), 8), 4, 3, [8, 8], True, False)
    policy, path = Policy(card, actor), tmp_path / "policy.onnx"
    assert export_policy(policy, "onnx", path) < 1e-5
    _, act = open_policy(str(path))
    assert act(*(i.numpy() for i in examples(policy, 3))).shape == (3, 3)
    with pytest.raises(UserError, match="for policies that see the state"):
        export_policy(policy, "numpy", tmp_path / "policy.npz")


def test_a_file_that_acts_differently_is_not_written(monkeypatch, tmp_path) -> None:
    path = tmp_path / "policy.npz"
    monkeypatch.setattr(exports, "_text", lambda policy: json.dumps(_wrong(policy)))
    with pytest.raises(UserError, match="acts differently from the policy by 1"):
        export_policy(policy_of_kind("ppo"), "numpy", path)
    assert list(tmp_path.iterdir()) == []


def _wrong(policy: Policy) -> dict:
    card = policy.described
    card["network"]["normaliser"]["epsilon"] = 10.0
    return card


@pytest.mark.parametrize(
    "text",
    [
        "__import__('os')",
        "x.__class__",
        "(lambda: 1)()",
        "[x for x in y]",
        "2 ** 9",
        "'text'",
        "clip(x, a=1)",
        "open(1)",
        "x[1:2:3]",
        "-" * 500 + "x",
        "(" * 500 + "x" + ")" * 500,
        "x + " * LONGEST + "x",
        "1 if x else 2",
        "",
    ],
)
def test_only_arithmetic_is_a_formula(text: str) -> None:
    with pytest.raises(ValueError, match="formula"):
        parse_formula(text)
    card = replace(make_policy().card, formulas={"arm": text})
    with pytest.raises(UserError, match="formula"):
        read_card(asdict(card))


def test_a_formula_is_evaluated() -> None:
    text = "concat(clip(10.0 * (a - [1, 0, 0]), -5, 5)[:2], vector(a[2] > 0.5))"
    values = {"a": np.array([1.2, 3.0, 0.7])}
    assert evaluate(parse_formula(text), values).tolist() == pytest.approx([2, 5, 1])


@pytest.mark.parametrize("axis", [1, -1])
def test_a_test_of_all_entries_of_a_row_has_a_formula(axis: int) -> None:
    inside = (np.abs(Traced(np.ones((4, 3)), "a")) < 2).all(axis=axis)
    assert (inside.text, inside.value.tolist()) == ("all((abs(a) < 2))", [True] * 4)


def test_a_policy_of_an_earlier_version_loads(tmp_path: Path) -> None:
    policy = make_policy()
    values = asdict(policy.card)
    for name in ("horizon", "fidelity", "evaluation"):
        del values[name]
    for name in ("measurements", "formulas", "control"):
        del values[name]
    assert read_card(values) == policy.card
    policy.save(tmp_path)
    (tmp_path / CARD).write_text(json.dumps(values))
    assert load_policy(tmp_path).card == policy.card  # without a warning


@pytest.fixture(scope="module")
def exported(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("exported") / "lift.npz"
    export_policy(load_policy("Lift"), "numpy", path)
    return path


def test_the_runner_observes_and_acts_as_the_environment(
    exported: Path, lift, lift_scene
) -> None:
    batch = NativeBatch(lift, 2, scene=lift_scene, threads=1)
    batch.begin(np.arange(2))
    policy, runner = load_policy("Lift"), Runner(str(exported))
    names = runner.card["measurements"].keys() - {"gripper_closing"}
    for _ in range(30):
        read = batch.read()
        measured = {name: read[name][0] for name in names}
        parts = batch.observation_spec.split(batch.observe().observation)
        found = runner.observe(measured)
        for name, values in found.items():
            np.testing.assert_array_equal(values, parts[name][0], name)
        command = runner.step(measured)
        action = policy({name: torch.from_numpy(p) for name, p in parts.items()})
        np.testing.assert_allclose(command.action, action[0], atol=1e-5)
        moved = command.position - (read["eef_pos"][0] - [-0.56, 0, 0.912])
        np.testing.assert_allclose(moved, 0.05 * command.action[:3], atol=1e-9)
        batch.step(np.array([command.action, batch.expert()[1]]))
        assert command.closing == pytest.approx(batch.read()["gripper_closing"][0])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"cube_pos": None}, "cube_pos is missing: position of body cube_main"),
        ({"cube_pos": [0.0, 0.0]}, r"cube_pos must be finite numbers of shape \[3\]"),
        ({"eef_pos": [0.0, 0.0, np.nan]}, "eef_pos must be finite"),
    ],
)
def test_a_wrong_measurement_is_named(change, message, exported) -> None:
    runner = Runner(str(exported))
    measured = {
        name: np.zeros([int(size) for size in entry["shape"].split()])
        for name, entry in runner.card["measurements"].items()
    }
    measured |= change
    measured = {name: v for name, v in measured.items() if v is not None}
    with pytest.raises(ValueError, match=message):
        runner.observe(measured)


@pytest.mark.parametrize(
    "image",
    [
        np.zeros((4, 4, 3), np.float32),
        np.full((4, 4, 3), 300),
        np.full((4, 4, 3), -1),
        np.full((4, 4, 3), 10**30, object),
        np.zeros((3, 4, 4), np.uint8),
        np.zeros(48, np.uint8),
    ],
)
def test_an_array_that_is_no_image_is_refused(image: np.ndarray) -> None:
    with pytest.raises(ValueError, match=r"numbers from 0 to 255 of shape \[4, 4"):
        _image("wrist_image", image.tolist(), [4, 4, 3])


def test_an_image_may_come_as_lists() -> None:
    image = np.arange(48).reshape(4, 4, 3)
    checked = _image("wrist_image", image.tolist(), [4, 4, 3])
    np.testing.assert_array_equal(checked, image.astype(np.uint8))


def test_the_runner_needs_neither_torch_nor_mujoco(exported: Path) -> None:
    card = load_policy("Lift").card
    measured = {
        name: np.full([int(size) for size in entry["shape"].split()], 0.1).tolist()
        for name, entry in card.measurements.items()
        if name != "gripper_closing"
    }
    program = f"""
import runpy, sys
for name in {FORBIDDEN}:
    sys.modules[name] = None
sys.argv = ["manip.deploy", {str(exported)!r}]
runpy.run_module("manip.deploy", run_name="__main__")
print(sorted(name for name in sys.modules if name.startswith("manip")))
"""
    lines = [json.dumps(measured)] * 2 + [json.dumps({"reset": True} | measured)]
    done = subprocess.run(
        [sys.executable, "-c", program],
        input="\n".join(lines),
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    *answers, modules = done.stdout.splitlines()
    first, second, third = map(json.loads, answers)
    assert first == third != second  # the gripper's command went on
    assert np.shape(first["action"]) == (7,)
    assert np.shape(first["rotation"]) == (3, 3)
    expected = ["deploy.exported_policy", "deploy.formulas", "deploy.runner"]
    assert all(name in modules for name in expected)
    assert "manip.agents" not in modules


def test_a_line_that_cannot_be_used_is_answered_with_an_error(
    exported: Path, monkeypatch, capsys
) -> None:
    lines = ["{", "[1]", '{"cube_pos": [0, 0, 0]}', '{"reset": true}']
    monkeypatch.setattr(sys, "argv", ["manip.deploy", str(exported)])
    monkeypatch.setattr(sys, "stdin", io.StringIO("\n".join(lines)))
    deploy.main()
    answers = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [[*answer] for answer in answers] == [["error"]] * 3
    assert "the line is no JSON" in answers[0]["error"]
    assert "is missing" in answers[2]["error"]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ([], "usage: python -m manip.deploy POLICY"),
        (["policy.pt"], "policy.pt must be an .onnx or .npz file"),
        (["none.npz"], "No such file"),
    ],
)
def test_a_file_that_cannot_be_run_is_one_line(
    arguments: list[str], message: str, monkeypatch
) -> None:
    monkeypatch.setattr(sys, "argv", ["manip.deploy", *arguments])
    with pytest.raises(SystemExit, match=message):
        deploy.main()


def test_the_format_follows_the_ending_of_the_file(tmp_path: Path, capsys) -> None:
    assert cli.run(export.main, ["Wipe", "--out", str(tmp_path / "wipe.npz")]) == 0
    card, _ = open_policy(str(tmp_path / "wipe.npz"))
    assert card["task"] == "Wipe"
    assert "no formula gives" in capsys.readouterr().err
    assert cli.run(export.main, ["Lift", "--out", str(tmp_path / "lift.xyz")]) == 2
    assert "known file formats: .onnx, .pt, .npz" in capsys.readouterr().err


def test_a_rotation_vector_becomes_a_matrix() -> None:
    np.testing.assert_allclose(
        rotation_of(np.array([0, 0, np.pi / 2])),
        [[0, -1, 0], [1, 0, 0], [0, 0, 1]],
        atol=1e-12,
    )
    assert (rotation_of(np.zeros(3)) == np.eye(3)).all()


@pytest.mark.slow
def test_the_runner_drives_stock_robosuite_over_a_pipe(exported: Path) -> None:
    program = ROOT / "docs/real_arm/drive_stock.py"
    done = subprocess.run(
        [sys.executable, program, "Lift", exported, "--episodes", "1"],
        capture_output=True,
        text=True,
    )
    assert "over the pipe 1, in this process 1 of 1" in done.stdout, done.stderr


@pytest.mark.slow
@pytest.mark.parametrize("name", shipped_policies())
def test_shipped_cards_are_up_to_date(name: str) -> None:
    card = load_policy(name).card
    batch = NativeBatch(load_task(card.task), 1, robot=card.robot_config, threads=1)
    fresh = interface_of(batch, card.observation_spec.names)
    assert fresh.formulas == card.formulas
    assert fresh.measurements == card.measurements
    assert card.horizon == batch.horizon
