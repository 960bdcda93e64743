"""The study of preferences: its statistics by hand, and a tiny study to its figures."""

import math
from dataclasses import replace
from math import isnan, log
from pathlib import Path

import pytest
import torch
from tensordict import TensorDict

from manip.agents.networks import Actor
from manip.errors import UserError
from manip.preferences.label_options import LabelOptions
from manip.preferences.taste_reward import SCALE, TasteReward
from manip.preferences.tastes import Taste, TasteTerm
from manip.rewards.reward_function import EnvironmentReward
from manip.studies.rlhf import PreferenceRow, PreferenceStudy
from manip.studies.rlhf_figures import (
    FIGURES,
    INPUTS,
    LABELLERS,
    METHODS,
    gains,
    share_of_gain,
)
from manip.studies.rlhf_scores import Scorer, divergence
from manip.studies.rlhf_variants import (
    FULL,
    LABELS,
    PARTS,
    REFERENCE,
    TRUE,
    Part,
    Variant,
    Variants,
)
from manip.studies.seed_interval import seed_interval

VARIANTS = Variants("Lift", "gentle", 61_440)


def test_the_interval_over_seeds_is_students() -> None:
    """Mean 2, s = 1, and t = 4.303 for two degrees of freedom."""
    interval = seed_interval([1.0, 2.0, 3.0])
    assert interval.value == 2.0
    assert interval.high == pytest.approx(2 + 4.3027 / math.sqrt(3), rel=1e-4)
    assert interval.low == pytest.approx(2 - 4.3027 / math.sqrt(3), rel=1e-4)


def test_one_seed_has_no_interval() -> None:
    interval = seed_interval([0.7])
    assert interval.value == 0.7
    assert isnan(interval.low)
    assert isnan(interval.high)


def constant_actor(mean: list[float], std: list[float]) -> Actor:
    """An actor that has the same Gaussian in every state."""
    actor = Actor(3, len(mean), (4,), squash=False, normalise=False)
    last = actor.body[-1]
    assert isinstance(last, torch.nn.Linear)
    with torch.no_grad():
        last.weight.zero_()
        last.bias.copy_(torch.tensor(mean))
        actor.log_std.copy_(torch.tensor(std).log())
    return actor


def test_divergence_is_that_of_gaussians() -> None:
    """KL = sum log(s' / s) + (s^2 + (m - m')^2) / (2 s'^2) - 1/2 over the actions."""
    ours = constant_actor([0.3, 0.0], [0.1, 0.5])
    others = constant_actor([0.1, 0.0], [0.2, 0.5])
    by_hand = log(2) + (0.1**2 + 0.2**2) / (2 * 0.2**2) - 0.5
    states = torch.randn(7, 5, 3)
    assert divergence(ours, others, states) == pytest.approx(by_hand, rel=1e-5)
    assert divergence(ours, ours, states) == 0.0


def test_a_known_taste_is_subtracted_from_the_reward() -> None:
    """Tilts of 0, 0.3 and 9 rad: penalties 0, 0.4 and three times 0.4 at most."""
    taste = Taste("", (TasteTerm("tilt", 0.4, full=0.2, above=0.1),), weight=2.0)
    reward = TasteReward(EnvironmentReward(), taste, ("speed", "tilt"))
    tilt = torch.tensor([0.0, 0.3, 9.0])
    measures = torch.stack([torch.ones(3), tilt], -1)[None]
    after = TensorDict({"reward": torch.ones(1, 3, 1), "measures": measures}, (1, 3))
    paid = reward(TensorDict({"next": after}, (1, 3)))
    assert paid.shape == (1, 3, 1)
    expected = [SCALE * value for value in (1.0, 1 - 0.8, 1 - 2.4)]
    assert paid.flatten().tolist() == pytest.approx(expected)


@pytest.mark.parametrize("part", PARTS)
def test_figures_show_variants_of_their_part(part: Part) -> None:
    shown = {"methods": METHODS, "inputs": INPUTS, "labellers": LABELLERS}
    assert set(shown.get(part, {})) <= set(VARIANTS.of([part]))


def test_variants_of_equal_names_are_the_same_runs() -> None:
    """Runs are shared between parts, so a name must stand for the same options."""
    for part in PARTS:
        alone, together = VARIANTS.of([part]), VARIANTS.of(PARTS)
        assert alone == {name: together[name] for name in alone}


def test_all_methods_ask_for_equally_many_labels() -> None:
    variants = VARIANTS.of(["methods"]).values()
    assert {v.config.labels.total for v in variants if v.compares} == {LABELS}
    for labels in (v.config.labels for v in variants if v.compares):
        assert labels.wanted(labels.rounds - 1) == LABELS
        last = labels.start + (labels.rounds - 1) * labels.every
        assert last < VARIANTS.steps


def row(variant: str, seed: int, steps: int = 100) -> PreferenceRow:
    value = 0.1 * seed + 0.01 * len(variant)
    learned = None if variant in (REFERENCE, TRUE) else value
    kl = 0.0 if variant == REFERENCE else value
    scored = (8, 1.0, value, value, value, learned, kl)
    return PreferenceRow("Lift", "gentle", variant, seed, steps, 300, *scored)


@pytest.mark.parametrize("part", PARTS)
@pytest.mark.parametrize("seeds", [1, 3])
def test_each_part_has_a_figure(part: Part, seeds: int, tmp_path: Path) -> None:
    variants = VARIANTS.of([part]).values()
    rows = [
        row(variant.name, seed, steps)
        for variant in variants
        for steps in variant.stages
        for seed in range(seeds)
    ]
    FIGURES[part](rows, tmp_path / "figure.png")
    assert (tmp_path / "figure.png").stat().st_size > 10_000


def test_gain_is_relative_to_the_reference_of_the_same_seed() -> None:
    """Gains of the known taste 0.4 and 0.2, of the other runs 0.3 and 0.0: a half."""
    utilities = {REFERENCE: (0.2, 0.1), TRUE: (0.6, 0.3), FULL: (0.5, 0.1)}
    rows = [
        replace(row(variant, seed), utility=utility)
        for variant, values in utilities.items()
        for seed, utility in enumerate(values)
    ]
    assert gains(rows, FULL) == pytest.approx([0.3, 0.0])
    assert share_of_gain(rows, FULL) == pytest.approx(50.0)
    assert isnan(share_of_gain(rows[:2], REFERENCE))


def tiny(variant: Variant, steps: int, stages: int) -> Variant:
    """The variant with few steps and labels."""
    config = variant.config
    if variant.compares:
        labels = LabelOptions(
            labeller=config.labels.labeller,
            taste=config.labels.taste,
            total=4,
            first=2,
            per_round=2,
            start=32,
            every=64,
            clip_steps=4,
            recent=64,
        )
        config = replace(config, labels=labels)
    small_run = replace(config, num_envs=4, horizon=16, eval_episodes=1)
    options = {"rollout_length": 16, "critic_rollouts": 0}
    known = {k: v for k, v in options.items() if hasattr(config.agent, k)}
    agent = replace(config.agent, **known)
    ends = tuple(steps * (k + 1) // stages for k in range(stages))
    return Variant(variant.name, replace(small_run, agent=agent), ends)


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> PreferenceStudy:
    variants = VARIANTS.of(["methods"])
    small = {
        REFERENCE: tiny(variants[REFERENCE], 64, 1),
        TRUE: tiny(variants[TRUE], 128, 1),
        FULL: tiny(variants[FULL], 192, 2),
    }
    folder = tmp_path_factory.mktemp("study")
    return PreferenceStudy(small, (0,), Scorer("Lift", "gentle", 2, 16), folder)


@pytest.mark.slow
def test_a_study_trains_scores_and_goes_on(study: PreferenceStudy) -> None:
    rows = study.rows()
    names = [(row.variant, row.env_steps) for row in rows]
    assert names == [(REFERENCE, 64), (TRUE, 128), (FULL, 96), (FULL, 192)]
    reference, true, early, late = rows
    assert reference.divergence == 0.0 < late.divergence
    assert reference.learned is None
    assert true.learned is None
    assert isinstance(early.learned, float)
    for scored in rows:
        paid = scored.reward - 2 * scored.penalty
        assert scored.utility == pytest.approx(paid)
    before = {path: path.stat().st_mtime_ns for path in study.folder.rglob("*.json*")}
    again = study.rows()
    assert again == rows
    assert before == {path: path.stat().st_mtime_ns for path in before}


@pytest.mark.slow
def test_a_study_refuses_runs_of_other_options(study: PreferenceStudy) -> None:
    study.rows()
    more = replace(study, scorer=replace(study.scorer, episodes=3))
    with pytest.raises(UserError, match="is of 2 episodes, not 3"):
        more.rows()
    other = dict(study.variants)
    config = other[FULL].config
    other[FULL] = replace(
        other[FULL], config=replace(config, horizon=17), stages=(320,)
    )
    with pytest.raises(UserError, match="holds a run with other options"):
        replace(study, variants=other).rows()
