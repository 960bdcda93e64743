"""What the numbers among the options of runs and algorithms may be."""

from dataclasses import fields
from typing import Any

from manip.errors import MOST, UserError

COUNT = (1, MOST)
NUMBER = (0, 10**9)
SHARE = (0, 1)

RANGES: dict[str, tuple[float, float]] = {
    **dict.fromkeys(("steps", "num_envs", "horizon", "eval_every"), COUNT),
    **dict.fromkeys(("eval_episodes", "threads", "control_freq", "n_step"), COUNT),
    **dict.fromkeys(("batch_size", "buffer_size", "actor_delay", "critics"), COUNT),
    **dict.fromkeys(("rollout_length", "epochs", "minibatches"), COUNT),
    **dict.fromkeys(("noise_steps", "workers"), COUNT),
    **dict.fromkeys(("actor_hidden", "critic_hidden"), COUNT),
    **dict.fromkeys(("random_steps", "conjugate_steps", "backtracks"), (0, MOST)),
    **dict.fromkeys(
        ("restart_fraction", "cool_down", "gamma", "gae_lambda", "tau"), SHARE
    ),
    **dict.fromkeys(("actor_average", "gripper_bursts", "epsilon", "clones"), SHARE),
    **dict.fromkeys(("learning_rate", "updates_per_step", "max_gradient"), NUMBER),
    **dict.fromkeys(("entropy_coefficient", "max_kl", "damping"), NUMBER),
    **dict.fromkeys(("reference_beta", "noise", "exploration_noise"), NUMBER),
    **dict.fromkeys(("target_noise", "target_noise_clip"), NUMBER),
    "checkpoint_every": NUMBER,
    **dict.fromkeys(("critic_coefficient", "target_kl", "beta"), (1e-9, 10**9)),
    "clip": SHARE,
    "action_scale": (1e-6, 1),
    "bins": (2, 1000),
    "initial_alpha": (1e-9, 10**9),
    "seed": (0, 2**32 - 1),
    "target_entropy": (-(10**9), 10**9),
}
"""Option -> the least and the most that it, or each of its numbers, may be."""


def check_options(options: Any) -> None:
    """Look at every option of a dataclass; those that are None are left open.

    Raises:
        UserError: one is out of its range.
    """
    for field in fields(options):
        value = getattr(options, field.name)
        for item in value if isinstance(value, tuple) else (value,):
            if field.name in RANGES and item is not None:
                _check(field.name, item)


def _check(name: str, value: float) -> None:
    least, most = RANGES[name]
    if least <= value <= most:
        return
    words = f"at most {most}" if value > most else f"at least {least}"
    if (least, most) == SHARE:
        words = "from 0 to 1"
    raise UserError(f"{name} must be {words}, not {value}")
