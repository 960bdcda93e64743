"""Learn a reward from the comparisons in a folder of preferences."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from manip.agents.compared_clips import ComparedClips
from manip.errors import UserError
from manip.preferences.clips import Clip, load_clip
from manip.preferences.comparison_record import Comparison
from manip.preferences.label_options import Inputs
from manip.preferences.reward_fit import fit
from manip.preferences.reward_model import RewardCard, RewardModel
from manip.preferences.reward_network import RewardNetwork
from manip.robot_config import RobotConfig

TARGETS = {"left": 1.0, "right": 0.0, "equal": 0.5}
"""Answer -> probability that left is better; skipped pairs are left out."""


class ClipReader:
    """Read the clips of comparisons as tensors, each file once.

    Args:
        folder: folder of preferences.
        card: of the reward to be learned; clips must be of its task, measures and
            length.
        robot: arm, controller and control frequency of all clips.
        widths: length of an observation and of an action in all clips.
    """

    def __init__(
        self,
        folder: Path,
        card: RewardCard,
        robot: RobotConfig,
        widths: tuple[int, int],
    ) -> None:
        self._folder, self._card = folder, card
        self._robot, self._widths = robot, widths
        self._steps: dict[str, dict[Inputs, Tensor]] = {}

    def read(self, answers: Sequence[Comparison]) -> None:
        """Read the clips of answers, as `compared` does; there may be none."""
        for answer in answers:
            self._clip(answer.left)
            self._clip(answer.right)

    def compared(self, answers: Sequence[Comparison], inputs: Inputs) -> ComparedClips:
        """The clips of all answers that were not skipped.

        Raises:
            UserError: there are none, or a clip is of another task, arm, controller,
                length or other measures.
        """
        answers = [answer for answer in answers if answer.answer in TARGETS]
        if not answers:
            raise UserError(
                f"{self._folder} holds no answer but skipped pairs: there is nothing "
                "to learn a reward from"
            )
        return ComparedClips(
            left=torch.stack([self._clip(a.left)[inputs] for a in answers]),
            right=torch.stack([self._clip(a.right)[inputs] for a in answers]),
            target=torch.tensor([TARGETS[answer.answer] for answer in answers]),
        )

    def _clip(self, clip_id: str) -> dict[Inputs, Tensor]:
        if clip_id not in self._steps:
            clip = load_clip(self._folder, clip_id)
            self._check(clip)
            both = np.concatenate([clip.observation, clip.action], axis=1)
            self._steps[clip_id] = {
                "measures": torch.from_numpy(clip.measures),
                "observation+action": torch.from_numpy(both),
            }
        return self._steps[clip_id]

    def _check(self, clip: Clip) -> None:
        card, header = self._card, clip.header
        expected = {
            "task": (header.task, card.task),
            "robot": (_words(header.robot_config), _words(self._robot)),
            "length": (clip.steps, card.clip_steps),
            "observation and action of": (clip.widths, self._widths),
        }
        if card.inputs == "measures":
            expected["measures"] = ([*header.measure_names], card.names)
        for name, (given, wanted) in expected.items():
            if given != wanted:
                raise UserError(
                    f"clip {clip.id} in {self._folder} has {name} {given}, not "
                    f"{wanted}: use another folder of preferences, or set "
                    "--labels.clip-steps and --task as the clips have them"
                )


def _words(robot: RobotConfig) -> str:
    return f"{robot.arm} {robot.controller} {robot.control_freq} Hz"


def learn_reward(
    card: RewardCard,
    pairs: ComparedClips,
    seed: Sequence[int],
    standard: Tensor | None = None,
) -> RewardModel:
    """Fit a reward to compared clips whose steps are what the card says.

    Args:
        seed: of weights, held-out pairs and their order.
        standard: [C, L, F] clips over which the reward gets mean 0 and standard
            deviation `STANDARD` (see reward_network); without them it is from 0 to 1.
    """
    generator = generator_of(*seed)
    network = RewardNetwork(len(card.names), card.members, card.hidden, generator)
    network.normalise_by(torch.cat([pairs.left, pairs.right]))
    result = fit(network, pairs, generator)
    if standard is not None:
        network.standardise(standard)
    card = replace(
        card, labels=len(pairs), accuracy=result.accuracy, held_out=result.held_out
    )
    return RewardModel(card, network)


def generator_of(*seed: int) -> torch.Generator:
    """A random generator for a seed of several numbers."""
    state = np.random.SeedSequence(seed).generate_state(1, np.uint64)
    return torch.Generator().manual_seed(int(state[0]) % 2**63)
