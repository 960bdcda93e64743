"""Reward kernels: bounded, monotone, and with the values their docstrings state."""

import numpy as np
import pytest
import torch
from dm_control.utils import rewards as dm_rewards
from tensordict import TensorDict

from manip.envs.adapters.torchrl import TaskEnv
from manip.envs.make_batch import make_batch
from manip.errors import UserError
from manip.rewards.compose import override_weights, weighted_sum
from manip.rewards.kernels import near, ramp, tolerance
from manip.rewards.reward_function import EnvironmentReward, WeightedTerms

DISTANCES = np.linspace(0, 3, 301)
POSITIONS = np.linspace(-3, 3, 601)

FALLING = {
    "near": lambda d: near(d, 0.3),
    "tolerance": lambda d: tolerance(d, 0.0, 0.1, margin=0.5),
    "reversed ramp": lambda d: 1 - ramp(d, 0.2, 1.0),
}


@pytest.mark.parametrize("kernel", FALLING.values(), ids=FALLING)
def test_kernels_fall_from_one_to_zero(kernel) -> None:
    values = kernel(DISTANCES)
    assert values[0] == 1
    assert ((values >= 0) & (values <= 1)).all()
    assert (np.diff(values) <= 0).all()
    assert values[-1] < 1e-6


@pytest.mark.parametrize("kernel", FALLING.values(), ids=FALLING)
def test_kernels_are_elementwise(kernel) -> None:
    x = np.random.default_rng(0).uniform(0, 3, (2, 3, 4))
    each = [kernel(value) for value in x.ravel()]
    np.testing.assert_array_equal(kernel(x), np.reshape(each, x.shape))


def test_near_has_the_stated_values() -> None:
    values = near(np.array([0.0, 0.1, 0.2]), 0.1)
    np.testing.assert_allclose(values, [1, 0.2384, 0.0360], atol=1e-4)


def test_ramp_has_the_stated_values() -> None:
    values = ramp(np.array([-1.0, 2.0, 2.5, 3.0, 4.0, 9.0]), 2.0, 4.0)
    np.testing.assert_array_equal(values, [0, 0, 0.25, 0.5, 1, 1])
    assert (np.diff(ramp(POSITIONS, -1.0, 2.0)) >= 0).all()


def test_tolerance_has_the_stated_values() -> None:
    x = np.array([1.0, 1.5, 2.0, 2.0 + 0.4, 1.0 - 0.4])
    np.testing.assert_allclose(tolerance(x, 1, 2, 0.4), [1, 1, 1, 0.1, 0.1])
    np.testing.assert_allclose(tolerance(x, 1, 2, 0.4, 0.7)[3:], [0.7, 0.7])


def test_tolerance_is_symmetric_about_its_middle() -> None:
    offset = POSITIONS
    np.testing.assert_allclose(
        tolerance(0.5 + offset, 0, 1, 0.3), tolerance(0.5 - offset, 0, 1, 0.3)
    )


@pytest.mark.parametrize("seed", range(20))
def test_tolerance_is_dm_controls(seed: int) -> None:
    rng = np.random.default_rng(seed)
    low, high = np.sort(rng.normal(size=2))
    margin, value = rng.uniform(0.01, 2), rng.uniform(0.01, 0.99)
    x = rng.normal(scale=2, size=200)
    theirs = dm_rewards.tolerance(x, (low, high), margin, value_at_margin=value)
    np.testing.assert_allclose(tolerance(x, low, high, margin, value), theirs)


@pytest.mark.parametrize(("low", "high"), [(1.0, 1.0), (2.0, 1.0), (np.nan, 1.0)])
def test_a_ramp_needs_ordered_bounds(low: float, high: float) -> None:
    with pytest.raises(UserError, match=f"low < high, not low {low} and high {high}"):
        ramp(DISTANCES, low, high)


@pytest.mark.parametrize(
    "wrong",
    [
        {"low": 2.0},
        {"margin": 0.0},
        {"margin": -1.0},
        {"value_at_margin": 0.0},
        {"value_at_margin": 1.0},
    ],
)
def test_tolerance_names_what_it_needs(wrong: dict[str, float]) -> None:
    given = {"low": 0.0, "high": 1.0, "margin": 1.0} | wrong
    text = "tolerance needs low <= high, margin > 0 and 0 < value_at_margin < 1, not "
    with pytest.raises(UserError, match=text):
        tolerance(DISTANCES, **given)


def test_weighted_sum_adds_terms_times_weights() -> None:
    terms = {"a": np.array([0.0, 1.0, 0.5]), "b": np.array([1.0, 1.0, 0.0])}
    reward = weighted_sum(terms, {"b": 0.25, "a": 0.75})
    np.testing.assert_array_equal(reward, [0.25, 1.0, 0.375])


@pytest.mark.parametrize("names", ["a", "abc", "ac"])
def test_terms_and_weights_have_the_same_names(names: str) -> None:
    terms = {name: np.ones(2) for name in names}
    text = r"reward terms \['a'.*and weights \['a', 'b'\] must have the same names"
    with pytest.raises(UserError, match=text):
        weighted_sum(terms, {"a": 0.5, "b": 0.5})


def test_overrides_replace_weights_and_leave_the_order() -> None:
    weights = {"a": 0.5, "b": 0.25, "c": 0.25}
    replaced = override_weights(weights, {"c": 2, "a": -1.5})
    assert list(replaced.items()) == [("a", -1.5), ("b", 0.25), ("c", 2)]
    assert weights == {"a": 0.5, "b": 0.25, "c": 0.25}


@pytest.mark.parametrize("weight", [np.nan, -np.inf, 1e300, "1", None, 1j, True])
def test_a_weight_that_is_no_moderate_number_is_refused(weight) -> None:
    with pytest.raises(UserError, match="weight of reward term 'a' must be a number"):
        override_weights({"a": 0.5}, {"a": weight})


def test_an_unknown_term_lists_the_terms() -> None:
    message = "unknown reward term 'lfit': did you mean 'lift'.*terms: lift, reach"
    with pytest.raises(UserError, match=message):
        override_weights({"lift": 0.5, "reach": 0.5}, {"lfit": 1.0})


def test_the_environments_reward_is_the_default_reward_function() -> None:
    reward = torch.rand(2, 3, 1)
    rollout = TensorDict({"next": {"reward": reward}}, [2, 3])
    assert EnvironmentReward()(rollout) is rollout["next", "reward"]
    torch.testing.assert_close(EnvironmentReward()(rollout), reward)


def test_weighted_terms_are_the_reward_that_an_environment_paid() -> None:
    batch = make_batch("Reach", 2)
    rollout = TaskEnv(batch).rollout(3)
    weighted = WeightedTerms([*batch.reward_weights.values()])(rollout)
    torch.testing.assert_close(weighted, EnvironmentReward()(rollout))
