"""The learned reward: Bradley-Terry by hand, recovery of a taste, files, queries."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from manip.agents.compared_clips import ComparedClips
from manip.errors import DamagedError, UserError
from manip.io.tensor_trees import load_tree, save_tree
from manip.preferences.queries import choose_pairs, disagreement, random_pairs
from manip.preferences.reward_fit import FitOptions, evaluate, fit, logits, losses
from manip.preferences.reward_learning import generator_of, learn_reward
from manip.preferences.reward_model import RewardCard, RewardModel, load_reward_model
from manip.preferences.reward_network import RewardNetwork

WIDTH, LENGTH = 4, 10
CARD = RewardCard(
    task="Lift",
    robot="Panda",
    inputs="measures",
    names=["tilt", "speed", "height", "grip"],
    hidden=[16],
    members=3,
    clip_steps=LENGTH,
)
WEIGHTS = torch.tensor([-2.0, -1.0, 1.5, 0.0])


def draw(*shape: int, seed: int = 0) -> Tensor:
    return torch.randn(shape, generator=generator_of(seed))


def compared(count: int, seed: int = 0) -> ComparedClips:
    """Clips whose steps vary around a mean of each clip, compared by a linear taste."""
    clips = draw(2, count, 1, WIDTH, seed=seed)
    clips = clips + 0.3 * draw(2, count, LENGTH, WIDTH, seed=seed + 1000)
    left, right = clips
    better = (left @ WEIGHTS).sum(1) > (right @ WEIGHTS).sum(1)
    return ComparedClips(left, right, better.float())


def network(seed: int = 0, members: int = 2) -> RewardNetwork:
    return RewardNetwork(WIDTH, members, (16,), generator_of(seed))


def by_hand(member: int, net: RewardNetwork, step: np.ndarray) -> float:
    """The reward of one step [F] by one member, in numpy."""
    hidden = (step - net.mean.numpy()) / net.std.numpy()
    for index, (weight, bias) in enumerate(zip(net.weights, net.biases, strict=True)):
        hidden = (
            hidden @ weight[member].detach().numpy() + bias[member].detach().numpy()[0]
        )
        hidden = np.maximum(hidden, 0) if index == 0 else hidden
    return float((1 + np.tanh(hidden[0])) / 2)


def test_likelihood_and_gradient_are_bradley_and_terrys() -> None:
    net, pairs = network(), compared(5)
    net.normalise_by(pairs.left)
    pairs = replace(pairs, target=torch.tensor([1.0, 0.0, 0.5, 1.0, 0.0]))
    logit = logits(net, pairs)
    for member in range(2):
        expected = []
        for left, right, y in zip(pairs.left, pairs.right, pairs.target, strict=True):
            sums = [
                sum(by_hand(member, net, step) for step in clip.numpy())
                for clip in (left, right)
            ]
            chance = 1 / (1 + np.exp(sums[1] - sums[0]))
            expected.append(-y * np.log(chance) - (1 - y) * np.log(1 - chance))
        loss = losses(logit, pairs.target)[member]
        assert loss.item() == pytest.approx(float(np.mean(expected)), rel=1e-4)
    free = logit.detach().requires_grad_()
    losses(free, pairs.target).sum().backward()
    torch.testing.assert_close(free.grad, (logit.sigmoid() - pairs.target).detach() / 5)


def test_members_are_trained_apart() -> None:
    """The ensemble of one member is the first member of the ensemble of two."""
    pairs = compared(8)
    two, one = network(), network(members=1)
    for big, small in zip(two.parameters(), one.parameters(), strict=True):
        small.data.copy_(big.data[:1])
    for net in (two, one):
        losses(logits(net, pairs), pairs.target).sum().backward()
    for big, small in zip(two.parameters(), one.parameters(), strict=True):
        torch.testing.assert_close(big.grad[:1], small.grad)


def test_a_linear_taste_is_recovered_from_comparisons() -> None:
    model = learn_reward(CARD, compared(300), (0,))
    assert evaluate(model.network, compared(1000, seed=7)).accuracy > 0.95
    assert model.card.accuracy > 0.9
    assert model.card.held_out == 45
    axes = torch.eye(WIDTH)
    slopes = (model.network.paid(axes) - model.network.paid(-axes)).tolist()
    assert slopes[0] < slopes[1] < -0.05
    assert slopes[2] > 0.05
    assert abs(slopes[3]) < 0.5 * abs(slopes[1])


def test_equal_answers_pull_the_rewards_together() -> None:
    pairs = compared(200)
    model = learn_reward(CARD, replace(pairs, target=torch.full((200,), 0.5)), (0,))
    spread = logits(model.network, pairs).abs().mean()
    assert (
        spread
        < 0.2 * logits(learn_reward(CARD, pairs, (0,)).network, pairs).abs().mean()
    )


def test_the_fit_repeats_bit_for_bit() -> None:
    models = [learn_reward(CARD, compared(60), (seed,)) for seed in (3, 3, 4)]
    weights = [torch.cat([p.flatten() for p in m.network.parameters()]) for m in models]
    assert torch.equal(weights[0], weights[1])
    assert not torch.equal(weights[0], weights[2])


def test_the_weights_of_the_lowest_held_out_loss_are_kept() -> None:
    """With answers at random, more epochs would make held-out answers worse."""
    pairs = replace(compared(80), target=(draw(80, seed=9) > 0).float())
    found = []
    for epochs in (1, 4, 40):
        options = FitOptions(patience=100, epochs=epochs)
        found.append(fit(network(members=1), pairs, generator_of(1), options).loss)
    assert found == sorted(found, reverse=True)


def test_the_paid_reward_is_standard_over_the_clips_it_is_made_standard_by() -> None:
    clips = 3 + 2 * draw(50, LENGTH, WIDTH)
    model = learn_reward(CARD, compared(50), (0,), standard=clips)
    paid = model.network.paid(clips)
    assert paid.mean().item() == pytest.approx(0, abs=1e-4)
    assert paid.std(correction=0).item() == pytest.approx(0.1, abs=1e-4)


def test_inputs_that_hardly_vary_are_not_blown_up() -> None:
    net, clips = network(), draw(50, LENGTH, WIDTH)
    clips[..., 2] *= 1e-3
    net.normalise_by(clips)
    assert net.std[2].item() == pytest.approx(0.05)
    torch.testing.assert_close(net.std[:2], clips.std((0, 1), correction=0)[:2])


def test_a_model_comes_back_from_its_file(tmp_path: Path) -> None:
    model = learn_reward(CARD, compared(40), (0,))
    model.save(tmp_path / "model.safetensors")
    again = load_reward_model(tmp_path / "model.safetensors")
    steps = draw(6, LENGTH, WIDTH)
    assert torch.equal(again.network.paid(steps), model.network.paid(steps))
    assert again.card == model.card


def set_card(tree: Any, **values: Any) -> Any:
    return tree | {"card": tree["card"] | values}


def set_weights(tree: Any, name: str, value: Tensor | None) -> Any:
    weights = {k: v for k, v in tree["weights"].items() if k != name}
    return tree | {"weights": weights if value is None else weights | {name: value}}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda t: [t], "holds no reward model"),
        (lambda t: {"card": t["card"]}, "holds no reward model"),
        (lambda t: set_card(t, format=9), "format 9, expected 1"),
        (lambda t: set_card(t, members=10**9), "members must be at most 100"),
        (lambda t: set_card(t, hidden=[10**9]), "hidden must be at most"),
        (lambda t: set_card(t, hidden=[8]), "another shape"),
        (lambda t: set_card(t, names=["\x1b[2J"] * 4), "control characters"),
        (lambda t: set_card(t, names=[]), "names must be"),
        (lambda t: set_card(t, inputs="eval"), "inputs must be"),
        (lambda t: set_card(t, code="x"), "unknown RewardCard option"),
        (lambda t: set_weights(t, "std", None), "other names"),
        (
            lambda t: set_weights(t, "std", torch.zeros(WIDTH)),
            "std must be more than 0",
        ),
        (lambda t: set_weights(t, "std", torch.ones(3)), "another shape"),
        (lambda t: set_weights(t, "scale", torch.tensor(torch.nan)), "not finite"),
        (lambda t: set_weights(t, "mean", torch.full((WIDTH,), 1e9)), "too large"),
    ],
)
def test_a_hostile_file_is_refused_in_a_line(
    change: Any, message: str, tmp_path: Path
) -> None:
    path = tmp_path / "model.safetensors"
    RewardModel(CARD, network(members=3)).save(path)
    save_tree(path, change(load_tree(path)))
    with pytest.raises(DamagedError, match=message) as raised:
        load_reward_model(path)
    assert "\n" not in str(raised.value)


def test_a_missing_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="there is no file"):
        load_reward_model(tmp_path / "model.safetensors")


def test_pairs_use_all_clips_before_any_again() -> None:
    pairs = random_pairs(10, 12, generator_of(0))
    assert len(pairs) == 12
    assert (pairs[:, 0] != pairs[:, 1]).all()
    assert sorted(pairs[:5].flatten().tolist()) == list(range(10))
    assert sorted(pairs[5:10].flatten().tolist()) == list(range(10))


def test_pairs_on_which_the_members_disagree_most_are_chosen() -> None:
    net, inputs = network(members=5), draw(40, LENGTH, WIDTH)
    chosen = choose_pairs(5, inputs, generator_of(0), net, candidates=20)
    drawn = random_pairs(40, 100, generator_of(0))
    least = disagreement(net, inputs, chosen).min()
    assert (disagreement(net, inputs, drawn) > least).sum() < 5
    sums = net.rewards(inputs).sum(-1)
    for left, right in chosen.tolist():
        chances = (sums[:, left] - sums[:, right]).sigmoid()
        found = disagreement(net, inputs, torch.tensor([[left, right]]))
        assert found.item() == pytest.approx(chances.std(correction=0).item())
