"""PEBBLE: SAC on a reward that is learned from preferences (Lee et al. 2021, arXiv
2106.05091).

    start:      `random_steps` steps of actions without any reward, from which the first
                clips are taken
    each round: r <- fit to all comparisons so far
                r_t of every stored step <- r(s_t, a_t)   (relabelling)
    between:    SAC; see `manip.agents.sac`

The paper's start maximises the entropy of the visited states. Here it is uniform
actions, with bursts of the gripper: without bursts, some runs never grasped anything
that could be preferred. After a round the critics' values are those of the old reward;
they can start anew (Nikishin et al. 2022, arXiv 2205.07802).
"""

from dataclasses import dataclass
from typing import Annotated

from manip.agents.agent import Spaces
from manip.agents.native.gradient_check import GradientSource
from manip.agents.sac import SAC, SACConfig
from manip.io.option_ranges import SHARE
from manip.rewards.reward_function import RewardFunction


@dataclass(frozen=True)
class PEBBLEConfig(SACConfig):
    """Options of PEBBLE: SAC's, and what happens after each round of comparisons."""

    gripper_bursts: Annotated[float, SHARE] = 0.25
    """Fraction of rollouts in which the gripper opens, or closes, in every step."""
    reset_critics: bool = False
    """Start the critics anew after each round of comparisons."""


class PEBBLE(SAC):
    """PEBBLE; see the module's docstring."""

    name = "pebble"
    Config = PEBBLEConfig
    needs_preferences = True
    takes_datasets = False
    takes_device = False
    config: PEBBLEConfig

    def __init__(
        self,
        config: PEBBLEConfig,
        spaces: Spaces,
        threads: int = 1,
        gradients: GradientSource = "native",
    ) -> None:
        super().__init__(config, spaces, threads, gradients)
        self._new_critics = self._params.critics.data.clone()

    def relabel(self, reward: RewardFunction) -> None:
        """Replace all stored rewards; start the critics anew, if they are to."""
        super().relabel(reward)
        if self.config.reset_critics:
            self._params.critics.data.copy_(self._new_critics)
            self._params.targets.data.copy_(self._new_critics)
            self._critic_optim.state.clear()
