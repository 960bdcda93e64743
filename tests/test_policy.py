"""Policies as files: equal actions, and plain words for what cannot be read."""

import pickle
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch
from safetensors.torch import load_file, save_file

from manip.agents import policy as policies
from manip.agents.networks import Actor
from manip.agents.policy import CARD, WEIGHTS, Policy, PolicyCard, load_policy
from manip.errors import DamagedError, UserError
from manip.io.tensor_trees import load_tree, save_tree


def make_policy(squash: bool = True, normalise: bool = True) -> Policy:
    torch.manual_seed(0)
    card = PolicyCard(
        task="Lift",
        robot="Panda",
        algo="sac",
        controller="OSC_POSE",
        control_freq=20,
        action_dim=3,
        layout={"arm": [0, 4], "cube": [4, 6]},
        hidden=[8, 8],
        squash=squash,
        normalise=normalise,
        env_steps=1000,
        seed=0,
        versions={"python": "3"},
    )
    scale = (1.0, 0.5, 0.25)
    actor = Actor(6, 3, card.hidden, squash, normalise, action_scale=scale)
    if normalise:
        actor.norm.update(5 + 3 * torch.randn(100, 6))
    return Policy(card, actor)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    make_policy().save(tmp_path / "policy")
    return tmp_path / "policy"


@pytest.mark.parametrize("squash", [False, True])
@pytest.mark.parametrize("normalise", [False, True])
def test_a_loaded_policy_acts_as_the_saved_one(squash, normalise, tmp_path) -> None:
    policy = make_policy(squash, normalise)
    policy.save(tmp_path)
    loaded = load_policy(tmp_path)
    observation = 5 + 3 * torch.randn(20, 6)
    action = policy(observation)
    assert loaded.card == policy.card
    assert torch.equal(loaded(observation), action)
    assert action.shape == (20, 3)
    assert action.abs().max() <= 1
    assert not action.requires_grad


def test_a_run_folder_leads_to_its_policy(folder: Path) -> None:
    assert load_policy(folder.parent).card == load_policy(folder).card
    assert sorted(path.name for path in folder.iterdir()) == [CARD, WEIGHTS]


@pytest.mark.parametrize("name", ["", "no such folder", f"policy/{WEIGHTS}"])
def test_a_wrong_folder_is_named(name: str, folder: Path) -> None:
    wrong = folder.parent / name if name else folder.parent.parent
    with pytest.raises(UserError, match="holds no policy") as told:
        load_policy(wrong)
    assert str(told.value).startswith(str(wrong))


@pytest.mark.parametrize("text", ["", "{", "[]", '{"format": 2, "robot": "Jaco"}'])
def test_a_card_that_says_something_else_counts_for_nothing(text, folder) -> None:
    whole = load_policy(folder)
    (folder / CARD).write_text(text)
    with pytest.warns(UserWarning, match=f"{folder / CARD} says something else than"):
        assert load_policy(folder).card == whole.card


def rewrite(folder: Path, change: Callable[[dict[str, Any]], Any]) -> None:
    tree = load_tree(folder / WEIGHTS)
    save_tree(folder / WEIGHTS, change(tree))


@pytest.mark.parametrize("key", ["layout", "action_dim", "hidden"])
@pytest.mark.parametrize("value", [None, "x", {}, {"a": 1}, -1, [None]])
def test_a_card_without_a_network_is_refused(key, value, folder: Path) -> None:
    rewrite(folder, lambda tree: tree | {"card": tree["card"] | {key: value}})
    with pytest.raises(UserError, match=f"{folder / WEIGHTS}(: {key} | holds no )"):
        load_policy(folder)


@pytest.mark.parametrize("card", [None, 3, {}, {"format": 1}, {"format": 99}])
def test_a_foreign_format_is_refused(card: Any, folder: Path) -> None:
    rewrite(folder, lambda tree: tree | {"card": card})
    with pytest.raises(UserError, match=r"has format .*, this version reads 2"):
        load_policy(folder)


@pytest.mark.parametrize(
    "change",
    [
        *({"hidden": [8, 9]}, {"hidden": [8]}, {"hidden": [10**6, 10**6]}),
        *({"normalise": False}, {"action_dim": 2}),
        *({"action_dim": 10**9}, {"action_dim": 10**30}, {"bins": 10**9}),
    ],
)
def test_weights_of_another_network_are_refused(change, folder: Path) -> None:
    rewrite(folder, lambda tree: tree | {"card": tree["card"] | change})
    with pytest.raises(UserError, match=f"{WEIGHTS} holds no policy: "):
        load_policy(folder)


def test_weights_that_are_not_finite_are_refused(folder: Path) -> None:
    policy = load_policy(folder)
    policy.actor.body[0].weight.data[2, 1] = float("nan")
    policy.save(folder)
    with pytest.raises(UserError, match="holds weights that are not finite"):
        load_policy(folder)


def test_damaged_and_pickled_files_are_refused(folder: Path) -> None:
    weights = folder / WEIGHTS
    whole, tensors = weights.read_bytes(), load_file(weights)
    unsealed = folder / "unsealed"
    save_file(tensors, unsealed)
    pickled, foreign = pickle.dumps(tensors), unsealed.read_bytes()
    for damaged in (whole[:-1], whole[:20], b"", pickled, foreign):
        weights.write_bytes(damaged)
        with pytest.raises(DamagedError, match=f"{WEIGHTS} is damaged or not a manip"):
            load_policy(folder)


def test_a_shipped_policy_is_found_by_its_name(tmp_path: Path, monkeypatch) -> None:
    policy = make_policy()
    monkeypatch.setattr(policies, "SHIPPED", tmp_path)
    assert policy.card.name == "Lift"
    assert replace(policy.card, robot="IIWA").name == "Lift-IIWA"
    policy.save(tmp_path / "Lift")
    assert load_policy("Lift").card == policy.card
    with pytest.raises(UserError, match=r"holds no policy .*shipped policies: Lift"):
        load_policy("Lfit")
