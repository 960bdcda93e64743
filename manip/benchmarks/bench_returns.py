"""Returns of PPO and SAC on Pendulum-v1, compared with Stable-Baselines3's.

Networks, options, numbers of steps and environments are the same for both libraries,
and each round uses the next seed (0, 1, ...). Policies are evaluated without noise in
the same 100 episodes. A return is the sum over 200 steps: about -1200 for an untrained
policy, -150 at best. Intervals are Welch's, 95 %, of the difference of the mean
returns. Two differences remain: manip's SAC has LayerNorm in its critics and deploys an
average of its actor.
"""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from itertools import count

import numpy as np
import torch
from scipy import stats

from manip.benchmarks import returns_manip
from manip.benchmarks.peers import import_peer
from manip.benchmarks.pendulum import HORIZON, STEPS, Act, mean_return
from manip.benchmarks.rounds import Candidate, Comparison, Settings
from manip.errors import at_least


def comparison(settings: Settings) -> Comparison:
    """Compare PPO and SAC of both libraries, one seed per round.

    Raises:
        UserError: fewer than two rounds, which have no interval, or Stable-Baselines3
            is not installed.
    """
    at_least(2, "--rounds", settings.rounds)
    torch.set_num_threads(1)
    libraries = {"manip": returns_manip.learn, "SB3": import_peer("returns_sb3").learn}
    candidates = {
        f"{algo}, {library}": _seed_by_seed(partial(learn, algo))
        for algo in STEPS
        for library, learn in libraries.items()
    }
    steps = ", ".join(f"{algo} {number:,} steps" for algo, number in STEPS.items())
    title = f"Return of {HORIZON} steps on Pendulum-v1; {steps}"
    return Comparison(
        title, candidates, unit="return", warm_up=False, derive=differences
    )


def differences(rounds: Mapping[str, Sequence[float]]) -> dict[str, float]:
    """Mean returns, and manip's less Stable-Baselines3's with Welch's interval."""
    values: dict[str, float] = {}
    for algo in STEPS:
        manip, sb3 = rounds[f"{algo}, manip"], rounds[f"{algo}, SB3"]
        interval = stats.ttest_ind(manip, sb3, equal_var=False).confidence_interval()
        values |= {
            f"{algo}_manip": float(np.mean(manip)),
            f"{algo}_SB3": float(np.mean(sb3)),
            f"{algo}_difference": float(np.mean(manip) - np.mean(sb3)),
            f"{algo}_difference_low": float(interval.low),
            f"{algo}_difference_high": float(interval.high),
        }
    return values


def _seed_by_seed(learn: Callable[[int], Act]) -> Candidate:
    seeds = count()
    return lambda: mean_return(learn(next(seeds)))
