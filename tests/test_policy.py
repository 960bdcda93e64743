"""Policies as files: equal actions, and plain words for what cannot be read."""

import json
import pickle
import shutil
import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch
from safetensors.torch import load_file, save_file

from manip.agents import policy as policies
from manip.agents.image_actor import ImageActor
from manip.agents.networks import Actor
from manip.agents.policy import CARD, WEIGHTS, Policy, load_policy
from manip.agents.policy_card import PolicyCard
from manip.cameras import CameraConfig
from manip.errors import DamagedError, UserError
from manip.io import checksums
from manip.io.tensor_trees import load_tree, save_tree


def part(name: str, *shape: int, role: str = "object") -> dict[str, Any]:
    return {"name": name, "shape": [*shape], "dtype": "float32", "role": role}


def make_policy(squash: bool = True, normalise: bool = True) -> Policy:
    torch.manual_seed(0)
    card = PolicyCard(
        task="Lift",
        robot="Panda",
        algo="sac",
        controller="OSC_POSE",
        control_freq=20,
        action_dim=3,
        observation=[part("arm", 4, role="proprioception"), part("cube", 2, 1)],
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
    parts = {"arm": 5 + 3 * torch.randn(20, 4), "cube": torch.randn(20, 2, 1)}
    action = policy(parts)
    assert loaded.card == policy.card
    assert torch.equal(loaded(parts), action)
    assert action.shape == (20, 3)
    assert action.abs().max() <= 1
    assert not action.requires_grad


def test_parts_are_joined_in_the_cards_order_whatever_else_there_is() -> None:
    policy = make_policy()
    arm, cube, other = torch.randn(3, 4), torch.randn(3, 2, 1), torch.randn(3, 9)
    joined = torch.cat([arm, cube.flatten(1)], 1)
    found = policy({"other": other, "cube": cube, "arm": arm})
    assert torch.equal(found, policy.actor.decide(joined))


def test_equal_policies_have_equal_bytes(tmp_path: Path) -> None:
    for folder in ("a", "b"):
        make_policy().save(tmp_path / folder)
    for name in (WEIGHTS, CARD):
        assert (tmp_path / "a" / name).read_bytes() == (
            tmp_path / "b" / name
        ).read_bytes()


def test_a_run_folder_leads_to_its_policy(folder: Path) -> None:
    assert load_policy(folder.parent).card == load_policy(folder).card
    assert sorted(path.name for path in folder.iterdir()) == [CARD, WEIGHTS]


@pytest.mark.parametrize("name", ["", "no such folder", f"policy/{WEIGHTS}"])
def test_a_wrong_folder_is_named(name: str, folder: Path) -> None:
    wrong = folder.parent / name if name else folder.parent.parent
    with pytest.raises(UserError, match="holds no policy") as error:
        load_policy(wrong)
    assert str(error.value).startswith(str(wrong))


def test_a_folder_without_a_policy_leads_to_what_there_is(
    folder: Path, tmp_path: Path
) -> None:
    runs, early = tmp_path / "runs", tmp_path / "early"
    for name in ("seed0", "seed1"):
        shutil.copytree(folder, runs / name / "policy")
    early.mkdir()
    (early / "config.yaml").write_text("task: Lift")
    with pytest.raises(UserError, match="name one of them: seed0, seed1"):
        load_policy(runs)
    with pytest.raises(UserError, match="has not been evaluated yet"):
        load_policy(early)
    with pytest.raises(UserError, match="did you mean Lift"):
        load_policy("lift")


@pytest.mark.parametrize("text", ["", "{", "[]", '{"format": 2, "robot": "Jaco"}'])
def test_a_different_json_card_is_warned_of_and_not_used(text, folder) -> None:
    whole = load_policy(folder)
    (folder / CARD).write_text(text)
    with pytest.warns(UserWarning, match=f"{folder / CARD} differs from the card in"):
        assert load_policy(folder).card == whole.card


def rewrite(folder: Path, change: Callable[[dict[str, Any]], Any]) -> None:
    tree = load_tree(folder / WEIGHTS)
    save_tree(folder / WEIGHTS, change(tree))


def refused(folder: Path) -> str:
    """The message of the refusal: one line, and nothing that a terminal obeys."""
    with pytest.raises(UserError, match=f"{folder / WEIGHTS} ") as error:
        load_policy(folder)
    message = str(error.value)
    assert message.isprintable()
    assert len(message) < 600
    return message


@pytest.mark.parametrize("key", ["observation", "action_dim", "hidden"])
@pytest.mark.parametrize("value", [None, "x", {}, {"a": 1}, -1, [None]])
def test_a_card_without_a_network_is_refused(key, value, folder: Path) -> None:
    rewrite(folder, lambda tree: tree | {"card": tree["card"] | {key: value}})
    assert "holds no policy" in refused(folder)


@pytest.mark.parametrize(
    "text",
    [
        "[red]Lift[/red]",
        "[/]",
        "Lift\n",
        "\x1b[2J",
        "\x9b2J",
        "Li\u202eft",
        "a" * 10**5,
        "\ud800",
    ],
)
@pytest.mark.parametrize("key", ["task", "algo", "robot", "controller", "versions"])
def test_markup_and_escape_sequences_in_a_card_are_refused(key, text, folder) -> None:
    value = {"python": text} if key == "versions" else text
    rewrite(folder, lambda tree: tree | {"card": tree["card"] | {key: value}})
    assert "text that is no plain name" in refused(folder)


@pytest.mark.parametrize(
    "observation",
    [
        [part("[red]", 6)],
        [part("arm", 3), part("arm", 3)],
        [part("arm", -6)],
        [part("arm", 10**9)],
        [part("arm", 2**40)],
        [part("arm", 6, role="unknown")],
        [part("arm", 6) | {"dtype": "complex64"}],
        [part("arm", 6) | {"more": "x"}],
        [part("arm", 6, role="camera")],
        [],
    ],
)
def test_impossible_observations_are_refused(observation, folder: Path) -> None:
    rewrite(
        folder,
        lambda tree: tree | {"card": tree["card"] | {"observation": observation}},
    )
    refused(folder)


@pytest.mark.parametrize(
    "change",
    [
        *({"control_freq": 0}, {"control_freq": 10**9}, {"seed": -1}, {"bins": -1}),
        *({"env_steps": -5}, {"bins": 10**6}, {"hidden": [8] * 200_000}),
        *({"hidden": [0]}, {"hidden": [-8, 8]}, {"hidden": [10**9]}, {"squash": 1}),
        *({"action_dim": 0}, {"action_dim": True}, {"env_steps": float("nan")}),
    ],
)
def test_absurd_numbers_are_refused(change: dict[str, Any], folder: Path) -> None:
    rewrite(folder, lambda tree: tree | {"card": tree["card"] | change})
    refused(folder)


@pytest.mark.parametrize("card", [None, 3, {}, {"format": 2}, {"format": 99}])
def test_a_foreign_format_is_refused(card: Any, folder: Path) -> None:
    rewrite(folder, lambda tree: tree | {"card": card})
    assert "expected 3" in refused(folder)


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
    refused(folder)


def with_weight(folder: Path, change: Callable[[torch.Tensor], Any]) -> None:
    """Change the first weight of a policy's file."""
    name = "body.0.weight"

    def changed(tree: dict[str, Any]) -> dict[str, Any]:
        weights = tree["weights"]
        return tree | {"weights": weights | {name: change(weights[name])}}

    rewrite(folder, changed)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda w: w * torch.nan, "holds weights that are not finite"),
        (lambda w: w / 0.0, "holds weights that are not finite"),
        (lambda w: w + 1e20, "holds weights beyond 1e+06"),
        (lambda w: w.double(), "are not a tensor of torch.float32"),
        (lambda w: w.half(), "are not a tensor of torch.float32"),
        (lambda w: w.int(), "are not a tensor of torch.float32"),
        (lambda w: w[:1], "have shape [1, 6], not [8, 6]"),
        (lambda w: w[None], "have shape [1, 8, 6], not [8, 6]"),
        (lambda w: "x", "are not a tensor of torch.float32"),
        (lambda w: w.numpy(), "are not a tensor of torch.float32"),
    ],
)
def test_weights_of_another_kind_are_refused(change, message, folder: Path) -> None:
    with_weight(folder, change)
    assert f"body.0.weight {message}" in refused(folder)


def test_complex_weights_are_refused(folder: Path, monkeypatch) -> None:
    """safetensors has complex numbers, though manip never writes any."""
    monkeypatch.setitem(checksums._DTYPES, torch.complex64, "C64")
    with_weight(folder, lambda w: w.to(torch.complex64))
    assert "body.0.weight are not a tensor of torch.float32" in refused(folder)


@pytest.mark.parametrize("extra", [{"more": torch.zeros(3)}, {"body.0.bias": None}])
def test_weights_of_other_names_are_refused(extra: dict, folder: Path) -> None:
    rewrite(folder, lambda tree: tree | {"weights": tree["weights"] | extra})
    refused(folder)


def test_an_enormous_file_is_refused_unread(folder: Path) -> None:
    with (folder / WEIGHTS).open("r+b") as file:
        file.truncate(2**40)  # sparse
    assert "it is larger than" in refused(folder)


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
    with pytest.raises(UserError, match=r"holds no policy: .*shipped policies: Lift"):
        load_policy("Lfit")


# Policies that see images


def camera(name: str, size: int = 12, frames: int = 1) -> dict[str, Any]:
    shape = [size, size, 3 * frames]
    return {"name": name, "shape": shape, "dtype": "uint8", "role": "camera"}


def image_policy(*vectors: dict[str, Any]) -> Policy:
    card = replace(
        make_policy(normalise=False).card,
        observation=[*vectors, camera("front_image"), camera("wrist_image")],
        image_channels=[4, 8],
        image_features=6,
        image_quality="lean",
    )
    sizes = card.encoder_sizes
    assert sizes is not None
    return Policy(card, ImageActor(sizes, card.observation_dim, 3, [8, 8], True, False))


def images_of(policy: Policy, count: int) -> dict[str, torch.Tensor]:
    assert policy.card.cameras is not None
    return {
        part.name: torch.randint(256, (count, *part.shape), dtype=torch.uint8)
        for part in policy.card.cameras.parts
    }


@pytest.fixture
def image_folder(tmp_path: Path) -> Path:
    image_policy(part("arm", 4, role="proprioception")).save(tmp_path / "policy")
    return tmp_path / "policy"


@pytest.mark.parametrize("vectors", [[], [part("arm", 4, role="proprioception")]])
def test_a_loaded_image_policy_acts_as_the_saved_one(vectors, tmp_path: Path) -> None:
    policy = image_policy(*vectors)
    policy.save(tmp_path)
    loaded = load_policy(tmp_path)
    parts = {"arm": torch.randn(20, 4), **images_of(policy, 20)}
    action = policy(parts)
    assert loaded.card == policy.card
    assert loaded.card.name == "Lift-cameras"
    assert loaded.card.cameras == CameraConfig(("front", "wrist"), 12)
    assert torch.equal(loaded(parts), action)
    assert torch.equal(loaded({k: v.numpy() for k, v in parts.items()}), action)
    assert action.shape == (20, 3)
    assert not action.requires_grad


def test_images_of_another_kind_are_refused(image_folder: Path) -> None:
    policy = load_policy(image_folder)
    parts = {"arm": torch.randn(2, 4), **images_of(policy, 2)}
    for wrong in (parts["front_image"] / 255.0, parts["front_image"][:, :6]):
        with pytest.raises(
            UserError, match=r"front_image must be uint8 \[N, 12, 12, 3"
        ):
            policy(parts | {"front_image": wrong})


@pytest.mark.parametrize(
    "change",
    [
        {"observation": [camera("front_image", 4)]},
        {"observation": [camera("front_image", 2000)]},
        {"observation": [camera("front_image", 12, 100)]},
        {"observation": [camera("front_image"), camera("wrist_image", 16)]},
        {"observation": [camera("front")]},
        {"observation": [camera("_image")]},
        {"observation": [camera("front_image") | {"dtype": "float32"}]},
        {"observation": [camera("front_image") | {"shape": []}]},
        {"observation": [camera("front_image") | {"shape": [12]}]},
        {"observation": [camera("front_image") | {"shape": [12, 12]}]},
        {"observation": [camera("front_image") | {"shape": [12, 16, 3]}]},
        {"observation": [camera(f"c{i}_image") for i in range(40)]},
        {"observation": [camera("front_image", 1024)], "image_channels": [1024]},
        *({"image_channels": []}, {"image_channels": [0]}, {"image_channels": [10**6]}),
        *({"image_channels": [4] * 200}, {"image_channels": "x"}, {"bins": 3}),
        *({"image_features": 0}, {"image_features": -1}, {"image_features": 10**9}),
        *({"image_quality": "x"}, {"image_convention": "opencv"}),
        *({"image_channels": [4, 9]}, {"image_features": 7}, {"hidden": [8]}),
    ],
)
def test_impossible_cameras_are_refused(change, image_folder: Path) -> None:
    rewrite(image_folder, lambda tree: tree | {"card": tree["card"] | change})
    refused(image_folder)


def test_a_json_card_without_later_fields_is_no_other_card(folder: Path) -> None:
    values = json.loads((folder / CARD).read_text())
    for name in ("image_channels", "image_features", "image_quality"):
        del values[name]
    (folder / CARD).write_text(json.dumps(values))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        load_policy(folder)
