"""How good a learned reward is, and what it pays for."""

from collections import Counter
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import torch
from torch import Tensor

from manip.agents.compared_clips import ComparedClips
from manip.errors import UserError
from manip.evaluation.statistics import Rate, wilson_rate
from manip.preferences.agreement import Agreement, agreement
from manip.preferences.clips import Clip, load_clip
from manip.preferences.comparisons import valid_comparisons
from manip.preferences.label_options import Inputs
from manip.preferences.reward_fit import logits
from manip.preferences.reward_learning import ClipReader, generator_of, learn_reward
from manip.preferences.reward_model import HIDDEN, RewardCard, RewardModel, input_names

EDGES = (0.5, 0.6, 0.7, 0.8, 0.9, 1.0)
"""Bounds of the predicted chances in a table of calibration."""


@dataclass(frozen=True)
class CalibrationRow:
    """Pairs for which the model gives its choice a chance of low to high.

    Attributes:
        predicted: mean chance; None without any pair.
        correct: share of the pairs in which the choice is the answer.
    """

    low: float
    high: float
    predicted: float | None
    correct: Rate | None


@dataclass(frozen=True)
class RewardReport:
    """A reward learned from a folder, and how it was judged.

    Attributes:
        model: fitted to all answers; its reward is standard over the clips.
        answers: answer -> number.
        accuracy: share of predicted answers, without "equal", each by a model that was
            fitted to other pairs (cross-validation).
        calibration: of the same predictions.
        slopes: input -> change of the reward for a change by one standard deviation.
        agreement: of repeated answers.
        inputs: [C, L, F] of all compared clips, one for each side of each answer.
    """

    model: RewardModel
    answers: dict[str, int]
    accuracy: Rate | None
    calibration: list[CalibrationRow]
    slopes: dict[str, float]
    agreement: Agreement
    inputs: Tensor


def report(
    folder: Path, inputs: Inputs, members: int, folds: int, seed: int
) -> RewardReport:
    """Fit a reward to all comparisons of a folder, and judge it.

    Args:
        folds: parts into which the answers are divided for cross-validation.

    Raises:
        UserError: there are fewer answers than folds, or clips of several tasks.
    """
    answers = valid_comparisons(folder)
    if len(answers) < folds:
        raise UserError(
            f"{folder} holds {len(answers)} comparisons: at least {folds} are needed; "
            f"make them with manip label {folder}"
        )
    first = load_clip(folder, answers[0].left)
    card = _card(first, inputs, members)
    reader = ClipReader(folder, card, first.header.robot_config, first.widths)
    pairs = reader.compared(answers, inputs)
    if len(pairs) < folds:
        raise UserError(
            f"only {len(pairs)} of the {len(answers)} comparisons in {folder} were not "
            f"skipped: at least {folds} are needed; make more, or lower --folds"
        )
    clips = torch.cat([pairs.left, pairs.right])
    model = learn_reward(card, pairs, (seed,), standard=clips)
    chances = cross_validated(card, pairs, folds, seed)
    decided = pairs.target != 0.5
    chances, target = chances[decided], pairs.target[decided]
    return RewardReport(
        model=model,
        answers=dict(Counter(answer.answer for answer in answers)),
        accuracy=_accuracy(chances, target),
        calibration=calibration(chances, target),
        slopes=slopes(model, clips),
        agreement=agreement(answers),
        inputs=clips,
    )


def _card(clip: Clip, inputs: Inputs, members: int) -> RewardCard:
    """The card of a reward for clips like this one."""
    return RewardCard(
        task=clip.header.task,
        robot=clip.header.robot,
        inputs=inputs,
        names=input_names(inputs, clip.header.measure_names, *clip.widths),
        hidden=HIDDEN,
        members=members,
        clip_steps=clip.steps,
    )


def cross_validated(
    card: RewardCard, pairs: ComparedClips, folds: int, seed: int
) -> Tensor:
    """[P]: the chance that left is better, by a model fitted to the other folds."""
    order = torch.randperm(len(pairs), generator=generator_of(seed))
    chances = torch.zeros(len(pairs))
    for number, rows in enumerate(order.chunk(folds)):
        others = order[~torch.isin(order, rows)]
        model = learn_reward(card, pairs.at(others), (seed, number))
        with torch.no_grad():
            chances[rows] = logits(model.network, pairs.at(rows)).mean(0).sigmoid()
    return chances


def calibration(chances: Tensor, target: Tensor) -> list[CalibrationRow]:
    """How often the model's choice is right, by the chance [P] that it gives it.

    Args:
        chances: [P] that left is better.
        target: [P] 1 if it is, 0 if right is.
    """
    sure = torch.maximum(chances, 1 - chances)
    right = (chances > 0.5) == (target > 0.5)
    rows = []
    for low, high in pairwise(EDGES):
        inside = (sure >= low) & ((sure < high) | (high == EDGES[-1]))
        some = bool(inside.any())
        predicted = sure[inside].mean().item() if some else None
        rows.append(CalibrationRow(low, high, predicted, _accuracy_of(right[inside])))
    return rows


def slopes(model: RewardModel, clips: Tensor) -> dict[str, float]:
    """Mean derivative of the reward over the steps of clips [C, L, F], by each input,
    times the input's standard deviation over these steps.
    """
    steps = clips.flatten(0, 1).clone().requires_grad_()
    (gradient,) = torch.autograd.grad(model.network.paid(steps).sum(), steps)
    values = (gradient.mean(0) * steps.detach().std(0)).tolist()
    return dict(zip(model.card.names, values, strict=True))


def _accuracy(chances: Tensor, target: Tensor) -> Rate | None:
    return _accuracy_of((chances > 0.5) == (target > 0.5))


def _accuracy_of(right: Tensor) -> Rate | None:
    return wilson_rate(int(right.sum()), len(right)) if len(right) else None
