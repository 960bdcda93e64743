"""Adapters to policies as they are before the merge of room `agents`; deleted with it.

`parts_of(env, state)` becomes `env.parts(state)`. `check_observation` becomes
manip.observation.check_observation(settings.observation, batch.observation_spec), and
the `observation=policy.card.layout` of its callers becomes `policy.card.observation`.
"""

from typing import Any

from tensordict import TensorDictBase


def parts_of(env: Any, state: TensorDictBase) -> Any:
    """The observation vector, which policies take until they take parts."""
    return state["observation"]


def check_observation(layout: Any, batch: Any) -> None:
    """Compare a card's layout with the batch's."""
    batch.check_layout(layout)
