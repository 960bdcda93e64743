"""Policies as files: equal actions, and plain words for what cannot be read."""

import json
import pickle
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from safetensors.torch import load_file, save_file

from manip.agents.networks import Actor
from manip.agents.policy import CARD, WEIGHTS, Policy, PolicyCard, load_policy
from manip.errors import UserError


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


@pytest.mark.parametrize("name", ["", "no such folder", f"policy/{CARD}"])
def test_a_wrong_folder_is_named(name: str, folder: Path) -> None:
    wrong = folder.parent / name if name else folder.parent.parent
    with pytest.raises(UserError, match="holds no policy") as told:
        load_policy(wrong)
    assert str(told.value).startswith(str(wrong))


@pytest.mark.parametrize(
    "text", ["", "{", "[]", "3", "{}", '{"format": 1}', '{"format": 1, "x": 2}', "\0"]
)
def test_a_damaged_card_is_named(text: str, folder: Path) -> None:
    (folder / CARD).write_text(text)
    with pytest.raises(UserError, match=f"{folder / CARD} is not a policy card: "):
        load_policy(folder)


def test_a_card_that_is_not_text_is_named(folder: Path) -> None:
    (folder / CARD).write_bytes(b"\xff\xfe")
    with pytest.raises(UserError, match="is not a policy card: "):
        load_policy(folder)


@pytest.mark.parametrize("key", ["layout", "action_dim", "hidden"])
@pytest.mark.parametrize("value", [None, "x", {}, {"a": 1}, -1, [None]])
def test_a_card_without_a_network_is_refused(key, value, folder: Path) -> None:
    card = json.loads((folder / CARD).read_text())
    (folder / CARD).write_text(json.dumps(card | {key: value}))
    with pytest.raises(UserError, match=f"{folder}.* (describes no|does not hold)"):
        load_policy(folder)


def test_a_foreign_format_is_refused(folder: Path) -> None:
    card = json.loads((folder / CARD).read_text())
    (folder / CARD).write_text(json.dumps(card | {"format": 99}))
    with pytest.raises(UserError, match="has format 99, this version reads 1"):
        load_policy(folder)


@pytest.mark.parametrize(
    "change",
    [{"hidden": [8, 9]}, {"hidden": [8]}, {"normalise": False}, {"action_dim": 2}],
)
def test_weights_of_another_network_are_refused(change, folder: Path) -> None:
    card = replace(make_policy().card, **change)
    actor = Actor(6, card.action_dim, card.hidden, card.squash, card.normalise)
    save_file(actor.state_dict(), folder / WEIGHTS)
    with pytest.raises(UserError, match=f"{WEIGHTS} does not hold this policy: "):
        load_policy(folder)


def test_damaged_missing_and_pickled_weights_are_refused(folder: Path) -> None:
    weights = folder / WEIGHTS
    whole, tensors = weights.read_bytes(), load_file(weights)
    refused = pytest.raises(UserError, match=f"{WEIGHTS} does not hold this policy: ")
    for damaged in (whole[:-1], whole[:20], b"", pickle.dumps(tensors)):
        weights.write_bytes(damaged)
        with refused:
            load_policy(folder)
    weights.unlink()
    with refused:
        load_policy(folder)
